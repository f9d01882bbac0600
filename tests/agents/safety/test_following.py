"""How far a vehicle is from where its plant would be under its setpoints, against the plant's closed solution."""

from collections.abc import Callable
from math import sin

import numpy as np
import pytest

from agents.safety.vehicle_watch import Following
from agents.situation.situation import Situation
from estimation.filters.own import OwnFilter
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.settings import OwnFilterSettings
from estimation.state import Telemetry, Vector

PLANT = Plant(PlantAxis(0.8, 0.87), PlantAxis(1.5, 1.9))
PERIOD_S = 0.05
STILL = (0.0, 0.0)


def flown(
    seconds: float,
    aim_m: Callable[[float], tuple[float, float]],
    wind_m_s2: tuple[float, float] = STILL,
    *,
    stuck: bool = False,
    jump: float = 0.0,
) -> list[tuple[float, float]]:
    """Return (time, error) of a vehicle with that plant, from rest; its estimate jumps by `jump` after 5 s."""
    own = OwnFilter(PLANT, OwnFilterSettings())
    following, motion = Following(PLANT, own), np.zeros(4)
    errors: list[tuple[float, float]] = []
    for tick in range(round(seconds / PERIOD_S) + 1):
        now_s = tick * PERIOD_S
        x, y, x_rate, y_rate = motion.tolist()
        offset_m = jump if now_s > 5.0 else 0.0  # it is controlled by its estimate
        own.measure(Telemetry(now_s, (x + offset_m, y, 8.0), (x_rate, y_rate, 0.0)))
        estimate = own.estimate(now_s)
        assert estimate is not None
        if tick % round(1.0 / PERIOD_S) == 0:
            situation = Situation(now_s, now_s, estimate, np.zeros(4), np.zeros(2), None, None, None)
            errors.append((now_s, following.error_m(situation)))
        aim: Vector = np.array(aim_m(now_s))
        own.command(now_s, aim)
        if not stuck:
            motion = exact_step(PLANT, PERIOD_S).advance(motion, aim - [offset_m, 0.0], np.array(wind_m_s2))
    return errors


def test_a_vehicle_that_follows_is_where_its_plant_is() -> None:
    errors = flown(20.0, lambda t: (5.0 * sin(0.4 * t), 3.0 if t > 4.0 else 0.0))
    assert max(error for _, error in errors) < 0.15


@pytest.mark.parametrize("wind_m_s2", [0.5, 3.0])
def test_a_wind_counts_as_far_as_it_exceeds_the_disturbance_that_is_compensated(wind_m_s2: float) -> None:
    """A steady disturbance w displaces the plant by w / a0; the filter's part of it displaces the model as well."""
    compensated_m_s2 = min(wind_m_s2, OwnFilterSettings().disturbance_max_m_s2)
    _, error_m = flown(40.0, lambda _: STILL, (wind_m_s2, 0.0))[-1]
    assert error_m == pytest.approx((wind_m_s2 - compensated_m_s2) / PLANT.x.a0_per_s2, abs=0.1)


def test_a_vehicle_that_ignores_its_setpoints_is_off_by_their_lead() -> None:
    errors = flown(20.0, lambda t: (4.0 if t > 5.0 else 0.0, 0.0), stuck=True)
    assert max(error for time_s, error in errors if time_s < 5.0) < 0.1
    assert errors[-1][1] == pytest.approx(4.0, abs=0.9)  # the filter's estimate is drawn along between its resets


def test_a_jump_of_the_reported_position_is_no_error_of_the_vehicle() -> None:
    errors = flown(20.0, lambda _: STILL, jump=8.0)
    assert max(error for time_s, error in errors if time_s > 7.0) < 0.3
