"""Replays of recorded flights: identical, or different at exactly the tick and in the field that was changed."""

import json
from collections.abc import Sequence
from math import inf, nextafter
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest

from agents.drops import Drops
from agents.inputs import (
    AutopilotStatus,
    Bus,
    Command,
    Computer,
    CoreInput,
    Ground,
    Killed,
    LateTicks,
    Lying,
    Message,
    Presence,
    Rejoined,
    Start,
    TacticEvent,
    Tick,
    TimeScale,
    VehicleJoins,
)
from agents.ports import FlightMode, VehicleStatus
from agents.situation.situation import Situation
from agents.situation.task import Task
from agents.tactics import Event, Tactic
from agents.team.codec import decode, encode
from agents.team.messages import (
    AddedVehicle,
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    StartProposal,
    TargetPackage,
)
from estimation.state import Sighting, Telemetry
from gcs.flightlog.reader import FlightLog, LogRecord, read_log
from gcs.flightlog.records import Decision, Run, Sent, Version
from gcs.replay.comparison import COVARIANCE_TOLERANCE, TOLERANCE, close
from gcs.replay.cores import VehicleReplay, replay
from tests.conftest import RunHere
from tests.support.flight_logs import engaging, part, record_simulation, reencoded, rewrite
from tests.support.result_keys import OUTPUT_KEYS

pytestmark = pytest.mark.slow

SECONDS, TICKS = 12.0, 121


@pytest.fixture(scope="module")
def case2(tmp_path_factory: pytest.TempPathFactory) -> FlightLog:
    path = tmp_path_factory.mktemp("logs") / "case2.mcap"
    record_simulation(engaging("case2"), path, seed=1, duration_s=SECONDS)
    return read_log(path)


@pytest.fixture
def copy(case2: FlightLog) -> FlightLog:
    """The same log, of which records may be changed in place."""
    return FlightLog(case2.path, list(case2.run_records), {i: list(each) for i, each in case2.vehicles.items()})


def nth(records: Sequence[LogRecord], kind: type, count: int) -> int:
    """Return the place of the n-th record of a kind, counted from 1."""
    return [place for place, record in enumerate(records) if record.kind is kind][count - 1]


def ticks_before(records: Sequence[LogRecord], place: int) -> int:
    return sum(record.kind is Tick for record in records[:place])


def change_decision(log: FlightLog, vehicle_id: int, tick: int, **fields: Any) -> None:
    records = log.vehicles[vehicle_id]
    place = nth(records, Decision, tick)
    records[place] = reencoded(records[place], msgspec.structs.replace(records[place].read(Decision), **fields))


def other_osqp(log: FlightLog) -> None:
    run = log.run_records[0].read(Run)  # `log.run` would remember it as it was
    versions = tuple(Version(each.name, "0.1") if each.name == "osqp" else each for each in run.versions)
    run = msgspec.structs.replace(run, versions=versions)
    log.run_records[:] = [reencoded(each, run) if each.kind is Run else each for each in log.run_records]


def of(log: FlightLog, vehicle_id: int) -> VehicleReplay:
    """Replay one vehicle of a log."""
    (vehicle,) = replay(part(log, vehicle_id)).vehicles
    return vehicle


# Identical


def test_a_recorded_flight_is_replayed_bit_for_bit(tmp_path: Path, run_here: RunHere) -> None:
    record = record_simulation(engaging(), tmp_path / "log.mcap", seed=1, duration_s=SECONDS)
    assert any("encircle" in vehicle.tactic for vehicle in record.vehicles)
    code, out, err = run_here("replay", str(tmp_path / "log.mcap"), "--json")
    result = json.loads(out)
    assert (code, result["same"], result["tolerance"]) == (0, True, None)
    assert list(result) == OUTPUT_KEYS["replay"].split()
    counts = [(each["id"], each["ticks"], each["compared"], each["identical"]) for each in result["vehicles"]]
    assert counts == [(vehicle_id, TICKS, TICKS, TICKS) for vehicle_id in (1, 2, 3)]
    assert "bit for bit" in err


