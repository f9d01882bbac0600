"""The pictures of a recorded flight against the records of its log, and what becomes of logs that hold none."""

from bisect import bisect_right
from itertools import pairwise
from math import dist, nan
from pathlib import Path

import msgspec
import pytest

from agents.inputs import Start
from agents.team.messages import AutopilotReport, RingValues
from estimation.state import Telemetry
from gcs.console.vehicle_view import VehicleView
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Decision
from gcs.mission.mission import Mission
from gcs.station.picture import FlightPicture
from gcs.station.recorded_flight import _VEHICLE_PICTURES, PICTURES_HZ, _with_ring, recorded_flight
from tests.support.flight_logs import engaging, record_simulation
from tests.support.mission_text import content, parsed
from tests.support.paths import DATA

pytestmark = pytest.mark.slow

FENCE = [[-60.0, -60.0], [160.0, -60.0], [160.0, 60.0], [-60.0, 60.0]]
DURATION_S = 40.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mission, Path]:
    mission = engaging("case2-field", (("safety", "fence_m"), FENCE))
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    record_simulation(mission, path, duration_s=DURATION_S)
    return mission, path


@pytest.fixture(scope="module")
def log(flown: tuple[Mission, Path]) -> FlightLog:
    return read_log(flown[1])


@pytest.fixture(scope="module")
def shown(log: FlightLog) -> FlightPicture:
    return recorded_flight(log)


def test_pictures_come_at_an_even_rate_from_the_start_to_the_end(shown: FlightPicture) -> None:
    assert (shown.mission.mission, shown.mission.source) == ("case2-field", "log")
    assert shown.mission.duration_s == DURATION_S
    times_s = [team.wall_s for team in shown.teams]
    assert [b - a for a, b in pairwise(times_s)] == pytest.approx([1.0 / PICTURES_HZ] * (len(times_s) - 1), abs=1.1e-3)
    assert shown.teams[0].time_s == pytest.approx(0.0, abs=0.2)
    assert shown.teams[-1].time_s == pytest.approx(DURATION_S, abs=0.41)
    assert shown.teams[100].remaining_s == pytest.approx(DURATION_S - (shown.teams[100].time_s or nan), abs=1e-3)
    assert [team.ending for team in shown.teams[:-1]] == [""] * (len(shown.teams) - 1)
    assert shown.teams[-1].ending == "Flown to the end of the simulation"
    assert all(each.has_ended for each in shown.teams[-1].vehicles)
    assert not any(each.has_ended or each.is_stale for each in shown.teams[-3].vehicles)


def test_every_vehicle_is_shown_by_its_newest_tick(shown: FlightPicture, log: FlightLog) -> None:
    start_s = min(each.at_s for i in log.run.vehicles for each in log.of_kind(i, Start))
    for column, vehicle_id in enumerate(log.run.vehicles):
        decisions = list(log.of_kind(vehicle_id, Decision))
        samples = list(log.of_kind(vehicle_id, Telemetry))
        ticks_s = [each.time_s for each in decisions]
        for team in shown.teams[5:-1]:
            assert team.time_s is not None
            now_s = start_s + team.time_s
            # Where a tick and a picture are at the same time, rounding decides.
            at = bisect_right(ticks_s, now_s + 1e-3) - 1
            fits = [
                fault_of(team.vehicles[column], each, samples, now_s) for each in decisions[max(at - 1, 0) : at + 1]
            ]
            assert "" in fits, (team.time_s, vehicle_id, fits)


