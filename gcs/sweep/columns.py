"""The columns of a sweep's table: the values of a flight's JSON result, each named by its path.

Metrics of vehicles and of transitions also have `.mean` and `.worst` over the team. Units are in the names. A metric
that does not apply is missing, never 0.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean

from gcs.metrics.catalogue import FLIGHT, FLOCKING, PHASES, TRANSITION, VEHICLE, VERDICTS, Metric, Worst
from gcs.metrics.result import FlightResult

Scalar = bool | int | float | str
Row = dict[str, Scalar]
"""The values of one run by column; values that do not apply are missing."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name, the type and meaning of its values, which extreme is the worst, and if a figure shows it."""

    name: str
    kind: type[Scalar]
    meaning: str
    worst: Worst | None = None
    drawn: bool = False


RUN = (
    Column("seed", int, "seed of noise, delays and losses"),
    Column("error", str, "why the run failed; a failed run has no other values"),
    Column("holds", bool, "no verdict failed, and the flight did not end early", drawn=True),
)


def _over(prefix: str, metrics: Iterable[Metric], *, mean: bool) -> Iterator[Column]:
    for each in metrics:
        if mean and each.kind is float:
            yield Column(f"{prefix}.{each.name}.mean", float, f"mean over the vehicles: {each.meaning}", each.worst)
        if each.worst is not None:
            meaning = f"worst value: {each.meaning}"
            yield Column(f"{prefix}.{each.name}.worst", each.kind, meaning, each.worst, each.drawn)


TEAM = (
    *(Column(each.name, each.kind, each.meaning, each.worst, each.drawn) for each in FLIGHT if not each.timed),
    *(Column(f"verdicts.{each.name}", bool, each.meaning) for each in VERDICTS),
    *(
        Column(f"reynolds.{phase}.{each.name}", each.kind, f"{where}: {each.meaning}", each.worst)
        for phase, where in PHASES.items()
        for each in FLOCKING
    ),
    *_over("vehicles", VEHICLE, mean=True),
    Column("transitions.count", int, "engagements; those within 3 s of each other are one"),
    *_over("transitions", TRANSITION, mean=False),
)
"""Every column of a flight but those of single vehicles."""


def columns(rows: Iterable[Row]) -> tuple[Column, ...]:
    """Return the columns of these runs, without those of the varied keys: single vehicles last, by their ids."""
    ids = {
        int(name.partition(".")[0].removeprefix("vehicle_"))
        for row in rows
        for name in row
        if name.startswith("vehicle_")
    }
    single = [
        Column(f"vehicle_{i}.{each.name}", each.kind, each.meaning, each.worst) for i in sorted(ids) for each in VEHICLE
    ]
    return (*RUN, *TEAM, *single)


def failed_verdicts(row: Row) -> list[str]:
    """Return the names of the verdicts that do not hold in a run."""
    return [each.name for each in VERDICTS if row.get(f"verdicts.{each.name}") is False]


def result_row(result: FlightResult, *, holds: bool) -> Row:
    """Return a result as a row: values that depend only on mission and seed, without wall times."""
    values = {
        "holds": holds,
        **{each.name: each.of(result) for each in FLIGHT if not each.timed},
        **{f"verdicts.{name}": held for name, held in result.verdicts.named().items()},
        **{
            f"reynolds.{phase}.{each.name}": each.of(getattr(result.reynolds, phase))
            for phase in PHASES
            for each in FLOCKING
        },
        **_condensed("vehicles", VEHICLE, result.vehicles, mean=True),
        "transitions.count": len(result.transitions),
        **_condensed("transitions", TRANSITION, result.transitions, mean=False),
        **{f"vehicle_{vehicle.id}.{each.name}": each.of(vehicle) for vehicle in result.vehicles for each in VEHICLE},
    }
    return {name: value for name, value in values.items() if value is not None}


def _condensed(prefix: str, metrics: Iterable[Metric], parts: Sequence[object], *, mean: bool) -> Row:
    """Return the mean and the worst value of each metric over the parts that have it."""
    row: Row = {}
    for each in metrics:
        known = [value for part in parts if (value := each.of(part)) is not None]
        if known and mean and each.kind is float:
            row[f"{prefix}.{each.name}.mean"] = fmean(known)
        if known and each.worst is not None:
            row[f"{prefix}.{each.name}.worst"] = max(known) if each.worst == "max" else min(known)
    return row
