"""Fly a mission over MAVLink and Zenoh: the composition of agents, links, buses and, on request, stub vehicles."""

import asyncio
import gc
import traceback
from collections.abc import Coroutine, Iterator
from contextlib import AsyncExitStack, ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from time import perf_counter

from agents.flight_end import FlightEnd
from agents.ports import VehicleRefusedError
from agents.shell.clock import MissionClock, WallClock
from agents.shell.outcome import BY_OPERATOR, Outcome, Stop
from gcs.console.live import LiveView
from gcs.flight.fault_injector import FaultInjector
from gcs.flight.keyboard import command_by_keyboard
from gcs.flight.plan import FlightPlan
from gcs.flight.preparation import Readiness, StartWait
from gcs.flight.stubs import FlightStubs, clock_refusal, url_ports
from gcs.flight.supervision.heartbeat import SupervisorLink, Unsupervised
from gcs.flight.target_vehicle import TargetVehicle
from gcs.flight.team import FlightTeam, Member
from gcs.flight.watch import FindingsReport, Watch
from gcs.flightlog.flight import FlightRecording, Recording, Unrecorded
from gcs.keys.team_keys import flight_keys
from gcs.link.hub import MavsdkHub
from gcs.link.ports.claims import fed_ports, flight_claims
from gcs.link.signing_keys import signing_keys
from gcs.metrics.journal import Journal
from gcs.metrics.record import FlightRecord
from gcs.preflight.findings import Grade
from sitl.server.governed_clock import GovernedClock
from sitl.server.shared_clock import ClockError, Rank, new_clock

PREPARING_SPEED = 10.0
"""The highest speed of stubs before take-off: connecting to them takes wall time, in which the flight would go on."""
_UNSUPERVISED = Unsupervised()
_ORPHANED = Outcome(FlightEnd.WATCHDOG, "the flight's supervisor process had ended")


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """The result: each vehicle's outcome, the record if the mission began, and the speeds requested and reached."""

    outcomes: dict[int, Outcome]
    record: FlightRecord | None
    speed: float
    speed_reached: float


async def fly(
    plan: FlightPlan,
    view: LiveView,
    report: FindingsReport = lambda _findings: None,
    supervisor: SupervisorLink = _UNSUPERVISED,
) -> FlightOutcome:
    """Fly; raises VehicleRefusedError when the team cannot or must not take off. `report` receives the findings.

    Raises InputError when the keys of the team, or of signed links, are missing or not valid.

    Ctrl-C makes every vehicle hold, then land; a second Ctrl-C makes them land at once.
    """
    injector = FaultInjector(plan.faults)
    if plan.faults:
        plan = replace(plan, equipment=injector.equipment())
    with ExitStack() as stack:
        clock = _mission_clock(plan, stack)
        keys = stack.enter_context(flight_keys(plan.mission))
        recording: Recording = Unrecorded()
        if plan.log is not None:
            recording = stack.enter_context(FlightRecording(plan.log, clock))
        team = FlightTeam(plan, clock, recording, view, Journal(plan.mission), keys, signing_keys(plan.mission))
        return await _fly(team, report, supervisor, injector)