# Different


def test_one_changed_telemetry_is_found_at_the_next_tick(case2: FlightLog, tmp_path: Path, run_here: RunHere) -> None:
    place = nth(case2.vehicles[2], Telemetry, 117)
    before = case2.vehicles[2][place].read(Telemetry)
    x, y, z = before.position_m
    after = msgspec.structs.replace(before, position_m=(x + 1e-9, y, z))
    path = tmp_path / "changed.mcap"
    rewrite(case2, path, 2, lambda record: after if record is case2.vehicles[2][place] else record.read(record.kind))
    code, out, err = run_here("replay", str(path), "--json")
    result = json.loads(out)
    one, two, three = result["vehicles"]
    assert (code, result["same"]) == (1, False)
    assert (one["difference"], three["difference"]) == (None, None)
    tick = ticks_before(case2.vehicles[2], place) + 1
    found = two["difference"]
    assert (found["tick"], found["time_s"]) == (tick, pytest.approx((tick - 1) / 10.0))
    (belief,) = (field for field in found["fields"] if field["field"] == "own.mean[0]")
    assert 0.0 < belief["replayed"] - belief["recorded"] < 1e-9, "a filter believes a part of what it measures"
    assert any(
        f"{before.time_s:.3f} s" in text and f"({x:.3f}, {y:.3f}, {z:.3f}) m" in text for text in found["inputs"]
    )
    assert f"vehicle 2: first difference: tick {tick}, {(tick - 1) / 10:.3f} s" in err
    assert "setpoint.position_m[0]" in err


def test_one_changed_bit_of_a_decision_is_found_there_and_nowhere_else(copy: FlightLog) -> None:
    decision = copy.vehicles[3][nth(copy.vehicles[3], Decision, 110)].read(Decision)
    assert decision.setpoint is not None
    x, y, z = decision.setpoint.position_m
    changed = msgspec.structs.replace(decision.setpoint, position_m=(x, nextafter(y, inf), z))
    change_decision(copy, 3, 110, setpoint=changed)
    vehicle = of(copy, 3)
    assert vehicle.difference is not None
    assert vehicle.difference.moment.tick == 110
    assert [each.field for each in vehicle.difference.fields] == ["setpoint.position_m[1]"]
    assert vehicle.difference.fields[0].recorded == nextafter(y, inf)
    assert vehicle.difference.fields[0].replayed == y
    assert (vehicle.compared, vehicle.identical) == (TICKS, TICKS - 1)
    assert isinstance(vehicle.difference.moment.inputs[-1], Tick)
    assert len([each for each in vehicle.difference.moment.inputs if isinstance(each, Tick)]) == 1


def test_a_changed_message_is_told_by_what_it_says(copy: FlightLog) -> None:
    decisions = [each.read(Decision) for each in copy.vehicles[2] if each.kind is Decision]
    sending, decision = next((n, each) for n, each in enumerate(decisions, 1) if n >= 100 and each.sent)
    state = decode(decision.sent[0].payload)
    assert isinstance(state, MemberState)
    garbled = Sent(decision.sent[0].topic, encode(msgspec.structs.replace(state, tactic="hold")))
    change_decision(copy, 2, sending, sent=(garbled, *decision.sent[1:]))
    difference = of(copy, 2).difference
    assert difference is not None
    assert [each.field for each in difference.fields] == ["sent[0].message.tactic"]


# Other versions


