"""Whether a plant still explains a flight: against flights whose plant is known, integrated in small steps."""

import re
from dataclasses import replace
from functools import cache
from math import hypot

import numpy as np
import pytest

from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.plant.watch import PlantComparison, PlantWatch, effect_delay_s, watch
from estimation.state import Vector
from gcs.console.advice import event_severity
from gcs.flightlog.reader import FlightLog, read_log
from gcs.metrics.record import FlightRecord, LoopStatistics
from gcs.metrics.result import PlantResult
from gcs.mission.file import load_mission
from gcs.replay.cores import replay
from gcs.report.evidence.criteria import plant_results
from gcs.report.evidence.flight import FlightEvidence, LoopTiming, VehicleEvidence
from gcs.report.evidence.reading import read_flight
from tests.support.flight_logs import record_simulation
from tests.support.mission_text import content, parsed
from tests.support.paths import MISSIONS

pytestmark = pytest.mark.slow

FILE = Plant(PlantAxis(1.7, 1.8), PlantAxis(1.7, 1.8), delay_s=0.2)
WIND = np.array([0.3, -0.2])
FINE_S = 0.005


@cache
def flown(
    a0: float, a1: float, delay_s: float, *, noise_m: float = 0.05, seconds: float = 150.0, step_m: float = 1.5
) -> tuple[Vector, Vector]:
    """Random steps at 20 Hz, and what a vehicle in the wind says of its place 20 times a second."""
    random = np.random.default_rng(11)
    time_s = np.arange(0.0, seconds, 0.05)
    levels = step_m * random.uniform(-1.0, 1.0, (int(seconds / 3.0) + 1, 2))
    setpoints = levels[(time_s / 3.0).astype(int)]
    place, speed, places = np.zeros(2), np.zeros(2), []
    for tick in range(len(time_s)):
        places.append(place)
        for k in range(round(0.05 / FINE_S)):
            acting = (time_s[tick] + k * FINE_S - delay_s) / 0.05
            wanted = setpoints[int(acting + 1e-9)] if acting >= 0.0 else np.zeros(2)
            speed = speed + FINE_S * (a0 * (wanted - place) - a1 * speed + WIND)
            place = place + FINE_S * speed
    noisy = np.array(places) + noise_m * random.normal(size=(len(places), 2))
    return np.column_stack([time_s, setpoints]), np.column_stack([time_s + 0.013, noisy])


@pytest.fixture(scope="module")
def explained() -> PlantComparison:
    """A flight of the plant that is in the file."""
    watched = watch(FILE, *flown(1.7, 1.8, 0.2))
    assert watched is not None
    return watched


def test_the_plant_that_flew_explains_its_flight(explained: PlantComparison) -> None:
    watched = explained
    # What lies between two samples, 13 ms after one of them, has less noise than either.
    left_m = 0.05 * hypot(0.013 / 0.05, 1.0 - 0.013 / 0.05)
    assert watched.unexplained_m == pytest.approx(left_m, rel=0.05), "only the noise is left"
    assert watched.best_m > 0.95 * watched.unexplained_m


@pytest.mark.parametrize(("a0", "a1", "delay_s"), [(1.0, 1.8, 0.2), (1.7, 1.1, 0.2), (1.7, 1.8, 0.4)])
def test_another_plant_is_noticed_and_named(a0: float, a1: float, delay_s: float) -> None:
    watched = watch(FILE, *flown(a0, a1, delay_s))
    assert watched is not None
    assert watched.best_m < 0.7 * watched.unexplained_m
    assert watched.best.x.a0_per_s2 == pytest.approx(a0, rel=0.15)
    assert watched.best.x.a1_per_s == pytest.approx(a1, rel=0.15)
    assert watched.best.delay_s == pytest.approx(delay_s, abs=0.05)


@pytest.mark.parametrize("delay_s", [0.04, 0.71])
def test_the_delay_from_a_setpoint_to_its_effect_is_found(delay_s: float) -> None:
    """Also where it is not that of the plant; the samples say where the vehicle was 13 ms before."""
    found_s = effect_delay_s(FILE, *flown(1.7, 1.8, delay_s))
    assert found_s == pytest.approx(delay_s + 0.013, abs=0.02)


