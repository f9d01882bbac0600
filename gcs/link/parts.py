"""The MAVSDK objects of one connected vehicle."""

from math import degrees
from typing import Any, NamedTuple

from mavsdk.plugins.offboard import PositionNedYaw, VelocityNedYaw

from agents.ports import Setpoint
from estimation.frames import MissionFrame, Triple, wrap_signed_rad
from gcs.link.calls import VehicleCalls
from gcs.link.external_position import ExternalPositionSender
from gcs.link.feed import VehicleFeed


class LinkParts(NamedTuple):
    """The MAVSDK objects of a connected link."""

    system: Any
    feed: VehicleFeed
    calls: VehicleCalls
    action: Any
    offboard: Any
    external: ExternalPositionSender | None

    def send(self, setpoint: Setpoint, origin_m: Triple, frame: MissionFrame) -> Triple:
        """Send a setpoint to the vehicle in its own NED, whose origin is at `origin_m` in the mission frame.

        Returns its position in NED. Raises what MAVSDK raises.
        """
        x, y, z = setpoint.position_m
        x0, y0, z0 = origin_m
        heading_deg = degrees(wrap_signed_rad(frame.x_bearing_rad - setpoint.yaw_rad))
        ned_m = frame.ned_from_mission((x - x0, y - y0, z - z0))
        place = PositionNedYaw(*ned_m, heading_deg)
        if setpoint.velocity_m_s:
            x_rate, y_rate, climb = setpoint.velocity_m_s
            velocity = VelocityNedYaw(*frame.ned_from_mission((x_rate, y_rate, climb)), heading_deg)
            self.offboard.set_position_velocity_ned(place, velocity)
        else:
            self.offboard.set_position_ned(place)
        return ned_m

    def destroy(self) -> None:
        """Destroy MAVSDK's plugins; blocks until running callbacks have returned."""
        if self.external is not None:
            self.external.close()
        self.offboard.destroy()
        self.action.destroy()
        self.feed.close()
