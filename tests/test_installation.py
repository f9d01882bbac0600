"""What is tested is what people get: the installation of these sources, compiled where there is a C compiler."""

import inspect
import pydoc
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import agents.core
import cordon
from native_build import compiled_files, no_compiler
from tests.structure import PACKAGES
from tests.support.installation import compiled, fault, place
from tests.support.paths import ROOT

PINNED = re.compile(r"^([\w.-]+)==([^\s;]+)(.*\\\n(?: {4}--hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)?", re.MULTILINE)
"""A line of constraints.txt, or an entry of requirements.txt with its hashes."""

HELP = """
import inspect, sys, pydoc, cordon
folder, *native = sys.argv[1:]
assert cordon.__file__.startswith(folder), cordon.__file__
for name in dir(cordon):
    thing = getattr(cordon, name)
    print(inspect.getdoc(thing) if name in native else pydoc.plain(pydoc.render_doc(thing)))
"""
NATIVE = ("Polar", "Situation")
"""The public classes that are compiled: of these, help has no signatures, and no docstrings of properties."""


def test_the_packages_are_those_that_the_installation_of_this_python_has() -> None:
    assert fault(place()) == ""
    assert Path(agents.core.__file__).is_relative_to(place())


def test_processes_have_the_same_packages_wherever_they_start() -> None:
    for folder in (ROOT, Path.home()):
        program = "import agents.core; print(agents.core.__file__)"
        done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == agents.core.__file__


def test_the_requirements_with_hashes_have_the_versions_of_the_constraints() -> None:
    """CONTRIBUTING.md has the command that writes them. What only builds is not in the constraints."""
    constraints, requirements = (
        {_normal(name): (version, hashes) for name, version, hashes in PINNED.findall((ROOT / file).read_text())}
        for file in ("constraints.txt", "requirements.txt")
    )
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    needed = [*project["project"]["dependencies"], *project["build-system"]["requires"], "mypy", "setuptools"]
    assert {_normal(re.split("[<>=]", each)[0]) for each in needed} <= set(requirements)
    assert [name for name, (_, hashes) in requirements.items() if not hashes] == []
    both = constraints.keys() & requirements.keys()
    assert {name: requirements[name][0] for name in both} == {name: constraints[name][0] for name in both}
    assert set(requirements) - both == {
        "hatch-fancy-pypi-readme",
        "hatchling",
        "setuptools",
        "tomlkit",
        "trove-classifiers",
    }


def _normal(name: str) -> str:
    return re.sub("[-_.]+", "-", name).lower()


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for package in PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    return tmp_path


@pytest.mark.skipif(bool(no_compiler()), reason="no C compiler")
def test_an_installation_of_other_sources_or_without_a_compiled_module_is_a_fault(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CORDON_COMPILE", raising=False)
    assert "agents/broadcast.py" in fault(copy)
    for name in compiled_files(ROOT):
        (copy / name).with_suffix(".cpython-311-x86_64-linux-gnu.so").touch()
    assert compiled(copy)
    assert fault(copy) == ""
    (copy / "gcs/errors.py").write_text("", encoding="utf-8")
    (copy / "gcs/mission/missions/case1.toml").unlink()
    for name in ("gcs/errors.py", "gcs/mission/missions/case1.toml"):
        assert name in fault(copy)


def test_help_of_the_public_interface_is_that_of_the_sources() -> None:
    sources, tested = (
        subprocess.run(
            [sys.executable, "-c", HELP, str(folder), *NATIVE],
            env={"PYTHONPATH": str(folder), "PYTHONSAFEPATH": "1"},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for folder in (ROOT, place())
    )
    assert tested.replace(str(place()), "") == sources.replace(str(ROOT), "")
    for name in dir(cordon):
        assert inspect.getdoc(getattr(cordon, name)) or not inspect.isclass(getattr(cordon, name))
    assert "Return the plan of this tick" in pydoc.render_doc(cordon.TaskPlanner)
