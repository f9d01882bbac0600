"""One flight of an experiment that draws flights by seeds: what was measured, its limits, and what misses them."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple, TypeVar


class Measure(NamedTuple):
    """A quantity of a flight and its limit: the largest value that it may have, or the least if it is `at_least`."""

    name: str
    value: float
    limit: float
    unit: str = ""
    at_least: bool = False

    @property
    def is_missed(self) -> bool:
        """Whether the value is beyond the limit, or not a number."""
        return not (self.value >= self.limit if self.at_least else self.value <= self.limit)

    @property
    def text(self) -> str:
        """It as text: "radius 0.047 m"."""
        return f"{self.name} {self.value:.4g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Judged:
    """The flight of a seed: what flew, the worst of each quantity, and what else is wrong with it."""

    seed: int
    about: str
    measures: tuple[Measure, ...]
    faults: tuple[str, ...] = ()

    @property
    def reasons(self) -> list[str]:
        """What misses its limit."""
        return [each.text for each in self.measures if each.is_missed] + list(self.faults)

    def value(self, name: str) -> float:
        """Return the measure of a name."""
        return next(each.value for each in self.measures if each.name == name)

    def __str__(self) -> str:
        measured = ", ".join(each.text for each in self.measures)
        missed = f"; misses: {'; '.join(self.reasons)}" if self.reasons else ""
        return f"seed {self.seed}: {self.about}: {measured}{missed}"


Flown = TypeVar("Flown", bound=Judged)


def judged_flights(
    measured: Callable[[int], Flown], first: int, count: int, *, workers: int | None = None, listed: bool = True
) -> list[Flown]:
    """Fly so many seeds from the first on, on all cores or with so many processes, and print each flight if `listed`.

    In the end the worst of each quantity is printed, and the flights that miss a limit.
    """
    flights = []
    with ProcessPoolExecutor(workers) as pool:
        for flight in pool.map(measured, range(first, first + count)):
            flights.append(flight)
            if listed:
                print(flight, flush=True)
    for worst in _worst(chain.from_iterable(each.measures for each in flights)):
        print(f"{worst.text} at {'least' if worst.at_least else 'most'}")
    missed = [each for each in flights if each.reasons]
    print(f"{len(missed)} of {count} miss a limit")
    print(*(f"  seed {each.seed}: {'; '.join(each.reasons)}" for each in missed), sep="\n", flush=True)
    return flights


def _worst(measures: Iterable[Measure]) -> Sequence[Measure]:
    found: dict[str, Measure] = {}
    for each in measures:
        before = found.setdefault(each.name, each)
        if (each.value < before.value) if each.at_least else (each.value > before.value):
            found[each.name] = each
    return list(found.values())
