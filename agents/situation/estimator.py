"""The estimate stage: from telemetry, sightings and the aims that were sent to the situation of a tick."""

from collections.abc import Sequence

from agents.settings.config import AgentConfig
from agents.situation.ring_frequency import RingFrequency
from agents.situation.situation import Situation, moved
from agents.situation.target_blend import TargetBlend
from agents.situation.team_frame import TeamFrame
from estimation.filters.own import OwnFilter
from estimation.filters.target import TargetFilter
from estimation.polar import Polar, polar_from_motion
from estimation.state import DISTURBANCE, MOTION, Sighting, TargetEstimate, Telemetry, Vector
from estimation.vectors import Pair

LINK_DELAY_MAX_S = 0.5
"""Delays beyond this are not predicted: the history of setpoints is short, and such a link is about to fail."""


class Estimator:
    """Estimates one vehicle's motion, the target's, and the centre of the ring.

    `own` and `target` are its filters, which fault detection monitors.
    """

    def __init__(self, config: AgentConfig) -> None:
        self.own = OwnFilter(config.plant, config.own_filter)
        self.target = TargetFilter(config.target_filter)
        self._frame = TeamFrame(config)
        self._target_blend = TargetBlend(config)
        self._seen: TargetEstimate | None = None
        self._ring_frequency = RingFrequency(config.rate_hz)
        self._swings = config.own_filter.disturbance_turns
        self._height_m = config.take_off_altitude_m
        # A setpoint is held for one period: on average it acts half a period late, in addition to the plant's delay.
        self._held_s = 0.5 / config.rate_hz
        self._plant_delay_s = config.plant.delay_s
        self._link_delay_s = 0.0

    @property
    def ring_frequency_rad_s(self) -> float:
        """The assumed frequency of the ring-frequency disturbance, 0 off the ring."""
        return self._ring_frequency.rate_rad_s

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
        if delay_s != self._link_delay_s:
            self._link_delay_s = delay_s
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
        target = self._seen = self.target.estimate(now_s)
        acting_s = now_s + self._plant_delay_s + self._link_delay_s + self._held_s
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
        )

    def _take(self, now_s: float, sightings: Sequence[Sighting]) -> None:
        """Take sightings; if they show an offset of the own frame, shift the own estimate by it."""
        sightings = self._frame.sightings(now_s, sightings, self._seen)
        if sightings:
            self.target.sight(*sightings)
        off_x, off_y = self._frame.follow()
        if off_x or off_y:
            self.own.shift(-off_x, -off_y)
