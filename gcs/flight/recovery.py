"""Bring home a team that is in the air: find its vehicles, judge them, and ask before anything is sent to one."""

import asyncio
import sys
from collections.abc import Collection, Sequence
from dataclasses import replace

from agents.ports import VehicleRefusedError
from agents.team.messages import TOPICS, BusMessage, MemberState, VehicleReport
from gcs.console.live import LiveView
from gcs.console.team_bus import guest_bus, observer
from gcs.errors import InputError
from gcs.flight.plan import TeamRecovery
from gcs.flight.team import FlightTeam
from gcs.flight.watch import FindingsReport
from gcs.keys.team_keys import TeamKeys
from gcs.link.ports import STILL_FLIES
from gcs.metrics.ending import named
from gcs.mission.added_vehicle import announcement
from gcs.mission.cross_checks import LAYER_LEAST_M
from gcs.mission.mission import Mission
from gcs.preflight.findings import Grade, VehicleFacts
from gcs.preflight.link_facts import unreachable
from gcs.preflight.mission import feasibility
from gcs.preflight.recovery import Standing, Treatment, standings

HOLDS_S = 3.0
"""How long the vehicles hold together before they return [s of the mission clock]."""
_LAYER_SHARE = 1.25
"""Vehicles of two layers do not evade each other, although they do not keep their heights exactly."""
LEFT_TO_PILOT = "its pilot kept it, as it was when it was found"
_REPORTS_S = 3.0
"""A vehicle reports everything within this time [wall s]."""
_MEETS_S = 3.0
"""How long a vehicle shows the others where it hovers, clocks are compared with theirs, and their answers are awaited
[wall s]: all send five a second. Shown for 3 s, vehicles that had forgotten it passed at 3.5 m or more, of 3 m needed.
"""
_LISTENS_S = 2.5
"""How long a flight that still runs is listened for on the bus [wall s]: its vehicles send states and reports."""


def homeward(mission: Mission, *, land: bool) -> tuple[Mission, str]:
    """Return the mission as it ends here, and what the operator has to know about that, empty if nothing.

    Vehicles return in layers, or with `land` land where they are. Where the mission has no layers, they get some.
    Its identity stays: the operators of the team command its vehicles by the file that they have.
    """
    if land:
        return _ending(mission, {"landing": "in_place"}), ""
    layer_m = mission.choreography.layer_m
    if layer_m < LAYER_LEAST_M:
        layer_m = max(LAYER_LEAST_M, _LAYER_SHARE * mission.safety.vertical_separation_m)
    try:
        return _ending(mission, {"landing": "return", "layer_m": layer_m}), ""
    except InputError as error:
        told = f"they land where they are: layers for the way home do not fit ({'; '.join(error.faults)})"
        return _ending(mission, {"landing": "in_place"}), told


def _ending(mission: Mission, choreography: dict[str, object]) -> Mission:
    return replace(mission.replace(choreography=choreography), identity=mission.identity)


async def prepare_recovery(team: FlightTeam, recovery: TeamRecovery, report: FindingsReport) -> None:
    """Connect to the vehicles that are received, judge them, and ask; the members that stay are to be flown.

    Raises VehicleRefusedError if a flight of the team still runs, a vehicle must not be taken, none is in the air, or
    the operator does not agree.
    """
    mission, asked = team.plan.mission, [each.id for each in team.plan.vehicles]
    if recovery.beside or mission.network.security is not None:  # the bus of a run's keys does not leave this computer
        await _require_not_flown(mission, team.keys, asked if recovery.beside else mission.ids)
    refused = await team.connect_some()
    if team.plan.speed is None and not team.plan.is_governed:
        await team.measure_speed()
    facts = [
        *await team.facts(_REPORTS_S),
        *(unreachable(i, each, each.clause) for i, each in refused.items()),
    ]
    if recovery.flies_on:
        _require_feasible(mission, report)
    judged = standings(mission, facts, recovery.from_pilot)
    recovery.record.judge(judged, facts)
    report([each.finding for each in judged])
    _require_takeable(judged)
    if not (recovery.confirmed or await _confirmed(team.view, _question(mission, judged, recovery))):
        raise VehicleRefusedError("not confirmed: nothing was sent to the vehicles", "")
    treatments = _as_they_are_now(team, judged, facts, recovery)
    await team.leave({i for i, each in treatments.items() if each is Treatment.LEAVE})
    team.accompanied.update(i for i, each in treatments.items() if each is Treatment.ACCOMPANY)
    for each in facts:
        if each.vehicle_id in {member.vehicle.id for member in team.members}:
            team.begin_vehicle(each)
    lying_m = {each.vehicle_id: each.position_m for each in facts if each.position_m and not each.status.armed}
    for agent in team.agents:
        for i, (x, y, _) in lying_m.items():
            agent.note_lying(i, (x, y))
        agent.announce()
    await _meet_others(team, beside=recovery.beside)


