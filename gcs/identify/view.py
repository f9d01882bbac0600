"""The result of an identification as a table, as JSON, and as a profile."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import date
from math import isfinite
from pathlib import Path
from typing import Any

import tomli_w
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from estimation.identification.filter_noise import AHEAD_S
from estimation.identification.identified import METHOD, IdentificationResult, Interval, ParameterEstimate
from estimation.plant.model import Identification, IdentifiedLog, PlantGrade, covariance_of
from estimation.profile.profile import LimitsSection, ProfileLibrary
from gcs.autopilots.autopilot import Autopilot
from gcs.autopilots.registry import autopilot_of
from gcs.vehicle_logs.vehicle_log import VehicleLog


def limits_in(logs: Sequence[VehicleLog], autopilot: Autopilot) -> tuple[LimitsSection, tuple[str, ...]]:
    """Return the limits of speed and acceleration (None if no log has the parameter), and the parameters' names."""
    named = list[str]()
    values: list[float | None] = []
    for known in (autopilot.speed_limits, autopilot.acceleration_limits):
        held = [(name, unit * log.parameters[name]) for name, unit in known for log in logs if name in log.parameters]
        held = [(name, value) for name, value in held if 0.0 < value <= 100.0]
        named += [held[-1][0]] if held else []
        values.append(held[-1][1] if held else None)
    speed_m_s, acceleration_m_s2 = values
    return LimitsSection(speed_max_m_s=speed_m_s, acceleration_max_m_s2=acceleration_m_s2), tuple(named)


_STYLES = {PlantGrade.GOOD: "bold green", PlantGrade.USABLE: "bold yellow", PlantGrade.DO_NOT_FLY: "bold red"}
_COLUMNS = ("", "x", "95 %", "y", "95 %")


def parameter_rows(found: ParameterEstimate) -> list[tuple[str, Interval, Interval, int]]:
    """Return the parameters of both axes with their names and the number of digits to show."""
    x, y = found.axes
    gain = found.feedforward
    return [
        ("a0 [1/s²]", x.a0_per_s2, y.a0_per_s2, 3),
        ("a1 [1/s]", x.a1_per_s, y.a1_per_s, 3),
        ("delay [s]", found.delay_s, found.delay_s, 3),
        ("natural frequency [rad/s]", x.frequency_rad_s, y.frequency_rad_s, 3),
        ("damping", x.damping, y.damping, 2),
        *([] if gain is None else [("feed-forward", gain, gain, 2)]),
    ]


def fit_rows(found: ParameterEstimate) -> list[tuple[str, float, float]]:
    """Return the validation fits of x and y with their names: the plant's own first."""
    x, y = found.axes
    rows = [("validation fit [%]", x.fit_percent, y.fit_percent)]
    if found.baseline_fit_percent is not None:
        rows.append(("  of plain least squares [%]", *found.baseline_fit_percent))
    return rows + [(f"  of '{name}' [%]", *fits) for name, fits in found.others_fit_percent.items()]


def bounds_words(interval: Interval, digits: int) -> str:
    """Return the bounds of an interval as text."""
    return f"{interval.low:.{digits}f} to {interval.high:.{digits}f}"


def identified_view(identified: IdentificationResult, logs: Sequence[VehicleLog]) -> RenderableType:
    """Return an identification for a terminal: the verdict first, then its reasons and numbers."""
    first = logs[0]
    vehicle = " ".join(filter(None, (f"vehicle {first.system_id},", first.autopilot, first.firmware)))
    parts: list[RenderableType] = [
        Text(f"{vehicle}: {identified.duration_s:.0f} s in {identified.excerpts} parts used", style="dim"),
    ]
    if identified.found is not None:
        parts += [_table(identified.found), *map(Text, remarks(identified.found))]
    parts.append(Text(f"verdict: {identified.verdict.value}", style=_STYLES[identified.verdict]))
    parts += [Text(f"  {reason}") for reason in identified.reasons]
    return Group(*parts)


def _table(found: ParameterEstimate) -> Table:
    table = Table(*_COLUMNS, box=None, pad_edge=False)
    for words, x, y, digits in parameter_rows(found):
        cells = [cell for axis in (x, y) for cell in (f"{axis.value:.{digits}f}", bounds_words(axis, digits))]
        table.add_row(Text(words), *cells)
    for at, (words, x_fit, y_fit) in enumerate(fit_rows(found)):
        table.add_row(Text(words), f"{x_fit:.1f}", "", f"{y_fit:.1f}", "", style="dim" if at else "")
    return table


