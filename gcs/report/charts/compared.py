"""Charts of several flights in one: their paths, and their errors over the time since each engaged."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from estimation.state import Vector
from gcs.metrics.result import FlightResult
from gcs.mission.mission import Mission
from gcs.report.charts.chart import logarithmic, over_time
from gcs.report.charts.panels import Sheet, mark_empty, mark_vehicle, title
from gcs.report.evidence.lyapunov import lyapunov_rad2
from gcs.style import ENGAGED, flight_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINTS_MAX = 1200
"""Of a line of one flight."""


@dataclass(frozen=True, slots=True)
class ComparedFlight:
    """One of several flights: its name (unique), its mission, and the data of its charts with its result."""

    name: str
    mission: Mission
    sheet: Sheet

    @property
    def result(self) -> FlightResult:
        """The metrics and verdicts of the flight."""
        return self.sheet.result

    @property
    def engaged_at_s(self) -> float | None:
        """The first tick in which a vehicle's tactic is encircle, None without one: the zero of compared times."""
        times_s = (vehicle.engaged_at_s for vehicle in self.result.vehicles)
        return min((time_s for time_s in times_s if time_s is not None), default=None)


def draw_compared_paths(axes: "Axes", flights: Sequence[ComparedFlight]) -> None:
    """Draw the paths of all flights over each other, a colour for each flight; targets are thin lines."""
    title(axes, "Paths", "")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    for index, flight in enumerate(flights):
        sheet, style = flight.sheet, flight_style(index)
        axes.plot(*sheet.path(sheet.record.target_path_m).T, **style | {"linewidth": 0.7})
        for row, track in enumerate(sheet.record.vehicles):
            axes.plot(*sheet.path(track.position_m).T, alpha=0.8, **style)
            engaged_s = flight.result.vehicles[row].engaged_at_s
            if engaged_s is not None:
                sample = int(np.argmin(np.abs(sheet.record.time_s - engaged_s)))
                axes.plot(*track.position_m[sample], color=style["color"], zorder=6, **ENGAGED)
            mark_vehicle(axes, track, style["color"])


def draw_compared_error(axes: "Axes", flights: Sequence[ComparedFlight], name: str) -> None:
    """Draw one of `ERRORS` of every flight that engaged over the time since it did, on a logarithmic scale."""
    error = ERRORS[name]
    title(axes, error.heading, "")
    lines = [
        (index, flight.sheet.record.time_s - flight.engaged_at_s, error.of(flight.sheet))
        for index, flight in enumerate(flights)
        if flight.engaged_at_s is not None
    ]
    known = [np.isfinite(values) for _, _, values in lines]
    if not any(mask.any() for mask in known):
        mark_empty(axes, "not measured in any flight" if lines else "no vehicle engaged in any flight")
        return
    times_s = [time_s[mask] for (_, time_s, _), mask in zip(lines, known, strict=True)]
    over_time(axes, error.label, np.sort(np.concatenate(times_s)))
    axes.set_xlabel("time since the first engagement [s]")
    logarithmic(axes, np.concatenate([values for _, _, values in lines]), error.floor)
    for index, time_s, values in lines:
        axes.plot(*flights[index].sheet.line(time_s, np.maximum(values, 0.1 * error.floor)), **flight_style(index))


def _largest(error: Vector) -> Vector:
    """Return the largest of the errors (V, T) at each time, NaN where there is none."""
    largest = np.fmax.reduce(np.abs(error), axis=0, initial=-np.inf)
    return np.where(largest >= 0.0, largest, np.nan)


class Error(NamedTuple):
    """A quantity over time: its heading, its label with the unit, the lowest value drawn, and its values (T,)."""

    heading: str
    label: str
    floor: float
    of: Callable[[Sheet], Vector]


ERRORS = {
    "radius": Error(
        "Largest radius error", "error [m]", 1e-4, lambda sheet: _largest(sheet.motion.radius_m - sheet.ring.radius_m)
    ),
    "spacing": Error(
        "Largest spacing error",
        "error [°]",
        1e-3,
        lambda sheet: _largest(np.degrees(sheet.motion.lead_rad - sheet.motion.desired_spacing_rad)),
    ),
    "lyapunov": Error("Lyapunov function", "V [rad²]", 1e-7, lambda sheet: lyapunov_rad2(sheet.motion)),
}
"""The quantities over time by their names."""
