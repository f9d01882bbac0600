"""References on a ring: their spacing against the modes of a ring in closed form, and within the bounds in between."""

from collections.abc import Callable, Sequence
from math import pi, sqrt, tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from agents.ring.commanded_ring import Orbit
from agents.ring.joining import Joining
from agents.ring.place import RingPlace, place_errors_rad
from agents.ring.reference import RingReference, RingWay
from agents.ring.transition import AccelerationBound, Mover, transition_of, transition_rate_rad_s
from agents.settings.config import AgentConfig
from estimation.polar import Polar
from estimation.state import Vector

Maker = Callable[..., AgentConfig]
STEP_S = 0.1
ORBIT = Orbit(10.0, 0.05)
IN_PLACE = [Mover(0.0, 0.1, 0.04, 0.03)]
GENTLE = AccelerationBound(3.0, 0.3, 0.3)


def turned(config: AgentConfig, bearings_rad: Sequence[float], duration_s: float, orbit: Orbit = ORBIT) -> Vector:
    """Let vehicles that are where their references are fly; each knows the others' of the tick before: (T, n, 2).

    Returns the bearings and rates of the references.
    """
    references, ids = [RingReference(config) for _ in bearings_rad], range(len(bearings_rad))
    joining = Joining(config)
    polars = [Polar(orbit.radius_m, bearing, 0.0, orbit.angular_rate_rad_s) for bearing in bearings_rad]
    way = RingWay(orbit, orbit.radius_m, IN_PLACE, GENTLE)
    points = [each.advance(polar, way, 0.0) for each, polar in zip(references, polars, strict=True)]
    track = []
    for tick in range(1, round(duration_s / STEP_S) + 1):
        now_s, before = tick * STEP_S, points
        points = []
        for own, (reference, last) in enumerate(zip(references, before, strict=True)):
            others = [each.place_rad(now_s) for each in (*before[:own], *before[own + 1 :])]
            polar = Polar(last.radius.value, last.place_rad(now_s), 0.0, last.bearing.rate)
            members = [own, *ids[:own], *ids[own + 1 :]]
            errors = place_errors_rad([reference.place_rad(polar, orbit, now_s), *others], members)
            movers = [joining.mover(each, orbit.radius_m, orbit) for each in errors]
            points.append(reference.advance(polar, RingWay(orbit, orbit.radius_m, movers, GENTLE), now_s))
        track.append([[each.bearing.value, each.bearing.rate] for each in points])
    return np.array(track)


def spacing_errors(bearings_rad: Vector) -> Vector:
    """The errors e (17) of the angles from each to the next in order (T, n)."""
    following = np.roll(bearings_rad, -1, axis=1)
    following[:, -1] += tau
    return np.asarray(following - bearings_rad - tau / bearings_rad.shape[1])


@pytest.mark.parametrize(
    ("bearings_rad", "rate_rad_s"),
    [((0.0, 0.4), 0.05), ((0.0, 0.35, 0.7), -0.15), ((0.0, 0.1, pi), 0.0), ((0.0, 0.4, 0.8, 1.2, 4.0), 0.05)],
)
def test_a_transition_keeps_its_bounds_and_no_spacing_overshoots(
    bearings_rad: tuple[float, ...], rate_rad_s: float, make_config: Maker
) -> None:
    config = make_config(encirclement={"spacing_speed_max_m_s": 0.8, "angular_rate_rad_s": rate_rad_s})
    orbit = Orbit(10.0, rate_rad_s)
    track = turned(config, bearings_rad, 90.0, orbit)
    errors, rates = spacing_errors(track[..., 0]), track[..., 1]
    direction = -1.0 if rate_rad_s < 0.0 else 1.0
    assert np.abs(errors[-1]).max() < np.radians(0.5)
    assert (direction * rates).max() <= abs(rate_rad_s) + 0.08 + 1e-9
    assert (direction * rates).min() >= (0.0 if rate_rad_s else -0.08 - 1e-9)
    assert np.abs(np.diff(rates, axis=0)).max() / STEP_S <= 0.03 + 1e-9
    began = np.sign(errors[0])
    assert np.degrees(-began * errors).max() < 2.0
    value = 0.5 * (errors**2).sum(axis=1)  # (18)
    moving = value > 0.5 * len(bearings_rad) * np.radians(0.1) ** 2
    assert np.diff(value)[moving[1:]].max() < 1e-9


