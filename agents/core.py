"""`VehicleCore`: one vehicle's whole decision making, without clock, sockets or asyncio.

What the world says comes in through the `on_...` methods, the time is an argument of `tick`, and everything the vehicle
wants done comes back from it: the same object flies over MAVLink, in the simulation, and again from a log.
"""

from math import hypot

import numpy as np

from agents.broadcast import (
    command_answer,
    member_state,
    neighbour_angle,
    sighting_told,
    target_package,
)
from agents.control.homing import assembled
from agents.control.lmpc import QpStatus
from agents.control.plan import Plan, shifted
from agents.control.planner import Planner
from agents.orders import Orders, Reshaping
from agents.outputs import (
    CoreStatus,
    Note,
    Outgoing,
    TickOutput,
)
from agents.ports import Setpoint, VehicleStatus
from agents.safety.failsafe import Condition, FailsafeMonitor
from agents.safety.fault_detector import FaultDetector
from agents.safety.guard import Guard, Guarded, GuardStatus
from agents.safety.neighbours import Neighbours
from agents.setpoint.altitude import Altitude
from agents.setpoint.feedforward import FeedForward
from agents.setpoint.slew_limit import SlewLimit
from agents.setpoint.yaw import Yaw
from agents.settings.config import AgentConfig
from agents.situation.ring_frequency import RingFrequency
from agents.situation.situation import Situation, moved
from agents.situation.target_blend import TargetBlend
from agents.tactics import (
    Event,
    Tactic,
    decides_to_encircle,
    next_tactic,
    reasons,
)
from agents.team.clock_watch import ClockWatch
from agents.team.inbox import Inbox
from agents.team.messages import (
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    TargetPackage,
)
from agents.team.team import Team
from estimation.filters.own import OwnFilter
from estimation.filters.target import TargetFilter
from estimation.polar import polar_from_motion
from estimation.state import (
    DISTURBANCE,
    MOTION,
    POSITION,
    Sighting,
    Telemetry,
)

GUARD_QUIET_S = 5.0
"""After this long without it the guard's next intervention is news again."""


