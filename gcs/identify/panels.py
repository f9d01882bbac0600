"""The panels of an identification's figures, and one figure of the most important of them."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from estimation.identification.excerpts import GRID_S, grid_s
from estimation.identification.identified import ParameterEstimate
from estimation.identification.identify import TRAINED_SHARE
from estimation.identification.output_error import autocorrelation, whiteness
from estimation.identification.response import response_of
from estimation.identification.simulated import PREDICTION_HORIZON_S, simulated
from estimation.plant.model import PlantGrade
from estimation.state import Vector
from gcs.report.charts.chart import levels, over_time
from gcs.report.charts.panels import thinned, title
from gcs.style import COLOURS, DESIRED, FAINT, WINDOW, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXES = ("x, north", "y, west")
"""The axes of the plant, as the figures name them."""
DRAWS = 400
"""How many plants are drawn from the covariance of a fit."""
_POINTS = 1500
_LAGS = 50
_STEP_S, _BODE_RAD_S = 10.0, (0.05, 10.0)
_SIZE_IN = (10.0, 8.5)
_RESTING_M = 0.05
"""The least extent of a validation panel above and below the setpoint: a vehicle at rest is a straight line."""


def identified_figure(found: ParameterEstimate, verdict: PlantGrade) -> "Figure":
    """Return validation, step responses and errors of an identification as one figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415
    from matplotlib.lines import Line2D  # noqa: PLC0415

    with drawing():
        figure = Figure(figsize=_SIZE_IN, layout="constrained")
        FigureCanvasAgg(figure)
        draws = drawn_parameters(found)
        rows = (
            partial(draw_held_out, found=found),
            partial(draw_step, draws=draws),
            partial(draw_errors, found=found),
        )
        for row, panels in zip(rows, figure.subplots(len(rows), 2), strict=True):
            for axis, axes in enumerate(panels):
                row(axes, axis=axis)
        lines = (
            Line2D([], [], color=COLOURS[0], label="measured"),
            Line2D([], [], color=COLOURS[1], label="simulated"),
            Line2D([], [], **{**DESIRED, "label": "setpoint"}),
        )
        figure.suptitle(f"Verdict: {verdict.value}")
        figure.legend(handles=lines, loc="outside lower center", ncols=len(lines))
    return figure


def draw_held_out(axes: "Axes", found: ParameterEstimate, axis: int) -> None:
    """Draw the validation part of the longest excerpt: setpoint, measured and simulated position."""
    validation = found.validation
    longest = max(range(len(validation.excerpts)), key=lambda at: validation.excerpts[at].duration_s)
    setpoint_m = validation.excerpts[longest].setpoint_m()[:, axis]
    flight = simulated(validation.excerpts, validation.trained, axis, TRAINED_SHARE, PREDICTION_HORIZON_S)[longest]
    title(axes, f"Along {AXES[axis]}", f"fit {found.axes[axis].fit_percent:.1f} %")
    time_s = flight.time_s[flight.held_out :]
    over_time(axes, "position [m]", time_s)
    middle_m = float(setpoint_m[flight.held_out])
    axes.update_datalim([(time_s[0], middle_m - _RESTING_M), (time_s[0], middle_m + _RESTING_M)])
    axes.plot(*thinned(time_s, setpoint_m[flight.held_out :], _POINTS), **{**DESIRED, "drawstyle": "steps-post"})
    axes.plot(*thinned(time_s, flight.measured_m[flight.held_out :], _POINTS), color=COLOURS[0], linewidth=1.4)
    axes.plot(*thinned(time_s, flight.simulated_m[flight.held_out :], _POINTS), color=COLOURS[1], linewidth=1.2)


def drawn_parameters(found: ParameterEstimate) -> Vector:
    """Return fitted parameters (D, k): first the best fit, then draws from its covariance."""
    best = found.validation.best
    random = np.random.default_rng(0)
    spread = random.multivariate_normal(np.zeros(best.parameters.size), best.covariance, DRAWS, method="eigh")
    return np.vstack((best.parameters, best.parameters + spread))


