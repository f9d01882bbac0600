"""The nearest point in half-planes and a disc, against a general solver."""

from math import pi

import numpy as np
import pytest

from agents.safety.half_planes import HalfPlane, nearest
from tests.support.solver import slsqp

Pair = tuple[float, float]


@pytest.mark.parametrize("seed", range(60))
def test_the_nearest_point_in_half_planes_is_what_slsqp_finds(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(0, 12))
    turns = random.uniform(-pi, pi, count)
    normals = np.column_stack([np.cos(turns), np.sin(turns)])
    least, wanted = random.uniform(-5.0, 1.0, count), random.normal(0.0, 5.0, 2)
    planes = [HalfPlane((x, y), bound) for (x, y), bound in zip(normals.tolist(), least.tolist(), strict=True)]
    point = nearest((float(wanted[0]), float(wanted[1])), 6.0, planes)
    expected = slsqp(wanted, 6.0, normals, least)
    if expected is None:
        assert point is None
    else:
        assert point == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("planes", "point"),
    [
        ([], (4.0, 3.0)),
        ([((1.0, 0.0), 6.0)], None),
        ([((1.0, 0.0), 1.0), ((-1.0, 0.0), -0.5)], None),
        ([((1.0, 0.0), 4.5), ((1.0, 0.0), 4.2)], (4.5, (25.0 - 4.5**2) ** 0.5)),
        ([((-1.0, 0.0), -1.0), ((0.0, -1.0), -2.0)], (1.0, 2.0)),
    ],
)
def test_points_in_half_planes_by_name(planes: list[tuple[Pair, float]], point: Pair | None) -> None:
    found = nearest((8.0, 6.0), 5.0, [HalfPlane(normal, least) for normal, least in planes])
    assert found is None if point is None else found == pytest.approx(point)
