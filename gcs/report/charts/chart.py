"""A chart: axes drawn by matplotlib, reduced to an SVG inside an HTML page."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from io import StringIO
from json import dumps
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from estimation.state import Vector
from gcs.report.charts.panels import empty_reason
from gcs.style import DESIRED, STYLE, drawing, themed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Draw = Callable[["Axes"], None]

WIDTH_IN, HEIGHT_IN = 5.0, 2.9
WIDE_IN = 10.3
"""The width of two charts side by side, with the gap between them."""
# The same margins everywhere, so that the axes of charts above each other line up.
_LEFT_IN, _RIGHT_IN, _BOTTOM_IN, _TOP_IN = 0.85, 0.2, 0.52, 0.1
_LABEL_IN = 0.24
_KEY_IN = 0.26
_LEVEL_PT, _ROUNDING_PT = 12.0, 1e-6
"""The height of a level's label, and what is no difference between two heights."""
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# The page uses another font; matplotlib leaves room for DejaVu Sans, which is wider than most.
_PAGE_STYLE: dict[Any, Any] = STYLE | {
    "font.size": 10.5,
    "axes.labelsize": 10.5,
    "legend.fontsize": 9.5,
    "svg.fonttype": "none",
    "text.parse_math": False,
    "path.simplify_threshold": 0.15,
}
_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_COORDINATES = re.compile(r' (d|x|y|points)="[^"]*"')
_CUT = re.compile(r"<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>", re.DOTALL)
_STYLE = re.compile(r'style="[^"]*"')
_COLOUR = re.compile(r"#[0-9a-f]{6}\b")
_NAMED = re.compile(r'<(g|text) id="([^"]*)"')
_LINE = "line: "
"""What the id of a line with a label begins with, until `_inline` keeps the label for the page's script."""
_KEPT = {"matplotlib.axis": "axis", "xtick": "xtick", "legend": "legend"}
"""The parts of a chart that the page's script tells apart, by the beginning of their ids: their classes."""


@dataclass(frozen=True, slots=True)
class Chart:
    """A chart: title, main figure, alternative text, and SVG.

    `missing` is the reason why the chart holds no data, empty if it does. A wide chart takes a row of the page.
    """

    title: str
    finding: str
    alt: str
    svg: Markup
    missing: str = ""
    is_wide: bool = False


def rows_of_two(draws: Sequence[Callable[..., Chart]], beside: int = 0) -> tuple[Chart, ...]:
    """Draw charts, each a call with `width_in`, for rows of two.

    With an odd number of charts that hold data, and of tables `beside` them, the first is as wide as a row.
    """
    charts = [draw(width_in=WIDTH_IN) for draw in draws]
    drawn = [index for index, each in enumerate(charts) if not each.missing]
    if drawn and (len(drawn) + beside) % 2:
        charts[drawn[0]] = draws[drawn[0]](width_in=WIDE_IN)
    return tuple(charts)


def chart(
    name: str,
    draws: Draw | Sequence[Draw],
    alt: str,
    height_in: float = HEIGHT_IN,
    *,
    key_rows: int = 0,
    width_in: float = WIDTH_IN,
    is_over_time: bool = True,
) -> Chart:
    """Draw panels below each other on one axis, of time or else of another; the first panel's titles are the chart's.

    `name` makes the ids in the SVG unique on a page; `key_rows` adds room for a legend below.
    """
    draws = (draws,) if callable(draws) else tuple(draws)
    key_in = _KEY_IN * key_rows
    height_in += key_in
    with drawing(_PAGE_STYLE | {"svg.hashsalt": name}):
        figure = _figure(width_in, height_in, key_in)
        rows = figure.subplots(len(draws), 1, sharex=True, squeeze=False)[:, 0]
        for draw, axes in zip(draws, rows, strict=True):
            draw(axes)
            axes.label_outer()
            axes.yaxis.set_label_coords((_LABEL_IN - _LEFT_IN) / (width_in - _LEFT_IN - _RIGHT_IN), 0.5)
        missing = "; ".join(filter(None, map(empty_reason, rows)))
        title, finding = rows[0].get_title(loc="left"), rows[0].get_title(loc="right")
        for axes in rows:
            axes.set_title("", loc="left")
            axes.set_title("", loc="right")
            for drawn, label in zip(*axes.get_legend_handles_labels(), strict=True):
                if drawn in axes.lines:
                    drawn.set_gid(f"{_LINE}{label}")
        scales = [_scale(axes, height_in) for axes in rows] if is_over_time and not empty_reason(rows[-1]) else []
        drawn = StringIO()
        figure.savefig(drawn, format="svg")
    return Chart(title, finding, alt, _inline(drawn.getvalue(), alt, scales), missing, width_in > WIDTH_IN)


