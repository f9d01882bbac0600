"""Where the nose points: at the target, along the path, at a bounded rate, and never spinning."""

import cmath
from collections.abc import Callable, Sequence
from math import cos, degrees, pi, radians, sin, tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.outputs import TickOutput
from agents.setpoint import Yaw
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from estimation.state import OwnEstimate, TargetEstimate
from gcs.mission.mission import Mission
from sitl.simulation.simulation import NetworkModel
from tests.support.estimates import own_spread, target_spread
from tests.support.mission_text import content, faults, parsed, put
from tests.support.observed_flight import observed

Maker = Callable[..., AgentConfig]
Point = tuple[float, float]

RATE_HZ, TURNS_DEG_S = 10.0, 45.0
STEP_RAD = radians(TURNS_DEG_S) / RATE_HZ
LOOKING = {"encirclement": {"yaw": "target"}, "formation": {"yaw": "path"}}


def seen(
    position_m: Point = (0.0, 0.0),
    velocity_m_s: Point = (0.2, 0.0),
    target_m: Point | None = None,
    target_sigma_m: float = 0.1,
) -> Situation:
    mean = np.array([*position_m, *velocity_m_s, 0.0, 0.0])
    own = OwnEstimate(1.0, mean, own_spread(0.01))
    if target_m is None:
        return Situation(1.0, 1.1, own, mean[:4], mean[4:], None, None, None)
    motion = np.array([*target_m, 0.0, 0.0])
    target = TargetEstimate(1.0, motion, target_spread(target_sigma_m), 1.0, 0.8, 0.2)
    return Situation(1.0, 1.1, own, mean[:4], mean[4:], target, None, motion)


def apart_rad(one_rad: float, other_rad: float) -> float:
    """The angle between two directions, [0, pi]."""
    return abs(cmath.phase(cmath.rect(1.0, one_rad - other_rad)))


def settled(yaw: Yaw, tactic: Tactic, situation: Situation) -> float:
    """The yaw after long enough for half a turn."""
    return [yaw.turn(tactic, situation) for _ in range(round(pi / STEP_RAD) + 2)][-1]


def test_without_being_asked_the_nose_points_along_x(make_config: Maker) -> None:
    yaw = Yaw(make_config())
    for tactic in Tactic:
        assert yaw.turn(tactic, seen(velocity_m_s=(-2.0, 2.0), target_m=(0.0, 9.0))) == 0.0


@pytest.mark.parametrize("target_m", [(12.0, 1.0), (-9.0, 0.1), (-9.0, -0.1)])
def test_on_the_ring_it_points_at_the_target_and_nowhere_else(make_config: Maker, target_m: Point) -> None:
    yaw, situation = Yaw(make_config(**LOOKING)), seen((1.0, 2.0), target_m=target_m)
    towards = complex(*target_m) - complex(1.0, 2.0)
    assert apart_rad(settled(yaw, Tactic.ENCIRCLE, situation), cmath.phase(towards)) < 1e-9
    only_path = Yaw(make_config(formation={"yaw": "path"}))
    assert settled(only_path, Tactic.ENCIRCLE, situation) == 0.0


@given(st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=60))
def test_whatever_the_direction_does_it_turns_no_faster_than_allowed(
    make_config: Maker, bearings_rad: Sequence[float]
) -> None:
    yaw, before_rad = Yaw(make_config(**LOOKING)), 0.0
    for bearing_rad in bearings_rad:
        wanted_rad = cmath.phase(cmath.rect(1.0, bearing_rad))
        now_rad = yaw.turn(Tactic.ENCIRCLE, seen(target_m=(10.0 * cos(bearing_rad), 10.0 * sin(bearing_rad))))
        assert -pi <= now_rad <= pi
        assert apart_rad(now_rad, before_rad) <= STEP_RAD + 1e-9
        # The shorter way around: what is left of the turn is less by the whole step, or nothing.
        left_rad = apart_rad(before_rad, wanted_rad) - STEP_RAD
        assert apart_rad(now_rad, wanted_rad) == pytest.approx(max(left_rad, 0.0), abs=1e-9)
        before_rad = now_rad


