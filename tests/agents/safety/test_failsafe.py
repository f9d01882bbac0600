"""The failsafe table, row by row through a whole core: when it reacts, how, who is told, and how it is left again."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.control.lmpc import QpStatus
from agents.control.plan import Plan
from agents.core import VehicleCore
from agents.drops import Drops
from agents.inputs import AutopilotStatus, Bus, Computer, LateTicks, Message, Presence, Start, TacticEvent, TimeScale
from agents.outputs import CoreStatus, TickOutput
from agents.ports import Connection, ModeSource, Reference, VehicleStatus
from agents.safety.failsafe import TABLE, Condition, Reaction
from agents.safety.failsafe_monitor import COUNTED_MIN_S, COUNTED_SHARE
from agents.safety.guard import GuardStatus
from agents.settings.config import AgentConfig
from agents.settings.sections import ChoreographySettings, FailsafeSettings, NoFlySection
from agents.situation.task import Task
from agents.tactics import Event, Tactic
from agents.team.codec import decode
from agents.team.messages import Aircraft, MemberState, NextChange, OperatorCommand, Outlook
from agents.team.team import GONE_S
from agents.team.verbs import Verb
from estimation.plant.model import exact_step
from estimation.plant.watch import Difference, PlantComparison
from estimation.state import POSITION, Sighting, Telemetry, Vector
from tests.support.solver import UNSOLVED

Maker = Callable[..., AgentConfig]

PERIOD_S = 0.1
HEIGHT_M = 8.0
ONSET_S = 8.0
"""When the fault begins: by then everything is known, and nothing was wrong."""
ESCALATION_S = 6.0
FENCE_X_M = 0.2 * ONSET_S
CEILING_M = 9.0
CLIMBS_M = 1.0
"""A height that changes by more within a period has jumped."""
LOOKS_S = 0.2
"""What is measured is looked at once a second, and next so long after the onset."""
DRIFT_S, DRIFTED_S = 0.1, 0.56
"""A clock gains so much a second, until it has gained so much."""
# No two alike, so that no row can take another's.
SETTINGS = FailsafeSettings(
    escalation_s=ESCALATION_S,
    settle_s=3.0,
    battery_s=4.0,
    fence_s=0.6,
    separation_s=0.4,
    plan_s=1.3,
    bus_lost_s=2.2,
    peers_silent_s=3.4,
    peer_silent_s=2.6,
    late_s=1.8,
    estimator_s=2.8,
    following_s=1.1,
    tilt_s=0.9,
    wind_s=1.5,
    clock_s=1.5,
    no_operator="hold",
    no_operator_s=3.2,
)


class Flight:
    """Vehicle 3 of a line of three: follows the leader, 2, or is on the ring; faults can be switched on and off."""

    def __init__(self, config: AgentConfig, *, on_ring: bool = False, time_scale: float = 1.0) -> None:
        self.core = VehicleCore(config, lambda _: self)
        self.core.take(TimeScale(time_scale))
        self.core.take(Start(0.0))
        self.plant = config.plant
        self.time_scale = time_scale
        self.motion: Vector = np.array([0.0, -5.0, 0.2, 0.0])
        self.ticks = 0
        self.outputs: list[TickOutput] = []
        self.on_ring = on_ring
        self.peers = {1: "formation", 2: "formation"}
        self.peer_alert = ""
        self.telemetry = True
        self.offset_m = 0.0
        self.target_m: tuple[float, float] | None = (6.0, -5.0) if on_ring else None
        self.battery: float | None = 0.9
        self.wind = np.zeros(2)
        self.plan_fails = False
        self.close = False
        self.peer_height_m = HEIGHT_M
        self.late_ticks = 0
        self.bus = True
        self.operated = True
        self.clock_ahead_s = 0.0
        self.second_source = False
        self.outside_m: tuple[float, float] | None = None
        self.flood = 0
        self.refused = 0
        self.clock_drifts = False
        self.height_m = self.flown_m = HEIGHT_M
        self.reports: dict[str, Any] = {}
        self.short_of = ""
        self.aircraft_m: float | None = None

    def plan(self, task: Task) -> Plan | None:
        """Plan in cordon's place while plans fail: stay, as a plan without a solution."""
        place_m = task.situation.own.mean[POSITION]
        return Plan(place_m, place_m, np.zeros(2), QpStatus.FALLBACK) if self.plan_fails else None

    @property
    def now_s(self) -> float:
        return self.ticks * PERIOD_S

    @property
    def status(self) -> CoreStatus:
        return self.outputs[-1].status

    @property
    def told(self) -> MemberState:
        """The state that was sent last, a moment ago."""
        said = [each.messages[0] for each in self.outputs[-3:] if each.messages]
        message = decode(said[-1].payload)
        assert isinstance(message, MemberState)
        return message

    def notes(self, since_s: float = 0.0, kind: str = "failsafe") -> list[str]:
        notes = (note for output in self.outputs for note in output.status.notes)
        return [note.text for note in notes if note.kind == kind and note.time_s >= since_s - 1e-9]

    def told_to(self, verb: Verb, number: int = 1) -> None:
        self.core.take(Message(self.now_s, OperatorCommand(self.now_s, verb, None, "pat", number)))

    def fly(self, until_s: float) -> list[TickOutput]:
        before = len(self.outputs)
        while self.now_s < until_s - 1e-6:
            self._step()
        return self.outputs[before:]

    def _step(self) -> None:
        now_s, core = self.now_s, self.core
        if self.clock_drifts:
            self.clock_ahead_s = min(self.clock_ahead_s + DRIFT_S * PERIOD_S, DRIFTED_S)
        x, y, x_rate, y_rate = self.motion.tolist()
        if self.telemetry:
            self.flown_m += min(max(self.height_m - self.flown_m, -CLIMBS_M), CLIMBS_M)
            core.take(Telemetry(now_s, (x + self.offset_m, y, self.flown_m), (x_rate, y_rate, 0.0)))
        for peer, tactic in self.peers.items():
            core.take(Message(now_s, self._said_by(peer, tactic)))
        if self.target_m is not None:
            core.take(Sighting(now_s, 3, self.target_m, (0.01, 0.0, 0.01), 0.8, 0.2))
        if self.outside_m is not None:
            core.take(Sighting(now_s, 1000, self.outside_m, (0.01, 0.0, 0.01), 0.8, 0.2))
        if self.second_source:
            said = self._said_by(1, "formation")
            forged = msgspec.structs.replace(said, time_s=now_s - 0.05, position_m=(said.position_m[0], 25.0))
            core.take(Message(now_s, forged))
        reports = self.reports
        if self.aircraft_m is not None:
            reports = reports | {"traffic": (Aircraft("HB-XYZ", now_s, (x, y - self.aircraft_m), (0.2, 0.0)),)}
        core.take(AutopilotStatus(VehicleStatus(connected=True, armed=True, battery=self.battery, **reports)))
        self.refused += self.flood // int(self.time_scale)  # floods come by the wall's clock
        core.take(Drops(too_many=self.refused))
        core.take(LateTicks(self.late_ticks))
        core.take(Bus(self.bus, self.operated))
        core.take(Computer(self.short_of))
        output = core.tick(now_s)
        self.outputs.append(output)
        wanted = (x, y) if output.setpoint is None else output.setpoint.position_m[:2]
        wanted = wanted[0] - self.offset_m, wanted[1]
        self.motion = exact_step(self.plant, PERIOD_S).advance(self.motion, np.array(wanted), self.wind)
        self.ticks += 1

    def _said_by(self, peer: int, tactic: str) -> MemberState:
        place = 0.2 * self.now_s, {1: 5.0, 2: 0.0}[peer]
        if peer == 1 and self.close:
            place = float(self.motion[0]), float(self.motion[1]) + 0.5
        dated_s = self.now_s + (self.clock_ahead_s * self.time_scale if peer == 1 else 0.0)
        ahead = place[0] + 0.2 * self.plant.x.a1_per_s / self.plant.x.a0_per_s2, place[1]
        alert, height_m = self.peer_alert if peer == 1 else "", self.peer_height_m
        return MemberState(peer, dated_s, tactic, place, (0.2, 0.0), ahead, (0.2, 0.0), height_m, alert=alert)