class VehicleCore:
    """Estimates, decides and plans for one vehicle."""

    def __init__(self, config: AgentConfig) -> None:
        self._config = config
        self._own = OwnFilter(config.plant, config.own_filter)
        self._target = TargetFilter(config.target_filter)
        self._target_blend = TargetBlend(config)
        self._team = Team()
        self._time_scale = 1.0
        self._slew_limit = SlewLimit(config)
        self._guard = Guard(config)
        self._yaw = Yaw(config)
        self._altitudes = Altitude(config)
        self._ring_frequency = RingFrequency(config.rate_hz)
        self._feedforward = FeedForward(config.plant, config.safety.speed_max_m_s)
        self._neighbours = Neighbours(config)
        self._planner = Planner(config, self._team)
        clocks = ClockWatch(config.failsafe.clock_step_s)
        self._inbox = Inbox(config.vehicle_id, config.slots, clocks)
        self._fault_detector = FaultDetector(config, self._own, self._target, self._team, clocks)
        self._failsafe = FailsafeMonitor(config)
        self._height_m = self._altitude_m = config.take_off_altitude_m
        self._tactic = Tactic.STANDBY
        self._start_s = np.inf
        self._formed_s: float | None = None
        self._untold: list[Sighting] = []
        self._sighted: list[Sighting] = []
        self._notes: list[Note] = []
        self._guarding_s = -np.inf
        shapes = config.shapes if config.excitation is None else ()
        self._orders = Orders(config.vehicle_id, config.safety.abort_hover_s, shapes)
        self._reshaping: Reshaping | None = None
        self._answers_heard: list[CommandAnswer] = []
        self._now_s = 0.0
        # A setpoint is held for one period: on average it acts half a period late, beside the plant's own delay.
        self._acts_after_s = config.plant.delay_s + 0.5 / config.rate_hz

    @property
    def tactic(self) -> Tactic:
        """The present tactic."""
        return self._tactic

    @property
    def alert(self) -> str:
        """The gravest condition of the failsafe table that is being reacted to, empty if there is none."""
        return self._failsafe.alert

    @property
    def kills(self) -> bool:
        """Whether the motors are to be cut: asked for at once, that waits for no tick."""
        return self._orders.kills

    def set_time_scale(self, factor: float) -> None:
        """Wait `factor` times as long for what comes over a link: links take wall time, the core's may pass faster."""
        self._time_scale = factor
        self._failsafe.set_time_scale(factor)

    def start(self, at_s: float) -> None:
        """Begin the mission at `at_s`: the formation's clock starts then."""
        self._start_s = at_s
        self._planner.start(at_s)

    def on_event(self, event: Event) -> None:
        """Take an operator's or the shell's event."""
        self._change(event)

    def on_vehicle(self, status: VehicleStatus) -> None:
        """Take what the autopilot says of itself."""
        self._fault_detector.battery = status.battery

    def on_loop(self, late_ticks: int) -> None:
        """Take how many ticks were skipped before the next, because it comes that late."""
        self._fault_detector.late_ticks = late_ticks

    def on_bus(self, alive: bool) -> None:
        """Take whether the bus to the peers works, as far as this end of it knows."""
        self._fault_detector.bus_alive = alive

    def on_telemetry(self, telemetry: Telemetry) -> None:
        """Take a sample of the vehicle's own motion."""
        self._height_m = telemetry.position_m[2]
        self._own.measure(telemetry)

    def on_sighting(self, sighting: Sighting) -> None:
        """Take a sighting; what the vehicle's own sensor sees peers are told in the next tick, others hear the rest."""
        self._sighted.append(sighting)
        if sighting.sensor_id == self._config.vehicle_id:
            self._untold.append(sighting)

    def on_message(self, payload: bytes, now_s: float) -> None:
        """Take a peer's message; what is malformed, foreign or from the future is counted and dropped."""
        message = self._inbox.take(payload, now_s, self._time_scale)
        match message:
            case MemberState():
                self._team.hear_member(message)
                if message.shape is not None:
                    self._reshape(Reshaping(message.shaped_s, message.shape))
            case NeighbourAngle():
                self._team.hear_angle(message)
            case TargetPackage():
                self._hear_target(message)
            case OperatorCommand():
                self._command(message, now_s)
            case CommandAnswer():
                self._answers_heard.append(message)
            case _:
                pass  # a start proposal is the shell's concern before the mission starts

    def on_command(self, command: OperatorCommand, now_s: float) -> None:
        """Take a command of an operator at this computer: it acts at once, and is answered in the next tick."""
        self._command(command, now_s)

    def on_killed(self, refusal: str, now_s: float) -> None:
        """Take what came of cutting the motors: why it failed, or nothing when it did not."""
        self._orders.on_killed(refusal, now_s)

    def on_presence(self, vehicle_id: int, present: bool) -> None:
        """Take the news that a peer has come or gone."""
        if not present:
            self._team.forget(vehicle_id)

    def tick(self, now_s: float) -> TickOutput:
        """Estimate, decide, plan: one step of the control loop at `now_s`."""
        self._now_s = now_s
        self._obey(self._orders.due(self._tactic, now_s))
        answers = tuple(map(command_answer, self._orders.answers(now_s)))
        self._team.expire(now_s, self._time_scale)
        situation = self._assess(now_s)
        if situation is None:
            return TickOutput(None, answers, self._status(now_s, None, None, None))
        self._fail_safe(situation)
        self._decide(situation)
        plan = self._planner.plan(self._tactic, situation, self._height_m)
        self._notes += [Note(now_s, "ring", text) for text in self._planner.news()]
        self._follow_ring(situation)
        plan = self._slew_limit.bounded(self._tactic, plan)
        guarded = self._guarded(situation, plan)
        self._note_guard(now_s, plan, guarded)
        self._fault_detector.unsolved = plan.qp is QpStatus.FALLBACK or guarded.status is GuardStatus.BRAKED
        setpoint = None if self._tactic is Tactic.PILOT_OVERRIDE else self._setpoint(situation, plan, guarded)
        plan = shifted(plan, guarded.setpoint_m)
        self._slew_limit.sent(guarded.setpoint_m)
        self._own.command(now_s, guarded.setpoint_m)
        return TickOutput(
            setpoint,
            (*answers, *self._messages(situation, plan)),
            self._status(now_s, situation, plan, guarded),
        )

    def _command(self, command: OperatorCommand, now_s: float) -> None:
        self._now_s = now_s
        self._obey(self._orders.take(command, self._tactic, now_s, self._failsafe.refuse_resume()))
        if self._orders.reshaping is not None:
            self._reshape(self._orders.reshaping)

    def _reshape(self, told: Reshaping) -> None:
        """Take the newest shape of the formation, from an operator or from whoever has heard one: so all have one."""
        if told.shape not in self._config.shapes or (self._reshaping is not None and told <= self._reshaping):
            return
        self._reshaping = told
        if told.shape != self._config.shape:
            self._config = self._config.reshaped(told.shape)
            self._planner.reshape(self._config)
            self._notes.append(Note(self._now_s, "command", f"the formation's shape is '{told.shape}'"))

    def _assess(self, now_s: float) -> Situation | None:
        if self._sighted:
            self._target.sight(*self._sighted)
            self._altitudes.sight(*self._sighted)
            self._sighted.clear()
        own = self._own.estimate(now_s)
        if own is None:
            return None
        target = self._target.estimate(now_s)
        acting_s = now_s + self._acts_after_s
        acting = self._own.predicted(acting_s, 0.5 / self._config.rate_hz)
        acting_target = None if target is None else moved(target.mean, acting_s - target.time_s)
        centre = self._target_blend.centre(target, now_s)
        blended = centre is not None and self._target_blend.catching_up
        return Situation(
            now_s,
            acting_s,
            own,
            acting[MOTION],
            acting[DISTURBANCE],
            target,
            None if centre is None else polar_from_motion(own.mean[MOTION], centre),
            acting_target,
            moved(centre, acting_s - now_s) if centre is not None and blended else acting_target,
            self._own.authority,
        )

    def _fail_safe(self, situation: Situation) -> None:
        failsafe, tactic = self._failsafe, self._tactic
        found = self._fault_detector.find(situation, tactic, self._height_m, failsafe.active, self._time_scale)
        event = failsafe.judge(situation.now_s, found, tactic)
        for text in failsafe.news():
            self._notes.append(Note(situation.now_s, "failsafe", text))
        if event is not None:
            self._change(event)

    def _decide(self, situation: Situation) -> None:
        now_s, target = situation.now_s, situation.target
        if self._tactic is Tactic.STANDBY and now_s >= self._start_s:
            self._change(Event.START)
        if self._tactic is Tactic.FORMATION and self._formed_s is None:
            self._formed_s = now_s
        if (
            self._tactic is Tactic.FORMATION
            and target is not None
            and decides_to_encircle(target, situation.own.mean[POSITION], self._config.decision)
        ):
            # One that is sent back close to the target has no place in line to leave from: it leaves from where it is.
            formed_s = now_s if self._formed_s is None else self._formed_s
            in_line = now_s - formed_s > self._config.encirclement.smoothing_time_s
            self._change(Event.ENGAGE, reasons(target, situation.own.mean[POSITION], self._config.decision))
            self._planner.engage(now_s, None if in_line else situation.own.mean[POSITION])
        if self._tactic is Tactic.RETURN_AND_LAND and self._planner.homing.may_land(
            situation, self._team.members(), self._time_scale
        ):
            self._change(Event.LAND)
        self._choose_height(situation)

    def _choose_height(self, situation: Situation) -> None:
        """Fly at the flying height once everybody is in place: until then, and on the way home, in layers."""
        if self._tactic is Tactic.RETURN_AND_LAND and self._planner.homing.returns:
            self._altitude_m = self._config.return_altitude_m
        elif self._altitude_m != self._config.altitude_m and self._tactic in (Tactic.FORMATION, Tactic.ENCIRCLE):
            here, flown_s = situation.own.mean[POSITION], situation.now_s - self._start_s
            if assembled(self._config, self._tactic, here, self._team.members(), flown_s):
                self._altitude_m = self._config.altitude_m

    def _obey(self, event: Event | None) -> None:
        self._notes += self._orders.notes()
        if event is not None:
            self._change(event)

    def _change(self, event: Event, because: str = "") -> None:
        if event is Event.RESUME and (reason := self._failsafe.refuse_resume()):
            self._notes.append(Note(self._now_s, "failsafe", f"resume refused: {reason}"))
            return
        excites = self._config.excitation is not None and event in (Event.START, Event.RESUME)
        after = next_tactic(self._tactic, Event.EXCITE if excites else event)
        if after is self._tactic:
            return
        text = f"{self._tactic.value} -> {after.value}: {event.value}"
        self._notes.append(Note(self._now_s, "tactic", text, because))
        self._tactic = after
        if event is Event.RESUME:
            self._failsafe.resume()
        if event is Event.PILOT_TOOK_OVER:
            self._failsafe.latch(Condition.PILOT_TOOK_OVER, "somebody else has the vehicle")
        self._planner.begin(after, to_home=event is Event.RETURN)
        self._follow_ring()
        if after is Tactic.FORMATION:
            self._formed_s = None

    def _guarded(self, situation: Situation, plan: Plan) -> Guarded:
        """Guard the setpoint, unless nobody obeys it: while the autopilot lands the vehicle or somebody else has it."""
        if self._tactic in (Tactic.LAND, Tactic.PILOT_OVERRIDE):
            return Guarded(plan.setpoint_m)
        lost = self._team.lost(situation.now_s, self._config.safety.lost_avoided_s)
        near = self._neighbours.near(situation, self._team.members())
        bodies = self._neighbours.bodies(situation, self._height_m, near, lost)
        return self._guard.check(situation, plan.setpoint_m, bodies)

    def _setpoint(self, situation: Situation, plan: Plan, guarded: Guarded) -> Setpoint:
        (x, y), velocity = self._feedforward.split(situation, plan, guarded)
        yaw_rad = self._yaw.turn(self._tactic, situation)
        altitude_m = self._altitudes.next_m(self._tactic, self._altitude_m)
        return Setpoint((x, y, self._guard.altitude_m(altitude_m)), yaw_rad, velocity)

    def _note_guard(self, now_s: float, plan: Plan, guarded: Guarded) -> None:
        """Note when the guard begins to change setpoints, and why; not again while it goes on and off."""
        if guarded.causes:
            if now_s - self._guarding_s > GUARD_QUIET_S:
                (x, y), moved_m = plan.setpoint_m.tolist(), hypot(*(guarded.setpoint_m - plan.setpoint_m).tolist())
                because = f"the setpoint wished for, ({x:.2f}, {y:.2f}) m, was moved by {moved_m:.2f} m"
                self._notes.append(Note(now_s, "guard", ", ".join(cause.words for cause in guarded.causes), because))
            self._guarding_s = now_s

    @property
    def _ring_rate_rad_s(self) -> float:
        """The angular rate at which the ring is flown, but for corrections of places on it; 0 off the ring."""
        return self._planner.ring_feasibility.orbit.angular_rate_rad_s if self._tactic is Tactic.ENCIRCLE else 0.0

    def _follow_ring(self, situation: Situation | None = None) -> None:
        """Look for a disturbance that swings as the vehicle goes around: at the rate that is flown."""
        polar = None if situation is None else situation.polar
        self._ring_frequency.follow(self._ring_rate_rad_s, None if polar is None else polar.angular_rate_rad_s)
        self._own.turn_disturbance(
            self._ring_frequency.rate_rad_s if self._config.own_filter.disturbance_turns else 0.0
        )

    def _messages(self, situation: Situation, plan: Plan) -> tuple[Outgoing, ...]:
        state = member_state(
            self._config.vehicle_id,
            self._tactic,
            situation,
            plan,
            altitude_m=self._height_m,
            alert=self.alert,
            reshaping=self._reshaping,
        )
        messages = [state]
        if self._tactic is Tactic.ENCIRCLE and situation.polar is not None and self._planner.joined:
            needed = self._planner.ring_feasibility.needed
            messages.append(neighbour_angle(self._config.vehicle_id, situation.now_s, situation.polar, needed))
        if self._untold:
            recipients = self._team.within(situation.own.mean[POSITION], self._config.communication_radius_m)
            messages += [target_package(self._config.vehicle_id, sighting, recipients) for sighting in self._untold]
            self._untold.clear()
        return tuple(messages)

    def _hear_target(self, package: TargetPackage) -> None:
        if self._config.vehicle_id not in package.recipients:
            return
        try:
            self._sighted.append(sighting_told(package))
        except ValueError:
            self._inbox.dropped += 1

    def _status(
        self, now_s: float, situation: Situation | None, plan: Plan | None, guarded: Guarded | None
    ) -> CoreStatus:
        notes, heard = (*self._notes, *self._orders.notes()), tuple(self._answers_heard)
        self._notes.clear()
        self._answers_heard.clear()
        return CoreStatus(
            self._config.vehicle_id,
            now_s,
            self._tactic,
            self._planner.mixing_share(self._tactic, now_s),
            None if situation is None else situation.own,
            None if situation is None else situation.target,
            None if situation is None else situation.polar,
            None if plan is None else plan.place,
            None if plan is None else plan.approach,
            None if plan is None else plan.qp,
            self._team.members(),
            self._inbox.dropped,
            self.alert,
            notes,
            guarded,
            heard,
            self._planner.ring_feasibility.words if self._tactic is Tactic.ENCIRCLE else "",
            self._ring_rate_rad_s,
            self._altitudes.target_m,
            self._ring_frequency.rate_rad_s,
        )
