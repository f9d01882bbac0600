"""The own filter's Kalman steps against those of filterpy."""

from math import cos, nan, sin

import numpy as np
import pytest
from filterpy import kalman

from estimation.filters.axial import AxisCovariance, AxisEstimate, Step, predicted, predicted_mean, updated
from estimation.state import Vector

OBSERVATION = np.eye(2, 5)
UPPER = np.triu_indices(5)


def drawn(seed: int) -> tuple[AxisEstimate, np.random.Generator]:
    """Return an estimate, and what else is random of a seed."""
    random = np.random.default_rng(seed)
    root = random.standard_normal((5, 5))
    covariance = root @ root.T + 0.1 * np.eye(5)
    p, v, c, s, q = random.standard_normal(5).tolist()
    return AxisEstimate((p, v, c, s, q), AxisCovariance(tuple(covariance[UPPER].tolist()))), random


def mean(axis: AxisEstimate) -> Vector:
    return np.array(axis.mean)


def covariance(axis: AxisEstimate) -> Vector:
    half = np.zeros((5, 5))
    half[UPPER] = axis.covariance.upper
    return half + np.triu(half, 1).T


def test_the_prediction_equals_filterpy_s(subtests: pytest.Subtests) -> None:
    for seed in range(5):
        with subtests.test(seed=seed):
            axis, random = drawn(seed)
            plant, disturbed, aimed = (
                random.standard_normal((2, 2)),
                random.standard_normal(2),
                random.standard_normal(2),
            )
            rotation, (pp, pv, vv, walk_c, walk_s) = 0.7, random.uniform(0.1, 1.0, 5).tolist()
            transition, noise, gain = np.zeros((5, 5)), np.zeros((5, 5)), np.zeros((5, 1))
            transition[:2, :2] = plant
            transition[:2, 2] = transition[:2, 3] = disturbed
            transition[2, 2] = 1.0
            transition[3:, 3:] = [[cos(rotation), -sin(rotation)], [sin(rotation), cos(rotation)]]
            gain[:2, 0] = aimed
            noise[:2, :2] = [[pp, pv], [pv, vv]]
            noise[2, 2], noise[3, 3], noise[4, 4] = walk_c, walk_s, walk_s
            expected = kalman.predict(
                mean(axis).reshape(-1, 1), covariance(axis), F=transition, Q=noise, u=np.array([[1.7]]), B=gain
            )
            step = Step(
                pp=plant[0, 0],
                pv=plant[0, 1],
                vp=plant[1, 0],
                vv=plant[1, 1],
                disturbed_p=disturbed[0],
                disturbed_v=disturbed[1],
                aimed_p=aimed[0],
                aimed_v=aimed[1],
                ramp_p=0.0,
                ramp_v=0.0,
                noise_pp=pp,
                noise_pv=pv,
                noise_vv=vv,
                walk_c=walk_c,
                walk_s=walk_s,
            )

            after = predicted(axis, step, (cos(rotation), sin(rotation)), 1.7)

            assert mean(after) == pytest.approx(expected[0].ravel(), abs=1e-9)
            assert covariance(after) == pytest.approx(expected[1], abs=1e-9)
            assert predicted_mean(axis, step, (cos(rotation), sin(rotation)), 1.7) == tuple(mean(after).tolist())


def test_the_update_equals_filterpy_s(subtests: pytest.Subtests) -> None:
    for seed in range(5):
        with subtests.test(seed=seed):
            axis, random = drawn(seed)
            measured, noise = random.standard_normal(2), random.uniform(0.1, 1.0, 2)
            expected = kalman.update(mean(axis), covariance(axis), measured, np.diag(noise), OBSERVATION)
            off = measured - mean(axis)[:2]
            squared_expected = off @ np.linalg.inv(covariance(axis)[:2, :2] + np.diag(noise)) @ off

            after, squared = updated(axis, measured[0], measured[1], (noise[0], noise[1]))

            assert mean(after) == pytest.approx(expected[0], abs=1e-9)
            assert covariance(after) == pytest.approx(expected[1], abs=1e-9)
            assert squared == pytest.approx(squared_expected)


def test_nothing_so_far_out_stops_the_filter(subtests: pytest.Subtests) -> None:
    for far_m in [1e200, -1e308, nan]:
        with subtests.test(far_m=far_m):
            axis, _ = drawn(0)
            _, squared = updated(axis, far_m, 0.0, (1.0, 1.0))
            assert not squared <= 1e300
