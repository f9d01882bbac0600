"""Where a camera looks: at the target in the middle of the interval until the next direction, five times a second."""

from collections.abc import Callable
from dataclasses import replace
from math import asin, atan2, cos, degrees, hypot, pi, sin

import numpy as np
import pytest

from agents.gimbal import CameraAim
from agents.settings.config import AgentConfig
from agents.settings.sections import GimbalSettings
from agents.situation.situation import Situation
from estimation.state import OwnEstimate, TargetEstimate
from tests.support.estimates import own_spread, target_spread

Maker = Callable[..., AgentConfig]
Point = tuple[float, float]
RADIUS_M, RATE_RAD_S, HEIGHT_M, TARGET_HEIGHT_M = 10.0, 0.15, 8.0, 1.5
TARGET_M, TARGET_M_S = (30.0, -5.0), (0.4, -0.2)
DELAY_S = 0.12


def camera(config: AgentConfig, *, rate_hz: float = 20.0) -> CameraAim:
    return CameraAim(replace(config, rate_hz=rate_hz, gimbal=GimbalSettings(target_height_m=TARGET_HEIGHT_M)))


def target_at(time_s: float) -> Point:
    return TARGET_M[0] + TARGET_M_S[0] * time_s, TARGET_M[1] + TARGET_M_S[1] * time_s


def vehicle_at(time_s: float) -> Point:
    x, y = target_at(time_s)
    return x + RADIUS_M * cos(RATE_RAD_S * time_s), y + RADIUS_M * sin(RATE_RAD_S * time_s)


def circling(time_s: float, *, sees_target: bool = True) -> Situation:
    """The situation of a vehicle that circles a moving target, which was estimated half a second ago."""
    x, y = vehicle_at(time_s)
    turn, v = RATE_RAD_S * time_s, RADIUS_M * RATE_RAD_S
    mean = np.array([x, y, TARGET_M_S[0] - v * sin(turn), TARGET_M_S[1] + v * cos(turn), 0.0, 0.0])
    own = OwnEstimate(time_s, mean, own_spread(0.01))
    seen_s = time_s - 0.5
    motion = np.array([*target_at(seen_s), *TARGET_M_S])
    target = TargetEstimate(seen_s, motion, target_spread(0.1), seen_s, 0.8, 0.2) if sees_target else None
    return Situation(time_s, time_s, own, mean[:4], mean[4:], target, None, None, height_m=HEIGHT_M)


@pytest.mark.parametrize("rate_hz", [4.0, 10.0, 20.0, 50.0])
def test_the_direction_is_that_of_the_true_motion_in_the_middle_of_its_interval(
    make_config: Maker, rate_hz: float
) -> None:
    aim = camera(make_config(), rate_hz=rate_hz)
    times_s = [tick / rate_hz for tick in range(round(60.0 * rate_hz))]
    sent = [(now_s, rad) for now_s in times_s if (rad := aim.next(circling(now_s), DELAY_S, None))]
    period_s = max(0.2, 1.0 / rate_hz)
    assert len(sent) == pytest.approx(60.0 / period_s, abs=1)
    for now_s, (elevation_rad, bearing_rad) in sent:
        acts_s = now_s + DELAY_S + period_s / 2.0
        (x, y), (target_x, target_y) = vehicle_at(acts_s), target_at(acts_s)
        true = np.array([target_x - x, target_y - y, TARGET_HEIGHT_M - HEIGHT_M])
        looks = np.array([cos(bearing_rad), sin(bearing_rad), 0.0]) * cos(elevation_rad)
        looks[2] = sin(elevation_rad)
        off_deg = degrees(asin(np.linalg.norm(np.cross(looks, true)) / np.linalg.norm(true)))
        assert off_deg < 0.1, "constant velocity for a quarter of a second on a ring"
        assert looks @ true > 0.0


def test_the_estimate_of_the_targets_altitude_counts_more_than_the_setting(make_config: Maker) -> None:
    elevation_rad, _ = camera(make_config()).next(circling(1.0), 0.0, 20.0)
    assert elevation_rad == pytest.approx(atan2(12.0, RADIUS_M), abs=1e-3)


def test_above_the_target_the_bearing_stays(make_config: Maker) -> None:
    aim, bearings_rad = camera(make_config(), rate_hz=5.0), list[float]()
    for tick in range(41):
        x = -4.0 + 0.2 * tick  # over the target and on, 1 m/s
        mean = np.array([x, 0.1, 0.0, 0.0, 0.0, 0.0])
        target = TargetEstimate(0.2 * tick, np.zeros(4), target_spread(0.1), 0.2 * tick, 0.8, 0.2)
        own = OwnEstimate(0.2 * tick, mean, own_spread(0.01))
        situation = Situation(0.2 * tick, 0.2 * tick, own, mean[:4], mean[4:], target, None, None, height_m=8.0)
        elevation_rad, bearing_rad = aim.next(situation, 0.0, None)
        assert elevation_rad == pytest.approx(atan2(TARGET_HEIGHT_M - 8.0, hypot(x, 0.1)))
        bearings_rad.append(bearing_rad)
    near = [bearing for tick, bearing in enumerate(bearings_rad) if abs(-4.0 + 0.2 * tick) < 0.45]
    assert len(set(near)) == 1, "it does not spin"
    assert abs(bearings_rad[-1]) == pytest.approx(pi, abs=0.05)


def test_without_a_gimbal_or_a_target_nothing_is_sent_and_a_clock_set_back_does_not_stop_it(make_config: Maker) -> None:
    assert CameraAim(make_config()).next(circling(1.0), 0.0, None) == ()
    aim = camera(make_config())
    assert aim.next(circling(100.0, sees_target=False), 0.0, None) == ()
    assert aim.next(circling(100.0), 0.0, None)
    assert aim.next(circling(100.05), 0.0, None) == ()
    assert aim.next(circling(50.0), 0.0, None), "set back by 50 s"