def test_it_does_not_spin_over_a_target_that_is_near_or_somewhere_or_nowhere(make_config: Maker) -> None:
    yaw = Yaw(make_config(**LOOKING))
    looked = settled(yaw, Tactic.ENCIRCLE, seen((0.0, -5.0), target_m=(0.0, 0.0)))
    assert looked == pytest.approx(pi / 2.0)
    for angle in np.linspace(0.0, tau, 40):
        near = seen((0.9 * cos(angle), 0.9 * sin(angle)), target_m=(0.0, 0.0))
        unsure = seen((9.0 * cos(angle), 9.0 * sin(angle)), target_m=(0.0, 0.0), target_sigma_m=5.0)
        for situation in (near, unsure, seen()):
            assert yaw.turn(Tactic.ENCIRCLE, situation) == looked


def test_in_other_tactics_it_stays_as_it_is(make_config: Maker) -> None:
    yaw = Yaw(make_config(**LOOKING))
    looked = settled(yaw, Tactic.ENCIRCLE, seen(target_m=(-4.0, 7.0)))
    for tactic in set(Tactic) - {Tactic.ENCIRCLE, Tactic.FORMATION}:
        assert yaw.turn(tactic, seen(velocity_m_s=(1.0, -1.0), target_m=(9.0, 0.0))) == looked


def test_in_formation_it_points_along_the_line_and_along_a_way_of_its_own(make_config: Maker) -> None:
    yaw = Yaw(make_config(formation={"yaw": "path", "speed_m_s": 0.2}))
    slow_ways = ((0.2, 0.0), (0.2, 0.55), (-0.2, 0.1), (0.0, 0.0))
    assert [settled(yaw, Tactic.FORMATION, seen(velocity_m_s=way)) for way in slow_ways] == [0.0] * 4
    assert settled(yaw, Tactic.FORMATION, seen(velocity_m_s=(-1.0, 1.0))) == pytest.approx(radians(135.0))
    # It keeps to its own way until it is well back at the formation's velocity, and does not waver between the two.
    assert settled(yaw, Tactic.FORMATION, seen(velocity_m_s=(0.2, 0.5))) == pytest.approx(np.arctan2(0.5, 0.2))
    assert settled(yaw, Tactic.FORMATION, seen(velocity_m_s=(0.2, 0.25))) == 0.0
    assert settled(yaw, Tactic.FORMATION, seen(velocity_m_s=(0.2, 0.5))) == 0.0


# In flight


def flown(mission: Mission) -> tuple[list[list[TickOutput]], np.ndarray[tuple[int, int, int], np.dtype[np.float64]]]:
    outputs: list[list[TickOutput]] = [[] for _ in mission.ids]

    def observe(_tick: int, vehicle: int, output: TickOutput) -> None:
        outputs[vehicle].append(output)

    flight = observed(mission, 5, observe, duration_s=45.0, network=NetworkModel(200.0))
    return outputs, flight.motion


def test_in_flight_each_looks_at_the_target_and_flies_as_one_that_does_not() -> None:
    near = put(content(), ("target", "start_m"), [9.0, -2.0])
    asked = put(put(near, ("encirclement", "yaw"), "target"), ("formation", "yaw"), "path")
    mission = parsed(asked)
    outputs, motion = flown(mission)
    plain, same_motion = flown(parsed(near))
    assert (motion == same_motion).all()
    for index, ticks in enumerate(outputs):
        assert ticks[-1].status.tactic is Tactic.ENCIRCLE
        yaws = np.array([0.0 if each.setpoint is None else each.setpoint.yaw_rad for each in ticks])
        turned = np.abs(np.angle(np.exp(1j * np.diff(yaws))))
        assert degrees(turned.max()) * mission.mission.rate_hz <= TURNS_DEG_S + 1e-6
        times_s = np.arange(len(ticks)) / mission.mission.rate_hz
        to_target = np.array([complex(*mission.target.motion.position_m(t)) for t in times_s.tolist()])
        to_target -= motion[:, index, 0] + 1j * motion[:, index, 1]
        off_deg = np.degrees(np.abs(np.angle(np.exp(1j * yaws) / to_target)))
        assert off_deg[-100:].max() < 1.0
        assert all(each.setpoint is None or each.setpoint.yaw_rad == 0.0 for each in plain[index])


# In the mission file


def test_nonsense_is_refused_with_key_and_value() -> None:
    slow = put(put(content(), ("encirclement", "yaw"), "target"), ("safety", "yaw_rate_max_deg_s"), 2.5)
    assert faults(slow) == [
        "safety.yaw_rate_max_deg_s: 2.5 degrees/s is less than the 2.9 degrees/s of encirclement.angular_rate_rad_s = "
        '0.05 rad/s, which encirclement.yaw = "target" takes'
    ]
    assert parsed(put(slow, ("encirclement", "yaw"), "fixed")).safety.yaw_rate_max_deg_s == 2.5