def draw_step(axes: "Axes", draws: Vector, axis: int) -> None:
    """Draw the response to a step of the setpoint, with its 95 % band."""
    time_s = grid_s(round(_STEP_S / GRID_S) * 2) / 2.0
    rows = []
    for draw in draws:
        since_s = time_s - max(0.0, float(draw[4]))
        step = response_of(*np.exp(draw[2 * axis : 2 * axis + 2]).tolist()).step(np.maximum(since_s, 0.0))
        rows.append(np.where(since_s > 0.0, step, 0.0))
    title(axes, f"Step along {AXES[axis]}", f"overshoot {100 * max(float(rows[0].max()) - 1.0, 0.0):.0f} %")
    over_time(axes, "position [m]", time_s)
    _draw_band(axes, time_s, np.array(rows))
    levels(axes, {"setpoint": 1.0})


def _gains(draws: Vector, axis: int) -> tuple[Vector, "np.ndarray[tuple[int, ...], np.dtype[np.complex128]]"]:
    rate_rad_s = np.geomspace(*_BODE_RAD_S, 120)
    rows = []
    for draw in draws:
        a0, a1 = np.exp(draw[2 * axis : 2 * axis + 2]).tolist()
        response = response_of(a0, a1, lead_s=float(draw[5]) * a1 / a0 if draw.size > 5 else 0.0)
        rows.append(response.gain(rate_rad_s) * np.exp(-1j * rate_rad_s * max(0.0, float(draw[4]))))
    return rate_rad_s, np.array(rows)


def draw_gain(axes: "Axes", draws: Vector, axis: int) -> None:
    """Draw the gain of the Bode plot, with its 95 % band."""
    rate_rad_s, gains = _gains(draws, axis)
    title(axes, f"Bode plot along {AXES[axis]}", "")
    axes.set(ylabel="gain [dB]")
    _over_rates(axes)
    _draw_band(axes, rate_rad_s, 20.0 * np.log10(np.abs(gains)))


def draw_phase(axes: "Axes", draws: Vector, axis: int) -> None:
    """Draw the phase of the Bode plot, with its 95 % band."""
    rate_rad_s, gains = _gains(draws, axis)
    axes.set(xlabel="rate [rad/s]", ylabel="phase [degrees]")
    _over_rates(axes)
    _draw_band(axes, rate_rad_s, np.degrees(np.unwrap(np.angle(gains), axis=1)))


def _over_rates(axes: "Axes") -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter  # noqa: PLC0415

    axes.set(xscale="log", xlim=_BODE_RAD_S)
    axes.xaxis.set_major_locator(LogLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _draw_band(axes: "Axes", at: Vector, rows: Vector) -> None:
    low, high = np.quantile(rows[1:], (0.025, 0.975), axis=0)
    axes.fill_between(at, low, high, color=COLOURS[1], alpha=0.25, linewidth=0.0)
    axes.plot(at, rows[0], color=COLOURS[1], linewidth=1.4)


def draw_errors(axes: "Axes", found: ParameterEstimate, axis: int) -> None:
    """Draw measured minus simulated positions of all excerpts over time."""
    flights = simulated(found.validation.excerpts, found.validation.best, axis, 1.0)
    errors_m = np.concatenate([flight.error_m for flight in flights])
    title(axes, f"Errors along {AXES[axis]}", f"{np.sqrt(np.mean(errors_m**2)):.2f} m rms")
    over_time(axes, "error [m]", np.array([flights[0].time_s[0], flights[-1].time_s[-1]]))
    for flight in flights:
        axes.plot(*thinned(flight.time_s, flight.error_m, _POINTS), color=COLOURS[0], linewidth=1.0)


def draw_whiteness(axes: "Axes", found: ParameterEstimate, axis: int) -> None:
    """Draw the autocorrelation of the errors, and the bounds of white noise."""
    errors = found.validation.best.errors[axis]
    share, bound = whiteness(errors)
    title(axes, f"Whiteness along {AXES[axis]}", f"{100 * share:.0f} % within bounds")
    lags_s = grid_s(_LAGS + 1)[1:]
    axes.axhspan(-bound, bound, color=WINDOW)
    axes.axhline(0.0, color=FAINT, linewidth=0.8)
    axes.set(xlabel="lag [s]", ylabel="correlation", xlim=(0.0, float(lags_s[-1])))
    axes.vlines(lags_s, 0.0, autocorrelation(errors, _LAGS), color=COLOURS[0], linewidth=1.6)
