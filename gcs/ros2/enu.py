"""The frame of ROS: metres about the mission's origin, x east, y north, z up (REP 103), yaw from east to north.

In a local frame north is that of the vehicles' NED.
"""

from math import pi

from estimation.frames import MissionFrame, Triple
from estimation.vectors import wrap_signed_rad

MAP = "map"
"""The name of the world-fixed frame (REP 105)."""


def enu_from_mission(frame: MissionFrame, mission: Triple) -> Triple:
    """Rotate the mission frame into east-north-up [m, m/s]."""
    north, east, down = frame.ned_from_mission(mission)
    return east, north, -down


def mission_from_enu(frame: MissionFrame, enu: Triple) -> Triple:
    """Rotate east-north-up into the mission frame; the inverse of `enu_from_mission`."""
    east, north, up = enu
    return frame.mission_from_ned((north, east, -up))


def yaw_enu_rad(frame: MissionFrame, yaw_rad: float) -> float:
    """Return a yaw from the mission's x axis as one from east, in [-pi, pi]."""
    return wrap_signed_rad(yaw_rad + pi / 2.0 - frame.x_bearing_rad)


def covariance_in_mission(frame: MissionFrame, covariance_m2: tuple[float, float, float]) -> tuple[float, float, float]:
    """Rotate a covariance (ee, en, nn) into the mission's axes (xx, xy, yy)."""
    ee, en, nn = covariance_m2
    (xe, ye, _), (xn, yn, _) = (mission_from_enu(frame, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    return (
        xe * xe * ee + 2.0 * xe * xn * en + xn * xn * nn,
        xe * ye * ee + (xe * yn + xn * ye) * en + xn * yn * nn,
        ye * ye * ee + 2.0 * ye * yn * en + yn * yn * nn,
    )
