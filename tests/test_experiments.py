"""Every experiment is a program that says what it measures."""

import itertools
import runpy
import shlex
import sys

import numpy as np
import pytest

from gcs.flight.faults.schedule import scheduled_faults
from gcs.flightlog.audit import AuditEntry
from gcs.metrics.record import FlightRecord, LoopStatistics, VehicleTrack
from gcs.mission.file import load_mission
from tests.experiments import adversaries, station_tour
from tests.experiments.random_joins import Ring
from tests.experiments.ring_losses import first_even_s, quantiles_s
from tests.support.loop_stages import STAGES, methods
from tests.support.mission_text import content, parsed
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


def test_a_join_and_a_departure_of_a_known_path_are_measured() -> None:
    """The second vehicle joins at 20 s with a spacing that swings by e^-x cos x, and holds from 60 s on."""
    time_s = np.arange(0.0, 100.0, 0.1)
    swing = 0.3 * np.maximum(time_s - 20.0, 0.0)
    error_rad = np.radians(40.0) * np.exp(-swing) * np.cos(swing)
    tracks = []
    for vehicle_id, bearing in ((1, 0.05 * time_s), (2, 0.05 * time_s + np.pi + error_rad)):
        about_m = 10.0 * np.column_stack([np.cos(bearing), np.sin(bearing)])
        tactic = np.full(time_s.shape, "encircle", "<U16")
        if vehicle_id == 2:
            tactic[time_s < 20.0], tactic[time_s >= 60.0] = "formation", "hold"
        tracks.append(VehicleTrack(vehicle_id, about_m, np.gradient(about_m, time_s, axis=0), tactic))
    still, loop = np.zeros((time_s.size, 2)), LoopStatistics(10.0, 0, 0)
    record = FlightRecord("ring", 0, "simulation", "truth", time_s, still, still, tuple(tracks), loop, 1.0)
    ring = Ring(record, parsed(content()))
    alone, joined, left = ring.spans()
    # By hand: e^-x cos x is least at x = 3 pi / 4, and an eighth, which is 5 degrees, at x = 1.16.
    lowest_deg = 40.0 * np.exp(-0.75 * np.pi) * np.cos(0.25 * np.pi)
    assert ring.beyond_deg(joined) == pytest.approx(lowest_deg, abs=0.02)
    assert ring.settling(joined).took_s == pytest.approx(1.1605 / 0.3, abs=0.11)
    assert [ring.beyond_deg(span) for span in (alone, left)] == [0.0, 0.0]
    assert [ring.settling(span).took_s for span in (alone, left)] == [0.0, 0.0]
    # The spacing changes fastest at x = 0, by -0.3 * 40 degrees per second, which is before the mixing ends.
    assert ring.speed_share() == pytest.approx(10.0 * (0.3 * np.radians(40.0) - 0.05) / 3.0, rel=0.05)


def test_times_that_are_cut_off_count_until_then() -> None:
    """By hand: of four, three are left after 1 s, of which one is cut off; each of the two left is half of that."""
    waits = [(4.0, True), (1.0, True), (2.0, False), (3.0, True)]
    assert quantiles_s(waits, (0.25, 0.5, 0.75)) == [1.0, 3.0, 4.0]
    assert quantiles_s([(1.0, True), (5.0, False)], (0.5, 0.75)) == [1.0, np.inf]


def test_a_vehicle_is_first_even_when_it_stays_between_its_neighbours() -> None:
    """The first of three turns to the middle at 2 s, is absent from 4 to 6 s, and stays from then on."""
    time_s = np.arange(0.0, 20.0, 0.5)
    turns = np.tile(np.radians([40.0, 120.0, 240.0]), (time_s.size, 1))
    turns[time_s >= 2.0, 0] = 0.0
    turns[(time_s >= 4.0) & (time_s < 6.0), 0] = np.nan
    assert first_even_s(time_s, turns, 0) == 6.0
    assert first_even_s(time_s[:20], turns[:20], 0) == np.inf


def test_the_judge_of_the_adversaries_sees_commands_that_were_forged() -> None:
    """Vehicle 2 is killed in the commander's name before the hold: by a number of its own, and by that of the hold.

    Vehicle 1 refuses the hold for its date and carries it out as it is repeated.
    """

    def answer(vehicle: int, time_s: float, name: str, verb: str, number: int, did: str) -> AuditEntry:
        return AuditEntry(time_s, "answered", vehicle, "bus", name, f"command/{verb}/{name}", number, did, "", "")

    one = adversaries.Round(["operator"], "hold", (1, 2), 7, 10.0)
    misdated = answer(1, 10.1, "anna", "hold", 7, "refused: it is dated 256 s ahead of this vehicle's clock")
    own = [misdated, answer(1, 10.2, "anna", "hold", 7, "holds"), answer(1, 11.0, "eve", "hold", 8, "holds")]
    forged = [answer(2, 9.0, "anna", "kill", 9, "motors cut"), answer(2, 9.5, "anna", "kill", 7, "motors cut")]
    refused = [answer(2, 9.6, "eve", "kill", 3, "refused: may not kill")]
    flown = adversaries.Flown([one], {7: "hold"}, [*own, *forged, *refused])
    assert adversaries.usurped(flown) == 2 * ["anna: command/kill/anna: motors cut"]
    assert [fault for _, _, fault in adversaries.judged(flown)] == ["2 did not hear it"]
