"""The text of a drill: its progress, each result, and the table at the end."""

from collections.abc import Sequence

from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from gcs.drill.run import DrillRow
from gcs.metrics.json_output import json_output

_VERDICTS = {True: Text("holds", style="green"), False: Text("FAILS", style="bold red"), None: Text("-", style="dim")}

_COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("fault", "left"),
    ("expected", "left"),
    ("within [s]", "right"),
    ("after [s]", "right"),
    ("verdict", "left"),
    ("", "left"),
)


class DrillProgress:
    """Prints a line when a drill begins and one when it ends."""

    def __init__(self, console: Console, total: int) -> None:
        self._console = console
        self._total = total
        self._done = 0

    def begin(self, step: str) -> None:
        """Show the step that begins now."""
        self._console.print(f"{self._done + 1} of {self._total}: {step} ...", style="dim", highlight=False)

    def add(self, row: DrillRow) -> None:
        """Show a result."""
        self._done += 1
        verdict = _VERDICTS[row.holds].plain
        took = "" if row.measured_s is None else f" after {row.measured_s:.2f} s"
        why = f": {row.detail}" if row.detail else ""
        self._console.print(f"    {row.expected}: {verdict}{took}{why}", markup=False, highlight=False, soft_wrap=True)


def drill_table(mission: str, rows: Sequence[DrillRow]) -> Table:
    """Return all results as a table."""
    table = Table(title=f"drills of {mission}", title_justify="left", title_style="bold", box=None, pad_edge=False)
    for name, justify in _COLUMNS:
        table.add_column(name, justify=justify)
    for row in rows:
        numbers = ("-" if value is None else f"{value:.2f}" for value in (row.limit_s, row.measured_s))
        table.add_row(row.fault, row.expected, *numbers, _VERDICTS[row.holds], Text(row.detail))
    return table


def drills_json(mission: str, rows: Sequence[DrillRow]) -> str:
    """Return all results as one JSON object."""
    holds = all(row.holds is not False for row in rows)
    return json_output({"mission": mission, "holds": holds, "drills": [row.to_dict() for row in rows]})
