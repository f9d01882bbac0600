"""The wander of a vehicle's reported position, against simulated truth and filterpy's Kalman filter."""

from itertools import pairwise
from math import exp, hypot, sqrt

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from estimation.filters.position_wander import PositionWander
from estimation.settings import OwnFilterSettings
from estimation.state import Telemetry, Vector

STEP_S, SIGMA_M, CORRELATION_S = 0.1, 0.25, 20.0


def settings(walk_m: float, noise_m: float = 0.02) -> OwnFilterSettings:
    return OwnFilterSettings(wander_m=SIGMA_M, wander_s=CORRELATION_S, velocity_walk_m=walk_m, position_noise_m=noise_m)


def flown(steps: int, walk_m: float, seed: int = 1) -> tuple[list[Telemetry], Vector]:
    """A vehicle on a circle at 1 m/s, with a wandering position and a noisy velocity; and the wander (steps, 2)."""
    random = np.random.default_rng(seed)
    kept = exp(-STEP_S / CORRELATION_S)
    wander_m = np.empty((steps, 2))
    error_m = SIGMA_M * random.standard_normal(2)
    samples = []
    for step in range(steps):
        angle_rad = 0.1 * step * STEP_S
        way = 10.0 * np.array([np.cos(angle_rad), np.sin(angle_rad)])
        velocity = np.array([-np.sin(angle_rad), np.cos(angle_rad)])
        velocity = velocity + walk_m / sqrt(STEP_S) * random.standard_normal(2)
        x, y = (way + error_m + 0.02 * random.standard_normal(2)).tolist()
        samples.append(Telemetry(step * STEP_S, (x, y, 8.0), (*velocity.tolist(), 0.0)))
        wander_m[step] = error_m
        error_m = kept * error_m + SIGMA_M * sqrt(1.0 - kept**2) * random.standard_normal(2)
    return samples, wander_m


def test_the_remaining_error_has_the_stated_deviation_and_correlation() -> None:
    walk_m, left = 0.1, []
    for seed in range(60):
        wander, (samples, truth) = PositionWander(settings(walk_m)), flown(1200, walk_m, seed)
        course = []
        for telemetry in samples:
            wander.measure(telemetry)
            course.append(wander.error_m)
        left.append((truth - np.array(course))[[-200, -1]])
    earlier, last = np.array(left).transpose(1, 0, 2)
    assert np.sqrt(np.mean(last**2)) == pytest.approx(wander.sigma_m, rel=0.2)
    assert wander.sigma_m < 0.97 * SIGMA_M
    kept = exp(-199 * STEP_S / wander.correlation_s)
    assert np.mean(earlier * last) / np.mean(last**2) == pytest.approx(kept, abs=0.25)


def test_it_is_the_kalman_filter_of_position_and_error() -> None:
    samples, _ = flown(300, 0.05)
    wander, reference = PositionWander(settings(0.05)), KalmanFilter(2, 1, dim_u=1)
    kept, prior = exp(-STEP_S / CORRELATION_S), SIGMA_M**2
    reference.F, reference.B, reference.H = np.diag([1.0, kept]), np.array([[STEP_S], [0.0]]), np.ones((1, 2))
    reference.Q, reference.R = np.diag([0.05**2 * STEP_S, prior * (1.0 - kept**2)]), np.array([[0.02**2]])
    reference.x = np.array([[samples[0].position_m[0]], [0.0]])
    reference.P = np.array([[prior + 0.02**2, -prior], [-prior, prior]])
    wander.measure(samples[0])
    for before, telemetry in pairwise(samples):
        wander.measure(telemetry)
        reference.predict(u=np.array([[(before.velocity_m_s[0] + telemetry.velocity_m_s[0]) / 2.0]]))
        reference.update(telemetry.position_m[0])
        assert wander.error_m[0] == pytest.approx(reference.x[1, 0], abs=1e-9)
        assert wander.sigma_m**2 == pytest.approx(reference.P[1, 1], rel=1e-6)


def test_a_position_jump_is_not_estimated_as_a_slow_error() -> None:
    samples, _ = flown(600, 0.02)
    wander = PositionWander(settings(0.02))
    for telemetry in samples[:500]:
        wander.measure(telemetry)
    before, sigma_m = wander.error_m, wander.sigma_m
    x, y, z = samples[500].position_m
    wander.measure(Telemetry(samples[500].time_s, (x + 2.0, y, z), samples[500].velocity_m_s))
    assert wander.error_m == pytest.approx(before, abs=0.01)
    assert sigma_m < 0.9 * SIGMA_M
    assert wander.sigma_m == pytest.approx(SIGMA_M)


def test_a_velocity_with_a_steady_error_keeps_the_estimate_bounded() -> None:
    wander = PositionWander(settings(0.01))
    for step in range(6000):
        wander.measure(Telemetry(step * STEP_S, (0.0, 0.0, 8.0), (0.2, 0.0, 0.0)))
    assert hypot(*wander.error_m) <= 3.0 * SIGMA_M + 1e-9


def test_samples_from_the_past_change_nothing() -> None:
    samples, _ = flown(50, 0.02)
    wander = PositionWander(settings(0.02))
    for telemetry in samples:
        wander.measure(telemetry)
    before = wander.error_m, wander.sigma_m
    wander.measure(samples[10])
    wander.measure(samples[-1])
    assert (wander.error_m, wander.sigma_m) == before