def test_other_versions_are_compared_within_the_tolerance(copy: FlightLog) -> None:
    place = nth(copy.vehicles[2], Decision, 80)
    decision = copy.vehicles[2][place].read(Decision)
    assert decision.setpoint is not None
    x, y, z = decision.setpoint.position_m
    other_osqp(copy)
    seen: list[None] = []
    for off_m, same in ((0.9 * TOLERANCE, True), (1.1 * TOLERANCE, False)):
        change_decision(copy, 2, 80, setpoint=msgspec.structs.replace(decision.setpoint, position_m=(x + off_m, y, z)))
        result = replay(FlightLog(copy.path, copy.run_records, {2: copy.vehicles[2]}), lambda: seen.append(None))
        assert result.same is same
        (told,) = result.other_versions
        assert told.startswith("osqp 0.1 in the flight, ")
    assert len(seen) == 2 * TICKS, "whoever counts is shown every tick"


def test_other_versions_are_named_with_the_tolerance(case2: FlightLog, tmp_path: Path, run_here: RunHere) -> None:
    run = msgspec.structs.replace(case2.run, versions=(*case2.run.versions[:-1], Version("machine", "abacus")))
    path = tmp_path / "elsewhere.mcap"
    rewrite(case2, path, 0, lambda record: run if record.kind is Run else record.read(record.kind))
    code, out, err = run_here("replay", str(path), "--json")
    assert (code, json.loads(out)["tolerance"]) == (0, TOLERANCE)
    assert "machine abacus in the flight" in " ".join(err.split())
    assert f"within {TOLERANCE:g}" in err


def test_what_is_close(subtests: pytest.Subtests) -> None:
    for field, one, other, same in (
        ("own.mean[0]", 1.0, 1.0 + 0.9 * TOLERANCE, True),
        ("own.covariance[0]", 1.0, 1.0 + 2.0 * COVARIANCE_TOLERANCE, False),
        ("notes[0].because", "moved by 0.53 m", "moved by 0.54 m", True),
        ("notes[0].because", "moved by 0.53 m", "moved by 0.55 m", False),
        ("notes[0].text", "vehicle 1", "vehicle 2", False),
        ("notes[0].text", "hold", "land", False),
        ("messages_dropped", 3, 4, False),
        ("own", None, 1.0, False),
    ):
        with subtests.test(field=field, one=one, other=other, same=same):
            assert close(field, one, other) is same


# Logs that are not whole


def test_from_a_gap_on_nothing_is_compared(copy: FlightLog) -> None:
    records = copy.vehicles[2]
    place = nth(records, Telemetry, 60)
    number, tick = records[place].plain()["number"], ticks_before(records, place)
    del records[place]
    result = replay(copy)
    one, two, three = result.vehicles
    assert (two.ticks, two.compared, two.identical) == (TICKS, tick, tick)
    assert f"record {number} " in two.gap
    assert f"tick {tick + 1} " in two.gap
    assert (two.difference, one.gap, three.gap) == (None, "", "")
    assert one.compared == three.compared == TICKS


def test_a_damaged_record_is_a_gap(copy: FlightLog) -> None:
    place = nth(copy.vehicles[2], Telemetry, 60)
    copy.vehicles[2][place] = copy.vehicles[2][place]._replace(payload=b"\xff\xff\xff")
    vehicle = of(copy, 2)
    assert "telemetry) cannot be read" in vehicle.gap
    assert vehicle.compared == ticks_before(copy.vehicles[2], place)


def test_a_log_that_ends_within_a_tick_is_replayed_to_there(copy: FlightLog) -> None:
    del copy.vehicles[2][nth(copy.vehicles[2], Tick, 100) + 1 :]
    vehicle = of(copy, 2)
    assert (vehicle.ticks, vehicle.compared, vehicle.identical) == (100, 99, 99)
    assert (vehicle.gap, vehicle.difference, vehicle.failure) == ("", None, None)


# Cores that fail


def failing_from(monkeypatch: pytest.MonkeyPatch, at_s: float) -> None:
    def failing(tactic: Tactic, situation: Situation, layer_m: float, peers: tuple[MemberState, ...]) -> Task:
        if situation.now_s >= at_s:
            raise ZeroDivisionError("no such plan")
        return Task(tactic, situation, layer_m, peers)

    monkeypatch.setattr("agents.core.Task", failing)