def set_to(**values: object) -> Callable[[Flight], None]:
    def change(flight: Flight) -> None:
        for name, value in values.items():
            setattr(flight, name, value)

    return change


def reporting(**values: object) -> Callable[[Flight], None]:
    return set_to(reports=values)


def peers(*ids: int) -> Callable[[Flight], None]:
    return set_to(peers=dict.fromkeys(ids, "formation"))


def jump(flight: Flight) -> None:
    flight.offset_m += 5.0


def target_jump(flight: Flight) -> None:
    assert flight.target_m is not None
    flight.target_m = flight.target_m[0], flight.target_m[1] - 9.0


def nothing(_flight: Flight) -> None:
    pass


@dataclass(frozen=True)
class Case:
    """How a condition comes about and ends, after how long it is met, and by which tactics, one after another.

    `wall` conditions count on the wall's clock. `grave` is the tactic on the way down, `over_s` how long it takes to be
    found to be over.
    """

    begin: Callable[[Flight], None]
    end: Callable[[Flight], None]
    after_s: float
    tactics: tuple[Tactic, ...]
    on_ring: bool = False
    wall: bool = False
    grave: Tactic = Tactic.RETURN_AND_LAND
    over_s: float = 0.3


def taken_over(**reports: Any) -> Case:
    def take_over(flight: Flight) -> None:
        flight.core.take(TacticEvent(Event.HANDED_OVER))
        flight.reports.update(reports)  # the autopilot may say why later

    override = Tactic.PILOT_OVERRIDE
    return Case(take_over, nothing, 0.0, (override, override), grave=override)


def unlike_its_profile(difference: Difference | None) -> Callable[[Flight], None]:
    def change(flight: Flight) -> None:
        found = None if difference is None else PlantComparison(6, 0.3, 0.1, flight.plant, difference, is_unfed=False)
        flight.core._vehicle.plant.found = found

    return change


