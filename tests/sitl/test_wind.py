"""Wind against MIL-F-8785C by hand, and turbulence against its autocovariance in closed form."""

from math import exp

import numpy as np
import pytest

from estimation.state import Vector
from sitl.vehicle.wind import Turbulence, Wind, low_altitude

STEP_S = 0.5
TURBULENCE = Turbulence(length_m=40.0, intensity_m_s=1.5, speed_m_s=8.0)


def blown(steady_m_s: tuple[float, float], gusts: Turbulence | None, steps: int, seed: int = 1) -> Vector:
    wind = Wind(steady_m_s, gusts, STEP_S, np.random.default_rng(seed))
    return np.array([wind.blow() for _ in range(steps)])


def test_low_altitude_turbulence_is_the_specifications() -> None:
    # 20 ft up in 10 m/s: 0.177 + 0.01646 = 0.19346; L = 20 ft / 0.19346^1.2 = 143.6 ft, sigma = 1 m/s / 0.19346^0.4.
    gusts = low_altitude(10.0, 20.0 * 0.3048)
    assert gusts.length_m == pytest.approx(143.6 * 0.3048, rel=1e-3)
    assert gusts.intensity_m_s == pytest.approx(1.929, rel=1e-3)
    assert gusts.speed_m_s == 10.0
    assert low_altitude(0.0, 1.0).speed_m_s == 1.0
    assert low_altitude(0.0, 1.0).intensity_m_s == 0.0


def test_gusts_have_the_autocovariance_of_drydens_filters() -> None:
    gusts = blown((8.0, 0.0), TURBULENCE, 60000) - (8.0, 0.0)
    span_s, variance = TURBULENCE.length_m / TURBULENCE.speed_m_s, TURBULENCE.intensity_m_s**2
    for lag in (0, 2, 6, 20):
        seen = [float(np.mean(each[: len(each) - lag] * each[lag:])) for each in gusts.T]
        late = lag * STEP_S / span_s
        assert seen[0] == pytest.approx(variance * exp(-late), abs=0.06 * variance)
        assert seen[1] == pytest.approx(variance * (1.0 - late / 2.0) * exp(-late), abs=0.06 * variance)
    assert abs(np.mean(gusts[:, 0] * gusts[:, 1])) < 0.05 * variance


def test_gusts_come_along_and_across_the_wind() -> None:
    slanted = blown((4.8, 6.4), TURBULENCE, 50) - (4.8, 6.4)
    straight = blown((8.0, 0.0), TURBULENCE, 50) - (8.0, 0.0)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    np.testing.assert_allclose(slanted, straight @ turn.T, atol=1e-12)
