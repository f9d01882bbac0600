"""From a plan to a setpoint: slew limit, velocity feed-forward, yaw and altitude.

The slew limit bounds how far an aim may move per tick after a jump of an estimate or a plan. The guard acts after it,
and may move the aim farther. The yaw, counter-clockwise from the mission's x axis, turns at a bounded rate in the
shorter direction; if no direction is wanted or known, it stays as it is.

Velocity feed-forward: the aim is split into a position setpoint and a velocity.
In the plant model all pairs with the same aim have the same effect, so the guard's result holds for any velocity. The
choice matters where the vehicle differs from its profile. The velocity sent is the one that the plant reaches under the
aim after half the time constant of its damping. At a steady speed the setpoint then needs no lead, and errors of a0 and
a1 have no effect; during acceleration they have half their effect. The velocity follows the guarded aim, so a braked
vehicle is sent less at once. A vehicle that stays is sent none, and comes to rest at the setpoint for any plant.

The altitude is the vehicle's layer, or on the ring that of the ring, or an offset above the target's altitude. All
vehicles are raised by the same amount, which keeps the differences of their `altitude_m`, also if the altitude limit of
one is reached. On an inclined ring it follows the bearing, and the climb rate is fed forward.
"""

from math import atan2, hypot, radians
from typing import TYPE_CHECKING, Final

from agents.control.aims import shifted, towards
from agents.control.encirclement import aim_for_acceleration
from agents.control.plan import Plan
from agents.ring.heights import inclined_m
from agents.safety.guard import Guarded, GuardStatus
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from estimation.plant.model import Plant
from estimation.polar import Polar
from estimation.settings import TargetFilterSettings
from estimation.state import POSITION, VELOCITY, Sighting, Vector
from estimation.vectors import Pair, clipped_pair, wrap_signed_rad

if TYPE_CHECKING:
    from estimation.filters.target_altitude import TargetAltitude


STAYS = (Tactic.HOLD, Tactic.ASIDE)
"""The tactics of a vehicle that keeps its place."""


_LAG_S: Final = 1.0
"""Autopilots follow a climb this much later if no rate is fed forward: 1 / MPC_Z_P, 1 / PSC_POSZ_P."""


