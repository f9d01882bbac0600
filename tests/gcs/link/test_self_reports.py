"""What autopilots report in words and numbers of their own, as facts of the vehicle's status."""

import json
from math import acos, degrees
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mavsdk.autopilot import Autopilot
from mavsdk.plugins.telemetry import FixType
from msgspec.structs import replace

from agents.ports import Connection, FlightMode, GpsThreat, ModeSource, VehicleStatus
from agents.safety.failsafe import STATUS_STALE_S
from gcs.link import self_reports
from gcs.link.self_reports import (
    BATTERY,
    CHANGES_WITHIN_S,
    LOST_S,
    WIND_S,
    EstimatorReport,
    SelfReports,
    estimator_facts,
    is_explained,
    tilt_deg,
)

SYSTEM = 4


class Subscriptions:
    """Stands for MAVSDK's plugins: keeps what is subscribed to."""

    def __init__(self, _system: object = None) -> None:
        self.taken: dict[str, Any] = {}

    def subscribe_message(self, name: str, take: Any) -> None:
        self.taken[name] = take

    def __getattr__(self, name: str) -> Any:
        return lambda take: self.taken.__setitem__(name.removeprefix("subscribe_"), take)


class Reports:
    def __init__(self, monkeypatch: pytest.MonkeyPatch, autopilot: Autopilot = Autopilot.PX4) -> None:
        monkeypatch.setattr(self_reports, "MavlinkDirect", Subscriptions)
        system = SimpleNamespace(autopilot_type=lambda: autopilot, get_system_id=lambda: SYSTEM)
        self.status: dict[str, object] = {}
        self.now_s = 0.0
        self.reports = SelfReports(system, self.status.update, lambda: self.now_s)
        self.telemetry = Subscriptions()
        self.reports.subscribe(self.telemetry, lambda take: take, gps=True)

    def wait(self, duration_s: float) -> None:
        self.now_s += duration_s
        self.reports.expire()

    def receive(self, message: str, system_id: int, component_id: int = 1, **fields: object) -> None:
        received = SimpleNamespace(system_id=system_id, component_id=component_id, fields_json=json.dumps(fields))
        self.reports.direct.taken[message](received)


TEXTS = {
    # PX4 1.13 to 1.17, ArduCopter 4.3 to 4.7.
    "Connection to ground control station lost": Connection.GROUND_STATION,
    "GCS Failsafe": Connection.GROUND_STATION,
    "Manual control lost": Connection.REMOTE_CONTROL,
    "Radio Failsafe - Continuing Guided Mode": Connection.REMOTE_CONTROL,
    "GCS connection regained": None,
    "GCS Failsafe Cleared": None,
    "Failsafe activated": None,
    "Connection to mission computer lost": None,
}
THREATS = {
    "GNSS signal spoofed": GpsThreat.SPOOFED,
    "GPS signal jammed": GpsThreat.JAMMED,
    "GPS 1: detected as u-blox": None,
}


