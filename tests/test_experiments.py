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
from tests.support.wording import facts_missing

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


def test_what_a_walk_through_asks_for_in_other_words_is_named() -> None:
    asked = "# Title\n1. Sing.\n## 1. Start\n1. Sing.\n- The **Moon** shows `a light`.\n- The **Map** is fine.\n"
    faults = station_tour.not_understood(list(lines_of(asked)))
    assert [fault.partition(":")[0] for fault in faults] == ["1. Start"] * 3
    assert facts_missing(" ".join(faults), "Sing.", "Moon", "is fine") == []


def test_events_of_the_page_and_of_the_log_are_the_same_only_at_the_same_time() -> None:
    shown = station_tour.on_page(
        [
            ("–", "Vehicle 1: connected"),
            ("1:02", "Vehicle 2: alert: bus flooded"),
            ("1:09", "Vehicle 2: alert: tilted"),
        ],
        "alert: (.+)",
    )
    logged = station_tour.in_log(
        [
            {"kind": "failsafe", "vehicle": 2, "time_s": 63.5, "text": "bus flooded: 900 messages a second: fly on"},
            {"kind": "failsafe", "vehicle": 2, "time_s": 62.0, "text": "tilted: 40 degrees: land"},
            {"kind": "tactic", "vehicle": 2, "time_s": 69.0, "text": "tilted: no alert"},
        ],
        "failsafe",
        "([a-z ]+):",
    )
    assert [event.text for event in shown] == ["bus flooded", "tilted"]
    assert [event.text for event in station_tour.without_counterpart(shown, logged)] == ["tilted"]


def test_changes_of_tactic_at_once_are_one_for_who_hears_of_them_some_times_a_second() -> None:
    happened = station_tour.Happened
    changes = [
        happened(1, "hold -> formation", 80.50),
        happened(2, "hold -> formation", 80.51),
        happened(1, "formation -> encircle", 80.52),
        happened(2, "formation -> encircle", 93.0),
    ]
    whole = [happened(1, "hold -> encircle", 80.50), changes[1], changes[3]]
    assert station_tour.merged(changes) == whole
