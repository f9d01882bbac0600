"""Labels and formats of Reynolds' flocking metrics, and a table of them for a terminal."""

from dataclasses import astuple

from rich.table import Table
from rich.text import Text

from gcs.metrics.result import FlockingResult, ReynoldsResult

# In the order of `FlockingResult`: label, label of a narrow column, format.
_FIGURES = (
    ("nearest other, min [m]", "nearest\nmin [m]", ".2f"),
    ("nearest other, mean [m]", "nearest\nmean [m]", ".2f"),
    ("velocity mismatch rms [m/s]", "mismatch\nrms [m/s]", ".3f"),
    ("order parameter, mean", "order\nmean", ".3f"),
    ("distance from centroid, mean [m]", "centroid\nmean [m]", ".2f"),
    ("distance from centroid, max [m]", "centroid\nmax [m]", ".2f"),
)
FLOCKING_LABELS = tuple(label for label, _, _ in _FIGURES)
FLOCKING_FORMS = tuple(form for _, _, form in _FIGURES)


def flocking_cells(figures: FlockingResult) -> tuple[str, ...]:
    """Return the metrics of a phase as text, a dash for None."""
    numbers = zip(astuple(figures), FLOCKING_FORMS, strict=True)
    return tuple("–" if value is None else format(value, form) for value, form in numbers)


def phases(result: ReynoldsResult) -> tuple[tuple[str, FlockingResult], ...]:
    """Return the phases of a flight that have any figure, with their names."""
    named = (("formation", result.formation), ("ring", result.ring), ("flight", result.flight))
    return tuple((name, figures) for name, figures in named if figures != FlockingResult())


def reynolds_grid(result: ReynoldsResult) -> Table | None:
    """Return the metrics as a table of at most 80 columns, None for a single vehicle."""
    measured = phases(result)
    if not measured:
        return None
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    table.add_column(Text("Reynolds'\nrules"), no_wrap=True)
    for _, name, _ in _FIGURES:
        table.add_column(Text(name), justify="right", no_wrap=True)
    for name, figures in measured:
        table.add_row(Text(name), *map(Text, flocking_cells(figures)))
    return table