def remarks(found: ParameterEstimate) -> list[str]:
    """Return remarks on setpoints, axes, errors, order, delay and noise as text."""
    x, y = found.axes
    order, enough = found.order, "enough" if found.order.second_is_enough else "not enough"
    lines = [
        f"setpoints: {found.between.value}",
        "axes: " + ("fitted together, as they do not differ" if found.axes_alike else "fitted separately: they differ"),
        f"errors: {x.error_rms_m:.2f} m along x, {y.error_rms_m:.2f} m along y (rms); "
        + (
            f"whitened; {100 * min(x.white_share, y.white_share):.0f} % of correlations within bounds of white noise"
            if found.whitened
            else "not whitened: the plant with the least simulation error"
        ),
        f"order: with a lag of {order.lag_s:.2f} s as third order, the fit would be {order.fit_third_percent:.1f} % "
        f"instead of {order.fit_second_percent:.1f} %: second order is {enough}",
    ]
    lines.append(f"delay: varies over time by {found.delay_spread_s:.2f} s (rms), beyond what the errors explain")
    if (noise := found.noise) is not None:
        lines.append(
            f"filter: noise of positions {noise.position_noise_m:.3f} m, of velocities "
            f"{noise.velocity_noise_m_s:.3f} m/s; disturbance: changes by {noise.disturbance_noise_m_s2:.3f} m/s2 in a "
            f"second (rms), limited to {noise.disturbance_max_m_s2:.2f} m/s2; error of a prediction {AHEAD_S:g} s "
            f"ahead {noise.predicted_rms_m:.3f} m rms"
        )
    if found.baseline is not None:
        (x0, y0), (x1, y1), delay_s = found.baseline.a0_per_s2, found.baseline.a1_per_s, found.baseline.delay_s
        lines.append(f"plain least squares: a0 {x0:.2f}, {y0:.2f}; a1 {x1:.2f}, {y1:.2f}; delay {delay_s:.1f} s")
    return lines


def identified_dict(identified: IdentificationResult, logs: Sequence[VehicleLog]) -> dict[str, Any]:
    """Return an identification as plain data; unknown values are None."""
    found = identified.found
    return {
        "verdict": identified.verdict.value,
        "reasons": list(identified.reasons),
        "method": METHOD,
        "vehicle": logs[0].system_id,
        "autopilot": logs[0].autopilot,
        "firmware": logs[0].firmware,
        "logs": [
            {"path": log.path, "format": log.format, "sha256": log.sha256, "damaged": log.is_damaged} for log in logs
        ],
        "duration_s": identified.duration_s,
        "parts": identified.excerpts,
        "plant": None if found is None else _found_dict(found),
    }


def _found_dict(found: ParameterEstimate) -> dict[str, Any]:
    shaping = {name: value if isfinite(value) else None for name, value in asdict(found.shaping).items()}
    return {
        "x": asdict(found.axes[0]),
        "y": asdict(found.axes[1]),
        "delay_s": asdict(found.delay_s),
        "feedforward": None if found.feedforward is None else asdict(found.feedforward),
        "delay_spread_s": found.delay_spread_s,
        "own_filter": None if found.noise is None else asdict(found.noise),
        "covariance_of": list(covariance_of(feedforward=found.feedforward is not None)),
        "covariance": found.covariance.tolist(),
        "setpoints": found.between.value,
        "whitened": found.whitened,
        "consistent": found.consistent,
        "axes_alike": found.axes_alike,
        "third_order": {**asdict(found.order), "second_is_enough": found.order.second_is_enough},
        "bounds": shaping,
        "least_squares": None
        if found.baseline is None
        else {
            "a0_per_s2": found.baseline.a0_per_s2.tolist(),
            "a1_per_s": found.baseline.a1_per_s.tolist(),
            "delay_s": found.baseline.delay_s,
            "fit_percent": found.baseline_fit_percent,
        },
        "others_fit_percent": dict(found.others_fit_percent),
    }


def identification_of(
    identified: IdentificationResult, found: ParameterEstimate, logs: Sequence[VehicleLog], today: date
) -> Identification:
    """Return the origin of a plant: `[identified]` of its profile."""
    return Identification(
        method=METHOD,
        date=today.isoformat(),
        vehicle=logs[0].system_id,
        autopilot=logs[0].autopilot,
        firmware=logs[0].firmware,
        logs=tuple(IdentifiedLog(name=Path(log.path).name, sha256=log.sha256) for log in logs),
        setpoints=found.between.value,
        duration_s=round(identified.duration_s, 1),
        fit_x_percent=round(found.axes[0].fit_percent, 1),
        fit_y_percent=round(found.axes[1].fit_percent, 1),
        delay_spread_s=round(found.delay_spread_s, 3),
        verdict=identified.verdict,
        reasons=identified.reasons,
        covariance=tuple(tuple(float(f"{value:.6g}") for value in row) for row in found.covariance.tolist()),
    )


