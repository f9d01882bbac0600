"""A flight read back from its logs is the flight that was flown: the same metrics, and what each vehicle believed."""

from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace

from agents.core import VehicleCore
from agents.inputs import AutopilotStatus
from agents.ports import VehicleStatus
from agents.recording import replay_input
from agents.team.codec import decode, encode
from agents.team.messages import MemberState
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog, LogRecord, read_log
from gcs.flightlog.records import Carried, Cost, Decision, RunEnd
from gcs.flightlog.run import mission_of
from gcs.metrics.journal import Journal, RunTotals
from gcs.metrics.metrics import evaluate
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import formation_reference, ring_reference, verdict_tolerances
from gcs.metrics.result import FlightResult
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.replay.playback import Turn, turns
from gcs.report.evidence.reading import LoggedFlight, read_flight
from tests.support.flight_logs import engaging, part, record_simulation, reencoded, rewrite

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[FlightRecord, Path]:
    path = tmp_path_factory.mktemp("logs") / "flight.mcap"
    return record_simulation(engaging(), path), path


@pytest.fixture(scope="module")
def whole(flown: tuple[FlightRecord, Path]) -> LoggedFlight:
    return read_flight([read_log(flown[1])])


@pytest.fixture(scope="module")
def alone(flown: tuple[FlightRecord, Path]) -> FlightRecord:
    """What the process of vehicle 2 has logged of the flight."""
    return read_flight([part(read_log(flown[1]), 2)]).evidence.record


def result(mission: Mission, record: FlightRecord) -> FlightResult:
    return evaluate(record, ring_reference(mission), formation_reference(mission), verdict_tolerances(mission))


def test_the_result_is_that_of_the_flight_to_the_last_digit(
    flown: tuple[FlightRecord, Path], whole: LoggedFlight
) -> None:
    record = flown[0]
    assert whole.evidence.record.seed == 3
    assert result(whole.mission, whole.evidence.record).to_json() == result(engaging(), record).to_json()
    assert any(vehicle.engaged_at_s is not None for vehicle in result(engaging(), record).vehicles)


def test_place_operators_wind_and_battery_of_a_flight_are_facts(
    flown: tuple[FlightRecord, Path], whole: LoggedFlight, tmp_path: Path
) -> None:
    facts = whole.evidence.facts
    assert facts["place"] == "47.397742, 8.545594, ground at 488 m; x points 90° from north"
    assert [facts[name] for name in ("operators", "wind")] == ["not recorded", "not reported"]
    statuses = iter([VehicleStatus(battery=0.7 - wind_m_s / 100.0, wind_m_s=wind_m_s) for wind_m_s in (4.0, 8.0, 5.0)])

    def reported(record: LogRecord) -> object:
        status = next(statuses, None) if record.kind is Cost else None
        return record.read(record.kind) if status is None else AutopilotStatus(status)

    windy = rewrite(read_log(flown[1]), tmp_path / "windy.mcap", 2, reported)
    windy.__dict__["run"] = structs.replace(windy.run, operator="anna.field")
    facts = read_flight([windy]).evidence.facts
    assert facts["battery at the end"] == "2: 65%"
    assert facts["wind"] == "5.0 m/s, up to 8.0 m/s, by the estimate of vehicle 2"
    assert facts["operators"] == "begun by anna.field"


def test_what_the_guard_did_and_why_is_in_the_log(tmp_path: Path) -> None:
    crossing, path = load_mission("crossing"), tmp_path / "crossing.mcap"
    record = record_simulation(crossing, path, duration_s=15.0)
    flight = read_flight([read_log(path)])
    assert result(flight.mission, flight.evidence.record).to_json() == result(crossing, record).to_json()
    guards = np.concatenate([vehicle.loop.guard for vehicle in flight.evidence.vehicles])
    assert record.guard is not None
    assert np.count_nonzero(guards != "passed") == record.guard.interventions > 0


