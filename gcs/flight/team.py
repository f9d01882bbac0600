"""The vehicles that one process flies, and what their agents share: clock, event journal, recording."""

import asyncio
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import radians

from msgspec import structs

from agents.control.plan import PlannerError
from agents.outputs import CoreStatus
from agents.ports import Heartbeat, PeerBus, TargetSensor, VehicleRefusedError
from agents.shell.agent import Agent
from agents.shell.clock import MissionClock, WallClock
from agents.shell.control_loop import AgentParts
from agents.shell.life import Phase
from agents.shell.outcome import Outcome, Stop
from agents.team.external_positions import ExternalPositions
from agents.team.perception import Perception
from estimation.frames import MissionFrame
from estimation.state import Sighting
from gcs.console.live import LiveView
from gcs.errors import InputError
from gcs.flight.equipment import Equipment
from gcs.flight.plan import FlightPlan
from gcs.flightlog.flight import Recording
from gcs.flightlog.records import RunEnd, VehicleEnd
from gcs.keys.team_keys import TeamKeys
from gcs.link.calls import NotReceivedError
from gcs.link.config import LinkConfig, link_paces
from gcs.link.ground_truth import extrapolated_m
from gcs.link.hub import MavsdkHub
from gcs.link.rates import RateController
from gcs.metrics.ending import Unaccounted, VehicleEnding
from gcs.metrics.journal import Journal, RunTotals
from gcs.metrics.record import FlightRecord
from gcs.mission.file import joined_mission
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.computer import ComputerFacts, computer_facts
from gcs.preflight.findings import VehicleFacts
from gcs.preflight.link_facts import CheckedLink, unreachable
from gcs.preflight.priority import RaisedPriority
from sitl.server.record import StubRecord, TruthTrack

Place = Callable[[float], tuple[float, float] | None]
"""Returns a horizontal position in the mission frame at a time of the mission clock; None if it is unknown."""
DISARMED = "disarmed"
_FIND_AGAIN_S = 1.0
"""The pause before an absent reserve is looked for again [wall s]."""
KEPT_S = 10.0
"""How long errors of the estimate are kept: no sighting is delayed by more [s of the mission clock]."""


class TrueSensor:
    """Implements `agents.ports.TargetSensor`: the sighting's position has the error of the vehicle's estimate.

    A camera on board measures the target's position relative to the vehicle; the vehicle adds its estimate of its own
    position at that time. Without the truth, as on real vehicles, the sensor measures from the estimate.
    """

    def __init__(self, sensor: TargetSensor, true_m: Place, estimated_m: Place) -> None:
        self._sensor = sensor
        self._true_m = true_m
        self._estimated_m = estimated_m
        self._errors_m: deque[tuple[float, float, float]] = deque()

    def sight(self, now_s: float, position_m: tuple[float, float]) -> tuple[Sighting, ...]:
        """Return the sightings that are due, of the targets within range of the vehicle; they may be delayed ones."""
        true_m, estimated_m = self._true_m(now_s), self._estimated_m(now_s)
        if true_m is None or estimated_m is None:
            true_m = estimated_m = position_m
        self._errors_m.append((now_s, estimated_m[0] - true_m[0], estimated_m[1] - true_m[1]))
        while self._errors_m[0][0] < now_s - KEPT_S:
            self._errors_m.popleft()
        return tuple(map(self._as_reported, self._sensor.sight(now_s, true_m)))

    def _as_reported(self, sighting: Sighting) -> Sighting:
        off_x, off_y = self._errors_m[-1][1:]
        for at_s, x, y in reversed(self._errors_m):  # from the newest: a sighting is seldom late
            if at_s < sighting.time_s:
                break
            off_x, off_y = x, y
        x, y = sighting.position_m
        return structs.replace(sighting, position_m=(x + off_x, y + off_y))


@dataclass(frozen=True, slots=True)
class Member:
    """One vehicle of this process."""

    vehicle: MissionVehicle
    link: CheckedLink
    agent: Agent

    @property
    def ending(self) -> str:
        """The state of a vehicle whose flight has ended, by its autopilot; empty before."""
        if self.agent.phase is not Phase.ENDED:
            return ""
        status = self.link.status
        if not status.connected:
            return "no link"
        return "handed over" if status.armed else DISARMED


