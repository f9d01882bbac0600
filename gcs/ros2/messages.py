"""The messages of ROS 2 that cordon writes and reads, in CDR by rosbags, an extra.

The definitions are those of Jazzy; the types used here are the same from Humble on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numpy as np

from estimation.frames import Triple
from gcs.errors import InputError

MISSING = "ROS 2 needs rosbags; install it by: pip install 'cordon-gcs[ros2]'"
POSE, POSE_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
TWIST, TRANSFORMS, MARKERS = (
    "geometry_msgs/msg/TwistStamped",
    "tf2_msgs/msg/TFMessage",
    "visualization_msgs/msg/MarkerArray",
)
_NS = 1_000_000_000
_STAMP_MAX_NS = 2**31 * _NS
_POINTS, _SPHERE = 4, 2
"""LINE_STRIP and SPHERE of visualization_msgs/Marker."""
_LIFETIME_S = 1


def require_rosbags() -> None:
    """Raise InputError if rosbags is not installed."""
    try:
        import rosbags.typesys  # noqa: F401, PLC0415
    except ImportError as error:
        raise InputError([MISSING]) from error


class MalformedError(ValueError):
    """Bytes are not a message of the stated type."""


@dataclass(frozen=True, slots=True)
class Shape:
    """A marker: a line through points about its place, or a sphere as wide as `size_m` without any.

    Places are in the frame of ROS; the colour is `#RRGGBB`.
    """

    namespace: str
    number: int
    place_m: Triple
    size_m: float
    colour: str
    points_m: Sequence[Triple] = ()


class Messages:
    """Encodes and decodes messages in one frame; stamps are nanoseconds of Unix time."""

    def __init__(self, frame_id: str) -> None:
        """Take the name of the frame; raises InputError if rosbags is not installed."""
        require_rosbags()
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

        self.store = get_typestore(Stores.ROS2_JAZZY)
        self._frame_id = frame_id
        self._types: dict[str, Any] = dict(self.store.types)

    def type_hash(self, kind: str) -> str:
        """Return the hash of a type (REP 2011)."""
        return str(self.store.hash_rihs01(kind))

    def pose(self, stamp_ns: int, place_m: Triple, yaw_rad: float) -> bytes:
        """Return a level pose as a PoseStamped."""
        return self._encoded(POSE, self._header(stamp_ns), self._pose(place_m, yaw_rad))

    def twist(self, stamp_ns: int, velocity_m_s: Triple) -> bytes:
        """Return a velocity in the axes of the frame as a TwistStamped; the angular rate is 0."""
        linear, angular = (self._new("geometry_msgs/msg/Vector3", *each) for each in (velocity_m_s, (0.0, 0.0, 0.0)))
        return self._encoded(TWIST, self._header(stamp_ns), self._new("geometry_msgs/msg/Twist", linear, angular))

    def transform(self, stamp_ns: int, child: str, place_m: Triple, yaw_rad: float) -> bytes:
        """Return the transform from the frame to that of a vehicle as a TFMessage."""
        moved = self._new(
            "geometry_msgs/msg/Transform",
            self._new("geometry_msgs/msg/Vector3", *place_m),
            self._rotation(yaw_rad),
        )
        stamped = self._new("geometry_msgs/msg/TransformStamped", self._header(stamp_ns), child, moved)
        return self._encoded(TRANSFORMS, [stamped])

    def markers(self, stamp_ns: int, shapes: Sequence[Shape]) -> bytes:
        """Return shapes as a MarkerArray; a viewer removes one that is not repeated within a second."""
        return self._encoded(MARKERS, [self._marker(stamp_ns, each) for each in shapes])

    def decode(self, kind: str, payload: bytes) -> Any:
        """Return the message in bytes; raises MalformedError."""
        from rosbags.serde import SerdeError  # noqa: PLC0415

        try:
            return self.store.deserialize_cdr(payload, kind)
        except SerdeError as error:
            raise MalformedError(str(error)) from error

    def _encoded(self, kind: str, *fields: object) -> bytes:
        return bytes(self.store.serialize_cdr(self._new(kind, *fields), kind))

    def _new(self, kind: str, *fields: object) -> Any:
        return self._types[kind](*fields)

    def _header(self, stamp_ns: int) -> Any:
        stamp = self._new("builtin_interfaces/msg/Time", *divmod(min(max(stamp_ns, 0), _STAMP_MAX_NS - 1), _NS))
        return self._new("std_msgs/msg/Header", stamp, self._frame_id)

    def _pose(self, place_m: Triple, yaw_rad: float = 0.0) -> Any:
        return self._new(
            "geometry_msgs/msg/Pose", self._new("geometry_msgs/msg/Point", *place_m), self._rotation(yaw_rad)
        )

    def _rotation(self, yaw_rad: float) -> Any:
        return self._new("geometry_msgs/msg/Quaternion", 0.0, 0.0, sin(yaw_rad / 2.0), cos(yaw_rad / 2.0))

    def _marker(self, stamp_ns: int, shape: Shape) -> Any:
        red, green, blue = (byte / 255.0 for byte in bytes.fromhex(shape.colour.removeprefix("#")))
        none = np.zeros(0, np.uint8)
        image = self._new("sensor_msgs/msg/CompressedImage", self._header(0), "", none)
        width_m = shape.size_m
        return self._new(
            "visualization_msgs/msg/Marker",
            self._header(stamp_ns),
            shape.namespace,
            shape.number,
            _POINTS if shape.points_m else _SPHERE,
            0,  # add or modify
            self._pose(shape.place_m),
            self._new("geometry_msgs/msg/Vector3", width_m, width_m, width_m),
            self._new("std_msgs/msg/ColorRGBA", red, green, blue, 1.0),
            self._new("builtin_interfaces/msg/Duration", _LIFETIME_S, 0),
            False,
            [self._new("geometry_msgs/msg/Point", *each) for each in shape.points_m],
            [],
            "",
            image,
            [],
            "",
            "",
            self._new("visualization_msgs/msg/MeshFile", "", none),
            False,
        )
