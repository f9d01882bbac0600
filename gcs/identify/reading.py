"""From logs to one vehicle's recordings, the input of the identification."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.identification.excerpts import MotionRecording, excerpts_of
from estimation.state import Vector
from gcs.errors import InputError
from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import VehicleLog, spans_of

SAMPLED_TOPICS = frozenset({"trajectory_setpoint", "POSITION_TARGET_LOCAL_NED"})
"""Topics that sample the current setpoint; all others hold each setpoint when it was sent."""


def recording_of(log: VehicleLog) -> MotionRecording:
    """Return a log as a recording; raises LogError if it lacks data."""
    if not any(mode.external for mode in log.modes):
        nothing = np.empty((0, 2))
        return MotionRecording(np.empty(0), nothing, np.empty(0), nothing, [])
    log.require("setpoint", "position")
    assert log.setpoint is not None
    assert log.position is not None
    setpoint_m = log.setpoint.values[:, :2]
    given = np.asarray(np.isfinite(setpoint_m).all(axis=1))
    return MotionRecording(
        log.position.time_s,
        log.position.values[:, :2],
        log.setpoint.time_s[given],
        setpoint_m[given],
        _flown_s(log, given),
        log.position_resets_s,
        sampled=log.setpoint.topic in SAMPLED_TOPICS,
        velocity_m_s=_velocity_m_s(log, log.setpoint.time_s[given]),
        reported_m_s=_reported_m_s(log, log.position.time_s),
    )


def _flown_s(log: VehicleLog, given: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the spans in which position setpoints flew the vehicle: of others it is not known where they led."""
    assert log.setpoint is not None
    known = [
        span for span, is_given in spans_of(log.setpoint.time_s.tolist(), given.tolist(), log.duration_s) if is_given
    ]
    flown = [mode.span for mode in log.modes if mode.external]
    both = [(max(one.begin_s, two.begin_s), min(one.end_s, two.end_s)) for one in flown for two in known]
    return [(begin_s, end_s) for begin_s, end_s in both if begin_s < end_s]


def _reported_m_s(log: VehicleLog, time_s: Vector) -> Vector | None:
    """Return the vehicle's velocities (T, 2) at these times; None if the log has none."""
    if log.velocity is None:
        return None
    return np.column_stack([np.interp(time_s, log.velocity.time_s, column) for column in log.velocity.values.T[:2]])


def _velocity_m_s(log: VehicleLog, time_s: Vector) -> Vector | None:
    """Return the velocities (n, 2) sent with the setpoints of these times, 0 without one; None if the log has none."""
    if log.setpoint_velocity is None:
        return None
    velocity_m_s = np.zeros((time_s.size, 2))
    _, here, there = np.intersect1d(time_s, log.setpoint_velocity.time_s, return_indices=True)
    velocity_m_s[here] = log.setpoint_velocity.values[there, :2]
    return velocity_m_s


def recordings_of(logs: Sequence[VehicleLog]) -> list[MotionRecording]:
    """Return one vehicle's logs as recordings; raises LogError, and InputError for logs of two kinds of plant."""
    recordings = [recording_of(log) for log in logs]
    _check_one_kind(logs, recordings)
    return recordings


def logs_of_one(paths: Sequence[Path], vehicle: int | None, option: str = "--vehicle") -> list[VehicleLog]:
    """Return the logs of the given vehicle, or of the only one.

    Raises InputError, with `option` if the vehicle has to be given, and LogError with file, topic and time.
    """
    if len(set(paths)) < len(paths):
        raise InputError([f"{path}: given more than once" for path in sorted(set(paths)) if paths.count(path) > 1])
    logs = _chosen([log for path in paths for log in read_vehicle_logs(path)], vehicle, option)
    _check_same(logs)
    return logs


def _check_one_kind(logs: Sequence[VehicleLog], recordings: Sequence[MotionRecording]) -> None:
    """Refuse a mix of logs with and without velocities beside the setpoints: they need different plants."""
    kinds = []
    for log, recording in zip(logs, recordings, strict=True):
        if excerpts := excerpts_of(recording):
            kinds.append((log.path, any(excerpt.fed for excerpt in excerpts)))
    if len({fed for _, fed in kinds}) > 1:
        words = "; ".join(f"{path}: {'with' if fed else 'without'} velocities" for path, fed in kinds)
        raise InputError([f"setpoints with and without velocities: identify them separately: {words}"])


def _check_same(logs: Sequence[VehicleLog]) -> None:
    """Refuse logs of different vehicles, as far as the logs identify them."""
    for what, values in (
        ("autopilots", {log.autopilot for log in logs}),
        ("firmwares", {log.firmware for log in logs if log.firmware}),
    ):
        if len(values) > 1:
            named = "; ".join(f"{log.path}: {log.autopilot} {log.firmware}".rstrip() for log in logs)
            raise InputError([f"the logs are of different {what}; identify them separately: {named}"])


def _chosen(logs: Sequence[VehicleLog], vehicle: int | None, option: str) -> list[VehicleLog]:
    known = sorted({log.system_id for log in logs})
    shown = ", ".join(map(str, known))
    if vehicle is None and len(known) > 1:
        raise InputError([f"{option}: the logs hold vehicles {shown}; choose one of them"])
    if vehicle is not None and vehicle not in known:
        raise InputError([f"{option}: the logs have no vehicle {vehicle} (they have {shown})"])
    return [log for log in logs if vehicle is None or log.system_id == vehicle]