def fault_of(vehicle: VehicleView, decision: Decision, samples: list[Telemetry], now_s: float) -> str:
    """Return what of a vehicle's picture is not as a tick decided it, empty if nothing."""
    own, setpoint, polar, place = decision.own, decision.setpoint, decision.polar, decision.place
    assert own is not None
    assert setpoint is not None
    assert vehicle.position_m is not None
    assert vehicle.setpoint_m is not None
    assert vehicle.velocity_m_s is not None
    altitudes_m = [each.position_m[2] for each in samples if abs(each.time_s - now_s) < 0.5]
    on_ring = place is not None and polar is not None
    facts = {
        "position": dist(vehicle.position_m[:2], own.mean[:2]) < 0.01,
        "velocity": dist(vehicle.velocity_m_s, own.mean[2:4]) < 0.01,
        "height": min(abs(vehicle.position_m[2] - each) for each in altitudes_m) < 0.01,
        "setpoint": dist(vehicle.setpoint_m, setpoint.position_m[:2]) < 0.01,
        "yaw": abs((vehicle.yaw_rad or 0.0) - setpoint.yaw_rad) < 1e-3,
        "tactic": vehicle.tactic == decision.tactic,
        "alert": vehicle.alert == decision.alert,
        "age": vehicle.age_s is not None and abs(now_s - decision.time_s - vehicle.age_s) < 0.01,
        "ring": on_ring == (vehicle.radius_m is not None),
    }
    if on_ring and polar is not None and place is not None:
        facts["radius"] = abs((vehicle.radius_m or 0.0) - polar.radius_m) < 0.01
        facts["rate"] = abs((vehicle.angular_rate_rad_s or 0.0) - polar.angular_rate_rad_s) < 1e-3
        facts["lead"] = abs((vehicle.lead_rad or 0.0) - (place.lead_rad or 0.0)) < 1e-3
    return ", ".join(name for name, holds in facts.items() if not holds)


def test_the_surroundings_are_those_of_the_picture_itself(shown: FlightPicture) -> None:
    for team in shown.teams[10:-1:20]:
        for vehicle in team.vehicles:
            assert vehicle.position_m is not None
            x, y, _ = vehicle.position_m
            others = {each.vehicle_id: each.position_m for each in team.vehicles if each is not vehicle}
            away_m = {i: dist((x, y), place_m[:2]) for i, place_m in others.items() if place_m is not None}
            assert vehicle.nearest_m == pytest.approx(min(away_m.values()), abs=0.011)
            assert vehicle.nearest_id is not None
            assert away_m[vehicle.nearest_id] == min(away_m.values())
            margin_m = min(x + 60.0, 160.0 - x, y + 60.0, 60.0 - y)
            assert vehicle.fence_margin_m == pytest.approx(margin_m, abs=0.011)
    assert shown.teams[-10].ring_members == 3


def test_the_target_is_where_the_newest_estimate_has_it(shown: FlightPicture, flown: tuple[Mission, Path]) -> None:
    seen = [team for team in shown.teams[:-1] if team.target is not None]
    assert len(seen) > 100
    for team in seen[50:]:
        assert team.target is not None
        assert team.time_s is not None
        target_m = flown[0].target.motion.position_m(team.time_s)
        assert dist(team.target.position_m, target_m) < 1.0, "what the noise of the sensors leaves"
        xx, xy, yy = team.target.covariance_m2
        assert xx * yy > xy**2
        assert 0.0 <= team.target.sighting_age_s < 2.0


def test_all_events_are_there_in_order(shown: FlightPicture, log: FlightLog) -> None:
    notes = [(each.text, i) for i in log.run.vehicles for tick in log.of_kind(i, Decision) for each in tick.notes]
    told = [(each.text, each.vehicle_id) for each in shown.events if not each.text.startswith("flight ended")]
    assert sorted(told) == sorted(notes)
    assert [each.number for each in shown.events] == list(range(1, len(shown.events) + 1))
    assert [each.wall_s for each in shown.events] == sorted(each.wall_s for each in shown.events)
    ended = [each for each in shown.events if each.text.startswith("flight ended")]
    assert [(each.vehicle_id, each.severity) for each in ended] == [
        (1, "information"),
        (2, "information"),
        (3, "information"),
    ]