def test_no_delay_is_found_where_nothing_was_asked_for() -> None:
    assert effect_delay_s(FILE, *flown(1.7, 1.8, 0.2, step_m=0.0)) is None


def noted(
    flight: tuple[Vector, Vector],
    trips_s: tuple[float, ...] = (),
    *,
    plant: Plant = FILE,
    velocity_m_s: Vector | None = None,
) -> PlantResult:
    """Return the note about a vehicle whose profile is a plant, over a link with these round trips."""
    mission = load_mission("px4-trio")
    mission = replace(mission, vehicles=(replace(mission.vehicles[0], plant=plant), *mission.vehicles[1:]))
    sent, samples = flight
    flat = ((0, 0), (0, 1))
    velocity_m_s = np.zeros((len(sent), 2)) if velocity_m_s is None else velocity_m_s
    loop = LoopTiming(time_s=sent[:, 0], setpoint_m=np.pad(sent[:, 1:], flat), velocity_m_s=np.pad(velocity_m_s, flat))
    vehicle = VehicleEvidence(1, loop=loop, samples=samples, round_trip_s=np.array(trips_s))
    empty = np.empty((0, 2))
    record = FlightRecord("x", 0, "sitl", "truth", np.empty(0), empty, empty, (), LoopStatistics(20.0, 0, 0), 1.0)
    (note,) = plant_results(mission, FlightEvidence(record, (vehicle, VehicleEvidence(2))))
    return note


@pytest.mark.parametrize("link_s", [0.0, 0.15])
def test_a_link_is_no_fault_of_the_plant(link_s: float) -> None:
    """A flight over a link whose round trip is known, and one whose is not measured."""
    note = noted(flown(1.7, 1.8, 0.2 + link_s), (0.14, 0.15, 0.16) if link_s else ())
    assert (note.id, note.profile, note.verdict) == (1, "px4", "valid")
    assert note.text.startswith("'px4' is valid for this flight: ")
    measured = "link's round trip 0.15 s (0.14 to 0.16)" if link_s else "link's round trip not measured"
    assert measured in note.latency
    found = re.search(r"setpoint to effect (\d\.\d\d) s", note.latency)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.213 + link_s, abs=0.02)


def test_an_effect_before_the_setpoint_can_arrive_is_not_reported() -> None:
    """A vehicle that is so much quicker than its profile that no delay explains its flight."""
    note = noted(flown(6.0, 4.5, 0.07), (0.14,))
    assert "setpoint to effect not measured, because the profile's plant is slower than the vehicle" in note.latency


@pytest.mark.parametrize(("gain", "told"), [(1.0, "is valid "), (0.0, "without velocity feed-forward)")])
def test_velocities_that_have_no_effect_are_noticed(gain: float, told: str) -> None:
    """A circle of 4 m at 0.2 rad/s: where a plant with feed-forward is, and one that leaves the velocities aside."""
    fed, time_s = Plant(FILE.x, FILE.y, 0.2, 1.0), np.arange(0.0, 120.0, 0.05)
    turn = 0.2 * time_s
    setpoints = 4.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    velocities = 0.8 * np.column_stack([-np.sin(turn), np.cos(turn)])
    axis, s = FILE.x, 0.2j
    answer = (axis.a0_per_s2 + gain * axis.a1_per_s * s) / (s**2 + axis.a1_per_s * s + axis.a0_per_s2)
    flown = 4.0 * answer * np.exp(1j * (turn - 0.2 * 0.2))
    noise = 0.05 * np.random.default_rng(5).normal(size=(time_s.size, 2))
    samples = np.column_stack([time_s, np.column_stack([flown.real, flown.imag]) + noise])
    note = noted((np.column_stack([time_s, setpoints]), samples), plant=fed, velocity_m_s=velocities)
    assert told in note.text
    assert note.verdict == ("softer" if gain == 0.0 else "valid")


