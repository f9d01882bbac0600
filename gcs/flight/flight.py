"""Fly a mission over MAVLink and Zenoh: the composition of agents, links, buses and, on request, stub vehicles."""

import asyncio
import gc
import os
from collections.abc import Callable, Collection, Coroutine, Iterator, Sequence
from contextlib import AsyncExitStack, ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from time import perf_counter

from rich.text import Text

from agents.flight_end import FlightEnd
from agents.ports import VehicleRefusedError
from agents.shell.clock import MissionClock, WallClock
from agents.shell.life import Phase
from agents.shell.outcome import BY_OPERATOR, Outcome, Stop
from agents.tactics import Tactic
from agents.team.participant import Participant
from estimation.frames import Triple
from gcs.console.command_client import CommandClient
from gcs.console.keyboard import KeyBindings, Keyboard, KeyCommands, KeyedCommand
from gcs.console.live import LiveView
from gcs.errors import InputError
from gcs.flight.added_flight import AddedFlight
from gcs.flight.audit_exchange import AuditExchange
from gcs.flight.faults.failing_equipment import FailingEquipment
from gcs.flight.faults.schedule import ScheduledFault
from gcs.flight.faults.team_faults import Injection, PresentFaults, TeamInFlight, UnauthorisedClient, last_in_line
from gcs.flight.heartbeat import SupervisorLink, Unsupervised
from gcs.flight.live.operating import ProgramLink
from gcs.flight.member_flights import MemberFlights, begun
from gcs.flight.plan import FlightPlan
from gcs.flight.preparation import ChecklistWait, Readiness, StartWait
from gcs.flight.recovery import LEFT_TO_PILOT, prepare_recovery
from gcs.flight.stubs import FlightStubs, clock_refusal, preparing_speed, url_ports
from gcs.flight.target_vehicle import TargetVehicle
from gcs.flight.team import FlightTeam, Member, ending_of
from gcs.flight.watch import FindingsReport, Watch
from gcs.flightlog.flight import Recording
from gcs.keys.identity import Identity, user_name
from gcs.keys.team_keys import flight_keys
from gcs.link.hub import MavsdkHub
from gcs.link.ports import fed_ports, flight_claims, recovery_claims
from gcs.link.signing_keys import signing_keys
from gcs.metrics.ending import Unaccounted, named
from gcs.metrics.journal import Journal
from gcs.metrics.record import FlightRecord
from gcs.mission.mission import Mission
from gcs.preflight.findings import Grade
from sitl.server.governed_clock import GovernedClock
from sitl.server.one_core import OneCore
from sitl.server.shared_clock import ClockError, Rank, new_clock

_PERIOD_S = 0.1
_POSITIONS_EVERY_S = 0.5
"""How often positions are reported to the supervisor [wall s]."""
_SHOWN_S = 0.3
"""Time to show the line that names a fault before the fault ends the process [wall s]."""


class FaultInjector:
    """The faults of one flight: those scheduled, and those present in its equipment."""

    def __init__(self, faults: Sequence[ScheduledFault]) -> None:
        """Take the faults in order of time."""
        self.faults = tuple(faults)
        self._present = PresentFaults()
        self._unauthorised_clients: list[asyncio.Task[None]] = []

    def equipment(self) -> FailingEquipment:
        """Return the equipment that the faults act on."""
        return FailingEquipment(self._present)

    async def run(self, team: FlightTeam, stubs: FlightStubs) -> None:
        """Inject each fault at its time of the mission, until cancelled."""
        try:
            for each in self.faults:
                while team.start_s is None:
                    await team.clock.sleep(_PERIOD_S)
                await team.clock.sleep_until(team.start_s + each.injected.at_s)
                await self._begin(each, team, stubs)
            await asyncio.Event().wait()
        finally:
            for client in self._unauthorised_clients:
                client.cancel()

    async def _begin(self, scheduled: ScheduledFault, team: FlightTeam, stubs: FlightStubs) -> None:
        """Print a fault, and inject it if the vehicles that it needs are airborne."""
        fault, airborne = scheduled.fault, _airborne(team)
        subject = scheduled.injected.vehicle or (last_in_line(team.plan.mission, tuple(airborne)) if airborne else 0)
        time, named = f"{scheduled.injected.at_s:.1f} s", fault.name + ("" if fault.of_team else f", vehicle {subject}")
        if subject not in airborne or len(airborne) < fault.vehicles_min:
            team.view.print_line(f"{time}: not injected: {named}: too few vehicles are airborne", "warning")
            return
        team.view.print_line(f"{time}: injected: {named}")
        scene = TeamInFlight(team.plan.mission, subject, tuple(airborne), airborne)
        injection = fault.inject(scene)
        if injection.ends_flight:
            await asyncio.sleep(_SHOWN_S)
        self._inject(injection, team, stubs)

    def _inject(self, injection: Injection, team: FlightTeam, stubs: FlightStubs) -> None:
        for vehicle_id, each in injection.vehicles.items():
            stubs.inject(team.plan.mission.vehicle(vehicle_id).system_id, each)
        if injection.unauthorised_client:
            self._unauthorised_clients.append(
                asyncio.create_task(UnauthorisedClient(team.plan.mission, team.clock).run())
            )
        self._present.set(self._present.now.with_more(injection.team))
        if injection.signal is not None:
            os.kill(os.getpid(), injection.signal)