AS_BEFORE: tuple[Tactic, ...] = (Tactic.FORMATION,)
HOLDS = (Tactic.HOLD, Tactic.LAND)
LEAVES = (Tactic.ASIDE, Tactic.HOLD, Tactic.LAND)
CASES = {
    Condition.TELEMETRY_STALE: Case(
        set_to(telemetry=False), set_to(telemetry=True), 1.0, HOLDS, wall=True, grave=Tactic.LAND
    ),
    Condition.ESTIMATOR_JUMPED: Case(jump, nothing, 1.1, (Tactic.HOLD, Tactic.HOLD)),
    Condition.ORIGIN_MOVED: Case(
        reporting(reference=Reference(moves=1, moved_m=(8.0, 0.0, -2.0))), nothing, 0.0, (Tactic.HOLD, Tactic.HOLD)
    ),
    Condition.SETPOINTS_LOST: Case(reporting(lost=Connection.SETPOINTS), reporting(), 0.0, (Tactic.HOLD, Tactic.HOLD)),
    Condition.REMOTE_CONTROL_LOST: taken_over(lost=Connection.REMOTE_CONTROL),
    Condition.GROUND_STATION_LOST: taken_over(lost=Connection.GROUND_STATION),
    Condition.AUTOPILOT_FAILSAFE: taken_over(mode_by=ModeSource.FAILSAFE),
    Condition.PILOT_TOOK_OVER: taken_over(mode_by=ModeSource.PILOT),
    Condition.MODE_CHANGED: taken_over(),
    Condition.BATTERY_CRITICAL: Case(set_to(battery=0.08), set_to(battery=0.5), 4.0, (Tactic.LAND,), grave=Tactic.LAND),
    Condition.BATTERY_LOW: Case(
        set_to(battery=0.18), set_to(battery=0.5), 4.0, (Tactic.RETURN_AND_LAND, Tactic.RETURN_AND_LAND)
    ),
    Condition.NO_WAY_HOME: Case(
        reporting(endurance_s=20.0), reporting(), LOOKS_S + 4.0, (Tactic.RETURN_AND_LAND, Tactic.RETURN_AND_LAND)
    ),
    Condition.ESTIMATOR_FAILING: Case(
        reporting(estimator_ratio=1.2, estimator_sensor="height"), reporting(), 2.8, HOLDS, grave=Tactic.LAND
    ),
    # It takes the plant 1.4 s to be 3 of the 6 m away that this wind pushes it at last.
    Condition.NOT_FOLLOWING: Case(
        set_to(wind=np.array([0.0, 6.0 * 0.8])), set_to(wind=np.zeros(2)), LOOKS_S + 2.0 + 1.1, HOLDS, grave=Tactic.LAND
    ),
    Condition.TILTED: Case(reporting(tilt_deg=36), reporting(tilt_deg=34), 0.9, HOLDS, grave=Tactic.LAND),
    Condition.WINDY: Case(reporting(wind_m_s=12.1), reporting(wind_m_s=12.0), 1.5, HOLDS, grave=Tactic.LAND),
    # The line leads it out at the onset; the wind blows it back in.
    Condition.FENCE_LEFT: Case(nothing, set_to(wind=np.array([-0.6, 0.0])), 0.6, HOLDS),
    Condition.ZONE_ENTERED: Case(nothing, set_to(wind=np.array([-0.6, 0.0])), 0.6, HOLDS),
    Condition.ALTITUDE_LEFT: Case(set_to(height_m=CEILING_M + 1.2), set_to(height_m=CEILING_M), LOOKS_S + 0.6, HOLDS),
    Condition.TOO_CLOSE: Case(set_to(close=True), set_to(close=False), 0.4, LEAVES),
    Condition.TARGET_STALE: Case(set_to(target_m=None), set_to(target_m=(6.0, -5.0)), 4.0, HOLDS, on_ring=True),
    # Once it has left the ring, the target may jump as it likes.
    Condition.TARGET_JUMPED: Case(target_jump, nothing, 2.1, (Tactic.ASIDE, Tactic.ASIDE), on_ring=True),
    # Once it has left the line, there is no plan to fail.
    Condition.PLAN_FAILING: Case(set_to(plan_fails=True), set_to(plan_fails=False), 1.3, (Tactic.ASIDE, Tactic.ASIDE)),
    Condition.BUS_LOST: Case(set_to(bus=False), set_to(bus=True), 2.2, LEAVES, wall=True),
    Condition.PEERS_SILENT: Case(peers(), peers(1, 2), 3.4, LEAVES, wall=True),
    Condition.LATE_TICKS: Case(set_to(late_ticks=1), set_to(late_ticks=0), 1.8, AS_BEFORE + LEAVES, wall=True),
    Condition.BUS_FLOODED: Case(set_to(flood=30), set_to(flood=0), 0.5, AS_BEFORE * 3, wall=True),
    Condition.CLOCK_STEPPED: Case(set_to(clock_ahead_s=0.7), set_to(clock_ahead_s=0.0), 1.5, AS_BEFORE * 3, wall=True),
    # What is usual follows by a tenth with each message, and has passed 0.5 s after 6 s.
    Condition.CLOCK_DRIFTED: Case(
        set_to(clock_drifts=True), set_to(clock_drifts=False, clock_ahead_s=0.3), 6.0 + 1.5, AS_BEFORE * 3, over_s=1.3
    ),
    Condition.LINK_DEGRADED: Case(
        reporting(link_fault="34% of its messages are lost"), reporting(), 0.0, AS_BEFORE * 3
    ),
    Condition.TRAFFIC_NEAR: Case(set_to(aircraft_m=30.0), set_to(aircraft_m=90.0), 0.0, AS_BEFORE * 3),
    Condition.GIMBAL_FAILED: Case(reporting(gimbal_fault="system 255 controls it"), reporting(), 0.0, AS_BEFORE * 3),
    Condition.BATTERY_WARNING: Case(reporting(battery_fault="battery 0 low"), reporting(), 4.0, AS_BEFORE * 3),
    Condition.STATUS_STALE: Case(reporting(stale="battery"), reporting(), 0.0, AS_BEFORE * 3),
    Condition.ESTIMATOR_DEGRADED: Case(reporting(satellites=5), reporting(satellites=6), 2.8, AS_BEFORE * 3),
    Condition.COMPUTER_SHORT: Case(set_to(short_of="memory"), set_to(short_of=""), 0.0, AS_BEFORE * 3),
    Condition.LEADER_LOST: Case(peers(1), peers(1, 2), 2.6, AS_BEFORE * 3, wall=True),
    Condition.PEER_SILENT: Case(peers(2), peers(1, 2), 2.6, AS_BEFORE * 3, wall=True),
    # The third contradiction counts: two places in turn in one vehicle's name. It lasts until 5 s after the last one.
    Condition.PEER_DOUBTFUL: Case(
        set_to(second_source=True), set_to(second_source=False), 2.0, AS_BEFORE * 3, over_s=5.4
    ),
    Condition.SIGHTINGS_CONTRADICT: Case(
        set_to(target_m=(25.0, -5.0), outside_m=(40.0, -5.0)), set_to(outside_m=None), 2.1, AS_BEFORE * 3, over_s=5.4
    ),
    Condition.TARGET_FROM_OUTSIDE: Case(
        set_to(outside_m=(40.0, -5.0)), set_to(target_m=(40.0, -5.0)), 0.0, AS_BEFORE * 3
    ),
    Condition.STIFFER: Case(unlike_its_profile("stiffer"), unlike_its_profile(None), LOOKS_S, AS_BEFORE * 3),
    Condition.SOFTER: Case(unlike_its_profile("softer"), unlike_its_profile(None), LOOKS_S, AS_BEFORE * 3),
    Condition.NO_OPERATOR: Case(
        set_to(operated=False), set_to(operated=True), 3.2, (Tactic.HOLD, Tactic.HOLD), wall=True
    ),
}
BY_THE_SHELL = {Condition.OPERATOR_LOST}
"""Ended by a signal, see the test at the end."""
GRACE_S = {row.condition: getattr(SETTINGS, row.grace.partition(".")[2], 0.0) for row in TABLE} | {
    Condition.TARGET_STALE: 4.0
}
STICKY = [condition for condition, case in CASES.items() if case.tactics[0] in (Tactic.HOLD, Tactic.ASIDE)]
PASSING = [condition for condition, case in CASES.items() if case.tactics[0] is Tactic.FORMATION]


def by_name(condition: Condition) -> str:
    return condition.name.lower()


