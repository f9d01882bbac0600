"""The stub in its ArduCopter manners: shaped motion, GUIDED, silence until asked, and flown by MAVSDK."""

import asyncio
import socket
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from math import hypot, inf, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis, exact_step
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.ardupilot import ArduCopter
from sitl.autopilot.autopilot import MavResult
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.modes import NavMode
from sitl.autopilot.parameters import Parameters
from sitl.mavlink.protocol import Drop
from sitl.mavlink.reports import MavlinkConfig
from sitl.server import shared_clock
from sitl.server.server import StubConfig
from sitl.vehicle.shaping import ShapedStep, ShapeLimits
from tests.support.ground_station import GroundStation
from tests.support.wire import PATIENCE_S, free_port, served, stub_clock, stub_process

PLANT = Plant(PlantAxis(0.97, 1.33), PlantAxis(0.97, 1.33), delay_s=0.03)
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(30.0))
LIMITS = ShapeLimits(speed_m_s=5.0, acceleration_m_s2=2.5, jerk_m_s3=5.0)
CALM = np.zeros(2)
SET_MODE, TAKE_OFF, LAND, ARM, INTERVAL, REQUEST = 176, 22, 21, 400, 511, 512
STABILIZE, AUTO, GUIDED, LOITER, RTL, LANDING, BRAKE = 0, 3, 4, 5, 6, 9, 17
ACCEPTED, FAILED = 0, 4


# Shaped motion


