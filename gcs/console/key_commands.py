"""Keyboard commands in the terminal of a flight, for the vehicles of this process and of other processes."""

import asyncio
from collections.abc import Sequence
from random import randrange
from time import monotonic

from agents.shell.agent import Agent
from agents.shell.clock import MissionClock
from agents.shell.zenoh_bus import ZenohBus
from agents.team.messages import OperatorCommand, Verb, encode, topic_of
from gcs.console.keyboard import KeyBindings

REPEAT_S, REPEATS = 0.2, 10


class KeyCommands:
    """Sends a command to the team for each key.

    The agents of this process receive it directly; for all others it is repeated on the operator's bus for 2 s. A bus
    that is not open sends nothing.
    """

    def __init__(self, agents: Sequence[Agent], clock: MissionClock, bus: ZenohBus) -> None:
        self._agents = agents
        self._clock = clock
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
        command = OperatorCommand(self._clock.now_s(), verb, None, self._bus.participant.name, randrange(2**32))
        for agent in self._agents:
            agent.obey(command)
        if self._repeating is not None:
            self._repeating.cancel()
        self._repeating = asyncio.create_task(self._repeat(command))

    async def _repeat(self, command: OperatorCommand) -> None:
        for _ in range(REPEATS):
            self._bus.publish(topic_of(command), encode(command))
            await asyncio.sleep(REPEAT_S)
