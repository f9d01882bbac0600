"""The team's frame: positions without each vehicle's slow position error, as estimated from telemetry and sightings.

The positions that autopilots report have slow, independent errors. Estimation, planning and guard use team positions:
team position = reported position - offset; setpoints are converted back. The offset has two parts: one estimated from
the vehicle's own telemetry (`PositionWander`), one from sightings of the common target (`FrameOffsets`). Sightings are
sent to peers without the second part, so that no information is counted twice.
"""

from collections.abc import Mapping, Sequence
from math import exp
from typing import Final

from msgspec.structs import replace

from agents.settings.config import AgentConfig
from estimation.filters.position_wander import FrameOffsets, PositionWander
from estimation.state import Sighting, TargetEstimate, Telemetry
from estimation.vectors import Pair

_PREDICTED_S: Final = 1.0
"""The prediction period of the offsets without sightings."""
_SMOOTHED_S: Final = 0.3
"""Time constant with which the applied offset follows its estimate, so that a noisy sighting moves setpoints slowly."""
_APART_M: Final = 0.2
"""The assumed offset between two vehicles' positions if their profiles state none: it adds to others' uncertainty."""
_REPEATED: Final = 2.5
"""The number of sightings of one sensor at 5 Hz within the window of the target filter's manoeuvre test."""


class TeamFrame:
    """Converts one vehicle's measurements and setpoints between its autopilot's frame and the team's."""

    def __init__(self, config: AgentConfig) -> None:
        self._vehicle_id = config.vehicle_id
        self._wander = PositionWander(config.own_filter) if config.own_filter.wander_m > 0.0 else None
        self._offsets = FrameOffsets()
        self._followed = 1.0 - exp(-1.0 / (config.rate_hz * _SMOOTHED_S))
        self._sighted_m: Pair = (0.0, 0.0)
        self._predicted_s = 0.0

    @property
    def offset_m(self) -> Pair:
        """The offset of the autopilot's positions from the team's frame."""
        if self._wander is None:
            return (0.0, 0.0)
        (x, y), (error_x, error_y) = self._sighted_m, self._wander.error_m
        return x + error_x, y + error_y

    @property
    def variance_m2(self) -> float:
        """The variance per axis of the offset, 0 if the profile states no slow position error."""
        if self._wander is None:
            return 0.0
        if self._vehicle_id in self._offsets:
            return self._offsets.variance_m2(self._vehicle_id)
        return self._wander.sigma_m**2

    @property
    def shift_variance_m2(self) -> float:
        """The variance per axis of the team's frame in the mission's, as far as `variance_m2` does not contain it."""
        return self._offsets.shift_variance_m2 if self._vehicle_id in self._offsets else 0.0

    def telemetry(self, reported: Telemetry) -> Telemetry:
        """Take telemetry in the autopilot's frame; return it in the team's."""
        if self._wander is None:
            return reported
        self._wander.measure(reported)
        (x, y, z), (off_x, off_y) = reported.position_m, self.offset_m
        return Telemetry(reported.time_s, (x - off_x, y - off_y, z), reported.velocity_m_s)

    def shared(self, sighting: Sighting) -> Sighting:
        """Return a sighting of the own sensor as peers receive it, corrected by the first part of the offset."""
        if self._wander is None:
            return sighting
        (x, y), (off_x, off_y) = sighting.position_m, self._wander.error_m
        return replace(
            sighting,
            position_m=(x - off_x, y - off_y),
            frame_sigma_m=self._wander.sigma_m,
            frame_correlation_s=self._wander.correlation_s,
        )

    def sightings(
        self, now_s: float, sightings: Sequence[Sighting], targets: Mapping[str, TargetEstimate]
    ) -> Sequence[Sighting]:
        """Take a tick's sightings and the prior estimates of the targets by their names, that of the only one by "";
        return the sightings in the team's frame.

        Those of several targets show the offset as those of one do: each is compared with the estimate of its own.
        """
        offsets = self._offsets
        for each in sightings:
            if each.frame_sigma_m > 0.0:
                offsets.set_error_model(each.sensor_id, each.frame_sigma_m, each.frame_correlation_s)
        if not offsets:
            return [self._in_team_frame(each) for each in sightings]
        if not sightings and now_s - self._predicted_s < _PREDICTED_S:
            return sightings
        self._predicted_s = now_s
        if not targets:
            offsets.predict(now_s, 0.0)
            return sightings
        offsets.predict(now_s, max(sum(each.position_variance_m2) / 2.0 for each in targets.values()))
        for each in sightings:
            if (target := targets.get(each.target or "")) is not None:
                x, y, x_rate, y_rate = target.mean.tolist()
                ahead_s = each.time_s - target.time_s
                offsets.see(each, (x + x_rate * ahead_s, y + y_rate * ahead_s))
        return [self._in_team_frame(each) for each in sightings]

    def follow(self) -> Pair:
        """Move the applied offset towards its estimate, once a tick; return the step."""
        if self._wander is None:
            return (0.0, 0.0)
        (x, y), (goal_x, goal_y) = self._sighted_m, self._offsets.offset_m(self._vehicle_id)
        step_x, step_y = self._followed * (goal_x - x), self._followed * (goal_y - y)
        self._sighted_m = x + step_x, y + step_y
        return step_x, step_y

    def _in_team_frame(self, sighting: Sighting) -> Sighting:
        if sighting.sensor_id not in self._offsets:
            return sighting if sighting.sensor_id == self._vehicle_id else _less_exact(sighting, _APART_M**2)
        (x, y), (off_x, off_y) = sighting.position_m, self._offsets.offset_m(sighting.sensor_id)
        # The remaining offset is the same in successive sightings, so its variance is added several times.
        less_exact = _less_exact(sighting, _REPEATED * self._offsets.variance_m2(sighting.sensor_id))
        return replace(less_exact, position_m=(x - off_x, y - off_y))


def _less_exact(sighting: Sighting, variance_m2: float) -> Sighting:
    xx, xy, yy = sighting.covariance_m2
    return Sighting(
        sighting.time_s,
        sighting.sensor_id,
        sighting.position_m,
        (xx + variance_m2, xy, yy + variance_m2),
        sighting.importance,
        sighting.threat,
        sighting.altitude_m,
        sighting.altitude_sigma_m,
        sighting.frame_sigma_m,
        sighting.frame_correlation_s,
        sighting.target,
    )