def flown(setpoints: np.ndarray, wind: np.ndarray = CALM) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (T + 1, 4) and the accelerations (T, 2) of a vehicle at rest that follows setpoints (T, 2)."""
    step = ShapedStep(PLANT, STEP_S, LIMITS)
    state, acceleration = (0.0, 0.0, 0.0, 0.0), (0.0, 0.0)
    states, accelerations = [state], []
    push_x, push_y = wind.tolist()
    for aim_x, aim_y in setpoints.tolist():
        before = state
        state = step.advance(before, acceleration, (aim_x, aim_y), (push_x, push_y))
        acceleration = (state[2] - before[2]) / STEP_S, (state[3] - before[3]) / STEP_S
        states.append(state)
        accelerations.append(acceleration)
    return np.array(states), np.array(accelerations)


places = st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0))


@given(st.lists(st.tuples(places, st.integers(5, 150)), min_size=1, max_size=6))
def test_no_motion_exceeds_speed_acceleration_or_jerk(legs: list[tuple[tuple[float, float], int]]) -> None:
    setpoints = np.concatenate([np.tile(place, (steps, 1)) for place, steps in legs])
    states, accelerations = flown(setpoints)
    jerks = np.diff(accelerations, axis=0, prepend=np.zeros((1, 2))) / STEP_S
    assert np.linalg.norm(states[:, 2:], axis=1).max() <= LIMITS.speed_m_s
    assert np.linalg.norm(accelerations, axis=1).max() <= LIMITS.acceleration_m_s2 + 1e-9
    assert np.linalg.norm(jerks, axis=1).max() <= LIMITS.jerk_m_s3 + 1e-6


def test_a_small_motion_is_the_linear_plants_own() -> None:
    # A circle of 10 m at 0.15 rad/s, entered at leisure: 1.5 m/s, 0.23 m/s2.
    angle = 0.15 * STEP_S * np.arange(5000)
    grown = 10.0 * np.clip(np.arange(5000) * STEP_S / 40.0, 0.0, 1.0)[:, None]
    setpoints = grown * np.column_stack([np.cos(angle), np.sin(angle)])
    wind = np.array([0.05, -0.02])
    linear, expected = exact_step(PLANT, STEP_S), [np.zeros(4)]
    for setpoint in setpoints:
        expected.append(linear.advance(expected[-1], setpoint, wind))
    np.testing.assert_allclose(flown(setpoints, wind)[0], expected, atol=1e-9)


def test_a_long_distance_takes_the_time_of_the_limits() -> None:
    states, accelerations = flown(np.tile((200.0, 0.0), (3000, 1)))
    speed = states[:, 2]
    # Jerk first: 0.5 s until 2.5 m/s2, x = j t^3 / 6.
    assert states[25, 0] == pytest.approx(5.0 * 0.5**3 / 6.0, rel=0.1)
    assert accelerations[:, 0].max() == pytest.approx(2.5)
    assert speed.max() == pytest.approx(4.9, abs=0.05)
    # At no more than 5 m/s, 200 m take longer than 40 s; the linear plant would be there in 8 s.
    assert np.argmax(states[:, 0] > 199.0) * STEP_S > 40.0
    assert states[-1] == pytest.approx((200.0, 0.0, 0.0, 0.0), abs=0.05)


def test_limits_are_positive(subtests: pytest.Subtests) -> None:
    for wrong in ((0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, float("nan"))):
        with subtests.test(wrong=wrong), pytest.raises(ValueError, match="it must be positive"):
            ShapeLimits(*wrong)


# The autopilot


def ready(plant: Plant = PLANT, **parameters: float) -> ArduCopter:
    copter = ArduCopter(plant, parameters=Parameters(ArduCopter.TABLE, **parameters))
    wait(copter, 3.0)
    return copter


def wait(copter: ArduCopter, seconds: float) -> None:
    copter.step(copter.time_s + seconds)


def mode_of(copter: ArduCopter) -> NavMode:
    """Return the mode now; as a function, so that the type checker forgets what it knew before."""
    return copter.mode


def is_armed(copter: ArduCopter) -> bool:
    return copter.armed


def guided(height_m: float = 8.0, plant: Plant = PLANT, **parameters: float) -> ArduCopter:
    """Take off and hover in GUIDED."""
    copter = ready(plant, **parameters)
    assert copter.select(NavMode.OFFBOARD) is MavResult.ACCEPTED
    assert copter.arm() is MavResult.ACCEPTED
    assert copter.take_off(height_m) is MavResult.ACCEPTED
    wait(copter, 25.0)
    assert copter.airframe.position_m == pytest.approx((0.0, 0.0, height_m), abs=0.05)
    return copter


def texts(copter: ArduCopter) -> list[str]:
    return [text for _, text in copter.take_texts()]


def test_it_boots_in_stabilize_and_arms_once_it_has_a_position() -> None:
    copter = ArduCopter(PLANT)
    assert mode_of(copter) is NavMode.STABILIZED
    assert copter.arm() is MavResult.REJECTED
    assert texts(copter) == ["PreArm: Need Position Estimate"]
    wait(copter, 3.0)
    assert copter.armable
    assert copter.arm() is MavResult.ACCEPTED
    assert texts(copter) == ["Arming motors"]


def test_take_off_is_for_vehicles_armed_in_guided_on_the_ground() -> None:
    copter = ready()
    copter.select(NavMode.OFFBOARD)
    assert copter.take_off(5.0) is MavResult.REJECTED
    copter.select(NavMode.POSITION)
    copter.arm()
    assert copter.take_off(5.0) is MavResult.REJECTED
    copter.select(NavMode.OFFBOARD)
    assert copter.take_off(None) is MavResult.REJECTED
    assert copter.take_off(5.0) is MavResult.ACCEPTED
    wait(copter, 20.0)
    assert mode_of(copter) is NavMode.OFFBOARD
    assert copter.airframe.position_m[2] == pytest.approx(5.0, abs=0.05)
    assert copter.take_off(9.0) is MavResult.REJECTED


def test_a_position_setpoint_does_not_expire_and_the_end_of_the_stream_is_no_failsafe() -> None:
    copter = guided()
    copter.receive_setpoint(copter.time_s, PositionTarget((6.0, -3.0, 9.0)))
    wait(copter, 120.0)
    assert mode_of(copter) is NavMode.OFFBOARD
    assert not copter.failsafe
    assert copter.airframe.position_m == pytest.approx((6.0, -3.0, 9.0), abs=0.01)


@pytest.mark.parametrize(("gain", "moved_s"), [(1.0, 3.0), (0.0, 0.0)])
def test_a_position_with_a_velocity_moves_on_with_it_for_three_seconds(gain: float, moved_s: float) -> None:
    """As ModeGuided::posvelaccel_control_run has it; a stub whose plant takes no velocities leaves them aside."""
    copter = guided(plant=replace(PLANT, feedforward=gain))
    copter.receive_setpoint(copter.time_s, PositionTarget((2.0, 0.0, 8.0), None, (0.5, -0.4, 0.0)))
    wait(copter, 30.0)
    assert copter.airframe.position_m[:2] == pytest.approx((2.0 + 0.5 * moved_s, -0.4 * moved_s), abs=0.03)


@pytest.mark.parametrize("mode", [NavMode.HOLD, NavMode.STABILIZED])
def test_a_setpoint_outside_guided_or_on_the_ground_is_passed_over(mode: NavMode) -> None:
    copter = guided() if mode is NavMode.HOLD else ready()
    copter.select(mode)
    copter.receive_setpoint(copter.time_s, PositionTarget((20.0, 0.0, 8.0)))
    copter.select(NavMode.OFFBOARD)
    copter.arm()
    wait(copter, 5.0)
    assert copter.airframe.position_m[:2] == pytest.approx((0.0, 0.0), abs=0.01)
    if mode is NavMode.STABILIZED:
        copter.receive_setpoint(copter.time_s, PositionTarget((0.0, 0.0, 8.0)))
        wait(copter, 5.0)
        assert copter.airframe.on_ground


def test_guided_entered_anew_stays_where_it_is() -> None:
    copter = guided()
    copter.receive_setpoint(copter.time_s, PositionTarget((20.0, 0.0, 8.0)))
    wait(copter, 3.0)
    copter.select(NavMode.HOLD)
    wait(copter, 10.0)
    x = copter.airframe.position_m[0]
    assert 0.5 < x < 15.0
    copter.select(NavMode.OFFBOARD)
    wait(copter, 20.0)
    assert copter.airframe.position_m[0] == pytest.approx(x, abs=0.05)


def test_after_a_landing_it_disarms_at_once_and_cannot_be_armed_in_that_mode() -> None:
    copter = guided()
    assert copter.select(NavMode.RETURN) is MavResult.ACCEPTED
    while not copter.landed:
        wait(copter, STEP_S)
    wait(copter, STEP_S)
    assert not is_armed(copter)
    assert mode_of(copter) is NavMode.RETURN
    assert copter.armable
    assert copter.arm() is MavResult.REJECTED
    assert texts(copter)[-2:] == ["Disarming motors", "Arm: mode not armable"]


def test_armed_anew_it_does_not_follow_the_last_flights_setpoint() -> None:
    copter = guided()
    copter.receive_setpoint(copter.time_s, PositionTarget((6.0, 0.0, 8.0)))
    wait(copter, 1.0)
    assert copter.disarm(force=True) is MavResult.ACCEPTED
    wait(copter, 10.0)
    assert copter.landed
    assert copter.arm() is MavResult.ACCEPTED
    wait(copter, 8.0)
    assert copter.airframe.on_ground
    assert copter.take_off(4.0) is MavResult.ACCEPTED
    wait(copter, 20.0)
    assert copter.airframe.position_m[2] == pytest.approx(4.0, abs=0.05)


def test_idle_on_the_ground_it_disarms_after_the_delay() -> None:
    for delay_s, stays_s in ((3, 2.9), (0, 60.0)):
        copter = ready(DISARM_DELAY=delay_s)
        copter.arm()
        wait(copter, stays_s)
        assert is_armed(copter)
        wait(copter, 0.2)
        assert is_armed(copter) is (delay_s == 0)


def test_the_motion_is_as_fast_as_its_parameters_say() -> None:
    copter = guided(WPNAV_SPEED=200.0)
    copter.receive_setpoint(copter.time_s, PositionTarget((60.0, 0.0, 8.0)))
    speeds = []
    for _ in range(400):
        wait(copter, STEP_S)
        speeds.append(hypot(*copter.airframe.velocity_m_s[:2]))
    assert 1.9 < max(speeds) <= 2.0


# The bytes


class Client(GroundStation):
    """The ground station of an ArduCopter stub."""

    def __init__(self, copter: ArduCopter | None = None) -> None:
        self.copter = copter or ArduCopter(PLANT, (0.0, 0.0, 1.5))
        super().__init__(self.copter, MavlinkConfig(3, FRAME, (0.0, 0.0, 0.0)), dialect)

    def results(self, command: int, *params: float) -> list[int]:
        return [each.result for each in self.command(command, *params) if each.get_type() == "COMMAND_ACK"]

    def heartbeat(self) -> Any:
        return next(each for each in reversed(self.run(1.1)) if each.get_type() == "HEARTBEAT")


@pytest.fixture
def client() -> Client:
    return Client()


def counted(messages: list[Any]) -> Counter[str]:
    return Counter(message.get_type() for message in messages)


def test_it_streams_only_heartbeats_until_a_request(client: Client) -> None:
    assert counted(client.run(10.5)) == {"HEARTBEAT": 11}
    assert client.results(INTERVAL, 32, 50_000) == [ACCEPTED]
    assert counted(client.run(10.0)) == {"HEARTBEAT": 10, "LOCAL_POSITION_NED": pytest.approx(200, abs=1)}
    assert client.results(INTERVAL, 32, 0) == [ACCEPTED]
    assert counted(client.run(5.0)) == {"HEARTBEAT": 5}


def test_streams_are_asked_for_in_groups_too(client: Client) -> None:
    client.run(3.0)
    assert client.send(dialect.MAVLink_request_data_stream_message(3, 1, 6, 10, 1)) == []
    some = pytest.approx(20, abs=1)
    assert counted(client.run(2.0)) == {"HEARTBEAT": 2, "LOCAL_POSITION_NED": some, "GLOBAL_POSITION_INT": some}
    client.send(dialect.MAVLink_request_data_stream_message(3, 1, 0, 10, 0))
    assert counted(client.run(2.0)) == {"HEARTBEAT": 2}
    client.send(dialect.MAVLink_request_data_stream_message(3, 1, 99, 10, 1))
    assert client.vehicle.dropped[Drop.NOT_UNDERSTOOD] == 1


def test_a_mode_is_acknowledged_once_with_the_actual_result(client: Client) -> None:
    client.run(3.0)
    for mode in (GUIDED, LOITER, RTL, LANDING, BRAKE, STABILIZE):
        assert client.results(SET_MODE, 1, mode) == [ACCEPTED]
        assert client.heartbeat().custom_mode == mode
    said = client.heartbeat()
    assert (said.autopilot, said.type) == (3, 2)


def test_a_mode_that_cannot_be_is_refused_in_one_word(client: Client) -> None:
    assert client.results(SET_MODE, 1, AUTO) == [FAILED]
    assert client.results(SET_MODE, 0, LOITER) == [FAILED]
    assert client.results(SET_MODE, 1, GUIDED) == [ACCEPTED]
    assert client.results(ARM, 1) == [FAILED]
    assert client.heartbeat().custom_mode == GUIDED


def test_take_off_counts_from_home(client: Client) -> None:
    client.run(3.0)
    client.command(SET_MODE, 1, GUIDED)
    assert client.results(ARM, 1) == [ACCEPTED]
    assert client.results(TAKE_OFF, 0, 0, 0, 0, 0, 0, float("nan")) == [FAILED]
    assert client.results(TAKE_OFF, 0, 0, 0, 0, 0, 0, 4.0) == [ACCEPTED]
    client.run(20.0)
    assert client.copter.airframe.position_m[2] == pytest.approx(5.5, abs=0.05)


@pytest.mark.parametrize(
    ("name", "kind", "sent", "kept"), [("GUID_TIMEOUT", 9, 5.5, 5.5), ("FS_GCS_ENABLE", 6, 2.0, 2)]
)
def test_parameters_travel_as_numbers(client: Client, name: str, kind: int, sent: float, kept: float) -> None:
    (answer,) = client.send(dialect.MAVLink_param_set_message(3, 1, name.encode(), sent, kind))
    assert (answer.param_value, client.copter.parameters[name]) == (sent, kept)
    assert type(client.copter.parameters[name]) is type(ArduCopter.TABLE.defaults[name])


def test_a_parameter_that_is_no_number_is_refused(client: Client) -> None:
    for sent in (float("nan"), 3e9):
        (answer,) = client.send(dialect.MAVLink_param_set_message(3, 1, b"FS_GCS_ENABLE", sent, 6))
        assert answer.param_value == 0.0
    assert client.vehicle.dropped[Drop.PARAMETER] == 2


def test_the_estimators_report_is_ekf_status(client: Client) -> None:
    assert "EKF_STATUS_REPORT" not in counted(client.run(3.0))
    acknowledged, report = client.command(REQUEST, 193)
    assert (acknowledged.result, report.get_type()) == (ACCEPTED, "EKF_STATUS_REPORT")
    assert (report.flags, report.pos_horiz_variance, report.compass_variance) == (831, 0.0, 0.0)
    assert [each.get_type() for each in client.command(REQUEST, 230)] == ["COMMAND_ACK"]


def test_the_truth_is_sim_state(client: Client) -> None:
    client.run(3.0)
    acknowledged, truth = client.command(REQUEST, 108)
    assert (acknowledged.result, truth.get_type()) == (ACCEPTED, "SIM_STATE")
    place = FRAME.mission_from_geodetic(Geodetic(truth.lat_int / 1e7, truth.lon_int / 1e7, truth.alt))
    assert place == pytest.approx((0.0, 0.0, 1.5), abs=0.02)


# The failsafe for a silent ground station

STATION, OTHER_STATION = 245, 255


def station_of(copter: ArduCopter) -> Client:
    """Return the ground station of a copter, whose heartbeat has just arrived."""
    client = Client(copter)
    beat(client)
    return client


def beat(client: Client, system_id: int = STATION) -> None:
    message = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    client.vehicle.receive(bytes(message.pack(dialect.MAVLink(None, system_id, 190))), client.copter.time_s)


def left_mode_after_s(copter: ArduCopter, limit_s: float = 30.0) -> float:
    """Let time pass until the mode changes; return how much did."""
    began_s, mode = copter.time_s, copter.mode
    while copter.mode is mode and copter.time_s - began_s < limit_s:
        wait(copter, STEP_S)
    return copter.time_s - began_s


def test_a_silent_ground_station_ends_guided_by_its_parameter(subtests: pytest.Subtests) -> None:
    """By ArduCopter's documentation of FS_GCS_ENABLE; it looks for the heartbeats three times a second."""
    for enabled, timeout_s, mode in (
        (3, 5.0, NavMode.RETURN),
        (5, 2.0, NavMode.LAND),
        (7, 5.0, NavMode.HOLD),
    ):
        with subtests.test(enabled=enabled, timeout_s=timeout_s):
            copter = guided(FS_GCS_ENABLE=enabled, FS_GCS_TIMEOUT=timeout_s, SYSID_MYGCS=STATION)
            copter.take_texts()
            client = station_of(copter)
            assert timeout_s < left_mode_after_s(copter) <= timeout_s + 1.0 / 3.0 + 2 * STEP_S
            assert mode_of(copter) is mode
            assert texts(copter) == ["GCS Failsafe"]
            beat(client)
            wait(copter, 0.5)
            assert texts(copter) == ["GCS Failsafe Cleared"]
            assert mode_of(copter) is mode


