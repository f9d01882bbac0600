"""`VehicleCore`: the estimation, decision and control of one vehicle, without clock, sockets or asyncio.

Everything that it receives goes through `take`, the time is an argument of `tick`, and all outputs are in what `tick`
returns. The same object therefore flies over MAVLink, in the simulation, and again from a log.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import dist, hypot, inf
from typing import Any, Final

from mypy_extensions import mypyc_attr

from agents.broadcast import StateBroadcast, command_answer, received_sighting
from agents.command_handler import AHEAD_MAX_S, Circumstances, CommandHandler, Reshaping
from agents.control.aims import shifted
from agents.control.journey import Journey
from agents.control.lmpc import QpStatus
from agents.control.plan import Plan, PlannerFactory
from agents.control.planner import planner_of
from agents.control.return_and_land import assembled
from agents.control.transit import FAR_SHARE
from agents.drops import NO_DROPS, Drops, Reason
from agents.gimbal import CameraAim
from agents.inputs import (
    AutopilotStatus,
    Bus,
    Command,
    Computer,
    Ground,
    Killed,
    LateTicks,
    Lying,
    Message,
    Presence,
    ReceivedInput,
    Rejoined,
    Start,
    TacticEvent,
    TimeScale,
    VehicleJoins,
)
from agents.notes import (
    CommandOutcome,
    Notes,
    ReferenceChange,
    ResumeRefusal,
    Revocation,
    RingCommanded,
    ShapeChange,
    TacticChange,
    VehicleAdded,
)
from agents.outputs import CoreStatus, LandingCause, Outgoing, TickOutput
from agents.ports import Connection, FlightMode, ModeSource, Reference, Setpoint
from agents.refusals import added_refusal, aloft_refusal, place_refusal, rejoin_refusal
from agents.ring.chooser import RingChooser, Wanted
from agents.ring.commanded_rings import CommandedRings
from agents.safety.failsafe import POSITION_ALERTS, override
from agents.safety.failsafe_monitor import FailsafeMonitor
from agents.safety.fault_detector import FaultDetector, Faults
from agents.safety.guard import Guard, Guarded, GuardStatus, Interventions
from agents.safety.landing import OtherVehicles
from agents.safety.neighbours import NEAR_FOR_S, Neighbours
from agents.safety.traffic import KnownTraffic
from agents.setpoint import STAYS, Altitude, FeedForward, SlewLimit, Yaw
from agents.settings.config import AgentConfig
from agents.situation.estimator import Estimator
from agents.situation.own_sensor import OwnSensors
from agents.situation.situation import Situation
from agents.situation.task import Task
from agents.tactics import Event, Tactic, decides_to_encircle, next_tactic, reasons
from agents.team.clock_watch import ClockWatch
from agents.team.consistency_check import ConsistencyCheck, Limits
from agents.team.inbox import Inbox
from agents.team.messages import (
    CONDITIONS_LIMIT,
    LINK_SILENT_S,
    AddedVehicle,
    CommandAnswer,
    CommandedRing,
    MemberState,
    NextChange,
    OperatorCommand,
    Outlook,
)
from agents.team.team import Team
from estimation.state import POSITION, Sighting, TargetEstimate, Telemetry, Vector
from estimation.vectors import Pair

_NOTHING_DUE = Outlook()
# What every tick compares with is looked up once: in Python 3.11 a member of an enumeration takes 0.2 us.
_STANDBY: Final = Tactic.STANDBY
_FORMATION: Final = Tactic.FORMATION
_TRANSIT: Final = Tactic.TRANSIT
_RETURN_AND_LAND: Final = Tactic.RETURN_AND_LAND
_LAND: Final = Tactic.LAND
_PILOT_OVERRIDE: Final = Tactic.PILOT_OVERRIDE
_FALLBACK: Final = QpStatus.FALLBACK
_BRAKED: Final = GuardStatus.BRAKED
_PASSED: Final = GuardStatus.PASSED
_ON_A_RING = (Tactic.ENCIRCLE, Tactic.TRANSIT)
_IN_PLACE = (Tactic.FORMATION, Tactic.ENCIRCLE)
_UNGUARDED = (Tactic.LAND, Tactic.PILOT_OVERRIDE)
_CHOOSES = (Tactic.STANDBY, Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT)
"""The tactics in which a vehicle chooses among several rings."""
_LEAVES = (Tactic.RETURN_AND_LAND, Tactic.LAND, Tactic.PILOT_OVERRIDE)
"""Those in which others may have its place; in the rest, such as hold, it keeps its bids."""
_GOES_ON = ("start", "resume", "formation", "ring", "assign", "goto", "look")
"""With any other verb an operator takes the decision to resume."""


@mypyc_attr(allow_interpreted_subclasses=True)  # RecordedCore
class VehicleCore:
    """Estimates, decides, plans and guards for one vehicle; `planner` makes its plug-in planner, if any."""

    def __init__(self, config: AgentConfig, planner: PlannerFactory | None = None) -> None:
        self._mission_config, self._plug_in = config, planner
        self._notes = Notes()
        shapes = config.shapes if config.excitation is None else ()
        rings = tuple(each.name for each in config.rings)
        hover_s, has_gimbal = config.safety.abort_hover_s, config.gimbal is not None
        self.commands = CommandHandler(config.vehicle_id, hover_s, shapes, self._notes, rings, has_gimbal=has_gimbal)
        self.added: tuple[int, AddedVehicle] | None = None
        """The vehicle that is not in the mission file and has joined, with its id."""
        self.added_refusal = ""
        """Why the last one that would join must not, empty if it may."""
        self._answers: list[CommandAnswer] = []
        self._revoked: tuple[str, ...] = ()
        self._now_s = 0.0
        self._lying_m: dict[int, Pair] = {}
        self._begin(config)
        self._takes: dict[type, Callable[[Any], None]] = {
            TimeScale: self._take_time_scale,
            Start: self._take_start,
            TacticEvent: self._take_event,
            AutopilotStatus: self._take_autopilot,
            LateTicks: self._take_late_ticks,
            Bus: self._take_bus,
            Drops: self._take_drops,
            Computer: self._take_computer,
            Ground: self._take_ground,
            Telemetry: self._take_telemetry,
            Sighting: self._take_sighting,
            Command: self._take_command,
            Killed: self._take_killed,
            Rejoined: self._take_rejoined,
            VehicleJoins: self._take_added,
            Presence: self._take_presence,
            Lying: self._take_lying,
        }

    def _begin(self, config: AgentConfig) -> None:
        """Begin a flight, the first or another one, with nothing of an earlier one but what operators commanded."""
        self._config = config
        clocks = ClockWatch()
        self._team = Team(ConsistencyCheck(Limits(config.safety, config.failsafe.doubt_m), clocks, POSITION_ALERTS))
        self._inbox = Inbox(config.vehicle_id, config.slots, clocks)
        self._estimator = Estimator(config)
        self._own_sensors = OwnSensors(config)
        self._chooser = RingChooser(config) if len(config.rings) > 1 else None
        self._traffic = KnownTraffic(config)
        self._broadcast = StateBroadcast(config, self._team, self._own_sensors, self._chooser, self._traffic)
        self._fault_detector = FaultDetector(config, self._estimator, self._own_sensors, self._team, clocks)
        self._vehicle = self._fault_detector.vehicle
        self._failsafe = FailsafeMonitor(config)
        self._planner = planner_of(config, self._team, self._plug_in)
        self._has_plug_in = self._plug_in is not None
        self._slew_limit = SlewLimit(config)
        self._neighbours = Neighbours(config)
        self._guard = Guard(config)
        self._interventions = Interventions()
        self._feedforward = FeedForward(config.plant, config.safety.speed_max_m_s)
        self._yaw = Yaw(config)
        self._camera = CameraAim(config)
        self._altitude = Altitude(config)
        self._tactic = Tactic.STANDBY
        self.landing_cause: LandingCause | None = None  # why it lands before its mission's end
        self._layer_m = config.take_off_altitude_m
        self._start_s = inf
        self._formed_s: float | None = None
        self._reshaping: Reshaping | None = None
        self._wanted: Wanted | None = None
        self._commanded = CommandedRings(config)
        self._sightings: list[Sighting] = []
        self._bus_drops = NO_DROPS
        self._reference: Reference | None = None
        self._jumps = 0
        self._restarts = 0
        self._height_m = 0.0
        self._time_scale = 1.0
        self._was_armed = self._was_in_air = self._ends = self._is_over = self._is_adopted = False
        self._is_cut_in_air = self._fell = False

    # The tick

    def tick(self, now_s: float) -> TickOutput:
        """Estimate, decide, plan, guard, send: one step of the control loop at `now_s`."""
        self._carry_out(now_s)
        if self._chooser is not None:
            self._choose_ring(self._chooser, now_s)
        situation = self._estimate(now_s)
        if situation is None:
            return self._output(now_s)
        faults = self._fault_detector.detect(situation, self._tactic, self._failsafe.active, self._time_scale)
        task = self._decide(situation, faults)
        plan = self._plan(task)
        guarded = self._guard_aim(task, plan)
        return self._send(task, plan, guarded)

    def _carry_out(self, now_s: float) -> None:
        """Carry out an operator's order that has become due: the landing after an abort's hover."""
        self._now_s = now_s
        if (event := self.commands.due(self._tactic, now_s)) is not None:
            self._change(event, cause=LandingCause(verb="abort"))

    def _choose_ring(self, chooser: RingChooser, now_s: float) -> None:
        """Choose the ring among the mission's, by the estimates of the last tick; a vehicle that flies no mission keeps
        its ring.
        """
        config, place_m = self._config, self._estimator.position_m
        if place_m is None or self._tactic not in _CHOOSES:
            self._wanted, self._broadcast.ring = None, None
            if self._tactic in _LEAVES:
                chooser.withdraw(now_s)
            return
        on_ring = self._tactic in _ON_A_RING
        wanted = chooser.choose(config, place_m, self._estimator.targets.estimates, now_s, on_ring=on_ring)
        self._wanted = wanted
        if wanted is not None and wanted.ring != config.ring:
            self._config = config = config.on_ring(wanted.ring)
            self._estimator.follow_target(config.target)
            self._team.follow_ring(config.ring)
            self._planner.leave_for(config)
            self._altitude.change(config)
            self._neighbours.change(config)
            self._vehicle.change(config)
            if self._tactic is Tactic.ENCIRCLE:
                self._change(Event.CHANGE_RING, f"to ring '{config.rings[config.ring].name}'")
        self._broadcast.ring = config.ring if on_ring or wanted is not None else None

    def _estimate(self, now_s: float) -> Situation | None:
        """Estimate the motion of vehicle and target, and update the team; None before any telemetry."""
        self._team.expire(now_s, self._time_scale)
        sightings, self._sightings = self._sightings, []
        self._altitude.sight(*[each for each in sightings if each.target == self._config.target])
        if self._jumps != self._estimator.own.jumps:
            self._jumps = self._estimator.own.jumps
            self._leave_old_place()
        situation = self._estimator.estimate(now_s, sightings)
        if situation is not None:
            self._traffic.update(situation, self._team.members())
            self._fault_detector.traffic_near = self._traffic.near(situation)
        if situation is not None and self._team.watch_due(now_s):
            self._team.watch(self._neighbours.near(situation, self._team.members()), now_s + NEAR_FOR_S)
            self._broadcast.often = self._neighbours.meets(situation, self._team.near())
        return situation

    def _leave_old_place(self) -> None:
        """Send no aim that leads from the place before a jump to the one after it: a vehicle that holds stays."""
        self._slew_limit.restart()
        self._vehicle.plant.restart()
        if self._tactic in STAYS:
            self._planner.begin(self._tactic, to_home=False)

    def _decide(self, situation: Situation, faults: Faults) -> Task:
        """Decide on the tactic, first by the faults, then by the mission; and on the altitude layer."""
        if (restarts := self._estimator.own.resets) != self._restarts:
            self._restarts = restarts
            self._failsafe.leave_to_operator()
        event = self._failsafe.react(situation.now_s, faults, self._tactic)
        for change in self._failsafe.news():
            self._notes.add(situation.now_s, change)
        if event is not None:
            because = f"{self.alert} is over" if event is Event.RESUME else ""
            self._change(event, because, cause=LandingCause(self.alert))
        self._follow_journey(situation)
        self._follow_mission(situation)
        if self._is_adopted:
            self._is_adopted, self._layer_m = False, situation.height_m
            self._altitude.begin_at(situation.height_m)
        self._layer_m = self._chosen_layer_m(situation)
        return Task(self._tactic, situation, self._layer_m, self._team.members())

    def _follow_journey(self, situation: Situation) -> None:
        """End the way to a place: there, when a failsafe stops the vehicle, or when it takes too long."""
        journey = self._planner.journey
        if journey is None:
            return
        end = journey.end(situation, self._team.members(), self.alert if self._failsafe.stops else "")
        if end is None:
            return
        self._planner.stay(journey.goal_m if end.has_arrived else None)
        lands, obstacle = end.has_arrived and journey.place.lands, None
        if lands:
            obstacle = self._planner.landing_obstacle(situation, self._other_vehicles())
        did = end.did if obstacle is None else f"has arrived, and holds, does not land: {obstacle.text}"
        is_refused = not end.has_arrived or obstacle is not None
        self._notes.add(self._now_s, CommandOutcome("goto", journey.origin, did, is_refused=is_refused))
        if lands and obstacle is None:
            self._change(Event.LAND, cause=LandingCause(verb="goto", origin=journey.origin))

    def _plan(self, task: Task) -> Plan:
        """Plan the aim of the tactic, within the slew limit."""
        plan, situation = self._planner.plan(task), task.situation
        if plan.ring is not None and plan.ring.news is not None:
            self._notes.add(situation.now_s, plan.ring.news)
        self._estimator.follow_ring(0.0 if plan.ring is None else plan.ring.rate_rad_s, situation.polar)
        return self._slew_limit.bounded(task.tactic, plan, situation)

    def _guard_aim(self, task: Task, plan: Plan) -> Guarded:
        """Guard the aim, unless it has no effect: while the autopilot lands the vehicle or a pilot flies it."""
        situation, aim_m = task.situation, plan.aim_m
        has_effect = task.tactic not in _UNGUARDED
        guarded = self._kept_apart(situation, aim_m) if has_effect else Guarded(aim_m)
        if (news := self._interventions.news(situation.now_s, aim_m, guarded)) is not None:
            self._notes.add(situation.now_s, *news)
        self._fault_detector.unsolved = plan.qp is _FALLBACK or guarded.status is _BRAKED
        return guarded

    def _kept_apart(self, situation: Situation, aim_m: Vector) -> Guarded:
        """Guard an aim against the vehicles that it could bring too close; if that changes it, against all near."""
        lost = self._team.lost(situation.now_s, self._config.safety.lost_avoided_s)
        doubtful = {*self._team.inconsistencies, *self._team.explained}
        near = self._team.near()
        exposed = self._neighbours.exposed(situation, near, aim_m) if not (lost or doubtful) else near
        bodies, encircles = self._neighbours.bodies, self._tactic in _ON_A_RING
        traffic = self._traffic.bodies(situation)
        kept_from = bodies(situation, exposed, lost, doubtful, encircles=encircles)
        guarded = self._guard.check(situation, aim_m, kept_from, traffic)
        if guarded.aim_m is aim_m or len(exposed) == len(near):
            return guarded
        kept_from = bodies(situation, near, lost, doubtful, encircles=encircles)
        return self._guard.check(situation, aim_m, kept_from, traffic)

    def _send(self, task: Task, plan: Plan, guarded: Guarded) -> TickOutput:
        """Make the setpoint from the guarded aim; record and publish what is sent."""
        now_s, aim_m = task.situation.now_s, guarded.aim_m
        setpoint = None if task.tactic is _PILOT_OVERRIDE else self._setpoint(task, plan, guarded)
        self._watch_plant(now_s, task.tactic, setpoint)
        self._slew_limit.sent(aim_m)
        self._planner.sent(guarded=guarded.status is not _PASSED)
        self._estimator.sent(now_s, aim_m)
        sent = shifted(plan, aim_m)
        self._broadcast.goal, self._broadcast.goal_s = self._planner.goal, self._planner.goal_s
        messages = self._broadcast.messages(task, sent, self.alert, self._reshaping, self._drops)
        return self._output(now_s, setpoint, messages, task.situation, sent, guarded)

    def _watch_plant(self, now_s: float, tactic: Tactic, setpoint: Setpoint | None) -> None:
        """Compare the vehicle's motion under its setpoints with its profile's plant."""
        watch = self._vehicle.plant
        if setpoint is None or tactic is _LAND:
            watch.restart()
        else:
            arrives_s = now_s + self._estimator.link_delay_s
            watch.sent(arrives_s, *setpoint.position_m[:2], *setpoint.velocity_m_s[:2])

    def _output(
        self,
        now_s: float,
        setpoint: Setpoint | None = None,
        messages: tuple[Outgoing, ...] = (),
        situation: Situation | None = None,
        plan: Plan | None = None,
        guarded: Guarded | None = None,
    ) -> TickOutput:
        """Return the output of a tick: the results of its stages, None for stages that did not run."""
        answers, self._answers = tuple(self._answers), []
        status = CoreStatus(
            vehicle_id=self._config.vehicle_id,
            time_s=now_s,
            tactic=self._tactic,
            situation=situation,
            plan=plan,
            guarded=guarded,
            peers=self._team.members(),
            drops=self._drops,
            alert=self.alert,
            outlook=self._outlook(now_s),
            notes=self._notes.drained(),
            answers=answers,
            target_altitude_m=self._altitude.target_m,
            turning_rad_s=self._estimator.ring_frequency_rad_s,
            ring=self._config.ring,
            added=None if self.added is None else self.added[0],
        )
        return TickOutput(setpoint, (*map(command_answer, self.commands.answers(now_s)), *messages), status)

    def _outlook(self, now_s: float) -> Outlook | None:
        """Return what holds the vehicle and what it does next, None while nothing is due."""
        failsafe, tactic = self._failsafe, self._tactic
        bent = self._interventions.lasting(now_s, tactic)
        alerts, explained, change = failsafe.alerts, self._team.explained, self._next_change(now_s)
        if not (alerts or explained) and change is None and bent is None:
            return None
        also = *alerts[1:], *[f"vehicle {i} {alert}" for i, alert in explained.items()]
        outlook = Outlook(
            change,
            failsafe.blocks,
            failsafe.waits_for_resume(tactic),
            also[:CONDITIONS_LIMIT],
            () if bent is None else bent.causes,
            () if bent is None else bent.evaded,
        )
        return None if outlook == _NOTHING_DUE else outlook

    def _next_change(self, now_s: float) -> NextChange | None:
        """Return the next change of tactic that the vehicle makes by itself: by a failsafe, or after an abort."""
        change, lands_s = self._failsafe.next_change(self._tactic, now_s), self.commands.abort_lands_s
        if lands_s is None or (change is not None and change.at_s <= lands_s):
            return change
        return NextChange(Tactic.LAND.value, lands_s, "abort")

    # Parts of the stages

    def _follow_mission(self, situation: Situation) -> None:
        """Change the tactic as the mission demands: at its start, near the target, and at the end of the return."""
        now_s, target = situation.now_s, situation.target
        if self._tactic is _STANDBY and now_s >= self._start_s:
            self._change(Event.START)
        if self._tactic is _FORMATION:
            self._formed_s = now_s if self._formed_s is None else self._formed_s
            place_m = situation.own.mean[POSITION]
            if target is not None and self._engages(target, place_m):
                # A vehicle that resumes close to the target is not in its place in line: it leaves from its position.
                in_line = now_s - self._formed_s > self._config.encirclement.smoothing_time_s
                far_m = FAR_SHARE * self._config.encirclement.far_m
                if self._wanted is None or hypot(*(target.mean[POSITION] - place_m).tolist()) < far_m:
                    self._change(Event.ENGAGE, self._reasons(target, place_m))
                    self._planner.engage(now_s, None if in_line else place_m)
                else:
                    self._change(Event.CHANGE_RING, self._reasons(target, place_m))
        if self._tactic is _TRANSIT and target is not None and self._planner.arrived:
            place_m = situation.own.mean[POSITION]
            self._change(Event.ENGAGE, self._reasons(target, place_m))
            self._planner.engage(now_s, place_m)
        if self._tactic is _RETURN_AND_LAND:
            if self._planner.may_land(situation, self._other_vehicles(), self._time_scale):
                self._change(Event.LAND)
            if (news := self._planner.landing_news()) is not None:
                self._notes.add(now_s, news)

    def _other_vehicles(self) -> OtherVehicles:
        """Return the others as one that lands knows them: one that fell silent stays where it was."""
        return OtherVehicles(self._team.members(), self._team.lost(self._now_s, inf), self._lying_m)

    def _engages(self, target: TargetEstimate, place_m: Vector) -> bool:
        """Return whether a vehicle in formation leaves it: for its only ring by the rule, for one of several if it has
        a place there.
        """
        if self._chooser is not None:
            return self._wanted is not None and self._wanted.ring == self._config.ring
        return decides_to_encircle(target, place_m, self._config.decision)

    def _reasons(self, target: TargetEstimate, place_m: Vector) -> str:
        why = reasons(target, place_m, self._config.decision)
        if self._wanted is None:
            return why
        name = self._config.rings[self._config.ring].name
        return f"ring '{name}': assigned by an operator" if self._wanted.assigned else f"ring '{name}': {why}"

    def _chosen_layer_m(self, situation: Situation) -> float:
        """Return the flying altitude once all are in place; until then, and on the return, the vehicle's own layer."""
        config = self._config
        if self._tactic is _RETURN_AND_LAND and self._planner.returns_home:
            return config.return_altitude_m
        if self._layer_m != config.altitude_m and self._tactic in _IN_PLACE:
            place_m, flown_s = situation.own.mean[POSITION], situation.now_s - self._start_s
            if assembled(config, self._tactic, place_m, self._team.members(), flown_s):
                return config.altitude_m
        return self._layer_m

    def _change(self, event: Event, because: str = "", cause: LandingCause | None = None) -> None:
        """Change the tactic by the table, unless a failsafe refuses to resume; `cause` is why the vehicle lands."""
        if event is Event.RESUME and (reason := self._resume_refused):
            self._notes.add(self._now_s, ResumeRefusal(reason))
            return
        excites = self._config.excitation is not None and event in (Event.START, Event.RESUME)
        after = next_tactic(self._tactic, Event.EXCITE if excites else event)
        if after is self._tactic:
            return
        self._notes.add(self._now_s, TacticChange(self._tactic.value, after.value, event.value), because)
        self._tactic = after
        self.landing_cause = (self.landing_cause or cause) if after in (Tactic.RETURN_AND_LAND, Tactic.LAND) else None
        if event is Event.RESUME:
            self._failsafe.resume()
        if event is Event.HANDED_OVER:
            self._name_override()
        self._planner.begin(after, to_home=event is Event.RETURN)
        self._estimator.follow_ring(self._planner.ring_rate_rad_s)
        if after is Tactic.FORMATION:
            self._formed_s = None

    def _name_override(self) -> None:
        """Record what caused a pilot override, and what the autopilot reports about it later."""
        if self._tactic is Tactic.PILOT_OVERRIDE:
            self._failsafe.latch_override(*override(self._vehicle.status))

    def _setpoint(self, task: Task, plan: Plan, guarded: Guarded) -> Setpoint:
        situation = task.situation
        wanted_m, climb_m_s = self._altitude.next(task.tactic, task.layer_m, situation.polar)
        if (altitude_m := self._guard.altitude_m(wanted_m, situation.acting_motion, situation.height_m)) != wanted_m:
            climb_m_s = 0.0
        (x, y), velocity = self._feedforward.split(situation, plan, guarded, climb_m_s)
        off_x, off_y = self._estimator.offset_m
        yaw_rad = self._yaw.turn(task.tactic, situation)
        camera_rad = self._camera.next(situation, self._estimator.link_delay_s, self._altitude.target_m)
        return Setpoint((x + off_x, y + off_y, altitude_m), yaw_rad, velocity, camera_rad)

    # Inputs between ticks

    @property
    def tactic(self) -> Tactic:
        """The present tactic."""
        return self._tactic

    @property
    def alert(self) -> str:
        """The most severe active condition of the failsafe table, empty if there is none."""
        alerts = self._failsafe.alerts
        return alerts[0] if alerts else ""

    @property
    def _resume_refused(self) -> str | None:
        """Why the vehicle must not resume, None if it may."""
        status = self._vehicle.status
        if self._was_in_air and status.connected and not status.in_air:  # its motors still turn for some seconds
            return "it has flown and is on the ground: it takes off again by rejoin"
        if self._reference is not None and not self._reference.is_known:
            return "the origin of its positions is being read again"
        return self._failsafe.refuse_resume()

    @property
    def _drops(self) -> Drops:
        """The messages dropped so far, by the bus and by the core."""
        own = self._inbox.dropped.drops
        return own if self._bus_drops is NO_DROPS else own.plus(self._bus_drops)

    def take(self, item: ReceivedInput) -> None:
        """Take what is received between two ticks."""
        if isinstance(item, Message):  # most of what a vehicle of many receives
            self._take_message(item)
        else:
            self._takes[type(item)](item)

    def _take_time_scale(self, item: TimeScale) -> None:
        self._time_scale = item.factor
        self._failsafe.set_time_scale(item.factor)

    def _take_start(self, item: Start) -> None:
        self._start_s = item.at_s
        self._planner.start(item.at_s)
        self._failsafe.start(item.at_s)

    def _take_event(self, item: TacticEvent) -> None:
        self._is_adopted = self._is_adopted or item.event in (Event.ADOPT, Event.TAKE_OVER)
        self._ends = self._ends or item.event in (Event.HOLD, Event.ADOPT)
        self._is_over = self._is_over or item.event is Event.END
        self._failsafe.leave_to_operator()
        self._change(item.event)

    def _take_autopilot(self, item: AutopilotStatus) -> None:
        if self._vehicle.status.armed and item.status.connected and not item.status.armed and item.status.in_air:
            self._fell = self._fell or self._is_high
        self._vehicle.status = item.status
        self._traffic.receive(item.status.traffic)
        self._follow_reference(item.status.reference)
        self._estimator.follow_link(item.status.round_trip_s)
        self._was_armed = self._was_armed or item.status.armed
        self._was_in_air = self._was_in_air or item.status.in_air
        if item.status.lost is not Connection.NONE or item.status.mode_by is not ModeSource.UNKNOWN:
            self._name_override()

    @property
    def _is_reserve(self) -> bool:
        return self._config.vehicle_id in self._config.reserves

    @property
    def _is_high(self) -> bool:
        """Whether the vehicle was clearly above the ground when its position was received last."""
        low_m = 0.5 * min(self._mission_config.altitude_m, self._mission_config.take_off_altitude_m)
        return self._height_m > low_m

    def _follow_reference(self, reference: Reference) -> None:
        """Take what the positions refer to: a change since the last status is an event."""
        before, self._reference = self._reference or reference, reference
        if reference.moves != before.moves:
            self._fault_detector.origin_moves = reference.moves
            self._notes.add(self._now_s, ReferenceChange("origin moved", *reference.moved_m))
        if reference.jumps != before.jumps:
            self._notes.add(self._now_s, ReferenceChange("position jumped", *reference.jumped_m))
            self._estimator.own.accept_jump()

    def _take_late_ticks(self, item: LateTicks) -> None:
        self._fault_detector.late_ticks = item.count

    def _take_bus(self, item: Bus) -> None:
        self._fault_detector.bus_alive, self._fault_detector.operated = item.alive, item.operated
        if item.revoked != self._revoked:
            self._revoked = item.revoked
            self._notes.add(self._now_s, Revocation(item.revoked))

    def _take_drops(self, drops: Drops) -> None:
        self._bus_drops = self._fault_detector.bus_drops = drops

    def _take_computer(self, item: Computer) -> None:
        self._fault_detector.computer_short_of = item.short_of

    def _take_ground(self, item: Ground) -> None:
        self.commands.start_blockers = item.start_blockers

    def _take_telemetry(self, telemetry: Telemetry) -> None:
        x, y, self._height_m = telemetry.position_m
        self._vehicle.plant.measured(telemetry.time_s, x, y)
        self._estimator.measure(telemetry)

    def _take_sighting(self, sighting: Sighting) -> None:
        """Take a sighting. The newest one of the vehicle's own sensor is sent to the peers with its state, when due."""
        if sighting.sensor_id == self._config.vehicle_id:
            sighting = self._estimator.shared(sighting)
        if self._own_sensors.accepts(sighting):
            self._sightings.append(sighting)

    def _take_message(self, item: Message) -> None:
        """Take a message; one from outside the team, too old or from the future is counted and dropped.

        The shell handles start proposals.
        """
        message, now_s = item.message, item.now_s
        if isinstance(message, MemberState):
            if self._chooser is None:
                if not self._team.waits(message) and self._inbox.accepts_state(message, now_s, self._time_scale):
                    self._take_state(message)
                return
            accepted = self._inbox.accepts_state(message, now_s, self._time_scale)
            if accepted and self._take_bids(self._chooser, message, now_s) and not self._team.waits(message):
                self._take_state(message)
            return
        if not self._inbox.accepts(message, now_s, self._time_scale):
            return
        match message:
            case OperatorCommand():
                sent_s = message.sent_s(self._config.vehicle_id)
                self._command(message, now_s, (now_s - sent_s) / self._time_scale)
            case CommandAnswer():
                self._answers.append(message)

    def _take_bids(self, chooser: RingChooser, state: MemberState, now_s: float) -> bool:
        """Take the bids in a peer's state, whatever its distance; return False for a state of another mission."""
        choice, count = state.choice, len(self._config.rings)
        is_ours = choice is not None and (choice.ring is None or choice.ring < count)
        if choice is None or not is_ours or not chooser.receive(state.sender, choice, now_s):
            self._inbox.dropped.add(Reason.MALFORMED)
            return False
        return True

    def _take_state(self, state: MemberState) -> None:
        numbers = state.numbers
        if self._lying_m:
            self._lying_m.pop(numbers.sender, None)
        if numbers.has_sightings:
            self._receive_sightings(state)
        self._team.receive(state)
        if numbers.is_bare:
            return
        self._traffic.hear(state.traffic or ())
        if state.shape is not None:
            self._reshape(Reshaping(state.shaped_s, state.shape))
        commanded = state.choice.commanded if state.choice is not None else [state.ring] if state.ring else []
        if commanded and not self._has_plug_in:
            self._take_rings_of(state.sender, commanded, state.time_s + AHEAD_MAX_S)

    def _take_rings_of(self, sender: int, commanded: Sequence[CommandedRing], dated_by_s: float) -> None:
        """Take newer values of rings from a peer's state, those that an operator could command the vehicle to fly."""
        dated = {number: ring for number, ring in enumerate(commanded) if ring.is_dated_by(dated_by_s)}
        rings = {number: ring for number, ring in dated.items() if number < len(self._commanded.newest)}
        target_m = self._estimator.targets.position_m
        flyable, refusals = self._commanded.of_peer(sender, rings, self._config, target_m, self._now_s)
        for refusal in refusals:
            self._notes.add(self._now_s, refusal)
        for number in flyable:
            self._change_ring(number, rings[number])

    def _take_command(self, item: Command) -> None:
        self._command(item.command, item.now_s)

    def _take_killed(self, item: Killed) -> None:
        self.commands.on_killed(item.refusal, item.now_s)
        self._fell = self._fell or (self._is_cut_in_air and not item.refusal)

    def _take_rejoined(self, item: Rejoined) -> None:
        self.commands.on_rejoined(item.refusal, item.now_s)
        if item.refusal:
            return
        self._begin(self._mission_config)
        self._fault_detector.join()
        self._follow_commands()

    @property
    def added_aloft(self) -> str:
        """Why the vehicle that has joined must not take off anew, as far as it was received; empty if it may."""
        return "" if self.added is None else self._aloft_refusal(self.added[0])

    def _aloft_refusal(self, vehicle_id: int) -> str:
        states = (*self._team.members(), *self._team.lost(self._now_s, inf))
        return aloft_refusal(vehicle_id, states, self._config)

    def _refuse_added(self, vehicle_id: int, vehicle: AddedVehicle) -> str:
        """Return why a vehicle that is not in the mission file must not join, empty if it may."""
        if self._has_plug_in:
            return "a plug-in planner flies its mission"
        if aloft := self._aloft_refusal(vehicle_id):
            return aloft
        place_m, separation_m = self._estimator.position_m, self._config.safety.separation_m
        away_m = inf if place_m is None else dist(place_m, vehicle.start_m)
        if not self._vehicle.status.armed and away_m < separation_m:
            return f"it stands {away_m:.1f} m from this start: {separation_m:g} m at least"
        return added_refusal(vehicle_id, vehicle, self._config, self._estimator.targets.position_m)

    def _take_added(self, item: VehicleJoins) -> None:
        """Take a vehicle that joins in flight as a member, also for a later flight of this vehicle, if it may."""
        self.added_refusal = self._refuse_added(item.vehicle_id, item.vehicle)
        self._notes.add(self._now_s, VehicleAdded(item.vehicle_id, self.added_refusal))
        if self.added_refusal:
            return
        self.added = item.vehicle_id, item.vehicle
        added = item.vehicle_id, item.vehicle.start_m, item.vehicle.slot_m
        self._mission_config = self._mission_config.with_added(*added)
        self._config = self._config.with_added(*added)
        self._inbox.admit(item.vehicle_id)
        self._commanded.change(self._mission_config)
        for each in (self._planner, self._vehicle):
            each.change(self._config)

    def _take_presence(self, item: Presence) -> None:
        if not item.present:
            self._team.forget(item.vehicle_id)

    def _take_lying(self, item: Lying) -> None:
        self._lying_m[item.vehicle_id] = item.position_m

    def _command(self, command: OperatorCommand, now_s: float, age_s: float = 0.0) -> None:
        self._now_s = now_s
        if command.verb not in _GOES_ON and command.vehicle in (None, self._config.vehicle_id):
            self._failsafe.leave_to_operator()
        circumstances = self._circumstances(now_s)._replace(age_s=age_s)
        if command.ring is not None and (number := command.ring_number or 0) < len(self._commanded.newest):
            ring = self._commanded.newest[number].commanded(command.ring, command.time_s)
            newer = ring.is_newer_than(command.ring, command.time_s)
            refused = "a newer command of the ring applies" if newer else self._ring_refusal(number, ring)
            circumstances = circumstances._replace(ring_refused=refused)
        if command.verb == "goto" and command.place is not None:
            place, estimator = command.place, self._estimator
            here_m, target_m, peers = estimator.position_m, estimator.targets.position_m, self._team.members()
            refused = place_refusal(place, self._config, self._altitude.setpoint_m, here_m, target_m, peers)
            circumstances = circumstances._replace(place_refused=refused)
        effect = self.commands.take(command, self._tactic, now_s, circumstances)
        if effect.event is not None:
            self._change(effect.event, cause=LandingCause(verb=command.verb, origin=command.origin))
        self._is_cut_in_air = self.commands.kills and (self._is_cut_in_air or self._vehicle.status.in_air)
        if effect.goes_to is not None:
            height_m = self._altitude.setpoint_m
            self._planner.go(Journey(self._config, effect.goes_to, command.origin, command.time_s, height_m))
        elif effect.stays and self._planner.journey is not None:
            self._planner.stay()
        self._follow_commands()

    def _follow_commands(self) -> None:
        """Take the shape, the rings, the assignment and the camera's place that operators commanded last."""
        looks_at = self.commands.looks_at
        self._camera.place_m = None if looks_at is None else (looks_at.x_m, looks_at.y_m)
        if self.commands.reshaping is not None:
            self._reshape(self.commands.reshaping)
        for number, ring in enumerate(self.commands.commanded_rings):
            self._change_ring(number, ring)
        if self._chooser is not None:
            self._chooser.assigned = self.commands.assigned

    def _circumstances(self, now_s: float) -> Circumstances:
        status = self._vehicle.status
        refused, change = self._resume_refused or "", self._next_change(now_s)
        if refused and change is not None:
            refused = f"{refused}; {change.text(now_s)}"
        return Circumstances(
            resume_refused=refused,
            is_down=status.connected and not status.armed and (self._was_armed or self._is_reserve),
            rejoin_refused=rejoin_refusal(
                status,
                self._tactic,
                self._config,
                self._team.members(),
                now_s - LINK_SILENT_S * self._time_scale,
                fell=self._fell,
                is_over=self._is_over or self._ends,
            ),
            ring=self._config.ring if self._tactic is Tactic.ENCIRCLE else None,
            follows=not status.connected or status.mode in (FlightMode.OFFBOARD, FlightMode.UNKNOWN),
            link_lost=self._was_armed and not status.connected,
            ends=self._ends,
            is_over=self._is_over,
        )

    def _receive_sightings(self, state: MemberState) -> None:
        for package in state.sightings:
            if self._config.vehicle_id not in package.recipients:
                continue
            try:
                sighting = received_sighting(package, self._config.targets)
            except ValueError:
                self._inbox.dropped.add(Reason.MALFORMED)
                continue
            if self._own_sensors.accepts(sighting):
                self._sightings.append(sighting)

    def _reshape(self, wanted: Reshaping) -> None:
        """Take the newest commanded shape of the formation, from an operator or a peer's state."""
        if wanted.shape not in self._config.shapes or (self._reshaping is not None and wanted <= self._reshaping):
            return
        self._reshaping = wanted
        if wanted.shape != self._config.shape:
            self._config = self._config.reshaped(wanted.shape)
            self._planner.reshape(self._config)
            self._notes.add(self._now_s, ShapeChange(wanted.shape))

    def _change_ring(self, number: int, commanded: CommandedRing) -> None:
        """Take the newest values of a ring, from an operator or a peer's state."""
        newest = self._commanded.newest[number].with_(commanded)
        if newest == self._commanded.newest[number] or self._has_plug_in:
            return
        self._commanded.newest[number] = newest
        self._broadcast.commanded_rings = tuple(self._commanded.newest)
        before, flown = self._config, self._commanded.flown(number, newest)
        ring = flown.encirclement
        if number == before.ring:
            self._config = replace(before, encirclement=ring, decision=flown.decision)
        if before.rings:
            self._config = self._config.with_flown(number, ring)
        if self._config != before:
            for each in (self._planner, self._altitude, self._neighbours, self._vehicle):
                each.change(self._config)
            values = ring.radius_m, ring.angular_rate_rad_s, ring.altitude_m, ring.tilt_deg
            name = before.rings[number].name if before.rings else ""
            self._notes.add(self._now_s, RingCommanded(*values, ring=number, name=name))

    def _ring_refusal(self, number: int, commanded: CommandedRing) -> str:
        """Return why the vehicle cannot fly a commanded ring about the present target, empty if it can."""
        if self._has_plug_in:
            return "its plug-in planner flies a ring of its own"
        return self._commanded.refusal(number, commanded, self._config, self._estimator.targets.position_m)
