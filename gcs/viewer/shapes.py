"""Foxglove primitives of the scene, and their geometry."""

from collections.abc import Iterable
from math import atan2, cos, hypot, log, sin, sqrt, tau

from foxglove.messages import (
    ArrowPrimitive,
    Color,
    CylinderPrimitive,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from agents.ring.heights import inclined_m
from agents.settings.sections import EncirclementSettings
from estimation.frames import Triple
from estimation.polar import Polar

CIRCLE_POINTS = 72
ELLIPSE_SHARE = 0.95
"""Probability within an uncertainty ellipse."""
ELLIPSE_HEIGHT_M = 0.1
LINE_PX, LABEL_PX = 2.0, 16.0


def colour(hexadecimal: str, alpha: float = 1.0) -> Color:
    """Return a colour written as `#RRGGBB`."""
    red, green, blue = (byte / 255.0 for byte in bytes.fromhex(hexadecimal.removeprefix("#")))
    return Color(r=red, g=green, b=blue, a=alpha)


def timestamp(time_ns: int) -> Timestamp:
    """Return a time stamp [ns]."""
    return Timestamp(*divmod(time_ns, 1_000_000_000))


def rotation(yaw_rad: float) -> Quaternion:
    """Return a rotation about z, counter-clockwise seen from above."""
    return Quaternion(x=0.0, y=0.0, z=sin(yaw_rad / 2.0), w=cos(yaw_rad / 2.0))


def pose(place_m: Triple, yaw_rad: float = 0.0) -> Pose:
    """Return a level pose."""
    x, y, z = place_m
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=rotation(yaw_rad))


def circle(radius_m: float, points: int = CIRCLE_POINTS) -> list[Triple]:
    """Return points on a level circle about the origin."""
    turns = (tau * k / points for k in range(points))
    return [(radius_m * cos(turn), radius_m * sin(turn), 0.0) for turn in turns]


def ring_outline(ring: EncirclementSettings) -> list[Triple]:
    """Return points on a ring about the origin."""
    level = circle(ring.radius_m)
    polars = [Polar(ring.radius_m, atan2(y, x), 0.0, 0.0) for x, y, _ in level]
    return [(x, y, inclined_m(ring, at)[0]) for (x, y, _), at in zip(level, polars, strict=True)]


def ellipse(covariance: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the two half axes [m], the longer first, and its direction [rad], within which ELLIPSE_SHARE of a normal
    distribution lies; `covariance` is (xx, xy, yy) [m²].
    """
    xx, xy, yy = covariance
    middle, reach = (xx + yy) / 2.0, hypot((xx - yy) / 2.0, xy)
    scale = -2.0 * log(1.0 - ELLIPSE_SHARE)
    half_axes = (sqrt(max(scale * variance, 0.0)) for variance in (middle + reach, middle - reach))
    return *half_axes, atan2(2.0 * xy, xx - yy) / 2.0  # type: ignore[return-value]  # two of them


def line(points: Iterable[Point3], color: Color, at_m: Triple = (0.0, 0.0, 0.0), *, closed: bool) -> LinePrimitive:
    """Return a line through points relative to a position, of constant width on the screen."""
    kind = LinePrimitiveLineType.LineLoop if closed else LinePrimitiveLineType.LineStrip
    return LinePrimitive(
        type=kind, pose=pose(at_m), thickness=LINE_PX, scale_invariant=True, points=list(points), color=color
    )


def arrow(at_m: Triple, yaw_rad: float, color: Color) -> ArrowPrimitive:
    """Return an arrow of the size of a vehicle."""
    return ArrowPrimitive(
        pose=pose(at_m, yaw_rad),
        shaft_length=0.6,
        shaft_diameter=0.25,
        head_length=0.5,
        head_diameter=0.6,
        color=color,
    )


def label(text: str, at_m: Triple, color: Color) -> TextPrimitive:
    """Return text above a position that faces the viewer."""
    x, y, z = at_m
    return TextPrimitive(
        pose=pose((x, y, z + 1.0)), billboard=True, font_size=LABEL_PX, scale_invariant=True, color=color, text=text
    )


def ball(at_m: Triple, diameter_m: float, color: Color) -> SpherePrimitive:
    """Return a sphere."""
    return SpherePrimitive(pose=pose(at_m), size=Vector3(x=diameter_m, y=diameter_m, z=diameter_m), color=color)


def disc(
    at_m: Triple, axes_m: tuple[float, float], height_m: float, color: Color, yaw_rad: float = 0.0
) -> CylinderPrimitive:
    """Return an upright cylinder about a position, elliptic if its axes (full lengths) differ."""
    along, across = axes_m
    size = Vector3(x=along, y=across, z=height_m)
    return CylinderPrimitive(pose=pose(at_m, yaw_rad), size=size, bottom_scale=1.0, top_scale=1.0, color=color)
