"""Thinned lines against what must not get lost of them: ends, peaks and gaps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs.report.charts.panels import thinned, thinned_path

POINTS = st.integers(8, 200)
VALUES = st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=900).map(np.array)


@settings(max_examples=40)
@given(VALUES, POINTS)
def test_a_thinned_line_keeps_its_ends_and_extremes(values: np.ndarray, points: int) -> None:
    time_s = np.arange(values.size) / 20.0
    kept_s, kept = thinned(time_s, values, points)
    assert kept.size <= max(points, 8)
    assert (np.diff(kept_s) > 0.0).all()
    samples = np.rint(kept_s * 20.0).astype(int)
    assert np.array_equal(values[samples], kept, equal_nan=True)
    assert samples[0] == 0
    assert samples[-1] == values.size - 1
    if np.isfinite(values).any():
        assert np.nanmax(kept) == np.nanmax(values)
        assert np.nanmin(kept) == np.nanmin(values)


def test_a_gap_stays_a_gap(subtests: pytest.Subtests) -> None:
    """Between the last point before the gap and the first after it there is a NaN, however many are left out."""
    for width in [1, 500]:
        with subtests.test(width=width):
            values = np.ones(12000)
            values[6000 : 6000 + width] = np.nan
            kept_s, kept = thinned(np.arange(12000.0), values, 300)
            inside = (kept_s >= 6000) & (kept_s < 6000 + width)
            assert np.isnan(kept[inside]).any()
            assert np.isfinite(kept[~inside]).all()


def test_a_thinned_path_keeps_its_outermost_points() -> None:
    angle = np.linspace(0.0, 40.0, 20000)
    path_m = np.column_stack(((10.0 + angle) * np.cos(angle), (10.0 + angle) * np.sin(angle)))
    path_m[777] = (300.0, -1.0)
    path_m[778] = (1.0, -400.0)
    kept_m = thinned_path(path_m, 1200)
    assert len(kept_m) <= 1200
    assert np.array_equal(kept_m.max(axis=0), path_m.max(axis=0))
    assert np.array_equal(kept_m.min(axis=0), path_m.min(axis=0))
    assert np.array_equal(kept_m[[0, -1]], path_m[[0, -1]])
    assert np.array_equal(thinned_path(kept_m, 1200), kept_m)