def _airborne(team: FlightTeam) -> dict[int, Triple]:
    """Return the positions [m] of the armed vehicles, from their own estimates."""
    return {
        member.vehicle.id: member.link.motion.position_m
        for member in team.members
        if member.link.status.armed and member.link.motion is not None
    }


_HERE_ONLY = "the keyboard commands the vehicles of this process only: there is no operator key for the others"


async def command_by_keyboard(team: FlightTeam, stack: AsyncExitStack) -> Callable[[], Text]:
    """Let the keyboard command the team until the stack ends; return the text below the table about it.

    Without a terminal no key is read. Raises VehicleRefusedError when the bus to other vehicles cannot be opened.
    """
    if not team.view.is_live:
        return Text
    mission, here = team.plan.mission, {member.vehicle.id for member in team.members}
    identity, client = Identity(Participant("operator", user_name())), None
    if team.plan.recovery is None and len(team.members) < len(team.plan.mission.vehicles):
        try:
            identity = team.keys.identity("operator")
        except InputError as error:
            team.view.print_line(f"{_HERE_ONLY}: {error}")
        else:
            client = CommandClient(mission, identity)
            stack.push_async_callback(client.close)
            await client.open()
    bindings = KeyBindings(sorted(here) if client is None else mission.ids)

    def ended() -> set[int]:
        ended_here = {member.vehicle.id for member in team.members if member.agent.phase is Phase.ENDED}
        return ended_here | (set() if client is None else client.ended.keys())

    async def elsewhere(keyed: KeyedCommand, number: int) -> None:
        """Command the vehicles of other processes: these accept none from a vehicle's own bus."""
        asked = [each for each in mission.ids if each not in here and keyed.vehicle in (None, each)]
        if client is None or not asked:
            return
        try:
            await client.command(keyed.verb, asked, keyed.vehicle, number=number)
        except VehicleRefusedError as refusal:
            team.view.print_line(f"{keyed.verb} for {named(asked)}: {refusal.reason}")

    commands = KeyCommands(
        team.agents, team.clock, identity.participant.name, elsewhere, bindings, lambda: _piloted(team), ended
    )
    keyboard = stack.enter_context(Keyboard(commands.press, commands.ignore_paste))
    return (lambda: commands.hint) if keyboard.active else Text


def _piloted(team: FlightTeam) -> set[int]:
    """Return the vehicles that pilots fly, of this process and of others."""
    newest, pilot = team.newest.values(), Tactic.PILOT_OVERRIDE
    here = {status.vehicle_id for status in newest if status.tactic is pilot}
    return here | {peer.sender for status in newest for peer in status.peers if peer.tactic == pilot.value}


_UNSUPERVISED = Unsupervised()
_ORPHANED = Outcome(FlightEnd.WATCHDOG, "the flight's supervisor process had ended")


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """The result: each vehicle's outcome, the record if the mission began, and the speeds requested and reached.

    `mission` is that which was flown, with a vehicle that has joined.
    """

    mission: Mission
    outcomes: dict[int, Outcome]
    record: FlightRecord | None
    speed: float
    speed_reached: float


async def fly(
    plan: FlightPlan,
    view: LiveView,
    report: FindingsReport = lambda _findings: None,
    supervisor: SupervisorLink = _UNSUPERVISED,
    program: ProgramLink | None = None,
) -> FlightOutcome:
    """Fly; raises VehicleRefusedError when the team cannot or must not take off. `report` receives the findings.

    A `program` may operate the team beside the keyboard and the bus.

    Raises InputError when the keys of the team, or of signed links, are missing or not valid.

    Ctrl-C makes every vehicle hold, then land; a second Ctrl-C makes them land at once.
    """
    injector = FaultInjector(plan.faults)
    if plan.faults:
        plan = replace(plan, equipment=injector.equipment())
    with ExitStack() as stack:
        clock = _mission_clock(plan, stack)
        joins = plan.mission.added is not None and plan.recovery is None
        keys = stack.enter_context(flight_keys(plan.mission, joins=joins))
        plan = replace(plan, holders=keys.holders())
        recording = stack.enter_context(Recording(plan.log, clock))
        team = FlightTeam(plan, clock, recording, view, Journal(plan.mission), keys, signing_keys(plan.mission))
        return await _fly(team, report, supervisor, injector, program)