@pytest.mark.parametrize(("given_m_s2", "bounds"), [(None, (0.3, 0.5)), (1.2, (1.2, 2.0)), (9.0, (2.0, 15.0))])
def test_a_given_acceleration_of_a_transition_replaces_that_of_the_radius(
    given_m_s2: float | None, bounds: tuple[float, float], make_config: Maker
) -> None:
    """Of a ring of 10 m, whose vehicles accelerate at 2 m/s2 at most."""
    keys = {} if given_m_s2 is None else {"spacing_acceleration_max_m_s2": given_m_s2}
    transition = transition_of(make_config(encirclement={"acceleration_max_m_s2": 2.0, **keys}).encirclement)
    assert (transition.acceleration_m_s2, transition.jerk_m_s3) == pytest.approx(bounds)


@pytest.mark.parametrize("members", [2, 3, 8])
def test_up_to_the_damped_gain_no_spacing_overshoots_and_beyond_it_one_does(members: int, make_config: Maker) -> None:
    """Of one vehicle that is off its place by sizes at which the jerk matters and the acceleration does not bound."""

    def overshoot(gain_per_s: float, off_rad: float) -> float:
        config = make_config(encirclement={"spacing_gain_per_s": gain_per_s})
        bearings_rad = [off_rad * members / (members - 1), *(tau * each / members for each in range(1, members))]
        errors = spacing_errors(turned(config, bearings_rad, 12.0)[..., 0])
        return float((-np.sign(errors[0]) * errors).max() / np.abs(errors[0]).max())

    damped_per_s = transition_of(make_config().encirclement).damped_gain_per_s
    slower, faster = ([overshoot(share * damped_per_s, off) for off in (0.02, 0.03, 0.045)] for share in (1.0, 2.0))
    assert max(slower) < 0.02
    assert max(faster) > 0.1


def test_without_a_bound_the_rate_is_that_of_the_paper() -> None:
    # (22) by hand: 0.05 + 0.3 / 3 (lead - lag), with lead - lag three times the error.
    for ring_rad_s in (0.05, -0.05, 0.0):
        movers = [Mover(error, 1.0, 1.0, 1.0) for error in (0.1, -0.06, -0.04)]
        assert transition_rate_rad_s(movers, ring_rad_s, 0.3) == pytest.approx(ring_rad_s + 0.1 * 0.3)
    assert transition_rate_rad_s(IN_PLACE * 2, 0.05, 0.3) == 0.05
    assert transition_rate_rad_s([Mover(0.5, 0.1, 0.04, 0.03)], 0.05, 0.0) == 0.05


bounds = st.floats(1e-3, 1.0)
movers_of_a_ring = st.builds(Mover, st.floats(-pi, pi), bounds, bounds, bounds)


@given(st.lists(movers_of_a_ring, min_size=1, max_size=12), st.floats(-0.3, 0.3), st.floats(0.01, 1.0))
def test_under_any_bounds_all_corrections_have_the_largest_share_that_they_allow(
    movers: list[Mover], ring_rad_s: float, gain_per_s: float
) -> None:
    """Against a linear programme: the largest share, and with it the smallest common rate."""
    rates = np.array(
        [transition_rate_rad_s(seen_by(movers, own), ring_rad_s, gain_per_s) for own in range(len(movers))]
    )
    direction = 1.0 if np.copysign(1.0, ring_rad_s) > 0.0 else -1.0
    errors = direction * np.array([each.error_rad for each in movers])
    ahead, back = (np.array([getattr(each, name) for each in movers]) for name in ("ahead_max_rad_s", "back_max_rad_s"))
    braked = np.array([sqrt(each.acceleration_max_rad_s2 * abs(each.error_rad)) for each in movers])
    wanted = gain_per_s * errors
    share, common = linear_programme(wanted, ahead, back, braked)
    forwards = direction * (rates - ring_rad_s)
    assert forwards == pytest.approx(share * wanted + common, abs=1e-6)
    assert (forwards <= ahead + 1e-9).all()
    assert (forwards >= -back - 1e-9).all()


def seen_by(movers: list[Mover], own: int) -> list[Mover]:
    return [movers[own], *movers[:own], *movers[own + 1 :]]


