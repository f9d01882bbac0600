"""What may be wrong with a flying process, its agents' buses and their sensors; told through a Unix socket."""

import asyncio
import ctypes
import os
import random
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Literal

import msgspec

from agents.ports import PeerBus, TargetSensor
from agents.team.messages import OperatorCommand, decode
from estimation.state import Sighting
from gcs.flight.equipment import Equipment
from gcs.mission.mission import Mission, MissionVehicle

HANG_S = 6
"""For how long the process hangs when it is to: longer than any supervisor may wait."""

Hang = Literal["", "interpreter", "event loop", "exit"]


class Ailments(msgspec.Struct, frozen=True):
    """Everything that is to be wrong from now on; each replaces the one before.

    `loss` is the share of all messages that each agent does not hear, `delay_s` how much later it hears the others
    [wall s]; those of `unheard` are heard by no other vehicle. `blind` sensors see no target. A process may `hang`.
    """

    loss: float = 0.0
    delay_s: float = 0.0
    unheard: tuple[int, ...] = ()
    blind: bool = False
    hang: Hang = ""


class Patient:
    """The present ailments of this process, as they are told."""

    def __init__(self) -> None:
        self.now = Ailments()
        self.loop: asyncio.AbstractEventLoop | None = None

    def listen(self, path: str) -> None:
        """Tell this process's id, and obey what is told from then on, on a thread of its own."""
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(path)
        connection.sendall(b"%d\n" % os.getpid())
        threading.Thread(target=self._obey, args=(connection,), name="drill", daemon=True).start()

    def _obey(self, connection: socket.socket) -> None:
        with connection.makefile("rb") as lines:
            for line in lines:
                self.now = msgspec.json.decode(line, type=Ailments)
                self._hang(self.now.hang)
        os._exit(0)  # the drill is gone, and its vehicles with it

    def _hang(self, how: Hang) -> None:
        if how == "interpreter":
            ctypes.PyDLL(None).sleep(HANG_S)  # unlike CDLL, this keeps the lock: no thread of Python runs
        elif how == "event loop" and self.loop is not None:
            self.loop.call_soon_threadsafe(time.sleep, HANG_S)
        elif how == "exit":
            os._exit(0)


class FailingBus:
    """A bus between agents that loses, delays or keeps back what the others say; implements `agents.ports.PeerBus`."""

    def __init__(self, bus: PeerBus, patient: Patient, seed: int) -> None:
        self._bus = bus
        self._patient = patient
        self._chance = random.Random(seed)

    @property
    def alive(self) -> bool:
        """Whether the real one is."""
        return self._bus.alive

    async def open(self, on_message: Callable[[bytes], None], on_presence: Callable[[int, bool], None]) -> None:
        """Join."""
        loop = asyncio.get_running_loop()

        def hear(payload: bytes) -> None:
            ailments = self._patient.now
            if self._chance.random() < ailments.loss or _sender(payload) in ailments.unheard:
                return
            if ailments.delay_s > 0.0:
                loop.call_later(ailments.delay_s, on_message, payload)
            else:
                on_message(payload)

        await self._bus.open(hear, on_presence)

    def publish(self, topic: str, payload: bytes) -> None:
        """Send: what is lost is lost where it should be heard."""
        self._bus.publish(topic, payload)

    async def close(self) -> None:
        """Leave."""
        await self._bus.close()


class FailingSensor:
    """A sensor that may be blind; implements `agents.ports.TargetSensor`."""

    def __init__(self, sensor: TargetSensor, patient: Patient) -> None:
        self._sensor = sensor
        self._patient = patient

    def sight(self, now_s: float, position_m: tuple[float, float]) -> Sighting | None:
        """Return what the real one sees, unless it is blind."""
        sighting = self._sensor.sight(now_s, position_m)
        return None if self._patient.now.blind else sighting


class FailingEquipment(Equipment):
    """The mission's equipment, each piece with a patient's ailments."""

    def __init__(self, patient: Patient) -> None:
        self._patient = patient

    def bus(self, mission: Mission, vehicle: MissionVehicle) -> PeerBus:
        """Return a bus that can fail."""
        self._patient.loop = asyncio.get_running_loop()
        return FailingBus(super().bus(mission, vehicle), self._patient, vehicle.id)

    def sensor(self, mission: Mission, vehicle_id: int, start_s: float) -> TargetSensor:
        """Return a sensor that can fail."""
        return FailingSensor(super().sensor(mission, vehicle_id, start_s), self._patient)


def _sender(payload: bytes) -> int | None:
    with suppress(ValueError):
        message = decode(payload)
        return None if isinstance(message, OperatorCommand) else message.sender
    return None
