"""The estimate stage: from telemetry, sightings and the aims that were sent to the situation of a tick."""

from collections.abc import Sequence
from math import hypot
from typing import Final

import numpy as np

from agents.settings.config import AgentConfig
from agents.situation.situation import Situation, moved
from agents.situation.targets import TargetEstimates
from agents.situation.team_frame import TeamFrame
from agents.tactics import mixing_share
from estimation.filters.own import OwnFilter
from estimation.filters.target import OUT_OF_SIGHT_S
from estimation.polar import Polar, polar_from_motion
from estimation.state import DISTURBANCE, MOTION, POSITION, VELOCITY, Sighting, TargetEstimate, Telemetry, Vector
from estimation.vectors import Pair, clipped

_ACCELERATION_M_S2: Final = 0.8
_RATE_PER_S: Final = 0.8
_SPEED_SHARE: Final = 0.8
_CAUGHT_M: Final = 0.5
_CAUGHT_M_S: Final = 0.5
_HAND_OVER_S: Final = 5.0


class TargetBlend:
    """Follows one vehicle's estimate of the target; its state is the centre while it differs from the estimate."""

    def __init__(self, config: AgentConfig) -> None:
        ring = config.encirclement
        # Meanwhile the ring's rate is lowered (agents/ring/feasibility.py), which leaves speed for catching up.
        self._speed_max_m_s = _SPEED_SHARE * min(ring.speed_max_m_s, config.safety.speed_max_m_s)
        self._before: TargetEstimate | None = None
        self._centre: Vector | None = None
        self._time_s = 0.0
        self._caught_s: float | None = None

    @property
    def catching_up(self) -> bool:
        """Whether the centre differs from the estimate of the target."""
        return self._centre is not None

    def centre(self, estimate: TargetEstimate | None, now_s: float) -> Vector | None:
        """Return the centre's motion (4,), None without an estimate."""
        before, self._before = self._before, estimate
        if estimate is None:
            self._centre = None
            return None
        if before is not None and estimate.sighted_s - before.sighted_s > OUT_OF_SIGHT_S:
            self._centre = moved(before.mean, 0.0) if self._centre is None else self._centre
            self._caught_s = None
        if self._centre is None:
            self._time_s = now_s
            return estimate.mean
        self._follow(self._centre, estimate.mean, now_s - self._time_s)
        self._time_s = now_s
        return self._mixed(self._centre, estimate.mean, now_s)

    def _follow(self, centre: Vector, goal: Vector, step_s: float) -> None:
        """Move the centre by a step towards a goal (4,), critically damped."""
        way = goal[POSITION] - centre[POSITION]
        wanted = clipped(goal[VELOCITY] + _RATE_PER_S / 2.0 * way, self._speed_max_m_s)
        change = clipped(2.0 * _RATE_PER_S * (wanted - centre[VELOCITY]), _ACCELERATION_M_S2)
        centre[POSITION] += centre[VELOCITY] * step_s + change * step_s**2 / 2.0
        centre[VELOCITY] += change * step_s

    def _mixed(self, centre: Vector, goal: Vector, now_s: float) -> Vector:
        away = goal - centre
        if self._caught_s is None:
            near = hypot(*away[POSITION].tolist()) < _CAUGHT_M and hypot(*away[VELOCITY].tolist()) < _CAUGHT_M_S
            self._caught_s = now_s if near else None
            return centre.copy()
        share = mixing_share(now_s - self._caught_s, _HAND_OVER_S)
        if share >= 1.0:
            self._centre = None
            return goal
        return np.asarray(centre + share * away, dtype=np.float64)


_FOLLOWS_S: Final = 20.0
"""Time constant: longer than the noise in rate estimates lasts, at most one turn of a ring, 30 s to 2 min."""
_OFF_MOST: Final = 0.2
"""The largest deviation, as a share of the ring's rate: a vehicle on its way to the ring does not circle yet."""


class RingFrequency:
    """Estimates one vehicle's angular rate as a share of the ring's."""

    def __init__(self, rate_hz: float) -> None:
        self._gain = 1.0 / (_FOLLOWS_S * rate_hz)
        self._share = 1.0
        self.rate_rad_s = 0.0

    def follow(self, ring_rad_s: float, flown_rad_s: float | None = None) -> None:
        """Take the ring's angular rate, 0 off the ring, and once a tick the flown one."""
        if not ring_rad_s:
            self._share = 1.0
        elif flown_rad_s is not None:
            share = self._share + self._gain * (flown_rad_s / ring_rad_s - self._share)
            self._share = min(max(share, 1.0 - _OFF_MOST), 1.0 + _OFF_MOST)
        self.rate_rad_s = self._share * ring_rad_s


LINK_DELAY_MAX_S: Final = 0.5
"""Delays beyond this are not predicted: the history of setpoints is short, and such a link is about to fail."""


