"""The flying process's link to the program that operates it: its commands in, the team's states and events out."""

import asyncio
import os
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from math import isnan, nan
from multiprocessing import connection as pipes
from multiprocessing.connection import Connection
from queue import SimpleQueue
from random import randrange
from time import monotonic
from types import TracebackType
from typing import Self

from agents.flight_end import FlightEnd
from agents.outputs import CoreStatus
from agents.shell.outcome import Outcome
from agents.team.verbs import VERBS
from gcs.console.command_client import CommandResult
from gcs.console.rings import flown_ring, newest_commanded, ring_names
from gcs.flight.live.exchange import END, Answers, Asked, Begun, LiveVehicle, Message, News
from gcs.flight.team import FlightTeam, Member
from gcs.keys.identity import user_name

_PERIOD_S = 0.1
"""How often the team's state is sent [s of the mission clock]."""
_POLL_S = 0.02
_ANSWER_TIMEOUT_S, _DONE_TIMEOUT_S = 4.0, 12.0
"""How long the answer to a command is waited for [wall s]; the second of a kill as the autopilot confirms it."""
_UNREAD_MAX = 50
"""States that wait to be sent beyond this number, as to a program that is stopped, are left out."""
_ABANDONED = Outcome(FlightEnd.WATCHDOG, "the program that operated the flight had ended")


class ProgramLink:
    """The link to the program, to be used as a context manager around the flight.

    What is sent never waits for the program. Once that has ended, the vehicles hold, then land.
    """

    def __init__(self, connection: Connection, program_id: int) -> None:
        self._connection = connection
        self._program = _process_descriptor(program_id)
        self._outbox: SimpleQueue[Message | None] = SimpleQueue()
        self._sender = threading.Thread(target=self._send_all, name="to the program", daemon=True)
        self._commands: set[asyncio.Task[None]] = set()

    def __enter__(self) -> Self:
        self._sender.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Send what is left; a program that does not read it is waited for no longer than a command."""
        self._outbox.put(None)
        self._sender.join(_DONE_TIMEOUT_S)

    def send(self, message: Message) -> None:
        """Send a message to the program."""
        self._outbox.put(message)

    def follow(self, team: FlightTeam) -> None:
        """Take the program's orders to an equipped team from now on; to be called on its event loop."""
        loop = asyncio.get_running_loop()

        def listen() -> None:
            asked_to_end = False
            with suppress(RuntimeError):  # the event loop is closed: the flight is over
                while (order := self._received()) is not None:
                    if isinstance(order, Asked):
                        loop.call_soon_threadsafe(self._command, team, order)
                    elif order == END:
                        asked_to_end = True
                        loop.call_soon_threadsafe(team.stop.request)
                if not asked_to_end:  # a second request would mean: land at once
                    loop.call_soon_threadsafe(team.stop.request, _ABANDONED)

        threading.Thread(target=listen, name="from the program", daemon=True).start()

    async def report(self, team: FlightTeam) -> None:
        """Send the team's state and its events until cancelled, and once more then."""
        log = team.plan.log
        self.send(Begun(None if log is None else log.path))
        known = 0
        try:
            while True:
                if self._outbox.qsize() < _UNREAD_MAX:
                    known = self._report(team, known)
                await team.clock.sleep(_PERIOD_S)
        finally:
            self._report(team, known)

    def _report(self, team: FlightTeam, known: int) -> int:
        """Send the state, and the events after the `known` ones; return how many are known then."""
        events = team.journal.event_log.events
        clock_s, start_s = team.clock.now_s(), nan if team.start_s is None else team.start_s
        names = ring_names(team.plan.mission)
        rings = [each.commanded_rings for each in team.agents]
        news = News(
            clock_s,
            None if isnan(start_s) or clock_s < start_s else clock_s - start_s,
            {each.vehicle.id: _vehicle(each, team.newest.get(each.vehicle.id), names) for each in team.members},
            [replace(event, time_s=event.time_s - start_s) for event in events[known:]],
            [newest_commanded(rings, number) for number in range(max(1, len(names)))],
        )
        self.send(news)
        return len(events)

    def _command(self, team: FlightTeam, asked: Asked) -> None:
        task = asyncio.create_task(self._carry_out(team, asked))
        self._commands.add(task)
        task.add_done_callback(self._commands.discard)

    async def _carry_out(self, team: FlightTeam, asked: Asked) -> None:
        """Command the vehicles, and send their answers once each has answered or its time is over."""
        given, row = asked.given, VERBS[asked.verb]
        flying = [each for each in team.members if given.vehicle in (None, each.vehicle.id) and not each.ending]
        command = given.command(team.clock.now_s(), asked.verb, user_name(), randrange(2**32))
        began_s = monotonic()
        asked_ids = [each.vehicle.id for each in flying] if given.vehicle is None else [given.vehicle]
        answers: dict[int, CommandResult | None] = dict.fromkeys(asked_ids)
        for each in flying:
            each.agent.obey(command)
        end_s = began_s + (_DONE_TIMEOUT_S if row.done else _ANSWER_TIMEOUT_S)
        while monotonic() < end_s and flying and not all(each and each.is_final for each in answers.values()):
            await asyncio.sleep(_POLL_S)
            for each in flying:
                answer, before = each.agent.answer(command.key), answers[each.vehicle.id]
                if answer is not None and (before is None or before.did != answer.did):
                    after_s = monotonic() - began_s
                    answers[each.vehicle.id] = CommandResult(answer.did, after_s, answer.is_obeyed, answer.is_final)
        self.send(Answers(asked.number, answers))

    def _received(self) -> Asked | str | None:
        """Return the program's next order, None once it has ended."""
        watched: list[Connection | int] = [self._connection]
        if self._program is not None:
            watched.append(self._program)
        if self._connection not in pipes.wait(watched):
            return None
        try:
            order: Asked | str = self._connection.recv()
        except (EOFError, OSError):
            return None
        return order

    def _send_all(self) -> None:
        with suppress(OSError):  # the program has ended: the listening thread lands the vehicles
            while (message := self._outbox.get()) is not None:
                self._connection.send(message)


def _vehicle(member: Member, status: CoreStatus | None, names: Sequence[str]) -> LiveVehicle:
    motion, autopilot = member.link.motion, member.link.status
    polar = None if status is None else status.polar
    return LiveVehicle(
        member.vehicle.id,
        tactic="" if status is None else status.tactic.value,
        mode=autopilot.mode.value,
        armed=autopilot.armed,
        position_m=None if motion is None else motion.position_m,
        velocity_m_s=None if motion is None else motion.velocity_m_s,
        radius_m=None if polar is None else polar.radius_m,
        angular_rate_rad_s=None if polar is None else polar.angular_rate_rad_s,
        ring="" if status is None else flown_ring(status.tactic, status.ring, names),
        alert="" if status is None else status.alert,
        battery=autopilot.battery,
        ended=member.ending,
    )


def _process_descriptor(process_id: int) -> int | None:
    """Return what becomes readable when a process ends; None where the system has no such thing.

    A copy of the process, made by fork, may hold the pipe open for longer.
    """
    if not hasattr(os, "pidfd_open"):
        return None
    try:
        return os.pidfd_open(process_id)
    except OSError:  # it has ended: the pipe tells
        return None
