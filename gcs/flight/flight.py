"""Fly a mission over MAVLink and Zenoh: the composition of agents, links, buses and, if asked for, stub vehicles."""

import asyncio
import traceback
from collections.abc import Callable, Coroutine, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from datetime import date
from functools import partial
from math import degrees
from time import perf_counter

from agents.outputs import CoreStatus
from agents.ports import VehicleRefusedError
from agents.shell.agent import Agent
from agents.shell.clock import MissionClock
from agents.shell.outcome import Ending, Outcome, Stop
from agents.shell.parts import AgentParts
from agents.team.perception import Perception
from gcs.console.helm import Helm
from gcs.console.keys import Keys
from gcs.console.live import LiveRow, LiveView
from gcs.flight.equipment import Equipment
from gcs.flight.heartbeat import Supervision, Unsupervised
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import FlightStubs
from gcs.flight.target_vehicle import TargetVehicle
from gcs.flightlog.flight import FlightRecording, Recording, Unrecorded
from gcs.flightlog.records import RunEnd, VehicleEnd
from gcs.link.hub import MavsdkHub
from gcs.metrics.event_log import event_line
from gcs.metrics.journal import Journal
from gcs.metrics.record import FlightRecord
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import Finding, Grade
from gcs.preflight.link_facts import CheckedLink
from gcs.preflight.preflight import preflight
from gcs.preflight.vehicle import clock_lag
from gcs.viewer.scene import Scene
from sitl.server.server import StubRecord

_VIEW_PERIOD_S = 0.2
_UNSUPERVISED = Unsupervised()
Tell = Callable[[Sequence[Finding]], None]


@dataclass(frozen=True, slots=True)
class Flight:
    """What came of it: each vehicle's outcome, the record if the mission began, and the speed asked for and kept."""

    outcomes: dict[int, Outcome]
    record: FlightRecord | None
    speed: float
    speed_kept: float


@dataclass(frozen=True, slots=True)
class _Member:
    """One vehicle of this process."""

    vehicle: MissionVehicle
    link: CheckedLink
    agent: Agent


async def fly(
    plan: FlightPlan,
    view: LiveView,
    tell: Tell = lambda _findings: None,
    supervision: Supervision = _UNSUPERVISED,
) -> Flight:
    """Fly; raises VehicleRefusedError when the team cannot even take off, or should not: `tell` is told the findings.

    Ctrl-C makes every vehicle hold and land, a second one land at once.
    """
    clock = MissionClock(plan.speed or 1.0)
    if plan.log is None:
        return await _fly(plan, clock, view, tell, supervision, Unrecorded())
    with FlightRecording(plan.log, clock, Scene(plan.log.context, plan.mission)) as recording:
        return await _fly(plan, clock, view, tell, supervision, recording)


async def _fly(
    plan: FlightPlan, clock: MissionClock, view: LiveView, tell: Tell, supervision: Supervision, recording: Recording
) -> Flight:
    journal = Journal(plan.mission)
    stop = Stop()
    recording.begin(plan.run(clock.speed))
    async with AsyncExitStack() as stack:
        loop = asyncio.get_running_loop()
        supervision.relay(lambda: loop.call_soon_threadsafe(stop.ask))
        stubs = await stack.enter_async_context(FlightStubs(plan.mission if plan.stubs else None, clock.speed))
        hub = MavsdkHub()
        stack.push_async_callback(hub.close)
        team = [
            _member(plan, vehicle, hub, clock, journal, supervision, recording, view.say) for vehicle in plan.vehicles
        ]
        for member in team:
            stack.push_async_callback(member.agent.close)
        target = TargetVehicle(plan.mission, hub, clock, [member.agent for member in team])
        stack.push_async_callback(target.close)
        view.update([], 0.0, "looking for the vehicles")
        await _unless_stopped(_prepare(team, target, plan, clock, tell, recording), stop)
        recording.begin(plan.run(clock.speed))
        began_s = perf_counter()
        helm = Helm([member.agent for member in team], clock)
        keys = stack.enter_context(Keys(helm.press)) if view.is_live else None
        ask = (lambda: helm.hint) if keys is not None and keys.active else str
        outcomes = await _fly_team(team, plan.duration_s, stop, clock, journal, view, tell, ask, recording)
        wall_time_s = perf_counter() - began_s
    record = _record(plan, team, journal, stubs.record, clock, wall_time_s)
    _complete(recording, team, stubs.record, record)
    kept = clock.speed if stubs.record is None else stubs.record.speed_reached
    return Flight(outcomes, record, clock.speed, kept)


