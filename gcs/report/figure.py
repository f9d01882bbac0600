"""The paper's figures 1 to 6 (section 5) of a flight: all on one page, or one alone.

Paths with the vehicles and the target, speeds in formation, radii, angular velocities and
spacings on the ring. matplotlib is imported only when a figure is drawn, and draws without a
display.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcs.keys.private_files import create
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import DesiredRing, FormationReference
from gcs.metrics.result import FlightResult
from gcs.report.charts.panels import (
    Sheet,
    draw_paths,
    draw_radii,
    draw_rates,
    draw_spacings,
    draw_speeds,
    landmarks_m,
    map_height_in,
    sheet_of,
)
from gcs.style import COLOURS, DESIRED, ENGAGED, FAINT, STYLE, drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "METADATA", "STYLE", "drawn_figure", "save_figure"]

METADATA: dict[str, dict[str, None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
_DRAWS = {
    "paths": draw_paths,
    "speed": draw_speeds,
    "radius": draw_radii,
    "rate": draw_rates,
    "spacing": draw_spacings,
}
_OF_A_RING = ("radius", "rate", "spacing")
_PAGE = (("paths", "paths"), ("speed", "radius"), ("rate", "spacing"))
PANELS = {1: ("paths",), 2: ("speed",), 3: ("radius", "rate"), 4: ("paths",), 5: ("radius", "rate"), 6: ("spacing",)}
"""By the number of a figure in the paper, its panels from the top. 1 to 3 are of case 1 there, 4 to 6 of case 2."""
_PAGE_WIDTH_IN, _FIGURE_WIDTH_IN = 10.0, 7.0
_PANEL_HEIGHT_IN = 2.1
_LEGEND_HEIGHT_IN, _TITLE_HEIGHT_IN = 0.5, 0.75


def save_figure(
    record: FlightRecord,
    result: FlightResult,
    rings: Sequence[DesiredRing],
    path: Path,
    formation: FormationReference | None = None,
    number: int | None = None,
) -> "Figure":
    """Draw a flight over these rings, write it to `path`, whose suffix chooses PNG, SVG or PDF, and return it.

    `formation` adds its desired speed. `number` draws this figure of the paper alone. Raises ValueError for any other
    suffix, OSError when the file cannot be written.
    """
    figure = drawn_figure(record, result, rings, formation, number)
    write_figure(figure, path)
    return figure


def write_figure(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG, SVG or PDF. Raises ValueError for any other suffix, OSError when that fails."""
    suffix = path.suffix.lower()
    if suffix not in METADATA:
        raise ValueError(f"cannot draw a figure as {path.name!r}: its name must end in {', '.join(METADATA)}")
    with drawing(), create(path) as file:
        figure.savefig(file, format=suffix[1:], dpi=160, metadata=METADATA[suffix])


def drawn_figure(
    record: FlightRecord,
    result: FlightResult,
    rings: Sequence[DesiredRing],
    formation: FormationReference | None = None,
    number: int | None = None,
) -> "Figure":
    """Return the page of figures of a flight, or one figure of the paper alone, drawn but not written."""
    with drawing():
        return _draw(sheet_of(record, result, rings, formation), number)


def _draw(sheet: Sheet, number: int | None) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    width_in = _PAGE_WIDTH_IN if number is None else _FIGURE_WIDTH_IN
    rows = _rows(len(sheet.rings), number)
    heights_in = [
        map_height_in(landmarks_m(sheet), width_in) if ("paths", 0) in row else _PANEL_HEIGHT_IN for row in rows
    ]
    height_in = sum(heights_in) + _TITLE_HEIGHT_IN * len(rows) + _LEGEND_HEIGHT_IN
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    mosaic: list[Any] = [[f"{name} {ring}" for name, ring in row] for row in rows]
    panels = figure.subplot_mosaic(mosaic, height_ratios=heights_in)
    for name, ring in dict.fromkeys(each for row in rows for each in row):
        axes = panels[f"{name} {ring}"]
        _DRAWS[name](axes, sheet.each_ring[ring] if name in _OF_A_RING else sheet)
        if sheet.rings and number is None and name in _OF_A_RING:
            axes.set_title("", loc="right")  # three in a row have no room for it beside the ring's name
    _draw_legend(figure, sheet, columns=7 if number is None else 4)
    return figure


def _rows(rings: int, number: int | None) -> list[tuple[tuple[str, int], ...]]:
    """Return the panels of each row, with the number of the ring that each shows; those of several rings in turn."""
    if rings < 2:
        names = _PAGE if number is None else tuple((name,) for name in PANELS[number])
        return [tuple((name, 0) for name in row) for row in names]
    if number is None:
        of_rings = [tuple((name, ring) for name in _OF_A_RING for _ in range(2)) for ring in range(rings)]
        return [(("paths", 0),) * 6, (("speed", 0),) * 6, *of_rings]
    return [((name, ring),) for name in PANELS[number] for ring in range(rings if name in _OF_A_RING else 1)]


def _draw_legend(figure: "Figure", sheet: Sheet, columns: int) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    handles = [
        *(Line2D([], [], **sheet.style(row)) for row in range(len(sheet.record.vehicles))),
        Line2D([], [], label="target", color="black", marker="D", linewidth=1.2),
        Line2D([], [], label="desired", **DESIRED),
        Line2D([], [], label="engages", linestyle="", color=FAINT, **ENGAGED),
        Patch(label="ring metrics window", color="#DDDDDD"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), columns), frameon=False)
