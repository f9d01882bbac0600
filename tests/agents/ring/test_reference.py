"""References on a ring: their spacing against the modes of a ring in closed form, and within the bounds in between."""

from collections.abc import Callable, Sequence
from math import inf, pi, tau

import numpy as np
import pytest

from agents.ring.feasibility import Orbit
from agents.ring.place import place_errors_rad
from agents.ring.reference import RingReference, RingWay
from agents.ring.transition import transition_of, transition_rate_rad_s
from agents.settings.config import AgentConfig
from estimation.polar import Polar
from estimation.state import Vector

Maker = Callable[..., AgentConfig]
STEP_S = 0.1
ORBIT = Orbit(10.0, 0.05)


def turned(config: AgentConfig, bearings_rad: Sequence[float], duration_s: float, orbit: Orbit = ORBIT) -> Vector:
    """Let vehicles that are where their references are fly; each knows the others' of the tick before: (T, n, 2).

    Returns the bearings and rates of the references.
    """
    references = [RingReference(config.encirclement) for _ in bearings_rad]
    polars = [Polar(orbit.radius_m, bearing, 0.0, orbit.angular_rate_rad_s) for bearing in bearings_rad]
    way = RingWay(orbit, orbit.radius_m, [0.0])
    points = [each.advance(polar, way, 0.0) for each, polar in zip(references, polars, strict=True)]
    track = []
    for tick in range(1, round(duration_s / STEP_S) + 1):
        now_s, before = tick * STEP_S, points
        points = []
        for own, (reference, last) in enumerate(zip(references, before, strict=True)):
            others = [each.bearing_rad(now_s) for each in (*before[:own], *before[own + 1 :])]
            polar = Polar(last.radius.value, last.bearing_rad(now_s), 0.0, last.bearing.rate)
            errors = place_errors_rad([reference.bearing_rad(polar, now_s), *others])
            points.append(reference.advance(polar, RingWay(orbit, orbit.radius_m, errors), now_s))
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


def test_without_a_bound_the_rate_is_that_of_the_paper(make_config: Maker) -> None:
    settings = make_config(encirclement={"spacing_gain_per_s": 0.3}).encirclement
    # (22) by hand: 0.05 + 0.3 / 3 (lead - lag), with lead - lag three times the error.
    assert transition_rate_rad_s([0.1, -0.06, -0.04], ORBIT, transition_of(settings)) == pytest.approx(0.05 + 0.1 * 0.3)
    assert transition_rate_rad_s([0.0, 0.0], ORBIT, transition_of(settings)) == 0.05


def test_a_bound_on_one_vehicle_scales_the_corrections_of_all(make_config: Maker) -> None:
    settings = make_config(encirclement={"spacing_speed_max_m_s": 0.5, "spacing_gain_per_s": 0.3}).encirclement
    errors = [1.0, -0.4, -0.6]
    wanted = np.array(
        [transition_rate_rad_s(np.roll(errors, -k).tolist(), ORBIT, transition_of(settings)) for k in range(3)]
    )
    shares = np.diff(wanted) / np.diff(errors)
    assert shares == pytest.approx(shares[0])
    assert shares[0] < 0.2  # gamma without the bound
    assert wanted.max() <= 0.05 + 0.05 + 1e-12
    assert wanted.min() >= 0.05 * 0.2 - 1e-12


def test_a_reference_waits_for_a_vehicle_that_does_not_follow(make_config: Maker) -> None:
    config = make_config(encirclement={"reference_lead_max_m": 1.0})
    reference, stuck = RingReference(config.encirclement), Polar(12.0, 1.0, 0.0, 0.0)
    way = RingWay(ORBIT, 10.0, [0.0])
    for tick in range(300):
        point = reference.advance(stuck, way, tick * STEP_S)
        assert abs(point.radius.value - 12.0) <= 1.0 + 1e-9
        assert abs(point.bearing.value - 1.0) * 12.0 <= 1.0 + 1e-9
    assert point.bearing.value == pytest.approx(1.0 + 1.0 / 12.0)


def test_a_vehicle_that_the_guard_holds_up_does_not_hurry_after_its_reference(make_config: Maker) -> None:
    reference, slow = RingReference(make_config().encirclement), Polar(10.0, 1.0, 0.0, 0.0)
    for tick in range(50):
        point = reference.advance(slow, RingWay(ORBIT, 10.0, [0.0], waits=True), tick * STEP_S)
        assert point.bearing.value == pytest.approx(1.0)
    assert point.bearing.rate == pytest.approx(0.05)


def test_while_it_leaves_the_formation_the_vehicles_own_motion_counts(make_config: Maker) -> None:
    reference = RingReference(make_config().encirclement)
    polar = Polar(14.0, 3.1, -0.2, 0.01)
    for tick in range(20):
        point = reference.advance(polar, RingWay(ORBIT, 10.0, [0.0], inf, 0.0), tick * STEP_S)
        assert (point.radius.value, point.bearing.value) == pytest.approx((14.0, 3.1))
        assert (point.radius.rate, point.bearing.rate) == pytest.approx((-0.2, 0.01))


@pytest.mark.parametrize("speed_m_s", [-3.0, 3.0])
def test_a_reference_that_arrives_too_fast_brakes_and_then_comes_to_rest(speed_m_s: float, make_config: Maker) -> None:
    # It brakes at the vehicle's acceleration, and must not keep that where only a transition's jerk could end it.
    reference = RingReference(make_config(encirclement={"reference_lead_max_m": 100.0}).encirclement)
    way = RingWay(ORBIT, 10.0, [0.0])
    point = reference.advance(Polar(11.0, 0.0, speed_m_s, 0.05), way, 0.0)
    for tick in range(1, 400):
        polar = Polar(point.radius.value, point.bearing_rad(tick * STEP_S), point.radius.rate, point.bearing.rate)
        point = reference.advance(polar, way, tick * STEP_S)
    assert point.radius.value == pytest.approx(10.0, abs=0.01)
    assert point.radius.rate == pytest.approx(0.0, abs=0.01)
