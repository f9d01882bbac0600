"""The metrics of a flight, computed from its record: the definitions behind `--json` and the verdicts."""

from dataclasses import replace

import numpy as np

from agents.tactics import Tactic
from gcs.metrics.apart import closest_approach_m
from gcs.metrics.catalogue import Verdicts, judge, not_judged
from gcs.metrics.departures import departures
from gcs.metrics.ending import TeamEnding
from gcs.metrics.record import FlightRecord, Mask, grid_time
from gcs.metrics.references import (
    DesiredRing,
    EngagementReference,
    FormationReference,
    VerdictTolerances,
    engagement,
    engagement_reference,
    formation_reference,
    ring_reference,
    verdict_tolerances,
)
from gcs.metrics.result import EstimateResult, FlightResult, LoopResult, NamedRing
from gcs.metrics.reynolds import ReynoldsResult, condensed, flocking
from gcs.metrics.ring import JudgedPart, estimated_ring, is_brief, judged_part, judged_ring, ring_motion, within
from gcs.metrics.rings import combined, rings_engagement
from gcs.metrics.transitions import predicted, transitions
from gcs.metrics.vehicles import (
    engagement_times_s,
    estimated_vehicles,
    flown_again_s,
    formation_span,
    left_formation_s,
    moved_s,
    vehicle_results,
)
from gcs.mission.mission import Mission

_ON_WAYS = (Tactic.STANDBY.value, Tactic.RETURN_AND_LAND.value, Tactic.LAND.value)
"""Vehicles take off, return and land in layers, while others fly the mission."""

NONE_ENGAGES = EngagementReference()


def evaluated(mission: Mission, record: FlightRecord) -> FlightResult:
    """Return the metrics and verdicts of a flight of the mission, those of each ring if it has several."""
    if len(mission.rings) < 2:
        return _evaluated(mission, record, engagement_reference(mission))
    references = ring_reference(mission), formation_reference(mission), verdict_tolerances(mission)
    team = evaluate(record, *references)
    named = tuple(_named_ring(mission, record, number) for number in range(len(mission.rings)))
    engaged = rings_engagement(mission, record)
    result = combined(replace(team, engagement=engaged), record, named)
    return replace(result, reynolds=_reynolds(record, within(record.time_s, result.window_s)))


def _named_ring(mission: Mission, record: FlightRecord, number: int) -> NamedRing:
    """Return the result of one of several rings, with the vehicles that were on it."""
    ring, alone = mission.rings[number], mission.of_ring(number)
    on_it = [track.vehicle_id for track in record.vehicles if track.encircles(number).any()]
    return NamedRing(ring.name, alone.target.name, _evaluated(alone, record.of_ring(number).of_vehicles(on_it)))


def _evaluated(mission: Mission, record: FlightRecord, engages: EngagementReference = NONE_ENGAGES) -> FlightResult:
    """Return the metrics and verdicts of a flight of a mission of one ring."""
    references = ring_reference(mission, record.events), formation_reference(mission), verdict_tolerances(mission)
    result = evaluate(record, *references, engages)
    config = mission.agent_config(mission.vehicles[0])
    return replace(result, transitions=predicted(result.transitions, record, config, references[0]))


def evaluate(
    record: FlightRecord,
    ring: DesiredRing,
    formation: FormationReference,
    tolerances: VerdictTolerances,
    engages: EngagementReference = NONE_ENGAGES,
) -> FlightResult:
    """Compute the metrics and verdicts of a flight; without a reference no vehicle was to engage."""
    end_s = float(record.time_s[-1]) if record.time_s.size else 0.0
    each_engaged_s, motion = engagement_times_s(record), ring_motion(record, ring.gaps, ring.bend)
    changes_s = *each_engaged_s, *moved_s(record), *flown_again_s(record)
    part = judged_part(record.time_s, motion, ring, changes_s)
    window_s, ring_result = judged_ring(record.time_s, motion, part)
    window = within(record.time_s, window_s)
    result = FlightResult(
        mission=record.mission,
        seed=record.seed,
        source=record.source,
        reference=record.reference,
        duration_s=grid_time(end_s),
        window_s=window_s,
        vehicles=vehicle_results(record, motion, part.ring, formation, window),
        ring=ring_result,
        transitions=transitions(record, motion, ring, ring.began_s(changes_s)),
        reynolds=_reynolds(record, window),
        closest_approach_m=_closest_approach_m(record, ring),
        ways_closest_m=record.ways_closest_m,
        guard_interventions=None if record.guard is None else record.guard.interventions,
        guard_causes={} if record.guard is None else dict(record.guard.causes),
        loop=LoopResult.of(record.loop),
        verdicts=Verdicts(),
        wall_time_s=record.wall_time_s,
        realtime_factor=end_s / record.wall_time_s if record.wall_time_s > 0.0 else None,
        events=record.events,
        estimate=_estimate_result(record, part, window, ring),
        truth_missing=record.truth_missing or None,
        ended=TeamEnding.of(record.endings),
        engagement=engagement(record, engages, each_engaged_s),
        faults=tuple(fault.given for fault in record.faults),
        kinds=record.kinds,
        departures=departures(record),
    )
    verdicts = judge(result, part.ring, tolerances)
    if is_brief(record.time_s, motion, part, window, ring_result):
        verdicts = replace(verdicts, c1=None, c2=None, c3=None)
    result = replace(result, verdicts=verdicts)
    return replace(result, not_judged=not_judged(result))


def _estimate_result(record: FlightRecord, part: JudgedPart, window: Mask, ring: DesiredRing) -> EstimateResult | None:
    """Return the ring's figures by estimate in the same window, None where the record has no estimates beside it."""
    if not record.estimates:
        return None
    estimated = replace(record, vehicles=record.estimates)
    motion = ring_motion(estimated, part.ring.gaps, part.ring.bend)
    began_s = part.ring.began_s((*engagement_times_s(estimated), *moved_s(estimated), *flown_again_s(estimated)))
    seen = replace(part, began_s=tuple(each for each in began_s if each <= record.time_s[part.samples - 1]))
    vehicles = estimated_vehicles(record, motion, part.ring, window)
    whole = estimated_ring(record.time_s, motion, seen, window)
    return EstimateResult(vehicles, whole, _closest_approach_m(estimated, ring))


def _reynolds(record: FlightRecord, window: Mask) -> ReynoldsResult:
    figures = flocking(record)
    spans = (
        formation_span(record.time_s, left_formation_s(record)),
        window,
        np.ones(record.time_s.shape, dtype=np.bool_),
    )
    return ReynoldsResult(*(condensed(figures, span) for span in spans))


def _closest_approach_m(record: FlightRecord, ring: DesiredRing) -> float | None:
    x_m, y_m = (np.array([track.position_m[:, axis] for track in record.vehicles]) for axis in (0, 1))
    unknown_m = np.full(record.time_s.shape, np.nan)
    height_m = np.array([unknown_m if each.altitude_m is None else each.altitude_m for each in record.vehicles])
    on_ways = np.array([np.isin(track.tactic, _ON_WAYS) for track in record.vehicles], dtype=np.bool_)
    return closest_approach_m(x_m, y_m, height_m, np.where(ring.are_stacked | on_ways, ring.above_m, np.inf))