class Altitude:
    """Computes one vehicle's altitude, with a bounded rate if the ring has heights of its own or follows the target."""

    def __init__(self, config: AgentConfig) -> None:
        ring = self._ring = config.encirclement
        self._flying_m = config.altitude_m
        self._target = _target_altitude(config.target_filter) if ring.altitude == "target" else None
        others_have = any(each.encirclement.has_heights for each in config.rings)
        self._has_heights = self._target is not None or ring.has_heights or others_have
        self._above_lowest_m = config.altitude_m - config.lowest_m
        self._offset_m = ring.altitude_offset_m or 0.0
        self._low_m, self._high_m = config.lowest_between_m
        self._step_m = ring.climb_max_m_s / config.rate_hz
        self._altitude_m = config.take_off_altitude_m
        self._lead_s = 0.0 if config.plant.feedforward > 0.0 else _LAG_S

    def change(self, config: AgentConfig) -> None:
        """Fly at the heights of another ring from now on."""
        self._ring = config.encirclement
        self._has_heights = self._has_heights or self._ring.has_heights

    def begin_at(self, altitude_m: float) -> None:
        """Begin at an altitude other than that of the take-off."""
        self._altitude_m = altitude_m

    @property
    def setpoint_m(self) -> float:
        """The altitude of the last setpoint, without a lead: that at which a vehicle holds."""
        return self._altitude_m

    @property
    def target_m(self) -> float | None:
        """The estimate of the target's altitude, None if it is unknown or not followed."""
        return None if self._target is None else self._target.mean_m

    def sight(self, *sightings: Sighting) -> None:
        """Take sightings from any sensors, in any order."""
        if self._target is not None:
            for sighting in sorted(sightings, key=lambda each: each.time_s):
                self._target.sight(sighting)

    def next(self, tactic: Tactic, layer_m: float, polar: Polar | None = None) -> Pair:
        """Return altitude [m] and climb rate [m/s] of the next setpoint, once for each.

        `layer_m` is the altitude of a level ring without a target, `polar` is where the vehicle is about the target.
        Where no climb rate is fed forward, the altitude leads.
        """
        if not self._has_heights:
            self._altitude_m = layer_m
            return layer_m, 0.0
        wanted_m, climb_m_s = self._wanted(tactic, layer_m, polar)
        left_m = wanted_m - self._altitude_m
        self._altitude_m += min(max(left_m, -self._step_m), self._step_m)
        climb_m_s = climb_m_s if abs(left_m) <= self._step_m else 0.0
        return self._altitude_m + self._lead_s * climb_m_s, climb_m_s

    def _wanted(self, tactic: Tactic, layer_m: float, polar: Polar | None) -> Pair:
        if tactic in STAYS:
            return self._altitude_m, 0.0
        # Every vehicle stays in its layer until all are in their places.
        if tactic not in (Tactic.ENCIRCLE, Tactic.TRANSIT) or layer_m != self._flying_m:
            return layer_m, 0.0
        above_m, climb_m_s = 0.0, 0.0
        if polar is not None and tactic is Tactic.ENCIRCLE:
            above_m, climb_m_s = inclined_m(self._ring, polar)
        lowest_m = self._lowest_m
        return (layer_m if lowest_m is None else lowest_m + self._above_lowest_m) + above_m, climb_m_s

    @property
    def _lowest_m(self) -> float | None:
        """The altitude of the ring's lowest vehicle if it were level, None for its flying height."""
        if self._target is None or self.target_m is None:
            return self._ring.altitude_m
        lowest_m, rise_m = self.target_m + self._offset_m, self._ring.rise_m
        lowest_m = lowest_m if self._high_m is None else min(lowest_m, self._high_m - rise_m)
        return lowest_m if self._low_m is None else max(lowest_m, self._low_m + rise_m)


def _target_altitude(settings: TargetFilterSettings) -> "TargetAltitude":
    # filterpy takes as long to import as the rest of an agent, and few missions follow an altitude.
    from estimation.filters.target_altitude import TargetAltitude  # noqa: PLC0415

    return TargetAltitude(settings)


_REACHED: Final = 0.5
"""The prediction time of the velocity, in time constants 1 / a1."""
_STILL = (0.0, 0.0)


class FeedForward:
    """Splits the aims of one vehicle; it has no state."""

    def __init__(self, plant: Plant, speed_max_m_s: float) -> None:
        self._plant = plant
        self._lead_s = plant.lead_s
        self._feeds = plant.feedforward > 0.0
        self._speed_max_m_s = speed_max_m_s

    def split(
        self, situation: Situation, plan: Plan, guarded: Guarded, climb_m_s: float = 0.0
    ) -> tuple[Pair, tuple[float, ...]]:
        """Return the setpoint, and the velocity (x, y, z) to send with it, empty if the plant has no feed-forward."""
        x, y = guarded.aim_m.tolist()
        if not self._feeds:
            return (x, y), ()
        velocity = plan.velocity_m_s
        if guarded.status is GuardStatus.BRAKED:
            velocity = _STILL
        elif velocity is None:
            velocity = self._reached(situation, (x, y))
        x_rate, y_rate = clipped_pair(velocity, self._speed_max_m_s)
        lead_x, lead_y = self._lead_s
        return (x - lead_x * x_rate, y - lead_y * y_rate), (x_rate, y_rate, climb_m_s)

    def _reached(self, situation: Situation, aim_m: Pair) -> Pair:
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        w_x, w_y = situation.disturbance.tolist()
        along_x, along_y = self._plant.x, self._plant.y
        push_x = along_x.a0_per_s2 * (aim_m[0] - x) + w_x - along_x.a1_per_s * x_rate
        push_y = along_y.a0_per_s2 * (aim_m[1] - y) + w_y - along_y.a1_per_s * y_rate
        return x_rate + _REACHED * push_x / along_x.a1_per_s, y_rate + _REACHED * push_y / along_y.a1_per_s