def _figure(width_in: float, height_in: float, key_in: float) -> "Figure":
    """Return a figure with the margins of all charts, and with room for a legend below."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasSVG(figure)
    figure.subplots_adjust(
        left=_LEFT_IN / width_in,
        right=1.0 - _RIGHT_IN / width_in,
        bottom=(_BOTTOM_IN + key_in) / height_in,
        top=1.0 - _TOP_IN / height_in,
        hspace=0.12,
    )
    return figure


def _scale(axes: "Axes", height_in: float) -> str:
    """Return what a script needs to read values from axes over time: their box in the SVG [points], their limits."""
    points = _points(axes)
    left, bottom, right, top = (points * edge for edge in axes.get_window_extent().extents)
    box = [left, 72.0 * height_in - top, right, 72.0 * height_in - bottom]
    scale = {
        "box": [round(float(edge), 2) for edge in box],
        "time_s": list(map(float, axes.get_xlim())),
        "limits": list(map(float, axes.get_ylim())),
        "is_logarithmic": axes.get_yscale() == "log",
    }
    return dumps(scale)


def _points(axes: "Axes") -> float:
    """Return the points of a pixel."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    return 72.0 / figure.dpi


def _inline(svg: str, alt: str, scales: Sequence[str]) -> Markup:
    """Return an SVG for inline use: without prolog, ids and comments, coordinates rounded to 0.01 points.

    `scales` are those of its axes, for the page's script.
    """
    numbered = iter(scales)

    def kept(match: re.Match[str]) -> str:
        tag, name = match.groups()
        if name.startswith(_LINE):
            return f'<{tag} data-label="{name.removeprefix(_LINE)}"'
        if name.startswith("axes_"):
            return f'<{tag} data-axes="{escape(scale)}"' if (scale := next(numbered, "")) else f"<{tag}"
        kind = _KEPT.get(name.rpartition("_")[0])
        return f'<{tag} class="{kind}"' if scales and kind else f"<{tag}"

    svg = _CUT.sub("", svg[svg.index("<svg") :])
    head, _, body = svg.partition(">")
    box = re.search(r'viewBox="[^"]*"', head)
    body = _COORDINATES.sub(lambda match: _rounded(match.group()), _NAMED.sub(kept, body))
    body = _STYLE.sub(lambda style: _COLOUR.sub(lambda colour: themed(colour.group()), style.group()), body)
    body = re.sub(r"\n\s*", " ", body)
    return Markup(f'<svg role="img" aria-label="{escape(alt)}" {box.group() if box else ""}>{body}')


def _rounded(attribute: str) -> str:
    attribute = _NUMBER.sub(lambda number: f"{float(number.group()):.2f}".rstrip("0").rstrip("."), attribute)
    return re.sub(r"\s*([MLCQZ])\s*", r"\1", attribute)


def over_time(axes: "Axes", label: str, time_s: Vector) -> None:
    """Set up the axes of a quantity over time."""
    axes.set(xlabel="time [s]", ylabel=label)
    if time_s.size > 1:
        axes.set_xlim(float(time_s[0]), float(time_s[-1]))


def _label_places(lines: Sequence[float], foot: float, head: float) -> list[float]:
    """Return the lower edges of the labels of lines, from the lowest line up, between a foot and a head [points]."""
    places: list[float] = []
    for line in lines:
        places.append(max(line + 2.0, places[-1] + _LEVEL_PT if places else foot))
    limit = head - _LEVEL_PT
    for index in reversed(range(len(places))):
        if places[index] > limit + _ROUNDING_PT:
            places[index] = min(limit, lines[index] - _LEVEL_PT - 1.0)
        limit = places[index] - _LEVEL_PT
    return places


def logarithmic(axes: "Axes", values: Vector, floor: float) -> None:
    """Set a logarithmic vertical axis from the smallest value, but not below the floor, with plain tick labels."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator  # noqa: PLC0415

    known = values[np.isfinite(values) & (values > 0.0)]
    low = max(floor, 0.6 * float(known.min())) if known.size else floor
    high = max(1.6 * float(known.max()), 10.0 * low) if known.size else 10.0 * floor
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 100.0 * low else (1.0, 2.0, 5.0), numticks=7))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
    axes.yaxis.set_minor_locator(NullLocator())


def _plain(value: float) -> str:
    """Return a number of one digit without an e."""
    mantissa, _, exponent = f"{value:.0e}".partition("e")
    if -4 < int(exponent) < 4:
        return f"{value:g}"
    power = f"10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    return power if mantissa == "1" else f"{mantissa}·{power}"


def levels(axes: "Axes", values: Mapping[str, float]) -> None:
    """Draw reference levels, each with its label above the right end of its line.

    Labels that would cover each other are moved up, those that would leave the axes down. The vertical scale is fixed.
    """
    for value in values.values():
        axes.axhline(value, **DESIRED)
    axes.set_ylim(axes.get_ylim())
    points = _points(axes)
    foot_pt, head_pt = (points * y for y in axes.get_window_extent().intervaly)
    ordered = sorted(values.items(), key=lambda item: item[1])
    left = axes.get_xlim()[0]
    lines_pt = [points * float(axes.transData.transform((left, value))[1]) for _, value in ordered]
    for (label, _), label_pt in zip(ordered, _label_places(lines_pt, foot_pt, head_pt), strict=True):
        axes.annotate(
            label,
            (1.0, (label_pt - foot_pt) / (head_pt - foot_pt)),
            xycoords="axes fraction",
            xytext=(-2, 0),
            textcoords="offset points",
            ha="right",
            va="bottom",
            fontsize=9,
            color="#5C5C5C",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.5},
            zorder=9,
        )
