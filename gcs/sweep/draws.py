"""Draws of varied values: from ranges by a design of experiments, of lists, or all combinations.

Every run has a seed for the flight, and random numbers of its own for what is drawn beside the mission's values.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import exp, isfinite, log
from typing import Any, Literal, get_args

import numpy as np

from gcs.errors import InputError
from gcs.mission.mission import Mission

Sampling = Literal["sobol", "lhs", "random", "grid"]
OWN = "draw."
"""The prefix of varied values that are no keys of the mission."""
RUNS_MAX = 100_000


@dataclass(frozen=True, slots=True)
class Range:
    """Numbers from `low` to `high`, drawn uniformly, or uniformly in their logarithm."""

    low: float
    high: float
    logarithmic: bool = False

    def at(self, share: float) -> float:
        """Return the number at a share of the range from 0 to 1."""
        if self.logarithmic:
            return exp(log(self.low) + share * (log(self.high) - log(self.low)))
        return self.low + share * (self.high - self.low)


@dataclass(frozen=True, slots=True)
class Draw:
    """One run, for functions that draw its plants and events.

    `mission` has the varied values, and `values` are those by their keys, also those that begin with `draw.`. `random`
    gives the same numbers in the runs of one `seed`, whatever their mission and planner.
    """

    mission: Mission
    values: Mapping[str, Any]
    seed: int
    random: np.random.Generator


Vary = Mapping[str, Range | Sequence[Any]] | Sequence[Mapping[str, Any]]


def drawn_values(vary: object, sampling: object, runs: object, seed: object) -> list[tuple[int, dict[str, Any]]]:
    """Return the number of the seed and the varied values of each draw, in order.

    A design has a seed for each draw; of combinations, and of draws that are given, each has `runs` seeds. Raises
    InputError with every fault.
    """
    if not isinstance(runs, int) or isinstance(runs, bool) or not 1 <= runs <= RUNS_MAX:
        raise InputError([f"runs: it must be a whole number from 1 to {RUNS_MAX} (given: {runs!r})"])
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise InputError([f"seed: it must be a whole number, not negative (given: {seed!r})"])
    if not isinstance(sampling, str) or sampling not in get_args(Sampling):
        raise InputError([f"sampling: it must be one of {', '.join(get_args(Sampling))} (given: {sampling!r})"])
    if isinstance(vary, Sequence) and not isinstance(vary, str):
        if not vary or not all(isinstance(each, Mapping) and each.keys() == vary[0].keys() for each in vary):
            raise InputError(["vary: give mappings with the same keys, such as [{'encirclement.radius_m': 12.0}, ...]"])
        return [(number, _plain(values)) for values in vary for number in range(runs)]
    if not isinstance(vary, Mapping):
        raise InputError([f"vary: {vary!r}: give a mapping, such as {{'encirclement.radius_m': cordon.Range(8, 14)}}"])
    if faults := [fault for key, values in vary.items() for fault in _faults(key, values, sampling)]:
        raise InputError(faults)
    if sampling == "grid":
        every = product(*(values for values in vary.values() if not isinstance(values, Range)))
        return [(number, _plain(dict(zip(vary, values, strict=True)))) for values in every for number in range(runs)]
    shares = _shares(len(vary), sampling, runs, seed)
    return [
        (number, _plain({key: _at(values, share) for (key, values), share in zip(vary.items(), row, strict=True)}))
        for number, row in enumerate(shares.tolist())
    ]


def run_seed(seed: int, number: int) -> int:
    """Return the seed of the flights of a run."""
    return int(np.random.SeedSequence((seed, number)).generate_state(1)[0])


def random_of(seed: int, number: int, stream: int) -> np.random.Generator:
    """Return the random numbers of a run for one of several functions."""
    return np.random.default_rng(np.random.SeedSequence((seed, number), spawn_key=(stream,)))


def _shares(keys: int, sampling: str, runs: int, seed: int) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Return shares from 0 to 1 (runs, keys)."""
    if keys == 0:
        return np.empty((runs, 0))
    if sampling == "random":
        return np.random.default_rng(seed).random((runs, keys))
    from scipy.stats import qmc  # noqa: PLC0415 - slow to import

    random = np.random.default_rng(seed)
    if sampling == "lhs":
        return np.asarray(qmc.LatinHypercube(keys, seed=random).random(runs))
    # Whole powers of two are balanced; the first `runs` of one are what the sequence gives.
    return np.asarray(qmc.Sobol(keys, seed=random).random_base2((runs - 1).bit_length())[:runs])


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values without types of numpy, which a mission does not hold."""
    return {
        key: value.tolist() if isinstance(value, np.generic | np.ndarray) else value for key, value in values.items()
    }


def _at(values: Range | Sequence[Any], share: float) -> Any:
    if isinstance(values, Range):
        return values.at(share)
    return values[min(int(share * len(values)), len(values) - 1)]


def _faults(key: object, values: object, sampling: str) -> Iterator[str]:
    """Return the faults of one varied key."""
    of = f"vary: {key!r}"
    if not isinstance(key, str):
        yield f"{of}: give a key of the mission, such as 'encirclement.radius_m'"
    elif isinstance(values, Range):
        if sampling == "grid":
            yield f"{of}: sampling='grid' takes lists of values, not {values}"
        if not (isfinite(values.low) and isfinite(values.high) and values.low < values.high):
            yield f"{of}: {values}: low must be less than high, and both finite"
        elif values.logarithmic and values.low <= 0.0:
            yield f"{of}: {values}: a logarithmic range begins above 0"
    elif not isinstance(values, Sequence | np.ndarray) or isinstance(values, str) or len(values) == 0:
        yield f"{of}: {values!r}: give a cordon.Range, or a list of values"
