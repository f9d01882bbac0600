"""The result of a sweep: its table, its summary and its figure."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cordon.flight import Flight
from cordon.study import Study
from gcs.errors import InputError
from gcs.sweep.columns import PASS, RUN, Column, Row, columns, kind_of, shown
from gcs.sweep.draws import run_seed
from gcs.sweep.summary import SweepSummary

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

Table = Mapping[str, "np.ndarray[tuple[int], np.dtype[Any]]"]


@dataclass(frozen=True, eq=False, repr=False)
class SweepResult:
    """The finished runs of a sweep.

    `table` holds a numpy array (N,) for each column, with a value for each run: `mission`, `planner`, the varied keys,
    `seed`, `error`, the columns of docs/sweeps.md that have a value, and the metrics given. What does not apply is NaN,
    or "" in columns of text; columns of truth values with NaN hold 0, 1 and NaN.
    """

    table: Table
    _study: Study = field()
    _columns: tuple[Column, ...] = field()
    _rows: tuple[Row, ...] = field()
    _indexes: tuple[int, ...] = field()
    _counts: SweepSummary = field()

    @classmethod
    def of(cls, study: Study, rows: Mapping[int, Row], counts: SweepSummary) -> "SweepResult":
        """Return the result of the finished runs of a study, by their indexes."""
        indexes = sorted(rows)
        full = [_full(study, index) | rows[index] for index in indexes]
        varied = [*study.draws[0][1]]
        kinds = {key: kind_of([values[key] for _, values in study.draws]) for key in varied}
        for row in full:
            row |= {key: shown(row[key], kinds[key]) for key in varied}
        given = [
            Column("mission", str, "mission"),
            Column("planner", str, "planner"),
            *(Column(key, kinds[key], "varied value") for key in varied),
        ]
        of_flights = columns(rows.values())
        own = [Column(name, float, "metric given", drawn=True) for name in study.metrics]
        last = [] if study.series is None else [Column("series", str, "file of the run's channels")]
        known = {*(name for row in rows.values() for name in row), *(each.name for each in RUN), *study.metrics}
        all_columns = (*given, *(each for each in (*of_flights, *own, *last) if each.name in known))
        table = {each.name: _array(each, full) for each in all_columns}
        return cls(table, study, all_columns, tuple(full), tuple(indexes), counts)

    def __repr__(self) -> str:
        return f"<SweepResult of {self._counts.line}>"

    def __len__(self) -> int:
        return len(self._rows)

    def frame(self) -> "DataFrame":
        """Return the table as a pandas data frame. Raises ImportError without pandas."""
        try:
            from pandas import DataFrame  # noqa: PLC0415
        except ImportError as error:
            raise ImportError("data frames need pandas: pip install 'cordon-gcs[pandas]'") from error
        return DataFrame(dict(self.table))

    def flight(self, row: int) -> Flight:
        """Fly the run of a row of the table again, in this process."""
        return self._study.flight(self._indexes[row])

    def summary(self, by: Sequence[str] = (), metrics: Sequence[str] = ()) -> str:
        """Return a text: for each group of runs how many there are, pass and failed, and the metrics' distributions.

        `by` are columns whose values make the groups, by default mission and planner where there are several.
        `metrics` are columns, by default the given ones, without any the main ones. A cell is the median, with the 5 %
        and the 95 % quantile. Raises InputError for unknown columns.
        """
        keys = self._named(by, "by") if by else self._apart()
        wanted = self._drawn(metrics)
        groups: dict[tuple[Any, ...], list[Row]] = {}
        for row in self._rows:
            groups.setdefault(tuple(row.get(key, "") for key in keys), []).append(row)
        heads = [*keys, "runs", "pass", "failed", *(each.name for each in wanted if each.name != PASS)]
        lines = [heads]
        for values in sorted(groups):
            of_group = groups[values]
            passed, failed = (sum(map(is_so, of_group)) for is_so in (_passes, _failed))
            cells = [_quantiles(of_group, each) for each in wanted if each.name != PASS]
            lines.append([*map(_text, values), str(len(of_group)), str(passed), str(failed), *cells])
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
        )

    def plot(self, path: str | Path | None = None, over: Sequence[str] = (), metrics: Sequence[str] = ()) -> "Figure":
        """Return a matplotlib figure of metrics over a column or two; with `path`, also write a .png, .svg or .pdf.

        `over` is by default the first varied key; over one column, missions and planners are drawn apart. `metrics` are
        as for `summary`. Raises InputError for unknown columns, and if the file cannot be written.
        """
        from gcs.report.figure import write_figure  # noqa: PLC0415 - matplotlib
        from gcs.sweep.figure import Picture, sweep_figure  # noqa: PLC0415

        axes = self._named(over, "over") if over else [*self._study.draws[0][1], *self._apart(), "seed"][:1]
        if len(axes) > 2:
            raise InputError([f"over: at most two columns (given: {', '.join(axes)})"])
        apart = [key for key in self._apart() if key not in axes]
        title = f"{', '.join(self._study.missions)}: {self._counts.line}"
        figure = sweep_figure(Picture(title, self._drawn(metrics), tuple(axes), self._rows, tuple(apart)))
        if path is not None:
            try:
                write_figure(figure, Path(path))
            except (OSError, ValueError) as error:
                raise InputError([f"plot: {path}: {error}"]) from error
        return figure

    def _apart(self) -> list[str]:
        """Return the columns that tell flights of one draw apart."""
        study = self._study
        return [name for name, every in (("mission", study.missions), ("planner", study.planners)) if len(every) > 1]

    def _drawn(self, metrics: Sequence[str]) -> tuple[Column, ...]:
        numbers = {each.name: each for each in self._columns if each.kind is not str}
        if metrics:
            return tuple(numbers[name] for name in self._named(metrics, "metrics", tuple(numbers)))
        own = [each for each in numbers.values() if each.name in self._study.metrics]
        return tuple(own or [each for each in numbers.values() if each.drawn])

    def _named(self, given: Sequence[str], argument: str, known: Sequence[str] = ()) -> list[str]:
        """Return the names of columns; raises InputError for those that there are not."""
        names = [given] if isinstance(given, str) else [*given]
        known = known or [*self.table]
        faults = []
        for name in names:
            if name not in known:
                near = ", ".join(difflib.get_close_matches(name, known))
                hint = f"did you mean {near}?" if near else "`table` has them"
                kind = "numeric " if argument == "metrics" else ""
                faults.append(f"{argument}: the table has no {kind}column {name!r}; {hint}")
        if faults:
            raise InputError(faults)
        return names


def _full(study: Study, index: int) -> Row:
    mission, planner, number, values = study.case(index)
    return {"mission": mission, "planner": planner, **values, "seed": run_seed(study.seed, number)}


def _array(column: Column, rows: Sequence[Row]) -> "np.ndarray[tuple[int], np.dtype[Any]]":
    values = [row.get(column.name) for row in rows]
    if column.kind is str:
        return np.array(["" if value is None else value for value in values], dtype=np.str_)
    if any(value is None for value in values):
        return np.array([np.nan if value is None else float(value) for value in values])
    return np.array(values, dtype=column.kind)


def _passes(row: Row) -> bool:
    return row.get(PASS) is True


def _failed(row: Row) -> bool:
    return "error" in row


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _quantiles(rows: Sequence[Row], metric: Column) -> str:
    known = [float(row[metric.name]) for row in rows if metric.name in row]
    if not known:
        return "–"
    low, median, high = np.quantile(known, (0.05, 0.5, 0.95))
    return f"{median:.3g} [{low:.3g}, {high:.3g}]"
