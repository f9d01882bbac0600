"""The entities of a flight's 3-D scene.

Each entity has a constant id and is empty while it has nothing to show. So every scene message is complete, also for a
viewer that connects late or seeks in a log.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import atan2, hypot
from typing import Any, NamedTuple

from foxglove.messages import Point3, SceneEntity, Timestamp

from agents.settings.config import AgentConfig
from agents.settings.sections import SafetySettings
from agents.tactics import Tactic
from estimation.frames import Triple
from estimation.state import Telemetry
from gcs.flightlog.records import Decision, TargetState
from gcs.style import FAIL, FAINT
from gcs.viewer.shapes import ELLIPSE_HEIGHT_M, arrow, ball, circle, colour, disc, ellipse, label, line

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


class DrawnRing(NamedTuple):
    """A ring to draw: its name, empty for the only one, the number of its target, its colour (`#RRGGBB`), its outline
    about the origin, and its altitude.
    """

    name: str
    target: int
    colour: str
    outline_m: Sequence[Triple]
    altitude_m: float


MISSION_FRAME = "mission"
TARGET = "#F0E442"
SLOT_M, SETPOINT_M, TARGET_M = 0.5, 0.3, 0.8
BUBBLE_ALPHA, BUBBLE_ALERT_ALPHA, ELLIPSE_ALPHA = 0.12, 0.5, 0.4
_DESIRED = colour(FAINT)


def newest_target(team: Sequence[DrawnVehicle]) -> TargetState | None:
    """Return the target estimate with the newest sighting in the team, None without any."""
    targets = [vehicle.target for vehicle in team if vehicle.target is not None]
    return max(targets, key=lambda each: each.sighted_s, default=None)


def targets_seen(team: Sequence[DrawnVehicle], rings: Sequence[DrawnRing]) -> dict[int, TargetState]:
    """Return the newest estimate of each target that is known, by its number: a vehicle's is of its ring's target."""
    of_target: dict[int, list[DrawnVehicle]] = {}
    for vehicle in team:
        ring = 0 if vehicle.decision is None else vehicle.decision.ring
        of_target.setdefault(rings[ring].target, []).append(vehicle)
    newest = {number: newest_target(vehicles) for number, vehicles in of_target.items()}
    return {number: target for number, target in newest.items() if target is not None}


def ground_place(target: TargetState) -> Triple:
    """Return the estimated position of a target on the ground."""
    return target.mean[0], target.mean[1], 0.0


def position_covariance(target: TargetState) -> tuple[float, float, float]:
    """Return (xx, xy, yy) [m²] of an estimate, whose covariance (4, 4) is that of [x y x' y']."""
    return target.covariance[0], target.covariance[1], target.covariance[5]


class Drawing:
    """Draws a team; constant geometry is built once."""

    def __init__(self, limits: Sequence[SafetySettings], rings: Sequence[DrawnRing], targets: Sequence[str]) -> None:
        """Take the vehicles' safety settings, which differ in fence and altitudes only, the rings, and the targets'
        names.
        """
        self._safety = limits[0]
        self._rings = rings
        self._outlines = [_points(each.outline_m) for each in rings]
        self._targets = targets
        self._slot = _points(circle(SLOT_M, 4))
        self._fence = [line(points, _DESIRED, closed=True) for each in limits for points in _fence(each)]

    def entities(self, team: Sequence[DrawnVehicle], at: Timestamp) -> list[SceneEntity]:
        """Return all entities of the vehicles with a known position."""
        seen = targets_seen(team, self._rings)
        entities = [_entity(at, "fence", lines=self._fence)]
        for number, name in enumerate(self._targets):
            entities += self._target(name, number, seen.get(number), at)
        for vehicle in team:
            entities += self._vehicle(vehicle, at)
        return entities

    def _target(self, name: str, number: int, target: TargetState | None, at: Timestamp) -> list[SceneEntity]:
        """Return a target and the rings about it, empty while it is not known."""
        target_id = f"target {name}".rstrip()
        outlines = zip(self._rings, self._outlines, strict=True)
        rings = [(f"ring {ring.name}".rstrip(), ring, points) for ring, points in outlines if ring.target == number]
        if target is None:
            return [_entity(at, target_id), *(_entity(at, ring_id) for ring_id, _, _ in rings)]
        place_m, shade = ground_place(target), colour(TARGET)
        spheres, text = [ball(place_m, TARGET_M, shade)], label(name or "target", place_m, shade)
        return [
            _entity(at, target_id, spheres=spheres, texts=[text]),
            *(_ring(ring_id, ring, points, place_m, at) for ring_id, ring, points in rings),
        ]

    def _vehicle(self, vehicle: DrawnVehicle, at: Timestamp) -> list[SceneEntity]:
        name, own, place_m = f"vehicle {vehicle.vehicle_id}", colour(vehicle.colour), vehicle.place_m
        tactic = "" if vehicle.decision is None else vehicle.decision.tactic
        text = label(f"{vehicle.vehicle_id} {tactic}", place_m, own)
        slot_m = vehicle.slot_m
        slot = [] if slot_m is None else [line(self._slot, own, slot_m, closed=True)]
        return [
            _entity(at, name, arrows=[arrow(place_m, vehicle.yaw_rad, own)], texts=[text]),
            _entity(at, f"{name} separation", cylinders=[self._bubble(vehicle)]),
            _entity(at, f"{name} trail", lines=[line(vehicle.trail, own, closed=False)]),
            _entity(at, f"{name} slot", lines=slot),
            _setpoint(vehicle, f"{name} setpoint", at),
            _uncertainty(vehicle, f"{name} target", at),
        ]

    def _bubble(self, vehicle: DrawnVehicle) -> Any:
        """Return a cylinder of half the separation about a vehicle: two vehicles are too close where theirs touch."""
        safety = self._safety
        shade = colour(FAIL, BUBBLE_ALERT_ALPHA) if vehicle.guarded else colour(FAINT, BUBBLE_ALPHA)
        return disc(vehicle.place_m, (safety.separation_m, safety.separation_m), safety.vertical_separation_m, shade)


def _ring(name: str, ring: DrawnRing, points: Sequence[Point3], place_m: Triple, at: Timestamp) -> SceneEntity:
    centre_m, shade = (place_m[0], place_m[1], ring.altitude_m), colour(ring.colour)
    x, y, z = ring.outline_m[0]
    named_m = (centre_m[0] + x, centre_m[1] + y, centre_m[2] + z)
    texts = [label(ring.name, named_m, shade)] if ring.name else []
    return _entity(at, name, lines=[line(points, shade, centre_m, closed=True)], texts=texts)


def _setpoint(vehicle: DrawnVehicle, name: str, at: Timestamp) -> SceneEntity:
    if vehicle.decision is None or vehicle.decision.setpoint is None:
        return _entity(at, name)
    there_m, own = vehicle.decision.setpoint.position_m, colour(vehicle.colour, 0.6)
    way = line(_points((vehicle.place_m, there_m)), own, closed=False)
    return _entity(at, name, lines=[way], spheres=[ball(there_m, SETPOINT_M, own)])


def _uncertainty(vehicle: DrawnVehicle, name: str, at: Timestamp) -> SceneEntity:
    if vehicle.target is None:
        return _entity(at, name)
    long_m, short_m, yaw_rad = ellipse(position_covariance(vehicle.target))
    axes_m, shade = (2.0 * long_m, 2.0 * short_m), colour(vehicle.colour, ELLIPSE_ALPHA)
    area = disc(ground_place(vehicle.target), axes_m, ELLIPSE_HEIGHT_M, shade, yaw_rad)
    return _entity(at, name, cylinders=[area])


def _fence(safety: SafetySettings) -> list[list[Point3]]:
    """Return the fence's outline at its lowest and highest altitude, on the ground without altitude limits."""
    heights_m = [each for each in (safety.altitude_min_m, safety.altitude_max_m) if each is not None] or [0.0]
    return [_points([(x, y, z) for x, y in safety.fence_m]) for z in heights_m] if safety.fence_m else []


def _entity(at: Timestamp, name: str, **primitives: Any) -> SceneEntity:
    return SceneEntity(timestamp=at, frame_id=MISSION_FRAME, id=name, **primitives)


def _points(places_m: Any) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in places_m]
