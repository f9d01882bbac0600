"""Panels of on-board data: estimation errors, computing time, reception, height, yaw and battery."""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from estimation.state import Vector
from gcs.report.charts.chart import levels, logarithmic, over_time
from gcs.report.charts.panels import Sheet, ring_height_m, title
from gcs.report.evidence.estimate_errors import SIGMAS, EstimateError
from gcs.report.evidence.flight import FlightEvidence, Reception
from gcs.style import FAIL, INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Percentile of the vertical scale: the first estimates are as uncertain as their priors.
_SHOWN_SHARE = 99.0


def draw_errors(axes: "Axes", sheet: Sheet, errors: Iterable[EstimateError], axis: int, heading: str) -> None:
    """Draw the errors along one axis, with the 3σ bounds of each vehicle's own covariance."""
    errors = tuple(errors)
    title(axes, heading, "")
    over_time(axes, f"in {'xy'[axis]} [m]", np.array([errors[0].time_s[0], errors[0].time_s[-1]]))
    axes.set_xlim(min(e.time_s[0] for e in errors), max(e.time_s[-1] for e in errors))
    reach_m = 1e-3
    for error in errors:
        bound_m, error_m = SIGMAS * error.sigma_m[:, axis], error.error_m[:, axis]
        style = sheet.style(error.row)
        for side in (-1.0, 1.0):
            label = f"{style['label']}, 3σ" if side > 0.0 else "_"
            thin = style | {"linewidth": 0.9, "alpha": 0.55, "linestyle": (0, (2, 1.5)), "label": label}
            axes.plot(*sheet.line(error.time_s, side * bound_m), **thin)
        axes.plot(*sheet.line(error.time_s, error_m), **style | {"linewidth": 0.8})
        spread_m = np.concatenate((bound_m, np.abs(error_m[np.isfinite(error_m)])))
        reach_m = max(reach_m, float(np.percentile(spread_m, _SHOWN_SHARE)))
    axes.axhline(0.0, color=INK, linewidth=0.6, zorder=1)
    axes.set_ylim(-1.25 * reach_m, 1.25 * reach_m)


def draw_ticks(axes: "Axes", sheet: Sheet, evidence: FlightEvidence) -> None:
    """Draw the computing time of each tick with its median, 99 % and the period, and mark skipped ticks."""
    timed = [v for v in evidence.vehicles if v.loop.time_s.size]
    all_us = np.concatenate([v.loop.tick_us for v in timed])
    p50_us, p99_us = np.percentile(all_us, (50, 99))
    title(axes, "Computing time of a tick", f"median {p50_us:.0f} µs, 99 % {p99_us:.0f} µs")
    over_time(axes, "computing time [µs]", np.array([v.loop.time_s[0] for v in timed] + [timed[0].loop.time_s[-1]]))
    axes.set_xlim(min(v.loop.time_s[0] for v in timed), max(v.loop.time_s[-1] for v in timed))
    # The period of the wall's clock, which the computing times are of as well.
    period_us = 1e6 / (sheet.record.loop.rate_hz * evidence.speed)
    logarithmic(axes, np.append(all_us, period_us), 1.0)
    for row, vehicle in enumerate(evidence.vehicles):
        loop = vehicle.loop
        axes.plot(*sheet.line(loop.time_s, loop.tick_us), **sheet.style(row) | {"linewidth": 0.7, "alpha": 0.8})
        late = loop.skipped > 0
        axes.plot(loop.time_s[late], np.full(late.sum(), 0.7 * period_us), "x", color=FAIL, markersize=6, zorder=8)
    levels(axes, {f"period, {1e-3 * period_us:.3g} ms": period_us, "median": float(p50_us), "99 %": float(p99_us)})