CIRCLE_M, TURN_RAD_S = 10.0, 0.15


def told(
    plant: Plant, *, link_s: float = 0.0, gust_m_s2: float = 0.04, meanwhile: Plant | None = None
) -> tuple[float, str] | None:
    """Return when a watch in flight finds a difference on a ring in a gusty wind, and which; None if it does not.

    If `meanwhile` is given, the vehicle is that plant for 10 s.
    """
    random, step, other = np.random.default_rng(7), exact_step(plant, 0.05), exact_step(meanwhile or plant, 0.05)
    watched = PlantWatch(FILE)
    state, gust, queue = np.array([CIRCLE_M, 0.0, 0.0, CIRCLE_M * TURN_RAD_S]), np.zeros(2), list[Vector]()
    for tick in range(2400):
        time_s = tick * 0.05
        queue.append(CIRCLE_M * np.array([np.cos(TURN_RAD_S * time_s), np.sin(TURN_RAD_S * time_s)]))
        watched.sent(time_s + link_s, *queue[-1].tolist())
        if watched.found is not None and watched.found.difference is not None:
            return time_s, watched.found.difference
        gust = 0.98 * gust + gust_m_s2 * random.normal(size=2)
        late = round((plant.delay_s + link_s) / 0.05)
        now = other if 40.0 < time_s < 50.0 else step
        state = now.advance(state, queue[max(len(queue) - 1 - late, 0)], gust)
        seen = state[:2] + 0.05 * random.normal(size=2)
        watched.measured(time_s + 0.05, *seen.tolist())
    return None


def scaled(a0: float, a1: float, delay_s: float = FILE.delay_s) -> Plant:
    axis = PlantAxis(a0 * FILE.x.a0_per_s2, a1 * FILE.x.a1_per_s)
    return Plant(axis, axis, delay_s)


@pytest.mark.parametrize(
    ("plant", "difference"),
    [(scaled(2.5, 1.3), "stiffer"), (scaled(0.4, 0.7), "softer"), (scaled(1.0, 1.0, 0.8), "softer")],
)
def test_a_vehicle_that_is_not_its_profile_is_noticed_within_a_minute_on_a_ring(plant: Plant, difference: str) -> None:
    found = told(plant)
    assert found is not None
    assert found[0] < 60.0
    assert found[1] == difference


@pytest.mark.parametrize("near", [scaled(1.0, 1.0), scaled(0.9, 1.1), scaled(1.1, 0.9, 0.25), scaled(0.8, 0.9)])
def test_a_vehicle_that_is_its_profile_is_not(near: Plant) -> None:
    assert told(near) is None
    assert told(near, link_s=0.3) is None, "the link's delay is not the vehicle's"
    assert told(near, gust_m_s2=0.2) is None, "gusts hide the plant"


def test_a_vehicle_that_lags_for_one_window_is_not() -> None:
    """Where its speed or its acceleration is limited on the way to the ring."""
    assert told(FILE, meanwhile=scaled(0.1, 0.5)) is None


@pytest.mark.parametrize(("share", "difference"), [(4.0, "stiffer"), (0.6, "softer")])
def test_of_plants_with_the_same_lag_the_one_with_the_larger_a0_is_stiffer(share: float, difference: str) -> None:
    watched = watch(Plant(FILE.x, FILE.y, 0.0), *flown(share * 1.7, share * 1.8, 0.0, noise_m=0.02))
    assert watched is not None
    assert watched.difference == difference
    assert watched.best.x.a0_per_s2 / 1.7 == pytest.approx(watched.best.x.a1_per_s / 1.8), "the lag is the same"


