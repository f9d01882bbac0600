"""The story of a vehicle, against what the simulation knew of the flight, and against flights made up by hand."""

import json
from collections.abc import Iterable
from math import hypot
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.inputs import AutopilotStatus, Bus, CoreInput, LateTicks, Message, TacticEvent, Tick, TimeScale
from agents.notes import Note, TacticChange
from agents.ports import FlightMode, Reference, VehicleStatus
from agents.tactics import Event
from agents.team.messages import MemberState
from estimation.state import Telemetry
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Decision, GuardResult, OwnState, Place, PolarMotion, TargetState
from gcs.metrics.record import FlightRecord
from gcs.replay.event_detectors import (
    AutopilotEvents,
    EventDetector,
    GuardEvents,
    LoopEvents,
    NoteEvents,
    PeerEvents,
    PlanFailures,
    ReceivedInputs,
    RingEvents,
    TargetEvents,
    TelemetryGaps,
    TimelineEntry,
)
from gcs.replay.playback import Turn
from gcs.replay.timeline import FOLDED_FROM, KEPT, Timeline, folded, summary_lines, timeline_of
from tests.conftest import RunHere
from tests.support.flight_logs import engaging, record_simulation

SECONDS = 25.0
EMPTY = Decision(0.0, "formation", 0.0, None, None, None, None, None, None, None, None, "", (), (), (), (), 0)
OWN = OwnState(0.0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0,) * 36)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[FlightLog, FlightRecord]:
    path = tmp_path_factory.mktemp("logs") / "case2.mcap"
    record = record_simulation(engaging("case2", (("safety", "separation_m"), 3.99)), path, seed=1, duration_s=SECONDS)
    return read_log(path), record


@pytest.fixture(scope="module")
def timelines(flight: tuple[FlightLog, FlightRecord]) -> list[Timeline]:
    return [timeline_of(flight[0], vehicle_id) for vehicle_id in (1, 2, 3)]


@pytest.fixture
def timeline(timelines: list[Timeline]) -> Timeline:
    return timelines[1]


def entries_of(timeline: Timeline, kind: str) -> list[TimelineEntry]:
    return [line for line in timeline.entries if line.kind == kind]


# Against the simulation


def test_tactics_are_those_that_the_simulation_saw(timeline: Timeline, flight: tuple[FlightLog, FlightRecord]) -> None:
    events = [(e.time_s, e.text) for e in flight[1].events if e.vehicle == timeline.vehicle_id and e.kind == "tactic"]
    assert len(events) >= 2
    assert [(line.time_s, line.text) for line in entries_of(timeline, "tactic")] == events
    assert "importance 0.800 (more than 0.6)" in entries_of(timeline, "tactic")[-1].because


def test_the_seconds_of_each_tactic_are_those_that_the_simulation_saw(
    timeline: Timeline, flight: tuple[FlightLog, FlightRecord]
) -> None:
    record = flight[1]
    tactics = record.vehicles[timeline.vehicle_id - 1].tactic.tolist()
    counted = {name: tactics[:-1].count(name) / 10.0 for name in dict.fromkeys(tactics[:-1])}
    assert timeline.summary.seconds == pytest.approx(counted)
    assert all(f"{seconds:.1f} s {name}" in summary_lines(timeline)[0] for name, seconds in counted.items())


def test_the_nearest_neighbour_is_where_it_truly_was(
    timeline: Timeline, flight: tuple[FlightLog, FlightRecord]
) -> None:
    tracks = {i: track.position_m for i, track in enumerate(flight[1].vehicles, start=1)}
    own = tracks.pop(timeline.vehicle_id)
    apart = {i: np.hypot(*(track - own).T) for i, track in tracks.items()}
    true = min(apart, key=lambda i: float(apart[i].min()))
    assert timeline.summary.nearest is not None
    assert timeline.summary.nearest.distance_m == pytest.approx(float(apart[true].min()), abs=0.03)
    assert timeline.summary.nearest.vehicle_id == true


def test_the_ring_is_told_as_it_was_at_that_moment(timeline: Timeline, flight: tuple[FlightLog, FlightRecord]) -> None:
    record = flight[1]
    first = entries_of(timeline, "ring")[0]
    assert first.time_s == next(
        e.time_s for e in record.events if e.vehicle == timeline.vehicle_id and "engage" in e.text
    )
    tick = round(first.time_s * 10.0)
    away = record.vehicles[timeline.vehicle_id - 1].position_m[tick] - record.target_position_m[tick]
    told_m = float(first.because.rpartition("radius ")[2].removesuffix(" m"))
    assert told_m == pytest.approx(hypot(*away.tolist()), abs=0.05)


def test_setpoints_that_the_guard_changed_are_all_counted(
    timelines: list[Timeline], flight: tuple[FlightLog, FlightRecord]
) -> None:
    guard = flight[1].guard
    assert guard is not None
    assert guard.interventions > 0
    assert sum(each.summary.guarded for each in timelines) == guard.interventions
    changed = [
        int(line.text.split(" setpoint")[0].split()[-1]) for each in timelines for line in entries_of(each, "guard")
    ]
    assert sum(changed) == guard.interventions


