"""One vehicle's estimates and setpoints in each tick, on the time grid of a flight's record."""

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from agents.outputs import TickOutput
from estimation.state import POSITION, VELOCITY, Vector
from gcs.report.evidence.flight import VehicleEvidence


@dataclass(frozen=True, slots=True, eq=False)
class Decisions:
    """Arrays of `VehicleChannels` (T, n), NaN for unknown values."""

    position_estimate_m: Vector
    velocity_estimate_m_s: Vector
    target_position_estimate_m: Vector
    target_velocity_estimate_m_s: Vector
    setpoint_m: Vector
    setpoint_velocity_m_s: Vector
    tick_us: Vector
    values: dict[str, Vector] = field(default_factory=dict)

    @classmethod
    def unknown(cls, samples: int) -> "Decisions":
        """Return decisions with unknown values."""
        own_m, own_m_s, target_m, target_m_s = (np.full((samples, 2), np.nan) for _ in range(4))
        setpoint_m, beside_m_s = (np.full((samples, 3), np.nan) for _ in range(2))
        return cls(own_m, own_m_s, target_m, target_m_s, setpoint_m, beside_m_s, np.full(samples, np.nan))

    def note(self, tick: int, output: TickOutput) -> None:
        """Store a tick of a simulation."""
        motion, target, setpoint = output.status.motion, output.status.target, output.setpoint
        if motion is not None:
            self.position_estimate_m[tick], self.velocity_estimate_m_s[tick] = motion[POSITION], motion[VELOCITY]
        if target is not None:
            self.target_position_estimate_m[tick] = target[POSITION]
            self.target_velocity_estimate_m_s[tick] = target[VELOCITY]
        if setpoint is not None:
            self.setpoint_m[tick] = setpoint.position_m
            self.setpoint_velocity_m_s[tick] = setpoint.velocity_m_s or 0.0
        if output.status.plan is not None:
            for name, value in output.status.plan.values.items():
                self.values.setdefault(name, np.full(self.tick_us.size, np.nan))[tick] = value

    def arrays(self) -> dict[str, Any]:
        """Return the arrays by their names."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


def logged_decisions(evidence: VehicleEvidence, grid_s: Vector) -> Decisions:
    """Return the decisions in a vehicle's log: those of the nearest tick for each time of the grid."""
    decisions, loop = Decisions.unknown(grid_s.size), evidence.loop
    decisions.position_estimate_m[:] = _nearest(evidence.own.time_s, evidence.own.motion[:, POSITION], grid_s)
    decisions.velocity_estimate_m_s[:] = _nearest(evidence.own.time_s, evidence.own.motion[:, VELOCITY], grid_s)
    seen = evidence.target
    decisions.target_position_estimate_m[:] = _nearest(seen.time_s, seen.motion[:, POSITION], grid_s)
    decisions.target_velocity_estimate_m_s[:] = _nearest(seen.time_s, seen.motion[:, VELOCITY], grid_s)
    decisions.setpoint_m[:] = sent_m = _nearest(loop.time_s, loop.setpoint_m, grid_s)
    beside_m_s = _nearest(loop.time_s, loop.velocity_m_s, grid_s)
    decisions.setpoint_velocity_m_s[:] = np.where(np.isnan(sent_m), np.nan, beside_m_s)
    decisions.tick_us[:] = _nearest(loop.time_s, loop.tick_us[:, None], grid_s)[:, 0]
    for name, values in loop.values.items():
        decisions.values[name] = _nearest(loop.time_s, values[:, None], grid_s)[:, 0]
    return decisions


def _nearest(time_s: Vector, rows: Vector, grid_s: Vector) -> Vector:
    """Return the rows (n, k) nearest to the times of the grid, NaN if none is within half a period."""
    if time_s.size == 0:
        return np.full((grid_s.size, rows.shape[1]), np.nan)
    after = np.clip(np.searchsorted(time_s, grid_s), 1, max(time_s.size - 1, 1))
    before = after - 1
    after = np.minimum(after, time_s.size - 1)
    index = np.where(grid_s - time_s[before] <= time_s[after] - grid_s, before, after)
    half_s = 0.5 * float(grid_s[1] - grid_s[0]) if grid_s.size > 1 else np.inf
    near = np.abs(time_s[index] - grid_s) <= half_s
    return np.where(near[:, None], rows[index], np.nan)
