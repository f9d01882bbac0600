"""The panels of the paper's figures 1 to 6 (section 5), drawn into axes of the caller.

Paths with the vehicles and the target, speeds in formation, radii, angular velocities and spacings on the ring.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.safety.routes import shapes_of
from agents.settings.sections import NoFlySection
from agents.tactics import Tactic
from estimation.state import Vector
from gcs.metrics.record import FlightRecord, VehicleTrack
from gcs.metrics.references import DesiredRing, FormationReference
from gcs.metrics.result import FlightResult, verdict_states
from gcs.metrics.ring import RingMotion, ring_motion
from gcs.style import COLOURS, DESIRED, ENGAGED, FAIL, FAINT, INK, WINDOW, vehicle_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation


_RING_POINTS = 180
_LABEL_SHARE = 0.08
"""Room for the label of the uppermost ring, as a share of the map's height."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """The data of all panels; lines of more than `points_max` points are thinned, None: no limit.

    The sheet of a flight over several rings has one for each in `rings`: with its `name`, and of the `team` the
    vehicles that were on it. The panels of a ring are drawn from these.
    """

    record: FlightRecord
    result: FlightResult
    ring: DesiredRing
    formation: FormationReference | None
    motion: RingMotion
    points_max: int | None = None
    name: str = ""
    team: tuple[int, ...] = ()
    rings: "tuple[Sheet, ...]" = ()

    def style(self, row: int) -> dict[str, Any]:
        """Return the line style of a vehicle, and its label."""
        label = f"vehicle {self.record.vehicles[row].vehicle_id}"
        return {**vehicle_style(self._place(row), len(self.team or self.record.vehicles)), "label": label}

    def colour(self, row: int) -> str:
        """Return the colour of a vehicle."""
        return COLOURS[self._place(row) % len(COLOURS)]

    def _place(self, row: int) -> int:
        """Return the place of a vehicle in the team."""
        return self.team.index(self.record.vehicles[row].vehicle_id) if self.team else row

    def titled(self, text: str, short: str) -> str:
        """Return the title of a panel: a text, or in short behind the ring's name if there are several."""
        return f"{self.name}: {short}" if self.name else text

    @property
    def each_ring(self) -> "tuple[Sheet, ...]":
        """The sheets of all rings, the sheet itself where there is one ring."""
        return self.rings or (self,)

    def line(self, time_s: Vector, values: Vector) -> tuple[Vector, Vector]:
        """Return the points to draw of a quantity over time."""
        return (time_s, values) if self.points_max is None else thinned(time_s, values, self.points_max)

    @property
    def desired_m(self) -> Vector:
        """The desired radius (T,)."""
        return self.ring.over_m(self.record.time_s)

    @property
    def desired_rad_s(self) -> Vector:
        """The desired angular rate (T,)."""
        return self.ring.over_rad_s(self.record.time_s)

    def path(self, position_m: Vector) -> Vector:
        """Return the points (K, 2) to draw of a path."""
        return position_m if self.points_max is None else thinned_path(position_m, self.points_max)


def sheet_of(
    record: FlightRecord,
    result: FlightResult,
    rings: Sequence[DesiredRing],
    formation: FormationReference | None = None,
    points_max: int | None = None,
) -> Sheet:
    """Return the data of all panels of a flight over these rings, its mission's."""
    sheet = Sheet(record, result, rings[0], formation, ring_motion(record, rings[0].gaps, rings[0].bend), points_max)
    team = tuple(track.vehicle_id for track in record.vehicles)
    sheets = []
    for number, (named, ring) in enumerate(zip(result.rings, rings, strict=bool(result.rings))):
        alone = record.of_ring(number).of_vehicles({vehicle.id for vehicle in named.result.vehicles})
        motion = ring_motion(alone, ring.gaps, ring.bend)
        sheets.append(Sheet(alone, named.result, ring, formation, motion, points_max, named.name, team))
    return replace(sheet, rings=tuple(sheets))


def landmarks_m(sheet: Sheet) -> Vector:
    """Return points (K, 2) that the map must show: every path, the rings that were flown, and a label above them."""
    paths = [track.position_m for track in sheet.record.vehicles]
    for each in sheet.each_ring:
        if each.result.window_s is not None:
            target_m = each.record.target_path_m
            paths += [target_m[-1:] - each.ring.radius_m, target_m[-1:] + each.ring.radius_m]
    points_m = np.concatenate([*paths, *sheet.record.target_paths_m])
    known_m: Vector = points_m[np.isfinite(points_m).all(axis=1)]
    if not known_m.size:
        return np.zeros((1, 2))
    if not sheet.rings:
        return known_m
    x, y = known_m.max(axis=0).tolist()
    with_label_m: Vector = np.vstack((known_m, (x, y + _LABEL_SHARE * float(np.ptp(known_m[:, 1])))))
    return with_label_m


