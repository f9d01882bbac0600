"""Waiting on the ground for vehicles that are about to be ready."""

import asyncio
import time
from collections.abc import Awaitable, Sequence
from math import inf

from agents.ports import VehicleRefusedError
from gcs.checklist import Checklist
from gcs.flight.team import FlightTeam
from gcs.flightlog.audit import ticked
from gcs.preflight.findings import COMPUTER, MISSION, Finding, Grade, Subject, subjects_text
from gcs.preflight.preflight import worst

FIRST_REPORTS_S = 3.0
"""A ready vehicle reports everything within this time: home once a second, health twice [wall s]."""
PERIOD_S = 1.0
_TICKED_EVERY_S = 0.3
REMINDED_EVERY_S = 30.0
"""How often a wait for the checklist says what is open [wall s]."""
_TICK_IT = (
    "waiting for the checklist, nothing is armed: tick it on the operator's page (--station, or `cordon station`); "
    "Ctrl-C ends the wait, and --checklist-done NAME says that it is done"
)


Feasible = Awaitable[Sequence[Finding]]


class Readiness:
    """The wait for one team, at most `plan.wait_s` wall seconds from now; shows the start blockers.

    `feasible` returns the findings about the mission alone; it is awaited before each check.
    """

    def __init__(self, team: FlightTeam, feasible: Feasible) -> None:
        self._team = team
        self._feasible = feasible
        self._end_s = time.monotonic() + team.plan.wait_s
        self._shown: set[tuple[str, str]] = set()

    async def measure_speed(self) -> None:
        """Set the clock to the autopilots' speed; raises VehicleRefusedError where it cannot be measured in time."""
        while True:
            try:
                return await self._team.measure_speed()
            except VehicleRefusedError as refusal:
                if self._left_s <= 0.0:
                    raise
                self._show([f"waiting, {self._left_s:.0f} s left: {refusal.reason}"], {("", refusal.reason)})

    async def findings(self) -> Sequence[Finding]:
        """Return the preflight findings, and record the facts behind them.

        While only the vehicles' readiness forbids take-off, they are checked again. Once they are ready, or if
        something else forbids take-off, one more check decides: on a busy computer clocks and rates vary.
        """
        settle_s, decides = FIRST_REPORTS_S, False
        while True:
            facts, computer = await asyncio.gather(self._team.facts(settle_s), self._team.computer())
            findings = self._team.plan.findings(facts, computer, await self._feasible)
            blockers = about_to_pass(findings)
            well = worst(findings) is not Grade.REFUSE
            if self._left_s <= 0.0 or (not blockers and (decides or (well and not self._shown))):
                break
            settle_s, decides = min(PERIOD_S, self._left_s), not blockers
            if blockers:
                lines = [f"waiting until these are ready, {self._left_s:.0f} s left:", *blocker_lines(blockers)]
                self._show(lines, {(each.subject, each.check) for each in blockers})
            elif self._shown and self._team.plan.speed is None and not self._team.plan.is_governed:
                await self.measure_speed()
        if self._shown:
            self._team.view.update([], 0.0)
        for each in facts:
            self._team.begin_vehicle(each)
        return findings

    @property
    def _left_s(self) -> float:
        return max(0.0, self._end_s - time.monotonic())

    def _show(self, lines: Sequence[str], blockers: set[tuple[str, str]]) -> None:
        """Show the start blockers: on a terminal always, elsewhere when they have changed."""
        if self._team.view.is_live:
            self._team.view.update([], 0.0, "\n".join(lines))
        elif blockers != self._shown:
            self._team.view.print_line("\n".join(lines))
        self._shown = blockers


