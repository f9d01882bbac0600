"""The gimbal manager of a stub: MAVLink's gimbal protocol v2, with one mount, for the system that has taken control."""

from collections.abc import Callable, Mapping
from math import asin, atan2, cos, inf, isfinite, nan, pi, sin
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.mavlink_constants import Fields, MessageId, Result
from sitl.vehicle.mount import ELEVATION_MAX_RAD, ELEVATION_MIN_RAD, Mount

DEVICE = 1
"""The gimbal device's id: the first of those without a component of their own."""
NOBODY = (0, 0)
_KEEP, _SENDER, _RELEASE = -1, -2, -3
"""What DO_GIMBAL_MANAGER_CONFIGURE may say in place of a system's id."""
_CAPABILITIES = (
    mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_LOCK
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_LOCK
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_SUPPORTS_INFINITE_YAW
)
_LOCKED = mavlink.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | mavlink.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
_YAW_LOCK = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK


class GimbalManager:
    """The manager of one mount: who controls it, and its messages; `boot_ms` returns the time since boot."""

    def __init__(self, mount: Mount, boot_ms: Callable[[], int]) -> None:
        self.mount = mount
        self.controller = NOBODY
        self._boot_ms = boot_ms

    @property
    def builders(self) -> Mapping[int, Callable[[], Fields]]:
        """What makes the fields of its messages, by their ids."""
        return {
            MessageId.GIMBAL_MANAGER_INFORMATION: self._information,
            MessageId.GIMBAL_MANAGER_STATUS: self._status,
            MessageId.GIMBAL_DEVICE_INFORMATION: self._device,
            MessageId.GIMBAL_DEVICE_ATTITUDE_STATUS: self._attitude,
        }

    def configure(self, params: tuple[float, ...], sender: tuple[int, int]) -> Result:
        """Give control to a system, or take it away from the sender."""
        system, component = params[:2]
        if system == _SENDER:
            self.controller = sender
        elif system == _RELEASE:
            self.controller = NOBODY if self.controller == sender else self.controller
        elif system != _KEEP:
            if not (0 <= system <= 255 and 0 <= component <= 255):
                return Result.DENIED
            self.controller = int(system), int(component)
        return Result.ACCEPTED

    def point(self, message: Any, sender: tuple[int, int]) -> bool:
        """Turn to the attitude in GIMBAL_MANAGER_SET_ATTITUDE; return whether it was taken.

        It is not if somebody else is in control, or if its yaw follows the vehicle's nose, which cordon never asks for.
        """
        w, x, y, z = message.q
        locked = bool(message.flags & _YAW_LOCK)
        if sender != self.controller or not locked or not all(map(isfinite, (w, x, y, z))):
            return False
        elevation_rad = asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
        self.mount.point(elevation_rad, atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
        return True

    def _information(self) -> Fields:
        return (self._boot_ms(), _CAPABILITIES, DEVICE, 0.0, 0.0, ELEVATION_MIN_RAD, ELEVATION_MAX_RAD, -pi, pi)

    def _status(self) -> Fields:
        return self._boot_ms(), _LOCKED | _YAW_LOCK, DEVICE, *self.controller, *NOBODY

    def _device(self) -> Fields:
        named = b"cordon", b"stub", b""
        ranges = (0.0, 0.0, ELEVATION_MIN_RAD, ELEVATION_MAX_RAD, -inf, inf)
        return self._boot_ms(), *named, 0, 0, 0, _CAPABILITIES & 0xFFFF, 0, *ranges, DEVICE

    def _attitude(self) -> Fields:
        pitch, yaw = self.mount.elevation_rad / 2.0, self.mount.heading_rad / 2.0
        quaternion = (cos(pitch) * cos(yaw), -sin(pitch) * sin(yaw), sin(pitch) * cos(yaw), cos(pitch) * sin(yaw))
        flags = _LOCKED | _YAW_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
        return 0, 0, self._boot_ms(), flags, quaternion, nan, nan, nan, 0, nan, nan, DEVICE