@pytest.fixture
def make_flight(make_config: Maker) -> Callable[..., Flight]:
    """Return a maker of flights that are healthy so far, just before the onset."""

    def make(
        condition: Condition | None,
        *,
        time_scale: float = 1.0,
        going_home: bool = False,
        heard: tuple[int, ...] = (1, 2),
    ) -> Flight:
        on_ring = condition is not None and CASES[condition].on_ring
        config = make_config(
            vehicle_id=3,
            failsafe=SETTINGS,
            target_filter={"stale_after_s": 4.0},
            own_filter={"disturbance_max_m_s2": 0.05},
            choreography=ChoreographySettings(layer_m=3.0, landing="return"),
            home_m=(-60.0, -5.0),
            layers_from_m=HEIGHT_M,
            safety={"guard": False, "fence_m": corners(FENCE_X_M)}
            if condition is Condition.FENCE_LEFT
            else {"guard": False, "no_fly": (NoFlySection(name="beyond", polygon_m=BEYOND),)}
            if condition is Condition.ZONE_ENTERED
            else {
                "guard": condition is Condition.TOO_CLOSE,
                "altitude_max_m": CEILING_M if condition is Condition.ALTITUDE_LEFT else None,
                "traffic_distance_m": 40.0 if condition is Condition.TRAFFIC_NEAR else 0.0,
            },
        )
        flight = Flight(config, on_ring=on_ring, time_scale=time_scale)
        peers(*heard)(flight)
        flight.fly(ONSET_S - 1.0)
        if going_home:
            flight.core.take(TacticEvent(Event.END))
        flight.fly(ONSET_S)
        expected = Tactic.RETURN_AND_LAND if going_home else Tactic.ENCIRCLE if on_ring else Tactic.FORMATION
        assert (flight.status.tactic, flight.status.alert, flight.notes()) == (expected, "", [])
        return flight

    return make


def corners(x_m: float) -> tuple[tuple[float, float], ...]:
    return (-90.0, -90.0), (x_m, -90.0), (x_m, 90.0), (-90.0, 90.0)


BEYOND = ((FENCE_X_M, -90.0), (90.0, -90.0), (90.0, 90.0), (FENCE_X_M, 90.0))
"""A zone that begins where the fence ends."""


def reaction_s(flight: Flight, condition: Condition, until_s: float) -> float:
    """Fly until the alert is told, and return how long after the onset that was."""
    while flight.core.alert != condition.value:
        assert flight.now_s < until_s, "never detected"
        flight.fly(flight.now_s + PERIOD_S)
    return flight.now_s - PERIOD_S - ONSET_S


def test_every_condition_has_one_row_and_every_row_a_case() -> None:
    assert sorted(row.condition.name for row in TABLE) == sorted(condition.name for condition in Condition)
    assert set(CASES) | BY_THE_SHELL == set(Condition)
    assert {row.condition for row in TABLE if row.shell} == BY_THE_SHELL


def check_announcements(flown: list[TickOutput], condition: Condition, scale: float = 1.0) -> None:
    """Every change by itself is announced before, and comes when it was announced.

    Grace times below two seconds are too short to be read.
    """
    grace_s = GRACE_S.get(condition, 0.0)
    for before, after in pairwise(flown):
        by_itself = after.status.tactic is not before.status.tactic
        taken_over = after.status.tactic is Tactic.PILOT_OVERRIDE
        first = before.status.tactic in (Tactic.FORMATION, Tactic.ENCIRCLE)
        if by_itself and not taken_over and not (first and grace_s < COUNTED_MIN_S):
            assert before.status.outlook is not None
            change = before.status.outlook.next
            assert change is not None
            assert (change.tactic, change.cause) == (after.status.tactic.value, condition.value)
            assert change.at_s == pytest.approx(after.status.time_s, abs=PERIOD_S)
            announced_s = [
                each.status.time_s for each in flown if each.status.outlook and each.status.outlook.next == change
            ]
            known_s = max(COUNTED_SHARE * grace_s, GONE_S if condition is Condition.PEERS_SILENT else 0.0)
            notice_s = scale * (grace_s - known_s if first else ESCALATION_S)
            assert change.at_s - announced_s[0] == pytest.approx(notice_s, abs=3.0 * PERIOD_S)
    last = flown[-1].status.outlook
    assert last is None or last.next is None, "nothing is announced that does not come"


@pytest.mark.parametrize("condition", CASES, ids=by_name)
def test_it_is_met_after_its_grace_and_announced_and_by_graver_reactions_as_it_persists(
    condition: Condition, make_flight: Callable[..., Flight]
) -> None:
    case, flight = CASES[condition], make_flight(condition)
    before = flight.status.tactic
    case.begin(flight)
    quiet = flight.fly(ONSET_S + case.after_s - 0.15)
    assert {output.status.tactic for output in quiet} <= {before}
    assert condition.value not in {output.status.alert for output in quiet}
    flown = quiet + flight.fly(ONSET_S + case.after_s + 0.15)
    assert flight.status.tactic is case.tactics[0]
    assert flight.status.alert == condition.value
    assert (flight.told.tactic, flight.told.alert) == (case.tactics[0].value, condition.value)
    assert [note for note in flight.notes() if note.startswith(f"{condition.value}: ")]
    for step, tactic in enumerate(case.tactics):
        reached_s = ONSET_S + case.after_s + step * ESCALATION_S
        flown += flight.fly(reached_s + 0.15)
        assert flight.status.tactic is tactic
        steady = flight.fly(reached_s + ESCALATION_S - 0.15) if step + 1 < len(case.tactics) else []
        assert {output.status.tactic for output in steady} <= {tactic}
        flown += steady
    check_announcements(flown + flight.fly(flight.now_s + 1.0), condition)


@pytest.mark.parametrize("condition", CASES, ids=by_name)
def test_what_comes_over_a_link_is_borne_by_the_wall_and_the_rest_by_the_vehicles_own_time(
    condition: Condition, make_flight: Callable[..., Flight]
) -> None:
    case, flight = CASES[condition], make_flight(condition, time_scale=5.0)
    case.begin(flight)
    after_s = 5.0 * case.after_s if case.wall else case.after_s
    assert reaction_s(flight, condition, ONSET_S + 25.0) == pytest.approx(after_s, abs=0.2)


