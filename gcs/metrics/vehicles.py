"""The metrics of every vehicle: on the ring in the window of the ring metrics, and before it in formation.

Arrays over the whole team have shape (V, T): vehicles in the record's order, samples in time. NaN marks samples
without a measurement, and averages ignore it.
"""

from dataclasses import dataclass

import numpy as np

from agents.tactics import NO_TACTIC, Tactic
from estimation.state import Vector
from gcs.metrics.pointing import pointing_error_rms_deg
from gcs.metrics.record import (
    ANOTHER_RING,
    GAP_MAX_S,
    TIME_GRAIN_S,
    FlightRecord,
    Mask,
    VehicleTrack,
    grid_time,
    largest,
    lasting_s,
    rms,
)
from gcs.metrics.references import DesiredRing, FormationReference
from gcs.metrics.ring import SETTLED_FOR_S, RingMotion, flies, measured

FORMATION_START_S = 30.0


@dataclass(frozen=True, slots=True)
class VehicleResult:
    """One vehicle's metrics; `tactic` is the last one received, `unknown` without any."""

    id: int
    engaged_at_s: float | None
    tactic: str
    radius_error_rms_m: float | None = None
    radius_error_max_m: float | None = None
    angular_rate_mean_rad_s: float | None = None
    angular_rate_error_rms_rad_s: float | None = None
    formation_speed_error_rms_m_s: float | None = None
    formation_spacing_error_rms_m: float | None = None
    height_error_rms_m: float | None = None
    pointing_error_rms_deg: float | None = None


@dataclass(frozen=True, slots=True)
class EstimatedVehicleResult:
    """One vehicle's ring metrics by its own estimates of itself and of the target, over the window of the ring metrics.

    `estimate_error_*` are the horizontal distances of the estimate of its own position from the truth.
    """

    id: int
    radius_error_rms_m: float | None = None
    radius_error_max_m: float | None = None
    angular_rate_mean_rad_s: float | None = None
    estimate_error_rms_m: float | None = None
    estimate_error_max_m: float | None = None


def vehicle_results(
    record: FlightRecord,
    motion: RingMotion,
    ring: DesiredRing,
    formation: FormationReference,
    window: Mask,
) -> tuple[VehicleResult, ...]:
    """Return the metrics of every vehicle, in the record's order."""
    engaged_s = engagement_times_s(record)
    speed_error_m_s, spacing_error_m = formation_errors(record, formation)
    known = measured(record)
    desired_m, desired_rad_s = ring.over_m(record.time_s), ring.over_rad_s(record.time_s)
    results = []
    for row, track in enumerate(record.vehicles):
        radius_error_m = (motion.radius_m[row] - desired_m)[window]
        rate_rad_s, bearing_rad = motion.rate_rad_s[row, window], motion.bearing_rad[row, window]
        last_tactic = track.tactic[known[row]][-1:]
        result = VehicleResult(
            id=track.vehicle_id,
            engaged_at_s=engaged_s[row],
            tactic=str(last_tactic[0]) if last_tactic.size else NO_TACTIC,
            radius_error_rms_m=rms(radius_error_m),
            radius_error_max_m=largest(radius_error_m),
            angular_rate_mean_rad_s=_mean_rate_rad_s(record.time_s[window], bearing_rad, rate_rad_s),
            angular_rate_error_rms_rad_s=rms(rate_rad_s - desired_rad_s[window]),
            formation_speed_error_rms_m_s=rms(speed_error_m_s[row]),
            formation_spacing_error_rms_m=rms(spacing_error_m[row]),
            height_error_rms_m=_height_error_rms_m(record.time_s, track, ring, motion.bearing_rad[row], window),
            pointing_error_rms_deg=pointing_error_rms_deg(record, track, window),
        )
        results.append(result)
    return tuple(results)


def _height_error_rms_m(
    time_s: Vector, track: VehicleTrack, ring: DesiredRing, bearing_rad: Vector, window: Mask
) -> float | None:
    """Return the error of the height on the last commanded ring, None where its heights are the flying heights."""
    if track.altitude_m is None:
        return None
    judged = window & ~ring.changes(time_s) & (time_s >= max(ring.changed_s, default=-np.inf))
    return rms((track.altitude_m - ring.height_m(track.vehicle_id, bearing_rad))[judged])


def estimated_vehicles(
    record: FlightRecord, motion: RingMotion, ring: DesiredRing, window: Mask
) -> tuple[EstimatedVehicleResult, ...]:
    """Return the ring metrics of every vehicle by estimate, and the errors of the estimates."""
    vehicles = []
    desired_m = ring.over_m(record.time_s)
    for row, (estimate, true) in enumerate(zip(record.estimates, record.vehicles, strict=True)):
        radius_error_m = (motion.radius_m[row] - desired_m)[window]
        off_m = np.hypot(*(estimate.position_m - true.position_m).T)[window]
        bearing_rad, rate_rad_s = motion.bearing_rad[row, window], motion.rate_rad_s[row, window]
        result = EstimatedVehicleResult(
            id=estimate.vehicle_id,
            radius_error_rms_m=rms(radius_error_m),
            radius_error_max_m=largest(radius_error_m),
            angular_rate_mean_rad_s=_mean_rate_rad_s(record.time_s[window], bearing_rad, rate_rad_s),
            estimate_error_rms_m=rms(off_m),
            estimate_error_max_m=largest(off_m),
        )
        vehicles.append(result)
    return tuple(vehicles)


def engagement_times_s(record: FlightRecord) -> tuple[float | None, ...]:
    """Return the time at which each vehicle's tactic was encircle first, None where it never was."""
    return _first_s(record, Tactic.ENCIRCLE)