def test_a_log_that_ends_in_flight_says_so(flown: tuple[Mission, Path], tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flown[1].read_bytes()[: flown[1].stat().st_size // 2])
    shown = recorded_flight(read_log(cut))
    assert shown.teams[-1].ending == "The log ends in flight: vehicles 1, 2 and 3"
    assert not any(each.has_ended for each in shown.teams[-1].vehicles)
    assert [each.is_unaccounted for each in shown.teams[-1].vehicles] == [True] * 3, "no record shows where they landed"
    assert not any(each.is_unaccounted for team in shown.teams[:-3] for each in team.vehicles)
    assert 0.0 < (shown.teams[-1].time_s or 0.0) < DURATION_S


def test_ten_minutes_of_three_vehicles_are_no_more_than_3_megabytes(log: FlightLog) -> None:
    share = DURATION_S / 600.0
    shown = recorded_flight(log, vehicle_pictures=round(share * _VEHICLE_PICTURES))
    widest = [
        msgspec.structs.replace(each, mode="offboard", autopilot=AutopilotReport(0.71, 1234.0, 3, 14), estimator="good")
        for team in shown.teams
        for each in team.vehicles
    ]
    more = len(msgspec.json.encode(widest)) - len(
        msgspec.json.encode([e for team in shown.teams for e in team.vehicles])
    )
    assert len(msgspec.json.encode(shown)) + more < 3e6 * share, "with what autopilots tell and simulations do not"
    assert shown.teams[1].wall_s - shown.teams[0].wall_s <= 0.5


def test_what_is_no_log_of_a_flight_is_refused(tmp_path: Path) -> None:
    for name in ("px4-quad.ulg", "px4-quad.csv"):
        with pytest.raises(LogError):
            recorded_flight(read_log(DATA / name))
    with pytest.raises(LogError):
        recorded_flight(read_log(tmp_path / "none.mcap"))


def test_a_log_without_a_tick_has_nothing_to_show(log: FlightLog) -> None:
    run_alone = FlightLog(log.path, log.run_records, {}, [])
    with pytest.raises(LogError, match="no tick"):
        recorded_flight(run_alone)


def test_a_flight_over_several_rings_shows_each_vehicles_ring_and_every_target(tmp_path: Path) -> None:
    """The boat moves at 0.1 m/s along x, the buoy is at rest; sensors are without noise."""
    told = content()
    target, ring = told.pop("target"), told.pop("encirclement")
    sensor = {"range_m": 60.0}
    boat = target | {"name": "boat", "start_m": [13.0, -5.0], "velocity_m_s": [0.1, 0.0], "sensor": sensor}
    buoy = target | {"name": "buoy", "start_m": [13.0, 25.0], "velocity_m_s": [0.0, 0.0], "sensor": sensor}
    told |= {"targets": [boat, buoy], "decision": told["decision"] | {"distance_max_m": 60.0}}
    south = ring | {"name": "south", "target": "buoy", "places": 2, "radius_m": 8.0}
    mission = parsed(told | {"rings": [ring | {"name": "north", "target": "boat", "places": 2}, south]})
    path = tmp_path / "rings.mcap"
    record_simulation(mission, path, duration_s=60.0)
    shown = recorded_flight(read_log(path))
    assert shown.mission.targets == ("boat", "buoy")
    last = shown.teams[-5]
    assert last.time_s is not None
    assert (last.target, last.ring) == (None, None)
    places_m = [(13.0 + 0.1 * last.time_s, -5.0), (13.0, 25.0)]
    assert isinstance(last.targets, tuple)
    assert [each.position_m for each in last.targets if each] == [pytest.approx(each, abs=0.05) for each in places_m]
    for each in last.vehicles:
        assert each.position_m is not None
        assert each.tactic == "encircle"
        number = ("north", "south").index(str(each.ring))
        assert dist(each.position_m[:2], places_m[number]) == pytest.approx((10.0, 8.0)[number], abs=0.3)
    assert {each.ring for each in last.vehicles} == {"north", "south"}
    assert [each.ring for each in shown.teams[0].vehicles] == [""] * 3
    commanded = _with_ring(last, 1, RingValues(9.0))
    assert commanded.rings == (None, RingValues(9.0))
    assert commanded.ring is None
