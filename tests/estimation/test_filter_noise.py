"""What a flight tells of the own-state filter and of the delay, where noise and disturbance are known."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.identification.excerpts import MotionRecording
from estimation.identification.filter_noise import FilterNoise
from estimation.identification.identified import ParameterEstimate
from estimation.identification.identify import identify
from estimation.state import Vector
from tests.support.synthetic_flights import FINE_S, SENT_S, Truth, excitation_m, flown, recorded

pytestmark = pytest.mark.slow

TRUTH = Truth((1.5, 1.5), (1.9, 1.9), 0.2)
PUSH_M_S2 = 0.8


def found_in(recording: MotionRecording) -> ParameterEstimate:
    found = identify([recording]).found
    assert found is not None
    return found


def told(*, position_m: float, velocity_m_s: float, push_m_s2: float = 0.0) -> FilterNoise:
    """Identify a flight with white noise on its positions, a steady error of its velocities, and a push that swings."""
    random = np.random.default_rng(3)
    sent_m = excitation_m(random, 45.0, 30.0)
    time_s, aimed_m = flown(TRUTH, sent_m)
    swing = push_m_s2 / TRUTH.a0[0] * np.sin(0.4 * np.arange(len(sent_m)) * SENT_S)
    _, pushed_m = flown(replace(TRUTH, delay_s=0.0), np.column_stack((swing, -swing)))
    path_m = aimed_m + pushed_m
    rate_m_s = np.gradient(path_m, FINE_S, axis=0) + velocity_m_s
    every = round(0.1 / FINE_S)
    noisy_m: Vector = path_m[::every] + random.normal(0.0, position_m, path_m[::every].shape)
    sent_s = np.arange(len(sent_m), dtype=np.float64) * SENT_S
    spans_s = [(0.0, float(time_s[-1]))]
    noise = found_in(
        MotionRecording(time_s[::every], noisy_m, sent_s, sent_m, spans_s, reported_m_s=rate_m_s[::every])
    ).noise
    assert noise is not None
    return noise


def test_noise_of_positions_and_velocities_is_measured() -> None:
    noise = told(position_m=0.06, velocity_m_s=0.25)
    assert noise.position_noise_m == pytest.approx(0.06, rel=0.15)
    assert noise.velocity_noise_m_s == pytest.approx(0.26, rel=0.1)  # with what the positions' noise adds in a second


def test_an_oscillating_push_gives_a_larger_random_walk_and_bound() -> None:
    calm, pushed = (told(position_m=0.01, velocity_m_s=0.0, push_m_s2=push) for push in (0.0, PUSH_M_S2))
    assert pushed.disturbance_noise_m_s2 > 3.0 * calm.disturbance_noise_m_s2
    assert PUSH_M_S2 < pushed.disturbance_max_m_s2 < 2.0 * PUSH_M_S2
    assert calm.predicted_rms_m < 0.03


def test_a_delay_that_changes_is_noticed() -> None:
    """For 15 s each, setpoints act at once and 0.3 s later: 0.15 s rms, part of which the plant's damping takes up."""
    sent_m = excitation_m(np.random.default_rng(1), 45.0, 30.0)
    steady = recorded(TRUTH, 1, noise_m=0.03, sampled=False, setpoints_hz=25.0, setpoint_m=sent_m)
    late_s = steady.setpoint_time_s + 0.3 * (np.floor(steady.setpoint_time_s / 15.0) % 2.0)
    kept = np.append(True, np.diff(np.maximum.accumulate(late_s)) > 0.0)
    changing = replace(steady, setpoint_time_s=late_s[kept], setpoint_m=steady.setpoint_m[kept])
    unchanged = found_in(steady)
    assert unchanged.noise is None, "a log without velocities gives no filter settings"
    assert unchanged.delay_spread_s < 0.02
    assert 0.08 < found_in(changing).delay_spread_s < 0.2