def _mission_clock(plan: FlightPlan, stack: ExitStack) -> MissionClock:
    """Return the clock of a flight, until the stack ends: governed if every vehicle is a stub.

    Raises VehicleRefusedError if no clock can be shared, InputError for a url no stub can serve.
    """
    if not plan.is_governed:
        return WallClock(plan.speed or 1.0)
    speed = plan.speed or 1.0
    try:
        name = plan.clock or stack.enter_context(
            new_clock(min(speed, preparing_speed(len(plan.stubs))), url_ports(plan.mission, plan.stubs).values())
        )
        return stack.enter_context(GovernedClock(name, Rank.AGENTS))
    except ClockError as error:
        raise clock_refusal(error) from error


@contextmanager
def _at_speed(speed: float | None, clock: MissionClock) -> Iterator[None]:
    """Let a governed clock run at the speed of the flight within a context, at most; None leaves it as it is."""
    before = clock.speed
    if isinstance(clock, GovernedClock) and speed is not None:
        clock.set_speed(speed)
    try:
        yield
    finally:
        if isinstance(clock, GovernedClock):
            clock.set_speed(before)


async def _fly(
    team: FlightTeam,
    report: FindingsReport,
    supervisor: SupervisorLink,
    injector: FaultInjector,
    program: ProgramLink | None,
) -> FlightOutcome:
    plan, clock = team.plan, team.clock
    team.recording.note_run(plan.run(clock.time_scale))
    # First: a url that stubs cannot serve is bad input, also while a port is in use.
    flight_stubs = FlightStubs(plan.mission, plan.stubs, clock)
    async with AsyncExitStack() as stack:
        loop = asyncio.get_running_loop()
        if plan.recovery is None:
            claims = stack.enter_context(flight_claims(plan.mission, plan.stubs))
        else:
            claims = stack.enter_context(recovery_claims(plan.mission, beside=plan.recovery.beside))
        supervisor.relay(
            lambda: loop.call_soon_threadsafe(team.stop.request, _ORPHANED if supervisor.is_lost else BY_OPERATOR)
        )
        stubs = await stack.enter_async_context(flight_stubs)
        # After the stubs: they do not inherit it.
        stack.enter_context(team.priority if plan.needs_prompt_computer else OneCore())
        hub = MavsdkHub(clock)
        stack.push_async_callback(hub.close)
        team.equip(hub, supervisor.heartbeat)
        if program is not None:
            program.follow(team)
        exchange = AuditExchange(team)
        for agent in team.agents:
            stack.push_async_callback(agent.close)
        target = TargetVehicle(plan.mission, hub, clock, team.agents, team.signing_keys)
        stack.push_async_callback(target.close)
        team.view.update([], 0.0, "looking for the vehicles")
        recovery = plan.recovery
        prepare = _prepare(team, target, report) if recovery is None else prepare_recovery(team, recovery, report)
        await _unless_stopped(prepare, team.stop)
        plan = replace(plan, vehicles=tuple(member.vehicle for member in team.members))
        # Vehicles send to these ports now: no stub server may start on them later. Stubs hold their ports themselves.
        claims.take_fed(fed_ports(plan.vehicles))
        if recovery is not None and plan.mission.added is not None:
            claims.show_added(plan.mission)  # `cordon command` finds it
        team.recording.note_run(plan.run(clock.time_scale))
        gc.freeze()  # links and agents live as long as the flight: no collection examines them
        hint = await command_by_keyboard(team, stack)
        began_s, began_mission_s = perf_counter(), clock.now_s()
        async with supervisor.follow(clock):
            with _at_speed(plan.speed, clock):
                watch = Watch(team, report, hint)
                beside = [watch.run(), exchange.run(), injector.run(team, stubs), _report_positions(team, supervisor)]
                if program is not None:
                    beside.append(program.report(team))
                if recovery is not None:
                    beside.append(recovery.record.follow(team))
                outcomes = await _fly_members(team, report, watch, exchange, beside)
        if recovery is not None:
            frame = plan.mission.mission_frame()
            recovery.record.end(team, [ending_of(i, outcome, frame) for i, outcome in outcomes.items()])
        supervisor.report_unaccounted([i for i, outcome in outcomes.items() if outcome.unaccounted is not None])
        wall_time_s, mission_time_s = perf_counter() - began_s, clock.now_s() - began_mission_s
    record = team.record(stubs.record, wall_time_s, outcomes)
    team.complete(stubs.record, record, outcomes)
    return FlightOutcome(team.flown_mission, outcomes, record, plan.speed or clock.speed, mission_time_s / wall_time_s)


