"""The true tracks: straight flights whose samples are lost, late, out of order or no numbers."""

import numpy as np
import pytest

from estimation.state import Vector
from gcs.metrics.journal import missing_truth, true_track
from gcs.metrics.record import VehicleTrack
from sitl.server.record import TruthTrack

START_S = 1_700_000_000.0
TIME_S = np.arange(201) / 10.0
GRID_S = START_S + TIME_S
SLOPE_M_S = np.array([0.4, -0.2])


def truth(time_s: Vector) -> TruthTrack:
    """A straight flight, sampled at times since the start."""
    still = np.zeros((time_s.size, 1))
    position_m = np.hstack((time_s[:, None] * SLOPE_M_S, still + 8.0))
    return TruthTrack(1, START_S + time_s, position_m, np.hstack((np.tile(SLOPE_M_S, (time_s.size, 1)), still)))


def estimated(vehicle_id: int = 1, flown: Vector = TIME_S) -> VehicleTrack:
    unknown = np.full((TIME_S.size, 2), np.nan)
    return VehicleTrack(vehicle_id, unknown, unknown, np.where(np.isin(TIME_S, flown), "encircle", "unknown"))


def missing(sampled: TruthTrack | None, track: VehicleTrack | None = None) -> str:
    known = {} if sampled is None else {1: sampled}
    return missing_truth([track or estimated()], known, TIME_S, GRID_S)


ALL_S = np.arange(-1.03, 21.05, 0.1)


def without(begin_s: float, end_s: float) -> Vector:
    return ALL_S[(begin_s - 0.01 > ALL_S) | (end_s + 0.01 < ALL_S)]


def test_the_true_track_is_the_flight_between_its_samples_with_the_tactics_of_the_estimates() -> None:
    random = np.random.default_rng(1)
    for time_s in (ALL_S, ALL_S + random.uniform(-0.05, 0.05, ALL_S.size), ALL_S[::4], random.permutation(ALL_S)):
        track = true_track(estimated(flown=TIME_S[50:]), truth(time_s), GRID_S)
        np.testing.assert_allclose(track.position_m, TIME_S[:, None] * SLOPE_M_S, atol=1e-6)
        np.testing.assert_allclose(track.velocity_m_s, np.tile(SLOPE_M_S, (TIME_S.size, 1)), atol=1e-9)
        assert track.target is None
        assert list(track.tactic[48:52]) == ["unknown", "unknown", "encircle", "encircle"]
        assert missing(truth(time_s)) == ""


def test_a_message_lost_now_and_then_is_no_gap_and_a_second_without_any_is(subtests: pytest.Subtests) -> None:
    for time_s, expected in (
        (without(5.0, 5.7), None),
        (without(5.0, 6.4), "from 5.5 s to 6.0 s"),
        (without(12.0, 30.0), "from 12.5 s on"),
        (without(-1.0, 3.9), "from 0.0 s to 3.5 s"),
        (np.empty(0), "no ground truth of vehicle 1"),
    ):
        with subtests.test(expected=expected):
            told = missing(truth(time_s))
            assert (told == "") if expected is None else (expected in told)
    assert "vehicle 1" in missing(None)
    joins = estimated(flown=TIME_S[TIME_S > 3.95])
    assert missing(truth(without(-1.0, 3.9)), joins) == "", "nothing is missing before it was in the flight"


def test_numbers_that_are_none_are_gaps() -> None:
    broken = truth(ALL_S)
    broken.position_m[(ALL_S > 4.95) & (ALL_S < 6.55), 0] = np.nan
    assert "from 5.4 s" in missing(broken)
    broken.position_m[:, 0] = np.inf
    assert "vehicle 1" in missing(broken)


def test_before_the_first_sample_and_after_the_last_one_no_place_is_claimed() -> None:
    sampled = truth(ALL_S[(ALL_S > 0.25) & (ALL_S < 19.75)])
    assert missing(sampled) == ""  # too short for a gap
    known = np.isfinite(true_track(estimated(), sampled, GRID_S).position_m).all(axis=1)
    assert TIME_S[known][[0, -1]] == pytest.approx([0.3, 19.6])
    assert known.sum() == 194
