"""The flights of a team's vehicles: one each, and another one of a vehicle that landed and rejoins the others."""

import asyncio
import traceback
from collections.abc import Coroutine, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import date
from math import cos, dist, sin

from agents.control.plan import PlannerError
from agents.flight_end import FlightEnd
from agents.shell.outcome import FLIES_AGAIN, UNUSED, Outcome
from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.frames import Triple
from estimation.state import POSITION
from gcs.flight.preparation import FIRST_REPORTS_S, start_blockers
from gcs.flight.reserves import Reserves
from gcs.flight.stubs import preparing_speed
from gcs.flight.team import FlightTeam, Member
from gcs.flight.watch import FindingsReport
from gcs.metrics.ending import named
from gcs.preflight.preflight import vehicle_findings
from sitl.server.governed_clock import GovernedClock

LEAST_LEFT_S = 30.0
"""A mission that ends sooner than this after the command is not rejoined [s of the mission clock]."""
CLIMB_M_S = 1.0
"""The assumed speed of a climb: while it lasts, the others do not receive where the vehicle is."""
_RELIEVED = (FlightEnd.BATTERY, FlightEnd.OPERATOR)
"""The ends of a vehicle from which one in reserve has taken over as planned."""
_NO_LINK = "its link is lost: rejoin once it is received again"
RING_CLEAR = 2.0
"""In separations: the least horizontal distance of a climb from the ring."""


class MemberFlights:
    """Flies every vehicle of a team until all are down; one that has landed may rejoin until then.

    `report` receives the findings about a vehicle that is to take off again.
    """

    def __init__(self, team: FlightTeam, report: FindingsReport) -> None:
        self._team = team
        self._report = report
        self._reserves = Reserves(team)
        self._flying = {member.vehicle.id for member in team.members}
        self._all_down = asyncio.Event()
        self._checking = asyncio.Lock()

    async def fly(self) -> Sequence[Outcome]:
        """Fly, and return the outcomes of the members, in their order."""
        for each in self._reserves.waiting:
            each.agent.stand_by(self._team.plan.duration_s)
        beside = [asyncio.create_task(each) for each in (self._reserves.run(), self._team.find_absent())]
        try:
            return await asyncio.gather(*map(self._fly, self._team.members))
        finally:
            for task in beside:
                task.cancel()

    async def _fly(self, member: Member) -> Outcome:
        team, agent = self._team, member.agent
        if agent.in_reserve:
            outcome = UNUSED
        else:
            outcome = await begun(team, member, agent.fly(team.plan.duration_s, team.stop))
            self._reserves.note_end(member.vehicle.id, outcome)
        while await self._is_to_rejoin(member):
            refusal = await self.refusal(member)
            if refusal:
                if agent.in_reserve:
                    team.view.print_line(f"vehicle {member.vehicle.id} stays in reserve: {refusal}", "warning")
                agent.stay(refusal)
                continue
            self._reserves.note_again(member.vehicle.id)
            team.note_end(member, FLIES_AGAIN)
            again = await flown(team, member, agent.fly_again(team.plan.duration_s, team.stop))
            self._reserves.note_end(member.vehicle.id, again)
            outcome = replace(again, flew=outcome.flew or again.flew)
        if (relief := self._reserves.relieved_by(member.vehicle.id)) is not None and outcome.how in _RELIEVED:
            return replace(outcome, how=FlightEnd.LANDED, reason=f"relieved by vehicle {relief}")
        return outcome

    async def _is_to_rejoin(self, member: Member) -> bool:
        """Wait until a vehicle that is down is commanded to rejoin; return False once all are down."""
        self._flying.discard(member.vehicle.id)
        if not self._flying:
            self._all_down.set()
        waits = [asyncio.create_task(each.wait()) for each in (member.agent.rejoining, self._all_down)]
        try:
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for each in waits:
                each.cancel()
        if self._all_down.is_set():
            if member.agent.rejoining.is_set():
                member.agent.stay("all vehicles are down: the flight is over")
            return False
        self._flying.add(member.vehicle.id)
        return True

    async def refusal(self, member: Member) -> str:
        """Check a vehicle that is to rejoin; return why it must not take off, empty if it may."""
        async with self._checking:  # each has the checks' whole time
            with _at_preparing_speed(self._team):
                return self._too_late() or await self._check(member) or self._too_late()

    def _too_late(self) -> str:
        team = self._team
        if team.stop.wanted.is_set():
            return "the operator ends the flight"
        if team.start_s is None:
            return "the mission has not begun"
        left_s = team.start_s + team.plan.duration_s - team.clock.now_s()
        return "" if left_s >= LEAST_LEFT_S else f"the mission ends in {max(left_s, 0.0):.0f} s"

    async def _check(self, member: Member) -> str:
        """Check the vehicle as before a flight; its state may have changed since the command."""
        team, vehicle_id = self._team, member.vehicle.id
        if not member.link.status.connected:
            return _NO_LINK
        member.link.count_anew()
        facts = await member.link.facts(vehicle_id, FIRST_REPORTS_S)
        findings = vehicle_findings(team.plan.mission, facts, date.today())
        self._report(findings)
        if not member.link.status.connected:
            return _NO_LINK
        if blockers := start_blockers(vehicle_id, findings):
            return blockers
        assert facts.position_m is not None, "a vehicle without a position is refused above"
        if above := self._above(vehicle_id, facts.position_m):
            return above
        team.begin_vehicle(facts)
        return ""

    def _above(self, vehicle_id: int, place_m: Triple) -> str:
        """Return what may be above a place while a vehicle climbs from it, empty if nothing may."""
        mission = self._team.plan.mission
        here_m, separation_m = place_m[:2], mission.safety.separation_m
        config = mission.agent_config(mission.vehicle(vehicle_id))
        climb_s = max(config.altitude_m, config.take_off_altitude_m) / CLIMB_M_S
        near = sorted(
            i
            for i, path in self._paths_m(vehicle_id, climb_s).items()
            if min(dist(here_m, p) for p in path) < separation_m
        )
        if near:
            return f"{named(near)} may fly above it: move them, or carry it to its start"
        if any(
            abs(dist(here_m, centre_m) - radius_m) < RING_CLEAR * separation_m for centre_m, radius_m in self._rings()
        ):
            return "the ring passes above it: carry it to its start"
        return ""

    def _paths_m(self, vehicle_id: int, for_s: float) -> dict[int, list[tuple[float, float]]]:
        """Return where the other vehicles in the air will be: straight on, except those on the ring."""
        moving = {
            peer.sender: (*peer.position_m, *((0.0, 0.0) if peer.angle is not None else peer.velocity_m_s))
            for peer in self._peers()
        }
        for each in self._team.members:
            moving.pop(each.vehicle.id, None)
            if each.link.status.armed and (motion := each.link.motion) is not None:
                status = self._team.newest.get(each.vehicle.id)
                turns = status is not None and status.tactic is Tactic.ENCIRCLE  # it stays on its ring
                velocity_m_s = (0.0, 0.0) if turns else motion.velocity_m_s[:2]
                moving[each.vehicle.id] = (*motion.position_m[:2], *velocity_m_s)
        moving.pop(vehicle_id, None)
        steps = [for_s * k / 20.0 for k in range(21)]
        return {i: [(x + vx * s, y + vy * s) for s in steps] for i, (x, y, vx, vy) in moving.items()}

    def _rings(self) -> Iterator[tuple[tuple[float, float], float]]:
        """Return centre and radius of the rings that vehicles fly now, by their own estimates [m]."""
        for member in self._team.members:
            status = self._team.newest.get(member.vehicle.id)
            if status is None or member.ending or status.tactic is not Tactic.ENCIRCLE:
                continue
            if status.target_estimate is not None and status.polar is not None:
                x, y = status.target_estimate.mean[POSITION].tolist()
                yield (x, y), status.polar.radius_m
        for peer in self._peers():
            if (angle := peer.angle) is not None:
                (x, y), radius_m = peer.position_m, angle.radius_m
                yield (x - radius_m * cos(angle.bearing_rad), y - radius_m * sin(angle.bearing_rad)), radius_m

    def _peers(self) -> Iterator[MemberState]:
        """Return the newest states that vehicles of this process have of others."""
        for status in self._team.newest.values():
            yield from status.peers