@pytest.mark.parametrize("condition", [Condition.TELEMETRY_STALE, Condition.PEERS_SILENT, Condition.LATE_TICKS])
def test_what_is_borne_by_the_wall_is_announced_by_it(condition: Condition, make_flight: Callable[..., Flight]) -> None:
    case, flight = CASES[condition], make_flight(condition, time_scale=3.0)
    case.begin(flight)
    flown = flight.fly(ONSET_S + 3.0 * (case.after_s + 3.0 * ESCALATION_S) + 1.0)
    assert flight.status.tactic is case.tactics[-1]
    check_announcements(flown, condition, 3.0)


@pytest.mark.parametrize("condition", STICKY, ids=by_name)
def test_it_is_left_by_resume_alone_and_only_once_it_is_over(
    condition: Condition, make_flight: Callable[..., Flight]
) -> None:
    case, flight = CASES[condition], make_flight(condition)
    reaction = case.tactics[0]
    case.begin(flight)
    flight.fly(ONSET_S + case.after_s + 0.15)
    # Nothing is planned any more once it has stepped aside: then the plan is what does not last. Who resumes a vehicle
    # is an operator, see the test below.
    lasts = condition not in (Condition.PLAN_FAILING, Condition.NO_OPERATOR)
    if lasts:
        said_s = flight.now_s
        flight.told_to("resume")
        flight.fly(flight.now_s + 0.2)
        assert flight.status.tactic is reaction
        (refusal,) = flight.notes(said_s - PERIOD_S, kind="command")
        assert refusal.startswith(f"resume by pat: refused: {condition.value}")
    case.end(flight)
    after = flight.fly(flight.now_s + 6.0)
    assert {output.status.tactic for output in after} == {reaction}, "it stays"
    assert (flight.told.tactic, flight.told.alert) == (reaction.value, condition.value)
    assert f"{condition.value}: cleared; resume continues the mission" in flight.notes()
    flight.told_to("resume", 2)
    flight.fly(flight.now_s + 0.3)
    assert flight.status.tactic in (Tactic.FORMATION, Tactic.ENCIRCLE)
    assert flight.told.alert == ""


RESUMING = (
    Condition.TELEMETRY_STALE,
    Condition.SETPOINTS_LOST,
    Condition.BUS_LOST,
    Condition.PEERS_SILENT,
    Condition.LATE_TICKS,
)
"""Links and computers: what they leave behind is known once they are back."""
RESUME_S = 2.5


def resuming(make_config: Maker, **changes: object) -> Flight:
    """Return a healthy flight that may resume by itself, just before the onset."""
    settings = SETTINGS.model_copy(update={"resume": "auto", "resume_s": RESUME_S, **changes})
    flight = Flight(make_config(vehicle_id=3, failsafe=settings, safety={"guard": False}))
    flight.fly(ONSET_S)
    return flight


@pytest.mark.parametrize("condition", [*RESUMING, Condition.ESTIMATOR_FAILING, Condition.TILTED, Condition.WINDY])
def test_where_the_mission_says_so_a_vehicle_resumes_by_itself_after_what_leaves_nothing_in_doubt(
    condition: Condition, make_config: Maker
) -> None:
    assert {row.condition for row in TABLE if row.resumes} == set(RESUMING)
    case, flight = CASES[condition], resuming(make_config)
    case.begin(flight)
    late_s = ESCALATION_S if condition is Condition.LATE_TICKS else 0.0
    flight.fly(ONSET_S + case.after_s + late_s + 0.3)
    assert flight.status.tactic in (Tactic.ASIDE, Tactic.HOLD)
    case.end(flight)
    over_s = flight.now_s
    stopped = flight.fly(over_s + RESUME_S - 0.3)
    assert Tactic.FORMATION not in {each.status.tactic for each in stopped}
    resumes = condition in RESUMING
    outlook = stopped[-1].status.outlook
    assert outlook is not None
    assert outlook.waits_for_resume
    announced = None if outlook.next is None else (outlook.next.tactic, outlook.next.cause)
    assert announced == (("formation", f"{condition.value} is over") if resumes else None)
    flown = flight.fly(over_s + RESUME_S + 20.0)
    assert (flight.status.tactic.value == "formation") is resumes
    if resumes:
        assert outlook.next is not None
        resumed_s = next(each.status.time_s for each in flown if each.status.tactic is Tactic.FORMATION)
        assert resumed_s == pytest.approx(over_s + RESUME_S, abs=0.3)
        assert resumed_s == pytest.approx(outlook.next.at_s, abs=PERIOD_S)
        assert (flight.told.alert, flight.status.outlook) == ("", None)


def test_a_vehicle_resumes_by_itself_three_times_and_then_waits_for_its_operator(make_config: Maker) -> None:
    flight = resuming(make_config)
    tactics = []
    for _ in range(5):
        flight.telemetry = False
        flight.fly(flight.now_s + 2.0)
        assert flight.status.tactic is Tactic.HOLD
        flight.telemetry = True
        flight.fly(flight.now_s + RESUME_S + 2.0)
        tactics.append(flight.status.tactic)
    assert tactics == [Tactic.FORMATION] * 3 + [Tactic.HOLD] * 2
    assert flight.status.outlook == Outlook(waits_for_resume=True)
    flight.told_to("resume")
    flight.fly(flight.now_s + 0.3)
    assert flight.status.tactic is Tactic.FORMATION


@pytest.mark.parametrize("here", [False, True], ids=["over the bus", "at this computer"])
@pytest.mark.parametrize("held_s", [-1.0, 3.0])
def test_what_an_operator_has_stopped_before_or_after_resumes_by_the_operator_alone(
    held_s: float, here: bool, make_config: Maker
) -> None:
    flight = resuming(make_config)
    faults = ((0.0, set_to(telemetry=False)), (2.0, set_to(telemetry=True)))
    stop = (held_s, lambda each: each.core.take(TacticEvent(Event.HOLD)) if here else each.told_to("hold"))
    for at_s, act in sorted((*faults, stop), key=lambda pair: pair[0]):
        flight.fly(ONSET_S + 1.0 + at_s)
        act(flight)
    flown = flight.fly(ONSET_S + 12.0)
    assert Tactic.FORMATION not in {each.status.tactic for each in flown}


