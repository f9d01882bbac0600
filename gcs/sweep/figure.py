"""The figure of a sweep: its metrics over one varied key with their spread, or over two as maps."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gcs.keys.private_files import create
from gcs.report.figure import METADATA
from gcs.style import COLOURS, FAINT, INK, drawing
from gcs.sweep.columns import PASS, Column, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ACROSS = 3
_PANEL_IN = (4.2, 2.9)
_CELLS_WITH_TEXT = 120
_MAP_COLOURS = "cividis"
_INVALID: dict[str, Any] = {"facecolor": "#E4E4E4"}
_LACKING: dict[str, Any] = {"fill": False, "hatch": "////", "edgecolor": FAINT}
_UNJUDGED: dict[str, Any] = {
    "color": FAINT,
    "linestyle": (0, (4, 2)),
    "marker": "x",
    "markersize": 4.0,
    "linewidth": 1.2,
}


@dataclass(frozen=True, slots=True)
class Picture:
    """The content of the figure: a title, the metrics, and the finished runs over one key or two."""

    title: str
    metrics: tuple[Column, ...]
    over: tuple[str, ...]
    rows: Sequence[Row]

    def places(self, key: str) -> list[Any]:
        """Return the values of a key: numbers sorted, others in order of appearance."""
        values = list(dict.fromkeys(row[key] for row in self.rows))
        return sorted(values) if all(map(_is_number, values)) else values

    def groups(self, metric: Column) -> Mapping[tuple[Any, ...], Any]:
        """Return the values of a metric by the values of the keys, without runs that lack it.

        Beside runs that were judged, one that could not be judged is one that does not pass.
        """
        groups = {}
        for place, flown in self._flown().items():
            known = [float(row[metric.name]) for row in flown if metric.name in row]
            if known:
                unjudged = len(flown) - len(known) if metric.name == PASS else 0
                groups[place] = np.array(known + unjudged * [0.0])
        return groups

    def invalid(self) -> list[tuple[Any, ...]]:
        """Return the values of the keys with which no run has a result: no valid mission, or an error."""
        return [place for place, flown in self._flown().items() if not flown]

    def lacking(self, metric: Column) -> Mapping[tuple[Any, ...], float]:
        """Return the share of the runs with a result that lack a metric, or were not judged, by the keys, where > 0."""
        shares = {
            place: sum(metric.name not in row for row in flown) / len(flown)
            for place, flown in self._flown().items()
            if flown
        }
        return {place: share for place, share in shares.items() if share}

    def _flown(self) -> Mapping[tuple[Any, ...], list[Row]]:
        """Return the runs with a result by the values of the keys."""
        flown: dict[tuple[Any, ...], list[Row]] = {}
        for row in self.rows:
            of_place = flown.setdefault(tuple(row[key] for key in self.over), [])
            if "error" not in row:
                of_place.append(row)
        return flown


def save_sweep_figure(picture: Picture, path: Path) -> None:
    """Draw a sweep and write it to `path`, whose suffix chooses PNG, SVG or PDF; raises OSError."""
    count = len(picture.metrics)
    across, down = min(_ACROSS, count), ceil(count / _ACROSS)
    with drawing():
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
        from matplotlib.figure import Figure  # noqa: PLC0415

        figure = Figure(figsize=(_PANEL_IN[0] * across, _PANEL_IN[1] * down + 0.7), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(down, across, squeeze=False).ravel()
        for axes, metric in zip(panels, picture.metrics, strict=False):
            axes.set_title("runs that pass" if metric.name == PASS else metric.name, loc="left", fontsize=9.0)
            (_draw_map if len(picture.over) == 2 else _draw_spread)(axes, picture, metric)
        for axes in panels[count:]:
            axes.set_axis_off()
        _draw_words(figure, picture)
        suffix = path.suffix.lower()
        with create(path) as file:
            figure.savefig(file, format=suffix[1:], dpi=130, metadata=METADATA[suffix])


def _draw_spread(axes: "Axes", picture: Picture, metric: Column) -> None:
    """Draw every run, the median, and the interquartile range of the runs, over one key."""
    (key,) = picture.over
    places = picture.places(key)
    is_scale = all(map(_is_number, places))
    groups = picture.groups(metric)
    at_of = {place: place if is_scale else index for index, place in enumerate(places)}
    known = [(at, groups[place,]) for place, at in at_of.items() if (place,) in groups]
    axes.set_xlabel(key)
    half = min(np.diff(sorted(at_of.values())), default=1.0) / 2.0
    for (place,) in picture.invalid():
        axes.axvspan(at_of[place] - half, at_of[place] + half, linewidth=0.0, zorder=0, **_INVALID)
    if not is_scale:
        axes.set_xticks(range(len(places)), [str(place) for place in places])
        axes.set_xlim(-0.5, len(places) - 0.5)
    x = [at for at, _ in known]
    line: dict[str, Any] = {"color": COLOURS[0], "marker": "o", "markersize": 3.5, "linewidth": 1.4}
    if metric.kind is bool:
        axes.plot(x, [100.0 * values.mean() for _, values in known], **line)
        if metric.name == PASS and (unjudged := picture.lacking(metric)):
            flown = [place for place in places if (place,) not in picture.invalid()]
            shares = [100.0 * unjudged.get((place,), 0.0) for place in flown]
            axes.plot([at_of[place] for place in flown], shares, **_UNJUDGED)
        axes.set_ylim(-4.0, 104.0)
        axes.set_ylabel("fraction of the runs [%]")
        return
    if not known:
        return
    quartiles = np.array([np.percentile(values, (25, 50, 75)) for _, values in known]).T
    axes.fill_between(x, quartiles[0], quartiles[2], color=COLOURS[0], alpha=0.18, linewidth=0.0)
    for at, values in known:
        axes.plot(np.full(values.size, at), values, ".", color=FAINT, markersize=3.0, alpha=0.6, zorder=1)
    axes.plot(x, quartiles[1], **line)


def _draw_map(axes: "Axes", picture: Picture, metric: Column) -> None:
    """Draw the median of a metric over two keys; for a verdict, the fraction of the runs that pass.

    Values without a valid mission are grey; hatched are those with runs that were not judged, or lack the metric.
    """
    columns, lines = (picture.places(key) for key in picture.over)
    is_share = metric.kind is bool
    cells = np.full((len(lines), len(columns)), np.nan)
    for (column, line), values in picture.groups(metric).items():
        value = 100.0 * values.mean() if is_share else np.median(values)
        cells[lines.index(line), columns.index(column)] = value
    limits: dict[str, Any] = {"vmin": 0.0, "vmax": 100.0} if is_share else {}
    axes.grid(visible=False)
    drawn = axes.imshow(cells, origin="lower", aspect="auto", cmap=_MAP_COLOURS, **limits)
    axes.figure.colorbar(drawn, ax=axes, label="fraction of the runs [%]" if is_share else "median")
    for set_ticks, places in ((axes.set_xticks, columns), (axes.set_yticks, lines)):
        step = ceil(len(places) / 12)
        set_ticks(range(0, len(places), step), [str(place) for place in places[::step]])
    axes.set_xlabel(picture.over[0])
    axes.set_ylabel(picture.over[1])
    for marked, style in ((picture.invalid(), _INVALID), ([*picture.lacking(metric)], _LACKING)):
        _mark_cells(axes, [(columns.index(column), lines.index(line)) for column, line in marked], style)
    if cells.size <= _CELLS_WITH_TEXT:
        _write_cells(axes, cells, *drawn.get_clim())


def _mark_cells(axes: "Axes", cells: Iterable[tuple[int, int]], style: Mapping[str, Any]) -> None:
    from matplotlib.patches import Rectangle  # noqa: PLC0415

    for column, line in cells:
        axes.add_patch(Rectangle((column - 0.5, line - 0.5), 1.0, 1.0, linewidth=0.0, **style))


def _write_cells(axes: "Axes", cells: Any, least: float, most: float) -> None:
    """Write the values into their cells, in a contrasting colour on a scale from `least` to `most`."""
    for (line, column), value in np.ndenumerate(cells):
        if np.isfinite(value):
            colour = "black" if value > (least + most) / 2.0 else "white"
            axes.text(column, line, f"{value:.3g}", color=colour, ha="center", va="center", fontsize=7.5)


def _draw_words(figure: "Figure", picture: Picture) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    figure.suptitle(picture.title, x=0.01, ha="left", fontsize=10.5, color=INK)
    is_map, handles = len(picture.over) == 2, []
    lacking = [metric for metric in picture.metrics if picture.lacking(metric)]
    if not is_map:
        handles = [
            Line2D([], [], label="median", color=COLOURS[0], marker="o", markersize=3.5),
            Patch(label="interquartile range of the runs", color=COLOURS[0], alpha=0.18),
            Line2D([], [], label="a run", linestyle="", marker=".", color=FAINT),
        ]
        if any(metric.name == PASS for metric in lacking):
            handles.append(Line2D([], [], label="runs not judged", **_UNJUDGED))
    elif lacking:
        handles.append(Patch(label="with runs not judged, or without this value", linewidth=0.0, **_LACKING))
    if picture.invalid():
        handles.append(Patch(label="no valid mission, or an error", **_INVALID))
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=len(handles), frameon=False)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
