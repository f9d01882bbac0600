"""The target of each flight mode: hold points, take-off, descent, return, the followed setpoint.

Mission frame, metres, seconds; headings clockwise from north.
"""

from dataclasses import dataclass
from math import hypot, inf

from estimation.frames import Triple
from estimation.vectors import clipped_pair
from sitl.autopilot.airframe import STEP_S, Airframe, Target
from sitl.autopilot.modes import NEEDS_STICKS, NavMode
from sitl.autopilot.parameters import FlightLimits, Parameters

HOVER_THRUST_S = 1.0
"""The time from started motors to lift-off, while the thrust ramps up."""
LIFT_OFF_MARGIN_M = 0.2
"""A vehicle with a target less than this above the ground stays on the ground."""
CRAWL_BELOW_M = 1.0
DESCENT_LEAD_M = 10.0
"""A descent has its target this far below, so that the speed limit is reached and the vehicle stays on the ground."""


@dataclass(frozen=True, slots=True)
class PositionTarget:
    """A received setpoint: mission position, heading (None keeps the present one), and velocity, empty if none."""

    position_m: Triple
    heading_rad: float | None = None
    velocity_m_s: tuple[float, ...] = ()


class Guidance:
    """Turns a flight mode into a target for the airframe, step by step."""

    def __init__(self, parameters: Parameters, airframe: Airframe) -> None:
        self._parameters = parameters
        self._airframe = airframe
        self._hold_m = self.home_m = airframe.position_m
        self._take_off_altitude_m = airframe.position_m[2]
        self._return_altitude_m = 0.0
        self._climb_from_s = inf
        self._descends_from_s = -inf

    @property
    def _limits(self) -> FlightLimits:
        return self._parameters.limits

    @property
    def take_off_complete(self) -> bool:
        """Whether the take-off altitude is nearly reached."""
        return self._airframe.position_m[2] > self._take_off_altitude_m - self._limits.altitude_margin_m

    def on_arm(self) -> None:
        """Set home to the present position."""
        self._hold_m = self.home_m = self._airframe.position_m
        self._climb_from_s = inf

    def plan_take_off(self, altitude_m: float | None) -> None:
        """Set the take-off altitude; None is the default height above the present one."""
        default = self._airframe.position_m[2] + self._limits.take_off_height_m
        self._take_off_altitude_m = default if altitude_m is None else altitude_m

    def enter(self, mode: NavMode, *, after: NavMode) -> None:
        """Set the hold point of `mode` to the present position; after a take-off, at the requested altitude."""
        x, y, altitude = self._airframe.position_m
        if (after, mode) == (NavMode.TAKE_OFF, NavMode.HOLD) and self.take_off_complete:
            altitude = self._take_off_altitude_m
        if mode is NavMode.TAKE_OFF:
            self.plan_take_off(None)
        self._hold_m = (x, y, altitude)
        self._descends_from_s = -inf
        distance = hypot(x - self.home_m[0], y - self.home_m[1])
        # It climbs less near home: the return cone has a slope of 45 degrees.
        rise = min(distance, self._limits.return_rise_m)
        self._return_altitude_m = max(altitude, self.home_m[2] + rise)

    def hover_before_landing(self, until_s: float) -> None:
        """Delay the descent of the landing that was just entered until `until_s`."""
        self._descends_from_s = until_s

    def target(self, mode: NavMode, setpoint: PositionTarget | None, *, time_s: float, motors_s: float) -> Target:
        """Return the present target; `motors_s` is when the motors were started."""
        x, y, altitude = self._hold_m
        heading = None
        velocity: tuple[float, ...] = ()
        sink = self._limits.sink_m_s
        if mode is NavMode.OFFBOARD and setpoint is not None:
            (x, y, altitude), heading, velocity = setpoint.position_m, setpoint.heading_rad, setpoint.velocity_m_s
        elif mode is NavMode.TAKE_OFF:
            altitude = self._take_off_altitude_m
        elif mode is NavMode.RETURN and not self._home_reached:
            x, y, altitude = self._head_home()
        elif (mode in (NavMode.LAND, NavMode.RETURN) or mode in NEEDS_STICKS) and time_s >= self._descends_from_s:
            altitude = self._airframe.position_m[2] - DESCENT_LEAD_M
            sink = self._sink_speed_m_s(crawl=mode not in NEEDS_STICKS)
        climb = self._climb_limit_m_s(mode, altitude, time_s=time_s, motors_s=motors_s)
        return Target((x, y), altitude, heading, climb, sink, velocity)

    @property
    def _home_reached(self) -> bool:
        return self._hold_m[:2] == self.home_m[:2]

    def _head_home(self) -> Triple:
        """Climb first, then move the hold point home at cruise speed."""
        x, y, _ = self._hold_m
        if self._airframe.position_m[2] > self._return_altitude_m - self._limits.altitude_margin_m:
            left = self.home_m[0] - x, self.home_m[1] - y
            stride = clipped_pair(left, self._limits.cruise_m_s * STEP_S)
            x, y = self.home_m[:2] if stride is left else (x + stride[0], y + stride[1])
        self._hold_m = (x, y, self._return_altitude_m)
        return self._hold_m

    def _sink_speed_m_s(self, *, crawl: bool) -> float:
        """Return the descent rate, lower near the ground; a vehicle without stick inputs descends at it."""
        near = crawl and self._airframe.height_m < CRAWL_BELOW_M
        return self._limits.crawl_m_s if near else self._limits.land_m_s

    def _climb_limit_m_s(self, mode: NavMode, altitude_m: float, *, time_s: float, motors_s: float) -> float:
        """Return the climb limit: 0 while the motors start, then a ramp, then the mode's speed."""
        if self._airframe.on_ground:
            lifts_off = altitude_m > self._airframe.position_m[2] + LIFT_OFF_MARGIN_M
            self._climb_from_s = min(self._climb_from_s, time_s) if lifts_off else inf
        limits = self._limits
        spooled_s = motors_s + limits.spool_up_s
        ramp_s = time_s - max(self._climb_from_s, spooled_s) - HOVER_THRUST_S
        if ramp_s <= 0.0:
            return 0.0
        if ramp_s < limits.take_off_ramp_s:
            return limits.take_off_m_s * ramp_s / limits.take_off_ramp_s
        return limits.take_off_m_s if mode is NavMode.TAKE_OFF else limits.climb_m_s