async def test_texts_name_the_lost_connection_and_the_threat(
    monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    for text, expected in {**TEXTS, **THREATS}.items():
        with subtests.test(text=text):
            flight = Reports(monkeypatch)
            flight.reports.take_text(text)
            assert list(flight.status.values()) == ([] if expected is None else [expected])


def test_what_a_text_reported_ends_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Reports(monkeypatch)
    for _ in range(2):
        flight.reports.take_text("GCS Failsafe")
        flight.wait(0.6 * LOST_S)
    assert flight.status == {"lost": Connection.GROUND_STATION}
    flight.wait(0.5 * LOST_S)
    assert flight.status == {"lost": Connection.NONE}


def test_a_report_that_stops_is_named_and_its_values_are_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Reports(monkeypatch)
    flight.wait(2.0 * STATUS_STALE_S)
    assert flight.status == {}, "what was never reported is not missed"
    for _ in range(3):
        flight.reports.take_repeated(BATTERY, battery=0.8, endurance_s=600.0)
        flight.telemetry.taken["gps_info"](SimpleNamespace(fix_type=FixType.FIX_3D, num_satellites=14))
        flight.wait(0.6 * STATUS_STALE_S)
    assert "stale" not in flight.status
    flight.telemetry.taken["gps_info"](SimpleNamespace(fix_type=FixType.FIX_3D, num_satellites=14))
    flight.wait(0.6 * STATUS_STALE_S)
    assert flight.status == {
        "battery": None,
        "endurance_s": None,
        "gps_dimensions": 3,
        "satellites": 14,
        "stale": "battery",
    }
    flight.wait(0.6 * STATUS_STALE_S)
    assert flight.status["stale"] == "GPS, battery"
    assert flight.status["satellites"] is None
    flight.reports.take_repeated(BATTERY, battery=0.7, endurance_s=None)
    assert (flight.status["battery"], flight.status["stale"]) == (0.7, "GPS")


async def test_a_remote_control_is_lost_only_where_there_was_one(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Reports(monkeypatch)
    take = flight.telemetry.taken["rc_status"]
    take(SimpleNamespace(is_available=False))
    assert flight.status == {}
    take(SimpleNamespace(is_available=True))
    take(SimpleNamespace(is_available=False))
    assert flight.status == {"lost": Connection.REMOTE_CONTROL}


ACCEPTED, DENIED = 0, 2
SET_MODE, SET_INTERVAL = 176, 511


def test_pilot_and_station_changed_the_mode_only_if_that_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Reports(monkeypatch)

    def acknowledge(command: int, result: int, station: int) -> None:
        flight.receive("COMMAND_ACK", SYSTEM, command=command, result=result, target_system=station)

    acknowledge(SET_MODE, ACCEPTED, 255)
    assert flight.reports.mode_changed() is ModeSource.STATION
    for command, result, station in ((SET_MODE, ACCEPTED, 245), (SET_MODE, DENIED, 255), (SET_INTERVAL, ACCEPTED, 255)):
        flight.wait(2.0 * CHANGES_WITHIN_S)
        acknowledge(command, result, station)
        assert flight.reports.mode_changed() is ModeSource.UNKNOWN
    flight.reports.take_text("Pilot took over using sticks")  # after the heartbeat that shows it
    assert flight.status["mode_by"] is ModeSource.PILOT
    flight.wait(2.0 * CHANGES_WITHIN_S)
    assert flight.reports.mode_changed() is ModeSource.UNKNOWN, "that was about another change"


async def test_the_estimator_counts_with_its_own_system_id_and_dialect(monkeypatch: pytest.MonkeyPatch) -> None:
    copter = Reports(monkeypatch, Autopilot.ARDUPILOT)
    copter.receive("EKF_STATUS_REPORT", SYSTEM + 1, flags=0x33F, compass_variance=3.0)
    copter.reports.direct.taken["EKF_STATUS_REPORT"](SimpleNamespace(system_id=SYSTEM, fields_json="{"))
    assert copter.status == {}
    copter.receive("EKF_STATUS_REPORT", SYSTEM, flags=0x33F, pos_horiz_variance=0.46, velocity_variance=0.1)
    expected = {"estimator_ratio": 0.5, "estimator_sensor": "horizontal position", "estimator_fault": ""}
    assert copter.status == expected
    px4 = Reports(monkeypatch)
    px4.receive("ESTIMATOR_STATUS", SYSTEM, flags=32, vel_ratio=None)
    expected = {
        "estimator_ratio": None,
        "estimator_sensor": "",
        "estimator_fault": "no attitude, no horizontal position",
    }
    assert px4.status == expected
    px4.wait(2.0 * STATUS_STALE_S)
    assert px4.status == expected | {"stale": "estimator"}, "its fault is not over"


def test_the_wind_is_that_of_each_autopilots_own_message_and_expires(monkeypatch: pytest.MonkeyPatch) -> None:
    px4, copter = Reports(monkeypatch), Reports(monkeypatch, Autopilot.ARDUPILOT)
    px4.receive("WIND_COV", SYSTEM + 1, wind_x=9.0, wind_y=0.0)
    px4.receive("WIND_COV", SYSTEM, wind_x=9.0, wind_y=None)
    px4.receive("WIND_COV", SYSTEM, wind_x=9.0)
    assert px4.status == {}
    px4.receive("WIND_COV", SYSTEM, wind_x=-9.0, wind_y=12.04, wind_z=100.0)
    copter.receive("WIND", SYSTEM, direction=200.0, speed=7.26, speed_z=-3.0)
    assert (px4.status, copter.status) == ({"wind_m_s": 15.0}, {"wind_m_s": 7.3})
    for each in (px4, copter):
        each.wait(1.1 * WIND_S)
    assert (px4.status, copter.status) == ({"wind_m_s": None}, {"wind_m_s": None})


def test_a_rejected_sensor_is_not_hidden_by_a_worse_compass() -> None:
    def worst(**ratios: float) -> object:
        return estimator_facts(EstimatorReport(ratios, relative=True, absolute=True))["estimator_sensor"]

    assert worst(height=1.2, compass=3.0) == "height"
    assert worst(height=0.8, compass=3.0) == "compass"
    assert worst(height=0.8, velocity=0.9) == "velocity"


async def test_satellites_and_the_dimensions_of_the_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Reports(monkeypatch)
    for fix, dimensions in ((FixType.NO_FIX, 0), (FixType.FIX_2D, 2), (FixType.FIX_3D, 3), (FixType.RTK_FIXED, 3)):
        flight.telemetry.taken["gps_info"](SimpleNamespace(fix_type=fix, num_satellites=7))
        assert flight.status == {"gps_dimensions": dimensions, "satellites": 7}
    flight.telemetry.taken["gps_info"](SimpleNamespace(fix_type=FixType.FIX_3D, num_satellites=255))
    assert flight.status["satellites"] is None


def test_the_tilt_is_the_angle_between_the_rotated_axis_and_the_vertical() -> None:
    for roll_deg, pitch_deg in ((0.0, 0.0), (30.0, 0.0), (0.0, -35.0), (25.0, 25.0), (180.0, 0.0)):
        roll, pitch = np.radians((roll_deg, pitch_deg))
        about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        upright = float((about_y @ about_x)[2, 2])
        assert tilt_deg(roll_deg, pitch_deg) == round(degrees(acos(upright)))


LEFT_OFFBOARD = VehicleStatus(mode=FlightMode.LAND, mode_by=ModeSource.FAILSAFE, battery=0.8, gps_dimensions=3)


@pytest.mark.parametrize(
    "changes",
    [
        {"mode_by": ModeSource.PILOT},
        {"lost": Connection.REMOTE_CONTROL},
        {"mode": FlightMode.RETURN},
        {"gps_dimensions": 2},
        {"battery": 0.15},
        {"estimator_fault": "no horizontal position"},
        {"battery_fault": "battery 0 critical"},
    ],
)
def test_another_cause_than_lost_setpoints_explains_a_change_of_mode(changes: dict[str, Any]) -> None:
    assert is_explained(replace(LEFT_OFFBOARD, **changes), [])


def test_a_failsafe_without_a_cause_is_left_to_lost_setpoints() -> None:
    assert not is_explained(LEFT_OFFBOARD, ["Failsafe activated"])
    assert not is_explained(replace(LEFT_OFFBOARD, battery=None, gps_dimensions=None), [])
    assert is_explained(LEFT_OFFBOARD, ["Fence breached"])
