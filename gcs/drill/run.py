"""A drill: injects faults into a flying team one after another, and judges its reactions."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import inf
from typing import Protocol

from agents.ports import VehicleRefusedError
from gcs.drill.faults import RESPACED_S, Drill
from gcs.drill.flight import DrillFlight
from gcs.drill.judge import OFFBOARD, ON_MISSION, Expectation, failures, reacted_s, respaced
from gcs.drill.mission import drill_mission, profiles_of
from gcs.drill.roles import Roles
from gcs.mission.file import parse_mission
from gcs.mission.mission import Mission

SPEED = inf
"""As fast as the computer can: the stubs' clock waits for the team, and for the messages of both."""
LINGER_S = 1.0
"""How long a reaction is observed, to check that it lasts."""
BACK_S, RETURNED_S = 6.0, 90.0
"""Time limits for messages, and for the vehicles' return to the mission."""

Change = tuple[str, str, object]


class Progress(Protocol):
    """Receives the progress of a drill."""

    def begin(self, step: str) -> None:
        """Report the step that begins now."""
        ...

    def add(self, row: "DrillRow") -> None:
        """Report a result."""
        ...


@dataclass(frozen=True, slots=True)
class DrillRow:
    """One line of the table: `limit_s` and `measured_s` on the clock of the reaction's grace time.

    `holds` is None for a drill that is not possible in this mission; `detail` states why, or the deviations.
    """

    fault: str
    expected: str
    limit_s: float | None
    measured_s: float | None
    holds: bool | None
    detail: str

    def to_dict(self) -> dict[str, object]:
        """Return it as a plain dict."""
        return asdict(self)


class DrillRun:
    """Flies a mission and injects faults; `fly` makes a flight from a mission's text and a speed.

    `changes` apply to the mission that is flown, not to the one that it is judged by: a control experiment flies with a
    reaction switched off.
    """

    def __init__(
        self,
        mission: str,
        fly: Callable[[str, float], DrillFlight],
        drills: Sequence[Drill],
        progress: Progress,
        *,
        speed: float = SPEED,
        changes: Sequence[Change] = (),
    ) -> None:
        self._mission = mission
        self._start = fly
        self._drills = drills
        self._progress = progress
        self._speed = speed
        self._changes = changes
        self.rows: list[DrillRow] = []

    async def run(self) -> list[DrillRow]:
        """Return a row for each drill; raises VehicleRefusedError if the team cannot fly at all."""
        judged_by = parse_mission(drill_mission(self._mission), None, profiles_of(self._mission))
        left = list(self._drills)
        while left:
            if unsuitable := left[0].unsuitable(judged_by):
                drill = left.pop(0)
                self._add(DrillRow(drill.fault, drill.expected, None, None, None, unsuitable))
                continue
            try:
                await self._fly(judged_by, left)
            except VehicleRefusedError as refusal:
                if not self.rows:
                    raise
                for drill in left:
                    self._add(DrillRow(drill.fault, drill.expected, None, None, False, refusal.reason))
                left.clear()
        return self.rows

    async def _fly(self, judged_by: Mission, left: list[Drill]) -> None:
        """Fly once, with as many of the remaining drills as this flight allows."""
        self._progress.begin("the team takes off")
        async with self._start(drill_mission(self._mission, self._changes), self._speed) as flight:
            roles = Roles(judged_by)
            await flight.reach_mission(roles.airborne, roles.tactic)
            while left and left[0].vehicles_min <= len(roles.airborne) and not left[0].unsuitable(judged_by):
                if not await self._drilled(left.pop(0), flight, roles):
                    return

    def _add(self, row: DrillRow) -> None:
        self.rows.append(row)
        self._progress.add(row)

    async def _drilled(self, drill: Drill, flight: DrillFlight, roles: Roles) -> bool:
        """Add a drill's row, and return whether the flight can continue."""
        expected = drill.expect(roles)
        if expected.is_reaction and not expected.reacting:
            row = DrillRow(
                drill.fault, drill.expected, None, None, None, "no vehicle encircles the target in this mission"
            )
            self._add(row)
            return True
        self._progress.begin(drill.fault)
        stuck = ""
        if drill.waits_for_spacing:
            await flight.until(lambda: respaced(roles.on_ring, flight.log), RESPACED_S)
        began_s = flight.now_s()
        flight.fail(drill.fault, roles)
        await flight.faults_taken()
        await self._watch(drill, expected, flight, began_s)
        failed = failures(expected, flight.log, began_s, flight.now_s())
        done_s = reacted_s(expected, flight.log, began_s)
        if not drill.ends_flight:
            flight.clear_faults()
            await flight.faults_taken()
            if drill.waits_for_estimate:
                quiet_s = (
                    roles.mission.vehicle(roles.subject).own_filter.gate_timeout_s + roles.mission.failsafe.settle_s
                )
                await flight.clock.sleep(quiet_s + LINGER_S)
            if drill.lands_subject:
                roles.landed.add(roles.subject)
            if stuck := await self._stuck(flight, roles):
                failed.append(f"did not return to the mission: {stuck}")
        self._add(self._row(drill, expected, None if done_s is None else done_s - began_s, failed))
        return not (drill.ends_flight or stuck)

    async def _watch(self, drill: Drill, expected: Expectation, flight: DrillFlight, began_s: float) -> None:
        """Observe until the reaction has happened or is overdue, and some time longer."""
        if expected.limit_s is None:
            await flight.clock.sleep(drill.watched_s)
            return
        await flight.until(lambda: reacted_s(expected, flight.log, began_s) is not None, expected.limit_s + LINGER_S)
        if drill.undo_after_s is not None:
            await flight.clock.sleep_until(began_s + drill.undo_after_s)
            flight.clear_faults()
            await flight.faults_taken()
            at_last = expected.at_last
            if at_last is not None:
                await flight.until(lambda: all(flight.log.tactic(i) == at_last for i in expected.reacting), BACK_S)
        if expected.respacing:
            await flight.until(lambda: respaced(expected.respacing, flight.log), RESPACED_S)
        await flight.clock.sleep(LINGER_S)

    async def _stuck(self, flight: DrillFlight, roles: Roles) -> str:
        """Command stopped vehicles to resume, and return those that do not return to their mission."""
        log = flight.log
        end_s = flight.now_s() + BACK_S + RETURNED_S

        def away() -> list[int]:
            return [
                i for i in roles.airborne if log.mode(i) != OFFBOARD or log.tactic(i) != roles.tactic(i) or log.alert(i)
            ]

        while away() and flight.now_s() < end_s:
            for each in [i for i in away() if log.tactic(i) not in ON_MISSION]:
                await flight.resume(each)
            await flight.until(lambda: not away(), LINGER_S)
        return "; ".join(f"vehicle {i}: {log.state(i)}" for i in away())

    def _row(self, drill: Drill, expected: Expectation, took_s: float | None, failed: list[str]) -> DrillRow:
        limit_s = expected.limit_s
        measured_s = took_s if expected.is_reaction else None
        if limit_s is not None and measured_s is not None and measured_s > limit_s:
            failed = [*failed, "too late"]
        return DrillRow(
            drill.fault,
            drill.expected,
            None if limit_s is None else round(limit_s, 2),
            None if measured_s is None else round(measured_s, 2),
            not failed,
            "; ".join(failed),
        )
