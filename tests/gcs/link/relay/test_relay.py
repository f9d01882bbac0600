"""The relay of a connection between two sockets: which of MAVSDK's frames reach the vehicles there."""

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import count

import pytest
from pymavlink.dialects.v20 import common as mavlink

from gcs.link.relay import carriers
from gcs.link.relay.frames import header
from gcs.link.relay.relay import Relay
from gcs.link.relay.relay_thread import RelayThread
from tests.support.wire import LOOPBACK, PATIENCE_S, free_port, until_now

VEHICLES = (7, 8)
PARAMETER_REQUEST = 20


@dataclass
class Ends:
    """Both ends of a relay: MAVSDK's connection, and the socket of two vehicles."""

    relay: Relay
    mavsdk: socket.socket
    vehicles: socket.socket

    def find(self, vehicle: int) -> None:
        """Wait for a vehicle's heartbeat, and accept its address."""
        self.relay.claim(vehicle, None)
        autopilot = mavlink.MAVLink(None, vehicle, 1)

        def found() -> bool:
            self.vehicles.send(bytes(autopilot.heartbeat_encode(2, 12, 0, 0, 4).pack(autopilot)))
            return bool(self.relay.candidates(vehicle))

        until_now(found)
        self.relay.verify(vehicle, self.relay.candidates(vehicle)[0])

    def sends(self, *messages: mavlink.MAVLink_message) -> list[tuple[str, int]]:
        """Send messages as MAVSDK, and return the names and targets of those that arrive, up to a command."""
        sender = mavlink.MAVLink(None, 245, 190)
        last = sender.command_long_encode(7, 1, 0, 0, *[0.0] * 7)
        self.mavsdk.sendall(b"".join(bytes(each.pack(sender)) for each in (*messages, last)))
        reader, arrived = mavlink.MAVLink(None), list[tuple[str, int]]()
        while not arrived or arrived[-1][0] != "COMMAND_LONG":
            found = reader.parse_buffer(self.vehicles.recv(4096)) or []
            arrived += [(m.get_type(), m.target_system) for m in found if hasattr(m, "target_system")]
        return arrived[:-1]

    def hears(self, count: int, *messages: mavlink.MAVLink_message) -> list[tuple[str, int]]:
        """Send messages, and return what arrives, once there are `count`: setpoints may wait until others have left."""
        arrived = self.sends(*messages)

        def all_arrived() -> bool:
            arrived.extend(self.sends())
            return len(arrived) >= count

        until_now(all_arrived)
        return arrived


@pytest.fixture
def ends() -> Iterator[Ends]:
    port, thread = free_port(), RelayThread("relays")
    relay = Relay(f"udpin://{LOOPBACK}:{port}", thread)
    at = relay.inner_url.removeprefix("tcpout://").split(":")
    with socket.create_connection((at[0], int(at[1]))) as mavsdk, socket.socket(type=socket.SOCK_DGRAM) as vehicles:
        vehicles.settimeout(PATIENCE_S)
        vehicles.connect((LOOPBACK, port))
        relay.start()
        both = Ends(relay, mavsdk, vehicles)
        for vehicle in VEHICLES:
            both.find(vehicle)
        yield both
        relay.close()
    thread.close()


NUMBERS = count()


def setpoint(vehicle: int) -> mavlink.MAVLink_message:
    """Return a setpoint that differs from all others."""
    encode = mavlink.MAVLink(None).set_position_target_local_ned_encode
    return encode(0, vehicle, 1, 1, 0, float(next(NUMBERS)), 0.0, 0.0, *[0.0] * 6, yaw=0.0, yaw_rate=0.0)


@pytest.mark.parametrize("paced", [False, True], ids=["without a pace", "with a pace"])
def test_a_muted_vehicle_is_sent_no_setpoint_and_the_others_and_all_else_are(ends: Ends, paced: bool) -> None:
    if paced:
        ends.relay.pace(None, 1000.0)
    both = [("SET_POSITION_TARGET_LOCAL_NED", vehicle) for vehicle in VEHICLES]
    assert sorted(ends.hears(2, setpoint(7), setpoint(8))) == both
    ends.relay.mute(7, True)
    assert ends.hears(1, setpoint(7), setpoint(8)) + ends.sends() == both[1:]
    if paced:
        ends.relay.mute(7, False)
    else:  # found again
        ends.relay.release(7)
        ends.find(7)
    assert both[0] in ends.hears(1, setpoint(7))


def test_what_waits_for_room_leaves_when_it_is_due_and_costs_no_processor_until_then(ends: Ends) -> None:
    """A due time that was never over made the thread spin, and frames leave a quarter of a second late."""
    bytes_s, requests = 800.0, 32
    ends.relay.pace(bytes_s, 1.0)
    sender = mavlink.MAVLink(None, 245, 190)
    frames = [bytes(sender.param_request_read_encode(7, 1, b"", index).pack(sender)) for index in range(requests)]
    began_s, used_s = time.monotonic(), time.process_time()
    ends.mavsdk.sendall(b"".join(frames))
    at_s = list[float]()
    while len(at_s) < requests:
        if header(ends.vehicles.recv(4096)).message == PARAMETER_REQUEST:
            at_s.append(time.monotonic())
    lasts_s = sum(map(len, frames)) / bytes_s
    assert 0.8 * lasts_s < at_s[-1] - began_s < 3.0 * lasts_s, "no sooner than there is room, and hardly later"
    assert time.process_time() - used_s < 0.25 * lasts_s


IDLE = 50


def test_callers_that_send_no_heartbeat_keep_no_vehicle_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither those that call before it nor those that call after it."""
    port, thread = free_port(), RelayThread("relays")
    relay = Relay(f"tcpin://{LOOPBACK}:{port}", thread)
    at = relay.inner_url.removeprefix("tcpout://").split(":")
    autopilot = mavlink.MAVLink(None, 7, 1)
    with ExitStack() as stack:
        mavsdk = stack.enter_context(socket.create_connection((at[0], int(at[1]))))
        stack.callback(thread.close)
        stack.callback(relay.close)
        relay.start()
        relay.claim(7, None)

        def call() -> socket.socket:
            caller = stack.enter_context(socket.create_connection((LOOPBACK, port)))
            caller.settimeout(PATIENCE_S)
            return caller

        idle = [call() for _ in range(IDLE)]
        vehicle = call()

        def found() -> bool:
            vehicle.send(bytes(autopilot.heartbeat_encode(2, 12, 0, 0, 4).pack(autopilot)))
            return bool(relay.candidates(7))

        until_now(found, "the vehicle among those that call")
        relay.verify(7, relay.candidates(7)[0])
        monkeypatch.setattr(carriers, "CALLER_S", 0.0)
        idle += [call() for _ in range(IDLE)]
        for each in idle:  # until they are dropped
            with suppress(ConnectionResetError):
                assert each.recv(1) == b""
        sender = mavlink.MAVLink(None, 245, 190)
        mavsdk.sendall(bytes(sender.command_long_encode(7, 1, 0, 0, *[0.0] * 7).pack(sender)))
        reader, arrived = mavlink.MAVLink(None), list[str]()
        while "COMMAND_LONG" not in arrived:
            arrived += [each.get_type() for each in reader.parse_buffer(vehicle.recv(4096)) or []]
