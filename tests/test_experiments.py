"""Every experiment is a program that says what it measures."""

import runpy
import sys

import pytest

from tests.support.loop_stages import STAGES, methods
from tests.support.paths import ROOT

PROGRAMS = sorted(
    path.stem
    for path in (ROOT / "tests" / "experiments").glob("*.py")
    if 'if __name__ == "__main__"' in path.read_text(encoding="utf-8")
)


def test_experiments_describe_themselves(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert "benchmark" in PROGRAMS
    faults = []
    for name in PROGRAMS:
        module = f"tests.experiments.{name}"
        monkeypatch.setattr(sys, "argv", [name, "--help"])
        monkeypatch.delitem(sys.modules, module, raising=False)  # runpy warns of a module that is imported already
        with pytest.raises(SystemExit) as ended:
            runpy.run_module(module, run_name="__main__")
        shown = capsys.readouterr().out
        usage, description, *_ = shown.split("\n\n")
        if ended.value.code != 0 or f"python -m {module}" not in usage or not description[0].isupper():
            faults.append(f"{name}: {shown}")
    assert faults == []


def test_the_stages_of_a_flight_that_are_timed_exist() -> None:
    """A method that is renamed would drop out of the profile unnoticed."""
    assert {stage for stage, _, _ in methods()} == set(STAGES)
