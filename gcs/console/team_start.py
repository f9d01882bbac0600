"""The start of a team whose agents wait on the ground: vehicles ready or missing, with reasons, and the command."""

import asyncio
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from agents.team.messages import BusMessage, StartProposal, VehicleReport
from gcs.console.command_client import CommandClient, CommandResult
from gcs.keys.identity import Identity
from gcs.mission.mission import Mission

_POLL_S = 0.1
_NO_AGENT = "no agent is on the bus: its computer is off, out of reach, or does not run its agent"
_NO_REPORT = "its agent is on the bus, but has not found its autopilot yet"
_OTHER_MISSION = "it has another mission, or another version of this one: copy one mission file to all computers"
_NOT_WAITING = "it is not waiting for the start: it runs its first checks, or runs without --wait-for-start"

State = Literal["ready", "flying", "missing"]


@dataclass(frozen=True, slots=True)
class StartState:
    """The state of one vehicle before the start: why it is missing, and its clock's offset to its peers' [s]."""

    vehicle: int
    state: State
    reason: str = ""
    clock_off_s: float | None = None


@dataclass(slots=True)
class StartReports:
    """The vehicles' reports received so far."""

    mission: Mission
    _reports: dict[int, VehicleReport] = field(default_factory=dict)
    _of_another: dict[int, bool] = field(default_factory=dict)

    def receive(self, message: BusMessage) -> None:
        """Process a message from the bus."""
        match message:
            case VehicleReport():
                self._reports[message.sender] = message
            case StartProposal(mission=flown) if flown is not None:
                self._of_another[message.sender] = flown != self.mission.identity
            case _:
                pass

    def states(self, present: Collection[int]) -> Sequence[StartState]:
        """Return the state of each vehicle; `present` are those on the bus."""
        return [self._state(each, present=each in present) for each in self.mission.ids]

    def _state(self, vehicle: int, *, present: bool) -> StartState:
        report = self._reports.get(vehicle)
        if not present:
            return StartState(vehicle, "missing", _NO_AGENT)
        if report is None:
            return StartState(vehicle, "missing", _NO_REPORT)
        if self._of_another.get(vehicle):
            return StartState(vehicle, "missing", _OTHER_MISSION)
        if report.ended:
            return StartState(vehicle, "missing", f"its flight has ended: {report.ended}")
        if report.start_blockers is not None:
            return StartState(
                vehicle, "missing" if report.start_blockers else "ready", report.start_blockers, report.clock_off_s
            )
        return StartState(vehicle, "flying") if report.armed else StartState(vehicle, "missing", _NOT_WAITING)


@dataclass(frozen=True, slots=True)
class StartResult:
    """The vehicles' states, and their answers to the start; no answers if it was not sent."""

    states: Sequence[StartState]
    answers: Mapping[int, CommandResult | None] = field(default_factory=dict)

    @property
    def started(self) -> bool:
        """Whether every vehicle takes off or is flying."""
        return bool(self.answers) and all(answer and answer.obeyed for answer in self.answers.values())


async def start_team(mission: Mission, operator: Identity, wait_s: float) -> StartResult:
    """Start the team once no vehicle is missing; after `wait_s` give up.

    Raises VehicleRefusedError if the bus cannot be joined, or the team flies another mission.
    """
    reports = StartReports(mission)
    client = CommandClient(mission, operator, reports.receive)
    try:
        await client.open()
        end_s = asyncio.get_running_loop().time() + wait_s
        while True:
            states = reports.states(client.present)
            complete = all(each.state != "missing" for each in states)
            if complete or asyncio.get_running_loop().time() >= end_s:
                break
            await asyncio.sleep(_POLL_S)
        return StartResult(states, await client.command("start", mission.ids, None) if complete else {})
    finally:
        await client.close()
