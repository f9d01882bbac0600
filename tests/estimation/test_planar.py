"""The target filter's Kalman steps against those of filterpy."""

from math import nan

import numpy as np
import pytest
from filterpy import kalman

from estimation.filters.planar import Motion, MotionStep, PlanarCovariance, predicted, updated
from estimation.state import Vector

OBSERVATION = np.eye(2, 4)
UPPER = np.triu_indices(4)


def drawn(seed: int) -> tuple[Motion, np.random.Generator]:
    """Return an estimate, and what else is random of a seed."""
    random = np.random.default_rng(seed)
    covariance = positive(random, 4)
    x, y, u, v = random.standard_normal(4).tolist()
    return Motion(3.0, x, y, u, v, PlanarCovariance(tuple(covariance[UPPER].tolist()))), random


def mean_of(motion: Motion) -> Vector:
    return np.array((motion.x, motion.y, motion.u, motion.v))


def covariance_of(motion: Motion) -> Vector:
    half = np.zeros((4, 4))
    half[UPPER] = motion.spread.upper
    return half + np.triu(half, 1).T


def positive(random: np.random.Generator, size: int) -> Vector:
    root = random.standard_normal((size, size))
    return np.asarray(root @ root.T + 0.1 * np.eye(size), dtype=np.float64)


def test_the_prediction_equals_filterpy_s(subtests: pytest.Subtests) -> None:
    for seed in range(5):
        with subtests.test(seed=seed):
            motion, random = drawn(seed)
            step = MotionStep(*random.uniform(0.1, 2.0, 5).tolist())
            axis = np.array([[1.0, step.velocity_s], [0.0, step.velocity_share]])
            noise = np.array([[step.noise_position, step.noise_cross], [step.noise_cross, step.noise_velocity]])
            mean, covariance = kalman.predict(
                mean_of(motion), covariance_of(motion), F=np.kron(axis, np.eye(2)), Q=np.kron(noise, np.eye(2))
            )

            after = predicted(motion, 3.5, step)

            assert after.time_s == 3.5
            assert mean_of(after) == pytest.approx(mean, abs=1e-9)
            assert covariance_of(after) == pytest.approx(covariance, abs=1e-9)


def test_the_update_equals_filterpy_s(subtests: pytest.Subtests) -> None:
    for seed in range(5):
        with subtests.test(seed=seed):
            motion, random = drawn(seed)
            noise, position = positive(random, 2), random.standard_normal(2)
            mean, covariance = kalman.update(mean_of(motion), covariance_of(motion), position, noise, OBSERVATION)
            off = position - mean_of(motion)[:2]
            squared = off @ np.linalg.inv(covariance_of(motion)[:2, :2] + noise) @ off

            x, y = position.tolist()
            after, innovation = updated(motion, (x, y), (noise[0, 0], noise[0, 1], noise[1, 1]))

            assert after.time_s == 3.0
            assert mean_of(after) == pytest.approx(mean, abs=1e-9)
            assert covariance_of(after) == pytest.approx(covariance, abs=1e-9)
            assert innovation.squared == pytest.approx(squared)


def test_nothing_so_far_out_stops_the_filter(subtests: pytest.Subtests) -> None:
    for far_m in [1e200, -1e308, nan]:
        with subtests.test(far_m=far_m):
            motion, _ = drawn(0)
            _, innovation = updated(motion, (0.0, far_m), (1.0, 0.0, 1.0))
            assert not innovation.squared <= 1e300


def test_a_noise_that_is_almost_a_line_leaves_a_covariance() -> None:
    still = Motion(0.0, 0.0, 0.0, 0.0, 0.0, PlanarCovariance((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0)))
    after, innovation = updated(still, (1.0, 1.0), (1e4, 1e4, 1e4))
    assert np.isfinite(mean_of(after)).all()
    assert np.isfinite(innovation.squared)
