"""The metrics of a flight, computed from its record: the definitions behind `--json` and the verdicts.

Arrays over the whole team have shape (V, T): vehicles in the record's order, samples in time. NaN marks samples
without a measurement, and averages ignore it.
"""

from dataclasses import replace

import numpy as np

from estimation.state import Vector
from gcs.metrics.ending import FlightEnding
from gcs.metrics.engagement import EngagementReference, engagement
from gcs.metrics.record import FlightRecord, Mask
from gcs.metrics.result import (
    EstimatedVehicleResult,
    EstimateResult,
    FlightResult,
    FormationReference,
    LoopResult,
    ReynoldsResult,
    RingReference,
    RingResult,
    VehicleResult,
    VerdictTolerances,
    judge,
)
from gcs.metrics.reynolds import condensed, flocking
from gcs.metrics.ring_motion import RingMotion, flies, measured, off_ring, ring_motion
from gcs.metrics.transitions import transitions

NONE_ENGAGES = EngagementReference()
FORMATION_START_S = 30.0
SETTLED_FOR_S = 10.0
"""A ring that stays within its limits for this time has settled, even if it leaves them later."""
# Rounding errors of times on the record's grid are smaller than this.
TIME_GRAIN_S = 1e-6


def evaluate(
    record: FlightRecord,
    ring: RingReference,
    formation: FormationReference,
    tolerances: VerdictTolerances,
    engages: EngagementReference = NONE_ENGAGES,
) -> FlightResult:
    """Compute the metrics and verdicts of a flight; without a reference no vehicle was to engage."""
    end_s = float(record.time_s[-1]) if record.time_s.size else 0.0
    each_engaged_s, motion = engagement_times_s(record), ring_motion(record)
    engaged_s = [time_s for time_s in each_engaged_s if time_s is not None]
    window_s, ring_result = _judged_ring(record.time_s, motion, ring, engaged_s)
    vehicles = _vehicle_results(record, motion, ring, formation, window := _within(record.time_s, window_s))
    closest_m, engagers = _closest_approach_m(record), engagement(record, engages, each_engaged_s)
    return FlightResult(
        mission=record.mission,
        seed=record.seed,
        source=record.source,
        reference=record.reference,
        duration_s=_grid_time(end_s),
        window_s=window_s,
        vehicles=vehicles,
        ring=ring_result,
        transitions=transitions(record, motion, ring, engaged_s),
        reynolds=_reynolds(record, window),
        closest_approach_m=closest_m,
        guard_interventions=None if record.guard is None else record.guard.interventions,
        guard_causes={} if record.guard is None else dict(record.guard.causes),
        loop=LoopResult.of(record.loop),
        verdicts=replace(judge(vehicles, ring_result, closest_m, ring, tolerances), engaged=engagers.holds),
        wall_time_s=record.wall_time_s,
        realtime_factor=end_s / record.wall_time_s if record.wall_time_s > 0.0 else None,
        events=record.events,
        estimate=_estimate_result(record, ring, window),
        truth_missing=record.truth_missing or None,
        ended=FlightEnding.of(record.endings),
        engagement=engagers,
        faults=record.faults,
        kinds=record.kinds,
    )


def _judged_ring(
    time_s: Vector, motion: RingMotion, ring: RingReference, engaged_s: list[float]
) -> tuple[tuple[float, float] | None, RingResult]:
    """Return the window of the ring metrics, None where none engaged, and the ring as a whole."""
    if not engaged_s:
        return None, RingResult()
    settled_s = _settled_at_s(time_s, motion, ring, max(engaged_s))
    window_s = _window_s(time_s, settled_s)
    settling_time_s = None if settled_s is None else _grid_time(settled_s - max(engaged_s))
    errors_deg = _spacing_errors_deg(motion, _within(time_s, window_s))
    return window_s, RingResult(settling_time_s, *errors_deg, *_unsettled(time_s, motion, ring, max(engaged_s)))