def _member(
    plan: FlightPlan,
    vehicle: MissionVehicle,
    hub: MavsdkHub,
    clock: MissionClock,
    journal: Journal,
    supervision: Supervision,
    recording: Recording,
    say: Callable[[str], None],
) -> _Member:
    mission, equipment = plan.mission, plan.equipment or Equipment()
    config = mission.agent_config(vehicle)
    link = CheckedLink(
        hub,
        vehicle.section.url,
        vehicle.system_id,
        mission.mission_frame(),
        clock.now_s,
        clock.speed,
        settings=mission.link,
        origin_m=vehicle.origin_m,
    )
    parts = AgentParts(
        core=recording.core(config),
        config=config,
        link=link,
        bus=equipment.bus(mission, vehicle),
        clock=clock,
        make_sensor=partial(equipment.sensor, mission, vehicle.id),
        observe=partial(_observe, journal, recording),
        heartbeat=supervision.signs(vehicle.id),
        perception=Perception(mission.mission_frame(), lambda text: say(f"vehicle {vehicle.id}: {text}")),
    )
    return _Member(vehicle, link, Agent(parts))


def _observe(journal: Journal, recording: Recording, status: CoreStatus, tick_us: float | None) -> None:
    journal.note(status, tick_us)
    if tick_us is not None:
        recording.cost(status.vehicle_id, status.time_s, tick_us)


async def _unless_stopped(preparing: Coroutine[None, None, None], stop: Stop) -> None:
    """Prepare the team; the operator may end that at any time."""
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


async def _prepare(
    team: Sequence[_Member],
    target: TargetVehicle,
    plan: FlightPlan,
    clock: MissionClock,
    tell: Tell,
    recording: Recording,
) -> None:
    await _connect(team)
    await target.connect()
    if plan.speed is None:
        await _find_speed(team, clock)
    for member in team:
        member.agent.announce()
    await _check(team, plan.mission, tell, recording)


async def _connect(team: Sequence[_Member]) -> None:
    """Reach everybody, or refuse with the reason of each that cannot be reached."""
    results = await asyncio.gather(*(member.agent.connect() for member in team), return_exceptions=True)
    refused: list[tuple[_Member, VehicleRefusedError]] = []
    for member, result in zip(team, results, strict=True):
        if isinstance(result, VehicleRefusedError):
            refused.append((member, result))
        elif isinstance(result, BaseException):
            raise result
    if len(refused) == 1:
        raise refused[0][1]
    if refused:
        raise VehicleRefusedError("\n".join(_told(member.vehicle, refusal) for member, refusal in refused), "")


def _told(vehicle: MissionVehicle, refusal: VehicleRefusedError) -> str:
    """Return one line about a vehicle among several that cannot be reached."""
    reason = refusal.reason.removeprefix(f"vehicle {vehicle.system_id} ")
    return f"vehicle {vehicle.id}: {reason}; next: {refusal.next_step}"


async def _find_speed(team: Sequence[_Member], clock: MissionClock) -> None:
    """Let the clock run as fast as the autopilots': a simulator may be faster than the wall."""
    clock.set_speed(await team[0].link.measure_speed())
    for member in team:
        member.link.set_speed(clock.speed)


async def _check(team: Sequence[_Member], mission: Mission, tell: Tell, recording: Recording) -> None:
    """Look at everything before anything is armed."""
    facts = await asyncio.gather(*(member.link.facts(member.vehicle.id) for member in team))
    for each in facts:
        recording.meet(each)
    findings = preflight(mission, facts, date.today())
    tell(findings)
    refused = sum(finding.grade is Grade.REFUSE for finding in findings)
    if refused:
        raise VehicleRefusedError(
            f"nothing was armed: the preflight check refuses {refused} of the {len(findings)} things it looks at",
            "do what is said above, then fly again; `cordon check` looks without flying",
        )


async def _fly_team(
    team: Sequence[_Member],
    duration_s: float,
    stop: Stop,
    clock: MissionClock,
    journal: Journal,
    view: LiveView,
    tell: Tell,
    hint: Callable[[], str],
    recording: Recording,
) -> dict[int, Outcome]:
    async def one(member: _Member) -> Outcome:
        try:
            outcome = await member.agent.fly(duration_s, stop)
        except Exception as error:  # a bug in one agent must not take the others out of the air uncontrolled
            traceback.print_exc()
            stop.ask()
            return Outcome(
                Ending.FAILED, f"{type(error).__name__}: {error}", "report this with the text above", flew=True
            )
        never_began = member.agent.start_s is None and not stop.wanted.is_set()
        if never_began or (outcome.ending is Ending.REFUSED and not outcome.flew):
            stop.ask()  # the mission needs everybody: those in the air come down again
        return outcome

    watching = asyncio.create_task(_watch(team, stop, clock, journal, view, tell, hint, recording))
    try:
        outcomes = await asyncio.gather(*map(one, team))
    finally:
        watching.cancel()
        _tell_news(team, journal, view)
    return {member.vehicle.id: outcome for member, outcome in zip(team, outcomes, strict=True)}