def test_a_position_that_has_jumped_meanwhile_is_the_operators_to_judge(make_config: Maker) -> None:
    flight = resuming(make_config)
    flight.telemetry = False
    flight.fly(ONSET_S + 2.0)
    flight.telemetry = True
    jump(flight)
    flown = flight.fly(ONSET_S + 20.0)
    assert {each.status.tactic for each in flown} == {Tactic.HOLD}
    assert flight.status.outlook is not None
    assert flight.status.outlook.waits_for_resume


def test_a_vehicle_that_stopped_before_the_start_resumes_by_itself_not_before_it(make_config: Maker) -> None:
    settings = SETTINGS.model_copy(update={"resume": "auto", "resume_s": RESUME_S})
    flight = Flight(make_config(vehicle_id=3, failsafe=settings, safety={"guard": False}))
    flight.core.take(Start(15.0))
    flight.fly(3.0)
    flight.telemetry = False
    flight.fly(5.0)
    assert flight.status.tactic is Tactic.HOLD
    flight.telemetry = True
    flown = flight.fly(20.0)
    resumed_s = next(each.status.time_s for each in flown if each.status.tactic is Tactic.FORMATION)
    assert resumed_s == pytest.approx(15.0, abs=PERIOD_S)


@pytest.mark.parametrize(
    ("policy", "tactic"),
    [("go_on", Tactic.FORMATION), ("hold", Tactic.HOLD), ("return", Tactic.RETURN_AND_LAND)],
)
def test_the_mission_chooses_what_is_done_without_an_operator(policy: str, tactic: Tactic, make_config: Maker) -> None:
    config = make_config(
        vehicle_id=3,
        failsafe=SETTINGS.model_copy(update={"no_operator": policy}),
        choreography=ChoreographySettings(layer_m=3.0, landing="return"),
        home_m=(-60.0, -5.0),
        layers_from_m=HEIGHT_M,
    )
    flight = Flight(config)
    flight.operated = False
    flight.fly(2.0 * SETTINGS.no_operator_s)
    assert flight.notes() == [], "before the first operator none is missed"
    flight.operated = True
    flight.fly(flight.now_s + 1.0)
    flight.operated = False
    flight.fly(flight.now_s + SETTINGS.no_operator_s + 1.0)
    assert flight.status.tactic is tactic
    assert len(flight.notes()) == (0 if policy == "go_on" else 1)
    flight.operated = True
    flight.fly(flight.now_s + 1.0)
    assert flight.status.tactic is tactic, "an operator who is back changes nothing"
    cleared = [note for note in flight.notes() if note.endswith("cleared; resume continues the mission")]
    assert len(cleared) == (0 if policy == "go_on" else 1)


