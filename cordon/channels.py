"""The channels of one vehicle's flight: arrays over one time grid, from a simulation or a log."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from cordon.decisions import Decisions
from estimation.state import Vector
from gcs.metrics.record import FlightRecord
from gcs.metrics.ring import ring_motion

_UNIT = re.compile(r"_(m_s|m)$")


@dataclass(frozen=True, slots=True, eq=False)
class VehicleChannels:
    """One vehicle's channels: T samples at `time_s`, seconds since the mission's start, one in each period of the loop.

    Positions and velocities are in the mission frame: x in the formation's direction, y to its left, z up. Unknown
    values are NaN, and so are the four channels about the ring while the vehicle does not encircle.

    - `tactic` (T,): `formation`, `encircle`, `hold` and others; `unknown` without data.
    - `position_m`, `velocity_m_s` (T, 2): the motion; the true one if `Flight.record.reference` is "truth", otherwise
      the vehicle's estimate.
    - `radius_m`, `bearing_rad`, `angular_rate_rad_s` (T,): the motion about the target, counter-clockwise.
    - `lead_rad` (T,): the angle to the next vehicle on the ring, counter-clockwise.
    - `position_estimate_m`, `velocity_estimate_m_s` (T, 2): the vehicle's estimate of its own motion.
    - `target_position_estimate_m`, `target_velocity_estimate_m_s` (T, 2): its estimate of the target.
    - `setpoint_m`, `setpoint_velocity_m_s` (T, 3): the setpoint sent; the velocity is 0 if only a position was sent.
    - `tick_us` (T,): the computing time of the tick.
    - `values`: those of a user's planner (`cordon.Plan.values`) by name, each (T,).
    """

    vehicle_id: int
    time_s: Vector
    tactic: "np.ndarray[tuple[int], np.dtype[np.str_]]"
    position_m: Vector
    velocity_m_s: Vector
    radius_m: Vector
    bearing_rad: Vector
    angular_rate_rad_s: Vector
    lead_rad: Vector
    position_estimate_m: Vector
    velocity_estimate_m_s: Vector
    target_position_estimate_m: Vector
    target_velocity_estimate_m_s: Vector
    setpoint_m: Vector
    setpoint_velocity_m_s: Vector
    tick_us: Vector
    values: Mapping[str, Vector]

    def columns(self) -> dict[str, Vector]:
        """Return every channel as columns (T,): `position_m` is `position_x_m` and `position_y_m`."""
        found: dict[str, Vector] = {}
        for name in (each.name for each in fields(self)[1:]):
            values = getattr(self, name)
            if name == "values":
                found |= {f"values.{each}": column for each, column in values.items()}
            elif values.ndim == 1:
                found[name] = values
            else:
                found |= {
                    _UNIT.sub(rf"_{axis}_\1", name): column for axis, column in zip("xyz", values.T, strict=False)
                }
        return found


def channels_of(record: FlightRecord, decisions: Mapping[int, Decisions]) -> dict[int, VehicleChannels]:
    """Return the channels of a record's vehicles by their ids."""
    ring = ring_motion(record)
    return {
        track.vehicle_id: VehicleChannels(
            vehicle_id=track.vehicle_id,
            time_s=record.time_s,
            tactic=track.tactic,
            position_m=track.position_m,
            velocity_m_s=track.velocity_m_s,
            radius_m=ring.radius_m[row],
            bearing_rad=ring.bearing_rad[row],
            angular_rate_rad_s=ring.rate_rad_s[row],
            lead_rad=ring.lead_rad[row],
            **decisions[track.vehicle_id].arrays(),
        )
        for row, track in enumerate(record.vehicles)
    }
