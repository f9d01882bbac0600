"""The figures of an identification as one HTML page: measurements against predictions of the plant."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimation.identification.excerpts import GRID_S, grid_s
from estimation.identification.identified import Identified, ParameterEstimate
from estimation.identification.identify import TRAINED_SHARE
from estimation.identification.output_error import autocorrelation, whiteness
from estimation.identification.response import response_of
from estimation.identification.simulated import PREDICTION_HORIZON_S, SimulatedAxis, simulated
from estimation.state import Vector
from gcs.identify.view import bounds_words, fit_rows, parameter_rows, remarks
from gcs.report.charts.chart import chart, levels, over_time
from gcs.report.charts.panels import thinned, title
from gcs.report.page_parts import KeyLine, Section, Table, render
from gcs.style import COLOURS, DESIRED, FAINT, INK, WINDOW
from gcs.vehicle_logs.vehicle_log import VehicleLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS = 1500
_DRAWS = 400
_LAGS = 50
_AXES = ("x, north", "y, west")
_STEP_S, _BODE_RAD_S = 10.0, (0.05, 10.0)


def identified_html(identified: Identified, logs: Sequence[VehicleLog]) -> str:
    """Return the page of an identification."""
    facts = {
        "vehicle": str(logs[0].system_id),
        "autopilot": " ".join(filter(None, (logs[0].autopilot, logs[0].firmware))),
        "logs": ", ".join(f"{Path(log.path).name} ({log.sha256[:12]})" for log in logs),
        "used": f"{identified.duration_s:.0f} s in {identified.excerpts} parts",
        "verdict": identified.verdict.value,
    }
    key = (
        KeyLine("measured", COLOURS[0], ""),
        KeyLine("simulated", COLOURS[1], ""),
        KeyLine("setpoint", INK, "4 3"),
    )
    sections = [_verdict(identified)]
    if identified.found is not None:
        sections += [_held_out(identified.found), _responses(identified.found), _residuals(identified.found)]
    name = f"Plant of vehicle {logs[0].system_id}"
    return render("vehicle_log.html.j2", name=name, facts=facts, key=key, sections=sections)


def _verdict(identified: Identified) -> Section:
    reasons = tuple((reason,) for reason in identified.reasons) or (("all checks passed",),)
    tables = [Table(f"Verdict: {identified.verdict.value}", ("reasons",), reasons)]
    if identified.found is not None:
        rows = []
        for words, x, y, digits in parameter_rows(identified.found):
            cells = [cell for axis in (x, y) for cell in (f"{axis.value:.{digits}f}", bounds_words(axis, digits))]
            rows.append((words, *cells))
        rows += [(words, f"{x:.1f}", "", f"{y:.1f}", "") for words, x, y in fit_rows(identified.found)]
        tables.append(Table("Parameters", ("", "x", "95 %", "y", "95 %"), tuple(rows)))
        tables.append(Table("More", ("remarks",), tuple((line,) for line in remarks(identified.found))))
    return Section("verdict", "Parameters and verdict", tables=tuple(tables), keyed=False)


def _held_out(found: ParameterEstimate) -> Section:
    validation = found.validation
    flights = [
        simulated(validation.excerpts, validation.trained, axis, TRAINED_SHARE, PREDICTION_HORIZON_S)
        for axis in range(2)
    ]
    longest = max(range(len(validation.excerpts)), key=lambda at: validation.excerpts[at].duration_s)
    setpoint_m = validation.excerpts[longest].setpoint_m()
    charts = []
    for axis in range(2):
        flight, asked_m = flights[axis][longest], setpoint_m[:, axis]
        charts.append(
            chart(
                f"held-out-{axis}",
                partial(_draw_held_out, flight=flight, setpoint_m=asked_m, found=found, axis=axis),
                f"Measured and simulated positions along {_AXES[axis]}, on the validation part.",
            )
        )
    share = f"{100 * TRAINED_SHARE:.0f} %"
    lead = (
        f"A plant fitted to the first {share} of each part of the flight predicts the rest from setpoints only. The "
        f"estimator's drift within {PREDICTION_HORIZON_S:g} s (offset, rate and curvature) is removed. Time is that of "
        "the log."
    )
    return Section("held-out", "Validation", lead, tuple(charts))


def _draw_held_out(
    axes: "Axes", flight: SimulatedAxis, setpoint_m: Vector, found: ParameterEstimate, axis: int
) -> None:
    title(axes, f"Along {_AXES[axis]}", f"fit {found.axes[axis].fit_percent:.1f} %")
    time_s = flight.time_s[flight.held_out :]
    over_time(axes, "position [m]", time_s)
    axes.plot(*thinned(time_s, setpoint_m[flight.held_out :], _POINTS), **{**DESIRED, "drawstyle": "steps-post"})
    axes.plot(*thinned(time_s, flight.measured_m[flight.held_out :], _POINTS), color=COLOURS[0], linewidth=1.4)
    axes.plot(*thinned(time_s, flight.simulated_m[flight.held_out :], _POINTS), color=COLOURS[1], linewidth=1.2)


def _responses(found: ParameterEstimate) -> Section:
    draws = _drawn_parameters(found)
    charts = []
    for axis in range(2):
        charts.append(
            chart(
                f"step-{axis}",
                partial(_draw_step, draws=draws, axis=axis),
                f"Response to a step of the setpoint along {_AXES[axis]}, with its 95 % band.",
            )
        )
        charts.append(
            chart(
                f"bode-{axis}",
                [partial(_draw_gain, draws=draws, axis=axis), partial(_draw_phase, draws=draws, axis=axis)],
                f"Bode plot along {_AXES[axis]}: gain and phase with their 95 % bands.",
                4.4,
                is_over_time=False,
            )
        )
    lead = f"Responses of {_DRAWS} plants drawn from the fit's covariance; bands contain 95 % of them."
    if found.feedforward is not None:
        lead += " Setpoints of the Bode plots carry their velocities, those of the steps do not."
    return Section("responses", "Responses", lead, tuple(charts), keyed=False)


def _drawn_parameters(found: ParameterEstimate) -> Vector:
    """Return fitted parameters (D, k): first the best fit, then draws from its covariance."""
    best = found.validation.best
    random = np.random.default_rng(0)
    spread = random.multivariate_normal(np.zeros(best.parameters.size), best.covariance, _DRAWS, method="eigh")
    return np.vstack((best.parameters, best.parameters + spread))


def _draw_step(axes: "Axes", draws: Vector, axis: int) -> None:
    time_s = grid_s(round(_STEP_S / GRID_S) * 2) / 2.0
    rows = []
    for draw in draws:
        since_s = time_s - max(0.0, float(draw[4]))
        step = response_of(*np.exp(draw[2 * axis : 2 * axis + 2]).tolist()).step(np.maximum(since_s, 0.0))
        rows.append(np.where(since_s > 0.0, step, 0.0))
    title(axes, f"Step along {_AXES[axis]}", f"overshoot {100 * max(float(rows[0].max()) - 1.0, 0.0):.0f} %")
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


def _draw_gain(axes: "Axes", draws: Vector, axis: int) -> None:
    rate_rad_s, gains = _gains(draws, axis)
    title(axes, f"Bode plot along {_AXES[axis]}", "")
    axes.set(ylabel="gain [dB]")
    _over_rates(axes)
    _draw_band(axes, rate_rad_s, 20.0 * np.log10(np.abs(gains)))


def _draw_phase(axes: "Axes", draws: Vector, axis: int) -> None:
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


def _residuals(found: ParameterEstimate) -> Section:
    charts = []
    validation = found.validation
    for axis in range(2):
        flights = simulated(validation.excerpts, validation.best, axis, 1.0)
        charts.append(
            chart(
                f"errors-{axis}",
                partial(_draw_errors, flights=flights, axis=axis),
                f"Measured minus simulated positions along {_AXES[axis]} over time.",
            )
        )
        charts.append(
            chart(
                f"whiteness-{axis}",
                partial(_draw_whiteness, found=found, axis=axis),
                f"Autocorrelation of the errors along {_AXES[axis]}, and the bounds of white noise.",
                is_over_time=False,
            )
        )
    how = "whitened errors" if found.whitened else "errors"
    lead = f"Measured minus simulated positions over all fitted parts, and the autocorrelation of the {how}."
    return Section("residuals", "Residuals", lead, tuple(charts), keyed=False)


def _draw_errors(axes: "Axes", flights: Sequence[SimulatedAxis], axis: int) -> None:
    errors_m = np.concatenate([flight.error_m for flight in flights])
    title(axes, f"Errors along {_AXES[axis]}", f"{np.sqrt(np.mean(errors_m**2)):.2f} m rms")
    over_time(axes, "error [m]", np.array([flights[0].time_s[0], flights[-1].time_s[-1]]))
    for flight in flights:
        axes.plot(*thinned(flight.time_s, flight.error_m, _POINTS), color=COLOURS[0], linewidth=1.0)


def _draw_whiteness(axes: "Axes", found: ParameterEstimate, axis: int) -> None:
    errors = found.validation.best.errors[axis]
    share, bound = whiteness(errors)
    title(axes, f"Whiteness along {_AXES[axis]}", f"{100 * share:.0f} % within bounds")
    lags_s = grid_s(_LAGS + 1)[1:]
    axes.axhspan(-bound, bound, color=WINDOW)
    axes.axhline(0.0, color=FAINT, linewidth=0.8)
    axes.set(xlabel="lag [s]", ylabel="correlation", xlim=(0.0, float(lags_s[-1])))
    axes.vlines(lags_s, 0.0, autocorrelation(errors, _LAGS), color=COLOURS[0], linewidth=1.6)