def test_an_operator_may_resume_before_the_bus_shows_one(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(Condition.NO_OPERATOR)
    flight.operated = False
    flight.fly(flight.now_s + SETTINGS.no_operator_s + 1.0)
    assert flight.status.tactic is Tactic.HOLD
    flight.told_to("resume")
    flight.operated = True
    flight.fly(flight.now_s + 5.0)
    assert (flight.status.tactic, flight.told.alert) == (Tactic.FORMATION, "")


@pytest.mark.parametrize("condition", PASSING, ids=by_name)
def test_what_is_only_told_ends_by_itself(condition: Condition, make_flight: Callable[..., Flight]) -> None:
    case, flight = CASES[condition], make_flight(condition)
    case.begin(flight)
    flight.fly(ONSET_S + case.after_s + 1.0)
    assert flight.told.alert == condition.value
    case.end(flight)
    flight.fly(flight.now_s + case.over_s)
    assert flight.told.alert == ""
    began, over = flight.notes()
    assert began.startswith(f"{condition.value}: ")
    assert began.endswith("fly on and report")
    assert over == f"{condition.value}: cleared"
    assert {output.status.tactic for output in flight.outputs} == {Tactic.FORMATION}


DESCENTS = {(CASES[row.condition].tactics[0], row.descending): row.condition for row in TABLE if not row.shell}
"""A condition of each reaction in flight and in a descent."""


def test_what_a_descent_becomes_is_in_the_table() -> None:
    lands = {row.condition for row in TABLE if Reaction.LAND in (row.descending, row.reactions[0])}
    assert lands == {condition for condition, case in CASES.items() if case.grave is Tactic.LAND}


@pytest.mark.parametrize("condition", DESCENTS.values(), ids=by_name)
def test_nothing_turns_a_descent_into_hovering(condition: Condition, make_flight: Callable[..., Flight]) -> None:
    case, flight = CASES[condition], make_flight(condition, going_home=True)
    case.begin(flight)
    down = flight.fly(ONSET_S + case.after_s + 2.0)
    assert {output.status.tactic for output in down} <= {Tactic.RETURN_AND_LAND, case.grave}
    assert flight.status.tactic is case.grave


def test_a_fault_that_passes_within_its_grace_time_is_announced_once_half_of_it_is_over(
    make_flight: Callable[..., Flight],
) -> None:
    flight = make_flight(Condition.BATTERY_LOW)
    flight.battery = 0.18
    flown = flight.fly(ONSET_S + 3.5)
    flight.battery = 0.5
    flown += flight.fly(ONSET_S + 8.0)
    counted_s = [each.status.time_s - ONSET_S for each in flown if each.status.outlook is not None]
    assert (counted_s[0], counted_s[-1]) == pytest.approx((2.0, 3.4), abs=0.05)


def test_what_refuses_a_resume_is_told_where_another_condition_stopped_the_vehicle_and_when_it_lands(
    make_flight: Callable[..., Flight],
) -> None:
    """A GPS jump: the position has settled, and the estimator still rejects it."""
    flight = make_flight(Condition.ESTIMATOR_JUMPED)
    jump(flight)
    reporting(estimator_ratio=1.2, estimator_sensor="position")(flight)
    flight.fly(ONSET_S + 6.0)
    assert "estimator jumped: cleared" in flight.notes(), "and no word of a resume"
    outlook = flight.status.outlook
    assert outlook is not None
    assert (flight.told.alert, outlook.blocks, outlook.also) == (
        "estimator failing",
        "estimator failing",
        ("estimator jumped", "estimator degraded"),
    )
    flight.told_to("resume")
    lands_s = ONSET_S + SETTINGS.estimator_s + ESCALATION_S
    flown = flight.fly(flight.now_s + PERIOD_S)
    (refusal,) = (note for note in flight.notes(kind="command") if "refused" in note)
    assert refusal.endswith(f"estimator failing: position rejected (test ratio 1.2); lands in {ceil(lands_s - 14.0)} s")
    flown += flight.fly(lands_s + 1.0)
    landed_s = next(each.status.time_s for each in flown if each.status.tactic is Tactic.LAND)
    assert landed_s == pytest.approx(lands_s, abs=PERIOD_S)


def test_a_vehicle_whose_condition_is_over_waits_for_a_resume_and_one_whose_operator_held_it_does_not(
    make_flight: Callable[..., Flight],
) -> None:
    flight = make_flight(Condition.TELEMETRY_STALE)
    flight.core.take(TacticEvent(Event.HOLD))
    flight.fly(ONSET_S + 1.0)
    assert flight.status.outlook is None
    flight.telemetry = False
    flight.fly(ONSET_S + 3.0)
    assert flight.status.outlook is not None
    assert not flight.status.outlook.waits_for_resume
    flight.telemetry = True
    flight.fly(ONSET_S + 4.0)
    assert flight.status.outlook == Outlook(waits_for_resume=True)


def test_the_landing_after_an_abort_is_announced_until_a_resume(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(None)
    flight.told_to("abort")
    flight.fly(ONSET_S + 1.0)
    assert flight.status.outlook == Outlook(NextChange("land", ONSET_S + 5.0, "abort"))
    flight.told_to("resume", 2)
    flight.fly(ONSET_S + 2.0)
    assert flight.status.outlook is None


def test_a_vehicle_that_was_held_and_is_sent_down_blind_lands(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(Condition.TELEMETRY_STALE)
    flight.telemetry = False
    flight.fly(ONSET_S + 2.0)
    assert flight.status.tactic is Tactic.HOLD
    flight.core.take(TacticEvent(Event.END))
    (output,) = flight.fly(flight.now_s + 0.1)
    assert output.status.tactic is Tactic.LAND


def test_a_battery_is_no_reason_to_go_on_once_it_reads_better(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(Condition.BATTERY_LOW)
    flight.battery = 0.18
    flight.fly(ONSET_S + 5.0)
    flight.battery = 0.5
    flight.core.take(TacticEvent(Event.RESUME))
    flight.fly(flight.now_s + 2.0)
    flight.core.take(TacticEvent(Event.RESUME))
    flight.fly(flight.now_s + 2.0)
    assert flight.status.tactic is Tactic.RETURN_AND_LAND


def test_a_short_voltage_sag_or_an_unknown_charge_triggers_no_failsafe(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(Condition.BATTERY_LOW)
    for _ in range(4):
        flight.battery = 0.05
        flight.fly(flight.now_s + 3.5)
        flight.battery = None
        flight.fly(flight.now_s + 0.5)
    assert flight.notes() == []


def test_who_has_the_vehicle_keeps_it_and_it_returns_by_resume_once_all_is_well(
    make_flight: Callable[..., Flight],
) -> None:
    flight = make_flight(Condition.PILOT_TOOK_OVER)
    flight.core.take(TacticEvent(Event.HANDED_OVER))
    flight.battery = 0.05
    flight.fly(ONSET_S + 20.0)
    assert flight.status.outlook is not None
    assert (flight.told.alert, flight.status.outlook.blocks) == ("mode changed", "battery critical")
    flight.core.take(TacticEvent(Event.RESUME))
    flight.fly(flight.now_s + 0.2)
    assert flight.status.tactic is Tactic.PILOT_OVERRIDE
    assert flight.outputs[-1].setpoint is None
    (refusal,) = [note for note in flight.notes() if note.startswith("resume refused")]
    assert "battery critical: at 5%" in refusal
    flight.battery = 0.9
    flight.fly(flight.now_s + 0.2)
    flight.core.take(TacticEvent(Event.RESUME))
    flight.fly(flight.now_s + 0.2)
    assert (flight.status.tactic, flight.told.alert) == (Tactic.FORMATION, "")


def test_the_gravest_condition_determines_the_reaction_and_the_report(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(Condition.TELEMETRY_STALE)
    peers(2)(flight)
    flight.fly(ONSET_S + 3.0)
    assert flight.told.alert == "peer silent"
    flight.telemetry = False
    flight.fly(flight.now_s + 1.5)
    assert (flight.told.alert, flight.told.tactic) == ("telemetry stale", "hold")
    flight.bus = False
    flight.fly(flight.now_s + 3.0)
    assert (flight.told.alert, flight.told.tactic) == ("telemetry stale", "hold")


class Between(Flight):
    """A flight with a peer on either side, which follow it."""

    away_m = 20.0

    def _said_by(self, peer: int, tactic: str) -> MemberState:
        said = super()._said_by(peer, tactic)
        x_m, y_m, x_m_s, y_m_s = self.motion.tolist()
        y_m += self.away_m if peer == 1 else -self.away_m
        return msgspec.structs.replace(said, position_m=(x_m, y_m), velocity_m_s=(x_m_s, y_m_s), aim_m=(x_m, y_m))


def test_a_guard_that_finds_no_solution_is_a_plan_that_fails(
    make_config: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between two peers that are both nearer than the separation, the guard needs its solver."""
    flight = Between(make_config(vehicle_id=3, failsafe=SETTINGS, safety={"separation_m": 4.5}))
    flight.fly(ONSET_S)
    flight.away_m = 2.5
    monkeypatch.setattr("osqp.OSQP.solve", lambda *_, **__: UNSOLVED)
    flight.fly(ONSET_S + 1.0)
    assert flight.status.guarded is not None
    assert flight.status.guarded.status is GuardStatus.BRAKED
    assert not any("plan failing" in note for note in flight.notes())
    flight.fly(ONSET_S + 1.6)
    assert any("plan failing" in note for note in flight.notes())


@pytest.mark.parametrize("told_after_s", [0.5, 3.0])
def test_a_peer_whose_own_alert_explains_its_contradictions_is_not_doubted_but_kept_clear_of(
    told_after_s: float, make_flight: Callable[..., Flight]
) -> None:
    """One cause, one alarm: that of the vehicle itself. It comes a while after the first contradictions."""
    flight = make_flight(Condition.PEER_DOUBTFUL)
    flight.second_source = True
    flown = flight.fly(ONSET_S + told_after_s)
    flight.peer_alert = "not following"
    explained = flight.fly(ONSET_S + 6.0)
    doubted = {each.status.alert for each in flown} == {"", "peer doubtful"}
    assert doubted is (told_after_s > 2.0)
    assert {each.status.alert for each in explained[3:]} == {""}
    assert {each.status.outlook for each in explained[3:]} == {Outlook(also=("vehicle 1 not following",))}
    flight.peer_alert = ""
    flight.fly(ONSET_S + 9.0)
    assert flight.told.alert == "peer doubtful", "two sources that contradict each other without one"


def test_of_a_cause_and_its_consequences_only_the_cause_is_an_alarm(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(None)
    flight.bus = False
    peers()(flight)
    flight.fly(ONSET_S + 5.0)
    assert [note.partition(":")[0] for note in flight.notes()] == ["bus lost"]
    outlook = flight.status.outlook
    assert outlook is not None
    assert flight.told.alert == "bus lost"
    assert set(outlook.also) == {"all peers silent", "leader lost", "peer silent"}
    flight.bus = True
    flight.fly(ONSET_S + 5.5)
    assert flight.told.alert == "all peers silent"
    flight.told_to("resume")
    flight.fly(ONSET_S + 7.0)
    (refusal,) = (note for note in flight.notes(kind="command"))
    assert "refused: all peers silent" in refusal, "a consequence that goes on is an alarm of its own"
    assert flight.notes(ONSET_S + 5.0)[1].startswith("all peers silent: vehicle 1, vehicle 2")


def test_peers_that_land_or_stand_down_are_not_missed(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(None)
    flight.peers = {1: "land", 2: "pilot override"}
    flight.fly(ONSET_S + 5.0)
    flight.peers = {1: "land"}
    flight.fly(ONSET_S + 10.0)
    flight.core.take(Presence(1, present=False))
    flight.peers = {}
    flight.fly(ONSET_S + 30.0)
    assert (flight.told.tactic, flight.told.alert, flight.notes()) == ("formation", "", [])


def test_the_last_peer_to_fall_silent_counts_beside_those_that_landed(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(None)
    flight.peers = {1: "land", 2: "formation"}
    flight.fly(ONSET_S + 5.0)
    flight.peers = {2: "formation"}
    flight.fly(ONSET_S + 10.0)
    assert flight.told.alert == ""
    flight.peers = {}
    flight.fly(ONSET_S + 15.0)
    assert (flight.told.tactic, flight.told.alert) == ("aside", "all peers silent")


def test_on_the_ring_a_vehicle_without_bus_stays_clear_of_the_others(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(Condition.TARGET_STALE)
    flight.peers = {}
    flight.fly(ONSET_S + 3.6)
    assert flight.told.tactic == "aside"
    assert flight.target_m is not None
    x, y = flight.target_m
    away_m = []
    while flight.now_s < ONSET_S + 3.4 + ESCALATION_S:
        # The ring comes after it.
        course = flight.motion[:2] - np.array([x, y])
        away_m.append(float(np.hypot(*course)))
        x, y = (np.array([x, y]) + course / away_m[-1] * 0.5 * PERIOD_S).tolist()
        flight.target_m = x, y
        flight.fly(flight.now_s + PERIOD_S)
    # The ring, twice the separation of its bend, and one for the vehicle.
    assert away_m[-1] == pytest.approx(10.0 + 3.0 + 1.0, abs=0.6)
    assert min(away_m[-10:]) >= 10.0 + 3.0


def test_who_was_never_heard_does_not_count_among_the_silent(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(None, heard=(2,))
    flight.peers = {}
    flight.fly(ONSET_S + 10.0)
    assert (flight.told.tactic, flight.told.alert) == ("formation", "leader lost")


def test_in_the_line_a_target_may_jump_and_vanish(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(None)
    for target_m in ((40.0, -5.0), (40.0, 15.0), None):
        flight.target_m = target_m
        flight.fly(flight.now_s + 5.0)
    assert (flight.told.tactic, flight.told.alert, flight.notes()) == ("formation", "", [])


def test_a_peer_whose_words_are_dropped_for_its_clock_is_said_to_have_stepped(
    make_flight: Callable[..., Flight],
) -> None:
    flight = make_flight(None)
    flight.clock_ahead_s = -5.0
    flight.fly(ONSET_S + 4.0)
    assert flight.status.drops.too_old >= 39
    step, silence = flight.notes()
    assert step == "peer's clock stepped: vehicle 1 by -5.00 s: fly on and report"
    assert silence.startswith("peer silent: vehicle 1")
    assert flight.told.alert == "peer's clock stepped"


def test_a_peer_that_falls_silent_nearby_still_counts_as_near(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(Condition.TOO_CLOSE, heard=(2,))
    flight.close = True
    peers(1, 2)(flight)
    flight.fly(ONSET_S + 0.1)
    peers(2)(flight)
    flight.core.take(Presence(1, present=False))
    flight.fly(ONSET_S + 0.6)
    assert (flight.told.tactic, flight.told.alert) == ("aside", "too close")


def test_above_and_below_each_other_vehicles_are_not_too_close(make_flight: Callable[..., Flight]) -> None:
    flight = make_flight(Condition.TOO_CLOSE)
    flight.close = True
    for height_m in (6.5, 9.5):
        flight.peer_height_m = height_m
        flown = flight.fly(flight.now_s + 1.0)
        assert "too close" not in {output.status.alert for output in flown}


def test_a_lost_operator_ends_the_flight_and_does_not_kill_the_program() -> None:
    program = (
        "import os, signal, threading\n"
        "from gcs.signals import hold_back, relay\n"
        "hold_back()\n"
        "asked = threading.Event()\n"
        "relay(asked.set)\n"
        "for each in (signal.SIGHUP, signal.SIGTERM, signal.SIGINT):\n"
        "    asked.clear()\n"
        "    os.kill(os.getpid(), each)\n"
        "    print(asked.wait(10.0))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, 3 * "True\n"), done.stderr
