"""The table of a sweep, one row for each run in the order of the plan, as Parquet. Equal rows give equal bytes."""

import io
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gcs.errors import InputError
from gcs.sweep.columns import Column, Row, Scalar, columns
from gcs.sweep.plan import SweepPlan

if TYPE_CHECKING:
    import pyarrow

MISSING = "a sweep's table needs pyarrow; install it by: pip install 'cordon-gcs[sweep]'"


def require_pyarrow() -> None:
    """Raise InputError if pyarrow is not installed."""
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415
    except ImportError as error:
        raise InputError([MISSING]) from error


def full_rows(plan: SweepPlan, rows: Mapping[int, Row]) -> list[Row]:
    """Return the finished runs in the order of the plan, each with its varied values and its seed."""
    kinds = {each.place: _kind(each.values) for each in plan.variations}
    return [
        {
            **{place: _shown(value, kinds[place]) for place, value in run.values.items()},
            "seed": run.seed,
            **rows[run.index],
        }
        for run in plan.runs
        if run.index in rows
    ]


def table_columns(plan: SweepPlan, rows: Sequence[Row]) -> tuple[Column, ...]:
    """Return the columns of a sweep's table: first the varied keys, by their paths in the mission."""
    varied = [Column(each.place, _kind(each.values), "varied value") for each in plan.variations]
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


def _kind(values: Sequence[Any]) -> type[Scalar]:
    """Return the type of a varied key's column: that of its values; float for mixed numbers; otherwise text."""
    kinds = {type(value) for value in values}
    if kinds == {int, float}:
        return float
    return kinds.pop() if len(kinds) == 1 and kinds <= {bool, int, float, str} else str


def _shown(value: Any, kind: type[Scalar]) -> Scalar:
    """Return a varied value converted to its column's type: arrays, tables and mixed values as JSON."""
    return value if isinstance(value, kind) else kind(value) if kind is float else json.dumps(value)


def _arrow(kind: type[Scalar]) -> "pyarrow.DataType":
    import pyarrow  # noqa: PLC0415

    types = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    return types[kind]