class ChecklistWait:
    """The wait until people have ticked the required items of the mission's checklist; `--wait 0` forbids it.

    It has no other limit: people take their time. It says what is open when that changes, and every
    `REMINDED_EVERY_S`. Nothing is armed while it lasts; Ctrl-C ends it.
    """

    def __init__(self, team: FlightTeam, checklist: Checklist) -> None:
        self._team = team
        self._checklist = checklist

    async def done(self) -> None:
        """Wait, note the ticks in the audit log, and use them up.

        Raises InputError where they cannot be read, VehicleRefusedError for open items of a flight that does not wait.
        """
        shown, shown_s = list[str](), -inf
        while open_items := await asyncio.to_thread(self._checklist.open):
            if self._team.plan.wait_s == 0.0:
                texts = "; ".join(item.text for item in open_items)
                step = "tick it on the operator's page, or use --checklist-done NAME"
                raise VehicleRefusedError(f"the checklist is not done: {texts}", step)
            lines = [f"  [ ] {item.text}" for item in open_items]
            if lines != shown or time.monotonic() - shown_s >= REMINDED_EVERY_S:
                shown, shown_s = lines, time.monotonic()
                self._team.view.print_line("\n".join([_TICK_IT, *lines]))
            await asyncio.sleep(_TICKED_EVERY_S)
        ticks = await asyncio.to_thread(self._checklist.use)
        for number, (item, tick) in enumerate(zip(self._checklist.items, ticks, strict=True), start=1):
            if tick is not None:
                self._team.recording.note_run(ticked(self._team.clock.now_s(), number, tick, item.text))
                self._team.view.print_line(f"checklist: {item.text}: {tick.by}")


def about_to_pass(findings: Sequence[Finding]) -> Sequence[Finding]:
    """Return the refusals if waiting may resolve all of them, otherwise none."""
    refused = [each for each in findings if each.grade is Grade.REFUSE]
    return refused if all(each.temporary for each in refused) else []


def blocker_lines(blockers: Sequence[Finding]) -> list[str]:
    """Return a line for each start blocker, with the vehicles concerned."""
    subjects: dict[str, list[Subject]] = {}
    for each in blockers:
        subjects.setdefault(each.found, []).append(each.about)
    return [f"  {subjects_text(named)}: {found}" for found, named in subjects.items()]


CHECK_AGAIN_S = 3.0
"""Pause between two checks [wall s]: a start is refused by the findings of the newest."""


class StartWait:
    """Checks the vehicles of one team repeatedly, and lets each report what forbids its start.

    `feasible` is as in `Readiness`.
    """

    def __init__(self, team: FlightTeam, feasible: Feasible) -> None:
        self._team = team
        self._feasible = feasible
        self._shown: list[str] = []

    async def findings(self) -> Sequence[Finding]:
        """Return the newest preflight findings once all are started, and record the facts behind them."""
        settle_s = FIRST_REPORTS_S
        while True:
            facts, computer = await asyncio.gather(self._team.facts(settle_s), self._team.computer())
            findings = self._team.plan.findings(facts, computer, await self._feasible)
            self._wait(findings)
            settle_s = 0.0
            if await self._started():
                break
        self._team.view.update([], 0.0)
        for each in facts:
            self._team.begin_vehicle(each)
        return findings

    def _wait(self, findings: Sequence[Finding]) -> None:
        """Let the vehicles that are not started yet report their start blockers; show them when they have changed."""
        lines = []
        for member in self._team.members:
            if not member.agent.started.is_set():
                blockers = start_blockers(member.vehicle.id, findings)
                member.agent.wait_on_ground(blockers)
                lines.append(f"vehicle {member.vehicle.id} waits for its start: {blockers or 'ready'}")
        if lines != self._shown:
            self._shown = lines
            self._team.view.print_line("\n".join(lines))

    async def _started(self) -> bool:
        """Return whether all vehicles are started within a period."""
        waits = (member.agent.started.wait() for member in self._team.members)
        try:
            await asyncio.wait_for(asyncio.gather(*waits), CHECK_AGAIN_S)
        except TimeoutError:
            return False
        return True


def start_blockers(vehicle_id: int, findings: Sequence[Finding]) -> str:
    """Return what forbids a vehicle's start, empty if nothing does: the first refusal that concerns it."""
    subjects = (MISSION, COMPUTER, vehicle_id)
    refusals = (each for each in findings if each.grade is Grade.REFUSE and each.about in subjects)
    return next((f"{each.check}: {each.found}" for each in refusals), "")
