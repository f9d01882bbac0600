"""Flights whose commands, or the answers to them, are lost for longer than MAVSDK repeats them."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from math import isfinite
from typing import Any

import pytest

from agents.ports import FlightMode, Setpoint
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.profile.autopilots import AutopilotName
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from sitl.mavlink.commands import CommandId
from sitl.mavlink.protocol import MavlinkVehicle
from sitl.mavlink_constants import MessageId, Outgoing
from sitl.server.server import Stub, StubConfig
from tests.support.wire import LOOPBACK, free_port, served, until

pytestmark = pytest.mark.wire

SPEED = 2.0
"""What MAVSDK waits for an answer by the wall is twice as long for the vehicle: it disarms 10 s after arming."""
COMMANDS = {
    CommandId.COMPONENT_ARM_DISARM, CommandId.NAV_TAKEOFF, CommandId.DO_SET_MODE, CommandId.NAV_LAND,
}  # fmt: skip
PARAMETER = -1
LOST, PARAMETERS_LOST = 5, 7
"""One more than MAVSDK sends of each in a call that is not answered."""
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0))
PLANT = Plant(PlantAxis(0.8, 0.87), PlantAxis(0.8, 0.87))
HEIGHT_M = 3.0

Key = tuple[float, ...]


class Losses:
    """Loses the first so many of each command to the stubs of this process, or of the answers to each."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, commands: int = 0, answers: int = 0) -> None:
        self.lost = Counter[Key]()
        handle, send = MavlinkVehicle._handle, MavlinkVehicle._send

        def lossy_handle(vehicle: MavlinkVehicle, message: Any, time_s: float) -> list[Outgoing]:
            key = _key(message)
            count = PARAMETERS_LOST if key == (PARAMETER,) and commands else commands
            return [] if key and self._loses(key, count) else handle(vehicle, message, time_s)

        def lossy_send(vehicle: MavlinkVehicle, outgoing: Outgoing) -> None:
            number, fields = outgoing
            is_answer = number == MessageId.COMMAND_ACK and fields[0] in COMMANDS
            if not (is_answer and self._loses(fields[:1], answers)):
                send(vehicle, outgoing)

        monkeypatch.setattr(MavlinkVehicle, "_handle", lossy_handle)
        monkeypatch.setattr(MavlinkVehicle, "_send", lossy_send)

    def _loses(self, key: Key, count: int) -> bool:
        loses = self.lost[key] < count
        self.lost[key] += loses
        return loses


def _key(message: Any) -> Key:
    """Return what a command or parameter is about; empty for all others."""
    if message.get_type() == "PARAM_SET":
        return (PARAMETER,)
    if message.get_type() != "COMMAND_LONG" or message.command not in COMMANDS:
        return ()
    # What MAVSDK leaves out is NaN, which is unequal to itself.
    params = (each if isfinite(each) else 0.0 for each in (message.param1, message.param2, message.param3))
    return message.command, *params


@asynccontextmanager
async def linked(autopilot: AutopilotName) -> AsyncIterator[tuple[MavsdkLink, Stub]]:
    config = StubConfig(1, free_port(), PLANT, FRAME, autopilot=autopilot)
    async with served([config], SPEED) as here:
        hub = MavsdkHub(here.clock)
        link = MavsdkLink(hub, LinkConfig(f"udpin://{LOOPBACK}:{config.client_port}", 1, FRAME), here.clock)
        try:
            await link.connect(lambda _: None)
            yield link, here.stubs[1]
        finally:
            await link.close()
            await hub.close()


async def fly(link: MavsdkLink, stub: Stub) -> int:
    """Take off, enter offboard and land; return how many setpoints arrived while offboard was left."""
    await link.take_off(HEIGHT_M)
    assert stub.autopilot.armed
    link.send(Setpoint((0.0, 0.0, HEIGHT_M)))
    await link.start_offboard()
    before = stub.setpoints
    await link.stop_offboard()
    assert link.status.mode is FlightMode.HOLD
    arrived = stub.setpoints - before
    await link.land()
    assert not stub.autopilot.armed
    return arrived


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
async def test_a_flight_whose_commands_are_lost(autopilot: AutopilotName, monkeypatch: pytest.MonkeyPatch) -> None:
    losses = Losses(monkeypatch, commands=LOST)
    async with linked(autopilot) as (link, stub):
        assert await fly(link, stub) > 0, "the failsafe acts without setpoints"
    assert {int(key[0]) for key in losses.lost} == COMMANDS | ({PARAMETER} if autopilot == "px4" else set())


async def test_a_flight_whose_answers_are_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    # This autopilot refuses to take off again once it climbs.
    losses = Losses(monkeypatch, answers=LOST)
    async with linked("ardupilot") as (link, stub):
        await fly(link, stub)
    assert {int(key[0]) for key in losses.lost} == COMMANDS


async def test_what_a_call_does_after_it_was_cancelled_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    losses = Losses(monkeypatch, commands=2)
    async with linked("ardupilot") as (link, stub):
        arming = (CommandId.COMPONENT_ARM_DISARM, 1.0, 0.0, 0.0)
        taking_off = asyncio.create_task(link.take_off(HEIGHT_M))
        await until(lambda: losses.lost[arming] > 0, waiting_for="the command to arm")
        taking_off.cancel()
        await asyncio.wait([taking_off])
        assert not link.status.armed
        await link.catch_up()
        assert stub.autopilot.armed
        assert link.status.armed
        assert stub.autopilot.landed