class Estimator:
    """Estimates one vehicle's motion, the targets', and the centre of its ring.

    `own` is its filter and `targets` are those of the targets, which fault detection monitors, `link_delay_s` is the
    delay of the link.
    """

    def __init__(self, config: AgentConfig) -> None:
        self.own = OwnFilter(config.plant, config.own_filter)
        self.targets = TargetEstimates(config)
        self._config = config
        self._frame = TeamFrame(config)
        self._target_blend = TargetBlend(config)
        self._position_m: Pair | None = None
        self._ring_frequency = RingFrequency(config.rate_hz)
        self._swings = config.own_filter.disturbance_turns
        self._height_m = config.take_off_altitude_m
        # A setpoint is held for one period: on average it acts half a period late, in addition to the plant's delay.
        self._held_s = 0.5 / config.rate_hz
        self._plant_delay_s = config.plant.delay_s
        self.link_delay_s = 0.0

    @property
    def ring_frequency_rad_s(self) -> float:
        """The assumed frequency of the ring-frequency disturbance, 0 off the ring."""
        return self._ring_frequency.rate_rad_s

    @property
    def position_m(self) -> Pair | None:
        """The vehicle's own position at the last tick, None before any telemetry."""
        return self._position_m

    def follow_target(self, name: str | None) -> None:
        """Follow the target of another ring, whose centre is at its estimate at once."""
        if (name or "") != self.targets.followed:
            self.targets.follow(name)
            self._target_blend = TargetBlend(self._config)

    def measure(self, telemetry: Telemetry) -> None:
        """Take a sample of the vehicle's own motion."""
        self._height_m = telemetry.position_m[2]
        self.own.measure(self._frame.telemetry(telemetry))

    def shared(self, sighting: Sighting) -> Sighting:
        """Return a sighting of the own sensor in the form that the estimator uses and peers receive."""
        return self._frame.shared(sighting)

    @property
    def offset_m(self) -> Pair:
        """The offset of the autopilot's positions from those in a situation, which setpoints have to include."""
        return self._frame.offset_m

    def sent(self, now_s: float, aim_m: Vector) -> None:
        """Take the aim (2,) of the setpoint that is sent, the input of the own filter's process model."""
        self.own.command(now_s, aim_m)

    def follow_link(self, round_trip_s: float | None) -> None:
        """Add the link's round trip, up to `LINK_DELAY_MAX_S`, to the delay from setpoints to telemetry."""
        delay_s = min(round_trip_s or 0.0, LINK_DELAY_MAX_S)
        if delay_s != self.link_delay_s:
            self.link_delay_s = delay_s
            self.own.delay_by(delay_s)

    def follow_ring(self, ring_rad_s: float, polar: Polar | None = None) -> None:
        """Set the disturbance's frequency to the ring's angular rate (0: off the ring), corrected by the flown one."""
        self._ring_frequency.follow(ring_rad_s, None if polar is None else polar.angular_rate_rad_s)
        self.own.turn_disturbance(self._ring_frequency.rate_rad_s if self._swings else 0.0)

    def estimate(self, now_s: float, sightings: Sequence[Sighting]) -> Situation | None:
        """Return the situation at `now_s` with the sightings since the last tick; None before any telemetry."""
        self._take(now_s, sightings)
        own = self.own.estimate(now_s)
        if own is None:
            return None
        self._position_m = own.mean.item(0), own.mean.item(1)
        target = self.targets.estimate(now_s)
        acting_s = now_s + self._plant_delay_s + self.link_delay_s + self._held_s
        acting = self.own.predicted(acting_s, self._held_s)
        acting_target = None if target is None else moved(target.mean, acting_s - target.time_s)
        centre = self._target_blend.centre(target, now_s)
        blended = centre is not None and self._target_blend.catching_up
        return Situation(
            now_s=now_s,
            acting_s=acting_s,
            own=own,
            acting_motion=acting[MOTION],
            disturbance=acting[DISTURBANCE],
            target=target,
            polar=None if centre is None else polar_from_motion(own.mean[MOTION], centre),
            acting_target=acting_target,
            acting_centre=moved(centre, acting_s - now_s) if centre is not None and blended else acting_target,
            authority=self.own.authority,
            height_m=self._height_m,
            offset_variance_m2=self._frame.variance_m2,
            shift_variance_m2=self._frame.shift_variance_m2,
            acting_others={
                name: moved(each.mean, acting_s - each.time_s)
                for name, each in self.targets.estimates.items()
                if name != self.targets.followed
            },
        )

    def _take(self, now_s: float, sightings: Sequence[Sighting]) -> None:
        """Take sightings; if they show an offset of the own frame, shift the own estimate by it."""
        sightings = self._frame.sightings(now_s, sightings, self.targets.estimates)
        if sightings:
            self.targets.sight(sightings)
        off_x, off_y = self._frame.follow()
        if off_x or off_y:
            self.own.shift(-off_x, -off_y)
