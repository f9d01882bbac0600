"""Random numbers one by one, drawn from their generator in blocks: one draw costs as much as a block of ten."""

from collections.abc import Iterator

import numpy as np

AHEAD = 256


def normals(random: np.random.Generator, ahead: int = AHEAD) -> Iterator[float]:
    """Yield standard normal numbers, the same for any `ahead`.

    With `ahead = 1` nothing is drawn in advance, which keeps the order with other draws from the generator.
    """
    while True:
        yield from random.standard_normal(ahead).tolist()


def uniforms(random: np.random.Generator) -> Iterator[float]:
    """Yield uniform numbers in [0, 1)."""
    while True:
        yield from random.random(AHEAD).tolist()
