"""Filters with other parameters, against what was recorded and against the truth."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from agents.inputs import TacticEvent, Tick
from agents.tactics import Event
from estimation.filters.own import OwnFilter
from estimation.state import POSITION, Telemetry, Vector
from gcs.errors import InputError
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Decision, GuardResult, Truth
from gcs.flightlog.run import mission_of
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.replay.cores import replay
from gcs.replay.playback import Turn, config_of, turns
from gcs.replay.what_if import (
    EstimateTrack,
    Feed,
    FilterComparison,
    FilterRun,
    FilterSettings,
    changed_filters,
    rms_difference,
    what_if,
)
from tests.conftest import RunHere
from tests.support.flight_logs import engaging, record_simulation

SECONDS = 40.0
Flight = tuple[FlightLog, Mission]


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Noise of the telemetry as the filter is told, 0.1 m and 0.05 m/s; delays; lost messages; vehicles as planned."""
    path = tmp_path_factory.mktemp("logs") / "field.mcap"
    mission = engaging("case2-field")
    record_simulation(mission, path, seed=1, duration_s=SECONDS)
    return read_log(path), mission


@pytest.fixture(scope="module")
def turning(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """The same with a disturbance that turns with the vehicle on the ring, which slows down about a fast target."""
    path = tmp_path_factory.mktemp("logs") / "turning.mcap"
    fast = ("target", "velocity_m_s"), [2.45, 0.0]
    mission = engaging("case2-field", (("own_filter", "disturbance_turns"), True), fast)
    record_simulation(mission, path, seed=1, duration_s=20.0)
    return read_log(path), mission


@pytest.fixture(scope="module")
def wandering(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Positions that wander, and settings that follow them."""
    path = tmp_path_factory.mktemp("logs") / "wandering.mcap"
    mission = engaging("case2-wander")
    record_simulation(mission, path, seed=1, duration_s=SECONDS)
    return read_log(path), mission


def run(flight: Flight, *changes: str) -> FilterRun:
    log, mission = flight
    config = config_of(log, mission, 2)
    feed, filters = Feed(config), FilterRun(config, changed_filters(mission, changes)[2])
    for turn in turns(log, 2):
        assert isinstance(turn, Turn)
        filters.take(turn, list(feed.inputs(turn)))
    return filters


def outcomes(flight: Flight, *changes: str) -> dict[tuple[int, str], FilterComparison]:
    log, mission = flight
    told = what_if(log, mission, changed_filters(mission, changes))
    return {(each.vehicle_id, each.filter): each for each in told.outcomes}


def roughness_m(track: EstimateTrack) -> float:
    """Return the rms of how much the estimates turn from tick to tick."""
    motion = np.array(list(track._motion.values()))[:, POSITION]
    return float(np.sqrt(np.mean(np.sum(np.diff(motion, 2, axis=0) ** 2, axis=1))))


# Against the record


@pytest.mark.parametrize("flight", ["field", "turning", "wandering"])
def test_with_the_recorded_parameters_the_estimates_are_the_recorded_ones(
    flight: str, request: pytest.FixtureRequest
) -> None:
    flown: Flight = request.getfixturevalue(flight)
    filters = run(flown)
    recorded = list(flown[0].of_kind(2, Decision))
    own = {each.time_s: each.own.mean[:4] for each in recorded if each.own is not None}
    target = {each.time_s: each.target.mean for each in recorded if each.target is not None}
    assert len(own) > 190
    assert len(target) > 190
    assert {time_s: tuple(mean.tolist()) for time_s, mean in filters.own._motion.items()} == own
    assert {time_s: tuple(mean.tolist()) for time_s, mean in filters.targets[""]._motion.items()} == target


def test_a_disturbance_turns_no_more_once_the_vehicle_is_told_to_leave_the_ring(turning: Flight) -> None:
    """Told between two ticks, it has left the ring before the next samples."""
    log, mission = turning
    config = config_of(log, mission, 2)
    filters, own = FilterRun(config, changed_filters(mission, [])[2]), OwnFilter(config.plant, config.own_filter)
    recorded = next(each for each in log.of_kind(2, Decision) if each.tactic == "encircle")
    # It stands still though its setpoint is beside it: there is a disturbance.
    rate_rad_s = config.encirclement.angular_rate_rad_s
    word = GuardResult((0.3, 0.0), "passed", (), None)
    on_ring = msgspec.structs.replace(recorded, guard=word, turning_rad_s=rate_rad_s)
    holds = msgspec.structs.replace(on_ring, tactic="hold", turning_rad_s=0.0)
    samples = [Telemetry(i / 5.0, (0.0, 0.0, 8.0), (0.0, 0.0, 0.0)) for i in range(40)]
    told = TacticEvent(Event.HOLD)
    for sample in samples[:-2]:
        filters.take(Turn((sample, Tick(sample.time_s)), on_ring), [sample])
        own.measure(sample)
        own.turn_disturbance(rate_rad_s)
        own.command(sample.time_s, np.array([0.3, 0.0]))
    last, now_s = samples[-2:], samples[-1].time_s
    filters.take(Turn((told, *last, Tick(now_s)), holds), [told, *last])
    own.turn_disturbance(0.0)
    for sample in last:
        own.measure(sample)
    expected = own.estimate(now_s)
    assert expected is not None
    assert filters.own._motion[now_s].tolist() == expected.mean[:4].tolist()


@pytest.fixture(scope="module")
def two_targets(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    path = tmp_path_factory.mktemp("logs") / "two-targets.mcap"
    mission = load_mission("two-targets")
    record_simulation(mission, path, seed=1, duration_s=30.0)
    return read_log(path), mission


def test_each_of_several_targets_has_a_filter_whose_estimates_are_the_recorded_ones(two_targets: Flight) -> None:
    log, mission = two_targets
    filters = run(two_targets)
    names = [mission.targets[ring.target].name for ring in mission.rings]
    recorded = [each for each in log.of_kind(2, Decision) if each.target is not None]
    assert len(recorded) > 190
    for each in recorded:
        assert each.target is not None
        assert tuple(filters.targets[names[each.ring]]._motion[each.time_s].tolist()) == each.target.mean


# Against the truth


def test_errors_are_those_against_the_truth(field: Flight) -> None:
    log, mission = field
    found = outcomes(field, "own_filter.gate_sigma=4.9", "target_filter.gate_sigma=3.9")
    decisions = [each for each in log.of_kind(2, Decision) if each.own is not None]
    truth = {each.time_s: np.array(each.position_m[:2]) for each in log.of_kind(2, Truth)}
    own = [np.array(each.own.mean[:2]) - truth[each.time_s] for each in decisions if each.own]
    assert found[2, "own"].recorded.error_m == pytest.approx(rms(own))
    motion = mission.target.motion
    target = [np.array(e.target.mean[:2]) - motion.position_m(e.time_s) for e in decisions if e.target]
    assert found[2, "target"].recorded.error_m == pytest.approx(rms(target))


def test_errors_of_several_targets_are_those_against_the_truth_of_each(two_targets: Flight) -> None:
    log, mission = two_targets
    told = what_if(log, mission, changed_filters(mission, ["target_filter.acceleration_noise_m_s2=2.0"]))
    assert told.gaps == ()
    assert [(each.vehicle_id, each.filter, each.target) for each in told.outcomes] == [
        (i, "target", name) for i in mission.ids for name in ("north", "south")
    ]
    tracks, motions = run(two_targets).targets, {each.name: each.motion for each in mission.targets}
    for outcome in told.outcomes[2:4]:
        assert outcome.target is not None
        off = [
            mean[:2] - motions[outcome.target].position_m(time_s)
            for time_s, mean in tracks[outcome.target]._motion.items()
        ]
        assert outcome.recorded.error_m == pytest.approx(rms(off))
        assert outcome.recorded.error_m is not None
        assert outcome.recorded.error_m < 0.1
        assert outcome.tried.error_m is not None
        assert outcome.tried.error_m > outcome.recorded.error_m
        assert outcome.recorded.measurements > 500, "five vehicles see it five times a second"


def test_sightings_that_name_no_target_are_reported(tmp_path: Path, run_here: RunHere) -> None:
    mission = load_mission(
        "two-targets", {"target.sensor.names": False, "vehicles[0].sensor": {"names": True}, "mission.duration_s": 30.0}
    )
    record_simulation(mission, tmp_path / "log.mcap", duration_s=2.0)
    code, out, err = run_here("replay", str(tmp_path / "log.mcap"), "--set", "target_filter.coast_s=3.0", "--json")
    assert code == 0
    assert json.loads(out)["what_if"]["gaps"] == [f"vehicle {i}: sightings that name no target" for i in mission.ids]
    assert "target north" in err


def rms(off: list[Vector]) -> float:
    return float(np.sqrt(np.mean(np.sum(np.array(off) ** 2, axis=1))))


def test_the_noise_that_is_there_makes_innovations_as_large_as_expected(field: Flight) -> None:
    """The simulation's noise is the filter's: 1 is expected; with a fifth of it, up to 25 times as much."""
    found = outcomes(field, "own_filter.position_noise_m=0.02", "own_filter.velocity_noise_m_s=0.01")
    for vehicle_id in (1, 2, 3):
        outcome = found[vehicle_id, "own"]
        assert outcome.recorded.nis == pytest.approx(1.0, abs=0.15)
        assert outcome.tried.nis is not None
        assert outcome.tried.nis > 3.0
        assert outcome.tried.error_m is not None
        assert outcome.recorded.error_m is not None
        assert outcome.tried.error_m > outcome.recorded.error_m
    found = outcomes(field, "target_filter.acceleration_noise_m_s2=1.0")
    for vehicle_id in (1, 2, 3):
        assert found[vehicle_id, "target"].recorded.nis == pytest.approx(1.0, abs=0.15)


def test_who_expects_more_noise_estimates_more_smoothly(field: Flight) -> None:
    recorded, tried = run(field), run(field, "own_filter.position_noise_m=1.0", "own_filter.velocity_noise_m_s=1.0")
    assert roughness_m(tried.own) < 0.7 * roughness_m(recorded.own)
    assert roughness_m(tried.targets[""]) == roughness_m(recorded.targets[""]), "it was not touched"


def test_a_narrow_gate_refuses_more(field: Flight) -> None:
    """With m = 4 and a gate of 1.01 sigma, chi^2(4) > 4 * 1.02: two in five."""
    outcome = outcomes(field, "own_filter.gate_sigma=1.01", "own_filter.gate_timeout_s=60.0")[2, "own"]
    assert outcome.recorded.refused == 0.0
    assert outcome.tried.refused is not None
    assert 0.2 < outcome.tried.refused < 0.6
    assert outcome.difference_m is not None
    assert outcome.difference_m > 0.0


def test_a_value_is_tried_on_vehicles_that_flew_with_different_ones(tmp_path: Path) -> None:
    mission = load_mission("mixed-team")
    record_simulation(mission, tmp_path / "log.mcap", duration_s=10.0)
    log = read_log(tmp_path / "log.mcap")
    assert [plant.name for plant in log.run.plants] == ["ardupilot", "px4"]
    assert mission_of(log) == mission
    assert all(each.ticks == each.compared == each.identical > 0 for each in replay(log).vehicles)
    found = what_if(log, mission, changed_filters(mission, ["own_filter.velocity_noise_m_s=0.232"]))
    (change,) = found.changes
    assert change.key == "own_filter.velocity_noise_m_s"
    assert (change.recorded, change.tried) == ({1: 0.232, 2: 0.02, 3: 0.232}, 0.232)
    differences_m = {each.vehicle_id: each.difference_m for each in found.outcomes}
    assert (differences_m[1], differences_m[3]) == (0.0, 0.0)
    assert differences_m[2] != 0.0


# Small parts


def test_innovations_are_normalised_by_what_was_expected_of_them() -> None:
    track = EstimateTrack()
    track.add_measurement(True, (np.array([3.0, 4.0, 0.0, 0.0]), np.diag([9.0, 4.0, 1.0, 1.0])))
    track.add_measurement(False, (np.array([100.0, 0.0]), np.eye(2)))
    track.add_measurement(True, None)
    figures = track.figures(None)
    assert (figures.measurements, figures.nis, figures.prediction_m) == (3, (1.0 + 4.0) / 4.0, 5.0)
    assert figures.refused == pytest.approx(1.0 / 3.0)
    assert figures.error_m is None


def test_tracks_are_compared_where_both_know() -> None:
    one, other = EstimateTrack(), EstimateTrack()
    for time_s in (0.0, 1.0, 2.0):
        one.add(time_s, np.array([time_s, 0.0, 0.0, 0.0]))
    other.add(1.0, np.array([4.0, 4.0, 0.0, 0.0]))
    other.add(3.0, np.array([9.0, 9.0, 0.0, 0.0]))
    assert rms_difference(one, other, POSITION) == 5.0
    assert rms_difference(one, EstimateTrack(), POSITION) is None
    assert EstimateTrack().figures(None).nis is None


def test_values_are_those_of_a_mission_file(field: Flight) -> None:
    mission = field[1]
    tried = changed_filters(mission, ["own_filter.disturbance_turns=true", "target_filter.late_max_s = 2"])
    assert list(tried) == list(mission.ids)
    for vehicle in mission.vehicles:
        assert tried[vehicle.id].own_filter == vehicle.own_filter.model_copy(update={"disturbance_turns": True})
        assert tried[vehicle.id].target_filter == mission.target_filter.model_copy(update={"late_max_s": 2.0})
        unchanged = changed_filters(mission, [])[vehicle.id]
        assert unchanged == FilterSettings(vehicle.own_filter, mission.target_filter)
    with pytest.raises(InputError, match="disturbance_turns"):
        changed_filters(mission, ["own_filter.disturbance_turns=3"])


def test_the_comparison_is_shown_and_is_json(field: Flight, run_here: RunHere) -> None:
    code, out, err = run_here("replay", str(field[0].path), "--set", "own_filter.position_noise_m=0.5", "--json")
    result = json.loads(out)["what_if"]
    assert code == 0
    assert result["changes"] == {"own_filter.position_noise_m": {"recorded": 0.1, "tried": 0.5}}
    assert [(each["vehicle_id"], each["filter"]) for each in result["filters"]] == [(i, "own") for i in (1, 2, 3)]
    assert "own_filter.position_noise_m: 0.1 -> 0.5" in err
    assert f"{result['filters'][0]['tried']['nis']:.3f}" in err