def test_a_failure_that_was_recorded_is_reported_with_its_inputs(
    copy: FlightLog, monkeypatch: pytest.MonkeyPatch
) -> None:
    del copy.vehicles[2][nth(copy.vehicles[2], Tick, 101) + 1 :]
    failing_from(monkeypatch, 10.0)
    vehicle = of(copy, 2)
    assert vehicle.failure is not None
    assert vehicle.failure.error == "ZeroDivisionError: no such plan"
    assert vehicle.failure.recorded
    assert (vehicle.failure.moment.tick, vehicle.failure.moment.time_s) == (101, 10.0)
    assert (vehicle.compared, vehicle.identical, vehicle.difference) == (100, 100, None)


def test_a_failure_that_was_not_recorded_is_a_difference(
    case2: FlightLog, monkeypatch: pytest.MonkeyPatch, run_here: RunHere
) -> None:
    failing_from(monkeypatch, 10.0)
    code, out, err = run_here("replay", str(case2.path), "--json")
    vehicle = json.loads(out)["vehicles"][0]
    assert code == 1
    assert (vehicle["failure"]["tick"], vehicle["failure"]["recorded"], vehicle["identical"]) == (101, False, 100)
    assert vehicle["difference"]["fields"][0] == {"field": "", "recorded": "a decision", "replayed": "no decision"}
    assert "ZeroDivisionError: no such plan" in err


def test_a_tick_without_a_decision_in_mid_flight_is_a_difference(copy: FlightLog) -> None:
    """A core that failed when it was recorded, and does not fail any more."""
    records = copy.vehicles[2]
    del records[nth(records, Decision, 100)]
    for place, record in enumerate(records):
        records[place] = reencoded(record, record.read(record.kind), number=place + 1)
    vehicle = of(copy, 2)
    assert vehicle.difference is not None
    assert vehicle.difference.moment.tick == 100
    assert vehicle.difference.fields[0].recorded == "no decision"
    assert (vehicle.compared, vehicle.identical) == (TICKS, TICKS - 1), "what comes after it is as it was"


# Bad input


def test_what_cannot_be_done_is_told(subtests: pytest.Subtests, case2: FlightLog, run_here: RunHere) -> None:
    for arguments, told in (
        (("--explain", "9"), "--explain: the log has no vehicle 9 (it has 1, 2, 3)"),
        (("--set", "own_filter.gate_sigm=3"), "gate_sigm: unknown key; did you mean 'gate_sigma'?"),
        (("--set", "safety.guard=false"), "safety: unknown key; known keys: own_filter, target_filter"),
        (("--set", "own_filter.gate_sigma=3\nx=1"), "own_filter.gate_sigma: "),
        (("--set", "target_filter.gate_sigma=-3"), "gate_sigma: it must be greater than 1 (given: -3)"),
        (("--set", "own_filter.gate_sigma"), "it must be KEY=VALUE"),
    ):
        with subtests.test(arguments=arguments, told=told):
            code, out, err = run_here("replay", str(case2.path), *arguments)
            assert (code, out) == (2, "")
            assert told in err


def test_a_log_without_a_vehicle_is_bad_input(copy: FlightLog, tmp_path: Path, run_here: RunHere) -> None:
    copy.vehicles.clear()
    rewrite(copy, tmp_path / "empty.mcap", 0, lambda record: record.read(record.kind))
    code, _, err = run_here("replay", str(tmp_path / "empty.mcap"))
    assert code == 2
    assert "no vehicle's control loop was recorded" in err


