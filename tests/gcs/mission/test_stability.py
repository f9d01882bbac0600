"""Eigenvalues against what the same loops do in time, on the planner itself and the exact plant."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from agents.control.encirclement import EncirclementPlanner, RingTask
from agents.ring.commanded_ring import Orbit
from agents.ring.reference import RingPoint
from agents.ring.transition import ShapedCoordinate
from agents.settings.config import AgentConfig
from estimation.plant.model import exact_step
from estimation.polar import Polar, motion_from_polar, polar_from_motion
from estimation.state import Vector
from gcs.mission.stability import ClosedLoop, loops
from tests.support.mission_text import CASE2, Content, content, faults, parsed, put

STILL = np.zeros(4)


def named(config: AgentConfig, name: str) -> ClosedLoop:
    return next(loop for loop in loops(config) if loop.name == name)


def radius_errors(config: AgentConfig, ticks: int) -> Vector:
    """Return a lone vehicle's radius errors, from 1 cm on: its state and the middle of each hold are known exactly."""
    period_s = 1.0 / config.rate_hz
    whole, half = exact_step(config.plant, period_s), exact_step(config.plant, period_s / 2.0)
    planner, settings = EncirclementPlanner(config), config.encirclement
    orbit = Orbit(settings.radius_m, settings.angular_rate_rad_s)
    motion = motion_from_polar(Polar(settings.radius_m + 0.01, 0.0, 0.0, 0.0), STILL)
    setpoint, errors = motion[:2], []
    for _ in range(ticks):
        middle = half.advance(motion, setpoint, np.zeros(2))
        middle = middle + half.input_gain @ (middle[2:] * period_s)
        polar = polar_from_motion(middle, STILL)
        reference = RingPoint(ShapedCoordinate(orbit.radius_m, 0.0), ShapedCoordinate(0.0, 0.0), 0.0)
        task = RingTask(middle, STILL, polar, np.zeros(2), None, orbit, orbit.radius_m, reference)
        setpoint = planner.plan(task).aim_m
        motion = whole.advance(motion, setpoint, np.zeros(2))
        errors.append(polar_from_motion(motion, STILL).radius_m - settings.radius_m)
    return np.array(errors)


@pytest.mark.parametrize("rate_hz", [5.0, 20.0])
def test_the_radius_settles_as_fast_as_its_eigenvalue_says(
    make_config: Callable[..., AgentConfig], rate_hz: float
) -> None:
    config = make_config(rate_hz=rate_hz, encirclement={"angular_rate_rad_s": 0.0})
    modulus = named(config, "keeping the radius along x").modulus
    errors = np.abs(radius_errors(config, round(20.0 * rate_hz)))
    # It swings: compare envelopes, ten seconds apart.
    early, late = (errors[round(begin_s * rate_hz) : round((begin_s + 5.0) * rate_hz)].max() for begin_s in (2.5, 12.5))
    assert np.log(late / early) / (10.0 * rate_hz) == pytest.approx(np.log(modulus), rel=0.1)


def test_a_radius_that_is_said_to_be_unstable_grows(make_config: Callable[..., AgentConfig]) -> None:
    config = make_config(
        rate_hz=2.0, encirclement={"angular_rate_rad_s": 0.0, "radius_weight": 1e6, "radial_increment_weight": 1e-6}
    )
    assert named(config, "keeping the radius along x").margin < -1.0
    # What is unstable near the ring is caught by the bounds far from it: it swings on.
    assert np.abs(radius_errors(config, 40)[20:]).max() > 0.02
    calm = make_config(rate_hz=2.0, encirclement={"angular_rate_rad_s": 0.0})
    assert np.abs(radius_errors(calm, 40)[20:]).max() < 1e-4


@pytest.mark.parametrize("members", [2, 12])
def test_the_references_are_spaced_as_the_spacing_law_says(
    make_config: Callable[..., AgentConfig], members: int
) -> None:
    config = make_config(rate_hz=50.0, encirclement={"spacing_gain_per_s": 0.2})
    config = replace(config, slots=tuple(range(1, members + 1)))
    assert -np.log(named(config, "the spacing").modulus) * 50.0 == pytest.approx(0.2, rel=0.01)


def test_a_ring_that_is_not_spaced_is_neutral_and_one_vehicle_has_no_spacing(
    make_config: Callable[..., AgentConfig],
) -> None:
    config = make_config(encirclement={"spacing_weight": 0.0, "spacing_gain_per_s": 0.0})
    assert named(config, "the spacing").margin == pytest.approx(0.0, abs=1e-9)
    assert named(config, "keeping the bearing along y").margin == pytest.approx(0.0, abs=1e-9)
    alone = replace(make_config(), slots=(2,))
    assert not [loop.name for loop in loops(alone) if "spacing" in loop.name]
    assert all(loop.margin > 0.01 for loop in loops(alone))


@pytest.mark.parametrize(
    ("gain_per_s", "more", "why"),
    [
        (0.7, {}, "with 0.7 1/s spacings overshoot"),
        (0.5, {"angular_increment_weight": 400.0}, "0.5 1/s is faster than vehicles[0] follows its reference"),
    ],
)
def test_a_spacing_gain_that_cannot_be_followed_is_refused_with_the_largest_that_can(
    gain_per_s: float, more: dict[str, float], why: str
) -> None:
    def with_gain(per_s: float) -> Content:
        return put(content(CASE2), ("tuning", "encirclement"), {"spacing_gain_per_s": per_s, **more})

    (fault,) = faults(with_gain(gain_per_s))
    assert fault.startswith(f"tuning.encirclement.spacing_gain_per_s: {why}")
    largest = float(fault.split("at most ")[1].split()[0])
    assert 0.1 < largest < gain_per_s
    parsed(with_gain(largest))


def test_gains_that_make_a_loop_unstable_are_refused_with_the_margin() -> None:
    slow = put(content(CASE2), ("mission", "rate_hz"), 2.0)
    stiff = put(slow, ("tuning", "encirclement"), {"radius_weight": 1e6, "radial_increment_weight": 1e-6})
    (fault,) = faults(stiff)
    assert fault.startswith("encirclement: keeping the radius along x is unstable with the plant of vehicles[0]: ")
    assert "has modulus 2.233, a margin of -1.233 to 1" in fault
    hard = put(slow, ("tuning", "formation"), {"position_weight": 1e6, "increment_weight": 1e-6})
    (fault,) = faults(hard)
    assert fault.startswith("formation: keeping its place along x is unstable")
    hard = put(slow, ("tuning", "encirclement"), {"spacing_weight": 1e6, "angular_increment_weight": 1e-6})
    (fault,) = faults(hard)
    assert fault.startswith("encirclement: keeping the bearing along x is unstable")


def test_a_mission_is_loaded_and_its_loops_are_checked_without_the_solver() -> None:
    """Importing it takes half as long as the rest, in every process that loads a mission."""
    program = "import sys; from gcs.mission.file import load_mission; load_mission('case2')"
    program += "; print([name for name in ('osqp', 'scipy') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
