"""Transitions of the ring, from flights whose motion is given in closed form."""

from collections.abc import Callable

import numpy as np
import pytest

from estimation.state import Vector
from gcs.metrics.record import FlightRecord, LoopStatistics, VehicleTrack
from gcs.metrics.references import DesiredRing
from gcs.metrics.ring import ring_motion
from gcs.metrics.transitions import TransitionResult, transitions

TIME_S = np.arange(0.0, 80.0, 0.1)
RING = DesiredRing(10.0, 0.05)
ENGAGES_S = 20.0
DRIFT_M_S = np.array([0.1, -0.05])


def flown(error_rad: Callable[[Vector], Vector], direction: float = 1.0) -> TransitionResult:
    """Fly two vehicles about a target that moves: the second joins at 20 s, with an error of the spacing over time."""
    since_s = np.maximum(TIME_S - ENGAGES_S, 0.0)
    half_rad = np.where(TIME_S < ENGAGES_S, error_rad(np.zeros(1))[0], error_rad(since_s)) / 2.0
    turned = direction * 0.05 * TIME_S
    target_m = DRIFT_M_S * TIME_S[:, None]
    tracks = []
    for vehicle_id, bearing in ((1, turned - half_rad), (2, turned + np.pi + half_rad)):
        about_m = 10.0 * np.column_stack([np.cos(bearing), np.sin(bearing)])
        velocity_m_s = np.gradient(about_m, TIME_S, axis=0) + DRIFT_M_S
        tactic = np.where((TIME_S >= ENGAGES_S) | (vehicle_id == 1), "encircle", "formation")
        tracks.append(VehicleTrack(vehicle_id, target_m + about_m, velocity_m_s, tactic))
    record = FlightRecord(
        "ring",
        0,
        "simulation",
        "truth",
        TIME_S,
        target_m,
        np.tile(DRIFT_M_S, (TIME_S.size, 1)),
        tuple(tracks),
        LoopStatistics(10.0, 0, 0),
        1.0,
    )
    ring = DesiredRing(10.0, direction * 0.05)
    first, second = transitions(record, ring_motion(record), ring, [0.0, ENGAGES_S])
    assert (first.members, first.spacing_overshoot_deg, first.spacing_monotonic) == (1, None, None)
    assert (second.begins_at_s, second.members) == (ENGAGES_S, 2)
    return second


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_spacing_that_decays_exponentially(direction: float) -> None:
    found = flown(lambda since_s: 0.4 * np.exp(-0.3 * since_s), direction)
    # By hand: 0.4 exp(-0.3 t) is 5 degrees after ln(0.4 / 0.0873) / 0.3 = 5.07 s.
    assert found.settling_time_s == pytest.approx(5.07, abs=0.11)
    fastest_rad_s = 0.05 + 0.4 / 2.0 * 0.3
    assert found.speed_max_m_s == pytest.approx(10.0 * fastest_rad_s, rel=0.03)
    assert found.forwards_min_m_s == pytest.approx(10.0 * (0.05 - 0.06), abs=0.03)
    assert found.spacing_overshoot_deg == pytest.approx(0.0, abs=1e-6)
    assert found.spacing_monotonic


def test_a_spacing_that_swings() -> None:
    found = flown(lambda since_s: 0.4 * np.exp(-0.1 * since_s) * np.cos(0.5 * since_s))
    # The first swing: the minimum of exp(-0.1 t) cos(0.5 t), where tan(0.5 t) = -0.2, at t = 5.888 s.
    assert found.spacing_overshoot_deg == pytest.approx(np.degrees(0.4 * np.exp(-0.5888) * 0.98058), rel=0.01)
    assert not found.spacing_monotonic


def test_a_vehicle_that_leaves_is_no_overshoot_of_those_that_stay() -> None:
    """Four at 0, 100, 190 and 280 degrees that do not move; the third leaves, and 120 degrees are wanted."""
    tracks = []
    for vehicle_id, bearing_deg in ((1, 0.0), (2, 100.0), (3, 190.0), (4, 280.0)):
        bearing_rad = np.radians(bearing_deg)
        place_m = np.tile(10.0 * np.array([np.cos(bearing_rad), np.sin(bearing_rad)]), (TIME_S.size, 1))
        tactic = np.where((TIME_S < 40.0) | (vehicle_id != 3), "encircle", "hold")
        tracks.append(VehicleTrack(vehicle_id, place_m, np.zeros_like(place_m), tactic))
    still = np.zeros((TIME_S.size, 2))
    loop = LoopStatistics(10.0, 0, 0)
    record = FlightRecord("ring", 0, "simulation", "truth", TIME_S, still, still, tuple(tracks), loop, 1.0)
    (found,) = transitions(record, ring_motion(record), RING, [0.0])
    assert found.spacing_overshoot_deg == 0.0


def test_the_acceleration_is_that_of_the_motion() -> None:
    found = flown(lambda since_s: 0.4 * (1.0 + 0.3 * since_s) * np.exp(-0.3 * since_s))
    # Its rate is -0.4 g² t exp(-g t), half of it each vehicle's: the change over the first 0.4 s is the largest.
    along_m_s2 = 10.0 * 0.4 / 2.0 * 0.3**2 * np.exp(-0.3 * 0.4)
    across_m_s2 = 10.0 * 0.05**2
    assert found.acceleration_max_m_s2 == pytest.approx(np.hypot(along_m_s2, across_m_s2), rel=0.08)
