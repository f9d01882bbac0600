"""A drill: injects faults into a flying team one after another, and judges its reactions."""

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import inf, sqrt
from typing import Any, Protocol

import tomli_w
from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from agents.ports import VehicleRefusedError
from estimation.input_file import toml_content
from gcs.drill.faults import RESPACED_S, Drill, Roles
from gcs.drill.flight import DrillFlight
from gcs.drill.judge import OFFBOARD, ON_MISSION, Expectation, failures, reacted_s, respaced
from gcs.errors import InputError
from gcs.link.ports import free_ports
from gcs.metrics.json_output import json_output
from gcs.mission.file import load_mission, parse_mission
from gcs.mission.mission import Mission

_LOOPBACK = "127.0.0.1"
_Content = dict[str, Any]


def drill_mission(name: str, changes: Sequence[tuple[str, str, object]] = ()) -> str:
    """Return the text of the mission to fly; raises MissionError.

    `changes` are (section, key, value). The target starts near enough for vehicles to encircle it at once, which saves
    the wait for the ring, and a line that all leave for the ring moves on with it: a vehicle that a fault has moved out
    of the target's reach comes back to it in formation. If the mission forbids that, it is not changed.
    """
    mission = load_mission(name)
    if mission.rings:
        raise InputError([f"{name}: drills are flown on one ring, and the mission has {len(mission.rings)}"])
    content = toml_content(mission.text)
    _move_apart(content)
    for section, key, value in changes:
        content.setdefault(section, {})[key] = value
    near = {**content, "target": {**content["target"], "start_m": _near_m(mission)}}
    try:
        roles = Roles(parse_mission(tomli_w.dumps(near), None, mission.profile_texts))
        if roles.on_ring != roles.airborne or mission.target.legs:
            return tomli_w.dumps(near)
        abreast = {**near, "formation": {**near["formation"], "speed_m_s": max(mission.target.velocity_m_s[0], 0.0)}}
        parse_mission(tomli_w.dumps(abreast), None, mission.profile_texts)
    except InputError:
        return tomli_w.dumps(content)
    return tomli_w.dumps(abreast)


_INSIDE_M = 0.5


def _near_m(mission: Mission) -> list[float]:
    """Return the farthest position straight ahead at which the whole formation engages, also one that stands."""
    leader = mission.vehicle(mission.formation.leader)
    config = mission.agent_config(leader)
    reach_m = min(mission.target.sensor.range_m, *(each.decision.distance_max_m for each in mission.vehicles))
    slots_m = [config.slot_offset_m(each, leader.id) for each in mission.ids]
    if reach_m <= max(abs(aside_m) for _, aside_m in slots_m):
        return list(mission.target.start_m)
    x, y = config.line_start_m
    return [x + min(ahead_m + sqrt(reach_m**2 - aside_m**2) for ahead_m, aside_m in slots_m) - _INSIDE_M, y]


def _move_apart(content: _Content) -> None:
    """Set free ports for every vehicle, and a unique team name."""
    vehicles = content["vehicles"]
    ports = iter(free_ports(2 * len(vehicles)))
    for vehicle in vehicles:
        vehicle["url"] = f"udpin://{_LOOPBACK}:{next(ports)}"
        vehicle["endpoint"] = f"tcp/{_LOOPBACK}:{next(ports)}"
    network = content.setdefault("network", {})
    network.pop("security", None)  # cordon creates the keys of flights on one computer
    network["team"] = f"drill-{os.getpid()}"


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

    def add(self, row: "DrillRow") -> None:
        """Report a result."""


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
        judged_by = parse_mission(drill_mission(self._mission), None, load_mission(self._mission).profile_texts)
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


_VERDICTS = {True: Text("holds", style="green"), False: Text("FAILS", style="bold red"), None: Text("-", style="dim")}

_COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("fault", "left"),
    ("expected", "left"),
    ("within [s]", "right"),
    ("after [s]", "right"),
    ("verdict", "left"),
    ("", "left"),
)


class DrillProgress:
    """Prints a line when a drill begins and one when it ends."""

    def __init__(self, console: Console, total: int) -> None:
        self._console = console
        self._total = total
        self._done = 0

    def begin(self, step: str) -> None:
        """Show the step that begins now."""
        self._console.print(f"{self._done + 1} of {self._total}: {step} ...", style="dim", highlight=False)

    def add(self, row: DrillRow) -> None:
        """Show a result."""
        self._done += 1
        verdict = _VERDICTS[row.holds].plain
        took = "" if row.measured_s is None else f" after {row.measured_s:.2f} s"
        why = f": {row.detail}" if row.detail else ""
        self._console.print(f"    {row.expected}: {verdict}{took}{why}", markup=False, highlight=False, soft_wrap=True)


def drill_table(mission: str, rows: Sequence[DrillRow]) -> Table:
    """Return all results as a table."""
    table = Table(title=f"drills of {mission}", title_justify="left", title_style="bold", box=None, pad_edge=False)
    for name, justify in _COLUMNS:
        table.add_column(name, justify=justify)
    for row in rows:
        numbers = ("-" if value is None else f"{value:.2f}" for value in (row.limit_s, row.measured_s))
        table.add_row(row.fault, row.expected, *numbers, _VERDICTS[row.holds], Text(row.detail))
    return table


def drills_json(mission: str, rows: Sequence[DrillRow]) -> str:
    """Return all results as one JSON object."""
    holds = all(row.holds is not False for row in rows)
    return json_output({"mission": mission, "holds": holds, "drills": [asdict(row) for row in rows]})
