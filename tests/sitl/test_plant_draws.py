"""The family of plants: what is drawn lies within its bounds, and control holds the worst of each kind."""

import pytest

from tests.experiments.plant_family import MANOEUVRES, flown, linear, manoeuvre

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["axes that differ"])
def test_a_manoeuvre_off_the_model_holds(name: str) -> None:
    assert name in MANOEUVRES
    assert flown(manoeuvre(name)).holds


def test_an_oscillation_far_larger_than_expected_is_estimated_in_time() -> None:
    """Of 500 linear draws the one with most to learn: what its plant file is off by swings by 4.7 m/s²."""
    assert linear(1161).holds_linear
