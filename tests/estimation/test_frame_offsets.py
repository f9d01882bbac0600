"""Offsets between vehicles' frames, from sightings of a common target, against simulated truth."""

from math import exp, hypot, sqrt

import numpy as np
import pytest

from estimation.filters.position_wander import FrameOffsets
from estimation.state import Sighting, Vector

PERIOD_S, SIGMA_M, CORRELATION_S, NOISE_M = 0.2, 0.25, 20.0, 0.3
REFERENCE_M = 0.1
"""Error of the place where the target is predicted to be, of which the filter is told."""


def sighting(time_s: float, sensor_id: int, x: float, y: float, noise_m: float = NOISE_M) -> Sighting:
    return Sighting(time_s, sensor_id, (x, y), (noise_m**2, 0.0, noise_m**2), 0.8, 0.2, None, 1.0)


class Watched:
    """A target at the origin, seen by sensors whose frames wander, some of them blind for a while."""

    def __init__(self, sigmas_m: dict[int, float], seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.sigmas_m = sigmas_m
        self.true_m = {sensor: sigma * self.random.standard_normal(2) for sensor, sigma in sigmas_m.items()}
        self.reference_m = REFERENCE_M * self.random.standard_normal(2)
        self.offsets = FrameOffsets()
        self.time_s = 0.0

    def step(self, blind: tuple[int, ...] = ()) -> None:
        self.time_s += PERIOD_S
        kept = exp(-PERIOD_S / CORRELATION_S)
        for sensor, sigma_m in self.sigmas_m.items():
            push = sigma_m * sqrt(1.0 - kept**2) * self.random.standard_normal(2)
            self.true_m[sensor] = kept * self.true_m[sensor] + push
        quick = exp(-PERIOD_S / 1.0)
        self.reference_m = quick * self.reference_m + REFERENCE_M * sqrt(1.0 - quick**2) * self.random.standard_normal(
            2
        )
        seen = [sensor for sensor in self.sigmas_m if sensor not in blind]
        for sensor in seen:
            if self.sigmas_m[sensor] > 0.0:
                self.offsets.set_error_model(sensor, self.sigmas_m[sensor], CORRELATION_S)
        self.offsets.predict(self.time_s, REFERENCE_M**2)
        for sensor in seen:
            x, y = (self.true_m[sensor] + NOISE_M * self.random.standard_normal(2)).tolist()
            self.offsets.see(sighting(self.time_s, sensor, x, y), (self.reference_m[0], self.reference_m[1]))

    def estimate(self, sensor: int) -> Vector:
        return np.array(self.offsets.offset_m(sensor))


def test_differences_of_drifting_frames_are_estimated_consistently_and_their_sum_is_unchanged() -> None:
    watched, errors, offsets = Watched({1: SIGMA_M, 2: SIGMA_M, 3: SIGMA_M}, 1), [], []
    for step in range(6000):
        watched.step()
        if step > 100:
            estimates = {sensor: watched.estimate(sensor) for sensor in (1, 2, 3)}
            errors.append(estimates[1] - estimates[2] - watched.true_m[1] + watched.true_m[2])
            offsets.append(watched.true_m[1] - watched.true_m[2])
            assert np.abs(sum(estimates.values())).max() < 1e-9
    stated_m = sqrt(2.0 * watched.offsets.variance_m2(1))
    found_m = float(np.sqrt(np.mean(np.square(errors))))
    assert found_m < 0.45 * np.sqrt(np.mean(np.square(offsets)))
    assert 0.7 * found_m < stated_m < 1.4 * found_m


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_variances_of_offset_and_common_shift_are_those_of_the_errors_of_places(count: int) -> None:
    watched, errors = Watched(dict.fromkeys(range(1, count + 1), SIGMA_M), 4), []
    for step in range(9000):
        watched.step()
        if step > 100:
            errors.append(watched.estimate(1) - watched.true_m[1])
    variance_m2 = watched.offsets.variance_m2(1) + watched.offsets.shift_variance_m2
    assert np.mean(np.square(errors)) == pytest.approx(variance_m2, rel=0.25)


def test_a_frame_that_does_not_wander_fixes_the_others() -> None:
    watched, errors = Watched({1: SIGMA_M, 2: SIGMA_M, 1000: 0.0}, 2), []
    for step in range(6000):
        watched.step()
        if step > 100:
            errors.append([watched.estimate(sensor) - watched.true_m[sensor] for sensor in (1, 2)])
    assert np.sqrt(np.mean(np.square(errors))) < 0.13
    assert 1000 not in watched.offsets
    assert watched.offsets.offset_m(1000) == (0.0, 0.0)


def test_a_frame_with_a_small_error_has_more_weight() -> None:
    watched, errors = Watched({1: SIGMA_M, 2: 0.02}, 3), []
    for step in range(6000):
        watched.step()
        if step > 100:
            errors.append(watched.estimate(1) - watched.true_m[1])
    assert np.sqrt(np.mean(np.square(errors))) < 0.14


def test_the_offset_of_a_blind_sensor_decays_and_its_variance_grows() -> None:
    watched = Watched({1: SIGMA_M, 2: SIGMA_M, 3: SIGMA_M}, 4)
    for _ in range(500):
        watched.step()
    before, sure_m2, moves = watched.estimate(1), watched.offsets.variance_m2(1), []
    for _ in range(round(60.0 / PERIOD_S)):
        last = watched.estimate(1)
        watched.step(blind=(1,))
        moves.append(hypot(*(watched.estimate(1) - last)))
    assert max(moves) < 0.05
    assert 3.0 * sure_m2 < watched.offsets.variance_m2(1) <= SIGMA_M**2
    assert np.linalg.norm(watched.estimate(1)) < np.linalg.norm(before) + 0.15


def test_outliers_do_not_move_an_offset() -> None:
    watched = Watched({1: SIGMA_M, 2: SIGMA_M}, 5)
    for _ in range(100):
        watched.step()
    before = watched.estimate(1)
    watched.offsets.see(sighting(watched.time_s, 1, 8.0, 0.0), (0.0, 0.0))
    assert watched.estimate(1) == pytest.approx(before)