def map_height_in(points_m: Vector, width_in: float) -> float:
    """Return how high a map of these points (K, 2) is, as wide as given and with room for its labels."""
    span_m = np.ptp(points_m, axis=0)
    return float(np.clip(0.85 * width_in * span_m[1] / max(span_m[0], 1e-9) + 0.6, 2.4, 5.0))


def draw_paths(axes: "Axes", sheet: Sheet) -> None:
    """Draw the paths of all vehicles and of the target, and the ring about it - figures 1 and 4."""
    record = sheet.record
    axes.update_datalim(landmarks_m(sheet))
    axes.margins(0.04)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    title(axes, f"{record.mission}: paths", _verdict_line(sheet.result), is_fault=sheet.result.passes is False)
    names = dict(zip(record.ring_targets, (each.target for each in sheet.result.rings), strict=False))
    ring_names = _draw_rings(axes, sheet)
    _draw_zones(axes, sheet.ring.zones)
    for number, target_m in enumerate(record.target_paths_m):
        name = names.get(number, "")
        _draw_target(axes, sheet, target_m, "" if name in ring_names else name)
    for row, track in enumerate(record.vehicles):
        axes.plot(*sheet.path(track.position_m).T, alpha=0.85, **sheet.style(row))
    for row, track in enumerate(record.vehicles):
        _mark_engagement(axes, sheet, row, track.position_m[:, 0], track.position_m[:, 1])
        mark_vehicle(axes, track, sheet.colour(row))


def _draw_target(axes: "Axes", sheet: Sheet, path_m: Vector, name: str) -> None:
    known_m = path_m[np.isfinite(path_m).all(axis=1)]
    if not known_m.size:
        return
    axes.plot(*sheet.path(known_m).T, color="black", linewidth=1.2, zorder=3)
    axes.plot(*known_m[0], marker="D", markersize=6, markerfacecolor="white", color="black", zorder=5)
    axes.plot(*known_m[-1], marker="D", markersize=8, color="black", zorder=6)
    if name:
        axes.annotate(
            name, known_m[-1], (8, 0), textcoords="offset points", va="center", fontsize=9, color=INK, zorder=9
        )


def _draw_rings(axes: "Axes", sheet: Sheet) -> set[str]:
    """Draw the rings that were flown about the last positions of their targets; return the names of several."""
    from matplotlib.patches import Polygon  # noqa: PLC0415

    outlines = dict[tuple[float, float, float], Vector]()
    drawn, names = set[str](), dict[tuple[float, float, float], list[str]]()
    for each in sheet.each_ring:
        path_m = each.record.target_path_m
        known_m = path_m[np.isfinite(path_m).all(axis=1)]
        if each.result.window_s is not None and known_m.size:
            x, y = known_m[-1].tolist()
            names.setdefault((x, y, each.ring.radius_m), []).append(ring_label(each))
            outlines[x, y, each.ring.radius_m] = known_m[-1] + each.ring.outline_m(_RING_POINTS)
            drawn.add(each.name)
    for (x, y, radius_m), labels in names.items():
        axes.add_patch(Polygon(outlines[x, y, radius_m], fill=False, **DESIRED))
        if sheet.rings:
            name_ring(axes, (x, y + radius_m), ", ".join(labels))
    return drawn


def _draw_zones(axes: "Axes", zones: Sequence[NoFlySection]) -> None:
    """Draw no-fly zones, hatched, with their names; those out of sight do not widen the map."""
    from matplotlib.patches import Polygon  # noqa: PLC0415

    for zone, corners_m in zip(zones, shapes_of(zones, 0.0), strict=True):
        axes.add_artist(Polygon(corners_m, facecolor="none", edgecolor=FAIL, hatch="//", linewidth=0.8, zorder=2))
        x, y = corners_m.mean(axis=0).tolist()
        axes.annotate(
            zone.name, (x, y), ha="center", va="center", fontsize=8, color=INK, zorder=9, annotation_clip=True
        )


def name_ring(axes: "Axes", top_m: tuple[float, float], label: str) -> "Annotation":
    """Write the label of a ring above its highest point on the map, and above a vehicle there."""
    return axes.annotate(
        label, top_m, (0, 9), textcoords="offset points", ha="center", va="bottom", fontsize=9, color=INK, zorder=9
    )


def ring_label(sheet: Sheet) -> str:
    """Return the name of a ring, with the height of its lowest vehicle if it has heights of its own."""
    height_m = ring_height_m(sheet)
    return sheet.name if height_m is None else f"{sheet.name} ({height_m:g} m high)"


