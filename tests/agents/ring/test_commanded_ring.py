"""The ring that operators command in flight: the way to it, and which rings a vehicle refuses."""

from collections.abc import Callable
from itertools import pairwise
from math import inf, pi, sin

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from agents.ring.commanded_ring import ChangingRing, Orbit, ring_refusal
from agents.ring.reference import RingReference, RingWay
from agents.ring.transition import AccelerationBound, Mover
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from estimation.polar import Polar

Maker = Callable[..., AgentConfig]
STEP_S = 0.05
RADII_M, SPEEDS_M_S = st.floats(6.0, 30.0), st.floats(-2.0, 2.0)


def settings(radius_m: float, along_m_s: float) -> EncirclementSettings:
    return EncirclementSettings(radius_m=radius_m, angular_rate_rad_s=along_m_s / radius_m)


def way(ring: ChangingRing, longest_s: float = 200.0) -> list[Orbit]:
    """Return the rings on the way to the commanded one, the present one first."""
    orbits = [ring.orbit(1.0, 1.0)]
    while ring.changes and len(orbits) < longest_s / STEP_S:
        ring.advance(STEP_S)
        orbits.append(ring.orbit(1.0, 1.0))
    return orbits


@example(before=(6.0, 0.3), after=(30.0, 2.0))
@example(before=(6.0, 0.0), after=(7.0, 0.0))
@given(st.tuples(RADII_M, SPEEDS_M_S), st.tuples(RADII_M, SPEEDS_M_S))
def test_no_ring_on_the_way_is_harder_to_fly_than_both_ends(
    before: tuple[float, float], after: tuple[float, float]
) -> None:
    """By hand: v between the two speeds, v²/R at most the larger one, and both change within a transition's bounds."""
    ring = ChangingRing(settings(*before))
    ring.change(settings(*after))
    orbits = way(ring)
    assert (orbits[-1].radius_m, orbits[-1].angular_rate_rad_s) == (after[0], after[1] / after[0])
    assert orbits[-1].radius_rate_m_s == 0.0
    speeds_m_s = [each.angular_rate_rad_s * each.radius_m for each in orbits]
    low_m_s, high_m_s = sorted((before[1], after[1]))
    assert low_m_s - 1e-3 <= min(speeds_m_s) <= max(speeds_m_s) <= high_m_s + 1e-3
    inwards_m_s2 = max(speed**2 / radius for radius, speed in (before, after))
    bounds_m_s2 = 0.03 * min(max(after[0], 10.0), 20.0)  # of the ring's size, as docs/control.md states
    fastest_m_s = settings(*after).transition_speed_m_s
    for one, other in pairwise(orbits):
        assert other.angular_rate_rad_s**2 * other.radius_m <= inwards_m_s2 + 1e-3
        assert abs(other.radius_rate_m_s) <= fastest_m_s
        assert abs(other.radius_rate_m_s - one.radius_rate_m_s) <= bounds_m_s2 * STEP_S
        change_m_s = other.angular_rate_rad_s * other.radius_m - one.angular_rate_rad_s * one.radius_m
        assert abs(change_m_s) <= bounds_m_s2 * STEP_S


def test_a_reversal_passes_through_a_ring_at_rest_without_changing_its_radius() -> None:
    ring = ChangingRing(settings(10.0, 1.0))
    ring.change(settings(10.0, -1.0))
    orbits = way(ring)
    assert {each.radius_m for each in orbits} == {10.0}
    assert all(one.angular_rate_rad_s >= other.angular_rate_rad_s for one, other in pairwise(orbits))


@given(st.tuples(RADII_M, SPEEDS_M_S), st.tuples(RADII_M, SPEEDS_M_S), st.integers(1, 200))
def test_a_command_before_the_last_one_is_flown_continues_from_there(
    first: tuple[float, float], second: tuple[float, float], steps: int
) -> None:
    ring = ChangingRing(settings(10.0, 0.5))
    ring.change(settings(*first))
    for _ in range(steps):
        ring.advance(STEP_S)
    there = ring.orbit(1.0, 1.0)
    ring.change(settings(*second))
    orbits = way(ring)
    assert (orbits[0].radius_m, orbits[0].radius_rate_m_s) == (there.radius_m, there.radius_rate_m_s)
    assert orbits[-1].radius_m == second[0]


