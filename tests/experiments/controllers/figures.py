"""The figures of both planners' flights."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gcs.style import COLOURS, STYLE, vehicle_style
from tests.experiments.controllers.flights import FAMILY, LMPC, NMPC, Outcome
from tests.experiments.controllers.tables import PLANNERS, times_ms

SHOWN, SHOWN_FROM_S = "case2-field", 220.0
_LINES: dict[str, dict[str, Any]] = {LMPC: {"color": COLOURS[0]}, NMPC: {"color": COLOURS[1], "linestyle": "--"}}


def draw(folder: Path, outcomes: Sequence[Outcome]) -> list[Path]:
    """Draw the figures into a folder: one flight by both planners, and the draws of the plant family."""
    flights = [each for each in outcomes if each.job.scene == SHOWN and each.job.seed == 0]
    draws = [each for each in outcomes if each.job.scene == FAMILY]
    paths = []
    with rc_context(STYLE):
        if flights:
            paths.append(_saved(folder / "controllers-flight.png", _flight(flights)))
        if draws:
            paths.append(_saved(folder / "controllers-family.png", _family(draws)))
    return paths


def _saved(path: Path, figure: Figure) -> Path:
    figure.savefig(path, dpi=110)
    return path


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _flight(outcomes: Sequence[Outcome]) -> Figure:
    """Radius, rate and spacing of every vehicle over time, the planners side by side."""
    figure = _figure(9.0, 6.2)
    panels: Any = figure.subplots(3, len(PLANNERS), sharex=True, sharey="row")
    for column, planner in zip(panels.T, PLANNERS, strict=True):
        outcome = next(each for each in outcomes if each.job.planner == planner)
        motion, shown = outcome.motion, outcome.time_s >= SHOWN_FROM_S
        column[0].set_title(planner)
        column[-1].set_xlabel("time, s")
        lines = (motion.radius_m, motion.rate_rad_s * 1e3, np.degrees(motion.lead_rad))
        for axes, values in zip(column, lines, strict=True):
            for vehicle, line in enumerate(np.where(motion.member, values, np.nan)):
                axes.plot(outcome.time_s[shown], line[shown], **vehicle_style(vehicle, len(values)))
    for axes, title in zip(panels[:, 0], ("radius, m", "angular rate, mrad/s", "angle to the next, °"), strict=True):
        axes.set_ylabel(title)
    return figure


def _family(outcomes: Sequence[Outcome]) -> Figure:
    """The share of draws, and of plans, up to each value."""
    figure = _figure(9.0, 5.6)
    panels: Any = figure.subplots(2, 2)
    by = {planner: [each for each in outcomes if each.job.planner == planner] for planner in PLANNERS}
    for axes, (title, name, scale) in zip(
        panels.ravel(),
        (
            ("radius error, m rms", "radius_m", 1.0),
            ("angular rate error, mrad/s rms", "rate_rad_s", 1e3),
            ("spacing error, ° rms", "spacing_deg", 1.0),
        ),
        strict=False,
    ):
        for planner, mine in by.items():
            _step(axes, planner, np.array([getattr(each, name) for each in mine], dtype=np.float64) * scale)
        axes.set(xlabel=title, ylabel="share of draws", xlim=(0.0, None))
    times = panels[1, 1]
    for planner, mine in by.items():
        _step(times, planner, times_ms(mine))
    times.set(xlabel="processor time of a plan, ms", ylabel="share of plans", xscale="log")
    panels[0, 0].legend(loc="lower right", frameon=False)
    return figure


def _step(axes: Any, planner: str, values: np.ndarray[Any, np.dtype[np.float64]]) -> None:
    """Draw the distribution of values, in a thousand points at most."""
    shares = np.linspace(0.0, 1.0, min(len(values), 1000))
    axes.plot(np.quantile(values, shares), shares, label=planner, **_LINES[planner])
