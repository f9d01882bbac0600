"""A simulator's truth from the fields of its message, and what a sensor makes of it."""

import json
import tracemalloc
from math import hypot, radians
from types import SimpleNamespace
from typing import Any

import pytest

from agents.ports import TargetSensor
from estimation.frames import Geodetic, MissionFrame
from estimation.state import Sighting, Telemetry
from gcs.autopilots import ardupilot, px4
from gcs.autopilots.autopilot import TruthMessage
from gcs.flight.team import TrueSensor
from gcs.link.ground_truth import RATE_HZ, GroundTruth
from sitl.world import SensorModel, SimulatedSensor, SimulatedSensors, TargetMotion

FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(90.0))
SYSTEM = 4
# 1e-4 degrees of latitude are 11.12 m; x is east, y is north.
PX4_FIELDS = {"lat": 473978420, "lon": 85455940, "alt": 496000, "vx": 150, "vy": -20, "vz": 10}
ARDUPILOT_FIELDS = {
    "lat": 4.7e8, "lon": 8.5e7, "alt": 496.0, "vn": 1.5, "ve": -0.2, "vd": 0.1,
    "lat_int": 473978420, "lon_int": 85455940,
}  # fmt: skip


MOTIONS = 500


class Link:
    """Stands for MAVSDK's plugin for messages as such."""

    def __init__(self, message: TruthMessage) -> None:
        self.now_s = 50.0
        self.taken: list[Telemetry] = []
        self.truth = GroundTruth(SYSTEM, FRAME, lambda: self.now_s)
        self.truth.on_sample = self.taken.append
        self.truth.subscribe(self, message, lambda take: take)

    def subscribe_message(self, name: str, take: Any) -> None:
        self.name, self._take = name, take

    def receive(self, fields: str | dict[str, object], system_id: int = SYSTEM) -> None:
        text = fields if isinstance(fields, str) else json.dumps(fields)
        self._take(SimpleNamespace(system_id=system_id, fields_json=text))


def test_place_and_velocity_are_in_the_mission_frame(subtests: pytest.Subtests) -> None:
    for message, fields in ((px4.AUTOPILOT.truth, PX4_FIELDS), (ardupilot.AUTOPILOT.truth, ARDUPILOT_FIELDS)):
        with subtests.test(message.name):
            link = Link(message)
            link.receive(dict(fields))
            assert link.name == message.name
            (sample,) = link.taken
            assert link.truth.newest == sample
            assert sample.time_s == 50.0
            assert sample.position_m == pytest.approx((0.0, 11.12, 8.0), abs=0.01)
            assert sample.velocity_m_s == pytest.approx((-0.2, 1.5, -0.1))
            assert link.truth.position_m(51.0) == pytest.approx((-0.2, 12.62), abs=0.01)
            assert link.truth.position_m(52.1) is None


def test_nothing_is_collected_before_the_speed_of_the_clock_is_known() -> None:
    """At half the wall's speed the clock jumps back by half of all seconds since 1970 once that is measured."""
    link = Link(px4.AUTOPILOT.truth)
    link.truth.on_sample, link.now_s = None, 100.0
    link.receive(dict(PX4_FIELDS))
    link.truth.on_sample, link.now_s = link.taken.append, 50.0
    link.receive(dict(PX4_FIELDS))
    assert link.truth.track().time_s.tolist() == [50.0]


def test_the_track_has_each_true_motion_and_takes_a_fraction_of_their_memory() -> None:
    link = Link(px4.AUTOPILOT.truth)
    link.truth.on_sample = lambda _: None
    link.receive(dict(PX4_FIELDS))
    tracemalloc.start()
    for step in range(1, MOTIONS):
        link.now_s = 50.0 + step / RATE_HZ
        link.receive({**PX4_FIELDS, "vx": step})
    grown = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert grown < 80 * MOTIONS, f"{grown / MOTIONS:.0f} bytes for each motion of seven numbers"
    link.truth.on_sample = link.taken.append
    link.receive({**PX4_FIELDS, "vx": 7})
    track, (sample,) = link.truth.track(), link.taken
    assert track.vehicle_id == SYSTEM
    assert track.time_s.tolist() == [50.0 + step / RATE_HZ for step in range(MOTIONS)] + [link.now_s]
    assert (tuple(track.position_m[-1]), tuple(track.velocity_m_s[-1])) == (sample.position_m, sample.velocity_m_s)
    assert track.velocity_m_s[7].tolist() == track.velocity_m_s[-1].tolist() != track.velocity_m_s[8].tolist()


def test_a_place_that_is_exact_to_half_a_metre_only_is_no_truth() -> None:
    link = Link(ardupilot.AUTOPILOT.truth)
    link.receive({**ARDUPILOT_FIELDS, "lat": 47.397842, "lon": 8.545594, "lat_int": 0, "lon_int": 0})
    assert link.truth.newest is None