_FREE = (Tactic.EXCITE, Tactic.LAND, Tactic.PILOT_OVERRIDE)
"""An identification flight consists of steps within its own bounds; in the other tactics the aim has no effect."""


class SlewLimit:
    """Bounds the motion of one vehicle's aim, relative to the last aim sent, which prevents wind-up.

    The first aim is bounded relative to that at which the vehicle keeps its velocity.
    """

    def __init__(self, config: AgentConfig) -> None:
        # Per tick, not per time: a clock step neither lifts nor tightens the limit.
        self._longest_m = config.safety.setpoint_speed_bound_m_s / config.rate_hz
        self._plant = config.plant
        self._sent_m: Vector | None = None

    def bounded(self, tactic: Tactic, plan: Plan, situation: Situation) -> Plan:
        """Return the plan with its aim within one tick's limit of the aim sent last."""
        if tactic in _FREE:
            return plan
        before_m = self._sent_m
        if before_m is None:
            before_m = aim_for_acceleration(situation.acting_motion, _STILL, situation.compensation, self._plant)
        return shifted(plan, towards(plan.aim_m, before_m, self._longest_m))

    def restart(self) -> None:
        """Begin again: the last aim refers to another place."""
        self._sent_m = None

    def sent(self, aim_m: Vector) -> None:
        """Record the aim (2,) that is sent."""
        self._sent_m = aim_m


STRAYS_M_S: Final = 0.6
RETURNS_M_S: Final = 0.3
"""A vehicle whose velocity differs from the formation's by more than the larger one has left the line, until the
difference is below the smaller one.
"""
SURE_SIGMAS: Final = 2.0
"""The direction to the target is used if its distance is more than this many standard deviations of its position."""


class Yaw:
    """Computes the yaw of one vehicle; its state is the yaw sent last."""

    def __init__(self, config: AgentConfig) -> None:
        self._along_path = config.formation.yaw == "path"
        self._at_target = config.encirclement.yaw == "target"
        self._turns = config.turns_nose
        self._line_m_s = config.formation.speed_m_s
        self._near_m = config.encirclement.radius_min_m
        self._step_rad = radians(config.safety.yaw_rate_max_deg_s) / config.rate_hz
        self._yaw_rad = 0.0
        self._strays = False

    def turn(self, tactic: Tactic, situation: Situation) -> float:
        """Return the yaw of the next setpoint; to be called once for each."""
        if not self._turns:
            return 0.0
        wanted_rad = self._wanted_rad(tactic, situation)
        if wanted_rad is not None:
            left_rad = wrap_signed_rad(wanted_rad - self._yaw_rad)
            step_rad = min(max(left_rad, -self._step_rad), self._step_rad)
            self._yaw_rad = wrap_signed_rad(self._yaw_rad + step_rad)
        return self._yaw_rad

    def _wanted_rad(self, tactic: Tactic, situation: Situation) -> float | None:
        if tactic is Tactic.FORMATION:
            return self._path_rad(situation) if self._along_path else 0.0
        if tactic is Tactic.ENCIRCLE:
            return self._target_rad(situation) if self._at_target else 0.0
        return None

    def _path_rad(self, situation: Situation) -> float:
        """Return the direction of flight; at the formation's velocity that of the mission line."""
        x_rate, y_rate = situation.acting_motion[VELOCITY].tolist()
        off_m_s = hypot(x_rate - self._line_m_s, y_rate)
        self._strays = off_m_s > (RETURNS_M_S if self._strays else STRAYS_M_S)
        own_way = self._strays and hypot(x_rate, y_rate) > RETURNS_M_S
        return atan2(y_rate, x_rate) if own_way else 0.0

    def _target_rad(self, situation: Situation) -> float | None:
        """Return the direction to the estimated target, None if it is too near for one."""
        if situation.target is None or situation.acting_target is None:
            return None
        x, y = (situation.acting_target - situation.acting_motion)[POSITION].tolist()
        unsure_m = SURE_SIGMAS * situation.target.position_sigma_m
        return atan2(y, x) if hypot(x, y) > max(self._near_m, unsure_m) else None
