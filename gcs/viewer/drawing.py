"""The entities of a flight's 3-D scene.

Each entity has a constant id and is empty while it has nothing to show. So every scene message is complete, also for a
viewer that connects late or seeks in a log.
"""

from collections.abc import Sequence
from typing import Any

from foxglove.messages import Point3, SceneEntity, Timestamp

from agents.settings.sections import SafetySettings
from estimation.frames import Triple
from gcs.flightlog.records import TargetState
from gcs.style import FAIL, FAINT
from gcs.viewer.drawn_vehicle import DrawnVehicle
from gcs.viewer.shapes import ELLIPSE_HEIGHT_M, arrow, ball, circle, colour, disc, ellipse, label, line

MISSION_FRAME = "mission"
TARGET = "#F0E442"
SLOT_M, SETPOINT_M, TARGET_M = 0.5, 0.3, 0.8
BUBBLE_ALPHA, BUBBLE_ALERT_ALPHA, ELLIPSE_ALPHA = 0.12, 0.5, 0.4
_DESIRED = colour(FAINT)


def newest_target(team: Sequence[DrawnVehicle]) -> TargetState | None:
    """Return the target estimate with the newest sighting in the team, None without any."""
    targets = [vehicle.target for vehicle in team if vehicle.target is not None]
    return max(targets, key=lambda each: each.sighted_s, default=None)


def ground_place(target: TargetState) -> Triple:
    """Return the estimated position of a target on the ground."""
    return target.mean[0], target.mean[1], 0.0


def position_covariance(target: TargetState) -> tuple[float, float, float]:
    """Return (xx, xy, yy) [m²] of an estimate, whose covariance (4, 4) is that of [x y x' y']."""
    return target.covariance[0], target.covariance[1], target.covariance[5]


class Drawing:
    """Draws a team; constant geometry is built once."""

    def __init__(self, limits: Sequence[SafetySettings], ring_radius_m: float, ring_altitude_m: float) -> None:
        """Take the vehicles' safety settings, which differ in fence and altitudes only."""
        self._safety = limits[0]
        self._ring_altitude_m = ring_altitude_m
        self._ring = _points(circle(ring_radius_m))
        self._slot = _points(circle(SLOT_M, 4))
        self._fence = [line(points, _DESIRED, closed=True) for each in limits for points in _fence(each)]

    def entities(self, team: Sequence[DrawnVehicle], at: Timestamp) -> list[SceneEntity]:
        """Return all entities of the vehicles with a known position."""
        entities = [_entity(at, "fence", lines=self._fence), *self._target(newest_target(team), at)]
        for vehicle in team:
            entities += self._vehicle(vehicle, at)
        return entities

    def _target(self, target: TargetState | None, at: Timestamp) -> list[SceneEntity]:
        if target is None:
            return [_entity(at, "target"), _entity(at, "ring")]
        place_m = ground_place(target)
        ring_m = (place_m[0], place_m[1], self._ring_altitude_m)
        shade = colour(TARGET)
        return [
            _entity(at, "target", spheres=[ball(place_m, TARGET_M, shade)], texts=[label("target", place_m, shade)]),
            _entity(at, "ring", lines=[line(self._ring, _DESIRED, ring_m, closed=True)]),
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
