"""The mission `evader`: the target reacts to the team, and its path is recorded, as the mission does not state it."""

from pathlib import Path

import numpy as np
import pytest

import cordon
from estimation.state import Vector
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Decision, TargetTruth
from gcs.metrics.metrics import evaluated
from gcs.metrics.references import engagement_reference
from gcs.mission.file import MissionError, load_mission
from gcs.preflight.mission import encounter
from gcs.replay.cores import replay
from gcs.replay.what_if import changed_filters, what_if
from gcs.report.evidence.reading import read_flight
from tests.support.flight_logs import record_simulation
from tests.support.mission_text import content as case2
from tests.support.mission_text import drop, faults, parsed, put

pytestmark = pytest.mark.slow

MISSION = load_mission("evader")
TICKS = 1801


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("evader") / "flight.mcap"


@pytest.fixture(scope="module")
def flight(log: Path) -> cordon.Flight:
    return cordon.simulate(MISSION, seed=4, log=log)


def fled(teams_m: Vector, start_m: tuple[float, float]) -> Vector:
    """Return the path (T,) of the mission's target, complex, past a team (T, N) of complex positions."""
    speed, bound, reach, step = 1.5, 0.5, 25.0, 0.1
    place, velocity, wanted = complex(*start_m), 0j, 0j
    path = []
    for team in teams_m:
        change = wanted - velocity
        change *= min(1.0, bound * step / max(abs(change), 1e-30))
        place, velocity = place + (velocity + change / 2.0) * step, velocity + change
        away = place - team
        weight = np.clip(reach - np.abs(away), 0.0, None)
        wanted = 0j if not weight.any() else speed * np.sum(weight * away / np.abs(away)) / weight.max()
        wanted /= max(abs(wanted) / speed, 1.0)
        path.append(place)
    return np.array(path)


def test_its_path_is_that_of_the_law_about_the_true_team(flight: cordon.Flight) -> None:
    teams_m = np.stack([each.position_m @ (1.0, 1.0j) for each in flight.record.vehicles], axis=1)
    path_m = flight.record.target_position_m @ (1.0, 1.0j)
    np.testing.assert_allclose(path_m, fled(teams_m, (30.0, -8.0)), atol=1e-9)
    assert abs(path_m[-1] - path_m[0]) > 10.0
    speed_m_s = np.abs(np.diff(path_m)) * 10.0
    assert 1.45 < speed_m_s.max() <= 1.5 + 1e-9
    # It stops once they are around it, but for the vehicles' noise.
    assert speed_m_s[-100:].max() < 0.1


def test_its_velocity_is_that_along_the_path(flight: cordon.Flight) -> None:
    record = flight.record
    along_m = np.cumsum(record.target_velocity_m_s[:-1] + record.target_velocity_m_s[1:], axis=0) / 2.0 / 10.0
    np.testing.assert_allclose(record.target_position_m[1:], record.target_position_m[0] + along_m, atol=0.01)


def test_every_verdict_of_the_ring_holds_with_margin(flight: cordon.Flight) -> None:
    result = flight.metrics
    assert (result.verdicts.c1, result.verdicts.c2, result.verdicts.c3) == (True, True, True)
    assert result.verdicts.separation is True
    assert all((each.radius_error_rms_m or 1.0) < 0.12 for each in result.vehicles)
    assert (result.ring.settling_time_s or 60.0) < 40.0


def test_a_vehicle_engages_by_what_it_sees_as_no_plan_knows_where_the_target_is() -> None:
    far = MISSION.replace(target={"start_m": [300.0, 0.0]})
    assert engagement_reference(MISSION).planned == engagement_reference(far).planned == (1, 2, 3)
    assert [finding.check for finding in encounter(MISSION)] == ["sensor range"]
    assert MISSION.target.speed_max_m_s == 1.5


# The log


