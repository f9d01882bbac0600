"""Vehicle urls of sockets, to a stub that answers there; and what is told of urls and vehicles that cannot work.

Serial lines: `test_radio.py`.
"""

import asyncio
import errno
import os
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agents.ports import VehicleRefusedError
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from gcs.flight.flight import fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.link.ports import free_ports, require_usable
from gcs.mission.file import load_mission
from gcs.preflight.findings import Finding, Grade
from sitl.autopilot.px4 import Px4
from sitl.server.governed_clock import GovernedClock
from sitl.server.server import StubConfig
from tests.support.flights import unseen_view
from tests.support.wire import LOOPBACK, served, served_by, stub_clock, until
from tests.support.wording import facts_missing

pytestmark = pytest.mark.wire

SPEED = 10.0
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0))
PLANT = Plant(PlantAxis(0.8, 0.87), PlantAxis(0.8, 0.87))


class Wire(asyncio.DatagramProtocol):
    """The stub's end of a stream: its datagrams go into the stream, and what the stream brings goes to the stub."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self._write = write
        self._stub: tuple[str, int] | None = None
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._stub = addr
        self._write(data)

    def feed(self, data: bytes) -> None:
        if self._transport is not None and self._stub is not None:
            self._transport.sendto(data, self._stub)


@asynccontextmanager
async def wired(port: int, write: Callable[[bytes], object]) -> AsyncIterator[Wire]:
    wire = Wire(write)
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: wire, local_addr=(LOOPBACK, port))
    try:
        yield wire
    finally:
        transport.close()


async def pump(wire: Wire, reader: asyncio.StreamReader) -> None:
    while data := await reader.read(4096):
        wire.feed(data)


@asynccontextmanager
async def over_udp_out(clock: GovernedClock, config: StubConfig, port: int) -> AsyncIterator[str]:
    async with served_by(clock, [replace(config, port=port)]):
        yield f"udpout://localhost:{port}"


@asynccontextmanager
async def over_tcp_out(clock: GovernedClock, config: StubConfig, port: int) -> AsyncIterator[str]:
    """The vehicle is a TCP server, as ArduPilot's simulator is."""

    async def serve_one(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError, OSError):
            async with wired(config.client_port, writer.write) as wire:
                await pump(wire, reader)
        writer.close()

    async with served_by(clock, [config]), await asyncio.start_server(serve_one, LOOPBACK, port):
        yield f"tcpout://{LOOPBACK}:{port}"


@asynccontextmanager
async def over_tcp_in(clock: GovernedClock, config: StubConfig, port: int) -> AsyncIterator[str]:
    """The vehicle calls as a TCP client, and again whenever the connection ends."""

    async def call() -> None:
        while True:
            with suppress(OSError):
                reader, writer = await asyncio.open_connection(LOOPBACK, port)
                async with wired(config.client_port, writer.write) as wire:
                    await pump(wire, reader)
                writer.close()
            await asyncio.sleep(0.05)

    calling = asyncio.create_task(call())
    try:
        async with served_by(clock, [config]):
            yield f"tcpin://{LOOPBACK}:{port}"
    finally:
        calling.cancel()


@pytest.mark.parametrize("carrier", [over_udp_out, over_tcp_out, over_tcp_in])
async def test_a_vehicle_is_reached_and_commanded(
    carrier: Callable[[GovernedClock, StubConfig, int], AbstractAsyncContextManager[str]],
) -> None:
    client_port, port = free_ports(2)
    samples: list[object] = []
    async with AsyncExitStack() as stack:
        clock = stack.enter_context(stub_clock(SPEED))
        url = await stack.enter_async_context(carrier(clock, StubConfig(1, client_port, PLANT, FRAME), port))
        hub = MavsdkHub(clock)
        stack.push_async_callback(hub.close)
        link = MavsdkLink(hub, LinkConfig(url, 1, FRAME), clock)
        stack.push_async_callback(link.close)
        await link.connect(samples.append)
        await until(lambda: len(samples) > 10, waiting_for="telemetry")
        await link.take_off(2.0)
        assert link.status.armed
    assert link.unsent == 0


def told_of(url: str) -> VehicleRefusedError:
    with pytest.raises(VehicleRefusedError) as refusal:
        require_usable(url)
    return refusal.value


def test_a_serial_device_that_is_not_there_is_named() -> None:
    told = told_of("serial:///dev/ttyNOWHERE:57600")
    assert told.reason.startswith("serial:///dev/ttyNOWHERE:57600: the serial device /dev/ttyNOWHERE does not exist; ")
    assert "/dev" in told.next_step


def test_a_file_is_no_serial_device(tmp_path: Path) -> None:
    told = told_of(f"serial://{tmp_path}:57600")
    assert facts_missing(told.reason, f"serial://{tmp_path}:57600: ", "not a serial device") == []


def test_a_device_of_somebody_else_tells_the_group_to_join(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    told = told_of("serial:///dev/null:57600")
    assert told.reason.startswith("serial:///dev/null:57600: ")
    assert "dialout" in told.next_step


def test_a_host_that_is_not_known_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    told = told_of("tcpout://drone.example:5760")
    assert told.reason == "tcpout://drone.example:5760: unknown host drone.example (Name or service not known)"
    assert "numeric" in told.next_step


def test_a_tcp_server_that_is_not_there_is_told_at_once() -> None:
    (port,) = free_ports(1)
    told = told_of(f"tcpout://{LOOPBACK}:{port}")
    assert told.reason == f"tcpout://{LOOPBACK}:{port}: tcp port {port} of {LOOPBACK} refuses connections"
    assert "host and port" in told.next_step


@pytest.mark.parametrize(("scheme", "kind"), [("udpin", socket.SOCK_DGRAM), ("tcpin", socket.SOCK_STREAM)])
def test_a_port_that_is_taken_is_named(scheme: str, kind: socket.SocketKind) -> None:
    with socket.socket(socket.AF_INET, kind) as other:
        other.bind((LOOPBACK, 0))
        if kind is socket.SOCK_STREAM:
            other.listen()
        port = other.getsockname()[1]
        told = told_of(f"{scheme}://{LOOPBACK}:{port}")
    taken = f"{scheme[:3]} port {port} of {scheme}://{LOOPBACK}:{port} is in use by process {os.getpid()} "
    assert told.reason.startswith(taken)


def test_an_address_of_another_machine_or_a_name_cannot_be_listened_on() -> None:
    assert os.strerror(errno.EADDRNOTAVAIL) in told_of("udpin://192.0.2.7:14540").reason
    assert told_of("udpin://drone.example:14540").next_step.startswith("use 0.0.0.0")


async def test_what_is_no_multicopter_of_a_known_autopilot_is_not_armed(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mavlink, "MAV_TYPE_QUADROTOR", 1)  # an aeroplane
    monkeypatch.setattr(Px4, "DIALECT", replace(Px4.DIALECT, autopilot=0))
    mission = load_mission(mission_file("px4-trio"))
    told: list[Finding] = []
    async with served([stub_configs(mission)[0]], SPEED) as stubs:
        plan = FlightPlan(mission, 5.0, mission.vehicles[:1], speed=SPEED, clock=stubs.clock.name)
        with pytest.raises(VehicleRefusedError, match="nothing was armed"):
            await fly(plan, unseen_view(), told.extend)
        assert not stubs.vehicles[1].armed
    refused = {each.found for each in told if each.grade is Grade.REFUSE and each.subject == "vehicle 1"}
    assert refused >= {"it is not a multicopter", "its autopilot is an unknown autopilot"}
