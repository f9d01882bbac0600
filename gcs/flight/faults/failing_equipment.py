"""Equipment of a flying process that can fail: the buses of its agents, and their sensors of the target."""

import asyncio
import random
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeVar

import msgspec

from agents.drops import Drops, Refusals
from agents.ports import PeerBus, TargetSensor
from agents.shell.clock import MissionClock
from agents.team.codec import decode, encode
from agents.team.messages import TOPICS, BusMessage, CommandAnswer, MemberState, OperatorCommand
from estimation.state import Sighting
from gcs.flight.equipment import Equipment
from gcs.flight.faults.team_faults import PresentFaults
from gcs.keys.team_keys import TeamKeys
from gcs.mission.mission import Mission, MissionVehicle

_Received = TypeVar("_Received")

FLOOD_HZ, _BURST_S, _FLOODED, _JUNK = 8000.0, 0.01, TOPICS[CommandAnswer].name, bytes(64)
"""A flood: its messages per second and the period of its bursts [s of the bus], its topic, and its payload."""
_SECOND_LATER_S = 0.01
"""Delay of a second source of a vehicle's messages after the first [s of the bus]."""
_HERE_M = (0.0, 0.0)


class FailingBus:
    """A vehicle's bus that loses, delays, withholds or falsifies messages; implements `agents.ports.PeerBus`."""

    def __init__(self, bus: PeerBus, clock: MissionClock, faults: PresentFaults, vehicle_id: int) -> None:
        self._bus = bus
        self._clock = clock
        self._present = faults
        self._vehicle_id = vehicle_id
        self._chance = random.Random(vehicle_id)
        self._flooding: asyncio.Task[None] | None = None

    @property
    def alive(self) -> bool:
        """Whether the real bus is alive."""
        return self._bus.alive

    @property
    def drops(self) -> Drops:
        """The messages that the real bus has dropped."""
        return self._bus.drops

    @property
    def operated(self) -> bool:
        """Whether an operator is on the real bus."""
        return self._bus.operated

    @property
    def operators_seen(self) -> int:
        """How often an operator has come to the real bus."""
        return self._bus.operators_seen

    @property
    def revoked(self) -> tuple[str, ...]:
        """The common names that were revoked on the real bus."""
        return self._bus.revoked

    @property
    def refusals(self) -> Refusals:
        """What the real bus has refused."""
        return self._bus.refusals

    @property
    def heads(self) -> Mapping[str, bytes]:
        """The heads that the real bus has received."""
        return self._bus.heads

    async def open(
        self,
        on_message: Callable[[BusMessage], None],
        on_sensor: Callable[[str, bytes], None],
        on_presence: Callable[[int, bool], None],
    ) -> None:
        """Join."""

        def receive(message: BusMessage) -> None:
            if _sender(message) not in self._present.now.not_received:
                self._delayed(on_message, message)

        await self._bus.open(receive, partial(self._delayed, on_sensor), on_presence)
        self._flooding = asyncio.create_task(self._flood())

    def _delayed(self, receive: Callable[..., None], *received: object) -> None:
        """Call a receiver after the present delay, unless the message is lost."""
        faults = self._present.now
        if self._chance.random() < faults.loss:
            return
        if faults.delay_s > 0.0:
            self._after(faults.delay_s, partial(receive, *received))
        else:
            receive(*received)

    def admit(self, vehicle_id: int) -> None:
        """Receive a vehicle that joins in flight."""
        self._bus.admit(vehicle_id)

    def publish(self, topic: str, payload: bytes) -> None:
        """Send a message, falsified here if a fault requires it; losses happen at the receiver."""
        faults = self._present.now
        offset_m = faults.position_offset_m.get(self._vehicle_id, _HERE_M)
        falsified = self._vehicle_id in faults.falsified_positions
        self._bus.publish(topic, _moved(payload, offset_m, 0.0) if falsified else payload)
        if self._vehicle_id in faults.impostors:
            second = _moved(payload, offset_m, _SECOND_LATER_S)
            self._after(_SECOND_LATER_S, partial(self._bus.publish, topic, second))

    async def close(self) -> None:
        """Leave."""
        if self._flooding is not None:
            self._flooding.cancel()
            await asyncio.gather(self._flooding, return_exceptions=True)
        await self._bus.close()

    def _after(self, delay_s: float, call: Callable[[], object]) -> None:
        """Make a call after a delay of the bus."""
        self._clock.call_at(self._clock.now_s() + delay_s * self._clock.time_scale, call)

    async def _flood(self) -> None:
        while True:
            await self._clock.sleep(_BURST_S * self._clock.time_scale)
            if self._vehicle_id in self._present.now.flooders:
                for _ in range(round(FLOOD_HZ * _BURST_S)):
                    self._bus.publish(_FLOODED, _JUNK)


class FailingSensor:
    """A sensor that may be blind; implements `agents.ports.TargetSensor`."""

    def __init__(self, sensor: TargetSensor, faults: PresentFaults) -> None:
        self._sensor = sensor
        self._present = faults

    def sight(self, now_s: float, position_m: tuple[float, float]) -> tuple[Sighting, ...]:
        """Return the sightings of the real sensor, none while it is blind."""
        sightings = self._sensor.sight(now_s, position_m)
        return () if self._present.now.blind else sightings


class FailingEquipment(Equipment):
    """The mission's equipment, with the faults that are present."""

    def __init__(self, faults: PresentFaults) -> None:
        self._present = faults

    def buses(
        self, mission: Mission, vehicles: Sequence[MissionVehicle], clock: MissionClock, keys: TeamKeys
    ) -> Mapping[int, PeerBus]:
        """Return buses that can fail."""
        self._present.loop = asyncio.get_running_loop()
        buses = super().buses(mission, vehicles, clock, keys)
        return {each: FailingBus(bus, clock, self._present, each) for each, bus in buses.items()}

    def sensor(self, mission: Mission, vehicle_id: int, start_s: float) -> TargetSensor:
        """Return a sensor that can fail."""
        return FailingSensor(super().sensor(mission, vehicle_id, start_s), self._present)


def _moved(payload: bytes, by_m: tuple[float, float], later_s: float) -> bytes:
    """Return a vehicle's state with another position and a later time; any other message unchanged."""
    message = decode(payload)
    if not isinstance(message, MemberState):
        return payload
    (x, y), (aim_x, aim_y) = message.position_m, message.aim_m
    elsewhere = msgspec.structs.replace(
        message,
        time_s=message.time_s + later_s,
        position_m=(x + by_m[0], y + by_m[1]),
        aim_m=(aim_x + by_m[0], aim_y + by_m[1]),
    )
    return encode(elsewhere)


def _sender(message: BusMessage) -> int | None:
    """Return the vehicle that sent a message, None for an operator's message."""
    return None if isinstance(message, OperatorCommand) else message.sender