@dataclass(frozen=True, slots=True)
class FlightTeam:
    """The members of this process and everything that they share in one flight.

    `stop` is the operator's request to end; `view` is the live view; `signing_keys` are those of the links,
    by the vehicle's system id. `absent` are reserves that have not been received yet, with the reason. `newest` is each
    vehicle's newest status, also during take-off and landing; `buses` and `kinds` are the vehicles' buses and kinds by
    id. `priority` is entered for a flight on the wall's clock.
    `accompanied` are members that their pilots fly, from the beginning; `ends` is the end of each vehicle's flight in
    the log.
    """

    plan: FlightPlan
    clock: MissionClock
    recording: Recording
    view: LiveView
    journal: Journal
    keys: TeamKeys
    signing_keys: Mapping[int, bytes] = field(default_factory=dict, repr=False)
    stop: Stop = field(default_factory=Stop)
    members: list[Member] = field(default_factory=list)
    buses: dict[int, PeerBus] = field(default_factory=dict)
    absent: dict[int, VehicleRefusedError] = field(default_factory=dict)
    newest: dict[int, CoreStatus] = field(default_factory=dict)
    kinds: dict[int, str] = field(default_factory=dict)
    priority: RaisedPriority = field(default_factory=RaisedPriority)
    accompanied: set[int] = field(default_factory=set)
    ends: dict[int, VehicleEnd] = field(default_factory=dict)

    @property
    def agents(self) -> list[Agent]:
        """The members' agents."""
        return [member.agent for member in self.members]

    @property
    def start_s(self) -> float | None:
        """The mission's start on the shared clock, once the agents agreed on it."""
        return next((each for agent in self.agents if (each := agent.start_s) is not None), None)

    @property
    def flown_mission(self) -> Mission:
        """The mission, with a vehicle of another process that has joined its flight."""
        mission = self.plan.mission
        added = next((each for agent in self.agents if (each := agent.added) is not None), None)
        return mission if added is None else joined_mission(mission, *added)

    def begin_vehicle(self, facts: VehicleFacts) -> None:
        """Record what is known of a vehicle before take-off, its kind, and from now on its true motion, if a simulator
        sends it; nothing of one that is not received.
        """
        if facts.unreachable is not None:
            return
        self.recording.begin_vehicle(facts)
        self.kinds[facts.vehicle_id] = facts.kind.value
        for member in self.members:
            if member.vehicle.id == facts.vehicle_id and member.link.truth is not None:
                member.link.truth.on_sample = partial(self.recording.truth, facts.vehicle_id)

    def equip(self, hub: MavsdkHub, heartbeat: Callable[[int], Heartbeat]) -> None:
        """Create the links and the agents of all vehicles of this process, not yet connected.

        `heartbeat` is called with a vehicle's id. Raises InputError when keys are missing or not valid, or a planner
        cannot be made.
        """
        plan = self.plan
        equipment = plan.equipment or Equipment()
        self.buses.update(equipment.buses(plan.mission, plan.vehicles, self.clock, self.keys))
        paces = link_paces(plan.mission, truth=not (plan.only_stubs or plan.mission.frame.local))
        for vehicle in plan.vehicles:
            link = self._link(vehicle, hub, paces[vehicle.section.url])
            agent = self._agent(vehicle, link, self.buses[vehicle.id], heartbeat(vehicle.id))
            self.members.append(Member(vehicle, link, agent))

    def _link(self, vehicle: MissionVehicle, hub: MavsdkHub, pace: RateController) -> CheckedLink:
        mission, clock = self.plan.mission, self.clock
        config = LinkConfig(
            vehicle.section.url,
            vehicle.system_id,
            mission.mission_frame(),
            pace,
            vehicle.origin_m,
            signing_key=self.signing_keys.get(vehicle.system_id),
            truth=pace.truth_bytes_s > 0.0 and vehicle.id not in self.plan.stubs,
            external_positions=self._located_from_outside(vehicle),
            view_rad=None if vehicle.section.gimbal is None else radians(vehicle.section.gimbal.view_deg),
            traffic=mission.safety.traffic_distance_m > 0.0,
        )
        return CheckedLink(hub, config, clock)

    def _located_from_outside(self, vehicle: MissionVehicle) -> bool:
        """Return whether a vehicle needs external positions; the stubs of a flight do not."""
        return self.plan.mission.frame.external_positions and vehicle.id not in self.plan.stubs

    def _agent(self, vehicle: MissionVehicle, link: CheckedLink, bus: PeerBus, heartbeat: Heartbeat) -> Agent:
        mission, equipment = self.plan.mission, self.plan.equipment or Equipment()
        config = mission.agent_config(vehicle)

        def report(text: str) -> None:
            self.view.print_line(f"vehicle {vehicle.id}: {text}")

        try:
            core = self.recording.core(config, None if self.plan.planner is None else self.plan.planner.factory)
        except PlannerError as error:
            raise InputError([f"planner: {error}"]) from error
        parts = AgentParts(
            core=core,
            config=config,
            link=link,
            bus=bus,
            clock=self.clock,
            make_sensor=lambda start_s: _true_sensor(equipment.sensor(mission, vehicle.id, start_s), link),
            observe=self._observe,
            heartbeat=heartbeat,
            perception=Perception(mission.mission_frame(), report, config.targets),
            positions=ExternalPositions(vehicle.id, report) if self._located_from_outside(vehicle) else None,
            mission=mission.identity,
        )
        return Agent(parts)

    def _observe(self, status: CoreStatus, tick_us: float | None) -> None:
        self.newest[status.vehicle_id] = status
        self.journal.note(status, tick_us)
        if tick_us is not None:
            self.recording.cost(status.vehicle_id, status.time_s, tick_us)

    async def connect(self) -> None:
        """Connect all links and buses; a reserve may come later (`find_absent`).

        Raises VehicleRefusedError with the reason of each of the others that cannot be reached.
        """
        refused = await self._connect()
        for member, refusal in refused:
            if member.vehicle.section.reserve and isinstance(refusal, NotReceivedError):
                self.absent[member.vehicle.id] = refusal
        _refuse([each for each in refused if each[0].vehicle.id not in self.absent])

    async def find_absent(self) -> None:
        """Connect each reserve that is absent once it is received, until all are there or this is cancelled."""
        await asyncio.gather(*(self._find(each) for each in self.members if each.vehicle.id in self.absent))

    async def _find(self, member: Member) -> None:
        vehicle_id = member.vehicle.id
        while vehicle_id in self.absent:
            try:
                await member.agent.connect_link()
            except VehicleRefusedError as refusal:
                if refusal.reason != self.absent[vehicle_id].reason:
                    self.absent[vehicle_id] = refusal
                    self.view.print_line(f"vehicle {vehicle_id}, in reserve: {refusal.reason}", "warning")
                await asyncio.sleep(_FIND_AGAIN_S)
            else:
                member.link.follow_clock()
                del self.absent[vehicle_id]
                self.view.print_line(f"vehicle {vehicle_id}, in reserve, is received now")

    async def connect_some(self) -> dict[int, VehicleRefusedError]:
        """Connect the links and buses that can be; return why the others, which are members no more, cannot.

        Raises as `connect` if none can.
        """
        refused = await self._connect()
        if len(refused) == len(self.members):
            _refuse(refused)
        await self.leave({member.vehicle.id for member, _ in refused})
        return {member.vehicle.id: refusal for member, refusal in refused}

    async def leave(self, vehicle_ids: Collection[int]) -> None:
        """Release the links and buses of members, which are members no more."""
        left = [member for member in self.members if member.vehicle.id in vehicle_ids]
        self.members[:] = [member for member in self.members if member not in left]
        await asyncio.gather(*(member.agent.close() for member in left))

    async def _connect(self) -> list[tuple[Member, VehicleRefusedError]]:
        results = await asyncio.gather(*(agent.connect() for agent in self.agents), return_exceptions=True)
        refused: list[tuple[Member, VehicleRefusedError]] = []
        for member, result in zip(self.members, results, strict=True):
            if isinstance(result, VehicleRefusedError):
                refused.append((member, result))
            elif isinstance(result, BaseException):
                raise result
        return refused

    async def measure_speed(self) -> None:
        """Set the clock to the autopilots' speed: a simulator may run faster than the wall clock."""
        assert isinstance(self.clock, WallClock)
        present = next(member for member in self.members if member.vehicle.id not in self.absent)
        self.clock.set_speed(await present.link.measure_speed())
        for member in self.members:
            member.link.follow_clock()

    async def facts(self, settle_s: float) -> Sequence[VehicleFacts]:
        """Return what the vehicles on the ground report, once they are healthy or `settle_s` has passed."""
        present = [member for member in self.members if member.vehicle.id not in self.absent]
        facts = await asyncio.gather(*(member.link.facts(member.vehicle.id, settle_s) for member in present))
        return [*facts, *(unreachable(i, refusal, refusal.reason) for i, refusal in self.absent.items())]

    async def computer(self) -> ComputerFacts | None:
        """Measure whether this computer is prompt enough; None for a flight that is not on the wall's clock."""
        plan = self.plan
        if not plan.needs_prompt_computer:
            return None
        return await computer_facts(plan.mission, plan.vehicles, self.priority.privileges, self.clock.speed)

    def record(
        self, stubs: StubRecord | None, wall_time_s: float, outcomes: Mapping[int, Outcome]
    ) -> FlightRecord | None:
        """Return the record of the mission, None if it never began."""
        start_s = self.start_s
        if start_s is None or not self.journal.latest:
            return None
        seen_s = max(status.time_s for status in self.journal.latest.values())
        ended_s = max((agent.ended_s or seen_s for agent in self.agents), default=seen_s)
        flown_s = min(min(seen_s, ended_s) - start_s, self.plan.duration_s)
        loops = [agent.loop for agent in self.agents]
        totals = RunTotals(
            self.plan.source(self.clock.time_scale),
            sum(loop.ticks for loop in loops),
            sum(loop.missed for loop in loops),
            wall_time_s,
            (*self._received_truth(), *(() if stubs is None else stubs.tracks)),
            endings=tuple(ending_of(i, outcome, self.plan.mission.mission_frame()) for i, outcome in outcomes.items()),
            faults=tuple(fault.injected for fault in self.plan.faults),
            kinds=self.kinds,
            views={member.vehicle.id: tuple(member.link.views) for member in self.members},
        )
        self.journal.enlarge(self.flown_mission)
        return self.journal.record(start_s, max(flown_s, 0.0), totals)

    def _received_truth(self) -> tuple[TruthTrack, ...]:
        """Return the true motions that the vehicles' simulators sent; real vehicles send none."""
        truths = (member.link.truth for member in self.members)
        return tuple(truth.track() for truth in truths if truth is not None and truth.newest is not None)

    def note_end(self, member: Member, outcome: Outcome) -> None:
        """Add to the log how a vehicle's flight has ended, unless the log says so: this process may not end by itself.

        `outcome` is `FLIES_AGAIN` as long as that of a further flight is not known.
        """
        loop, ended_s = member.agent.loop, member.agent.ended_s
        end = VehicleEnd(loop.ticks, loop.missed, ended_s, outcome.how.value, _reason(outcome), outcome.unaccounted)
        if self.ends.get(member.vehicle.id) != end:
            self.ends[member.vehicle.id] = end
            self.recording.end_vehicle(member.vehicle.id, end)

    def complete(self, stubs: StubRecord | None, record: FlightRecord | None, outcomes: Mapping[int, Outcome]) -> None:
        """Add to the log what is known once the flight is over."""
        true = {} if stubs is None else {track.vehicle_id: track for track in stubs.tracks}  # by system id
        for member in self.members:
            self.note_end(member, outcomes[member.vehicle.id])
            if member.vehicle.system_id in true:
                self.recording.true_track(member.vehicle.id, true[member.vehicle.system_id])
        if record is not None:
            self.recording.note_run(RunEnd(float(record.time_s[-1]), record.wall_time_s))