def draw_reception(
    axes: "Axes", sheet: Sheet, received: Iterable[tuple[int, Vector, Vector]], label: str, what: str
) -> None:
    """Draw times [ms] (K,) at (K,) moments of several vehicles, each by its row."""
    series = [(row, time_s, value_ms) for row, time_s, value_ms in received if time_s.size]
    everything_ms = np.concatenate([value_ms for _, _, value_ms in series])
    median_ms, worst_ms = np.percentile(everything_ms, (50, 100))
    title(axes, what, f"median {median_ms:.0f} ms, max {worst_ms:.0f} ms")
    over_time(axes, label, np.empty(0))
    axes.set_xlim(min(time_s[0] for _, time_s, _ in series), max(time_s[-1] for _, time_s, _ in series))
    for row, time_s, value_ms in series:
        axes.plot(*sheet.line(time_s, value_ms), **sheet.style(row) | {"linewidth": 0.9, "alpha": 0.85})
    top_ms = max(1.0, 1.08 * float(worst_ms))
    axes.set_ylim(-0.02 * top_ms, top_ms)


def intervals_ms(reception: Reception, speed: float) -> tuple[Vector, Vector]:
    """Return the reception time of each message but the first, and the interval to the previous one [wall ms]."""
    return reception.received_s[1:], 1e3 * np.diff(reception.received_s) / speed


def ages_by_sender(evidence: FlightEvidence) -> list[tuple[int, Vector, Vector]]:
    """Return the ages [ms] of each sender's messages at all receivers, in order of reception."""
    ages = []
    for row, sender in enumerate(evidence.vehicles):
        received = [each.peers[sender.vehicle_id] for each in evidence.vehicles if sender.vehicle_id in each.peers]
        if received:
            received_s = np.concatenate([each.received_s for each in received])
            order = np.argsort(received_s, kind="stable")
            ages.append((row, received_s[order], 1e3 * np.concatenate([each.age_s for each in received])[order]))
    return ages


def draw_altitudes(axes: "Axes", sheet: Sheet, evidence: FlightEvidence) -> None:
    """Draw the heights above the mission's origin, and the height of each ring if there are several."""
    title(axes, "Height", "")
    _draw_each(axes, sheet, "height [m]", evidence, lambda row: _height(evidence, row))
    if heights_m := {each.name: height_m for each in sheet.rings if (height_m := ring_height_m(each)) is not None}:
        levels(axes, heights_m)


def draw_yaws(axes: "Axes", sheet: Sheet, evidence: FlightEvidence) -> None:
    """Draw the yaws of the setpoints."""
    title(axes, "Yaw of the setpoints", "counter-clockwise from x")
    _draw_each(axes, sheet, "yaw [°]", evidence, lambda row: _yaw(evidence, row))
    axes.set_ylim(-185.0, 185.0)
    axes.set_yticks(range(-180, 181, 90))


def draw_batteries(axes: "Axes", sheet: Sheet, evidence: FlightEvidence) -> None:
    """Draw the charge of the batteries."""
    title(axes, "Battery", "")
    _draw_each(axes, sheet, "battery [%]", evidence, lambda row: _battery(evidence, row))
    axes.set_ylim(0.0, 105.0)


def _draw_each(
    axes: "Axes",
    sheet: Sheet,
    label: str,
    evidence: FlightEvidence,
    of: Callable[[int], tuple[Vector, Vector]],
) -> None:
    over_time(axes, label, sheet.record.time_s)
    for row in range(len(evidence.vehicles)):
        axes.plot(*sheet.line(*of(row)), **sheet.style(row))


def _height(evidence: FlightEvidence, row: int) -> tuple[Vector, Vector]:
    vehicle = evidence.vehicles[row]
    samples = min(vehicle.own.time_s.size, vehicle.altitude_m.size)
    return vehicle.own.time_s[:samples], vehicle.altitude_m[:samples]


def _yaw(evidence: FlightEvidence, row: int) -> tuple[Vector, Vector]:
    """Return the yaws [degrees], with NaN where the yaw wraps, so that the line is interrupted there."""
    loop = evidence.vehicles[row].loop
    wraps = np.abs(np.diff(loop.yaw_rad, prepend=np.nan)) > np.pi
    return loop.time_s[: wraps.size], np.where(wraps, np.nan, np.degrees(loop.yaw_rad))


def _battery(evidence: FlightEvidence, row: int) -> tuple[Vector, Vector]:
    held = evidence.vehicles[row].battery
    return held[:, 0], 100.0 * held[:, 1]
