"""One page of figures of a flight: the paper's figures 1 to 6 (section 5).

Paths with the vehicles and the target, speeds in formation, radii, angular velocities and
spacings on the ring. matplotlib is imported only when a figure is drawn, and draws without a
display.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gcs.metrics.record import FlightRecord
from gcs.metrics.result import FlightResult, FormationReference, RingReference
from gcs.metrics.ring_motion import ring_motion
from gcs.report.charts.panels import Sheet, draw_paths, draw_radii, draw_rates, draw_spacings, draw_speeds, landmarks_m
from gcs.style import COLOURS, DESIRED, ENGAGED, FAINT, STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "METADATA", "STYLE", "drawn_figure", "save_figure"]

METADATA: dict[str, dict[str, None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
WIDTH_IN = 10.0


def save_figure(
    record: FlightRecord,
    result: FlightResult,
    ring: RingReference,
    path: Path,
    formation: FormationReference | None = None,
) -> "Figure":
    """Draw a flight, write it to `path`, whose suffix chooses PNG, SVG or PDF, and return it.

    `formation` adds its desired speed. Raises ValueError for any other suffix, OSError when the file cannot
    be written.
    """
    suffix = path.suffix.lower()
    if suffix not in METADATA:
        raise ValueError(f"cannot draw a figure as {path.name!r}: its name must end in {', '.join(METADATA)}")
    from matplotlib import rc_context  # noqa: PLC0415

    with rc_context(STYLE):
        figure = drawn_figure(record, result, ring, formation)
        figure.savefig(path, dpi=160, metadata=METADATA[suffix])
    return figure


def drawn_figure(
    record: FlightRecord, result: FlightResult, ring: RingReference, formation: FormationReference | None = None
) -> "Figure":
    """Return the page of figures of a flight, drawn but not written."""
    from matplotlib import rc_context  # noqa: PLC0415

    with rc_context(STYLE):
        return _draw(Sheet(record, result, ring, formation, ring_motion(record)))


def _draw(sheet: Sheet) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    span_m = np.ptp(landmarks_m(sheet), axis=0)
    map_height_in = float(np.clip(0.95 * WIDTH_IN * span_m[1] / max(span_m[0], 1e-9), 2.6, 5.2))
    figure = Figure(figsize=(WIDTH_IN, map_height_in + 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    layout = [["paths", "paths"], ["speed", "radius"], ["rate", "spacing"]]
    panels = figure.subplot_mosaic(layout, height_ratios=(map_height_in, 2.1, 2.1))  # type: ignore[arg-type]
    draw_paths(panels["paths"], sheet)
    draw_speeds(panels["speed"], sheet)
    draw_radii(panels["radius"], sheet)
    draw_rates(panels["rate"], sheet)
    draw_spacings(panels["spacing"], sheet)
    _draw_legend(figure, sheet)
    return figure


def _draw_legend(figure: "Figure", sheet: Sheet) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    tracks = enumerate(sheet.record.vehicles)
    handles = [
        *(Line2D([], [], label=f"vehicle {track.vehicle_id}", **sheet.style(row)) for row, track in tracks),
        Line2D([], [], label="target", color="black", marker="D", linewidth=1.2),
        Line2D([], [], label="desired", **DESIRED),
        Line2D([], [], label="engages", linestyle="", color=FAINT, **ENGAGED),
        Patch(label="ring metrics window", color="#DDDDDD"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 7), frameon=False)
