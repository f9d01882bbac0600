"""An operator's word to a running team: joins its bus, says it, and listens to what every vehicle made of it."""

import asyncio
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from getpass import getuser
from random import randrange
from socket import gethostname
from time import monotonic

import msgspec

from agents.orders import final, obeyed
from agents.ports import VehicleRefusedError
from agents.settings.shapes import Shape
from agents.shell.zenoh_bus import ZenohBus
from agents.team.messages import (
    TOPICS,
    CommandAnswer,
    MemberState,
    OperatorCommand,
    Verb,
    decode,
    encode,
)
from agents.team.perception import TOPIC, Seen, encode_seen
from gcs.mission.mission import Mission

_OPERATOR_ID = 0
_HEARD_TIMEOUT_S = 3.0
_ALL_HEARD_WITHIN_S = 0.5
"""How long one waits for the last of the team once the first was heard: a command must not wait for the dead."""
_ANSWER_TIMEOUT_S = 4.0
_KILL_TIMEOUT_S = 12.0
"""That it is disarmed is heard by heartbeat, and a kill that is not heard of is tried again."""
_POLL_S = 0.005
_REPEAT_S = 0.1
_POINTED_OUT_S = 0.5
_ORIGIN_LENGTH = 32


@dataclass(frozen=True, slots=True)
class Answer:
    """What a vehicle did about a command, and how long after it was first said that was heard [wall s]."""

    did: str
    after_s: float

    @property
    def obeyed(self) -> bool:
        """Whether the vehicle does as it was told."""
        return obeyed(self.did)


class Operator:
    """Speaks to the vehicles of one mission."""

    def __init__(self, mission: Mission) -> None:
        endpoints = [vehicle.section.endpoint for vehicle in mission.vehicles]
        self._bus = ZenohBus(_OPERATOR_ID, mission.network.team, connect=endpoints)
        self._vehicles = mission.ids
        self._time_s: dict[int, float] = {}
        self._present: set[int] = set()
        self._number = randrange(2**32)
        self._answers: dict[int, Answer] = {}
        self._said_s = 0.0
        self.joined_after_s = 0.0
        """How long it took to join the bus and hear the team, before anything was said."""

    async def command(
        self, verb: Verb, vehicles: Collection[int], vehicle: int | None, shape: Shape | None = None
    ) -> dict[int, Answer | None]:
        """Tell one vehicle, or all (None); return the answer of each of `vehicles`, None where it gave none in time.

        Raises VehicleRefusedError when nobody of the team is there.
        """
        try:
            await self._join(vehicles)
            return await self._tell(verb, vehicles, vehicle, shape)
        finally:
            await self._bus.close()

    async def point_out(self, seen: Seen, lasting_s: float) -> Collection[int]:
        """Tell the whole team where the target is, again and again for a while; return who is there to hear it.

        Raises VehicleRefusedError when nobody of the team is there.
        """
        try:
            await self._join(self._vehicles)
            end_s = monotonic() + lasting_s
            while True:
                # Said twice it counts once: a sighting of the same moment is a repeat.
                payload = encode_seen(msgspec.structs.replace(seen, time_s=self._team_s))
                for _ in range(2):
                    self._bus.publish(TOPIC, payload)
                    await asyncio.sleep(_REPEAT_S)
                if monotonic() >= end_s:
                    return self._time_s.keys() | self._present
                await asyncio.sleep(_POINTED_OUT_S - 2.0 * _REPEAT_S)
        finally:
            await self._bus.close()

    async def _join(self, vehicles: Collection[int]) -> None:
        began_s = monotonic()
        await self._bus.open(self._hear, self._see)
        await self._until(lambda: bool(self._time_s or self._present), _HEARD_TIMEOUT_S)
        if not (self._time_s or self._present):
            raise VehicleRefusedError(
                f"no vehicle heard on the bus within {_HEARD_TIMEOUT_S:g} s",
                "check that the team flies, and that --mission names its mission",
            )
        await self._until(lambda: self._time_s.keys() >= set(vehicles), _ALL_HEARD_WITHIN_S)
        self.joined_after_s = monotonic() - began_s

    async def _tell(
        self, verb: Verb, vehicles: Collection[int], vehicle: int | None, shape: Shape | None
    ) -> dict[int, Answer | None]:
        self._said_s = monotonic()
        end_s = self._said_s + (_KILL_TIMEOUT_S if verb == "kill" else _ANSWER_TIMEOUT_S)
        said_s = 0.0
        while monotonic() < end_s and not all(self._is_done(verb, each) for each in vehicles):
            if monotonic() - said_s >= _REPEAT_S:
                said_s = monotonic()
                self._say(verb, vehicle, shape)
            await asyncio.sleep(_POLL_S)
        return {each: self._answers.get(each) for each in vehicles}

    def _is_done(self, verb: Verb, vehicle: int) -> bool:
        return vehicle in self._answers and final(verb, self._answers[vehicle].did)

    def _say(self, verb: Verb, vehicle: int | None, shape: Shape | None) -> None:
        command = OperatorCommand(self._team_s, verb, vehicle, _origin(), self._number, shape)
        self._bus.publish(TOPICS[OperatorCommand].name, encode(command))

    @property
    def _team_s(self) -> float:
        # The team's clock may run faster than the wall's: the newest time heard is the best to go by. Vehicles that
        # have not yet flown tell no time.
        return max(self._time_s.values(), default=time.time())

    def _see(self, vehicle_id: int, present: bool) -> None:
        if vehicle_id != _OPERATOR_ID:
            (self._present.add if present else self._present.discard)(vehicle_id)

    def _hear(self, payload: bytes) -> None:
        with suppress(ValueError):
            message = decode(payload)
            if isinstance(message, MemberState):
                self._time_s[message.sender] = message.time_s
            if isinstance(message, CommandAnswer) and message.number == self._number:
                before = self._answers.get(message.sender)
                if before is None or before.did != message.did:
                    self._answers[message.sender] = Answer(message.did, monotonic() - self._said_s)

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        end_s = monotonic() + timeout_s
        while not condition() and monotonic() < end_s:
            await asyncio.sleep(_POLL_S)


def _origin() -> str:
    """Return who says it, and on which computer."""
    try:
        user = getuser()
    except (OSError, KeyError, ImportError):  # nobody that the system knows
        user = "operator"
    return f"{user}@{gethostname()}"[:_ORIGIN_LENGTH]