def linear_programme(wanted: Vector, ahead: Vector, back: Vector, braked: Vector) -> tuple[float, float]:
    """Return the largest share with which all rates `share * wanted + common` are in bounds, and the common rate.

    A correction can be `braked` within half of the acceleration, whatever the common rate.
    """
    one, none = np.ones_like(wanted), np.zeros_like(wanted)
    rows = [(wanted, one, none), (-wanted, -one, none), (wanted, none, none), (-wanted, none, none)]
    limits = np.concatenate([ahead, back, braked, braked])
    sizes = [(none[:1], one[:1], -one[:1]), (none[:1], -one[:1], -one[:1])]  # of the common rate, the third variable
    matrix = np.vstack([np.column_stack(row) for row in (*rows, *sizes)])
    limits = np.append(limits, [0.0, 0.0])
    within = [(0.0, 1.0), (None, None), (None, None)]
    first = linprog([-1.0, 0.0, 0.0], matrix, limits, bounds=[*within[:2], (0.0, None)], method="highs")
    least = [(first.x[0] - 1e-10, 1.0), *within[1:]]
    second = linprog([0.0, 0.0, 1.0], matrix, limits, bounds=least, method="highs")
    return float(first.x[0]), float(second.x[1])


@pytest.mark.parametrize("ring_rad_s", [0.08, -0.08])
@pytest.mark.parametrize("ahead_rad", [2.5, 0.5, 0.0, -0.5, -2.5])
@pytest.mark.parametrize("start_m", [50.0, 30.0, 16.0])
def test_on_its_way_in_a_reference_keeps_the_limits_of_the_vehicle(
    start_m: float, ahead_rad: float, ring_rad_s: float, make_config: Maker
) -> None:
    """A vehicle that is where its reference is flies to a place that moves with the ring, `ahead_rad` of its own."""
    config = make_config(encirclement={"angular_rate_rad_s": ring_rad_s}, safety={"separation_m": 3.0})
    settings, orbit = config.encirclement, Orbit(10.0, ring_rad_s)
    joining, reference, polar = Joining(config), RingReference(config), Polar(start_m, 0.0, 0.0, 0.0)
    wanted_rad = reference.place_rad(polar, orbit, 0.0) + ahead_rad
    track = []
    for tick in range(600):
        now_s = tick * STEP_S
        error_rad = wanted_rad + ring_rad_s * now_s - reference.place_rad(polar, orbit, now_s)
        radius_m = joining.radius_m(polar, RingPlace(1, None, None), error_rad)
        mover = joining.mover(error_rad, polar.radius_m, orbit)
        way = RingWay(orbit, radius_m, [mover], joining.acceleration)
        point = reference.advance(polar, way, now_s)
        radius, bearing = point.radius, point.bearing
        polar = Polar(radius.value, bearing.value + STEP_S * bearing.rate, radius.rate, bearing.rate)
        track.append((radius.value, radius.rate, bearing.rate, radius.acceleration, bearing.acceleration, error_rad))
    out_m, towards_m_s, turning_rad_s, radial_m_s2, angular_rad_s2, errors_rad = np.array(track).T
    assert np.hypot(towards_m_s, turning_rad_s * out_m).max() <= 1.1 * settings.speed_max_m_s
    assert np.hypot(radial_m_s2, angular_rad_s2 * out_m).max() <= 1.1 * settings.acceleration_max_m_s2
    assert (np.sign(ring_rad_s) * turning_rad_s[out_m <= 10.5]).min() >= 0.0
    assert out_m.min() >= 9.9
    assert np.degrees(np.sign(ahead_rad) * errors_rad).min() >= -5.0
    assert abs(errors_rad[-1]) * 10.0 <= 0.1
    assert out_m[-1] == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize("ring_rad_s", [-0.1, 0.15])
def test_a_vehicle_that_comes_in_meets_its_place_as_that_turns_with_the_ring(
    ring_rad_s: float, make_config: Maker
) -> None:
    """The others need not wait for it: once it is at speed, its place keeps the ring's rate, and it flies straight in.

    It starts 40 m from the target; the ring turns by more than half a radian until it arrives.
    """
    config = make_config(encirclement={"angular_rate_rad_s": ring_rad_s}, safety={"separation_m": 3.0})
    joining, reference, orbit = Joining(config), RingReference(config), Orbit(10.0, ring_rad_s)
    polar, track = Polar(40.0, 0.0, 0.0, 0.0), []
    for tick in range(400):
        way = RingWay(orbit, 10.0, [joining.mover(0.0, polar.radius_m, orbit)], joining.acceleration)
        point = reference.advance(polar, way, tick * STEP_S)
        bearing = point.bearing
        polar = Polar(point.radius.value, bearing.value + STEP_S * bearing.rate, point.radius.rate, bearing.rate)
        track.append((point.radius.value, bearing.value, point.place.value, point.place.rate))
    out_m, bearings_rad, places_rad, rates_rad_s = np.array(track).T
    coming, at_ring = (out_m < 35.0) & (out_m > 15.0), out_m < 14.5
    assert rates_rad_s[coming] == pytest.approx(ring_rad_s, rel=0.2)
    assert np.ptp(bearings_rad[coming & (out_m > 20.0)]) < 0.1
    assert np.ptp(places_rad[coming]) > 0.5
    assert bearings_rad[at_ring] == pytest.approx(places_rad[at_ring], abs=0.01)