def test_logs_of_several_processes_are_one_flight(flown: tuple[FlightRecord, Path]) -> None:
    record, path = flown
    log = read_log(path)
    flight = read_flight([part(log, 3), part(log, 1, 2)])
    merged, whole = result(flight.mission, flight.evidence.record), result(engaging(), record)
    assert merged.vehicles == whole.vehicles
    assert (merged.ring, merged.closest_approach_m, merged.loop.ticks) == (
        whole.ring,
        whole.closest_approach_m,
        whole.loop.ticks,
    )
    assert [each.vehicle_id for each in flight.evidence.vehicles] == [1, 2, 3]


def test_one_process_sees_its_peers_by_what_they_say(flown: tuple[FlightRecord, Path], alone: FlightRecord) -> None:
    record = flown[0]
    tracks = {track.vehicle_id: track for track in alone.vehicles}
    assert set(tracks) == {1, 2, 3}
    # Vehicle 2's truth is in the log; what it heard of vehicle 1 is within noise and delay of where that was.
    off_m = np.hypot(*(tracks[1].position_m - record.vehicles[0].position_m).T)
    assert np.nanmedian(off_m) < 0.15
    assert np.isfinite(off_m).mean() > 0.95


def test_peers_are_judged_about_the_target_that_they_publish_their_places_about(
    flown: tuple[FlightRecord, Path], whole: LoggedFlight, alone: FlightRecord
) -> None:
    record = flown[0]
    assert (whole.evidence.record.reference, alone.reference) == ("truth", "estimate")
    assert "vehicle 1" in alone.truth_missing
    apart = {track.vehicle_id: np.hypot(*alone.relative(track)[0].T) for track in alone.vehicles}
    joined = np.isfinite(apart[1]) & np.isfinite(apart[3])
    assert joined.sum() > 50
    for index, vehicle_id in enumerate((1, 2, 3)):
        true_m = np.hypot(*record.relative(record.vehicles[index])[0].T)
        assert np.abs(apart[vehicle_id] - true_m)[joined].mean() < 0.4  # of sightings with 0.5 m noise


def test_the_log_of_one_process_gives_the_tracks_that_its_flight_had(
    flown: tuple[FlightRecord, Path], alone: FlightRecord
) -> None:
    """Vehicle 2's core flies again from its log, beside a journal of the flight."""
    log = part(read_log(flown[1]), 2)
    mission = mission_of(log)
    core, journal = VehicleCore(mission.agent_config(mission.vehicle(2))), Journal(mission)
    for item in (item for turn in turns(log, 2) if isinstance(turn, Turn) for item in turn.inputs):
        output = replay_input(core, item)
        if output is not None:
            journal.note(output.status, 100.0)
    of_flight = journal.record(0.0, 40.0, RunTotals("flight", 401, 0, 1.0))
    assert [track.vehicle_id for track in of_flight.vehicles] == [1, 2, 3]
    for live, logged in zip(of_flight.vehicles, alone.vehicles, strict=True):
        np.testing.assert_array_equal(live.position_m, logged.position_m)
        np.testing.assert_array_equal(live.tactic, logged.tactic)
        assert live.target is not None
        assert np.isfinite(live.target).all(axis=1).mean() > 0.5
        np.testing.assert_array_equal(live.target, logged.target)


def test_what_peers_do_after_the_own_control_loop_has_ended_is_an_event(flown: tuple[FlightRecord, Path]) -> None:
    """Vehicle 2's loop ends after 10 s; vehicle 1 publishes from 20 s on that it lands."""

    def landing(record: LogRecord) -> LogRecord:
        if record.kind is not Carried:
            return record
        carried = record.read(Carried)
        message = decode(carried.payload)
        lands = isinstance(message, MemberState) and message.sender == 1 and message.time_s > 20.0
        return reencoded(record, replace(carried, payload=encode(replace(message, tactic="land")))) if lands else record

    log = part(read_log(flown[1]), 2)
    ended = [each for each in log.vehicles[2] if each.kind is not Cost or each.time_ns < 10e9]
    alone = FlightLog(log.path, [landing(each) for each in log.run_records], {2: ended})
    alone.__dict__["run"] = log.run
    record = read_flight([alone]).evidence.record
    (event,) = [each for each in record.events if each.vehicle == 1]
    assert event.kind == "tactic"
    assert event.text.endswith("land")
    assert event.time_s == pytest.approx(20.1, abs=0.3)