def test_a_watch_begins_again_where_no_setpoints_were_sent() -> None:
    watched = PlantWatch(FILE)
    for tick in range(2400):
        watched.measured(tick * 0.05, 0.0, 0.0)
        # Steps of metres that no vehicle follows, but only for 9 s at a time: no window is complete.
        if tick % 200 < 180:
            watched.sent(tick * 0.05, 3.0 * (tick // 40 % 2), 0.0)
        else:
            watched.restart()
    assert watched.found is None


def test_a_flight_that_asks_little_tells_nothing() -> None:
    assert watch(FILE, *flown(1.7, 1.8, 0.2, step_m=0.0)) is None
    assert watch(FILE, *flown(1.0, 1.0, 0.2, seconds=40.0)) is None
    assert watch(FILE, np.empty((0, 3)), np.empty((0, 3))) is None


def test_where_the_vehicle_was_silent_nothing_is_compared(explained: PlantComparison) -> None:
    setpoints, samples = flown(1.7, 1.8, 0.2)
    silent = (samples[:, 0] > 42.0) & (samples[:, 0] < 48.0)
    cut = watch(FILE, setpoints, samples[~silent])
    assert cut is not None
    assert cut.windows < explained.windows
    assert cut.unexplained_m == pytest.approx(explained.unexplained_m, rel=0.1)


def test_setpoints_that_were_not_sent_do_no_harm(explained: PlantComparison) -> None:
    setpoints, samples = flown(1.7, 1.8, 0.2)
    unsent = np.column_stack([setpoints[-1, 0] + np.arange(1.0, 20.0), np.full((19, 2), np.nan)])
    assert watch(FILE, np.vstack([setpoints, unsent]), samples) == explained


@pytest.mark.parametrize(("stiffer", "verdict"), [(1.0, "valid"), (0.55, "softer"), (2.0, "stiffer")])
def test_the_report_says_when_to_identify_the_vehicle(stiffer: float, verdict: str) -> None:
    plant = load_mission("px4-trio").vehicles[0].plant
    note = noted(flown(stiffer * plant.x.a0_per_s2, plant.x.a1_per_s, plant.delay_s), plant=plant)
    assert (note.id, note.verdict) == (1, verdict)
    if verdict != "valid":
        told = f"{verdict} than its profile 'px4': identify it (cordon excite, cordon identify): residual 0."
        assert note.text.startswith(told)


SCALES = {1: {"a0": 2.8, "a1": 1.31}, 3: {"a0": 0.4, "a1": 0.9}}


@pytest.fixture(scope="module")
def unlike(tmp_path_factory: pytest.TempPathFactory) -> tuple[FlightRecord, FlightLog]:
    """A ring of three vehicles with the profile px4: a stiff hexarotor, a PX4 as in the profile, and a soft one."""
    mission = content((MISSIONS / "px4-trio.toml").read_text(encoding="utf-8"))
    for vehicle in mission["vehicles"]:
        vehicle["true_scale"] = SCALES.get(vehicle["id"], {})
    path = tmp_path_factory.mktemp("logs") / "unlike.mcap"
    return record_simulation(parsed(mission), path, seed=1, duration_s=80.0), read_log(path)


def test_vehicles_unlike_their_profile_are_told_in_flight_within_a_minute_of_engaging(
    unlike: tuple[FlightRecord, FlightLog],
) -> None:
    record, _ = unlike
    engaged_s = {each.vehicle: each.time_s for each in record.events if each.tactic and each.tactic.event == "engage"}
    alerts = {each.vehicle: each for each in record.events if each.alert is not None}
    assert {i: each.alert and each.alert.condition for i, each in alerts.items()} == {
        1: "stiffer than its profile",
        3: "softer than its profile",
    }
    assert all(each.time_s - engaged_s[i] < 60.0 for i, each in alerts.items())
    assert {event_severity(each) for each in alerts.values()} == {"warning"}
    assert {str(track.tactic[-1]) for track in record.vehicles} == {"encircle"}, "no vehicle leaves its mission for it"


def test_the_report_says_the_same_and_a_replay_decides_the_same(unlike: tuple[FlightRecord, FlightLog]) -> None:
    _, log = unlike
    flight = read_flight([log])
    found = plant_results(flight.mission, flight.evidence)
    assert {each.id: each.verdict for each in found} == {1: "stiffer", 2: "valid", 3: "softer"}
    again = replay(log)
    assert all(each.compared == each.identical > 0 for each in again.vehicles)
