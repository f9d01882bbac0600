"""The flight of a vehicle that is not in the mission file, and joins its team in the air (`cordon rejoin --add`)."""

import asyncio
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from math import inf
from random import randrange
from time import monotonic

from agents.flight_end import FlightEnd
from agents.ports import VehicleRefusedError
from agents.shell.outcome import Outcome
from agents.tactics import Tactic
from agents.team.messages import AddedAnswer, MemberState, OperatorCommand
from agents.team.participant import name_from
from gcs.flight.member_flights import MemberFlights, flown
from gcs.flight.team import FlightTeam, Member
from gcs.flight.watch import FindingsReport
from gcs.keys.identity import user_name
from gcs.link.ports import Claims
from gcs.metrics.ending import named
from gcs.mission.added_vehicle import announcement

ANSWERED_WITHIN_S = 15.0
"""How long answers to its introduction are waited for [wall s]."""
_LOOKED_FOR_S = 2.0
"""How long it receives the states of those in the air, which send at least one a second, before it takes off [s]."""
_PERIOD_S = 0.1
ENDS_FOR_S = 2.0
"""How long the others have to come home until it follows: at the mission's end it does so by itself [s]."""
_COMING_HOME = (Tactic.RETURN_AND_LAND, Tactic.LAND)
_COME_HOME = {each.value for each in _COMING_HOME}
_DURATION_MAX_S = 86400.0
_AGAIN = "add it again; the team flies on"


def coming_home(peers: Collection[MemberState]) -> tuple[int, ...]:
    """Return the peers that return or land if all do that no pilot flies, none if one of them goes on."""
    flown = [each for each in peers if each.tactic != Tactic.PILOT_OVERRIDE.value]
    return tuple(sorted(each.sender for each in flown)) if {each.tactic for each in flown} <= _COME_HOME else ()


class AddedFlight:
    """Flies the only vehicle of a process, which the mission adds, with the others, until it is down.

    It takes off once every other vehicle of the mission has answered that it knows it: these keep apart from it then.
    It comes home once all of them do.
    """

    def __init__(self, team: FlightTeam, report: FindingsReport) -> None:
        """Take the team of the process; `report` receives the findings about the vehicle before its take-off."""
        self._team = team
        self._report = report

    async def fly(self) -> Sequence[Outcome]:
        """Fly; returns its outcome. Raises VehicleRefusedError if it must not take off."""
        [member] = self._team.members
        agent = member.agent
        agent.stand_by(_DURATION_MAX_S)
        others = named(sorted({*self._team.plan.mission.ids} - {member.vehicle.id, *self._team.plan.off_bus}))
        self._team.view.print_line(f"vehicle {member.vehicle.id} announces itself: waiting for answers of {others}")
        answers = agent.introduce(announcement(member.vehicle))
        duration_s = await self._answered(member, answers)
        self._team.view.print_line(
            f"{others} know vehicle {member.vehicle.id}: it is checked once more, then takes off"
        )
        team = replace(self._team, plan=replace(self._team.plan, duration_s=duration_s))
        with Claims() as claims:
            claims.show_added(team.plan.mission)
            await team.clock.sleep(_LOOKED_FOR_S)
            _require_welcome(member, answers)  # the first may have been to its earlier flight
            self._order(member)
            if refusal := await MemberFlights(team, self._report).refusal(member):
                agent.stay(refusal)
                raise _refused(member, refusal)
            following = asyncio.create_task(self._end_with_the_others(member))
            try:
                outcome = await flown(team, member, agent.fly_again(duration_s, team.stop))
            finally:
                following.cancel()
            if not outcome.flew:
                agent.stay(outcome.reason or "it did not take off")  # the others await it in the air
            return [outcome]

    async def _answered(self, member: Member, answers: Mapping[int, AddedAnswer]) -> float:
        """Wait until all the others know the vehicle; return how long their mission lasts [s]."""
        plan, end_s = self._team.plan, monotonic() + ANSWERED_WITHIN_S
        asked = {*plan.mission.ids} - {member.vehicle.id, *plan.off_bus}
        while not self._team.stop.wanted.is_set():
            _require_welcome(member, answers)
            if asked <= answers.keys():
                return min(answer.duration_s for answer in answers.values())
            if (refusal := member.agent.start_refusal) is not None:
                raise _refused(member, refusal.reason, refusal.next_step)
            if monotonic() > end_s:
                missing = sorted(asked - answers.keys())
                raise VehicleRefusedError(
                    f"vehicle {member.vehicle.id} stays on the ground: {named(missing)}: no answer within "
                    f"{ANSWERED_WITHIN_S:g} s, and what does not know it does not keep apart from it",
                    "check that the team flies this mission, and that the keys of this vehicle were in its roster when "
                    "it took off; one that is down and off the bus is left out by --off-bus ID",
                )
            await asyncio.sleep(_PERIOD_S)
        raise VehicleRefusedError("the operator ended the flight before take-off", "")

    async def _end_with_the_others(self, member: Member) -> None:
        """Bring it home, as Ctrl-C does, once the others have come home for a while; one that a pilot has, after that.

        None of them can send it home alone.
        """
        team, vehicle_id = self._team, member.vehicle.id
        since_s, others = inf, tuple[int, ...]()
        while team.clock.now_s() - since_s < ENDS_FOR_S:
            await team.clock.sleep(_PERIOD_S)
            status = team.newest.get(vehicle_id)
            others = () if status is None else coming_home(status.peers)
            since_s = min(since_s, team.clock.now_s()) if others else inf
        while team.newest[vehicle_id].tactic is Tactic.PILOT_OVERRIDE:
            await team.clock.sleep(_PERIOD_S)
        if team.stop.wanted.is_set() or team.newest[vehicle_id].tactic in _COMING_HOME:
            return
        reason = f"the flight that it joined has ended: the others return and land ({', '.join(map(str, others))})"
        team.view.print_line(f"vehicle {vehicle_id} comes home: {reason}", "warning")
        team.stop.request(Outcome(FlightEnd.OPERATOR, reason))

    def _order(self, member: Member) -> None:
        """Order it to take off as `cordon rejoin` does; raises VehicleRefusedError if its core refuses."""
        agent, clock = member.agent, self._team.clock
        agent.look()
        command = OperatorCommand(clock.now_s(), "rejoin", member.vehicle.id, name_from(user_name()), randrange(2**32))
        agent.obey(command)
        if not agent.rejoining.is_set():
            answer = agent.answer(command.key)
            raise _refused(member, "" if answer is None else answer.did)


def _require_welcome(member: Member, answers: Mapping[int, AddedAnswer]) -> None:
    for sender, answer in sorted(answers.items()):
        if answer.refusal:
            raise _refused(member, f"vehicle {sender}: {answer.refusal}")


def _refused(member: Member, reason: str, next_step: str = "") -> VehicleRefusedError:
    then = f"{next_step}; then" if next_step else "once this is resolved,"
    return VehicleRefusedError(f"vehicle {member.vehicle.id} stays on the ground: {reason}", f"{then} {_AGAIN}")