async def _watch(
    team: Sequence[_Member],
    stop: Stop,
    clock: MissionClock,
    journal: Journal,
    view: LiveView,
    tell: Tell,
    hint: Callable[[], str],
    recording: Recording,
) -> None:
    told: set[int] = set()
    log_fault = ""
    while True:
        _tell_clocks(team, told, tell)
        _tell_news(team, journal, view)
        if recording.fault and not log_fault:
            log_fault = recording.fault
            view.say(f"the log is not whole: {log_fault}; the flight goes on")
        start_s = team[0].agent.start_s
        mission_time_s = 0.0 if start_s is None else max(clock.now_s() - start_s, 0.0)
        message = "holding and landing; Ctrl-C once more: land at once" if stop.wanted.is_set() else ""
        rows = [_row(member, journal.latest.get(member.vehicle.id)) for member in team]
        view.update(rows, mission_time_s, message, hint())
        await asyncio.sleep(_VIEW_PERIOD_S)


def _tell_news(team: Sequence[_Member], journal: Journal, view: LiveView) -> None:
    for event in journal.news():
        view.say(event_line(event, team[0].agent.start_s))


def _tell_clocks(team: Sequence[_Member], told: set[int], tell: Tell) -> None:
    """Tell once of every computer elsewhere whose clock is not quite this one's."""
    told |= {member.vehicle.id for member in team}  # they share this one
    for member in team:
        for peer, lag_s in member.agent.clock_lags_s.items():
            finding = clock_lag(member.vehicle.id, peer, lag_s)
            if peer not in told and finding.grade is not Grade.PASS:
                told.add(peer)
                tell([finding])


def _row(member: _Member, status: CoreStatus | None) -> LiveRow:
    vehicle = member.link.status
    polar = None if status is None else status.polar
    place = None if status is None else status.place
    return LiveRow(
        vehicle_id=member.vehicle.id,
        tactic="-" if status is None else status.tactic.value,
        mode=vehicle.mode.value,
        connected=vehicle.connected,
        radius_m=None if polar is None else polar.radius_m,
        angular_rate_rad_s=None if polar is None else polar.angular_rate_rad_s,
        spacing_lead_deg=None if place is None or place.lead_rad is None else degrees(place.lead_rad),
        spacing_lag_deg=None if place is None or place.lag_rad is None else degrees(place.lag_rad),
        battery=vehicle.battery,
        note="" if status is None else _remark(status),
    )


def _remark(status: CoreStatus) -> str:
    dropped = f"{status.messages_dropped} messages dropped" if status.messages_dropped else ""
    return ", ".join(filter(None, [status.alert, status.slowed, dropped]))


def _record(
    plan: FlightPlan,
    team: Sequence[_Member],
    journal: Journal,
    stubs: StubRecord | None,
    clock: MissionClock,
    wall_time_s: float,
) -> FlightRecord | None:
    start_s = team[0].agent.start_s
    if start_s is None or not journal.latest:
        return None
    seen_s = max(status.time_s for status in journal.latest.values())
    ended_s = max((member.agent.ended_s or seen_s for member in team), default=seen_s)
    flown_s = min(min(seen_s, ended_s) - start_s, plan.duration_s)
    loops = [member.agent.loop for member in team]
    return journal.record(
        start_s,
        max(flown_s, 0.0),
        ticks=sum(loop.ticks for loop in loops),
        missed=sum(loop.missed for loop in loops),
        wall_time_s=wall_time_s,
        source=plan.source(clock.speed),
        truth=() if stubs is None else stubs.tracks,
    )


def _complete(
    recording: Recording, team: Sequence[_Member], stubs: StubRecord | None, record: FlightRecord | None
) -> None:
    """Record what is known once all is over."""
    true = {} if stubs is None else {track.vehicle_id: track for track in stubs.tracks}  # a stub knows its system id
    for member in team:
        loop = member.agent.loop
        recording.end_vehicle(member.vehicle.id, VehicleEnd(loop.ticks, loop.missed, member.agent.ended_s))
        if member.vehicle.system_id in true:
            recording.reveal(member.vehicle.id, true[member.vehicle.system_id])
    if record is not None:
        recording.end(RunEnd(float(record.time_s[-1]), record.wall_time_s))
