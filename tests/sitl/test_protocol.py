"""The stub's MAVLink side: bytes in, bytes out, without sockets; pymavlink plays the client."""

import struct
from collections import Counter
from dataclasses import replace
from math import degrees, inf, nan, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from estimation.frames import Geodetic, MissionFrame, Triple
from estimation.plant.model import Plant, PlantAxis
from sitl.autopilot.autopilot import GPS_POSITIONING, Positioning
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.modes import NavMode
from sitl.autopilot.px4 import Px4, custom_mode
from sitl.faults import VehicleFaults
from sitl.mavlink.protocol import Drop
from sitl.mavlink.reports import HOME_CORRECTED_M, EstimatorNoise, MavlinkConfig
from tests.support.ground_station import GroundStation

PLANT = Plant(PlantAxis(1.51, 1.90), PlantAxis(1.87, 2.40), delay_s=0.2)
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(30.0))
START: Triple = (20.0, -5.0, 1.5)
ORIGIN: Triple = (20.3, -5.4, 1.6)
SYSTEM_ID = 7
NOISELESS = EstimatorNoise()


class Client(GroundStation):
    """The ground station of a PX4 stub."""

    def __init__(
        self,
        noise: EstimatorNoise = NOISELESS,
        seed: int = 0,
        faults: VehicleFaults | None = None,
        plant: Plant = PLANT,
        positioning: Positioning = GPS_POSITIONING,
    ) -> None:
        self.autopilot = Px4(plant, START, positioning=positioning)
        super().__init__(self.autopilot, MavlinkConfig(SYSTEM_ID, FRAME, ORIGIN, noise, seed), dialect, faults)

    def setpoint(self, x: float, y: float, z: float, **changes: Any) -> list[Any]:
        fields = {
            "time_boot_ms": 0, "target_system": SYSTEM_ID, "target_component": 1, "coordinate_frame": 1,
            "type_mask": 0b100111111000, "x": x, "y": y, "z": z, "vx": 0.0, "vy": 0.0, "vz": 0.0,
            "afx": 0.0, "afy": 0.0, "afz": 0.0, "yaw": 0.0, "yaw_rate": 0.0,
        }  # fmt: skip
        return self.send(dialect.MAVLink_set_position_target_local_ned_message(**(fields | changes)))


@pytest.fixture
def client() -> Client:
    made = Client()
    made.run(3.0)
    return made


def fly(client: Client) -> None:
    """Take off to 5 m and hover."""
    assert results(client.send(param_set("MIS_TAKEOFF_ALT", 5.0, 9))) == []
    assert results(client.command(400, 1)) == [0]
    assert results(client.command(22, 0, 0, 0, nan, nan, nan, nan)) == [0]
    client.run(25.0)


def follow(client: Client, x: float, y: float, z: float, seconds: float, yaw: float = 0.0) -> list[Any]:
    """Fly in offboard towards a place in local NED; return everything sent meanwhile."""
    client.setpoint(x, y, z, yaw=yaw)
    assert results(client.command(176, 1, 6)) == [0, 0]
    messages: list[Any] = []
    for _ in range(round(seconds / 0.04)):
        client.setpoint(x, y, z, yaw=yaw)
        messages += client.run(0.04)
    return messages


def results(messages: list[Any]) -> list[int]:
    return [message.result for message in messages if message.get_type() == "COMMAND_ACK"]


def only(messages: list[Any], kind: str) -> Any:
    found = [message for message in messages if message.get_type() == kind]
    assert len(found) == 1, (kind, messages)
    return found[0]


def last(messages: list[Any], kind: str) -> Any:
    return [message for message in messages if message.get_type() == kind][-1]


def param_set(name: str, value: float, kind: int) -> Any:
    return dialect.MAVLink_param_set_message(SYSTEM_ID, 1, name.encode(), value, kind)


# Telemetry