def test_beliefs_are_as_wrong_as_they_say(flown: tuple[FlightRecord, Path], whole: LoggedFlight) -> None:
    record = flown[0]
    for track, vehicle in zip(record.vehicles, whole.evidence.vehicles, strict=True):
        error_m = vehicle.own.motion[:, :2] - track.position_m
        sigmas = np.abs(error_m) / vehicle.own.sigma[:, :2]
        assert np.mean(sigmas < 3.0) > 0.9  # the plant file is 15 % off: not quite the 99.7 % of a perfect model
        assert vehicle.own.time_s == pytest.approx(record.time_s)
        sighted = np.isin(np.round(vehicle.target.time_s, 6), np.round(record.time_s, 6))
        assert sighted.all()
        at = np.searchsorted(record.time_s, vehicle.target.time_s - 1e-6)
        target_error_m = vehicle.target.motion[:, :2] - record.target_position_m[at]
        assert np.sqrt(np.mean(target_error_m**2)) < 0.5  # of sightings with 0.5 m noise


def test_what_was_heard_has_the_age_that_the_network_gives_it(
    flown: tuple[FlightRecord, Path], whole: LoggedFlight
) -> None:
    log = read_log(flown[1])
    sent = {
        i: sum(len(each.read(Decision).sent) for each in records if each.kind is Decision)
        for i, records in log.vehicles.items()
    }
    received = []
    for vehicle in whole.evidence.vehicles:
        assert vehicle.loop.tick_us.size == 401
        assert (vehicle.loop.tick_us > 0.0).all()
        assert set(vehicle.peers) == {1, 2, 3} - {vehicle.vehicle_id}
        for peer, reception in vehicle.peers.items():
            # Sent with 50 ms delay, taken in at the next tick of 100 ms; one in ten is lost.
            assert reception.age_s == pytest.approx(0.1, abs=1e-6)
            received.append(reception.received_s.size / sent[peer])
        assert vehicle.telemetry.age_s == pytest.approx(0.0, abs=1e-6)
    assert 0.87 < np.mean(received) < 0.93


def test_a_flight_that_did_not_live_to_say_its_end_is_as_long_as_its_last_tick(
    flown: tuple[FlightRecord, Path],
) -> None:
    _, path = flown
    whole = read_log(path)
    cut = FlightLog(
        path,
        [each for each in whole.run_records if each.kind is not RunEnd],
        {i: [each for each in records if each.time_ns < 25e9] for i, records in whole.vehicles.items()},
    )
    record = read_flight([cut]).evidence.record
    assert 24.5 < record.time_s[-1] < 25.0
    assert record.loop.ticks == 3 * 250


def test_a_mission_that_this_version_refuses_is_told_with_the_log_it_is_in(flown: tuple[FlightRecord, Path]) -> None:
    _, path = flown
    log = read_log(path)
    log.__dict__["run"] = replace(log.run, mission_text="radius = 1")
    with pytest.raises(LogError) as caught:
        read_flight([log])
    assert f"{path}: its mission: radius: unknown key" in str(caught.value.faults)


def test_logs_of_different_flights_are_not_mixed(flown: tuple[FlightRecord, Path], tmp_path: Path) -> None:
    _, path = flown
    other = tmp_path / "other.mcap"
    record_simulation(load_mission("case2"), other, duration_s=3.0)
    with pytest.raises(LogError, match="mission differs"):
        read_flight([part(read_log(path), 1), part(read_log(other), 2)])
    with pytest.raises(LogError, match="vehicle 2 is also in"):
        read_flight([part(read_log(path), 1, 2), part(read_log(path), 2, 3)])
