"""The figure of a sweep: its metrics over one varied key with their spread, or over two as maps.

Of a key whose values are drawn, each run has its own: neighbours are then taken together, about equally many each.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gcs.keys.private_files import create
from gcs.report.figure import METADATA
from gcs.style import COLOURS, FAINT, INK, drawing
from gcs.sweep.columns import PASS, Column, Row

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ACROSS = 3
_PANEL_IN = (4.2, 2.9)
_DRAWN_FROM, _RUNS_EACH = 24, 3
"""A key with more values, and fewer runs of each value in the mean, is one whose values are drawn."""
_CHARACTER_EM = 0.62
"""The width of a character, rather too wide."""
_TITLE_PT, _CELL_PT, _TICK_PT = 9.0, 7.5, 8.0
_TEXTS_IN, _SCALE_IN = 0.9, 1.6
"""The widths that texts beside a map have at most, and that its scale and names need."""
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
    """The content of the figure: a title, the metrics, and the finished runs over one key or two.

    Over one key, runs with different values of the keys `apart` are drawn apart.
    """

    title: str
    metrics: tuple[Column, ...]
    over: tuple[str, ...]
    rows: Sequence[Row]
    apart: tuple[str, ...] = ()

    def parts(self) -> Mapping[str, "Picture"]:
        """Return the pictures of the runs that are drawn apart, by their values; one without a name of all runs."""
        rows: dict[str, list[Row]] = {}
        for row in self.rows:
            rows.setdefault(", ".join(str(row[key]) for key in self.apart), []).append(row)
        return {name: replace(self, rows=of_part, apart=()) for name, of_part in rows.items()}

    def together(self) -> "Picture":
        """Return the picture with the runs at places of several runs each, where the values of a key are drawn."""
        rows = [dict(row) for row in self.rows]
        for key in self.over:
            places = self.places(key)
            is_drawn = len(places) > _DRAWN_FROM and len(rows) < _RUNS_EACH * len(places)
            if key == "seed" or not is_drawn or not all(map(_is_number, places)):
                continue
            values = np.array([row[key] for row in rows], dtype=float)
            count = min(isqrt(len(rows) // 2), 12 if len(self.over) == 1 else 8)
            at = np.searchsorted(np.quantile(values, np.linspace(0.0, 1.0, count + 1)[1:-1]), values, side="right")
            middles = {index: float(np.median(values[at == index])) for index in set(at.tolist())}
            for row, index in zip(rows, at.tolist(), strict=True):
                row[key] = middles[index]
        return replace(self, rows=rows)

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

    def flown(self) -> list[tuple[Any, ...]]:
        """Return the values of the keys with which a run has a result."""
        return [place for place, flown in self._flown().items() if flown]

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
    figure = sweep_figure(picture)
    suffix = path.suffix.lower()
    with drawing(), create(path) as file:
        figure.savefig(file, format=suffix[1:], dpi=130, metadata=METADATA[suffix])


def sweep_figure(picture: Picture) -> "Figure":
    """Return the figure of a sweep."""
    count = len(picture.metrics)
    across, down = min(_ACROSS, count), ceil(count / _ACROSS)
    width_in = _PANEL_IN[0] * max(across, 2)
    height_in = max(_PANEL_IN[1], _map_height_in(picture) + 1.4) if len(picture.over) == 2 else _PANEL_IN[1]
    with drawing():
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
        from matplotlib.figure import Figure  # noqa: PLC0415

        figure = Figure(figsize=(width_in, height_in * down + 0.9), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(down, across, squeeze=False).ravel()
        panel_in = width_in / across
        for axes, metric in zip(panels, picture.metrics, strict=False):
            title = "runs that pass" if metric.name == PASS else metric.name
            axes.set_title(_wrapped(title, 0.7 * panel_in, _TITLE_PT), loc="left", fontsize=_TITLE_PT)
            axes.tick_params(labelsize=_TICK_PT)
            if len(picture.over) == 2:
                _draw_map(axes, picture.together(), metric, panel_in)
            else:
                _draw_spreads(axes, picture, metric, panel_in)
        for axes in panels[count:]:
            axes.set_axis_off()
        _draw_words(figure, picture, width_in)
    return figure


def _wrapped(text: str, width_in: float, size_pt: float) -> str:
    """Return a text in lines that are not wider."""
    return "\n".join(_lines(text, width_in, size_pt))


def _lines(text: str, width_in: float, size_pt: float) -> list[str]:
    """Return the lines of a text, also broken behind points, hyphens and underscores."""
    most = max(int(width_in * 72.0 / (_CHARACTER_EM * size_pt)), 8)
    lines = [""]
    for word in re.split(r"(?<=[ ._,-])", text):
        if len(lines[-1]) + len(word) > most and lines[-1]:
            lines.append("")
        lines[-1] += word
    return [line.rstrip(" ") for line in lines]


def _draw_spreads(axes: "Axes", picture: Picture, metric: Column, panel_in: float) -> None:
    """Draw every run, the median, and the interquartile range of the runs, over one key; each part in its colour."""
    (key,) = picture.over
    places = picture.places(key)
    is_scale = all(map(_is_number, places))
    axes.set_xlabel(_wrapped(key, 0.8 * panel_in, _TITLE_PT))
    if not is_scale:
        _name_ticks(axes, places, 0.8 * panel_in / len(places))
        axes.set_xlim(-0.5, len(places) - 0.5)
    at_of = {place: place if is_scale else index for index, place in enumerate(places)}
    whole = picture.together()
    if whole.invalid():
        all_at = sorted({row[key] for row in whole.rows} if is_scale else at_of.values())
        half = min(np.diff(np.array(all_at, dtype=float)), default=1.0) / 2.0
        for (place,) in whole.invalid():
            at = place if is_scale else at_of[place]
            axes.axvspan(at - half, at + half, linewidth=0.0, zorder=0, **_INVALID)
    if metric.kind is bool:
        axes.set_ylim(-4.0, 104.0)
        axes.set_ylabel("fraction of the runs [%]")
    for number, part in enumerate(picture.parts().values()):
        colour = COLOURS[number % len(COLOURS)]
        _draw_spread(axes, part, metric, colour, None if is_scale else at_of, is_alone=not picture.apart)


def _name_ticks(axes: "Axes", places: Sequence[object], room_in: float) -> None:
    """Write texts below an axis: in lines where they fit into their room, otherwise turned."""
    wrapped = [_lines(str(place), room_in, _TICK_PT) for place in places]
    fits = all(_wide_in(line) <= room_in for lines in wrapped for line in lines)
    turned: dict[str, Any] = {} if fits else {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(places)), list(map("\n".join, wrapped)) if fits else list(map(str, places)), **turned)


def _draw_spread(
    axes: "Axes", picture: Picture, metric: Column, colour: str, at_of: Mapping[Any, int] | None, *, is_alone: bool
) -> None:
    def at(place: Any) -> float:
        return float(place if at_of is None else at_of[place])

    together = picture.together()
    groups = together.groups(metric)
    known = [(at(place), groups[place,]) for place in together.places(picture.over[0]) if (place,) in groups]
    x = [place for place, _ in known]
    style: dict[str, Any] = {} if at_of is None else {"linestyle": "none"}  # nothing is between two names
    line: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 3.5, "linewidth": 1.4, **style}
    if metric.kind is bool:
        axes.plot(x, [100.0 * values.mean() for _, values in known], **line)
        if metric.name == PASS and (unjudged := together.lacking(metric)):
            flown = [place for (place,) in together.flown()]
            shares = [100.0 * unjudged.get((place,), 0.0) for place in flown]
            order = np.argsort([at(place) for place in flown])
            marked = _UNJUDGED | ({} if is_alone else {"color": colour}) | style
            axes.plot([at(flown[i]) for i in order], [shares[i] for i in order], **marked)
        return
    if not known:
        return
    quartiles = np.array([np.percentile(values, (25, 50, 75)) for _, values in known]).T
    band: dict[str, Any] = {"color": colour, "alpha": 0.18, "linewidth": 0.0}
    if at_of is None:
        axes.fill_between(x, quartiles[0], quartiles[2], **band)
    else:
        axes.use_sticky_edges = False  # bars would end the axis at 0
        axes.bar(x, quartiles[2] - quartiles[0], 0.3, quartiles[0], **band)
    runs: dict[str, Any] = {"color": FAINT, "alpha": 0.6} if is_alone else {"color": colour, "alpha": 0.35}
    for (place,), values in picture.groups(metric).items():
        axes.plot(np.full(values.size, at(place)), values, ".", markersize=3.0, zorder=1, **runs)
    axes.plot(x, quartiles[1], **line)


def _texts_beside(places: Sequence[object]) -> list[list[str]]:
    """Return the lines of each text beside a map."""
    return [_lines(_label(place), _TEXTS_IN, _TICK_PT) for place in places]


def _map_height_in(picture: Picture) -> float:
    """Return the height that the texts beside a map need; of numbers, which are left out in turn, none."""
    places = picture.places(picture.over[1])
    if all(map(_is_number, places)):
        return 0.0
    return len(places) * max(map(len, _texts_beside(places))) * 1.35 * _TICK_PT / 72.0


def _draw_map(axes: "Axes", picture: Picture, metric: Column, panel_in: float) -> None:
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
    texts = _texts_beside(lines)
    width_in = panel_in - _SCALE_IN - max(_wide_in(line) for text in texts for line in text)
    step = ceil(len(lines) / 12) if all(map(_is_number, lines)) else 1
    axes.set_yticks(range(0, len(lines), step), list(map("\n".join, texts[::step])))
    step = ceil(len(columns) * (max(map(_wide_in, map(_label, columns))) + 0.08) / width_in)
    axes.set_xticks(range(0, len(columns), step), list(map(_label, columns[::step])))
    if not all(map(_is_number, columns)):
        _name_ticks(axes, columns, width_in / len(columns))
    axes.set_xlabel(_wrapped(picture.over[0], width_in, _TITLE_PT))
    axes.set_ylabel(_wrapped(picture.over[1], 0.7 * _PANEL_IN[1], _TITLE_PT))
    for marked, style in ((picture.invalid(), _INVALID), ([*picture.lacking(metric)], _LACKING)):
        _mark_cells(axes, [(columns.index(column), lines.index(line)) for column, line in marked], style)
    widest_in = max((_wide_in(_value(value), _CELL_PT) for value in cells[np.isfinite(cells)].tolist()), default=0.0)
    if widest_in < width_in / len(columns) and len(lines) <= 0.6 * _PANEL_IN[1] * 72.0 / (1.3 * _CELL_PT):
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
            axes.text(column, line, _value(value), color=colour, ha="center", va="center", fontsize=_CELL_PT)


def _value(value: float) -> str:
    return f"{value:.3g}"


def _label(place: object) -> str:
    return f"{place:.3g}" if isinstance(place, float) else str(place)


def _wide_in(text: str, size_pt: float = _TICK_PT) -> float:
    return len(text) * _CHARACTER_EM * size_pt / 72.0


def _draw_words(figure: "Figure", picture: Picture, width_in: float) -> None:
    """Draw the title and the legend, as wide as the figure at most."""
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    figure.suptitle(_wrapped(picture.title, 0.96 * width_in, 10.5), x=0.01, ha="left", fontsize=10.5, color=INK)
    is_map = len(picture.over) == 2
    handles: list[Artist] = []
    lacking = [metric for metric in picture.metrics if picture.lacking(metric)]
    if not is_map:
        median: dict[str, Any] = {"marker": "o", "markersize": 3.5}
        if not all(map(_is_number, picture.places(picture.over[0]))):
            median["linestyle"] = "none"
        handles += [
            Line2D([], [], label=f"median: {name}" if name else "median", color=COLOURS[at % len(COLOURS)], **median)
            for at, name in enumerate(picture.parts())
        ]
        handles += [
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
        widest_in = max(_wide_in(str(each.get_label()), 9.5) for each in handles) + 0.6
        columns = max(min(int(width_in / widest_in), len(handles)), 1)
        figure.legend(handles=handles, loc="outside lower left", ncols=columns, frameon=False)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
