"""Waiting on the ground until an operator starts the vehicles, as agents on companion computers do."""

import asyncio
from collections.abc import Sequence

from gcs.flight.preparation.readiness import FIRST_REPORTS_S
from gcs.flight.team import Team
from gcs.preflight.findings import COMPUTER, MISSION, Finding, Grade

PERIOD_S = 3.0
"""Pause between two checks [wall s]: a start is refused by the findings of the newest."""


class StartWait:
    """Checks the vehicles of one team repeatedly, and lets each report what forbids its start."""

    def __init__(self, team: Team) -> None:
        self._team = team
        self._shown: list[str] = []

    async def findings(self) -> Sequence[Finding]:
        """Return the newest preflight findings once all are started, and record the facts behind them."""
        settle_s = FIRST_REPORTS_S
        while True:
            facts, computer = await asyncio.gather(self._team.facts(settle_s), self._team.computer())
            findings = self._team.plan.findings(facts, computer)
            self._wait(findings)
            settle_s = 0.0
            if await self._started():
                break
        self._team.view.update([], 0.0)
        for each in facts:
            self._team.meet(each)
        return findings

    def _wait(self, findings: Sequence[Finding]) -> None:
        """Let the vehicles that are not started yet report what they lack; show it when it has changed."""
        lines = []
        for member in self._team.members:
            if not member.agent.started.is_set():
                lacks = lacking(member.vehicle.id, findings)
                member.agent.wait_on_ground(lacks)
                lines.append(f"vehicle {member.vehicle.id} waits for its start: {lacks or 'ready'}")
        if lines != self._shown:
            self._shown = lines
            self._team.view.print_line("\n".join(lines))

    async def _started(self) -> bool:
        """Return whether all vehicles are started within a period."""
        waits = (member.agent.started.wait() for member in self._team.members)
        try:
            await asyncio.wait_for(asyncio.gather(*waits), PERIOD_S)
        except TimeoutError:
            return False
        return True


def lacking(vehicle_id: int, findings: Sequence[Finding]) -> str:
    """Return what forbids a vehicle's start, empty if nothing does: the first refusal that concerns it."""
    subjects = (MISSION, COMPUTER, f"vehicle {vehicle_id}")
    refusals = (each for each in findings if each.grade is Grade.REFUSE and each.subject in subjects)
    return next((f"{each.check}: {each.found}" for each in refusals), "")