@contextmanager
def _at_preparing_speed(team: FlightTeam) -> Iterator[None]:
    """Slow a governed clock down within a context: checks take wall time, in which the flight goes on."""
    clock = team.clock
    before = clock.speed
    if isinstance(clock, GovernedClock):
        clock.set_speed(min(before, preparing_speed(len(team.plan.vehicles))))
    try:
        yield
    finally:
        if isinstance(clock, GovernedClock):
            clock.set_speed(before)


async def begun(team: FlightTeam, member: Member, flight: Coroutine[None, None, Outcome]) -> Outcome:
    """Let a vehicle begin the mission with the others: if it does not, those in the air land again."""
    outcome = await flown(team, member, flight)
    never_began = member.agent.start_s is None and not team.stop.wanted.is_set()
    if never_began or (outcome.how is FlightEnd.REFUSED and not outcome.flew):
        # The mission needs every vehicle.
        team.stop.request(Outcome(FlightEnd.FAILSAFE, f"vehicle {member.vehicle.id} did not begin the mission"))
    return outcome


async def flown(team: FlightTeam, member: Member, flight: Coroutine[None, None, Outcome]) -> Outcome:
    """Return the outcome of a vehicle's flight; a fault of the program ends that of the team."""
    try:
        outcome = await flight
    except Exception as error:  # a bug in one agent must not leave the other vehicles without control
        traceback.print_exc()
        team.stop.request(Outcome(FlightEnd.FAILSAFE, f"the agent of vehicle {member.vehicle.id} failed"))
        step = "correct the planner" if isinstance(error, PlannerError) else "report this with the text above"
        outcome = Outcome(FlightEnd.ERROR, f"{type(error).__name__}: {error}", step, flew=True)
    team.note_end(member, replace(outcome, unaccounted=member.agent.unaccounted))
    return outcome
