"""Consistency against chance: innovations as expected keep the authority, larger ones lower it."""

import numpy as np
import pytest

from estimation.filters.own import AUTHORITY_LEAST, Consistency

MOST = 25.0


def watched(scale: float, seconds: float = 30.0, period_s: float = 0.05) -> Consistency:
    consistency, random = Consistency(), np.random.default_rng(8)
    for _ in range(round(seconds / period_s)):
        consistency.see(float(np.mean((scale * random.standard_normal(4)) ** 2)), period_s, MOST)
    return consistency


def test_innovations_as_expected_keep_full_authority() -> None:
    right = watched(1.0)
    assert 1.0 < right.innovation < 2.5, "it rises faster than it falls"
    assert right.authority == 1.0


def test_the_larger_the_errors_the_lower_the_authority() -> None:
    shares = [watched(scale).authority for scale in (1.0, 1.8, 2.2, 2.6, 8.0)]
    assert shares == sorted(shares, reverse=True)
    assert (shares[0], shares[-1]) == (1.0, AUTHORITY_LEAST)
    assert AUTHORITY_LEAST < shares[2] < 1.0


def test_authority_falls_fast_and_recovers_slowly() -> None:
    consistency = watched(1.0)
    for _ in range(60):
        consistency.see(20.0, 0.05, MOST)
    assert consistency.authority < 0.2
    for _ in range(60):
        consistency.see(1.0, 0.05, MOST)
    assert consistency.authority < 0.7
    for _ in range(600):
        consistency.see(1.0, 0.05, MOST)
    assert consistency.authority == 1.0


def test_one_outlier_at_any_distance_has_little_effect(subtests: pytest.Subtests) -> None:
    for squared in [1e9, float("inf"), float("nan")]:
        with subtests.test(squared=squared):
            consistency = watched(1.0)
            consistency.see(squared, 0.05, MOST)
            assert consistency.innovation < 3.0
            assert consistency.authority == 1.0
