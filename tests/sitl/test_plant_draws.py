"""The family of plants: what is drawn lies within its bounds, and control holds the worst of each kind."""

import pytest

from tests.experiments.plant_family import drawn, flown, manoeuvre

pytestmark = pytest.mark.slow


def test_a_manoeuvre_off_the_model_holds() -> None:
    assert flown(manoeuvre("axes that differ"), 150.0).holds


def test_an_oscillation_far_larger_than_expected_is_estimated_in_time() -> None:
    """Of 500 linear draws the one with most to learn: what its plant file is off by swings by 4.7 m/s²."""
    assert flown(drawn(1161, linear=True), 210.0).holds_linear