def ring_height_m(sheet: Sheet) -> float | None:
    """Return the height at the ring's centre of the lowest vehicle that was on it, None without heights of its own."""
    ids = {track.vehicle_id for track in sheet.record.vehicles}
    return min((height_m for each, height_m in sheet.ring.heights_m.items() if each in ids), default=None)


def mark_vehicle(axes: "Axes", track: VehicleTrack, colour: str) -> None:
    """Mark where a vehicle began and where it ended, there with its id."""
    known_m = track.position_m[np.isfinite(track.position_m).all(axis=1)]
    if not known_m.size:
        return
    axes.plot(*known_m[0], marker="o", markersize=4, color=colour, zorder=5)
    axes.plot(*known_m[-1], marker="D", markersize=12, color=colour, markeredgecolor="white", zorder=7)
    axes.annotate(
        str(track.vehicle_id),
        known_m[-1],
        ha="center",
        va="center_baseline",
        fontsize=8 if track.vehicle_id < 10 else 7,
        fontweight="bold",
        color="white",
        zorder=8,
    )


def _mark_engagement(axes: "Axes", sheet: Sheet, row: int, x: Vector, y: Vector) -> None:
    """Circle the sample of a line at which its vehicle engaged."""
    engaged_s = sheet.result.vehicles[row].engaged_at_s
    if engaged_s is None:
        return
    sample = int(np.argmin(np.abs(sheet.record.time_s - engaged_s)))
    axes.plot(x[sample], y[sample], color=sheet.colour(row), zorder=6, **ENGAGED)


def draw_speeds(axes: "Axes", sheet: Sheet) -> None:
    """Draw the speed in the direction of the formation - figure 2."""
    title(axes, "Speed in formation", "")
    axes.set(xlabel="time [s]", ylabel="speed in x [m/s]")
    if sheet.formation is not None:
        axes.axhline(sheet.formation.speed_m_s, **DESIRED)
    time_s, end_s = sheet.record.time_s, 0.0
    for row, track in enumerate(sheet.record.vehicles):
        flying = track.tactic == Tactic.FORMATION.value
        speed_m_s = np.where(flying, track.velocity_m_s[:, 0], np.nan)
        axes.plot(*sheet.line(time_s, speed_m_s), **sheet.style(row))
        engaged_s = sheet.result.vehicles[row].engaged_at_s
        if engaged_s is not None and flying[time_s < engaged_s][-1:].any():  # not one in transit, whose line has ended
            _mark_engagement(axes, sheet, row, time_s, _held(speed_m_s))
        end_s = max(end_s, float(time_s[flying][-1])) if flying.any() else end_s
    if end_s > 0.0:
        axes.set_xlim(0.0, 1.03 * end_s)
    else:
        mark_empty(axes, "no vehicle flew in formation")


def _held(values: Vector) -> Vector:
    """Replace every NaN with the last number before it, for a mark just after the end of a line."""
    known = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(values.size)))
    return values[known]


def draw_radii(axes: "Axes", sheet: Sheet) -> None:
    """Draw the distances to the target on the ring - figures 3 and 5."""
    axes.set(xlabel="time [s]", ylabel="radius [m]")
    errors_m = [v.radius_error_rms_m for v in sheet.result.vehicles if v.radius_error_rms_m is not None]
    title(
        axes,
        sheet.titled("Radius about the target", "radius"),
        f"largest error {max(errors_m):.2g} m rms" if errors_m else "",
    )
    _draw_ring_panel(axes, sheet, sheet.motion.radius_m, sheet.desired_m)


def draw_rates(axes: "Axes", sheet: Sheet) -> None:
    """Draw the angular velocities about the target - figures 3 and 5."""
    axes.set(xlabel="time [s]", ylabel="angular velocity [rad/s]")
    means_rad_s = [v.angular_rate_mean_rad_s for v in sheet.result.vehicles if v.angular_rate_mean_rad_s is not None]
    title(
        axes,
        sheet.titled("Angular velocity", "angular velocity"),
        f"mean {np.mean(means_rad_s):.4f} rad/s" if means_rad_s else "",
    )
    desired_rad_s = sheet.desired_rad_s
    _draw_ring_panel(axes, sheet, sheet.motion.rate_rad_s, desired_rad_s)
    # The rate of a vehicle that passes close to the target is far out of scale.
    low_rad_s, high_rad_s = axes.get_ylim()
    least_rad_s, most_rad_s = min(desired_rad_s, default=0.0), max(desired_rad_s, default=0.0)
    reach_rad_s = 4.0 * max(abs(least_rad_s), abs(most_rad_s), 0.05)
    axes.set_ylim(max(low_rad_s, least_rad_s - reach_rad_s), min(high_rad_s, most_rad_s + reach_rad_s))