def flown_again_s(record: FlightRecord) -> tuple[float, ...]:
    """Return when vehicles came to the ring in another flight: after one that ended earlier, or after a restart."""
    times_s: list[float] = []
    for track in record.vehicles:
        known = np.flatnonzero(track.tactic != NO_TACTIC)
        gaps = np.flatnonzero(record.time_s[known[1:]] - record.time_s[known[:-1]] > GAP_MAX_S) + 1
        for gap in gaps:
            later = known[gap:]
            on = later[track.tactic[later] == Tactic.ENCIRCLE.value]
            if on.size and track.tactic[later[0]] == Tactic.STANDBY.value:
                times_s.append(grid_time(float(record.time_s[on[0]])))
    return tuple(times_s)


def left_formation_s(record: FlightRecord) -> tuple[float | None, ...]:
    """Return when each vehicle was on its way to a ring or on it first, None where it never was."""
    return _first_s(record, Tactic.TRANSIT, Tactic.ENCIRCLE)


def _first_s(record: FlightRecord, *tactics: Tactic) -> tuple[float | None, ...]:
    names = [each.value for each in tactics]
    hits = (np.flatnonzero(np.isin(track.tactic, names)) for track in record.vehicles)
    return tuple(grid_time(float(record.time_s[hit[0]])) if hit.size else None for hit in hits)


def moved_s(record: FlightRecord) -> tuple[float, ...]:
    """Return when vehicles came to the record's ring on their way from another, or left it for another.

    One that flew something else between the two left at the end of the first, and came at the begin of the second.
    """
    moves_s: list[float] = []
    for track in record.vehicles:
        on = np.flatnonzero(np.isin(track.tactic, (Tactic.ENCIRCLE.value, Tactic.TRANSIT.value, ANOTHER_RING)))
        here = track.tactic[on] == Tactic.ENCIRCLE.value
        leaves, comes = on[:-1][here[:-1] & ~here[1:]] + 1, on[1:][~here[:-1] & here[1:]]
        moves_s += [grid_time(each) for each in record.time_s[np.concatenate((leaves, comes))].tolist()]
    return tuple(moves_s)


def formation_errors(record: FlightRecord, formation: FormationReference) -> tuple[Vector, Vector]:
    """Return the errors of every velocity [m/s] and spacing [m] in formation, (V, T) each.

    Defined from 30 s after the start to the first engagement, for vehicles in formation; NaN elsewhere, and where none
    was in formation for `SETTLED_FOR_S` then. The first vehicle of the line has no spacing.
    """
    judged = formation_span(record.time_s, left_formation_s(record))
    mask = np.asarray(measured(record) & flies(record, Tactic.FORMATION) & judged)
    if lasting_s(record.time_s, np.asarray(mask.any(axis=0))) < SETTLED_FOR_S - TIME_GRAIN_S:
        mask[:] = False
    speed_error_m_s = np.full(mask.shape, np.nan)
    for row, track in enumerate(record.vehicles):
        speed_error_m_s[row, mask[row]] = np.hypot(*(track.velocity_m_s[mask[row]] - (formation.speed_m_s, 0.0)).T)
    return speed_error_m_s, _formation_spacing_error_m(record, formation, mask)


def formation_span(time_s: Vector, left_s: tuple[float | None, ...]) -> Mask:
    """Return the samples (T,) between 30 s and the first engagement, or the first way to one."""
    first_s = min((left for left in left_s if left is not None), default=np.inf)
    return np.asarray((time_s >= FORMATION_START_S - TIME_GRAIN_S) & (time_s < first_s - TIME_GRAIN_S))


def _formation_spacing_error_m(record: FlightRecord, formation: FormationReference, mask: Mask) -> Vector:
    """Return the distance of each vehicle (V, T) from its slot relative to its predecessor in slot order.

    A predecessor that is not in formation is skipped; NaN where there is none.
    """
    row_of = {track.vehicle_id: row for row, track in enumerate(record.vehicles)}
    error_m = np.full(mask.shape, np.nan)
    ahead_m = np.full((record.time_s.size, 2), np.nan)  # the predecessor's deviation from its slot
    for vehicle_id, slot_m in formation.slots_m.items():
        if vehicle_id not in row_of:
            continue
        row = row_of[vehicle_id]
        here_m = np.where(mask[row, :, None], record.vehicles[row].position_m - np.asarray(slot_m), np.nan)
        error_m[row] = np.hypot(*(here_m - ahead_m).T)
        ahead_m = np.where(mask[row, :, None], here_m, ahead_m)
    return error_m


def _mean_rate_rad_s(time_s: Vector, bearing_rad: Vector, rate_rad_s: Vector) -> float | None:
    """Return the unwrapped change of bearing over its duration, None from fewer than two samples.

    The integral of the measured rate resolves the number of turns across gaps longer than half a turn.
    """
    known = np.isfinite(bearing_rad) & np.isfinite(rate_rad_s)
    if known.sum() < 2:
        return None
    time_s, bearing_rad, rate_rad_s = time_s[known], bearing_rad[known], rate_rad_s[known]
    steps_rad = np.diff(time_s) * (rate_rad_s[1:] + rate_rad_s[:-1]) / 2.0
    turned_rad = np.concatenate(([0.0], np.cumsum(steps_rad)))
    unwrapped_rad = turned_rad + np.unwrap(bearing_rad - turned_rad)
    return float((unwrapped_rad[-1] - unwrapped_rad[0]) / (time_s[-1] - time_s[0]))
