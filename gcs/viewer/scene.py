"""A flight in standard Foxglove messages, beside the records: 3-D scene, map and event list for any viewer."""

from collections.abc import Sequence
from math import cos, dist, sin
from typing import NamedTuple

import numpy as np
from foxglove import Context
from foxglove.channels import (
    FrameTransformsChannel,
    LocationFixChannel,
    LogChannel,
    PointCloudChannel,
    PoseInFrameChannel,
    SceneUpdateChannel,
)
from foxglove.messages import (
    FrameTransform,
    FrameTransforms,
    LocationFix,
    Log,
    LogLevel,
    PackedElementField,
    PackedElementFieldNumericType,
    PointCloud,
    PoseInFrame,
    SceneUpdate,
    Timestamp,
    Vector3,
)
from numpy.typing import NDArray

from agents.inputs import Start
from agents.notes import Note
from agents.settings.sections import SafetySettings
from estimation.frames import MissionFrame, Triple
from estimation.state import Telemetry
from gcs.flightlog.records import Decision
from gcs.mission.mission import Mission, MissionRing
from gcs.style import COLOURS, FAIL, FAINT
from gcs.viewer.drawing import (
    MISSION_FRAME,
    TARGET,
    Drawing,
    DrawnRing,
    DrawnVehicle,
    ground_place,
    position_covariance,
    targets_seen,
)
from gcs.viewer.shapes import circle, colour, ellipse, pose, ring_outline, rotation, timestamp