def profile_text(found: ParameterEstimate, identified: Identification, logs: Sequence[VehicleLog]) -> str:
    """Return a profile's text: plant and filter as identified, limits as logged, the rest from the bundled profile."""
    autopilot = autopilot_of(identified.autopilot)
    lines = ["# Written by `cordon identify`; x points north, y west."]
    if autopilot.is_known:
        lines.append(f"autopilot = {_toml(autopilot.name)}")
    lines += _plant_lines(found)
    lines += _filter_lines(found) if found.noise is not None else _bundled_lines("own_filter", autopilot)
    limits, parameters = limits_in(logs, autopilot) if autopilot.is_known else (LimitsSection(), ())
    if parameters:
        lines += [f"\n# The autopilot's {' and '.join(parameters)}.", "[limits]"]
        lines += [f"{name} = {_toml(round(value, 4))}" for name, value in limits.model_dump(exclude_none=True).items()]
    else:
        lines += _bundled_lines("limits", autopilot)
    return "\n".join([*lines, *_identified_lines(identified)]) + "\n"


def _plant_lines(found: ParameterEstimate) -> list[str]:
    (x, y), gain = found.axes, found.feedforward
    equation = "a0 (X_d - x) - a1 x'" if gain is None else "a0 (X_d - x) + a1 (feedforward V_d - x')"
    lines = [
        f"# The plant as identified: x'' = {equation}.",
        f"delay_s = {found.delay_s.value:.4g}  # {bounds_words(found.delay_s, 3)} (95 %)",
    ]
    if gain is not None:
        lines.append(f"feedforward = {found.plant.feedforward:.4g}  # {bounds_words(gain, 3)}")
    for name, axis in (("x", x), ("y", y)):
        lines += [
            f"\n[{name}]",
            f"a0_per_s2 = {axis.a0_per_s2.value:.4g}  # {bounds_words(axis.a0_per_s2, 3)}",
            f"a1_per_s = {axis.a1_per_s.value:.4g}  # {bounds_words(axis.a1_per_s, 3)}",
        ]
    return lines


def _filter_lines(found: ParameterEstimate) -> list[str]:
    """Return the own-state filter's settings as identified from the flight."""
    noise = found.noise
    assert noise is not None
    return [
        f"\n# Identified from the same flight: with it, the error of a prediction {AHEAD_S:g} s ahead is "
        f"{noise.predicted_rms_m:.3f} m rms.",
        "[own_filter]",
        f"position_noise_m = {noise.position_noise_m:.3g}",
        f"velocity_noise_m_s = {noise.velocity_noise_m_s:.3g}",
        f"disturbance_noise_m_s2 = {noise.disturbance_noise_m_s2:.3g}",
        f"disturbance_max_m_s2 = {noise.disturbance_max_m_s2:.3g}",
    ]


def _bundled_lines(section: str, autopilot: Autopilot) -> list[str]:
    """Return a section of the autopilot's bundled profile: the keys that differ from the defaults."""
    if not autopilot.is_known:
        return []
    values = getattr(ProfileLibrary(None).load(autopilot.name), section).model_dump(exclude_unset=True)
    if not values:
        return []
    lines = [f"\n# Not in the logs: from the bundled profile '{autopilot.name}'.", f"[{section}]"]
    return lines + [f"{name} = {_toml(value)}" for name, value in values.items()]


def _identified_lines(identified: Identification) -> list[str]:
    lines = ["\n[identified]"]
    for name, value in identified.model_dump().items():
        if name == "covariance":
            lines += [f"# of {', '.join(covariance_of(feedforward=identified.feeds))}", "covariance = ["]
            lines += [f"  [{', '.join(f'{number:.6g}' for number in row)}]," for row in value] + ["]"]
        elif name != "logs" and value is not None:
            lines.append(f"{name} = {_toml(value)}")
    for log in identified.logs:
        lines += ["\n[[identified.logs]]", f"name = {_toml(log.name)}", f"sha256 = {_toml(log.sha256)}"]
    return lines


def _toml(value: object) -> str:
    """Return a value as TOML. Only values use tomli-w, which cannot write the comments with the intervals."""
    plain = value.value if isinstance(value, PlantGrade) else value
    return tomli_w.dumps({"value": plain}).removeprefix("value = ").rstrip()