@pytest.mark.parametrize(("error_rad", "reached_rad_s"), [(1.0, 0.07), (0.0, 0.05), (-1.0, 0.03)])
def test_a_reference_keeps_the_headway_on_either_side(
    error_rad: float, reached_rad_s: float, make_config: Maker
) -> None:
    reference = RingReference(make_config())
    point = reference.advance(Polar(10.0, 0.0, 0.0, 0.05), RingWay(ORBIT, 10.0, IN_PLACE, GENTLE), 0.0)
    way = RingWay(ORBIT, 10.0, [Mover(error_rad, 0.1, 0.04, 0.03)], GENTLE, (0.03, 0.07))
    for tick in range(1, 100):
        now_s = tick * STEP_S
        point = reference.advance(Polar(10.0, point.place_rad(now_s), 0.0, point.bearing.rate), way, now_s)
    assert point.bearing.rate == pytest.approx(reached_rad_s)


def test_a_reference_waits_for_a_vehicle_that_does_not_follow(make_config: Maker) -> None:
    config = make_config(encirclement={"reference_lead_max_m": 1.0})
    reference, stuck = RingReference(config), Polar(12.0, 1.0, 0.0, 0.0)
    way = RingWay(ORBIT, 10.0, IN_PLACE, GENTLE)
    for tick in range(300):
        point = reference.advance(stuck, way, tick * STEP_S)
        assert abs(point.radius.value - 12.0) <= 1.0 + 1e-9
        assert abs(point.bearing.value - 1.0) * 12.0 <= 1.0 + 1e-9
    assert point.bearing.value == pytest.approx(1.0 + 1.0 / 12.0)


def test_a_vehicle_that_the_guard_holds_up_does_not_hurry_after_its_reference(make_config: Maker) -> None:
    reference, slow = RingReference(make_config()), Polar(10.0, 1.0, 0.0, 0.0)
    for tick in range(50):
        point = reference.advance(slow, RingWay(ORBIT, 10.0, IN_PLACE, GENTLE, waits=True), tick * STEP_S)
        assert point.bearing.value == pytest.approx(1.0)
    assert point.bearing.rate == pytest.approx(0.05)


def test_while_it_leaves_the_formation_the_vehicles_own_motion_counts(make_config: Maker) -> None:
    reference = RingReference(make_config())
    polar = Polar(14.0, 3.1, -0.2, 0.01)
    for tick in range(20):
        point = reference.advance(polar, RingWay(ORBIT, 10.0, IN_PLACE, GENTLE, share=0.0), tick * STEP_S)
        assert (point.radius.value, point.bearing.value) == pytest.approx((14.0, 3.1))
        assert (point.radius.rate, point.bearing.rate) == pytest.approx((-0.2, 0.01))


@pytest.mark.parametrize("speed_m_s", [-3.0, 3.0])
def test_a_reference_that_arrives_too_fast_brakes_and_then_comes_to_rest(speed_m_s: float, make_config: Maker) -> None:
    # It brakes at the vehicle's acceleration, and must not keep that where only a transition's jerk could end it.
    reference = RingReference(make_config(encirclement={"reference_lead_max_m": 100.0}))
    way = RingWay(ORBIT, 10.0, IN_PLACE, GENTLE)
    point = reference.advance(Polar(11.0, 0.0, speed_m_s, 0.05), way, 0.0)
    for tick in range(1, 400):
        bearing_rad = point.bearing.value + STEP_S * point.bearing.rate
        polar = Polar(point.radius.value, bearing_rad, point.radius.rate, point.bearing.rate)
        point = reference.advance(polar, way, tick * STEP_S)
    assert point.radius.value == pytest.approx(10.0, abs=0.01)
    assert point.radius.rate == pytest.approx(0.0, abs=0.01)