def test_what_is_malformed_or_another_vehicles_is_dropped(subtests: pytest.Subtests) -> None:
    lacking = {name: value for name, value in PX4_FIELDS.items() if name != "vx"}
    rows: tuple[tuple[str, str | dict[str, object], int], ...] = (
        ("another system", dict(PX4_FIELDS), SYSTEM + 1),
        ("no JSON", "{", SYSTEM),
        ("a field is missing", dict(lacking), SYSTEM),
        ("beyond the poles", {**PX4_FIELDS, "lat": 910000000}, SYSTEM),
        ("no number", json.dumps({**PX4_FIELDS, "vx": float("nan")}), SYSTEM),
    )
    for words, fields, system_id in rows:
        with subtests.test(words):
            link = Link(px4.AUTOPILOT.truth)
            link.receive(fields, system_id)
            assert link.truth.newest is None
            assert link.truth.position_m(50.0) is None


def sensor(range_m: float) -> TargetSensor:
    model = SensorModel(range_m, rate_hz=5.0, noise_m=0.0, importance=1.0, threat=0.0)
    return SimulatedSensor(1, model, TargetMotion((20.0, 0.0)), 0.0, 0)


def seen(sightings: tuple[Sighting, ...]) -> tuple[float, float] | None:
    return sightings[0].position_m if sightings else None


def test_a_sighting_from_the_truth_holds_the_error_of_the_estimate() -> None:
    """The vehicle is at (12, 1) and takes itself to be at (12.3, 0.6): it sees a target at (20, 0) relative to it."""
    from_truth = TrueSensor(sensor(30.0), lambda _: (12.0, 1.0), lambda _: (12.3, 0.6))
    place = seen(from_truth.sight(0.0, (12.3, 0.6)))
    assert place is not None
    assert place == pytest.approx((20.3, -0.4))
    assert hypot(place[0] - 12.3, place[1] - 0.6) == pytest.approx(hypot(20.0 - 12.0, 0.0 - 1.0))


def test_a_delayed_sighting_holds_the_error_of_its_own_time() -> None:
    model = SensorModel(30.0, rate_hz=5.0, noise_m=0.0, importance=1.0, threat=0.0, delay_s=0.4)
    delayed = SimulatedSensor(1, model, TargetMotion((20.0, 0.0)), 0.0, 0)
    wandering = TrueSensor(delayed, lambda _: (12.0, 0.0), lambda now_s: (12.0 + now_s, 0.0))
    seen_m = {}
    for tick in range(30):
        for sighting in wandering.sight(tick / 10.0, (12.0 + tick / 10.0, 0.0)):
            seen_m[sighting.time_s] = sighting.position_m[0] - 20.0
    assert len(seen_m) > 10
    assert seen_m == pytest.approx({time_s: time_s for time_s in seen_m})


def test_sightings_of_several_targets_hold_the_errors_of_their_own_times() -> None:
    sensors = [
        SimulatedSensor(1, SensorModel(30.0, 5.0, 0.0, 1.0, 0.0, delay_s=delay_s), TargetMotion((20.0, y)), 0.0, 0)
        for delay_s, y in ((0.0, 1.0), (0.4, 2.0), (3.0, 3.0))
    ]
    wandering = TrueSensor(SimulatedSensors(sensors), lambda _: (12.0, 0.0), lambda now_s: (12.0 + now_s, 0.0))
    seen_of: dict[float, list[tuple[float, float]]] = {1.0: [], 2.0: [], 3.0: []}
    for tick in range(300):
        for sighting in wandering.sight(tick / 10.0, (0.0, 0.0)):
            seen_of[sighting.position_m[1]].append((sighting.time_s, sighting.position_m[0] - 20.0))
    for seen_m in seen_of.values():
        assert len(seen_m) > 130
        assert [off_m for _, off_m in seen_m] == pytest.approx([time_s for time_s, _ in seen_m])


def test_the_range_of_a_sensor_counts_from_the_truth() -> None:
    for true_x_m, is_seen in ((11.0, True), (9.0, False)):
        from_truth = TrueSensor(sensor(10.0), lambda _, x=true_x_m: (x, 0.0), lambda _: (10.0, 0.0))  # type: ignore[misc]
        assert bool(from_truth.sight(0.0, (10.0, 0.0))) is is_seen


def test_without_the_truth_a_sensor_sees_from_the_estimate() -> None:
    for true_m, estimated_m in ((None, (12.3, 0.6)), ((12.0, 1.0), None)):
        plain = TrueSensor(sensor(30.0), lambda _, place=true_m: place, lambda _, place=estimated_m: place)  # type: ignore[misc]
        assert seen(plain.sight(0.0, (12.3, 0.6))) == (20.0, 0.0)