def engagement_times_s(record: FlightRecord) -> tuple[float | None, ...]:
    """Return the time at which each vehicle's tactic was encircle first, None where it never was."""
    hits = (np.flatnonzero(track.tactic == "encircle") for track in record.vehicles)
    return tuple(_grid_time(float(record.time_s[hit[0]])) if hit.size else None for hit in hits)


def formation_errors(record: FlightRecord, formation: FormationReference) -> tuple[Vector, Vector]:
    """Return the errors of every velocity [m/s] and spacing [m] in formation, (V, T) each.

    Defined from 30 s after the start to the first engagement, for vehicles in formation; NaN elsewhere. The first
    vehicle of the line has no spacing.
    """
    judged = _formation_span(record.time_s, engagement_times_s(record))
    mask = np.asarray(measured(record) & flies(record, "formation") & judged)
    speed_error_m_s = np.full(mask.shape, np.nan)
    for row, track in enumerate(record.vehicles):
        speed_error_m_s[row, mask[row]] = np.hypot(*(track.velocity_m_s[mask[row]] - (formation.speed_m_s, 0.0)).T)
    return speed_error_m_s, _formation_spacing_error_m(record, formation, mask)


def _settled_at_s(time_s: Vector, motion: RingMotion, ring: RingReference, last_engaged_s: float) -> float | None:
    """Return the time after the last engagement from which the ring stays within its limits to the end, or None."""
    outside = np.flatnonzero(off_ring(motion, ring))
    # Settling starts at a sample at which every member of the ring was measured.
    valid = motion.measured & (time_s >= last_engaged_s - TIME_GRAIN_S)
    valid[: outside[-1] + 1 if outside.size else 0] = False
    return float(time_s[np.argmax(valid)]) if valid.any() else None


def _unsettled(
    time_s: Vector, motion: RingMotion, ring: RingReference, last_engaged_s: float
) -> tuple[float | None, float | None]:
    """Return when the ring had settled first, and when it left its limits last after that; None if it never did.

    It counts as settled once it was within its limits for `SETTLED_FOR_S`.
    """
    off = off_ring(motion, ring)
    known = (off | motion.measured) & (time_s >= last_engaged_s - TIME_GRAIN_S)
    off, at_s = off[known], time_s[known]
    changes = np.flatnonzero(np.diff(off)) + 1
    begins, ends = np.append(0, changes), np.append(changes, off.size)
    stays = [
        (at_s[begin], at_s[end]) for begin, end in zip(begins, ends, strict=True) if end < off.size and not off[begin]
    ]
    settled_s = next((begin_s for begin_s, end_s in stays if end_s - begin_s >= SETTLED_FOR_S), None)
    if settled_s is None:
        return None, None
    return _grid_time(float(settled_s)), _grid_time(float(stays[-1][1]))


def _window_s(time_s: Vector, settled_s: float | None) -> tuple[float, float]:
    start_s, end_s = float(time_s[0]), float(time_s[-1])
    window_start_s = settled_s if settled_s is not None else end_s - (end_s - start_s) / 4.0
    return _grid_time(window_start_s), _grid_time(end_s)


def _within(time_s: Vector, window_s: tuple[float, float] | None) -> Mask:
    if window_s is None:
        return np.zeros(time_s.shape, dtype=np.bool_)
    return np.asarray((time_s >= window_s[0] - TIME_GRAIN_S) & (time_s <= window_s[1] + TIME_GRAIN_S))


def _vehicle_results(
    record: FlightRecord,
    motion: RingMotion,
    ring: RingReference,
    formation: FormationReference,
    window: Mask,
) -> tuple[VehicleResult, ...]:
    engaged_s = engagement_times_s(record)
    speed_error_m_s, spacing_error_m = formation_errors(record, formation)
    known = measured(record)
    results = []
    for row, track in enumerate(record.vehicles):
        radius_error_m = motion.radius_m[row, window] - ring.radius_m
        rate_rad_s, bearing_rad = motion.rate_rad_s[row, window], motion.bearing_rad[row, window]
        last_tactic = track.tactic[known[row]][-1:]
        result = VehicleResult(
            id=track.vehicle_id,
            engaged_at_s=engaged_s[row],
            tactic=str(last_tactic[0]) if last_tactic.size else "unknown",
            radius_error_rms_m=_rms(radius_error_m),
            radius_error_max_m=_largest(radius_error_m),
            angular_rate_mean_rad_s=_mean_rate_rad_s(record.time_s[window], bearing_rad, rate_rad_s),
            angular_rate_error_rms_rad_s=_rms(rate_rad_s - ring.angular_rate_rad_s),
            formation_speed_error_rms_m_s=_rms(speed_error_m_s[row]),
            formation_spacing_error_rms_m=_rms(spacing_error_m[row]),
        )
        results.append(result)
    return tuple(results)


