"""Reynolds' figures against motions for which they are known by geometry."""

from dataclasses import astuple
from math import pi, sin, tau

import numpy as np
import pytest

from estimation.state import Vector
from gcs.metrics.record import FlightRecord, LoopStatistics, VehicleTrack
from gcs.metrics.reynolds import condensed, flocking

TIME_S = np.arange(400) / 10.0


def record(*motions: tuple[Vector, Vector]) -> FlightRecord:
    tracks = (
        VehicleTrack(index + 1, place_m, velocity_m_s, np.full(TIME_S.size, "formation"))
        for index, (place_m, velocity_m_s) in enumerate(motions)
    )
    still = np.zeros((TIME_S.size, 2))
    loop = LoopStatistics(10.0, 0, 0)
    return FlightRecord("flock", 0, "simulation", "truth", TIME_S, still, still, tuple(tracks), loop, 1.0)


def straight(start_m: tuple[float, float], velocity_m_s: tuple[float, float]) -> tuple[Vector, Vector]:
    velocity = np.tile(np.array(velocity_m_s, dtype=float), (TIME_S.size, 1))
    return np.array(start_m) + TIME_S[:, None] * velocity, velocity


def around(phase_rad: float, radius_m: float, rate_rad_s: float) -> tuple[Vector, Vector]:
    angle = phase_rad + rate_rad_s * TIME_S
    place_m = radius_m * np.column_stack((np.cos(angle), np.sin(angle)))
    return place_m, radius_m * rate_rad_s * np.column_stack((-np.sin(angle), np.cos(angle)))


def test_a_line_abreast_is_aligned_and_as_wide_as_it_is() -> None:
    figures = flocking(record(*(straight((0.0, y), (0.2, 0.0)) for y in (5.0, 0.0, -7.0))))
    assert figures.nearest_m[:, 0] == pytest.approx([5.0, 5.0, 7.0])
    assert figures.mismatch_m_s == pytest.approx(np.zeros((3, TIME_S.size)), abs=1e-12)
    assert figures.order == pytest.approx(np.ones(TIME_S.size))
    centre_m = -2.0 / 3.0
    assert figures.off_centre_m[:, -1] == pytest.approx([5.0 - centre_m, -centre_m, 7.0 + centre_m])


def test_on_an_even_ring_the_chords_are_equal_and_the_directions_cancel_out(subtests: pytest.Subtests) -> None:
    for count in [2, 3, 5, 16]:
        with subtests.test(count=count):
            radius_m, rate_rad_s = 10.0, 0.05
            figures = flocking(record(*(around(index * tau / count, radius_m, rate_rad_s) for index in range(count))))
            assert figures.nearest_m == pytest.approx(np.full((count, TIME_S.size), 2.0 * radius_m * sin(pi / count)))
            assert figures.mismatch_m_s == pytest.approx(np.full((count, TIME_S.size), radius_m * rate_rad_s))
            assert figures.order == pytest.approx(np.zeros(TIME_S.size), abs=1e-12)
            assert figures.off_centre_m == pytest.approx(np.full((count, TIME_S.size), radius_m))


def test_one_of_three_that_flies_the_other_way_leaves_a_third_of_the_order() -> None:
    ways = ((0.0, 0.5), (0.0, 2.0), (0.0, -1.0))  # the speeds do not matter, only the ways
    figures = flocking(record(*(straight((9.0 * x, 0.0), way) for x, way in enumerate(ways))))
    assert figures.order == pytest.approx(np.full(TIME_S.size, 1.0 / 3.0))
    assert figures.mismatch_m_s[:, 0] == pytest.approx([0.0, 1.5, 1.5])


def test_one_that_stands_still_has_no_direction() -> None:
    ways = ((0.2, 0.0), (0.2, 0.0), (-0.001, 0.001))
    figures = flocking(record(*(straight((9.0 * x, 0.0), way) for x, way in enumerate(ways))))
    assert figures.order == pytest.approx(np.ones(TIME_S.size))


def test_one_that_is_not_heard_counts_for_nobody() -> None:
    motions = [straight((0.0, y), (0.2, 0.0)) for y in (0.0, 3.0, 100.0)]
    for column in motions[1]:
        column[100:200] = np.nan
    figures = flocking(record(*motions))
    assert figures.nearest_m[0, [99, 150, 200]] == pytest.approx([3.0, 100.0, 3.0])
    assert figures.off_centre_m[0, 150] == pytest.approx(50.0)
    assert np.isnan(figures.nearest_m[1, 150])
    assert np.isnan(figures.mismatch_m_s[1, 150])


def test_one_alone_is_no_flock() -> None:
    figures = flocking(record(straight((0.0, 0.0), (0.2, 0.0))))
    assert all(np.isnan(each).all() for each in astuple(figures))
    assert astuple(condensed(figures, TIME_S >= 0.0)) == (None,) * 6


def test_the_numbers_condense_a_stretch() -> None:
    """Two vehicles fly apart by 2 m each second from 4 m on; nothing after 10 s counts."""
    figures = flocking(record(straight((-2.0, 0.0), (-1.0, 0.0)), straight((2.0, 0.0), (1.0, 0.0))))
    numbers = condensed(figures, TIME_S <= 10.0)
    assert numbers.separation_min_m == pytest.approx(4.0)
    assert numbers.separation_mean_m == pytest.approx(14.0)
    assert numbers.alignment_error_rms_m_s == pytest.approx(1.0)
    assert numbers.alignment_order_mean == pytest.approx(0.0)
    assert numbers.cohesion_mean_m == pytest.approx(7.0)
    assert numbers.cohesion_max_m == pytest.approx(12.0)
