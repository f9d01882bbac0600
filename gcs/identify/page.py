"""The figures of an identification as one HTML page: measurements against predictions of the plant."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from estimation.identification.identified import IdentificationResult, ParameterEstimate
from estimation.identification.identify import TRAINED_SHARE
from estimation.identification.simulated import PREDICTION_HORIZON_S
from gcs.identify.panels import (
    AXES,
    DRAWS,
    draw_errors,
    draw_gain,
    draw_held_out,
    draw_phase,
    draw_step,
    draw_whiteness,
    drawn_parameters,
)
from gcs.identify.view import bounds_words, fit_rows, parameter_rows, remarks
from gcs.report.charts.chart import chart
from gcs.report.page_parts import KeyLine, Section, Table, render
from gcs.style import COLOURS, INK
from gcs.vehicle_logs.vehicle_log import VehicleLog


def identified_html(identified: IdentificationResult, logs: Sequence[VehicleLog]) -> str:
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


def _verdict(identified: IdentificationResult) -> Section:
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
    charts = [
        chart(
            f"held-out-{axis}",
            partial(draw_held_out, found=found, axis=axis),
            f"Measured and simulated positions along {AXES[axis]}, on the validation part.",
        )
        for axis in range(2)
    ]
    share = f"{100 * TRAINED_SHARE:.0f} %"
    lead = (
        f"A plant fitted to the first {share} of each part of the flight predicts the rest from setpoints only. The "
        f"estimator's drift within {PREDICTION_HORIZON_S:g} s (offset, rate and curvature) is removed. Time is that of "
        "the log."
    )
    return Section("held-out", "Validation", lead, tuple(charts))


def _responses(found: ParameterEstimate) -> Section:
    draws = drawn_parameters(found)
    charts = []
    for axis in range(2):
        charts.append(
            chart(
                f"step-{axis}",
                partial(draw_step, draws=draws, axis=axis),
                f"Response to a step of the setpoint along {AXES[axis]}, with its 95 % band.",
            )
        )
        charts.append(
            chart(
                f"bode-{axis}",
                [partial(draw_gain, draws=draws, axis=axis), partial(draw_phase, draws=draws, axis=axis)],
                f"Bode plot along {AXES[axis]}: gain and phase with their 95 % bands.",
                4.4,
                is_over_time=False,
            )
        )
    lead = f"Responses of {DRAWS} plants drawn from the fit's covariance; bands contain 95 % of them."
    if found.feedforward is not None:
        lead += " Setpoints of the Bode plots carry their velocities, those of the steps do not."
    return Section("responses", "Responses", lead, tuple(charts), keyed=False)


def _residuals(found: ParameterEstimate) -> Section:
    charts = []
    for axis in range(2):
        charts.append(
            chart(
                f"errors-{axis}",
                partial(draw_errors, found=found, axis=axis),
                f"Measured minus simulated positions along {AXES[axis]} over time.",
            )
        )
        charts.append(
            chart(
                f"whiteness-{axis}",
                partial(draw_whiteness, found=found, axis=axis),
                f"Autocorrelation of the errors along {AXES[axis]}, and the bounds of white noise.",
                is_over_time=False,
            )
        )
    how = "whitened errors" if found.whitened else "errors"
    lead = f"Measured minus simulated positions over all fitted parts, and the autocorrelation of the {how}."
    return Section("residuals", "Residuals", lead, tuple(charts), keyed=False)
