"""Reynolds' figures against motions for which they are known by geometry."""

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
