"""A flight as a point cloud, for viewers without scene entities, such as Rerun."""

from collections.abc import Sequence
from math import cos, dist, sin

import numpy as np
from foxglove.messages import PackedElementField, PackedElementFieldNumericType, PointCloud, Timestamp
from numpy.typing import NDArray

from agents.settings.sections import SafetySettings
from estimation.frames import Triple
from gcs.style import FAIL, FAINT
from gcs.viewer.drawing import MISSION_FRAME, TARGET, ground_place, newest_target, position_covariance
from gcs.viewer.drawn_vehicle import DrawnVehicle
from gcs.viewer.shapes import circle, ellipse, pose

LAYOUT = np.dtype([("place", "<f4", 3), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1")])
FENCE_STEP_M, BUBBLE_POINTS, ELLIPSE_POINTS = 2.0, 24, 24
_Points = NDArray[np.float64]


class Cloud:
    """Draws a team as points; constant geometry is built once."""

    def __init__(self, limits: Sequence[SafetySettings], ring_radius_m: float, ring_altitude_m: float) -> None:
        """Take the vehicles' safety settings, which differ in fence and altitudes only."""
        numbers = PackedElementFieldNumericType
        places = [PackedElementField(name=name, offset=4 * k, type=numbers.Float32) for k, name in enumerate("xyz")]
        shades = [
            PackedElementField(name=name, offset=12 + k, type=numbers.Uint8)
            for k, name in enumerate(("red", "green", "blue", "alpha"))
        ]
        self._fields = places + shades
        self._ring = np.array(circle(ring_radius_m)) + np.array((0.0, 0.0, ring_altitude_m))
        self._bubble = np.array(circle(limits[0].separation_m / 2.0, BUBBLE_POINTS))
        self._ellipse = np.array(circle(1.0, ELLIPSE_POINTS))
        self._fence = b"".join(_packed(_outline(each), FAINT) for each in limits)

    def message(self, team: Sequence[DrawnVehicle], at: Timestamp) -> PointCloud:
        """Return the points of the vehicles with a known position."""
        parts = [self._fence]
        target = newest_target(team)
        if target is not None:
            place_m = np.array(ground_place(target))
            parts += [_packed(self._ring + place_m, FAINT), _packed(place_m[None], TARGET)]
        for vehicle in team:
            parts += self._vehicle(vehicle)
        return PointCloud(
            timestamp=at,
            frame_id=MISSION_FRAME,
            pose=pose((0.0, 0.0, 0.0)),
            point_stride=LAYOUT.itemsize,
            fields=self._fields,
            data=b"".join(parts),
        )

    def _vehicle(self, vehicle: DrawnVehicle) -> list[bytes]:
        here_m = np.array(vehicle.place_m)
        parts = [
            _packed(self._bubble + here_m, FAIL if vehicle.guarded else vehicle.colour),
            _packed(np.array([*vehicle.trail_m, here_m]), vehicle.colour),
        ]
        if vehicle.decision is not None and vehicle.decision.setpoint is not None:
            parts.append(_packed(np.array([vehicle.decision.setpoint.position_m]), vehicle.colour))
        if vehicle.target is not None:
            long_m, short_m, yaw_rad = ellipse(position_covariance(vehicle.target))
            along, across = self._ellipse[:, 0] * long_m, self._ellipse[:, 1] * short_m
            turned = np.zeros_like(self._ellipse)
            turned[:, 0] = along * cos(yaw_rad) - across * sin(yaw_rad)
            turned[:, 1] = along * sin(yaw_rad) + across * cos(yaw_rad)
            parts.append(_packed(turned + ground_place(vehicle.target), vehicle.colour))
        return parts


def _packed(places_m: _Points, hexadecimal: str) -> bytes:
    packed = np.empty(len(places_m), LAYOUT)
    packed["place"] = places_m
    packed["red"], packed["green"], packed["blue"] = bytes.fromhex(hexadecimal.removeprefix("#"))
    packed["alpha"] = 255
    return packed.tobytes()


def _outline(safety: SafetySettings) -> _Points:
    """Return points (N, 3) along the fence on the ground."""
    places_m: list[Triple] = []
    corners = safety.fence_m
    for (x1, y1), (x2, y2) in zip(corners, (*corners[1:], *corners[:1]), strict=True):
        steps = max(round(dist((x1, y1), (x2, y2)) / FENCE_STEP_M), 1)
        places_m += [(x1 + (x2 - x1) * k / steps, y1 + (y2 - y1) * k / steps, 0.0) for k in range(steps)]
    return np.array(places_m).reshape(-1, 3)
