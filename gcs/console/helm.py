"""The operator at the terminal of a flight: keys become commands, for the vehicles here and for those elsewhere."""

import asyncio
from collections.abc import Sequence
from random import randrange
from time import monotonic

from agents.shell.agent import Agent
from agents.shell.clock import MissionClock
from agents.team.messages import OperatorCommand, Verb
from gcs.console.keys import KeyMeaning

ORIGIN = "keys"
REPEAT_S, REPEATS = 0.2, 10


class Helm:
    """Commands the team by keys. Its own vehicles hear at once, the others over the bus, again and again for 2 s."""

    def __init__(self, agents: Sequence[Agent], clock: MissionClock) -> None:
        self._agents = agents
        self._clock = clock
        self._meaning = KeyMeaning()
        self._repeating: asyncio.Task[None] | None = None

    @property
    def hint(self) -> str:
        """What the keys are, or what is asked about the last one."""
        return self._meaning.hint(monotonic())

    def press(self, key: str) -> None:
        """Take a key."""
        verb = self._meaning.press(key, monotonic())
        if verb is not None:
            self._command(verb)

    def _command(self, verb: Verb) -> None:
        command = OperatorCommand(self._clock.now_s(), verb, None, ORIGIN, randrange(2**32))
        for agent in self._agents:
            agent.obey(command)
        if self._repeating is not None:
            self._repeating.cancel()
        self._repeating = asyncio.create_task(self._repeat(command))

    async def _repeat(self, command: OperatorCommand) -> None:
        for _ in range(REPEATS):
            self._agents[0].pass_on(command)
            await asyncio.sleep(REPEAT_S)