async def _meet_others(team: FlightTeam, *, beside: bool) -> None:
    """Introduce a vehicle that the mission adds, and compare clocks and missions with others that fly `beside`.

    These may have stopped to avoid the place of a vehicle that fell silent: they receive where it is for a while before
    it is taken, and keep clear of it. Raises VehicleRefusedError if clocks or missions differ: it would not receive
    where the others are.
    """
    added = next((each for each in team.members if each.vehicle.id == team.plan.mission.added), None)
    answers = {} if added is None else added.agent.introduce(announcement(added.vehicle))
    if not beside:
        return
    end_s = team.clock.now_s() + _MEETS_S * team.clock.time_scale
    while team.clock.now_s() < end_s:
        for agent in team.agents:
            agent.look()
        await team.clock.sleep(TOPICS[MemberState].period_s)
    if refusal := next(filter(None, (agent.start_refusal for agent in team.agents)), None):
        raise VehicleRefusedError(f"nothing was sent to the vehicles: {refusal.reason}", refusal.next_step)
    if added is not None and (silent := sorted(added.agent.clock_lags_s.keys() - answers.keys())):
        text = f"{named(silent)}: no answer to vehicle {added.vehicle.id}: what does not know it does not keep apart"
        team.view.print_line(text, "warning")


def _require_takeable(judged: Sequence[Standing]) -> None:
    refused = [each for each in judged if each.finding.grade is Grade.REFUSE]
    if refused:
        raise VehicleRefusedError(
            f"nothing was sent to the vehicles: {named(each.vehicle_id for each in refused)} must not be taken",
            "see the findings above; what --leave names is left as it is, and the others are brought home",
        )
    if all(each.treatment is not Treatment.TAKE for each in judged):
        raise VehicleRefusedError("no vehicle is in the air that could be brought home: nothing was sent to one", "")


def _require_feasible(mission: Mission, report: FindingsReport) -> None:
    findings = list(feasibility(mission))
    if any(each.grade is Grade.REFUSE for each in findings):
        report(findings)
        raise VehicleRefusedError(
            "nothing was sent to the vehicles: the mission cannot be flown", "see the findings above"
        )


def _question(mission: Mission, judged: Sequence[Standing], recovery: TeamRecovery) -> str:
    taken = named(sorted(each.vehicle_id for each in judged if each.treatment is Treatment.TAKE))
    if recovery.flies_on:
        return f"Take {taken} of {mission.mission.name}, hold, and fly the mission from its begin?"
    if mission.choreography.landing == "return":
        return f"Take {taken} of {mission.mission.name}, hold, return and land one after another?"
    return f"Take {taken} of {mission.mission.name}, hold, and land where they are?"


def _as_they_are_now(
    team: FlightTeam, judged: Sequence[Standing], facts: Sequence[VehicleFacts], recovery: TeamRecovery
) -> dict[int, Treatment]:
    """Return what is done with each member: the operator may have answered late, and nothing more than agreed is done.

    Raises VehicleRefusedError for a vehicle that must not be taken any more.
    """
    links = {member.vehicle.id: member.link for member in team.members}
    newest = [
        replace(each, status=links[each.vehicle_id].status, position_m=motion.position_m)
        for each in facts
        if each.vehicle_id in links and (motion := links[each.vehicle_id].motion) is not None
    ]
    agreed = {each.vehicle_id: each.treatment for each in judged}
    now = standings(team.plan.mission, newest, recovery.from_pilot)
    _require_takeable(now)
    changed = {each.vehicle_id: each.treatment for each in now if agreed[each.vehicle_id] is Treatment.TAKE}
    return {i: changed.get(i, each) for i, each in agreed.items() if i in links}


async def _require_not_flown(mission: Mission, keys: TeamKeys, vehicle_ids: Collection[int]) -> None:
    """Refuse vehicles that another program still flies; a whole flight on this computer holds claims as well.

    Raises VehicleRefusedError, InputError if this computer has no keys that may receive.
    """
    flying: set[int] = set()

    def take(message: BusMessage) -> None:
        if isinstance(message, VehicleReport) and not message.ended and message.sender in vehicle_ids:
            flying.add(message.sender)

    bus = guest_bus(mission, observer(keys))
    await bus.open(take, lambda *_: None, lambda _vehicle, _present: None)
    try:
        await asyncio.sleep(_LISTENS_S)
    finally:
        await bus.close()
    if flying:
        raise VehicleRefusedError(
            f"a flight of team {mission.network.team} still runs: it flies {named(sorted(flying))}, as its bus shows",
            STILL_FLIES,
        )


async def _confirmed(view: LiveView, question: str) -> bool:
    """Ask the operator on this terminal; a signal ends the wait for the answer."""
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[str] = loop.create_future()
    view.print_line(f"{question} [y/N]")

    def take() -> None:
        loop.remove_reader(sys.stdin)
        answer.set_result(sys.stdin.readline())

    loop.add_reader(sys.stdin, take)
    try:
        return (await answer).strip().lower() in ("y", "yes")
    finally:
        loop.remove_reader(sys.stdin)
