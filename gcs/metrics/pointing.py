"""How far cameras looked past the target, by what their gimbals reported."""

from math import inf

import numpy as np

from estimation.state import Vector
from gcs.metrics.record import FlightRecord, Mask, VehicleTrack, rms

_TURNS_S = 3.0
"""A camera is back at the target this long after it was told so."""


def pointing_error_rms_deg(record: FlightRecord, track: VehicleTrack, window: Mask) -> float | None:
    """Return the angle between the directions of the camera and of the target, rms over the views in a window (T,).

    Views while an operator has pointed the camera at a place, and soon after, are left out.

    The target is seen from the vehicle's track, which is the true one if the record's reference is the truth. None
    without views, or where the target is not known.
    """
    camera = record.cameras.get(track.vehicle_id)
    if camera is None or not window.any():
        return None
    grid_s = record.time_s
    nearest = np.clip(np.searchsorted(grid_s, camera.time_s), 0, grid_s.size - 1)
    judged = window[nearest] & (camera.time_s >= grid_s[0]) & (camera.time_s <= grid_s[-1])
    judged &= _at_target(record, track.vehicle_id, camera.time_s)
    if not judged.any():
        return None
    time_s = camera.time_s[judged]
    relative_m, _ = record.relative(track)
    x, y = (np.interp(time_s, grid_s, -relative_m[:, axis]) for axis in (0, 1))
    own_m = camera.altitude_m[judged]
    if track.altitude_m is not None:
        own_m = np.interp(time_s, grid_s, track.altitude_m)
    away = np.column_stack([x, y, camera.target_height_m - own_m])
    up, bearing = camera.elevation_rad[judged], camera.bearing_rad[judged]
    looks = np.column_stack([np.cos(up) * np.cos(bearing), np.cos(up) * np.sin(bearing), np.sin(up)])
    across = np.linalg.norm(np.cross(looks, away), axis=1)
    return rms(np.degrees(np.arctan2(across, (looks * away).sum(axis=1))))


def _at_target(record: FlightRecord, vehicle_id: int, time_s: Vector) -> Mask:
    """Return for times (K,) since the start whether the camera is to look at the target, not at an operator's place."""
    is_at_target = np.ones(time_s.shape, dtype=np.bool_)
    for each in record.events:
        command = each.command
        if each.vehicle == vehicle_id and command is not None and command.verb == "look" and not command.is_refused:
            after = time_s >= each.time_s
            back_s = inf if command.looks_at_m else each.time_s + _TURNS_S
            is_at_target[after] = time_s[after] >= back_s
    return is_at_target
