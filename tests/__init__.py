"""The tests, and the one command that checks everything: `python -m tests`.

They run what is installed, not the sources beside them: Python finds this folder's neighbours last, and processes that
tests start do not look for modules where they are started. The sources run where they are installed (`pip install -e`),
or with `PYTHONPATH=.`.
"""

import os
import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent
_CHOSEN = [Path(each).resolve() for each in os.environ.get("PYTHONPATH", "").split(os.pathsep) if each]

if _ROOT not in _CHOSEN:
    sys.path[:] = [*(each for each in sys.path if Path(each).resolve() != _ROOT), str(_ROOT)]
if _CHOSEN:
    os.environ["PYTHONPATH"] = os.pathsep.join(map(str, _CHOSEN))
os.environ["PYTHONSAFEPATH"] = "1"