def test_its_log_reports_what_the_simulation_did(flight: cordon.Flight, log: Path) -> None:
    read = cordon.read(log)
    np.testing.assert_array_equal(read.record.target_position_m, flight.record.target_position_m)
    np.testing.assert_array_equal(read.record.target_velocity_m_s, flight.record.target_velocity_m_s)
    assert read.record.reference == "truth"
    assert read.metrics.untimed() == flight.metrics.untimed()


def test_its_log_replays_bit_for_bit(flight: cordon.Flight, log: Path) -> None:
    assert flight.metrics is not None
    for vehicle in replay(read_log(log)).vehicles:
        assert (vehicle.identical, vehicle.compared, vehicle.difference) == (TICKS, TICKS, None)


def test_filters_are_compared_with_the_path_as_flown(flight: cordon.Flight, log: Path) -> None:
    read = read_log(log)
    found = what_if(read, MISSION, changed_filters(MISSION, ("target_filter.gate_sigma=3.9",)))
    path_m = dict(zip(flight.record.time_s.tolist(), flight.record.target_position_m, strict=True))
    for outcome in found.outcomes:
        seen = [each for each in read.of_kind(outcome.vehicle_id, Decision) if each.target is not None]
        off_m = [np.array(each.target.mean[:2]) - path_m[each.time_s] for each in seen if each.target]
        assert outcome.recorded.error_m == pytest.approx(np.sqrt(np.mean(np.sum(np.square(off_m), axis=1))))


def test_without_the_whole_path_nothing_is_judged_by_truth(log: Path, flight: cordon.Flight) -> None:
    cut = read_log(log)
    times_s, _ = cut.target_path or (np.empty(0), np.empty(0))
    assert times_s.tolist() == flight.record.time_s.tolist()
    paths = [place for place, each in enumerate(cut.run_records) if each.kind is TargetTruth]
    for kept in (0, 300):
        part = read_log(log)
        lost = set(paths[kept:])
        part.run_records[:] = [each for place, each in enumerate(part.run_records) if place not in lost]
        record = read_flight([part]).evidence.record
        assert (record.reference, record.truth_missing) == ("estimate", "no ground truth of the target")
        unknown = np.isnan(record.target_position_m).all(axis=1)
        assert np.flatnonzero(unknown).tolist() == [*range(kept, TICKS)]


def test_equal_seeds_fly_equal_paths(tmp_path: Path) -> None:
    first, again, other = (
        record_simulation(MISSION, tmp_path / f"{k}.mcap", seed=s, duration_s=8.0) for k, s in enumerate((1, 1, 2))
    )
    np.testing.assert_array_equal(first.target_position_m, again.target_position_m)
    assert evaluated(MISSION, first).untimed() == evaluated(MISSION, again).untimed()
    assert np.abs(first.target_position_m - other.target_position_m).max() > 0.0


# What is refused


EVADES = {"speed_m_s": 1.5, "acceleration_m_s2": 0.5, "distance_m": 25.0}


def test_a_target_evades_in_place_of_any_other_motion(subtests: pytest.Subtests) -> None:
    at_rest = put(drop(case2(), ("target", "velocity_m_s")), ("target", "evades"), EVADES)
    assert parsed(at_rest).target.speed_max_m_s == 1.5
    wrong = [
        put(at_rest, ("target", "velocity_m_s"), [0.1, 0.0]),
        put(at_rest, ("target", "legs"), [{"to_m": [1.0, 2.0], "speed_m_s": 1.0}]),
        put(at_rest, ("target", "source"), "external"),
        *(put(at_rest, ("target", "evades", key), value) for key in EVADES for value in (0.0, -1.0, 1e5)),
        put(at_rest, ("target", "evades", "acceleration"), 1.0),
    ]
    for number, mission in enumerate(wrong):
        with subtests.test(number=number):
            assert [fault for fault in faults(mission) if fault.startswith("target")]


def test_a_target_that_is_too_fast_for_the_ring_is_refused() -> None:
    with pytest.raises(MissionError, match=r"4\.20 m/s, more than speed_max_m_s = 4\.0 m/s"):
        MISSION.replace(target={"evades": {"speed_m_s": 3.0}})
