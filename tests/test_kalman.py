"""One Kalman step against the information form, and the gate before it."""

from math import inf, nan, sqrt

import numpy as np
import pytest
from filterpy import kalman

from estimation.kalman import Belief, correct, predict
from estimation.state import Vector

OBSERVATION = np.eye(2, 4)


def random_covariance(random: np.random.Generator, size: int) -> Vector:
    root = random.standard_normal((size, size))
    return np.asarray(root @ root.T + 0.1 * np.eye(size), dtype=np.float64)


@pytest.mark.parametrize("seed", range(5))
def test_a_correction_adds_information(seed: int) -> None:
    random = np.random.default_rng(seed)
    prior = Belief(3.0, random.standard_normal(4), random_covariance(random, 4))
    measurement, noise = random.standard_normal(2), random_covariance(random, 2)
    precision = np.linalg.inv(noise)
    information = np.linalg.inv(prior.covariance) + OBSERVATION.T @ precision @ OBSERVATION
    weighted = np.linalg.solve(prior.covariance, prior.mean) + OBSERVATION.T @ precision @ measurement
    innovation = measurement - prior.mean[:2]
    squared = innovation @ np.linalg.inv(prior.covariance[:2, :2] + noise) @ innovation

    result = correct(prior, measurement, noise, gate_sigma=20.0)

    assert result.accepted
    assert result.belief.time_s == 3.0
    assert result.belief.mean == pytest.approx(np.linalg.solve(information, weighted), abs=1e-9)
    assert result.belief.covariance == pytest.approx(np.linalg.inv(information), abs=1e-9)
    assert (result.belief.covariance == result.belief.covariance.T).all()
    assert result.innovation_squared == pytest.approx(squared)


@pytest.mark.parametrize("seed", range(5))
def test_a_correction_is_that_of_filterpy(seed: int) -> None:
    random = np.random.default_rng(seed)
    prior = Belief(0.0, random.standard_normal(6), random_covariance(random, 6))
    measurement, noise = random.standard_normal(4), random_covariance(random, 4)
    mean, covariance = kalman.update(prior.mean, prior.covariance, measurement, noise, np.eye(4, 6))

    belief = correct(prior, measurement, noise, gate_sigma=20.0).belief

    assert belief.mean == pytest.approx(mean, abs=1e-9)
    assert belief.covariance == pytest.approx(covariance, abs=1e-9)


def test_a_prediction_moves_mean_and_covariance() -> None:
    random = np.random.default_rng(1)
    belief = Belief(0.0, random.standard_normal(4), random_covariance(random, 4))
    transition, noise = random.standard_normal((4, 4)), random_covariance(random, 4)
    gain, acting = random.standard_normal((4, 2)), np.array([2.0, -1.0])
    cloud = random.multivariate_normal(belief.mean, belief.covariance, 200_000)
    moved = cloud @ transition.T + gain @ acting + random.multivariate_normal(np.zeros(4), noise, len(cloud))

    after = predict(belief, 0.5, transition, noise, gain, acting)

    assert after.time_s == 0.5
    scale = np.abs(after.covariance).max()
    assert after.mean == pytest.approx(moved.mean(axis=0), abs=0.01 * sqrt(scale))
    assert after.covariance == pytest.approx(np.cov(moved.T), abs=0.02 * scale)


@pytest.mark.parametrize(("deviation", "accepted"), [(0.999, True), (1.001, False)])
def test_the_gate_closes_at_its_distance(deviation: float, accepted: bool) -> None:
    prior = Belief(0.0, np.zeros(4), np.diag([3.0, 5.0, 1.0, 1.0]))
    # Innovation covariance 4 and 6: gate_sigma scaled to two degrees of freedom, all of it in x.
    measurement = np.array([3.0 * sqrt(2.0) * sqrt(4.0) * deviation, 0.0])
    result = correct(prior, measurement, np.eye(2), gate_sigma=3.0)
    assert result.accepted is accepted
    assert (result.belief is prior) is not accepted


@pytest.mark.parametrize("wrong", [nan, inf, -inf])
def test_what_is_not_finite_leaves_the_belief_alone(wrong: float) -> None:
    prior = Belief(0.0, np.zeros(4), np.eye(4))
    result = correct(prior, np.array([0.0, wrong]), np.eye(2), gate_sigma=3.0)
    assert not result.accepted
    assert result.belief is prior