async def _unless_stopped(preparing: Coroutine[None, None, None], stop: Stop) -> None:
    """Prepare the team; the operator may end the preparation at any time."""
    task = asyncio.create_task(preparing)
    stopped = asyncio.create_task(stop.wanted.wait())
    try:
        await asyncio.wait((task, stopped), return_when=asyncio.FIRST_COMPLETED)
        if not task.done():
            raise VehicleRefusedError("the operator ended the flight before take-off", "")
        task.result()
    finally:
        stopped.cancel()
        task.cancel()
        with suppress(asyncio.CancelledError, VehicleRefusedError):
            await task


async def _prepare(team: FlightTeam, target: TargetVehicle, report: FindingsReport) -> None:
    """Connect, agree on the clock's speed and check everything before a vehicle is armed."""
    feasible = asyncio.create_task(asyncio.to_thread(team.plan.feasibility))  # while the links wait for the vehicles
    await team.connect()
    await target.connect()
    readiness = Readiness(team, feasible)
    if team.plan.speed is None and not team.plan.is_governed:
        await readiness.measure_speed()
    for agent in team.agents:
        agent.announce()
    if team.plan.checklist is not None:
        await ChecklistWait(team, team.plan.checklist).done()
    findings = await (StartWait(team, feasible).findings() if team.plan.awaits_start else readiness.findings())
    report(findings)
    refused = sum(finding.grade is Grade.REFUSE for finding in findings)
    if refused:
        raise VehicleRefusedError(
            f"nothing was armed: {refused} of the {len(findings)} preflight findings forbid take-off",
            "correct the findings above, then fly again; `cordon check` runs the checks without flying",
        )


async def _fly_members(
    team: FlightTeam,
    report: FindingsReport,
    watch: Watch,
    exchange: AuditExchange,
    beside: Sequence[Coroutine[None, None, None]],
) -> dict[int, Outcome]:
    """Fly until every vehicle's flight has ended; what runs beside is cancelled then."""
    tasks = [asyncio.create_task(each) for each in beside]
    try:
        if team.plan.recovery is not None:
            outcomes = await _recover_team(team)
        elif team.plan.mission.added is not None:
            outcomes = await AddedFlight(team, report).fly()
        else:
            outcomes = await MemberFlights(team, report).fly()
    finally:
        for task in tasks:
            task.cancel()
        watch.end()
    await exchange.end()
    return {
        member.vehicle.id: replace(outcome, unaccounted=member.agent.unaccounted)
        for member, outcome in zip(team.members, outcomes, strict=True)
    }


async def _report_positions(team: FlightTeam, supervisor: SupervisorLink) -> None:
    """Report the vehicles' positions to the supervisor, and who is unaccounted for, until cancelled."""
    frame = team.plan.mission.mission_frame()
    while True:
        newest = ((member.vehicle.id, member.agent.last_position) for member in team.members)
        supervisor.report_positions(Unaccounted.of(i, last, frame) for i, last in newest if last is not None)
        supervisor.report_unaccounted([each.vehicle.id for each in team.members if each.agent.unaccounted is not None])
        await asyncio.sleep(_POSITIONS_EVERY_S)


def _taken(team: FlightTeam, member: Member, together: Collection[int]) -> Coroutine[None, None, Outcome]:
    """Return the flight of a vehicle that is taken in the air: home, or on with the mission."""
    flies_on = team.plan.recovery is not None and team.plan.recovery.flies_on
    fly = member.agent.take_over if flies_on else member.agent.recover
    return fly(together, team.plan.duration_s, team.stop)


async def _recover_team(team: FlightTeam) -> Sequence[Outcome]:
    """Bring home, or fly on with, all but the vehicles that their pilots fly.

    The others receive the states of these until they are down.
    """
    taken = [each for each in team.members if each.vehicle.id not in team.accompanied]
    together, landed = [each.vehicle.id for each in taken], Stop()
    flights = {
        each.vehicle.id: asyncio.create_task(
            begun(team, each, _taken(team, each, together)) if each in taken else each.agent.accompany(landed)
        )
        for each in team.members
    }
    try:
        await asyncio.gather(*(flights[i] for i in together))
    finally:
        for _ in range(2):  # the second time it is over at once
            landed.request()
        outcomes = await asyncio.gather(*flights.values())
    return [
        replace(each, reason=LEFT_TO_PILOT) if i in team.accompanied and each.how is FlightEnd.PILOT else each
        for i, each in zip(flights, outcomes, strict=True)
    ]
