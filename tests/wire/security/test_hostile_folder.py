"""Commands started in a folder from elsewhere, which holds modules with the names of cordon's and of Python's.

The runs of every command are in such a folder as well (`tests/wire/test_verbs.py`).
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gcs.link.ports import free_ports
from tests.support.hostile_modules import PACKAGES, imported, write_modules
from tests.support.paths import ROOT
from tests.support.verb_runs import DRILL, SCRIPT, fault, script, words, write_missions
from tests.support.wire import PATIENCE_S

pytestmark = pytest.mark.wire


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """Return a folder of missions with modules that leave a mark where they are imported."""
    folder = tmp_path / "missions"
    folder.mkdir()
    write_missions(folder)
    write_modules(folder)
    return folder


def run(folder: Path, *command: str) -> tuple[subprocess.CompletedProcess[str], str]:
    """Run a program there as a user does; return how it ended, and which of the folder's modules were imported."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    ended = subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=10 * PATIENCE_S,
        check=False,
    )
    return ended, imported(folder)


def test_the_modules_leave_marks(hostile: Path) -> None:
    _, marks = run(hostile, "-c", "import json, gcs")
    assert marks.split()[::3] == ["json", "gcs"]


@pytest.mark.parametrize(
    "arguments",
    [
        "fly ring.toml --sitl --speed max --duration 2 --log fly.mcap --station --station-address 127.0.0.1:{page}",
        "sweep ring.toml --seeds 0:1 --duration 2 --workers 1 --out swept",
    ],
    ids=lambda arguments: arguments.partition(" ")[0],
)
def test_no_process_of_a_command_imports_them(hostile: Path, arguments: str) -> None:
    ended, marks = run(hostile, script(hostile.parent, SCRIPT), *arguments.format(page=free_ports(1)[0]).split())
    assert marks == "", ended.stderr
    assert ended.returncode in (0, 1), ended.stderr


def test_a_drill_imports_none_either_and_tells_its_progress_and_its_table(hostile: Path) -> None:
    ended, marks = run(hostile, script(hostile.parent, SCRIPT), *words(DRILL))
    assert marks == "", ended.stderr
    assert fault(DRILL, ended.returncode, ended.stdout, ended.stderr) == "", ended.stderr
    result = json.loads(ended.stdout)
    assert (result["mission"], result["holds"]) == ("case2", True)
    (row,) = result["drills"]
    assert list(row) == ["fault", "expected", "limit_s", "measured_s", "holds", "detail"]
    assert (row["fault"], row["limit_s"], row["holds"]) == ("frozen interpreter", 2.0, True)
    assert 1.0 < row["measured_s"] <= 2.0, "later than a process that is gone: somebody had to notice"
    assert "1 of 1: frozen interpreter ..." in ended.stderr
    assert "drills of case2" in ended.stderr


@pytest.mark.parametrize("module", ["cordon", "gcs"])
def test_python_m_imports_none_but_what_it_is_told_to(hostile: Path, module: str) -> None:
    for name in PACKAGES:
        (hostile / name).rename(hostile / f"no-{name}")
    ended, marks = run(hostile, "-m", module, "sim", "ring.toml", "--duration", "2")
    assert (ended.returncode in (0, 1), marks) == (True, ""), ended.stderr


def test_figures_do_not_follow_its_settings(hostile: Path, tmp_path: Path) -> None:
    (hostile / "matplotlibrc").write_text("lines.linewidth: 40\nno.such.key: \x1b[2J\n", encoding="utf-8")
    drawn: list[bytes] = []
    for folder in (tmp_path, hostile):
        path = tmp_path / f"{len(drawn)}.svg"
        arguments = ("sim", str(hostile / "ring.toml"), "--duration", "2", "--plot", str(path))
        ended, marks = run(folder, "-P", "-m", "cordon", *arguments)
        assert marks == ""
        assert "matplotlibrc" not in ended.stderr
        assert "\x1b" not in ended.stderr
        drawn.append(path.read_bytes())
    assert drawn[0] == drawn[1]


def test_sources_run_in_their_own_folder_with_their_processes() -> None:
    """`python -m gcs` in a clone that is not installed."""
    place = "import gcs; print(gcs.__file__)"
    program = f"""
import subprocess, sys
from gcs.__main__ import leave_current_folder
leave_current_folder()
subprocess.run([sys.executable, "-c", {place!r}], check=True)
"""
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONSAFEPATH")}
    printed = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert Path(printed.strip()) == ROOT / "gcs" / "__init__.py"
