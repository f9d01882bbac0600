"""The state of a vehicle from the records so far, as the scene draws it."""

from collections import deque
from dataclasses import dataclass, field
from math import atan2, hypot

from foxglove.messages import Point3

from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from estimation.frames import Triple
from estimation.state import Telemetry
from gcs.flightlog.records import Decision, TargetState

TRAIL_POINTS, TRAIL_PERIOD_S = 120, 1.0
TRAIL_GRID_PER_M = 64.0
"""Resolution of the trails: multiples of it have few binary digits and compress well."""
MOVING_M_S = 0.3


@dataclass(slots=True)
class DrawnVehicle:
    """A vehicle to draw; its colour is `#RRGGBB`. `place_ns` is the time of its telemetry; `trail` holds the points of
    `trail_m` as Foxglove messages.
    """

    config: AgentConfig
    colour: str
    telemetry: Telemetry | None = None
    place_ns: int = 0
    decision: Decision | None = None
    start_s: float | None = None
    trail_m: deque[Triple] = field(default_factory=lambda: deque(maxlen=TRAIL_POINTS))
    trail: deque[Point3] = field(default_factory=lambda: deque(maxlen=TRAIL_POINTS))
    yaw_rad: float = 0.0
    _trailed_s: float | None = None

    @property
    def vehicle_id(self) -> int:
        """The vehicle's id."""
        return self.config.vehicle_id

    @property
    def place_m(self) -> Triple:
        """The position of the vehicle."""
        assert self.telemetry is not None
        return self.telemetry.position_m

    def move(self, telemetry: Telemetry, time_ns: int) -> None:
        """Add a sample of telemetry.

        The yaw is the direction of flight; below `MOVING_M_S`, and with a commanded yaw, that of the setpoint.
        """
        self.telemetry, self.place_ns = telemetry, time_ns
        x_rate, y_rate, _ = telemetry.velocity_m_s
        if hypot(x_rate, y_rate) >= MOVING_M_S and not self.config.turns_nose:
            self.yaw_rad = atan2(y_rate, x_rate)
        elif self.decision is not None and self.decision.setpoint is not None:
            self.yaw_rad = self.decision.setpoint.yaw_rad
        if self._trailed_s is None or not 0.0 <= telemetry.time_s - self._trailed_s < TRAIL_PERIOD_S:
            self._trailed_s = telemetry.time_s
            x, y, z = (round(each * TRAIL_GRID_PER_M) / TRAIL_GRID_PER_M for each in telemetry.position_m)
            self.trail_m.append((x, y, z))
            self.trail.append(Point3(x=x, y=y, z=z))

    @property
    def guarded(self) -> bool:
        """Whether the guard moved the newest setpoint."""
        return self.decision is not None and self.decision.guard is not None and bool(self.decision.guard.causes)

    @property
    def target(self) -> TargetState | None:
        """The vehicle's target estimate."""
        return None if self.decision is None else self.decision.target

    @property
    def slot_m(self) -> Triple | None:
        """The vehicle's slot in the formation, None while it is not in formation."""
        decision, config = self.decision, self.config
        if decision is None or self.start_s is None or decision.tactic != Tactic.FORMATION.value:
            return None
        x, y = config.line_start_m
        along_m, across_m = config.slot_offset_m(config.vehicle_id, config.formation.leader)
        flown_m = config.formation.speed_m_s * max(decision.time_s - self.start_s, 0.0)
        return x + along_m + flown_m, y + across_m, config.altitude_m