def test_a_landing_by_failsafe_begins_with_a_hover() -> None:
    """By LAND_WITH_DELAY_MS of ArduCopter's config.h, 4 s; a landing by command has none."""
    copter = guided(FS_GCS_ENABLE=5, SYSID_MYGCS=STATION)
    station_of(copter)
    left_mode_after_s(copter)
    wait(copter, 3.9)
    assert mode_of(copter) is NavMode.LAND
    assert copter.airframe.position_m[2] == pytest.approx(8.0, abs=0.05)
    wait(copter, 2.0)
    assert copter.airframe.position_m[2] < 7.5
    commanded = guided()
    commanded.land()
    wait(commanded, 2.0)
    assert commanded.airframe.position_m[2] < 7.5


def test_without_the_failsafe_or_its_station_guided_goes_on(subtests: pytest.Subtests) -> None:
    for words, enabled, watched, sender, every_s in (
        ("switched off", 0, STATION, STATION, 0.0),
        ("another station's heartbeats", 5, STATION, OTHER_STATION, 0.0),
        ("heartbeats go on", 5, STATION, STATION, 1.0),
    ):
        with subtests.test(words):
            copter = guided(FS_GCS_ENABLE=enabled, SYSID_MYGCS=watched)
            client = Client(copter)
            beat(client, sender)
            for _ in range(20):
                wait(copter, every_s or 1.0)
                if every_s:
                    beat(client, sender)
            assert mode_of(copter) is NavMode.OFFBOARD


