"""The family of plants: what is drawn lies within its bounds, and control holds the worst of each kind."""

import numpy as np
import pytest

from estimation.plant.model import Plant, PlantAxis
from tests.experiments.plant_draws import blowing, linear_relative, relative
from tests.experiments.plant_family import MANOEUVRES, drawn, flown, linear, manoeuvre

pytestmark = pytest.mark.slow

NOMINAL = Plant(PlantAxis(0.8, 0.9), PlantAxis(1.6, 1.8), 0.2)


def test_draws_fill_their_bounds_axis_by_axis_and_stay_within() -> None:
    random = np.random.default_rng(4)
    family = [relative(NOMINAL, blowing(random), random) for _ in range(400)]
    shares = np.array(
        [
            (
                each.plant.x.a0_per_s2 / 0.8,
                each.plant.x.a1_per_s / 0.9,
                each.plant.y.a0_per_s2 / 1.6,
                each.plant.y.a1_per_s / 1.8,
            )
            for each in family
        ]
    )
    assert 0.5 <= shares.min() < 0.52
    assert 1.48 < shares.max() <= 1.5
    assert np.abs(np.corrcoef(shares.T) - np.eye(4)).max() < 0.2, "each on its own"
    delays = [each.plant.delay_s for each in family]
    assert 0.0 <= min(delays) < 0.02
    assert 0.38 < max(delays) <= 0.4
    shapes = [each.imperfections.shape for each in family if each.imperfections.shape is not None]
    assert len(shapes) == len(family)
    speeds = sorted(shape.speed_m_s for shape in shapes)
    assert 2.0 <= speeds[0] < 2.2
    assert 11.8 < speeds[-1] <= 12.0
    winds = [float(np.hypot(*each.imperfections.wind_m_s)) for each in family]
    assert 7.9 < max(winds) <= 8.0
    rates = [
        each.imperfections.telemetry_timing.rate_hz
        for each in family
        if each.imperfections.telemetry_timing is not None
    ]
    assert 10.0 <= min(rates) < 11.0
    assert 49.0 < max(rates) <= 50.0


def test_the_linear_part_is_another_plant_in_a_steady_wind_and_nothing_else() -> None:
    each = linear_relative(NOMINAL, (3.0, 4.0), np.random.default_rng(1))
    assert (
        each.imperfections.shape,
        each.imperfections.gusts,
        each.imperfections.estimator_drift,
        each.imperfections.telemetry_timing,
    ) == (None, False, None, None)
    assert each.imperfections.wind_m_s == (3.0, 4.0)


def test_a_seed_is_one_draw_that_its_slowest_vehicle_can_fly() -> None:
    assert drawn(3, linear=False).family == drawn(3, linear=False).family != drawn(4, linear=False).family
    for seed in range(5):
        draw = drawn(seed, linear=False)
        ring, target = draw.mission.encirclement, draw.mission.target
        needed = abs(ring.angular_rate_rad_s) * ring.radius_m + np.hypot(*target.velocity_m_s)
        assert all(
            each.imperfections.shape is not None and needed < each.imperfections.shape.speed_m_s
            for each in draw.family.values()
        )


@pytest.mark.parametrize("name", ["axes that differ"])
def test_a_manoeuvre_off_the_model_holds(name: str) -> None:
    assert name in MANOEUVRES
    assert flown(manoeuvre(name)).holds


def test_an_oscillation_far_larger_than_expected_is_estimated_in_time() -> None:
    """Of 500 linear draws the one with most to learn: what its plant file is off by swings by 4.7 m/s²."""
    assert linear(1161).holds_linear
