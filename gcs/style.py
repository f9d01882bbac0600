"""Style of all figures: colours, lines and markers, shared by the paper's figures, the report and the viewers."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, chdir
from typing import Any

from agents.tactics import NO_TACTIC, Tactic

# Vehicles 1, 2, 3 are blue, red and green as in the paper, in shades that are distinguishable with colour blindness.
COLOURS = ("#0077BB", "#CC3311", "#009E73", "#AA4499", "#E69F00", "#56B4E9", "#882255", "#8A8A2A")
DASHES = ("-", (0, (5, 1.2, 1, 1.2)), (0, (1, 1)), (0, (7, 1, 1, 1, 1, 1)))
# Paul Tol's light scheme, for areas behind dark text.
TACTIC_COLOURS = {
    Tactic.STANDBY.value: "#DDDDDD",
    Tactic.FORMATION.value: "#99DDFF",
    Tactic.ENCIRCLE.value: "#BBCC33",
    Tactic.TRANSIT.value: "#AAAA00",
    Tactic.EXCITE.value: "#44BB99",
    Tactic.ASIDE.value: "#FFAABB",
    Tactic.HOLD.value: "#EEDD88",
    Tactic.RETURN_AND_LAND.value: "#77AADD",
    Tactic.LAND.value: "#AAAAAA",
    Tactic.PILOT_OVERRIDE.value: "#EE8866",
    NO_TACTIC: "#F7F7F7",
}
INK, FAINT, WINDOW, FAIL = "#333333", "#8A8A8A", "#F2F2F2", "#B3200A"
DESIRED: dict[str, Any] = {"color": INK, "linewidth": 1.0, "linestyle": (0, (4, 3)), "zorder": 4}
ENGAGED: dict[str, Any] = {"marker": "o", "markersize": 7, "markerfacecolor": "white", "markeredgewidth": 1.6}
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    # With no date in the metadata, the same flight gives the same file.
    "svg.hashsalt": "cordon",
}


def drawing(style: Mapping[Any, Any] = STYLE) -> AbstractContextManager[None]:
    """Return the context in which figures are drawn in a style.

    matplotlib is imported here, from another folder: it would read the `matplotlibrc` of the current one, which may
    come from elsewhere.
    """
    with chdir("/"):
        from matplotlib import rc_context  # noqa: PLC0415
    return rc_context(dict(style))


DARK = {
    "#000000": "#FFFFFF",
    "#333333": "#DFE3E8",
    "#4D4D4D": "#C8CDD2",
    "#5C5C5C": "#A9B1BA",
    "#7F7F7F": "#98A0A8",
    "#8A8A8A": "#8A939C",
    "#A6A6A6": "#78818A",
    "#E4E4E4": "#2B323A",
    "#F2F2F2": "#20262D",
    "#FFFFFF": "#14181D",
    "#B3200A": "#FF9A8D",
    "#0077BB": "#4DB2F0",
    "#CC3311": "#FF7A5C",
    "#009E73": "#2FCF9F",
    "#AA4499": "#DD88CF",
    "#E69F00": "#F0B429",
    "#56B4E9": "#8FD0F7",
    "#882255": "#D97AA8",
    "#8A8A2A": "#C2C25A",
    "#DDDDDD": "#444B53",
    "#99DDFF": "#1F5A78",
    "#BBCC33": "#55620F",
    "#AAAA00": "#5A5A12",
    "#44BB99": "#1D6B55",
    "#FFAABB": "#7D3646",
    "#EEDD88": "#665712",
    "#77AADD": "#2C5480",
    "#AAAAAA": "#555D66",
    "#EE8866": "#7D3D22",
    "#F7F7F7": "#1B2026",
}
"""The colours of charts on a dark page, by those of a light one."""


def themed(colour: str) -> str:
    """Return a colour of the light page for CSS, where a dark page gives it another one (`DARK`)."""
    return f"var(--c{colour.removeprefix('#').lower()}, {colour})"


def vehicle_style(row: int, vehicles: int) -> dict[str, Any]:
    """Return the line style of one of several vehicles: the colours in turn, then repeated with another dash."""
    return {
        "color": COLOURS[row % len(COLOURS)],
        "linestyle": DASHES[row // len(COLOURS) % len(DASHES)],
        "linewidth": 1.0 if vehicles > len(COLOURS) else 1.4,
    }


def flight_style(index: int) -> dict[str, Any]:
    """Return the line style of one of several flights: colour and dash, so that overlapping lines stay visible."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": DASHES[index % len(DASHES)], "linewidth": 1.4}