def test_the_reaction_to_a_silent_ground_station_depends_on_the_mode(subtests: pytest.Subtests) -> None:
    """The bits 8 (landing goes on) and 16 (a pilot's mode goes on) of FS_OPTIONS; 16 is the default."""
    for before, options, after in (
        (NavMode.HOLD, 16, NavMode.HOLD),
        (NavMode.HOLD, 0, NavMode.RETURN),
        (NavMode.LAND, 16, NavMode.RETURN),
        (NavMode.LAND, 8, NavMode.LAND),
    ):
        with subtests.test(before=before, options=options):
            copter = guided(FS_GCS_ENABLE=1, SYSID_MYGCS=STATION, FS_OPTIONS=options, LAND_SPEED=20.0)
            copter.select(before)
            station_of(copter)
            left_mode_after_s(copter, 6.0)
            assert copter.armed
            assert mode_of(copter) is after


def test_a_silent_ground_station_disarms_on_the_ground() -> None:
    copter = ready(FS_GCS_ENABLE=5, SYSID_MYGCS=STATION, DISARM_DELAY=0)
    copter.select(NavMode.OFFBOARD)
    copter.arm()
    station_of(copter)
    wait(copter, 5.5)
    assert not is_armed(copter)
    assert mode_of(copter) is NavMode.OFFBOARD


