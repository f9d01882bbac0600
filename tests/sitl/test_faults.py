"""Faults of one stub vehicle: what it tells and where it flies with a silent motion, or an estimate that is off."""

from collections import Counter

import pytest
from pymavlink.dialects.v20.common import MAVLink_set_gps_global_origin_message

from agents.shell.clock import WallClock
from agents.team.messages import MemberState, OperatorCommand
from gcs.flight.faults.failing_equipment import FailingBus
from gcs.flight.faults.team_faults import PresentFaults, TeamFaults
from sitl.autopilot.modes import NavMode
from sitl.faults import VehicleFaults
from tests.sitl.test_protocol import SYSTEM_ID, Client, fly, follow
from tests.support.fake_flight import FakeBus

MOTION = {"ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"}


@pytest.fixture
def faults() -> VehicleFaults:
    return VehicleFaults()


@pytest.fixture
def client(faults: VehicleFaults) -> Client:
    made = Client(faults=faults)
    made.run(3.0)
    return made


def test_a_vehicle_with_silent_motion_sends_everything_else(client: Client, faults: VehicleFaults) -> None:
    before = Counter(message.get_type() for message in client.run(2.0))
    faults.motion_silent = True
    after = Counter(message.get_type() for message in client.run(2.0))
    assert before.keys() - after.keys() == MOTION
    assert {kind: count for kind, count in before.items() if kind not in MOTION} == after
    faults.motion_silent = False
    assert {message.get_type() for message in client.run(0.5)} >= MOTION


def test_an_estimate_with_an_offset_is_sent_and_flown_by(client: Client, faults: VehicleFaults) -> None:
    fly(client)
    follow(client, 2.0, 1.0, -5.0, 20.0)
    x, y, _ = client.autopilot.airframe.position_m
    told = [m for m in client.run(0.2) if m.get_type() == "LOCAL_POSITION_NED"][-1]
    faults.estimate_offset_m = (10.0, -4.0, 0.0)
    jumped = [m for m in client.run(0.2) if m.get_type() == "LOCAL_POSITION_NED"][-1]
    assert (jumped.x - told.x) ** 2 + (jumped.y - told.y) ** 2 == pytest.approx(116.0, rel=0.01)
    follow(client, 2.0, 1.0, -5.0, 20.0)
    settled = [m for m in client.run(0.2) if m.get_type() == "LOCAL_POSITION_NED"][-1]
    assert (settled.x, settled.y) == pytest.approx((2.0, 1.0), abs=0.05), "it believes to be where it was told to be"
    assert client.autopilot.airframe.position_m[:2] == pytest.approx((x - 10.0, y + 4.0), abs=0.05)


def test_an_origin_that_moves_is_sent_and_the_place_on_earth_stays(client: Client, faults: VehicleFaults) -> None:
    before = {m.get_type(): m for m in client.run(1.0)}
    origin = next(m for m in client.command(512, 49) if m.get_type() == "GPS_GLOBAL_ORIGIN")
    north = MAVLink_set_gps_global_origin_message(
        SYSTEM_ID, origin.latitude + 900, origin.longitude, origin.altitude - 2000
    )
    client.send(north)
    sent = client.run(1.0)
    after = {m.get_type(): m for m in sent}
    moved = [m for m in sent if m.get_type() == "GPS_GLOBAL_ORIGIN"]
    assert [(m.latitude, m.altitude) for m in moved] == [(origin.latitude + 900, origin.altitude - 2000)]
    # A degree of latitude has 111.2 km there.
    off_m = before["LOCAL_POSITION_NED"].x - after["LOCAL_POSITION_NED"].x
    assert off_m == pytest.approx(10.0, abs=0.03)
    assert after["LOCAL_POSITION_NED"].z - before["LOCAL_POSITION_NED"].z == pytest.approx(-2.0, abs=0.01)
    assert after["GLOBAL_POSITION_INT"].lat == before["GLOBAL_POSITION_INT"].lat
    faults.origin_moved_m = (0.0, 0.0, 0.0)
    (back,) = [m for m in client.run(0.2) if m.get_type() == "GPS_GLOBAL_ORIGIN"]
    assert back.latitude == origin.latitude


def test_a_velocity_of_zero_is_a_setpoint_to_stop(client: Client) -> None:
    fly(client)
    follow(client, 20.0, 0.0, -5.0, 2.0)
    x, y, z = client.autopilot.airframe.position_m
    assert client.autopilot.airframe.velocity_m_s[0] > 1.0
    for _ in range(200):
        client.setpoint(0.0, 0.0, 0.0, type_mask=0b100111000111)
        client.run(0.05)
    assert client.autopilot.mode is NavMode.OFFBOARD, "it counts as a setpoint"
    # It was 17 m from its last setpoint.
    assert client.autopilot.airframe.position_m == pytest.approx((x, y, z), abs=5.0)
    assert max(map(abs, client.autopilot.airframe.velocity_m_s)) < 0.05


# The flying process


def member(sender: int) -> MemberState:
    return MemberState(sender, 1.0, "formation", (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))


COMMAND = OperatorCommand(1.0, "hold", None, "somebody", 7)


async def opened(bus: FakeBus) -> tuple[PresentFaults, list[object]]:
    """Open a failing bus; return its receiver of faults, and what comes through."""
    receiver, heard = PresentFaults(), list[object]()

    def sense(_topic: str, payload: bytes) -> None:
        heard.append(payload)

    await FailingBus(bus, WallClock(), receiver, vehicle_id=3).open(heard.append, sense, lambda *_: None)
    return receiver, heard


async def test_a_bus_loses_the_given_share() -> None:
    bus = FakeBus()
    receiver, heard = await opened(bus)
    for _ in range(1000):
        bus.deliver(member(1))
    assert len(heard) == 1000
    receiver.now = TeamFaults(loss=0.5)
    for _ in range(1000):
        bus.deliver(member(1))
    assert 1450 < len(heard) < 1550
    for _ in range(1000):
        bus.sense("perception", b"noise")
    assert 400 < heard.count(b"noise") < 600


async def test_who_is_unheard_is_and_operators_are_not() -> None:
    bus = FakeBus()
    receiver, heard = await opened(bus)
    receiver.now = TeamFaults(not_received=frozenset({1, 2}))
    for sender in (1, 2, 3):
        bus.deliver(member(sender))
    bus.deliver(COMMAND)
    bus.sense("perception", b"noise")
    assert heard == [member(3), COMMAND, b"noise"]
