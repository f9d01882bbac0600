"""The columns of a sweep's table: the values of a flight's JSON result, each named by its path.

Metrics of vehicles and of transitions also have `.mean` and `.worst` over the team. Units are in the names. A metric
that does not apply is missing, never 0.
"""

import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Any

from gcs.errors import InputError
from gcs.metrics.catalogue import FLIGHT, FLOCKING, ON_RING, PHASES, TRANSITION, VEHICLE, VERDICTS, Metric, Worst
from gcs.metrics.result import FlightResult
from gcs.sweep.plan import SweepPlan

if TYPE_CHECKING:
    import pyarrow


Scalar = bool | int | float | str
Row = dict[str, Scalar]
"""The values of one run by column; values that do not apply are missing."""
PASS = "holds"
"""The column of whether a run passes."""


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
    Column(PASS, bool, "the run passes; missing if it could not be judged", drawn=True),
)


def _over(prefix: str, metrics: Iterable[Metric], *, mean: bool) -> Iterator[Column]:
    for each in metrics:
        if mean and each.kind is float:
            yield Column(f"{prefix}.{each.name}.mean", float, f"mean over the vehicles: {each.meaning}", each.worst)
        if each.worst is not None:
            meaning = f"worst: {each.meaning}"
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
    """Return the names of the verdicts that fail in a run."""
    return [each.name for each in VERDICTS if row.get(f"verdicts.{each.name}") is False]


def result_row(result: FlightResult) -> Row:
    """Return a result as a row: values that depend only on mission and seed, without wall times.

    With several rings the ring metrics of the team are those of each vehicle on each ring that it was on.
    """
    values = {
        PASS: False if result.ended_early else result.passes,
        **{each.name: each.of(result) for each in FLIGHT if not each.timed},
        **{f"verdicts.{name}": held for name, held in result.verdicts.named().items()},
        **{
            f"reynolds.{phase}.{each.name}": each.of(getattr(result.reynolds, phase))
            for phase in PHASES
            for each in FLOCKING
        },
        **_condensed("vehicles", VEHICLE, result.vehicles, mean=True),
        **_condensed("vehicles", ON_RING, [each for ring in result.rings for each in ring.result.vehicles], mean=True),
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


MISSING = "a sweep's table needs pyarrow; install it by: pip install 'cordon-gcs[sweep]'"


def require_pyarrow() -> None:
    """Raise InputError if pyarrow is not installed."""
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415
    except ImportError as error:
        raise InputError([MISSING]) from error


def full_rows(plan: SweepPlan, rows: Mapping[int, Row]) -> list[Row]:
    """Return the finished runs in the order of the plan, each with its varied values and its seed."""
    kinds = {each.place: kind_of(each.values) for each in plan.variations}
    return [
        {
            **{place: shown(value, kinds[place]) for place, value in run.values.items()},
            "seed": run.seed,
            **rows[run.index],
        }
        for run in plan.runs
        if run.index in rows
    ]


def table_columns(plan: SweepPlan, rows: Sequence[Row]) -> tuple[Column, ...]:
    """Return the columns of a sweep's table: first the varied keys, by their paths in the mission."""
    varied = [Column(each.place, kind_of(each.values), "varied value") for each in plan.variations]
    return (*varied, *columns(rows))


def table_bytes(plan: SweepPlan, rows: Mapping[int, Row]) -> bytes:
    """Return the table of the finished runs as a Parquet file; the bytes depend on the version of pyarrow."""
    import pyarrow.parquet  # noqa: PLC0415

    full = full_rows(plan, rows)
    columns = table_columns(plan, full)
    fields = [pyarrow.field(each.name, _arrow(each.kind), metadata={"meaning": each.meaning}) for each in columns]
    arrays = [pyarrow.array([row.get(each.name) for row in full], type=_arrow(each.kind)) for each in columns]
    content = io.BytesIO()
    table = pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))
    pyarrow.parquet.write_table(table, content, version="2.6", compression="snappy", row_group_size=65_536)
    return content.getvalue()


def kind_of(values: Sequence[Any]) -> type[Scalar]:
    """Return the type of a varied key's column: that of its values; float for mixed numbers; otherwise text."""
    kinds = {type(value) for value in values}
    if kinds == {int, float}:
        return float
    return kinds.pop() if len(kinds) == 1 and kinds <= {bool, int, float, str} else str


def shown(value: Any, kind: type[Scalar]) -> Scalar:
    """Return a varied value converted to its column's type: arrays, tables and mixed values as JSON."""
    return value if isinstance(value, kind) else kind(value) if kind is float else json.dumps(value)


def _arrow(kind: type[Scalar]) -> "pyarrow.DataType":
    import pyarrow  # noqa: PLC0415

    types = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    return types[kind]
