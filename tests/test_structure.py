"""The structure of the packages: no circles, one class of a name, no parsed text, no chance without a seed."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests import structure
from tests.structure import (
    file_circles,
    folder_circles,
    long_files,
    long_functions,
    parsed_texts,
    repeated_classes,
    sources,
    unseeded_generators,
)

RULES = (file_circles, folder_circles, parsed_texts, repeated_classes, unseeded_generators)
REPORTED = (long_files, long_functions)


def test_sources_of_all_packages_are_found() -> None:
    found = {path.as_posix() for path in sources()}
    assert {"gcs/cli/output.py", "agents/core.py", "estimation/polar.py", "sitl/world.py"} <= found


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_sources_keep(rule: Callable[[list[Path]], list[str]]) -> None:
    assert rule(sources()) == []


@pytest.mark.parametrize("rule", RULES + REPORTED, ids=lambda rule: rule.__name__)
def test_breach_is_found(
    rule: Callable[[list[Path]], list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rule that finds nothing anywhere would keep silent about the sources, too."""
    texts = {
        "gcs/a/__init__.py": "",
        "gcs/a/one.py": "from gcs.b.two import x\ndef long():\n" + "    pass\n" * structure.FUNCTION_LINES_MAX,
        "gcs/b/two.py": "from gcs.a.one import y\nclass Twin: ...\n" + "\n" * structure.FILE_LINES_MAX,
        "gcs/a/twin.py": "class Twin: ...\n",
        "gcs/a/seed.py": "import numpy as np\nchance = np.random.default_rng()\nfixed = np.random.default_rng(1)\n",
        "gcs/a/texts.py": "def at_the_edge(text):\n    return text.split()\nis_low = alert.text == 'battery low'\n",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(structure, "ROOT", tmp_path)
    structure._tree.cache_clear()
    breaches = rule(sources())
    structure._tree.cache_clear()
    assert len(breaches) == 1, breaches