def _estimate_result(record: FlightRecord, ring: RingReference, window: Mask) -> EstimateResult | None:
    """Return the ring's figures by estimate in the same window, None where the record has no estimates beside it."""
    if not record.estimates:
        return None
    estimated = replace(record, vehicles=record.estimates)
    motion = ring_motion(estimated)
    engaged_s = [time_s for time_s in engagement_times_s(estimated) if time_s is not None]
    settled_s = _settled_at_s(record.time_s, motion, ring, max(engaged_s)) if engaged_s else None
    settling_time_s = None if settled_s is None else _grid_time(settled_s - max(engaged_s))
    vehicles = []
    for row, (estimate, true) in enumerate(zip(record.estimates, record.vehicles, strict=True)):
        radius_error_m = motion.radius_m[row, window] - ring.radius_m
        off_m = np.hypot(*(estimate.position_m - true.position_m).T)[window]
        bearing_rad, rate_rad_s = motion.bearing_rad[row, window], motion.rate_rad_s[row, window]
        result = EstimatedVehicleResult(
            id=estimate.vehicle_id,
            radius_error_rms_m=_rms(radius_error_m),
            radius_error_max_m=_largest(radius_error_m),
            angular_rate_mean_rad_s=_mean_rate_rad_s(record.time_s[window], bearing_rad, rate_rad_s),
            estimate_error_rms_m=_rms(off_m),
            estimate_error_max_m=_largest(off_m),
        )
        vehicles.append(result)
    spacing = RingResult(settling_time_s, *_spacing_errors_deg(motion, window))
    return EstimateResult(tuple(vehicles), spacing, _closest_approach_m(estimated))


def _reynolds(record: FlightRecord, window: Mask) -> ReynoldsResult:
    figures = flocking(record)
    spans = (
        _formation_span(record.time_s, engagement_times_s(record)),
        window,
        np.ones(record.time_s.shape, dtype=np.bool_),
    )
    return ReynoldsResult(*(condensed(figures, span) for span in spans))


def _formation_span(time_s: Vector, engaged_s: tuple[float | None, ...]) -> Mask:
    """Return the samples (T,) between 30 s and the first engagement."""
    first_s = min((engaged for engaged in engaged_s if engaged is not None), default=np.inf)
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


def _spacing_errors_deg(motion: RingMotion, window: Mask) -> tuple[float | None, float | None]:
    error_deg = np.degrees(motion.lead_rad - motion.desired_spacing_rad)[:, window]
    return _rms(error_deg), _largest(error_deg)


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


def _closest_approach_m(record: FlightRecord) -> float | None:
    """Return the smallest horizontal distance of two vehicles, None if no two were measured at one time."""
    x, y = (np.array([track.position_m[:, axis] for track in record.vehicles]) for axis in (0, 1))
    closest_m = np.inf
    for row in range(len(x) - 1):
        apart_m = np.hypot(x[row + 1 :] - x[row], y[row + 1 :] - y[row])
        closest_m = min(closest_m, float(np.fmin.reduce(apart_m, axis=None, initial=np.inf)))
    return closest_m if closest_m < np.inf else None


def _rms(errors: Vector) -> float | None:
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _largest(errors: Vector) -> float | None:
    known = errors[np.isfinite(errors)]
    return float(np.abs(known).max()) if known.size else None


def _grid_time(time_s: float) -> float:
    """Round away the accumulated error of time steps."""
    return round(time_s, 6)