def test_before_the_estimator_is_ready_no_position_is_sent() -> None:
    messages = Client().run(1.9)
    kinds = {message.get_type() for message in messages}
    assert not kinds & {"LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "HOME_POSITION"}
    status = last(messages, "SYS_STATUS")
    assert not status.onboard_control_sensors_health & (
        dialect.MAV_SYS_STATUS_SENSOR_GPS | dialect.MAV_SYS_STATUS_PREARM_CHECK
    )
    assert last(messages, "GPS_RAW_INT").fix_type == dialect.GPS_FIX_TYPE_NO_FIX


def test_a_vehicle_north_of_its_origin_says_so_in_every_message(client: Client) -> None:
    """The truth here is worked out on a sphere of the local radii of curvature: no projection library."""
    fly(client)
    messages = follow(client, 30.0, -12.0, -5.0, seconds=12.0, yaw=radians(90.0))
    local = last(messages, "LOCAL_POSITION_NED")
    assert (local.x, local.y, local.z) == pytest.approx((30.0, -12.0, -5.0), abs=0.02)
    place, origin = last(messages, "GLOBAL_POSITION_INT"), only(client.command(512, 49), "GPS_GLOBAL_ORIGIN")
    assert FRAME.origin is not None
    latitude = radians(FRAME.origin.latitude_deg)
    curvature = 1.0 - 6.69437999014e-3 * np.sin(latitude) ** 2
    meridian_m = 6378137.0 * (1.0 - 6.69437999014e-3) / curvature**1.5 + 488.0
    parallel_m = (6378137.0 / curvature**0.5 + 488.0) * np.cos(latitude)
    assert radians((place.lat - origin.latitude) / 1e7) * meridian_m == pytest.approx(30.0, abs=0.04)
    assert radians((place.lon - origin.longitude) / 1e7) * parallel_m == pytest.approx(-12.0, abs=0.04)
    assert place.alt - origin.altitude == pytest.approx(5000, abs=20)
    assert place.relative_alt == pytest.approx(5100, abs=20)  # home is 0.1 m below the origin
    assert place.hdg == pytest.approx(9000, abs=5)
    assert last(messages, "ATTITUDE").yaw == pytest.approx(radians(90.0), abs=1e-3)
    home = last(client.command(512, 242), "HOME_POSITION")
    dx, dy = START[0] - ORIGIN[0], START[1] - ORIGIN[1]
    cosine, sine = np.cos(FRAME.x_bearing_rad), np.sin(FRAME.x_bearing_rad)
    north, east = dx * cosine + dy * sine, dx * sine - dy * cosine
    assert (home.x, home.y) == pytest.approx((north, east), abs=1e-5)
    assert home.z == pytest.approx(0.1, abs=HOME_CORRECTED_M)


def test_velocity_and_tilt_point_where_the_vehicle_goes(client: Client) -> None:
    fly(client)
    messages = follow(client, 10.0, 0.0, -5.0, seconds=0.6)
    local, place = last(messages, "LOCAL_POSITION_NED"), last(messages, "GLOBAL_POSITION_INT")
    assert local.vx > 2.0
    assert abs(local.vy) < 0.35 * local.vx  # the two axes of the plant differ
    assert place.vx == pytest.approx(local.vx * 100.0, abs=40)
    assert last(messages, "ATTITUDE").pitch < -0.05
    assert last(messages, "ATTITUDE").time_boot_ms == pytest.approx(client.autopilot.time_s * 1000, abs=1)


def test_a_speed_beyond_the_field_is_sent_as_its_maximum(client: Client) -> None:
    fly(client)
    messages = follow(client, 50e3, 0.0, -5.0, seconds=0.6)
    assert last(messages, "LOCAL_POSITION_NED").vx > 400.0
    assert last(messages, "GLOBAL_POSITION_INT").vx == 32767


def test_noise_is_as_stated_repeatable_and_the_same_in_all_messages_of_a_time() -> None:
    noise = EstimatorNoise(position_m=0.5, velocity_m_s=0.1)
    first, again = Client(noise, seed=3), Client(noise, seed=3)
    sent, sent_again = first.run(60.0), again.run(5.0)
    local = [m for m in sent if m.get_type() == "LOCAL_POSITION_NED"]
    repeated = [m.x for m in sent_again if m.get_type() == "LOCAL_POSITION_NED"]
    assert [m.x for m in local][: len(repeated)] == repeated
    assert np.std([m.x for m in local]) == pytest.approx(0.5, rel=0.1)
    assert np.std([m.vz for m in local]) == pytest.approx(0.1, rel=0.1)
    heights = {m.time_boot_ms: m.alt for m in sent if m.get_type() == "GLOBAL_POSITION_INT"}
    for m in local:
        assert heights[m.time_boot_ms] == pytest.approx(488000.0 - m.z * 1000.0 + 1600.0, abs=2.0)


def test_the_truth_is_told_on_request_without_the_estimates_errors() -> None:
    """As PX4's simulator does it; what the estimate is off is in the local position alone."""
    client = Client(EstimatorNoise(position_m=0.5), faults=VehicleFaults(estimate_offset_m=(3.0, 0.0, 0.0)))
    client.run(3.0)
    assert client.command(512, 115)[0].result == 0
    truth = client.command(512, 115)[1]
    assert truth.get_type() == "HIL_STATE_QUATERNION"
    place = FRAME.mission_from_geodetic(Geodetic(truth.lat / 1e7, truth.lon / 1e7, truth.alt / 1e3))
    assert place == pytest.approx(START, abs=0.02)
    assert (truth.vx, truth.vy, truth.vz) == (0, 0, 0)
    assert "HIL_STATE_QUATERNION" not in {each.get_type() for each in client.run(2.0)}
    assert client.command(512, 108)[0].result != 0


# Commands


def test_take_off_to_an_altitude_above_the_datum(client: Client) -> None:
    client.command(400, 1)
    assert results(client.command(22, 0, 0, 0, 0, 0, 0, 1e9)) == [2]
    assert results(client.command(22, 0, 0, 0, 0, 0, 0, 488.0 + 3.0)) == [0]
    client.run(20.0)
    assert client.autopilot.airframe.position_m[2] == pytest.approx(3.0, abs=0.01)


def test_the_interval_of_a_message_is_told(client: Client) -> None:
    assert results(client.command(511, 30, -1)) == [0]
    assert only(client.command(510, 30), "MESSAGE_INTERVAL").interval_us == -1
    assert results(client.command(511, 32, nan)) == [4]
    assert results(client.command(510, 9999)) == [2]


def test_commands_as_integers(client: Client) -> None:
    message = dialect.MAVLink_command_int_message(SYSTEM_ID, 1, 0, 400, 0, 0, 1.0, 0.0, 0.0, 0.0, 0, 0, 0.0)
    ack = only(client.send(message), "COMMAND_ACK")
    assert (ack.command, ack.result, ack.target_system, ack.target_component) == (400, 0, 245, 190)
    assert client.autopilot.armed
    assert results(client.command(400, 2)) == [2]


# Parameters


def test_parameters_integers_bytewise(client: Client) -> None:
    as_bytes = struct.unpack("<f", struct.pack("<i", -4))[0]
    answer = only(client.send(param_set("COM_OBL_RC_ACT", as_bytes, 6)), "PARAM_VALUE")
    assert struct.unpack("<i", struct.pack("<f", answer.param_value))[0] == -4
    assert answer.param_type == 6
    assert client.autopilot.parameters["COM_OBL_RC_ACT"] == -4
    read = dialect.MAVLink_param_request_read_message(SYSTEM_ID, 1, b"COM_OF_LOSS_T", -1)
    assert only(client.send(read), "PARAM_VALUE").param_value == 1.0
    by_index = dialect.MAVLink_param_request_read_message(SYSTEM_ID, 1, b"", answer.param_index)
    assert only(client.send(by_index), "PARAM_VALUE").param_id == "COM_OBL_RC_ACT"


def test_a_parameter_that_cannot_be_is_counted_and_one_that_is_no_number_answered_with_the_old_value(
    client: Client,
) -> None:
    assert only(client.send(param_set("COM_OF_LOSS_T", nan, 9)), "PARAM_VALUE").param_value == 1.0
    assert client.send(param_set("NO_SUCH", 1.0, 9)) == client.send(param_set("COM_OF_LOSS_T", 0.0, 6)) == []
    assert client.vehicle.dropped[Drop.PARAMETER] == 3


def test_a_text_too_long_for_a_message_comes_in_chunks(client: Client) -> None:
    client.command(176, 1, 4, 5)
    client.command(400, 1)
    client.command(400, 1)
    texts = [message for message in client.run(0.1) if message.get_type() == "STATUSTEXT"]
    assert [(each.text, each.id, each.chunk_seq) for each in texts] == [
        ("Arming denied: Resolve system health failures firs", 1, 0), ("t", 1, 1),
        ("Arming denied: Resolve system health failures firs", 2, 0), ("t", 2, 1),
    ]  # fmt: skip
    client.command(176, 1, 4, 3)
    client.command(400, 1)
    (armed,) = [message for message in client.run(0.1) if message.get_type() == "STATUSTEXT"]
    assert (armed.text, armed.id, armed.chunk_seq) == ("Armed by external command", 0, 0)


def test_the_heartbeat_stands_by_only_where_it_could_be_armed(client: Client) -> None:
    states = [last(client.run(1.1), "HEARTBEAT").system_status]
    client.command(176, 1, 4, 5)
    states.append(last(client.run(1.1), "HEARTBEAT").system_status)
    client.command(176, 1, 4, 3)
    client.command(400, 1)
    states.append(last(client.run(1.1), "HEARTBEAT").system_status)
    assert states == [dialect.MAV_STATE_STANDBY, dialect.MAV_STATE_UNINIT, dialect.MAV_STATE_ACTIVE]


# Without GPS


GPS_BIT, POSITION_BIT = dialect.MAV_SYS_STATUS_SENSOR_GPS, dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL


def test_without_gps_it_knows_its_local_position_and_nothing_of_the_globe() -> None:
    indoors = Client(positioning=Positioning(gps=False))
    messages = indoors.run(6.0)
    kinds = {message.get_type() for message in messages}
    assert "LOCAL_POSITION_NED" in kinds
    assert not kinds & {"GLOBAL_POSITION_INT", "HOME_POSITION"}
    assert last(messages, "GPS_RAW_INT").fix_type == dialect.GPS_FIX_TYPE_NO_FIX
    status = last(messages, "SYS_STATUS")
    assert not status.onboard_control_sensors_present & GPS_BIT
    assert status.onboard_control_sensors_health & POSITION_BIT
    assert [m.get_type() for m in indoors.command(512, 49)] == ["COMMAND_ACK"]
    assert [m.get_type() for m in indoors.command(512, 242)] == ["COMMAND_ACK"]
    assert only(indoors.command(512, 230), "ESTIMATOR_STATUS").flags == 303


def test_not_localised_it_sends_no_position_and_stays_disarmed() -> None:
    lost = Client(positioning=Positioning(localised=False))
    messages = lost.run(6.0)
    kinds = {message.get_type() for message in messages}
    assert not kinds & {"LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "HOME_POSITION"}
    status = last(messages, "SYS_STATUS")
    assert status.onboard_control_sensors_present & GPS_BIT
    assert not status.onboard_control_sensors_health & (GPS_BIT | POSITION_BIT)
    assert results(lost.command(400, 1)) == [1]
    assert only(lost.command(512, 230), "ESTIMATOR_STATUS").flags == 165


def test_the_estimators_report_comes_when_asked_for_and_follows_its_noise() -> None:
    calm, noisy = Client(), Client(EstimatorNoise(position_m=0.5, velocity_m_s=0.3))
    told = []
    for client in (calm, noisy):
        assert "ESTIMATOR_STATUS" not in {message.get_type() for message in client.run(3.0)}
        only(client.command(512, 230), "ESTIMATOR_STATUS")
        client.command(511, 230, 20_000.0)
        told.append([message for message in client.run(20.0) if message.get_type() == "ESTIMATOR_STATUS"])
    exact, shaken = told
    assert len(exact) == pytest.approx(1000, abs=2)
    assert {(m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.flags) for m in exact} == {(0.0, 0.0, 0.0, 831)}
    # Errors of one standard deviation on each axis, and gates of five of them.
    means = [np.mean([getattr(m, name) for m in shaken]) for name in ("vel_ratio", "pos_horiz_ratio", "pos_vert_ratio")]
    assert means == pytest.approx([3 / 25, 2 / 25, 1 / 25], rel=0.2)
    assert results(calm.command(512, 193)) == [2], "that is ArduPilot's"


def test_the_parameter_list_is_complete(client: Client) -> None:
    client.send(dialect.MAVLink_param_request_list_message(SYSTEM_ID, 1))
    values = [message for message in client.run(2.0) if message.get_type() == "PARAM_VALUE"]
    assert [value.param_index for value in values] == list(range(values[0].param_count))
    assert {value.param_id for value in values} == set(client.autopilot.parameters.names)


# Plans


def item(seq: int, plan_type: int = 1) -> Any:
    return dialect.MAVLink_mission_item_int_message(
        SYSTEM_ID, 1, seq, 0, 5001, 0, 1, 3.0, 0.0, 0.0, 0.0, 473977420 + seq, 85455940, 0.0, plan_type
    )


def test_a_fence_is_taken_item_by_item_given_back_and_cleared(client: Client) -> None:
    asked = client.send(dialect.MAVLink_mission_count_message(SYSTEM_ID, 1, 3, 1))
    for seq in range(3):
        assert only(asked, "MISSION_REQUEST_INT").seq == seq
        assert only(client.send(item(seq + 1)), "MISSION_ACK").type == dialect.MAV_MISSION_INVALID_SEQUENCE
        if seq:
            assert only(client.send(item(seq - 1)), "MISSION_REQUEST_INT").seq == seq  # a repeat is asked past
        asked = client.send(item(seq))
    assert only(asked, "MISSION_ACK").type == dialect.MAV_MISSION_ACCEPTED
    assert only(client.send(dialect.MAVLink_mission_request_list_message(SYSTEM_ID, 1, 1)), "MISSION_COUNT").count == 3
    given = only(client.send(dialect.MAVLink_mission_request_int_message(SYSTEM_ID, 1, 2, 1)), "MISSION_ITEM_INT")
    assert (given.seq, given.x, given.command, given.mission_type) == (2, 473977422, 5001, 1)
    assert only(client.send(dialect.MAVLink_mission_request_list_message(SYSTEM_ID, 1, 0)), "MISSION_COUNT").count == 0
    assert only(client.send(dialect.MAVLink_mission_clear_all_message(SYSTEM_ID, 1, 1)), "MISSION_ACK").type == 0
    assert client.vehicle.plans.items(1) == ()
    refused = client.send(dialect.MAVLink_mission_request_int_message(SYSTEM_ID, 1, 0, 1))
    assert only(refused, "MISSION_ACK").type == dialect.MAV_MISSION_INVALID_SEQUENCE


def fence_item(seq: int, command: int, size: float, north_m: float, east_m: float) -> Any:
    """Return a fence item at an offset from the vehicle's start, worked out on a sphere."""
    place = FRAME.geodetic_from_mission(START)
    latitude = place.latitude_deg + north_m / 111_195.0
    longitude = place.longitude_deg + east_m / 111_195.0 / np.cos(radians(place.latitude_deg))
    return dialect.MAVLink_mission_item_int_message(
        SYSTEM_ID, 1, seq, 0, command, 0, 1, size, 0.0, 0.0, 0.0, round(latitude * 1e7), round(longitude * 1e7), 0.0, 1
    )


def upload_fence(client: Client, *items: Any) -> None:
    client.send(dialect.MAVLink_mission_count_message(SYSTEM_ID, 1, len(items), 1))
    for each in items[:-1]:
        assert only(client.send(each), "MISSION_REQUEST_INT")
    assert only(client.send(items[-1]), "MISSION_ACK").type == 0


def test_an_uploaded_fence_holds_the_vehicle_that_leaves_it(client: Client) -> None:
    corners = [(8.0, 8.0), (8.0, -8.0), (-8.0, -8.0), (-8.0, 8.0)]
    circle = fence_item(4, 5004, 3.0, 30.0, 0.0)
    upload_fence(client, *(fence_item(seq, 5001, 4.0, *corner) for seq, corner in enumerate(corners)), circle)
    assert [(zone.stay_inside, len(zone.corners_m), zone.radius_m) for zone in client.autopilot.zones] == [
        (True, 4, 0.0),
        (False, 1, 3.0),
    ]
    fly(client)
    north, east, _ = FRAME.ned_from_mission((START[0] - ORIGIN[0], START[1] - ORIGIN[1], 0.0))
    follow(client, north + 7.0, east, -5.0, seconds=8.0)
    assert last(client.run(1.1), "HEARTBEAT").custom_mode == custom_mode(NavMode.OFFBOARD)
    messages = follow(client, north + 12.0, east, -5.0, seconds=8.0)
    texts = {message.text for message in messages if message.get_type() == "STATUSTEXT"}
    assert {"Geofence: approaching or outside geofence", "Failsafe activated"} <= texts
    assert last(messages, "HEARTBEAT").custom_mode == custom_mode(NavMode.HOLD)
    client.send(dialect.MAVLink_mission_clear_all_message(SYSTEM_ID, 1, 1))
    assert client.autopilot.zones == ()


def test_what_makes_no_zone_is_left_out(client: Client) -> None:
    for command, size, north_m in (
        (5001, 4.0, 0.0),  # a polygon of four corners with one
        (5001, nan, 0.0),
        (5003, nan, 0.0),
        (5003, 5.0, 1e7),  # beyond the pole
        (16, 5.0, 0.0),
    ):
        upload_fence(client, fence_item(0, command, size, north_m, 0.0))
        assert client.autopilot.zones == ()


def test_clearing_by_an_empty_plan_and_all_at_once(client: Client) -> None:
    for plan_type in (0, 1):
        client.send(dialect.MAVLink_mission_count_message(SYSTEM_ID, 1, 1, plan_type))
        client.send(item(0, plan_type))
        assert len(client.vehicle.plans.items(plan_type)) == 1
    assert only(client.send(dialect.MAVLink_mission_count_message(SYSTEM_ID, 1, 0, 0)), "MISSION_ACK").type == 0
    assert [len(client.vehicle.plans.items(plan_type)) for plan_type in (0, 1)] == [0, 1]
    client.send(dialect.MAVLink_mission_clear_all_message(SYSTEM_ID, 1, 255))
    assert client.vehicle.plans.items(1) == ()
    assert only(client.send(dialect.MAVLink_mission_count_message(SYSTEM_ID, 1, 9999, 1)), "MISSION_ACK").type == 4
    assert only(client.send(dialect.MAVLink_mission_count_message(SYSTEM_ID, 1, 1, 77)), "MISSION_ACK").type == 1


# What is dropped


def test_setpoints_that_cannot_be_flown_are_counted_and_do_not_keep_offboard_alive(client: Client) -> None:
    counted = Counter[Drop]()
    rows: tuple[tuple[dict[str, Any], Drop], ...] = (
        ({"x": nan}, Drop.NOT_FINITE),
        ({"y": 1e30}, Drop.OUT_OF_REACH),
        ({"vx": inf, "type_mask": 0b100111000000}, Drop.NOT_FINITE),
        ({"vx": 1e30, "type_mask": 0b100111000000}, Drop.OUT_OF_REACH),
        ({"type_mask": 0b100111111001}, Drop.POSITION_MASKED),
        ({"type_mask": 0b110111000111, "vx": 0.5}, Drop.POSITION_MASKED),
        ({"type_mask": 0b110111111111}, Drop.POSITION_MASKED),
        ({"coordinate_frame": 8}, Drop.FRAME),
        ({"target_system": 8}, Drop.FOREIGN),
    )
    for changes, why in rows:
        counted[why] += 1
        client.setpoint(**({"x": 0.0, "y": 0.0, "z": -5.0} | changes))
        assert client.vehicle.dropped == counted
        assert not client.autopilot.conditions.setpoints_flow


def test_a_yaw_of_nan_or_masked_keeps_the_heading(client: Client) -> None:
    fly(client)
    client.setpoint(0.0, 0.0, -5.0, yaw=nan)
    assert results(client.command(176, 1, 6)) == [0, 0]
    client.run(0.5)
    client.setpoint(0.0, 0.0, -5.0, yaw=2.0, type_mask=0b110111111000)
    client.run(0.5)
    assert client.autopilot.airframe.heading_rad == 0.0
    client.setpoint(0.0, 0.0, -5.0, yaw=radians(20.0))
    client.run(0.8)
    assert degrees(client.autopilot.airframe.heading_rad) == pytest.approx(20.0)


def test_a_velocity_beside_the_setpoint_counts_where_it_is_whole(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[PositionTarget] = []
    monkeypatch.setattr(client.autopilot, "receive_setpoint", lambda _, target: heard.append(target))
    north, east, down = FRAME.ned_from_mission((0.8, 0.5, 0.25))
    rows: tuple[tuple[dict[str, Any], tuple[float, ...]], ...] = (
        ({"vx": inf}, ()),  # masked: it is not looked at
        ({"type_mask": 0b100111000000}, (0.8, 0.5, 0.25)),
        ({"type_mask": 0b100111010000}, ()),
        ({"type_mask": 0b100111000000, "vy": nan}, ()),
    )
    for changes, expected in rows:
        client.setpoint(0.0, 0.0, -5.0, **({"vx": north, "vy": east, "vz": down} | changes))
        assert heard.pop().velocity_m_s == pytest.approx(expected)
    assert client.vehicle.dropped == {}


def test_what_is_foreign_garbled_or_not_understood_is_counted(client: Client) -> None:
    assert client.command(400, 1, target=8) == []
    assert client.send(dialect.MAVLink_attitude_target_message(0, 0, (1, 0, 0, 0), 0, 0, 0, 0)) == []
    own = dialect.MAVLink(None, SYSTEM_ID, 1)
    loop = dialect.MAVLink_command_long_message(SYSTEM_ID, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0).pack(own)
    assert client.vehicle.receive(loop, 3.0) == []
    assert client.vehicle.dropped == {Drop.FOREIGN: 2, Drop.NOT_UNDERSTOOD: 1}
    good = client.pack(dialect.MAVLink_command_long_message(SYSTEM_ID, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0))
    broken = good[:-1] + bytes([good[-1] ^ 1])
    for garbage in (b"hello", broken, good[:20], b"\xfd\xff" + bytes(10)):
        assert client.vehicle.receive(garbage, 3.0) == []
    assert client.vehicle.dropped[Drop.GARBAGE] == 4
    assert not client.autopilot.armed
    assert len(client.vehicle.receive(good, 3.0)) == 1  # and none of it has deafened the vehicle
    assert client.autopilot.armed


def test_a_ping_is_answered(client: Client) -> None:
    answer = only(client.send(dialect.MAVLink_ping_message(123456, 9, 0, 0)), "PING")
    assert (answer.time_usec, answer.seq, answer.target_system, answer.target_component) == (123456, 9, 245, 190)


def test_a_timesync_request_is_answered_with_its_time_and_an_answer_is_not(client: Client) -> None:
    answer = only(client.send(dialect.MAVLink_timesync_message(0, 987_654_321)), "TIMESYNC")
    assert answer.ts1 == 987_654_321
    assert answer.tc1 > 0
    assert client.send(dialect.MAVLink_timesync_message(5, 987_654_321)) == []


@settings(max_examples=30)
@given(st.lists(st.binary(max_size=300), max_size=5))
def test_no_bytes_break_it(datagrams: list[bytes]) -> None:
    client = Client()
    for datagram in datagrams:
        client.vehicle.receive(datagram, 0.0)
    assert results(client.command(31000)) == [3]


WIRE_FLOATS = st.floats(width=32) | st.sampled_from([nan, inf, -inf, 21196.0, 1.0, 0.0, 2.0**31, 4.0, 6.0])


@settings(max_examples=30)
@given(st.sampled_from([20, 21, 22, 176, 400, 410, 510, 511, 512, 520, 999]), st.tuples(*[WIRE_FLOATS] * 7))
def test_no_command_breaks_it(command: int, params: tuple[float, ...]) -> None:
    client = Client()
    client.run(2.1)
    acks = results(client.command(command, *params))
    assert len(acks) == (2 if command == 176 else 1)
    client.run(1.0)
    assert np.isfinite(client.autopilot.airframe.position_m).all()


@settings(max_examples=20)
@given(st.tuples(*[WIRE_FLOATS] * 4), st.integers(0, 2**16 - 1), st.integers(0, 255))
def test_no_setpoint_breaks_it(numbers: tuple[float, float, float, float], mask: int, frame: int) -> None:
    client = Client(plant=replace(PLANT, feedforward=1.0))
    client.run(2.1)
    client.command(400, 1)
    client.command(22, 0, 0, 0, nan, nan, nan, nan)
    client.run(3.0)
    x, y, z, yaw = numbers
    client.setpoint(x, y, z, yaw=yaw, type_mask=mask, coordinate_frame=frame, vx=x, vy=yaw)
    client.command(176, 1, 6)
    client.run(1.5)
    assert np.isfinite(client.autopilot.airframe.position_m).all()