# Flown by MAVSDK

SPEED = 10.0


def copter_on(port: int) -> StubConfig:
    return StubConfig(1, port, PLANT, FRAME, autopilot="ardupilot")


async def hear(station: socket.socket, heartbeats: int) -> None:
    """Wait for heartbeats."""
    read, count = dialect.MAVLink(None), 0
    while count < heartbeats:
        datagram = await asyncio.to_thread(station.recv, 2048)
        count += any(each.get_type() == "HEARTBEAT" for each in read.parse_buffer(datagram) or [])


@pytest.fixture
def station() -> Iterator[socket.socket]:
    """Return a socket that receives from a vehicle."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bound:
        bound.bind(("127.0.0.1", free_port()))
        bound.settimeout(PATIENCE_S)
        yield bound


@pytest.mark.wire
async def test_while_the_time_stands_still_it_sends_heartbeats_by_the_wall(
    station: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared_clock, "HUNG_S", inf)
    async with served([copter_on(station.getsockname()[1])], SPEED) as stubs:
        with shared_clock.Seat(stubs.clock.name, shared_clock.Rank.GUEST) as other:
            other.state(other.now_us + 1_000)  # which it never goes on from
            stands_us = other.now_us
            await hear(station, 3)
            assert other.now_us <= stands_us + 1_000


@pytest.mark.wire
async def test_while_the_time_creeps_it_sends_heartbeats_by_the_wall(station: socket.socket) -> None:
    async with served([copter_on(station.getsockname()[1])], 0.05) as stubs:
        began_s = stubs.clock.now_s()
        await hear(station, 3)
        assert stubs.clock.now_s() - began_s < 1.0, "two seconds by its own clock"


@pytest.mark.wire
async def test_the_vehicle_link_flies_it_from_disarmed_to_disarmed_twice() -> None:
    from agents.ports import FlightMode, Setpoint
    from estimation.state import Telemetry
    from gcs.link.config import LinkConfig
    from gcs.link.hub import MavsdkHub
    from gcs.link.mavsdk_link import MavsdkLink

    port, heard = free_port(), list[Telemetry]()
    with stub_clock(SPEED) as clock, stub_process([copter_on(port)], clock.name) as process:
        hub = MavsdkHub(clock)
        link = MavsdkLink(hub, LinkConfig(f"udpin://127.0.0.1:{port}", 1, FRAME), clock)
        await link.connect(heard.append)
        for altitude_m in (6.0, 5.0):
            await link.take_off(altitude_m)
            assert abs(heard[-1].position_m[2] - altitude_m) < 0.5
            goal_m = (2.0, -1.0, altitude_m)
            link.send(Setpoint(goal_m))
            await link.start_offboard()
            assert link.status.mode is FlightMode.OFFBOARD
            await clock.sleep(10.0)
            assert heard[-1].position_m == pytest.approx(goal_m, abs=0.1)
            await link.stop_offboard()
            await link.land()
            assert not link.status.armed
        await link.close()
        await hub.close()
        place_m = process.stop().tracks[0].position_m[-1]
    assert place_m == pytest.approx((2.0, -1.0, 0.0), abs=0.1)