def test_a_reference_is_on_the_ring_while_that_changes(make_config: Maker) -> None:
    """One that followed the radius alone, at 0.5 1/s of the way that is left, would be 2 m behind a ring at 1 m/s."""
    before, after = settings(10.0, 1.0), settings(20.0, 1.0)
    ring, reference = ChangingRing(before), RingReference(make_config().with_ring(10.0, 0.1))
    mover, bound = Mover(0.0, 0.1, 0.04, 0.03), AccelerationBound(3.0, 0.6, 0.6)
    ring.change(after)
    reference.change(make_config().with_ring(20.0, 0.05))
    polar, time_s, off_m = Polar(10.0, 0.0, 0.0, 0.1), 0.0, [0.0]
    while ring.changes:
        orbit = ring.orbit(1.0, 1.0)
        point = reference.advance(polar, RingWay(orbit, orbit.radius_m, [mover], bound), time_s)
        polar = Polar(point.radius.value, point.bearing.value, point.radius.rate, point.bearing.rate)
        off_m.append(abs(point.radius.value - orbit.radius_m))
        ring.advance(STEP_S)
        time_s += STEP_S
    assert time_s > 8.0
    assert max(off_m) < 0.3


@given(st.tuples(RADII_M, SPEEDS_M_S), st.tuples(RADII_M, SPEEDS_M_S), st.floats(0.5, 60.0), st.integers(0, 100))
def test_after_a_pause_the_ring_is_where_it_would_be(
    before: tuple[float, float], after: tuple[float, float], pause_s: float, ticks: int
) -> None:
    paused, went_on = ChangingRing(settings(*before)), ChangingRing(settings(*before))
    for ring in (paused, went_on):
        ring.change(settings(*after))
        for _ in range(ticks):
            ring.advance(STEP_S)
    paused.advance(pause_s)
    for _ in range(round(pause_s / STEP_S)):
        went_on.advance(STEP_S)
    one, other = paused.orbit(1.0, 1.0), went_on.orbit(1.0, 1.0)
    assert one.radius_m == pytest.approx(other.radius_m, abs=0.5)
    assert one.angular_rate_rad_s * one.radius_m == pytest.approx(other.angular_rate_rad_s * other.radius_m, abs=0.2)


def test_a_vehicle_off_the_ring_has_the_commanded_one_at_once() -> None:
    ring = ChangingRing(settings(10.0, 0.5))
    ring.change(settings(20.0, -1.0))
    ring.arrive()
    assert not ring.changes
    orbit = ring.orbit(1.2, 0.5)
    assert (orbit.radius_m, orbit.angular_rate_rad_s, orbit.radius_rate_m_s) == (24.0, -0.025, 0.0)


TEAM = {
    "slots": (1, 2, 3),
    "safety": {"separation_m": 3.0, "keep_out_m": 2.0, "speed_max_m_s": 2.5, "acceleration_max_m_s2": 0.5},
    "encirclement": {"speed_max_m_s": 3.0, "acceleration_max_m_s2": 1.0, "yaw": "target"},
}


@pytest.mark.parametrize(
    ("radius_m", "rate_rad_s", "reach_m", "why"),
    [
        (10.0, 0.2, inf, ""),
        (10.0, -0.2, inf, ""),
        (1.8, 0.05, inf, "no room for the team"),  # three that are 3 m apart need 3/(2 sin 60°) = 1.73 m, but 2 m clear
        (2.5, 0.05, inf, ""),
        (61.0, 0.01, inf, "beyond its law's reach: less than 60 m"),
        (20.0, 0.13, inf, "at most 0.125 rad/s"),  # 2.5 m/s
        (10.0, 0.23, inf, "at most 0.224 rad/s"),  # 0.5 m/s² at 10 m
        (10.0, 0.2, 9.0, "leaves the fence: at most 9.0 m"),
        (10.0, 0.2, -4.0, "leaves the fence: at most 0.0 m"),
    ],
)
def test_a_ring_that_cannot_be_flown_is_refused_with_the_nearest(
    make_config: Maker, radius_m: float, rate_rad_s: float, reach_m: float, why: str
) -> None:
    config = make_config(vehicle_id=2, **TEAM).with_ring(radius_m, rate_rad_s)
    refusal = ring_refusal(config, reach_m)
    assert why in refusal
    assert bool(refusal) is bool(why)


def test_a_nose_that_cannot_follow_refuses_a_ring(make_config: Maker) -> None:
    safety = TEAM["safety"] | {"yaw_rate_max_deg_s": 10.0}  # type: ignore[operator]
    config = make_config(vehicle_id=2, **(TEAM | {"safety": safety})).with_ring(10.0, 0.2)
    assert "its nose cannot follow 0.2 rad/s: at most 10 degrees/s" in ring_refusal(config, inf)


def test_a_ring_has_room_for_the_whole_team(make_config: Maker) -> None:
    config = make_config(vehicle_id=2, **(TEAM | {"slots": tuple(range(1, 13))}))
    least_m = 3.0 / (2.0 * sin(pi / 12.0))
    assert f"more than {least_m:.1f} m" in ring_refusal(config.with_ring(least_m - 0.1, 0.05), inf)
    assert ring_refusal(config.with_ring(least_m + 0.1, 0.05), inf) == ""
