"""Reynolds' figures as people read them: their words, their numbers, and a table for a terminal."""

from dataclasses import astuple

from rich.table import Table
from rich.text import Text

from gcs.metrics.result import FlockingResult, ReynoldsResult

# In the order of `FlockingResult`: what a figure is called, the same in a narrow column, and its format.
_FIGURES = (
    ("nearest other, least [m]", "nearest\nleast [m]", ".2f"),
    ("nearest other, mean [m]", "nearest\nmean [m]", ".2f"),
    ("velocity mismatch rms [m/s]", "mismatch\nrms [m/s]", ".3f"),
    ("order parameter, mean", "order\nmean", ".3f"),
    ("off the centroid, mean [m]", "centroid\nmean [m]", ".2f"),
    ("off the centroid, at most [m]", "centroid\nmax [m]", ".2f"),
)
FLOCKING_WORDS = tuple(words for words, _, _ in _FIGURES)
FLOCKING_FORMS = tuple(form for _, _, form in _FIGURES)


def flocking_cells(figures: FlockingResult) -> tuple[str, ...]:
    """Return the figures of a stretch as text, a dash for what was not measured."""
    numbers = zip(astuple(figures), FLOCKING_FORMS, strict=True)
    return tuple("–" if value is None else format(value, form) for value, form in numbers)


def stretches(result: ReynoldsResult) -> tuple[tuple[str, FlockingResult], ...]:
    """Return the stretches of a flight that have any figure, with their names."""
    named = (("formation", result.formation), ("ring", result.ring), ("flight", result.flight))
    return tuple((name, figures) for name, figures in named if figures != FlockingResult())


def reynolds_grid(result: ReynoldsResult) -> Table | None:
    """Return the figures as a table of 80 columns at most, None for a vehicle alone."""
    measured = stretches(result)
    if not measured:
        return None
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    table.add_column(Text("Reynolds'\nrules"), no_wrap=True)
    for _, name, _ in _FIGURES:
        table.add_column(Text(name), justify="right", no_wrap=True)
    for name, figures in measured:
        table.add_row(Text(name), *map(Text, flocking_cells(figures)))
    return table
