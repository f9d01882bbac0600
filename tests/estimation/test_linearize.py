"""Polar coordinates against finite differences, and the feedback linearisation against the plant itself."""

from collections.abc import Callable
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.control.encirclement import aim_for, aim_for_acceleration
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.polar import Polar, motion_from_polar, polar_from_motion
from estimation.state import Vector

pytestmark = pytest.mark.filterwarnings("error")

PLANT = Plant(PlantAxis(0.80, 0.87), PlantAxis(0.60, 1.10))
TARGET = np.array([35.0, -5.0, 0.4, -0.3])
WIND = np.array([0.2, -0.1])

polars = st.builds(Polar, st.floats(0.1, 100.0), st.floats(-3.14, 3.14), st.floats(-5.0, 5.0), st.floats(-1.0, 1.0))
targets = st.lists(st.floats(-50.0, 50.0), min_size=4, max_size=4).map(np.array)


def derivative(function: Callable[[float], Vector], step_s: float = 1e-4) -> Vector:
    """At time 0, by central differences of fourth order."""
    near = function(step_s) - function(-step_s)
    far = function(2.0 * step_s) - function(-2.0 * step_s)
    return np.asarray((8.0 * near - far) / (12.0 * step_s), dtype=np.float64)


def target_at(time_s: float) -> Vector:
    return np.asarray(TARGET[:2] + TARGET[2:] * time_s, dtype=np.float64)


@pytest.mark.parametrize("bearing", [0.3, 2.0, -2.9, pi])
def test_polar_rates_are_the_time_derivatives_of_radius_and_bearing(bearing: float) -> None:
    def position(time_s: float) -> Vector:
        curve = np.array([7.0 * cos(bearing), 7.0 * sin(bearing)])
        curve += np.array([0.8, -0.5]) * time_s + np.array([0.3, 0.9]) * time_s**2
        return np.asarray(target_at(0.0) + curve, dtype=np.float64)

    def radius_and_turn(time_s: float) -> Vector:
        x, y = position(time_s) - target_at(time_s)
        start_x, start_y = position(0.0) - target_at(0.0)
        return np.array([np.hypot(x, y), np.arctan2(start_x * y - start_y * x, start_x * x + start_y * y)])

    polar = polar_from_motion(np.concatenate([position(0.0), derivative(position)]), TARGET)
    assert polar.radius_m == pytest.approx(7.0)
    assert (cos(polar.bearing_rad), sin(polar.bearing_rad)) == pytest.approx((cos(bearing), sin(bearing)))
    rates = derivative(radius_and_turn)
    assert (polar.radial_speed_m_s, polar.angular_rate_rad_s) == pytest.approx(tuple(rates), abs=1e-8)


@given(polars)
def test_motion_is_the_time_derivative_of_the_polar_position(polar: Polar) -> None:
    def position(time_s: float) -> Vector:
        radius = polar.radius_m + polar.radial_speed_m_s * time_s
        bearing = polar.bearing_rad + polar.angular_rate_rad_s * time_s
        return target_at(time_s) + radius * np.array([cos(bearing), sin(bearing)])

    motion = motion_from_polar(polar, TARGET)
    assert motion[:2] == pytest.approx(position(0.0))
    assert motion[2:] == pytest.approx(derivative(position), abs=1e-6)


@given(polars, targets)
def test_there_and_back_again(polar: Polar, target: Vector) -> None:
    again = polar_from_motion(motion_from_polar(polar, target), target)
    assert again.radius_m == pytest.approx(polar.radius_m, abs=1e-9)
    assert again.bearing_rad == pytest.approx(polar.bearing_rad, abs=1e-9)
    assert again.radial_speed_m_s == pytest.approx(polar.radial_speed_m_s, abs=1e-9)
    assert again.angular_rate_rad_s == pytest.approx(polar.angular_rate_rad_s, abs=1e-9)


def test_at_the_centre_itself_there_is_a_speed_but_no_rate() -> None:
    polar = polar_from_motion(TARGET + np.array([0.0, 0.0, 3.0, 4.0]), TARGET)
    assert (polar.radius_m, polar.bearing_rad) == (0.0, 0.0)
    assert (polar.radial_speed_m_s, polar.angular_rate_rad_s) == (5.0, 0.0)


def test_next_to_the_centre_nothing_is_divided_by_zero() -> None:
    assert polar_from_motion(np.array([0.0, 1e-170, 3.0, 4.0]), np.zeros(4)).radius_m <= 1e-170


@given(
    st.builds(Polar, st.floats(1.5, 40.0), st.floats(-pi, pi), st.floats(-1.0, 1.0), st.floats(-0.9, 0.9)),
    st.tuples(st.floats(-1.1, 1.1), st.floats(-0.2, 0.2)),
)
def test_the_plant_answers_with_the_polar_acceleration_wanted(polar: Polar, wanted: tuple[float, float]) -> None:
    motion = motion_from_polar(polar, TARGET)
    setpoint = aim_for(motion, polar, wanted, WIND, PLANT)

    def mean_acceleration(step_s: float) -> Vector:
        # The target goes on in a straight line, and so does not accelerate.
        after = exact_step(PLANT, step_s).advance(motion, setpoint, WIND)
        now = polar_from_motion(after, np.concatenate([target_at(step_s), TARGET[2:]]))
        rates = np.array([polar.radial_speed_m_s, polar.angular_rate_rad_s])
        change = np.array([now.radial_speed_m_s, now.angular_rate_rad_s]) - rates
        return np.asarray(change / step_s, dtype=np.float64)

    at_once = 2.0 * mean_acceleration(5e-4) - mean_acceleration(1e-3)
    assert at_once == pytest.approx(wanted, abs=1e-5)


def test_a_cartesian_acceleration_matches_the_plant() -> None:
    motion, wanted = np.array([3.0, -2.0, 1.0, 0.5]), (0.4, -0.9)
    x_d, y_d = aim_for_acceleration(motion, wanted, WIND, PLANT)
    assert 0.80 * (x_d - 3.0) - 0.87 * 1.0 + 0.2 == pytest.approx(0.4)
    assert 0.60 * (y_d + 2.0) - 1.10 * 0.5 - 0.1 == pytest.approx(-0.9)