def _mission_clock(plan: FlightPlan, stack: ExitStack) -> MissionClock:
    """Return the clock of a flight, until the stack ends: governed if every vehicle is a stub.

    Raises VehicleRefusedError if no clock can be shared, InputError for a url no stub can serve.
    """
    if not plan.is_governed:
        return WallClock(plan.speed or 1.0)
    speed = plan.speed or 1.0
    try:
        name = plan.clock or stack.enter_context(
            new_clock(min(speed, PREPARING_SPEED), url_ports(plan.mission, plan.stubs).values())
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
    team: FlightTeam, report: FindingsReport, supervisor: SupervisorLink, injector: FaultInjector
) -> FlightOutcome:
    plan, clock = team.plan, team.clock
    team.recording.begin(plan.run(clock.time_scale))
    # First: a url that stubs cannot serve is bad input, also while a port is in use.
    flight_stubs = FlightStubs(plan.mission, plan.stubs, clock)
    async with AsyncExitStack() as stack:
        loop = asyncio.get_running_loop()
        claims = stack.enter_context(flight_claims(plan.mission, plan.stubs))
        supervisor.relay(
            lambda: loop.call_soon_threadsafe(team.stop.request, _ORPHANED if supervisor.is_lost else BY_OPERATOR)
        )
        stubs = await stack.enter_async_context(flight_stubs)
        if plan.needs_prompt_computer:  # after the stubs: they do not inherit it
            stack.enter_context(team.priority)
        hub = MavsdkHub(clock)
        stack.push_async_callback(hub.close)
        team.equip(hub, supervisor.heartbeat)
        for agent in team.agents:
            stack.push_async_callback(agent.close)
        target = TargetVehicle(plan.mission, hub, clock, team.agents, team.signing_keys)
        stack.push_async_callback(target.close)
        team.view.update([], 0.0, "looking for the vehicles")
        await _unless_stopped(_prepare(team, target, report), team.stop)
        # Vehicles send to these ports now: no stub server may start on them later. Stubs hold their ports themselves.
        list(claims.take_fed(fed_ports(plan.vehicles)))
        team.recording.begin(plan.run(clock.time_scale))
        gc.freeze()  # links and agents live as long as the flight: no collection examines them
        hint = await command_by_keyboard(team, stack)
        began_s, began_mission_s = perf_counter(), clock.now_s()
        async with supervisor.follow(clock):
            with _at_speed(plan.speed, clock):
                outcomes = await _fly_members(team, Watch(team, report, hint), injector.run(team, stubs))
        wall_time_s, mission_time_s = perf_counter() - began_s, clock.now_s() - began_mission_s
    record = team.record(stubs.record, wall_time_s, outcomes)
    team.complete(stubs.record, record, outcomes)
    return FlightOutcome(outcomes, record, plan.speed or clock.speed, mission_time_s / wall_time_s)


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
    await team.connect()
    await target.connect()
    readiness = Readiness(team)
    if team.plan.speed is None and not team.plan.is_governed:
        await readiness.measure_speed()
    for agent in team.agents:
        agent.announce()
    findings = await (StartWait(team).findings() if team.plan.awaits_start else readiness.findings())
    report(findings)
    refused = sum(finding.grade is Grade.REFUSE for finding in findings)
    if refused:
        raise VehicleRefusedError(
            f"nothing was armed: {refused} of the {len(findings)} preflight findings forbid take-off",
            "correct the findings above, then fly again; `cordon check` runs the checks without flying",
        )


async def _fly_members(team: FlightTeam, watch: Watch, injection: Coroutine[None, None, None]) -> dict[int, Outcome]:
    beside = [asyncio.create_task(watch.run()), asyncio.create_task(injection)]
    try:
        outcomes = await asyncio.gather(*(_fly_member(team, member) for member in team.members))
    finally:
        for task in beside:
            task.cancel()
        watch.end()
    return {member.vehicle.id: outcome for member, outcome in zip(team.members, outcomes, strict=True)}


async def _fly_member(team: FlightTeam, member: Member) -> Outcome:
    try:
        outcome = await member.agent.fly(team.plan.duration_s, team.stop)
    except Exception as error:  # a bug in one agent must not leave the other vehicles without control
        traceback.print_exc()
        team.stop.request(Outcome(FlightEnd.FAILSAFE, f"the agent of vehicle {member.vehicle.id} failed"))
        return Outcome(
            FlightEnd.ERROR, f"{type(error).__name__}: {error}", "report this with the text above", flew=True
        )
    never_began = member.agent.start_s is None and not team.stop.wanted.is_set()
    if never_began or (outcome.how is FlightEnd.REFUSED and not outcome.flew):
        # The mission needs every vehicle: those in the air land again.
        team.stop.request(Outcome(FlightEnd.FAILSAFE, f"vehicle {member.vehicle.id} did not begin the mission"))
    return outcome