LAYOUT = np.dtype([("place", "<f4", 3), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1")])
FENCE_STEP_M, BUBBLE_POINTS, ELLIPSE_POINTS = 2.0, 24, 24
_Points = NDArray[np.float64]


class Cloud:
    """Draws a team as points; constant geometry is built once."""

    def __init__(self, limits: Sequence[SafetySettings], rings: Sequence[DrawnRing]) -> None:
        """Take the vehicles' safety settings, which differ in fence and altitudes only, and the rings."""
        numbers = PackedElementFieldNumericType
        places = [PackedElementField(name=name, offset=4 * k, type=numbers.Float32) for k, name in enumerate("xyz")]
        shades = [
            PackedElementField(name=name, offset=12 + k, type=numbers.Uint8)
            for k, name in enumerate(("red", "green", "blue", "alpha"))
        ]
        self._fields = places + shades
        self._rings = rings
        self._outlines = [np.array(each.outline_m) + np.array((0.0, 0.0, each.altitude_m)) for each in rings]
        self._bubble = np.array(circle(limits[0].separation_m / 2.0, BUBBLE_POINTS))
        self._ellipse = np.array(circle(1.0, ELLIPSE_POINTS))
        self._fence = b"".join(_packed(_outline(each), FAINT) for each in limits)

    def message(self, team: Sequence[DrawnVehicle], at: Timestamp) -> PointCloud:
        """Return the points of the vehicles with a known position."""
        parts = [self._fence]
        for number, target in sorted(targets_seen(team, self._rings).items()):
            place_m = np.array(ground_place(target))
            for ring, outline in zip(self._rings, self._outlines, strict=True):
                if ring.target == number:
                    parts.append(_packed(outline + place_m, ring.colour))
            parts.append(_packed(place_m[None], TARGET))
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


PERIOD_S = 0.2
"""Period of the scene messages in mission time."""
_EARLY_S = 1e-6
LEVELS = {
    "tactic": LogLevel.Info,
    "command": LogLevel.Info,
    "guard": LogLevel.Warning,
    "ring": LogLevel.Warning,
    "failsafe": LogLevel.Error,
}


class _VehicleChannels(NamedTuple):
    pose: PoseInFrameChannel
    location: LocationFixChannel | None


class Scene:
    """The scene of one run: call it with each record in order. A vehicle appears once its position is known."""

    def __init__(self, context: Context, mission: Mission) -> None:
        self._context = context
        self._frame = mission.mission_frame()
        self._team = {
            vehicle.id: DrawnVehicle(mission.agent_config(vehicle), COLOURS[row % len(COLOURS)])
            for row, vehicle in enumerate(mission.vehicles)
        }
        rings = drawn_rings(mission)
        # Vehicles may have fences of their own.
        limits = tuple(dict.fromkeys(vehicle.config.safety for vehicle in self._team.values()))
        self._drawing = Drawing(limits, rings, [each.name for each in mission.targets] if mission.rings else [""])
        self._cloud = Cloud(limits, rings)
        self._scene = SceneUpdateChannel("/scene", context=context)
        self._points = PointCloudChannel("/points", context=context)
        self._transforms = FrameTransformsChannel("/tf", context=context)
        self._log = LogChannel("/log", context=context)
        self._channels: dict[int, _VehicleChannels] = {}
        self._shown_s: float | None = None

    def __call__(self, vehicle_id: int, time_ns: int, record: object) -> None:
        """Add a record, and write the messages that are due."""
        vehicle = self._team.get(vehicle_id)
        if vehicle is None:
            return
        match record:
            case Telemetry():
                vehicle.move(record, time_ns)
            case Start():
                vehicle.start_s = record.at_s
            case Decision():
                vehicle.decision = record
                for note in record.notes:
                    self._log_note(vehicle_id, note, time_ns)
                if self._shown_s is None or not 0.0 <= record.time_s - self._shown_s < PERIOD_S - _EARLY_S:
                    self._shown_s = record.time_s
                    self._show(time_ns)

    def _log_note(self, vehicle_id: int, note: Note, time_ns: int) -> None:
        message = f"{note.text} ({note.because})" if note.because else note.text
        self._log.log(
            Log(timestamp=timestamp(time_ns), level=LEVELS[note.kind], name=f"vehicle {vehicle_id}", message=message),
            log_time=time_ns,
        )

    def _show(self, time_ns: int) -> None:
        """Write the messages of all vehicles: one message of a topic shows the whole team."""
        team = [vehicle for vehicle in self._team.values() if vehicle.telemetry is not None]
        if not team:
            return
        at = timestamp(time_ns)
        self._transforms.log(FrameTransforms(transforms=list(map(_transform, team))), log_time=time_ns)
        for vehicle in team:
            self._show_vehicle(vehicle, time_ns)
        self._scene.log(SceneUpdate(entities=self._drawing.entities(team, at)), log_time=time_ns)
        self._points.log(self._cloud.message(team, at), log_time=time_ns)

    def _show_vehicle(self, vehicle: DrawnVehicle, time_ns: int) -> None:
        channels = self._channels.get(vehicle.vehicle_id) or self._open_channels(vehicle.vehicle_id)
        at, place = timestamp(vehicle.place_ns), pose(vehicle.place_m, vehicle.yaw_rad)
        channels.pose.log(PoseInFrame(timestamp=at, frame_id=MISSION_FRAME, pose=place), log_time=time_ns)
        if channels.location is not None:
            channels.location.log(_location(vehicle, self._frame), log_time=time_ns)

    def _open_channels(self, vehicle_id: int) -> _VehicleChannels:
        topic, context = f"/vehicle/{vehicle_id}", self._context
        location = None if self._frame.is_local else LocationFixChannel(f"{topic}/location", context=context)
        channels = _VehicleChannels(PoseInFrameChannel(f"{topic}/pose", context=context), location)
        self._channels[vehicle_id] = channels
        return channels


def drawn_rings(mission: Mission) -> list[DrawnRing]:
    """Return the rings of a mission; only those of several have names and colours of their own."""
    lowest_m = min(vehicle.section.altitude_m for vehicle in mission.vehicles)
    only = MissionRing("", 0, len(mission.vehicles), mission.encirclement)
    return [
        DrawnRing(
            each.name,
            each.target,
            COLOURS[-1 - number % len(COLOURS)] if mission.rings else FAINT,
            ring_outline(each.encirclement),
            each.encirclement.lowest_m(lowest_m),
        )
        for number, each in enumerate(mission.rings or (only,))
    ]


def vehicle_frame(vehicle_id: int) -> str:
    """Return the name of a vehicle's body-fixed frame."""
    return f"vehicle_{vehicle_id}"


def _transform(vehicle: DrawnVehicle) -> FrameTransform:
    x, y, z = vehicle.place_m
    return FrameTransform(
        timestamp=timestamp(vehicle.place_ns),
        parent_frame_id=MISSION_FRAME,
        child_frame_id=vehicle_frame(vehicle.vehicle_id),
        translation=Vector3(x=x, y=y, z=z),
        rotation=rotation(vehicle.yaw_rad),
    )


def _location(vehicle: DrawnVehicle, frame: MissionFrame) -> LocationFix:
    assert vehicle.telemetry is not None
    place = frame.geodetic_from_mission(vehicle.place_m)
    north, east, down = frame.ned_from_mission(vehicle.telemetry.velocity_m_s)
    return LocationFix(
        timestamp=timestamp(vehicle.place_ns),
        frame_id=vehicle_frame(vehicle.vehicle_id),
        latitude=place.latitude_deg,
        longitude=place.longitude_deg,
        altitude=place.altitude_m,
        heading=frame.x_bearing_rad - vehicle.yaw_rad,
        velocity=Vector3(x=east, y=north, z=-down),
        color=colour(vehicle.colour),
    )
