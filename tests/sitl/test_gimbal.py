"""The stub's gimbal: who may point it, how fast and how far it turns, and that its report is where it looks."""

from math import degrees, inf, nan, pi, radians
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as dialect
from pymavlink.quaternion import Quaternion

from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from sitl.autopilot.px4 import Px4
from sitl.mavlink.reports import MavlinkConfig
from sitl.vehicle.mount import Mount
from tests.support.ground_station import GroundStation

SYSTEM_ID, CONFIGURE, REQUEST = 7, 1001, 512
INFORMATION, STATUS, DEVICE, ATTITUDE = 280, 281, 283, 285
YAW_LOCK, EARTH = 16, 64
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(30.0))
AXIS = PlantAxis(1.5, 1.9)


class Station(GroundStation):
    """The ground station of a PX4 stub with a gimbal."""

    def __init__(self, mount: Mount | None) -> None:
        super().__init__(Px4(Plant(AXIS, AXIS), mount=mount), MavlinkConfig(SYSTEM_ID, FRAME, (0.0, 0.0, 0.0)), dialect)

    def point(self, pitch_deg: float, heading_deg: float, flags: int = YAW_LOCK) -> None:
        """Send a direction; the quaternion is pymavlink's."""
        attitude = Quaternion([0.0, radians(pitch_deg), radians(heading_deg)]).q
        self.send(dialect.MAVLink_gimbal_manager_set_attitude_message(SYSTEM_ID, 1, flags, 1, attitude, nan, nan, nan))

    def request(self, message: int) -> Any:
        return next((m for m in self.command(REQUEST, message) if m.get_msgId() == message), None)

    def looks_deg(self) -> tuple[float, float]:
        """Pitch and heading that it reports, by pymavlink."""
        report = self.request(ATTITUDE)
        assert report.flags & EARTH
        roll, pitch, yaw = Quaternion(list(report.q)).euler
        assert roll == pytest.approx(0.0, abs=1e-6)
        return degrees(pitch), degrees(yaw)


def test_it_turns_at_a_bounded_rate_within_its_range_and_reports_where_it_looks() -> None:
    station = Station(Mount())
    station.run(1.0)
    station.command(CONFIGURE, -2, -2)
    station.point(-40.0, 170.0)
    station.run(1.0)
    assert station.looks_deg() == pytest.approx((-40.0, 90.0), abs=2.5), "90 degrees in a second"
    station.run(1.0)
    assert station.looks_deg() == pytest.approx((-40.0, 170.0), abs=1e-3)
    station.point(80.0, -170.0)
    station.run(1.0)
    assert station.looks_deg() == pytest.approx((20.0, -170.0), abs=1e-3), "the short way around"
    information = station.request(INFORMATION)
    assert (information.pitch_min, information.pitch_max) == pytest.approx((-pi / 2, radians(20.0)))
    assert station.request(DEVICE).yaw_max == inf


def test_only_who_has_control_points_it_and_its_status_names_that() -> None:
    station = Station(Mount())
    station.run(1.0)
    station.point(-40.0, 90.0)
    station.run(2.0)
    assert station.looks_deg() == pytest.approx((0.0, 0.0), abs=1e-3), "nobody has taken control"
    assert station.request(STATUS).primary_control_sysid == 0
    answers = station.command(CONFIGURE, 255, 190)
    assert [m.primary_control_sysid for m in answers if m.get_msgId() == STATUS] == [255], "it is told at once"
    station.point(-40.0, 90.0)
    station.run(2.0)
    assert station.looks_deg() == pytest.approx((0.0, 0.0), abs=1e-3), "another one has"
    station.command(CONFIGURE, -3, -3)
    assert station.request(STATUS).primary_control_sysid == 255, "only its own control is given back"
    station.command(CONFIGURE, -2, -2)
    station.point(-40.0, 90.0, flags=0)
    station.run(2.0)
    assert station.looks_deg() == pytest.approx((0.0, 0.0), abs=1e-3), "not a direction on earth"


def test_a_stub_without_a_gimbal_knows_none_of_it() -> None:
    station = Station(None)
    station.run(1.0)
    answers = station.command(CONFIGURE, -2, -2)
    assert [m.result for m in answers if m.get_type() == "COMMAND_ACK"] == [3]
    assert station.request(INFORMATION) is None