def test_a_mission_that_is_refused_now_is_bad_input(case2: FlightLog, tmp_path: Path, run_here: RunHere) -> None:
    run = msgspec.structs.replace(case2.run, mission_text=case2.run.mission_text.replace("radius_m", "radios_m"))
    path = tmp_path / "refused.mcap"
    rewrite(case2, path, 0, lambda record: run if record.kind is Run else record.read(record.kind))
    code, _, err = run_here("replay", str(path))
    assert code == 2
    assert "its mission: encirclement.radios_m: unknown key; did you mean 'radius_m'?" in err


# Inputs as text

STATUS = VehicleStatus(connected=True, armed=True, mode=FlightMode.OFFBOARD, battery=0.5)
ITEMS: dict[CoreInput, tuple[str, ...]] = {
    TimeScale(10.0): ("10",),
    Start(100.0): ("0.000 s",),
    TacticEvent(Event.END): ("end",),
    AutopilotStatus(STATUS): ("autopilot", "connected", "armed", "on the ground", "offboard", "50%"),
    LateTicks(3): ("3 ticks",),
    Bus(alive=False): ("bus",),
    Bus(alive=True, revoked=("operator-bob",)): ("keys revoked", "operator-bob"),
    Drops(too_many=7, unknown_key=1): ("too many 7", "unknown key 1"),
    Computer("memory"): ("computer", "memory"),
    Ground("GPS: no fix"): ("on the ground", "GPS: no fix"),
    Ground(""): ("on the ground", "ready"),
    Telemetry(101.0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.5)): ("1.000 s", "(1.000, 2.000, 3.000) m", "0.500) m/s"),
    Sighting(101.0, 2, (1.0, 2.0), (0.25, 0.0, 0.04), 0.8, 0.2): ("(1.000, 2.000) m", "0.50 m", "importance 0.800"),
    Sighting(101.0, 2, (1.0, 2.0), (0.2, 0.0, 0.2), 0.8, 0.2, 7.5, 0.4): ("altitude 7.500 m", "0.40 m"),
    Message(
        101.0,
        MemberState(
            3,
            100.5,
            "encircle",
            (1.0, 2.0),
            (0.0, 0.0),
            (1.0, 2.0),
            (0.0, 0.0),
            angle=NeighbourAngle(3, 100.5, 1.0, 0.05, 10.0),
            sightings=(TargetPackage(3, 100.5, (5.0, 6.0), (1.0, 0.0, 1.0), 0.8, 0.2, ()),),
        ),
    ): ("vehicle 3", "0.500 s", "(1.00, 2.00) m", "1.000 rad", "(5.000, 6.000) m"),
    Message(101.0, StartProposal(3, 100.5, None)): ("vehicle 3", "start"),
    Message(101.0, CommandAnswer(3, 100.5, 7, "holds")): ("vehicle 3", "command 7", "holds"),
    Message(101.0, OperatorCommand(100.5, "hold", None, "ground", 7)): ("ground", "all vehicles", "hold"),
    Command(101.0, OperatorCommand(100.5, "land", 2, "ground", 7)): ("ground", "vehicle 2", "land", "command 7"),
    Command(101.0, OperatorCommand(100.5, "formation", None, "ground", 7, "wedge")): ("formation wedge",),
    Killed(101.0, "it flies on"): ("motors", "it flies on"),
    Rejoined(101.0, "its battery is at 3 %"): ("its battery is at 3 %",),
    VehicleJoins(4, AddedVehicle((0.0, -8.0), 8.0)): ("vehicle 4 would join", "(0.00, -8.00) m"),
    Presence(3, present=False): ("vehicle 3",),
    Lying(3, (1.0, 2.0)): ("vehicle 3", "(1.00, 2.00) m"),
    Tick(101.0): ("tick", "1.000 s"),
}


def test_every_input_has_a_text_with_its_values() -> None:
    for item, facts in ITEMS.items():
        text = item.describe(lambda time_s: f"{time_s - 100.0:.3f} s")
        assert all(fact in text for fact in facts), text


def test_no_kind_of_input_was_forgotten() -> None:
    assert {type(item) for item in ITEMS} == set(get_args(CoreInput))