def test_a_timeline_ends_in_two_sentences_and_is_json_as_well(
    flight: tuple[FlightLog, FlightRecord], run_here: RunHere
) -> None:
    code, out, err = run_here("replay", str(flight[0].path), "--explain", "2", "--json")
    assert code == 0
    story = json.loads(out)["story"]
    assert story["vehicle"] == 2
    assert any(line["text"] == "formation -> encircle: engage" for line in story["lines"])
    shown = " ".join(err.split())
    assert "formation -> encircle: engage" in shown
    assert all(" ".join(sentence.split()) in shown for sentence in story["summary"])


# Against flights made up by hand


def turn(time_s: float, *inputs: CoreInput, **fields: Any) -> Turn:
    return Turn((*inputs, Tick(time_s)), msgspec.structs.replace(EMPTY, time_s=time_s, **fields))


def lines(detector: EventDetector, turns: Iterable[Turn]) -> list[TimelineEntry]:
    received, said = ReceivedInputs(), list[TimelineEntry]()
    for each in turns:
        received.take(each)
        said += detector.update(each, received)
    return said + list(detector.end())


def states(text: str, *facts: str) -> bool:
    """Return whether a text states all of the facts."""
    return all(fact in text for fact in facts)


def member(time_s: float, x: float) -> Message:
    state = MemberState(3, time_s, "encircle", (x, 0.0), (1.0, 0.0), (0.0, 0.0), (0.0, 0.0), altitude_m=0.0)
    return Message(time_s, state)


def test_an_intervention_is_told_once_with_the_nearest_that_anybody_came() -> None:
    def guarded(status: str, *causes: str) -> dict[str, Any]:
        return {"guard": GuardResult((0.0, 0.0), status, causes, None), "own": OWN, "peers": (3,)}

    note = Note(1.0, "guard", "separation", "was moved by 0.50 m")
    turns = [
        turn(0.5, **guarded("passed")),
        turn(1.0, member(0.9, 3.9), notes=(note,), **guarded("changed", "separation")),
        turn(2.0, member(1.9, 1.9), **guarded("braked", "separation")),
        turn(4.0, member(3.9, 4.9), **guarded("changed", "fence")),
        turn(20.0, **guarded("changed", "fence")),
    ]
    one, other = lines(GuardEvents(), turns)
    assert one.time_s == 1.0
    assert states(one.text, "separation, fence", "3 setpoints", "3.0 s")
    # At 1.9 s it was 1.9 m away and flew on with 1 m/s.
    assert states(one.because, note.because, "vehicle 3", "2.00 m", "braked")
    assert other.time_s == 20.0
    assert states(other.text, "fence", "1 setpoint")


def test_notes_of_failsafes_commands_and_tactics_are_told_with_their_numbers() -> None:
    notes = (
        Note(7.0, "command", "hold by ground: holds"),
        Note(7.0, "failsafe", "target stale: not seen for 10.0 s: hold"),
        Note(7.0, "tactic", "encircle -> hold: hold", tactic=TacticChange("encircle", "hold", "hold")),
    )
    said = lines(NoteEvents(), [turn(7.0, TacticEvent(Event.HOLD), notes=notes, own=OWN)])
    assert [(line.kind, line.text) for line in said] == [(note.kind, note.text) for note in notes]
    assert states(said[2].because, "outside the control core", "(0.00, 0.00) m", "0.0 m")


def test_who_is_counted_on_and_who_is_not_any_more() -> None:
    said = lines(PeerEvents(), [turn(0.0), turn(1.0, member(0.9, 4.0), peers=(3,)), turn(2.0, peers=(3,)), turn(3.0)])
    added, removed = said
    assert (added.time_s, removed.time_s) == (1.0, 3.0)
    assert states(added.text, "vehicle 3", "added")
    assert states(removed.text, "vehicle 3", "removed")
    assert states(added.because, "encircle", "(4.00, 0.00) m")
    assert states(removed.because, "encircle", "2.10 s")


def test_the_ring_is_told_when_it_grows_and_shrinks() -> None:
    polar = PolarMotion(10.0, 0.0, 0.0, 0.05)
    alone, pair = Place(1, None, None), Place(2, np.pi / 2.0, 1.5 * np.pi)
    turns = [
        turn(float(i), place=place, polar=polar) for i, place in enumerate((None, alone, alone, pair, alone, None))
    ]
    said = lines(RingEvents(), turns)
    assert [(line.time_s, line.text.rpartition(" ")[2]) for line in said] == [(1.0, "1"), (3.0, "2"), (4.0, "1")]
    assert states(said[1].because, "90.0° ahead", "270.0° behind", "180°", "10.00 m")


