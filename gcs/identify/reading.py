"""From logs to what identification is made from: one vehicle's recordings."""

from collections.abc import Sequence

import numpy as np

from estimation.identification.excerpts import Recording, excerpts_of
from estimation.state import Vector
from gcs.errors import InputError
from gcs.vehicle_logs.vehicle_log import VehicleLog

SAMPLED_TOPICS = frozenset({"trajectory_setpoint", "POSITION_TARGET_LOCAL_NED"})
"""Topics that hold what setpoint was in force now and then; all others hold each setpoint when it was sent."""


def recording_of(log: VehicleLog) -> Recording:
    """Return a log as a recording; raises LogError where it lacks what is needed."""
    flown_s = [(mode.span.begin_s, mode.span.end_s) for mode in log.modes if mode.external]
    if not flown_s:
        nothing = np.empty((0, 2))
        return Recording(np.empty(0), nothing, np.empty(0), nothing, [])
    log.require("setpoint", "position")
    assert log.setpoint is not None
    assert log.position is not None
    setpoint_m = log.setpoint.values[:, :2]
    given = np.isfinite(setpoint_m).all(axis=1)
    return Recording(
        log.position.time_s,
        log.position.values[:, :2],
        log.setpoint.time_s[given],
        setpoint_m[given],
        flown_s,
        log.position_resets_s,
        sampled=log.setpoint.topic in SAMPLED_TOPICS,
        velocity_m_s=_velocity_m_s(log, log.setpoint.time_s[given]),
        reported_m_s=_reported_m_s(log, log.position.time_s),
    )


def _reported_m_s(log: VehicleLog, time_s: Vector) -> Vector | None:
    """Return the vehicle's velocities (T, 2) at these times; None where the log has none."""
    if log.velocity is None:
        return None
    return np.column_stack([np.interp(time_s, log.velocity.time_s, column) for column in log.velocity.values.T[:2]])


def _velocity_m_s(log: VehicleLog, time_s: Vector) -> Vector | None:
    """Return the velocities (n, 2) that went with the setpoints of these times, 0 where none did; None without any."""
    if log.setpoint_velocity is None:
        return None
    velocity_m_s = np.zeros((time_s.size, 2))
    _, here, there = np.intersect1d(time_s, log.setpoint_velocity.time_s, return_indices=True)
    velocity_m_s[here] = log.setpoint_velocity.values[there, :2]
    return velocity_m_s


def check_one_kind(logs: Sequence[VehicleLog], recordings: Sequence[Recording]) -> None:
    """Refuse logs some of which were flown with velocities beside the setpoints and some without: two plants."""
    told = []
    for log, recording in zip(logs, recordings, strict=True):
        if excerpts := excerpts_of(recording):
            told.append((log.path, any(excerpt.fed for excerpt in excerpts)))
    if len({fed for _, fed in told}) > 1:
        words = "; ".join(f"{path}: {'with' if fed else 'without'} velocities" for path, fed in told)
        raise InputError([f"setpoints with velocities beside them and without make two plants, one file each: {words}"])


def chosen(logs: Sequence[VehicleLog], vehicle: int | None) -> list[VehicleLog]:
    """Return the logs of the one vehicle asked for, or of the only one there is; raises InputError."""
    known = sorted({log.system_id for log in logs})
    told = ", ".join(map(str, known))
    if vehicle is None and len(known) > 1:
        raise InputError([f"--vehicle: the logs hold vehicles {told}: say which of them is to be identified"])
    if vehicle is not None and vehicle not in known:
        raise InputError([f"--vehicle: the logs have no vehicle {vehicle} (they have {told})"])
    return [log for log in logs if vehicle is None or log.system_id == vehicle]
