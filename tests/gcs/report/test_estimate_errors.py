"""Errors of beliefs against beliefs that are off by known amounts."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.state import Vector
from gcs.metrics.record import FlightRecord, LoopStatistics, VehicleTrack
from gcs.report.evidence.estimate_errors import EstimateError, consistency, own_errors, target_errors
from gcs.report.evidence.flight import EstimateSeries, VehicleEvidence
from gcs.report.sections import consistency_note

TIME_S = np.arange(101) / 10.0
TARGET_M = np.column_stack((35.0 + 0.5 * TIME_S, -5.0 - 0.2 * TIME_S))
OFFSETS_M = ((0.3, 0.0), (0.0, -0.6), (-0.3, 0.3))


def belief(place_m: Vector, time_s: Vector = TIME_S) -> EstimateSeries:
    return EstimateSeries(time_s, np.hstack((place_m, np.zeros_like(place_m))), np.full((time_s.size, 4), 0.1))


def flight(*vehicles: VehicleEvidence) -> FlightRecord:
    tracks = (
        VehicleTrack(each.vehicle_id, TARGET_M, np.zeros_like(TARGET_M), np.full(TIME_S.size, "formation"))
        for each in vehicles
    )
    loop, still = LoopStatistics(10.0, 0, 0), np.zeros_like(TARGET_M)
    return FlightRecord("off", 0, "simulation", "truth", TIME_S, TARGET_M, still, tuple(tracks), loop, 1.0)


def off_by(vehicle_id: int, offset_m: tuple[float, float]) -> VehicleEvidence:
    return VehicleEvidence(vehicle_id, belief(TARGET_M + offset_m), belief(TARGET_M + offset_m))


TEAM = tuple(off_by(index + 1, offset_m) for index, offset_m in enumerate(OFFSETS_M))


def test_where_there_is_a_truth_the_error_is_the_distance_to_it() -> None:
    _, errors = target_errors(flight(*TEAM), TEAM)
    assert [tuple(each.error_m.mean(axis=0).round(9).tolist()) for each in errors] == list(OFFSETS_M)
    own = own_errors(flight(*TEAM), TEAM)
    assert [tuple(each.error_m.mean(axis=0).round(9).tolist()) for each in own] == list(OFFSETS_M)
    assert own[0].sigma_m == pytest.approx(np.full((TIME_S.size, 2), 0.1))


def test_a_belief_between_two_samples_of_the_truth_is_held_against_the_truth_between_them() -> None:
    between_s = TIME_S[:-1] + 0.037
    exact_m = np.column_stack((35.0 + 0.5 * between_s, -5.0 - 0.2 * between_s))
    (error,) = target_errors(flight(TEAM[0]), (VehicleEvidence(1, target=belief(exact_m, between_s)),))[1]
    assert error.error_m == pytest.approx(np.zeros((between_s.size, 2)), abs=1e-12)


def test_without_a_truth_nobody_is_told_how_wrong_it_was_about_itself() -> None:
    unknown = replace(flight(*TEAM), reference="estimate")
    assert own_errors(unknown, TEAM) == []
    assert "record" in target_errors(unknown, TEAM)[0]


def test_estimates_beside_the_truth_are_not_what_errors_are_taken_from() -> None:
    true = flight(*TEAM)
    tracks = tuple(replace(track, position_m=track.position_m + 9.0) for track in true.vehicles)
    own = own_errors(replace(true, estimates=tracks), TEAM)
    assert [tuple(each.error_m.mean(axis=0).round(9).tolist()) for each in own] == list(OFFSETS_M)


def test_where_nobody_knows_the_target_each_is_held_against_the_others() -> None:
    blind = replace(flight(*TEAM), reference="estimate", target_position_m=np.full_like(TARGET_M, np.nan))
    reference, errors = target_errors(blind, TEAM)
    assert "other vehicles" in reference
    for row, error in enumerate(errors):
        others = np.mean([OFFSETS_M[other] for other in range(3) if other != row], axis=0)
        assert error.error_m == pytest.approx(np.tile(OFFSETS_M[row] - others, (TIME_S.size, 1)))


def test_one_that_does_not_know_of_the_target_yet_is_no_part_of_the_others_mean() -> None:
    blind = replace(flight(*TEAM), target_position_m=np.full_like(TARGET_M, np.nan))
    later = VehicleEvidence(3, target=belief(TARGET_M[60:] + OFFSETS_M[2], TIME_S[60:]))
    error = target_errors(blind, (*TEAM[:2], later))[1][0]
    assert error.error_m[59] == pytest.approx(np.subtract(OFFSETS_M[0], OFFSETS_M[1]))
    assert error.error_m[60] == pytest.approx(np.subtract(OFFSETS_M[0], np.mean(OFFSETS_M[1:], axis=0)))


@pytest.mark.parametrize(
    ("times", "within", "nees", "optimistic", "pessimistic"),
    [
        (1.0, 0.9973, 2.0, False, False),
        (2.0, 0.8664, 8.0, True, False),  # within 1.5 standard deviations
        (0.5, 1.0, 0.5, False, True),
    ],
)
def test_errors_are_judged_by_the_covariance_that_claims_them(
    times: float, within: float, nees: float, optimistic: bool, pessimistic: bool
) -> None:
    error_m = np.random.default_rng(3).normal(0.0, 0.1 * times, (40_000, 2))
    error_m[:7] = np.nan
    found = consistency(EstimateError(0, np.arange(40_000.0), error_m, np.full(error_m.shape, 0.1)))
    assert found is not None
    assert found.within == pytest.approx(within, abs=0.003)
    assert found.nees == pytest.approx(nees, rel=0.03)
    assert (found.is_optimistic, found.is_pessimistic) == (optimistic, pessimistic)


def test_a_table_that_contradicts_a_consistent_filter_is_explained() -> None:
    def errors(row: int, times: float) -> EstimateError:
        error_m = np.random.default_rng(row).normal(0.0, 0.1 * times, (5000, 2))
        return EstimateError(row, np.arange(5000.0), error_m, np.full(error_m.shape, 0.1))

    said = consistency_note("own", [errors(0, 1.0), errors(1, 3.0)], [4, 7], true=True)
    assert "vehicle 7" in said
    assert "3.0 times" in said
    assert "vehicle 4" not in said
    assert "reference" in consistency_note("target", [errors(0, 3.0)], [4], true=False)
    assert "too large" in consistency_note("target", [errors(0, 0.3)], [4], true=True)
    assert consistency_note("own", [errors(0, 1.0)], [4], true=True) == ""
