"""The Lyapunov function against rings whose errors are known in closed form."""

from math import exp, log, tau

import numpy as np
import pytest

from estimation.state import Vector
from gcs.metrics.record import FlightRecord, LoopStatistics, VehicleTrack
from gcs.metrics.ring import ring_motion
from gcs.report.evidence.lyapunov import decays, lyapunov_rad2

TIME_S = np.arange(1201) / 10.0
GAMMA = 0.3


def ring(*phases_rad: Vector | float, joined_s: tuple[float, ...] = ()) -> FlightRecord:
    """Vehicles that turn about a target at rest, each ahead of 0.05 rad/s by its phase, from when it joined."""
    tracks = []
    for index, phase in enumerate(phases_rad):
        angle = 0.05 * TIME_S + phase
        place_m = 10.0 * np.column_stack((np.cos(angle), np.sin(angle)))
        joined = (joined_s[index] if joined_s else 0.0) - 1e-9 <= TIME_S
        tracks.append(
            VehicleTrack(index + 1, place_m, np.zeros_like(place_m), np.where(joined, "encircle", "formation"))
        )
    still = np.zeros((TIME_S.size, 2))
    loop = LoopStatistics(10.0, 0, 0)
    return FlightRecord("ring", 0, "simulation", "truth", TIME_S, still, still, tuple(tracks), loop, 1.0)


def closing(first_rad: float, second_rad: float, third_rad: float) -> FlightRecord:
    """Three vehicles whose phases are off an even ring by so much, each decaying at gamma."""
    fading = np.exp(-GAMMA * TIME_S)
    off = (first_rad, second_rad, third_rad)
    return ring(*(index * tau / 3 + each * fading for index, each in enumerate(off)))


def test_it_is_half_the_sum_of_the_squared_spacing_errors() -> None:
    value_rad2 = lyapunov_rad2(ring_motion(ring(0.1, tau / 3, 2 * tau / 3 - 0.2)))
    errors_rad = (-0.1, -0.2, 0.3)  # from each to the next in front
    assert value_rad2 == pytest.approx(np.full(TIME_S.size, 0.5 * sum(e**2 for e in errors_rad)))


def test_errors_that_decay_at_the_gain_keep_the_promise_exactly() -> None:
    flight = closing(0.2, 0.0, -0.1)
    motion = ring_motion(flight)
    (stretch,) = decays(TIME_S, motion, GAMMA)
    assert (stretch.members, stretch.start_s, stretch.end_s) == (3, 0.0, 120.0)
    assert stretch.decay_per_s == pytest.approx(2.0 * GAMMA)
    assert stretch.expected_rad2(TIME_S) == pytest.approx(lyapunov_rad2(motion), rel=1e-6, abs=1e-18)
    assert stretch.expected_after_s == pytest.approx(log(100.0) / (2.0 * GAMMA))
    assert stretch.decayed_after_s == pytest.approx(log(100.0) / (2.0 * GAMMA), abs=0.1)


def test_it_starts_anew_when_a_vehicle_joins() -> None:
    flight = ring(0.0, 2.5, 5.0, joined_s=(0.0, 20.0, 60.0))
    pair, three = decays(TIME_S, ring_motion(flight), GAMMA)
    assert [(each.members, each.start_s, each.end_s) for each in (pair, three)] == [(2, 20.0, 59.9), (3, 60.0, 120.0)]
    assert pair.start_rad2 == pytest.approx((tau / 2 - 2.5) ** 2)
    assert three.start_rad2 == pytest.approx(
        0.5 * ((2.5 - tau / 3) ** 2 + (2.5 - tau / 3) ** 2 + (tau - 5.0 - tau / 3) ** 2)
    )
    assert pair.decayed_after_s is None
    assert np.isnan(three.expected_rad2(np.array([59.0])))
    assert three.expected_rad2(np.array([61.0])) == pytest.approx(three.start_rad2 * exp(-0.6))


def test_a_member_that_is_not_heard_leaves_a_gap_but_not_the_ring() -> None:
    flight = closing(0.2, 0.0, 0.0)
    lost = flight.vehicles[1]
    lost.position_m[500:520] = np.nan
    lost.tactic[500:520] = "unknown"
    motion = ring_motion(flight)
    value_rad2 = lyapunov_rad2(motion)
    assert np.isnan(value_rad2[500:520]).all()
    assert np.isfinite(np.delete(value_rad2, np.s_[500:520])).all()
    assert len(decays(TIME_S, motion, GAMMA)) == 1


@pytest.mark.parametrize("flight", [ring(0.0), ring(0.0, 2.5, joined_s=(1000.0, 1000.0))])
def test_fewer_than_two_have_nothing_to_space(flight: FlightRecord) -> None:
    motion = ring_motion(flight)
    assert np.isnan(lyapunov_rad2(motion)).all()
    assert decays(TIME_S, motion, GAMMA) == ()
