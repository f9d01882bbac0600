"""Synthetic flights for tests of the report, with data of all kinds and a given length and density."""

from math import tau

import numpy as np

from estimation.state import Vector
from gcs.metrics.metrics import evaluate
from gcs.metrics.record import FlightEvent, FlightRecord, GuardTally, LoopStatistics, VehicleTrack, in_order
from gcs.metrics.references import DesiredRing, FormationReference, VerdictTolerances
from gcs.metrics.result import FlightResult
from gcs.report.evidence.criteria import Criteria
from gcs.report.evidence.flight import EstimateSeries, FlightEvidence, LoopTiming, Reception, VehicleEvidence

TOLERANCES = VerdictTolerances(
    radius_error_rms_m=0.2,
    angular_rate_error_rad_s=0.002,
    spacing_error_rms_deg=2.0,
    formation_speed_error_rms_m_s=0.05,
    formation_spacing_error_rms_m=0.25,
    separation_m=3.0,
)
SPACING_M, OWN_SIGMA_M, TARGET_SIGMA_M = 4.0, 0.04, 0.1


def flown(
    count: int, *, duration_s: float = 600.0, rate_hz: float = 20.0, mission: str = "case2", engaging: bool = True
) -> tuple[FlightEvidence, FlightResult, Criteria]:
    """`count` vehicles in line; from a third of the flight on, one after the other, onto a noisy ring."""
    random = np.random.default_rng(count)
    time_s = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    target_m = np.column_stack((35.0 + 0.1 * time_s, np.full(time_s.size, -5.0)))
    radius_m = max(10.0, 1.2 * count)
    slots = {index + 1: (0.0, SPACING_M * ((count - 1) / 2 - index)) for index in range(count)}
    tracks = tuple(
        _track(vehicle_id, slot, time_s, target_m, radius_m, count, engaging, random)
        for vehicle_id, slot in slots.items()
    )
    vehicles = tuple(_evidence(track, time_s, target_m, count, random) for track in tracks)
    tick_us = np.concatenate([each.loop.tick_us for each in vehicles])
    record = FlightRecord(
        mission,
        7,
        "sitl",
        "truth",
        time_s,
        target_m,
        np.tile([0.1, 0.0], (time_s.size, 1)),
        tracks,
        LoopStatistics(rate_hz, tick_us.size, 5, tick_us),
        duration_s / 10.0,
        GuardTally(12),
        in_order([FlightEvent(1.0, 1, "failsafe", "battery <b>low</b>"), FlightEvent(2.0, 1, "command", "hold")]),
    )
    formation = FormationReference(0.2, slots)
    criteria = Criteria(DesiredRing(radius_m, 0.05), formation, TOLERANCES, 0.3)
    evidence = FlightEvidence(record, vehicles, {"date": "2026-11-21", "log": "<b>/tmp/a&b.mcap</b>"})
    return evidence, evaluate(record, criteria.ring, formation, TOLERANCES), criteria


def _track(
    vehicle_id: int,
    slot_m: tuple[float, float],
    time_s: Vector,
    target_m: Vector,
    radius_m: float,
    count: int,
    engaging: bool,
    random: np.random.Generator,
) -> VehicleTrack:
    joins_s = time_s[-1] / 3.0 + 5.0 * vehicle_id if engaging else np.inf
    angle = vehicle_id * tau / count + 0.05 * time_s
    outward = np.column_stack((np.cos(angle), np.sin(angle)))
    forward = np.column_stack((-np.sin(angle), np.cos(angle)))
    around = (time_s >= joins_s)[:, None]
    line_m = np.column_stack((slot_m[0] + 0.2 * time_s, np.full(time_s.size, slot_m[1])))
    position_m = np.where(around, target_m + radius_m * outward, line_m) + random.normal(0.0, 0.02, line_m.shape)
    velocity_m_s = np.where(around, [0.1, 0.0] + 0.05 * radius_m * forward, [0.2, 0.0])
    return VehicleTrack(vehicle_id, position_m, velocity_m_s, np.where(around[:, 0], "encircle", "formation"))


def _evidence(
    track: VehicleTrack, time_s: Vector, target_m: Vector, count: int, random: np.random.Generator
) -> VehicleEvidence:
    def belief(position_m: Vector, sigma_m: float) -> EstimateSeries:
        motion = np.hstack((position_m + random.normal(0.0, sigma_m, position_m.shape), track.velocity_m_s))
        return EstimateSeries(time_s, motion, np.full((time_s.size, 4), sigma_m))

    ticks = time_s.size
    loop = LoopTiming(
        time_s,
        150.0 * np.exp(random.normal(0.0, 0.3, ticks)),
        (np.arange(ticks) == ticks // 2).astype(float),
        random.choice(["interior", "bounded", "fallback"], ticks),
        random.choice(["passed", "changed"], ticks, p=[0.99, 0.01]),
        np.zeros((ticks, 3)),
    )
    peers = {
        sender: Reception(time_s, random.uniform(0.02, 0.1, ticks))
        for sender in range(1, count + 1)
        if sender != track.vehicle_id
    }
    return VehicleEvidence(
        track.vehicle_id,
        belief(track.position_m, OWN_SIGMA_M),
        belief(target_m, TARGET_SIGMA_M),
        random.normal(8.0, 0.05, ticks),
        loop,
        Reception(time_s, random.uniform(0.0, 0.05, ticks)),
        peers,
        f"malformed {track.vehicle_id}",
        np.column_stack((time_s, np.linspace(0.9, 0.4, ticks))),
    )