def ending_of(vehicle_id: int, outcome: Outcome, frame: MissionFrame) -> VehicleEnding:
    """Return how a vehicle's flight ended, from the outcome of its agent."""
    last = outcome.unaccounted
    unaccounted = None if last is None else Unaccounted.of(vehicle_id, last, frame)
    return VehicleEnding(vehicle_id, outcome.how, _reason(outcome), unaccounted)


def _reason(outcome: Outcome) -> str:
    return outcome.reason or "landed and disarmed"


def _true_sensor(sensor: TargetSensor, link: CheckedLink) -> TargetSensor:
    """Return the sensor at the true position of the vehicle, if a simulator sends it."""
    truth = link.truth
    if truth is None:
        return sensor

    def estimated_m(now_s: float) -> tuple[float, float] | None:
        return None if link.motion is None else extrapolated_m(link.motion, now_s)

    return TrueSensor(sensor, truth.position_m, estimated_m)


def _refuse(refused: Sequence[tuple[Member, VehicleRefusedError]]) -> None:
    """Raise VehicleRefusedError with the reasons of all that cannot be reached, if any."""
    if len({id(refusal) for _, refusal in refused}) == 1:  # of one vehicle, or of the bus that they share
        raise refused[0][1]
    if refused:
        raise VehicleRefusedError("\n".join(_line(member.vehicle, refusal) for member, refusal in refused), "")


def _line(vehicle: MissionVehicle, refusal: VehicleRefusedError) -> str:
    """Return one line about a vehicle among several that cannot be reached."""
    return f"vehicle {vehicle.id}: {refusal.clause}; next: {refusal.next_step}"
