"""The wandering estimator against what a Gauss-Markov process and a Poisson process have to look like."""

from math import exp

import numpy as np
import pytest

from estimation.state import Vector
from sitl.vehicle.imperfections import EstimatorDrift, EstimatorDriftModel


def drifted(model: EstimatorDriftModel, step_s: float, steps: int, seed: int = 3) -> Vector:
    drift = EstimatorDrift(model, np.random.default_rng(seed))
    return np.array([drift.error_m(step_s * step) for step in range(steps)])


def test_the_error_has_its_deviation_and_correlation_time() -> None:
    step_s = 9.0
    errors = drifted(EstimatorDriftModel(0.25, 20.0), step_s, 40000)
    assert np.std(errors, axis=0) == pytest.approx([0.25, 0.25], rel=0.05)
    for lag in (1, 5):
        kept = np.mean(errors[:-lag] * errors[lag:]) / np.var(errors)
        assert kept == pytest.approx(exp(-lag * step_s / 20.0), abs=0.05)
    assert np.mean(errors[:, 0] * errors[:, 1]) / np.var(errors) == pytest.approx(0.0, abs=0.05)


def test_jumps_have_the_given_size_and_interval_in_any_direction() -> None:
    errors = drifted(EstimatorDriftModel(0.0, 1e9, jumps_every_s=50.0, jump_m=1.0), 0.5, 100000)
    steps = np.diff(errors, axis=0)
    jumps = steps[np.hypot(*steps.T) > 0.1]
    single = jumps[np.abs(np.hypot(*jumps.T) - 1.0) < 1e-6]
    assert len(single) == pytest.approx(50000.0 / 50.0, rel=0.1)
    assert len(single) > 0.97 * len(jumps), "two in one step are rare"
    assert np.abs(single.mean(axis=0)).max() < 0.1


def test_a_jump_fades_as_all_of_the_error_does() -> None:
    errors = drifted(EstimatorDriftModel(0.0, 20.0, jumps_every_s=400.0), 1.0, 4000)
    sizes = np.hypot(*errors.T)
    first = int(np.flatnonzero(sizes > 0.0)[0])
    assert sizes[first] == pytest.approx(1.0)
    assert sizes[first + 10] == pytest.approx(exp(-0.5), rel=1e-6)


def test_the_same_time_is_the_same_error_and_a_seed_one_wander() -> None:
    drift = EstimatorDrift(EstimatorDriftModel(0.5), np.random.default_rng(0))
    assert drift.error_m(3.0) == drift.error_m(3.0) != drift.error_m(3.1)
    np.testing.assert_array_equal(
        drifted(EstimatorDriftModel(0.5), 1.0, 20), drifted(EstimatorDriftModel(0.5), 1.0, 20)
    )


def test_an_earlier_error_is_the_one_that_there_was() -> None:
    drift = EstimatorDrift(EstimatorDriftModel(0.5), np.random.default_rng(0))
    errors = [drift.error_m(0.1 * step) for step in range(60)]
    assert [drift.earlier_error_m(0.1 * step) for step in range(60)] == errors
    assert drift.earlier_error_m(3.05) == errors[30]
