"""Style of all figures: colours, lines and markers, shared by the paper's figures, the report and the viewers."""

from typing import Any

# Vehicles 1, 2, 3 are blue, red and green as in the paper, in shades that are distinguishable with colour blindness.
COLOURS = ("#0077BB", "#CC3311", "#009E73", "#AA4499", "#E69F00", "#56B4E9", "#882255", "#8A8A2A")
DASHES = ("-", (0, (5, 1.2, 1, 1.2)), (0, (1, 1)), (0, (7, 1, 1, 1, 1, 1)))
# Paul Tol's light scheme, for areas behind dark text.
TACTIC_COLOURS = {
    "standby": "#DDDDDD",
    "formation": "#99DDFF",
    "encircle": "#BBCC33",
    "excite": "#44BB99",
    "aside": "#FFAABB",
    "hold": "#EEDD88",
    "return and land": "#77AADD",
    "land": "#AAAAAA",
    "pilot override": "#EE8866",
    "unknown": "#F7F7F7",
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