def draw_spacings(axes: "Axes", sheet: Sheet) -> None:
    """Draw the angle from each vehicle to the next on the ring - figure 6."""
    axes.set(xlabel="time [s]", ylabel="spacing [°]")
    error_deg = sheet.result.ring.spacing_error_rms_deg
    title(
        axes,
        sheet.titled("Angular separation", "spacing"),
        f"error {error_deg:.2g}° rms" if error_deg is not None else "",
    )
    lead_deg, desired_deg = np.degrees(sheet.motion.lead_rad), np.degrees(sheet.motion.desired_spacing_rad)
    if sheet.result.window_s is not None and np.isnan(lead_deg).all():
        mark_empty(axes, "one vehicle on the ring: no spacing")
    else:
        _draw_ring_panel(axes, sheet, lead_deg, desired_deg)


def _draw_ring_panel(axes: "Axes", sheet: Sheet, values: Vector, desired: Vector | float) -> None:
    """Draw one quantity (V, T) of the ring, from the first engagement on, over the window of the metrics."""
    if sheet.result.window_s is None:
        mark_empty(axes, "no vehicle was on this ring" if sheet.name else "no vehicle engaged")
        return
    time_s = sheet.record.time_s
    first_s = min(v.engaged_at_s for v in sheet.result.vehicles if v.engaged_at_s is not None)
    axes.set_xlim(first_s - 0.02 * (time_s[-1] - first_s), time_s[-1])
    axes.axvspan(*sheet.result.window_s, color=WINDOW, zorder=0)
    for each in _distinct(desired):
        axes.plot(*sheet.line(time_s, np.where(time_s >= first_s, each, np.nan)), **DESIRED)
    for row in range(len(values)):
        axes.plot(*sheet.line(time_s, values[row]), **sheet.style(row))
    for row in range(len(values)):
        _mark_engagement(axes, sheet, row, time_s, values[row])
    axes.ticklabel_format(axis="y", useOffset=False)


def _distinct(desired: Vector | float) -> Vector:
    """Return lines (K, T) through the values desired at each time, every value once."""
    lines: Vector = np.sort(np.atleast_2d(desired), axis=0)
    lines[1:][np.diff(lines, axis=0) == 0.0] = np.nan
    return np.asarray(lines[~np.isnan(lines).all(axis=1)])


def _verdict_line(result: FlightResult) -> str:
    return "   ".join(f"{name} {state.sign}" for name, state in verdict_states(result).items())


def title(axes: "Axes", text: str, finding: str, *, is_fault: bool = False) -> None:
    """Set the title of a panel on the left, and its main figure on the right; a fault is coloured."""
    axes.set_title(text, loc="left", fontweight="bold", parse_math=False)
    axes.set_title(finding, loc="right", fontsize=9, color=FAIL if is_fault else FAINT)


def mark_empty(axes: "Axes", text: str) -> None:
    """Write into a panel why it is empty."""
    axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=FAINT)


def empty_reason(axes: "Axes") -> str:
    """Return the reason that `mark_empty` wrote into a panel; empty if the panel holds data."""
    return axes.texts[0].get_text() if axes.texts and not axes.get_xticks().size else ""


def thinned(time_s: Vector, values: Vector, points_max: int) -> tuple[Vector, Vector]:
    """Return at most `points_max` points of a line (at least 8): its ends, and the extremes of every block.

    Every peak is kept. A block with a NaN keeps one, so that the line is interrupted there.
    """
    kept = _kept(values[:, None], points_max) if values.size > points_max else slice(None)
    return time_s[kept], values[kept]


def thinned_path(position_m: Vector, points_max: int) -> Vector:
    """Return at most `points_max` points (at least 8) of a path (T, 2): its ends, and the extremes in x and in y."""
    return position_m[_kept(position_m, points_max)] if len(position_m) > points_max else position_m


def _kept(columns: Vector, points_max: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the indices of the samples (T, C) to keep, in order: per block, two per column and one for a NaN."""
    samples, width = columns.shape
    count = max(1, (points_max - 2) // (2 * width + 1))
    length = -(-samples // count)
    padded = np.full((count * length, width), np.nan)
    padded[:samples] = columns
    blocks = padded.reshape(count, length, width)
    missing = np.isnan(blocks)
    lowest = np.where(missing, np.inf, blocks).argmin(axis=1)
    highest = np.where(missing, -np.inf, blocks).argmax(axis=1)
    gap = missing.any(axis=2).argmax(axis=1)[:, None]
    within = np.concatenate((lowest, highest, gap), axis=1)
    # Without a NaN the last column is 0, the first sample of the block: one point more, on the line.
    index = np.unique(within + length * np.arange(count)[:, None])
    return np.unique(np.concatenate(([0], index[index < samples], [samples - 1])))
