"""The plant's step on numbers against the same step on matrices, and draws one by one against blocks."""

from itertools import islice

import numpy as np

from estimation.plant.model import Plant, PlantAxis, exact_step
from sitl.draws import normals, uniforms
from sitl.vehicle.plant_step import NumericStep


def test_a_step_on_numbers_is_that_on_matrices_to_the_last_bits() -> None:
    random = np.random.default_rng(0)
    for step_s in (0.02, 0.1, 0.037):
        for _ in range(200):
            plant = Plant(PlantAxis(*random.uniform(0.2, 3.0, 2)), PlantAxis(*random.uniform(0.2, 3.0, 2)))
            motion, aim, push = random.normal(0.0, 30.0, 4), random.normal(0.0, 30.0, 2), random.normal(0.0, 1.0, 2)

            numbers = NumericStep(plant, step_s).advance(
                tuple(motion.tolist()), tuple(aim.tolist()), tuple(push.tolist())
            )

            expected = exact_step(plant, step_s).advance(motion, aim, push)
            np.testing.assert_allclose(numbers, expected, rtol=1e-14, atol=1e-14)


def test_numbers_drawn_ahead_are_those_drawn_one_by_one() -> None:
    for ahead in (1, 7, 256):
        one_by_one, drawn = np.random.default_rng(5), normals(np.random.default_rng(5), ahead)
        assert list(islice(drawn, 600)) == [one_by_one.standard_normal() for _ in range(600)]
    one_by_one = np.random.default_rng(6)
    assert list(islice(uniforms(np.random.default_rng(6)), 600)) == [one_by_one.random() for _ in range(600)]


def test_nothing_is_drawn_ahead_of_other_draws_where_none_is_wanted() -> None:
    mixed, plain = np.random.default_rng(7), np.random.default_rng(7)
    drawn = normals(mixed, 1)
    for _ in range(20):
        assert next(drawn) == plain.standard_normal()
        assert mixed.random() == plain.random()