def test_the_target_is_told_when_it_is_known_and_when_it_is_lost() -> None:
    covariance = np.diag([0.04, 0.25, 1.0, 1.0]).ravel().tolist()
    belief = TargetState(1.0, (3.0, 4.0, 0.0, 0.0), tuple(covariance), 1.0, 0.8, 0.2)
    turns = [turn(0.0), turn(1.0, target=belief, own=OWN), turn(11.5), turn(12.0, target=belief, own=OWN)]
    first, lost, again = lines(TargetEvents(), turns)
    assert [each.time_s for each in (first, lost, again)] == [1.0, 11.5, 12.0]
    assert states(first.because, "(3.00, 4.00) m", "0.50 m", "5.00 m", "importance 0.800", "threat 0.200")
    assert states(lost.text, "lost")
    assert states(lost.because, "10.5 s")
    assert again.text == f"{first.text} again"


def test_failed_plans_are_one_line_for_each_time() -> None:
    turns = [turn(i / 10.0, qp="fallback" if i in (10, 11, 15, 90) else "interior") for i in range(100)]
    one, other = lines(PlanFailures(), turns)
    assert (one.time_s, other.time_s) == (1.0, 9.0)
    assert states(one.text, "3 ticks", "0.5 s")


@pytest.mark.parametrize(("time_scale", "gaps"), [(1.0, ["0.60"]), (10.0, [])])
def test_telemetry_that_stays_away(time_scale: float, gaps: list[str]) -> None:
    heard = [Telemetry(time_s, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for time_s in (0.0, 0.4, 1.0, 1.1)]
    found = lines(TelemetryGaps(), [turn(2.0, TimeScale(time_scale), *heard)])
    assert [line.text.split()[-2] for line in found] == gaps


def test_a_late_computer_is_counted_tick_by_tick() -> None:
    """Recorded is only a change of the count: it holds until then."""
    turns = [turn(1.0, LateTicks(2)), turn(1.3), turn(1.4, LateTicks(0)), turn(9.0, LateTicks(1), Bus(alive=False))]
    bus, *late = sorted(lines(LoopEvents(), turns), key=lambda line: line.kind != "link")
    assert (bus.time_s, bus.text) == (9.0, "bus lost")
    first, second = late
    assert (first.time_s, second.time_s) == (1.0, 9.0)
    assert states(first.text, "4 ticks", "0.3 s", "at most 2")
    assert states(second.text, "1 tick ", "0.0 s")


def test_ticks_beside_a_landing_are_not_late() -> None:
    turns = [turn(1.0, LateTicks(2), tactic="land"), turn(1.1, tactic="land"), turn(1.2, tactic="land")]
    (late,) = lines(LoopEvents(), turns)
    assert states(late.text, "2 ticks", "0.0 s")


def test_an_autopilot_is_told_of_when_more_changes_than_its_battery() -> None:
    def said(battery: float, mode: FlightMode, *, known: bool = True) -> AutopilotStatus:
        status = VehicleStatus(connected=True, armed=True, in_air=True, mode=mode, battery=battery)
        return AutopilotStatus(msgspec.structs.replace(status, reference=Reference(is_known=known)))

    turns = [
        turn(1.0, said(0.9, FlightMode.HOLD)),
        turn(2.0, said(0.8, FlightMode.HOLD)),
        turn(3.0, said(0.7, FlightMode.OFFBOARD)),
        turn(4.0, said(0.7, FlightMode.OFFBOARD, known=False)),
        turn(4.1, said(0.7, FlightMode.OFFBOARD)),
    ]
    assert [(line.time_s, line.text, line.because) for line in lines(AutopilotEvents(), turns)] == [
        (1.0, "connected, armed, in the air, mode hold", "battery 90%"),
        (3.0, "mode offboard", "battery 70%"),
        (4.0, "origin of its positions is read again", "battery 70%"),
    ]


def test_what_is_repeated_is_folded() -> None:
    many = [TimelineEntry(float(i), "guard", f"separation: changes {i} setpoints", key="guard") for i in range(10)]
    other = TimelineEntry(5.5, "tactic", "formation -> hold: hold")
    told = list(folded(sorted([*many, other]), 0.0))
    assert [line.time_s for line in told] == [0.0, 1.0, 2.0, 5.5]
    assert states(told[KEPT].text, "8 ", "9.0 s", many[KEPT].text)
    assert list(folded(many[: FOLDED_FROM - 1], 0.0)) == many[: FOLDED_FROM - 1]


def test_a_timeline_of_a_log_with_a_gap_says_so(flight: tuple[FlightLog, FlightRecord], tmp_path: Path) -> None:
    log = flight[0]
    holed = FlightLog(log.path, log.run_records, {**log.vehicles, 2: log.vehicles[2][:500] + log.vehicles[2][510:]})
    assert "records 501 to 510 are missing" in " ".join(line.text for line in timeline_of(holed, 2).entries)
