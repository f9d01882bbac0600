"""The entities of a flight's 3-D scene. Each has an id of its own for good, and is empty while there is nothing to
show: so any one scene is complete, and whoever joins or seeks sees everything.
"""

from collections.abc import Sequence
from typing import Any

from foxglove.messages import Point3, SceneEntity, Timestamp

from agents.settings.sections import SafetySettings
from estimation.frames import Triple
from gcs.flightlog.records import TargetState
from gcs.style import FAIL, FAINT
from gcs.viewer.seen import SeenVehicle
from gcs.viewer.shapes import (
    ELLIPSE_HEIGHT_M,
    arrow,
    ball,
    circle,
    colour,
    disc,
    ellipse,
    label,
    line,
)

MISSION_FRAME = "mission"
TARGET = "#F0E442"
SLOT_M, SETPOINT_M, TARGET_M = 0.5, 0.3, 0.8
BUBBLE_ALPHA, BUBBLE_ALERT_ALPHA, ELLIPSE_ALPHA = 0.12, 0.5, 0.4
_WISHED = colour(FAINT)


def newest_target(team: Sequence[SeenVehicle]) -> TargetState | None:
    """Return what that vehicle believes of the target which has heard of it last."""
    believed = [seen.target for seen in team if seen.target is not None]
    return max(believed, key=lambda each: each.sighted_s, default=None)


def ground_place(belief: TargetState) -> Triple:
    """Return where a target is believed to be; its height is nobody's business."""
    return belief.mean[0], belief.mean[1], 0.0


def position_covariance(belief: TargetState) -> tuple[float, float, float]:
    """Return (xx, xy, yy) [m²] of a belief, whose covariance (4, 4) is that of [x y x' y']."""
    return belief.covariance[0], belief.covariance[1], belief.covariance[5]


class Drawing:
    """Draws a team; what never changes is made once."""

    def __init__(self, safety: SafetySettings, ring_radius_m: float, ring_altitude_m: float) -> None:
        self._safety = safety
        self._ring_altitude_m = ring_altitude_m
        self._ring = _points(circle(ring_radius_m))
        self._slot = _points(circle(SLOT_M, 4))
        self._fence = [line(points, _WISHED, closed=True) for points in _fence(safety)]

    def entities(self, team: Sequence[SeenVehicle], at: Timestamp) -> list[SceneEntity]:
        """Return everything that there is to see of vehicles whose places are known."""
        entities = [_entity(at, "fence", lines=self._fence), *self._target(newest_target(team), at)]
        for seen in team:
            entities += self._vehicle(seen, at)
        return entities

    def _target(self, belief: TargetState | None, at: Timestamp) -> list[SceneEntity]:
        if belief is None:
            return [_entity(at, "target"), _entity(at, "ring")]
        place_m = ground_place(belief)
        ring_m = (place_m[0], place_m[1], self._ring_altitude_m)
        shade = colour(TARGET)
        return [
            _entity(at, "target", spheres=[ball(place_m, TARGET_M, shade)], texts=[label("target", place_m, shade)]),
            _entity(at, "ring", lines=[line(self._ring, _WISHED, ring_m, closed=True)]),
        ]

    def _vehicle(self, seen: SeenVehicle, at: Timestamp) -> list[SceneEntity]:
        name, own, place_m = f"vehicle {seen.vehicle_id}", colour(seen.colour), seen.place_m
        tactic = "" if seen.decision is None else seen.decision.tactic
        words = label(f"{seen.vehicle_id} {tactic}", place_m, own)
        slot_m = seen.slot_m
        slot = [] if slot_m is None else [line(self._slot, own, slot_m, closed=True)]
        return [
            _entity(at, name, arrows=[arrow(place_m, seen.yaw_rad, own)], texts=[words]),
            _entity(at, f"{name} separation", cylinders=[self._bubble(seen)]),
            _entity(at, f"{name} trail", lines=[line(seen.trail, own, closed=False)]),
            _entity(at, f"{name} slot", lines=slot),
            _setpoint(seen, f"{name} setpoint", at),
            _uncertainty(seen, f"{name} target", at),
        ]

    def _bubble(self, seen: SeenVehicle) -> Any:
        """Return half of what is to be kept free about a vehicle: two vehicles are too close where two of them meet."""
        safety = self._safety
        shade = colour(FAIL, BUBBLE_ALERT_ALPHA) if seen.guarded else colour(FAINT, BUBBLE_ALPHA)
        return disc(seen.place_m, (safety.separation_m, safety.separation_m), safety.vertical_separation_m, shade)


def _setpoint(seen: SeenVehicle, name: str, at: Timestamp) -> SceneEntity:
    if seen.decision is None or seen.decision.setpoint is None:
        return _entity(at, name)
    there_m, own = seen.decision.setpoint.position_m, colour(seen.colour, 0.6)
    way = line(_points((seen.place_m, there_m)), own, closed=False)
    return _entity(at, name, lines=[way], spheres=[ball(there_m, SETPOINT_M, own)])


def _uncertainty(seen: SeenVehicle, name: str, at: Timestamp) -> SceneEntity:
    if seen.target is None:
        return _entity(at, name)
    long_m, short_m, yaw_rad = ellipse(position_covariance(seen.target))
    axes_m, shade = (2.0 * long_m, 2.0 * short_m), colour(seen.colour, ELLIPSE_ALPHA)
    area = disc(ground_place(seen.target), axes_m, ELLIPSE_HEIGHT_M, shade, yaw_rad)
    return _entity(at, name, cylinders=[area])


def _fence(safety: SafetySettings) -> list[list[Point3]]:
    """Return the fence's outline at its lowest and its highest altitude, at the ground where none are told."""
    heights_m = [each for each in (safety.altitude_min_m, safety.altitude_max_m) if each is not None] or [0.0]
    return [_points([(x, y, z) for x, y in safety.fence_m]) for z in heights_m] if safety.fence_m else []


def _entity(at: Timestamp, name: str, **primitives: Any) -> SceneEntity:
    return SceneEntity(timestamp=at, frame_id=MISSION_FRAME, id=name, **primitives)


def _points(places_m: Any) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in places_m]
