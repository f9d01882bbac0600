"""Filters with other parameters as a table for a terminal and as JSON data."""

from dataclasses import asdict
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gcs.console.table_view import number
from gcs.replay.estimates import FilterFigures
from gcs.replay.what_if import WhatIf

_COLUMNS = (
    "NIS/dof\n",
    "refused\n",
    "prediction\nrms [m]",
    "error\nrms [m]",
    "difference\nrms [m]",
    "difference\n[m/s]",
)


def what_if_view(what: WhatIf) -> RenderableType:
    """Return the filters side by side for a terminal."""
    lines = [Text(f"{change.key}: {change.recorded} -> {change.tried}", style="bold") for change in what.changes]
    if not lines:
        return Text("no parameter changed: the values are those of the flight", style="yellow")
    gaps = [Text(f"{gap}: the filters continue without them", style="yellow") for gap in what.gaps]
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    for name in ("", "filter", ""):
        table.add_column(name, no_wrap=True)
    for name in _COLUMNS:
        table.add_column(Text(name, justify="right"), justify="right", no_wrap=True)
    for each in what.outcomes:
        table.add_row(str(each.vehicle_id), each.filter, "recorded", *_cells(each.recorded))
        difference = number(each.difference_m, ".4f"), number(each.difference_m_s, ".4f")
        table.add_row("", "", "tried", *_cells(each.tried), *difference, style="cyan")
    return Group(*lines, *gaps, table)


def what_if_dict(what: WhatIf) -> dict[str, Any]:
    """Return the same as plain data."""
    return {
        "changes": {change.key: {"recorded": change.recorded, "tried": change.tried} for change in what.changes},
        "filters": [asdict(each) for each in what.outcomes],
        "gaps": list(what.gaps),
    }


def _cells(figures: FilterFigures) -> tuple[str, ...]:
    return (
        number(figures.nis, ".3f"),
        number(figures.refused, ".2%"),
        number(figures.prediction_m, ".4f"),
        number(figures.error_m, ".4f"),
    )
