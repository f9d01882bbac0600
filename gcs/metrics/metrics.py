"""The metrics of a flight, computed from its record: the definitions behind `--json` and the verdicts.

Arrays over the whole team have shape (V, T): vehicles in the record's order, samples in time. NaN marks samples
without a measurement, and averages ignore it.
"""

from dataclasses import replace

import numpy as np

from estimation.state import Vector
from gcs.metrics.catalogue import Verdicts, judge
from gcs.metrics.ending import FlightEnding
from gcs.metrics.engagement import EngagementReference, engagement
from gcs.metrics.record import FlightRecord, Mask
from gcs.metrics.references import (
    FormationReference,
    RingReference,
    VerdictTolerances,
    engagement_reference,
    formation_reference,
    ring_reference,
    verdict_tolerances,
)
from gcs.metrics.result import EstimateResult, FlightResult, LoopResult, ReynoldsResult, RingResult
from gcs.metrics.reynolds import condensed, flocking
from gcs.metrics.ring_motion import RingMotion, off_ring, ring_motion
from gcs.metrics.transitions import transitions
from gcs.metrics.vehicles import (
    TIME_GRAIN_S,
    engagement_times_s,
    estimated_vehicles,
    formation_span,
    grid_time,
    largest,
    rms,
    vehicle_results,
)
from gcs.mission.mission import Mission

NONE_ENGAGES = EngagementReference()
SETTLED_FOR_S = 10.0
"""A ring that stays within its limits for this time has settled, even if it leaves them later."""


def evaluated(mission: Mission, record: FlightRecord) -> FlightResult:
    """Return the metrics and verdicts of a flight of the mission."""
    references = ring_reference(mission), formation_reference(mission), verdict_tolerances(mission)
    return evaluate(record, *references, engagement_reference(mission))


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
    window = _within(record.time_s, window_s)
    result = FlightResult(
        mission=record.mission,
        seed=record.seed,
        source=record.source,
        reference=record.reference,
        duration_s=grid_time(end_s),
        window_s=window_s,
        vehicles=vehicle_results(record, motion, ring, formation, window),
        ring=ring_result,
        transitions=transitions(record, motion, ring, engaged_s),
        reynolds=_reynolds(record, window),
        closest_approach_m=_closest_approach_m(record),
        guard_interventions=None if record.guard is None else record.guard.interventions,
        guard_causes={} if record.guard is None else dict(record.guard.causes),
        loop=LoopResult.of(record.loop),
        verdicts=Verdicts(),
        wall_time_s=record.wall_time_s,
        realtime_factor=end_s / record.wall_time_s if record.wall_time_s > 0.0 else None,
        events=record.events,
        estimate=_estimate_result(record, ring, window),
        truth_missing=record.truth_missing or None,
        ended=FlightEnding.of(record.endings),
        engagement=engagement(record, engages, each_engaged_s),
        faults=record.faults,
        kinds=record.kinds,
    )
    return replace(result, verdicts=judge(result, ring, tolerances))


def _judged_ring(
    time_s: Vector, motion: RingMotion, ring: RingReference, engaged_s: list[float]
) -> tuple[tuple[float, float] | None, RingResult]:
    """Return the window of the ring metrics, None where none engaged, and the ring as a whole."""
    if not engaged_s:
        return None, RingResult()
    settled_s = _settled_at_s(time_s, motion, ring, max(engaged_s))
    window_s = _window_s(time_s, settled_s)
    settling_time_s = None if settled_s is None else grid_time(settled_s - max(engaged_s))
    errors_deg = _spacing_errors_deg(motion, _within(time_s, window_s))
    return window_s, RingResult(settling_time_s, *errors_deg, *_unsettled(time_s, motion, ring, max(engaged_s)))


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
    return grid_time(float(settled_s)), grid_time(float(stays[-1][1]))


def _window_s(time_s: Vector, settled_s: float | None) -> tuple[float, float]:
    start_s, end_s = float(time_s[0]), float(time_s[-1])
    window_start_s = settled_s if settled_s is not None else end_s - (end_s - start_s) / 4.0
    return grid_time(window_start_s), grid_time(end_s)


def _within(time_s: Vector, window_s: tuple[float, float] | None) -> Mask:
    if window_s is None:
        return np.zeros(time_s.shape, dtype=np.bool_)
    return np.asarray((time_s >= window_s[0] - TIME_GRAIN_S) & (time_s <= window_s[1] + TIME_GRAIN_S))


def _estimate_result(record: FlightRecord, ring: RingReference, window: Mask) -> EstimateResult | None:
    """Return the ring's figures by estimate in the same window, None where the record has no estimates beside it."""
    if not record.estimates:
        return None
    estimated = replace(record, vehicles=record.estimates)
    motion = ring_motion(estimated)
    engaged_s = [time_s for time_s in engagement_times_s(estimated) if time_s is not None]
    settled_s = _settled_at_s(record.time_s, motion, ring, max(engaged_s)) if engaged_s else None
    settling_time_s = None if settled_s is None else grid_time(settled_s - max(engaged_s))
    spacing = RingResult(settling_time_s, *_spacing_errors_deg(motion, window))
    return EstimateResult(estimated_vehicles(record, motion, ring, window), spacing, _closest_approach_m(estimated))


def _reynolds(record: FlightRecord, window: Mask) -> ReynoldsResult:
    figures = flocking(record)
    spans = (
        formation_span(record.time_s, engagement_times_s(record)),
        window,
        np.ones(record.time_s.shape, dtype=np.bool_),
    )
    return ReynoldsResult(*(condensed(figures, span) for span in spans))


def _spacing_errors_deg(motion: RingMotion, window: Mask) -> tuple[float | None, float | None]:
    error_deg = np.degrees(motion.lead_rad - motion.desired_spacing_rad)[:, window]
    return rms(error_deg), largest(error_deg)


def _closest_approach_m(record: FlightRecord) -> float | None:
    """Return the smallest horizontal distance of two vehicles, None if no two were measured at one time."""
    x, y = (np.array([track.position_m[:, axis] for track in record.vehicles]) for axis in (0, 1))
    closest_m = np.inf
    for row in range(len(x) - 1):
        apart_m = np.hypot(x[row + 1 :] - x[row], y[row + 1 :] - y[row])
        closest_m = min(closest_m, float(np.fmin.reduce(apart_m, axis=None, initial=np.inf)))
    return closest_m if closest_m < np.inf else None
