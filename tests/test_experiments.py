"""Every experiment is a program that says what it measures."""

import itertools
import runpy
import shlex
import sys

import pytest

from gcs.flight.faults.schedule import scheduled_faults
from gcs.mission.file import load_mission
from tests.experiments import station_tour
from tests.support.loop_stages import STAGES, methods
from tests.support.page.walk_through import lines_of
from tests.support.paths import ROOT

EXPERIMENTS = ROOT / "tests" / "experiments"
PROGRAMS = sorted(
    path.stem for path in EXPERIMENTS.glob("*.py") if 'if __name__ == "__main__"' in path.read_text(encoding="utf-8")
)


def test_experiments_describe_themselves(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert {"benchmark", "verbs"} <= set(PROGRAMS)
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


def test_the_walk_through_of_the_page_can_be_carried_out() -> None:
    document = station_tour.DOCUMENT.read_text(encoding="utf-8")
    lines = list(lines_of(document))
    assert station_tour.not_understood(lines) == []
    fly, *others = (shlex.split(line.words) for line in lines if line.kind == "command")
    faults = [value for option, value in itertools.pairwise(fly) if option == "--fault"]
    mission = load_mission(fly[2])
    assert len(scheduled_faults(faults, mission, mission.mission.duration_s, mission.ids)) == 3
    log = fly[fly.index("--log") + 1]
    assert [words[1:] for words in others] == [["station", log], ["report", log]]
