"""Keyboard commands in the terminal of a flight, for the vehicles of this process and of other processes."""

import asyncio
from collections.abc import Callable, Collection, Sequence
from random import randrange
from time import monotonic

from rich.text import Text

from agents.ports import PeerBus
from agents.shell.agent import Agent
from agents.shell.clock import MissionClock
from agents.team.messages import OperatorCommand
from gcs.console.keyboard.bindings import KeyBindings, KeyedCommand
from gcs.console.team_bus import send_command

REPEAT_S, REPEATS = 0.2, 10
_QUESTION = "bold white on red"


class KeyCommands:
    """Sends a command for each key, or once it is confirmed.

    The agents of this process receive it directly; for all others it is repeated for 2 s on `bus`, the bus of an
    operator. Without a bus, keys command the vehicles of this process only. `piloted` returns those that pilots fly.
    """

    def __init__(
        self,
        agents: Sequence[Agent],
        clock: MissionClock,
        operator: str,
        bus: PeerBus | None,
        bindings: KeyBindings,
        piloted: Callable[[], Collection[int]],
    ) -> None:
        self._agents = agents
        self._clock = clock
        self._operator = operator
        self._bus = bus
        self._bindings = bindings
        self._piloted = piloted
        self._repeating: dict[int | None, asyncio.Task[None]] = {}

    @property
    def hint(self) -> Text:
        """The keys and their commands, or the open question."""
        now_s = monotonic()
        return Text(self._bindings.hint(now_s), style=_QUESTION if self._bindings.asks(now_s) else "dim")

    def press(self, key: str) -> None:
        """Handle a key."""
        command = self._bindings.press("\n" if key == "\r" else key, monotonic(), self._piloted())
        if command is not None:
            self._send(command)

    def ignore_paste(self) -> None:
        """Ignore pasted text."""
        self._bindings.ignore_paste(monotonic())

    def _send(self, keyed: KeyedCommand) -> None:
        command = OperatorCommand(self._clock.now_s(), keyed.verb, keyed.vehicle, self._operator, randrange(2**32))
        for agent in self._agents:
            agent.obey(command)
        if self._bus is None:
            return
        # A superseded command must not arrive after the command that supersedes it.
        for receiver in [each for each in self._repeating if keyed.vehicle in (None, each)]:
            self._repeating.pop(receiver).cancel()
        self._repeating[keyed.vehicle] = asyncio.create_task(_repeat(self._bus, command))


async def _repeat(bus: PeerBus, command: OperatorCommand) -> None:
    for _ in range(REPEATS):
        send_command(bus, command)
        await asyncio.sleep(REPEAT_S)
