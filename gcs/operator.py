"""An operator's word to a running team: joins its bus, says it, and watches what every vehicle makes of it."""

import asyncio
from collections.abc import Callable, Collection
from contextlib import suppress
from getpass import getuser
from random import randrange
from time import monotonic

from agents.messages import TOPICS, MemberState, OperatorCommand, Verb, decode, encode
from agents.ports import VehicleRefusedError
from agents.tactics import Tactic
from agents.zenoh_bus import ZenohBus
from gcs.mission import Mission

_OPERATOR_ID = 0
_HEARD_TIMEOUT_S = 3.0
_ANSWER_TIMEOUT_S = 4.0
_POLL_S = 0.02
_REPEAT_S = 0.2
_OBEYED: dict[str, tuple[str, ...]] = {
    "hold": (Tactic.HOLD.value,),
    "resume": (Tactic.FORMATION.value, Tactic.ENCIRCLE.value),
    "land": (Tactic.LAND.value,),
}


class Operator:
    """Speaks to the vehicles of one mission."""

    def __init__(self, mission: Mission) -> None:
        endpoints = [vehicle.section.endpoint for vehicle in mission.vehicles]
        self._bus = ZenohBus(_OPERATOR_ID, mission.network.team, connect=endpoints)
        self._heard: dict[int, MemberState] = {}
        self._number = randrange(2**32)

    async def command(self, verb: Verb, vehicles: Collection[int], vehicle: int | None) -> dict[int, float | None]:
        """Tell one vehicle, or all (None); return after how many seconds each of `vehicles` obeyed, None if it did not.

        Raises VehicleRefusedError when nobody of the team is heard.
        """
        await self._bus.open(self._hear, lambda *_: None)
        try:
            await self._until(lambda: bool(self._heard), _HEARD_TIMEOUT_S)
            if not self._heard:
                raise VehicleRefusedError(
                    f"no vehicle heard on the bus within {_HEARD_TIMEOUT_S:g} s",
                    "check that the team flies, and that --mission names its mission",
                )
            return await self._tell(verb, vehicles, vehicle)
        finally:
            await self._bus.close()

    async def _tell(self, verb: Verb, vehicles: Collection[int], vehicle: int | None) -> dict[int, float | None]:
        began_s, said_s = monotonic(), 0.0
        obeyed: dict[int, float | None] = dict.fromkeys(vehicles)
        while monotonic() - began_s < _ANSWER_TIMEOUT_S and None in obeyed.values():
            if monotonic() - said_s >= _REPEAT_S:
                said_s = monotonic()
                self._say(verb, vehicle)
            await asyncio.sleep(_POLL_S)
            for each in [each for each, after_s in obeyed.items() if after_s is None]:
                if each in self._heard and self._heard[each].tactic in _OBEYED[verb]:
                    obeyed[each] = monotonic() - began_s
        return obeyed

    def _say(self, verb: Verb, vehicle: int | None) -> None:
        # The team's clock may run faster than the wall's: the newest time heard is the only one to go by.
        now_s = max(state.time_s for state in self._heard.values())
        command = OperatorCommand(now_s, verb, vehicle, getuser()[:32], self._number)
        self._bus.publish(TOPICS[OperatorCommand].name, encode(command))

    def _hear(self, payload: bytes) -> None:
        with suppress(ValueError):
            message = decode(payload)
            if isinstance(message, MemberState):
                self._heard[message.sender] = message

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        end_s = monotonic() + timeout_s
        while not condition() and monotonic() < end_s:
            await asyncio.sleep(_POLL_S)
