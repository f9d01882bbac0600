"""Keyboard commands in the terminal of a flight, for the vehicles of this process and of other processes."""

import asyncio
from collections.abc import Sequence
from random import randrange
from time import monotonic

from agents.ports import PeerBus
from agents.shell.agent import Agent
from agents.shell.clock import MissionClock
from agents.team.messages import OperatorCommand, Verb
from gcs.console.keyboard import KeyBindings
from gcs.console.team_bus import send_command

REPEAT_S, REPEATS = 0.2, 10


class KeyCommands:
    """Sends a command to the team for each key.

    The agents of this process receive it directly; for all others it is repeated for 2 s on `bus`, the bus of an
    operator. Without one, keys command the vehicles of this process only.
    """

    def __init__(self, agents: Sequence[Agent], clock: MissionClock, operator: str, bus: PeerBus | None) -> None:
        self._agents = agents
        self._clock = clock
        self._operator = operator
        self._bus = bus
        self._bindings = KeyBindings()
        self._repeating: asyncio.Task[None] | None = None

    @property
    def hint(self) -> str:
        """The keys and their commands, or the request to confirm a kill."""
        return self._bindings.hint(monotonic())

    def press(self, key: str) -> None:
        """Handle a key."""
        verb = self._bindings.press(key, monotonic())
        if verb is not None:
            self._command(verb)

    def _command(self, verb: Verb) -> None:
        command = OperatorCommand(self._clock.now_s(), verb, None, self._operator, randrange(2**32))
        for agent in self._agents:
            agent.obey(command)
        if self._repeating is not None:
            self._repeating.cancel()
        if self._bus is not None:
            self._repeating = asyncio.create_task(_repeat(self._bus, command))


async def _repeat(bus: PeerBus, command: OperatorCommand) -> None:
    for _ in range(REPEATS):
        send_command(bus, command)
        await asyncio.sleep(REPEAT_S)
