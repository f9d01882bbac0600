"""The asynchronous shell around one `VehicleCore`: it reports events to the state machine of the agent's life.

`agents/shell/life.py` defines the phases and the actions on each event. This module performs the actions.
"""

import asyncio
import time
from collections.abc import Callable, Collection, Coroutine, Mapping
from dataclasses import replace
from enum import Enum, auto
from math import inf

from agents.flight_end import FlightEnd, LastPosition
from agents.inputs import (
    AutopilotStatus,
    Command,
    Computer,
    Ground,
    Killed,
    Lying,
    Message,
    Presence,
    Rejoined,
    Start,
    TacticEvent,
    TimeScale,
    VehicleJoins,
)
from agents.ports import VehicleRefusedError, VehicleStatus
from agents.shell.control_loop import AgentParts, ControlLoop
from agents.shell.life import Action, LifeEvent, Phase, is_taken_over, next_phase, resumed, without_setpoints
from agents.shell.outcome import FAILED, KILLED, LOST, UNUSED, Outcome, Stop, outcome_of
from agents.shell.reporter import Reporter
from agents.shell.start_agreement import StartAgreement
from agents.shell.ticker import TickerStatistics
from agents.tactics import Event, Tactic
from agents.team import external_positions
from agents.team.messages import (
    LINK_SILENT_S,
    START_BLOCKERS_LIMIT,
    AddedAnswer,
    AddedVehicle,
    BusMessage,
    CommandAnswer,
    CommandedRing,
    CommandKey,
    MemberState,
    OperatorCommand,
    Outlook,
    StartProposal,
)
from agents.team.text import printable
from estimation.state import Sighting, Telemetry


class ActivityKind(Enum):
    """The kinds of activities."""

    CALL = auto()
    """Calls the link, except for a kill."""
    TICKS = auto()
    START = auto()
    """Compares clocks, agrees on the start, waits for the mission's end."""
    OPERATOR = auto()
    """Waits for the operator to stop the flight."""
    HOLD = auto()
    """Waits until the vehicle has come to rest after a stop."""
    KILL = auto()


Work = Callable[[], Coroutine[None, None, LifeEvent | None]]


class Activities:
    """Runs activities; an activity that replaces another of its kind begins when that one has ended."""

    def __init__(
        self,
        report: Callable[[LifeEvent, VehicleRefusedError | None], object],
        fail: Callable[[ActivityKind, Exception], object],
    ) -> None:
        """Take the receivers of the event at the end of an activity, and of an exception that is not a refusal."""
        self._report = report
        self._fail = fail
        self._tasks: dict[ActivityKind, set[asyncio.Task[None]]] = {kind: set() for kind in ActivityKind}

    def start(self, kind: ActivityKind, work: Work, refused: LifeEvent | None = None) -> None:
        """Start an activity: its event is what `work` returns, or `refused` if it raises VehicleRefusedError."""
        self.cancel(kind)
        before = frozenset(self._tasks[kind])
        task = asyncio.create_task(self._run(kind, work, refused, before))
        self._tasks[kind].add(task)
        task.add_done_callback(self._tasks[kind].discard)

    def running(self, kind: ActivityKind) -> bool:
        """Return whether an activity of a kind has not ended."""
        return any(not task.done() for task in self._tasks[kind])

    def cancel(self, *kinds: ActivityKind) -> None:
        """Cancel activities."""
        for kind in kinds:
            for task in self._tasks[kind]:
                task.cancel()

    async def stop(self, *kinds: ActivityKind) -> None:
        """Cancel activities and wait until they have ended."""
        self.cancel(*kinds)
        tasks = [task for kind in kinds for task in self._tasks[kind]]
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(
        self, kind: ActivityKind, work: Work, refused: LifeEvent | None, before: frozenset[asyncio.Task[None]]
    ) -> None:
        if before:
            await asyncio.wait(before)
        refusal: VehicleRefusedError | None = None
        try:
            event = await work()
        except VehicleRefusedError as error:
            event, refusal = refused, error
        except Exception as error:
            self._fail(kind, error)
            return
        if event is not None:
            self._report(event, refusal)


def override_reason(status: VehicleStatus) -> str:
    """Return the change of flight mode or arming by a pilot or the autopilot, as text."""
    what = f"the flight mode became '{status.mode.value}'" if status.armed else "it disarmed"
    why = f": by {status.mode_by.value}" if status.mode_by.value else ""
    if status.lost.value:
        why = f": its {status.lost.value} is lost"
    return f"{what}, which cordon did not request{why}"


def override_outcome(reason: str, *, restarted: bool) -> Outcome:
    """Return the outcome of a vehicle that was handed over."""
    if restarted:
        return Outcome(FlightEnd.PILOT, f"{reason}: its autopilot restarted", "examine the vehicle and its log")
    return Outcome(FlightEnd.PILOT, reason, "land it from where the mode was changed: cordon has handed it over")


class OutsideSensors:
    """Takes payloads on the sensors' topics."""

    def __init__(self, parts: AgentParts) -> None:
        self._parts = parts

    def take(self, topic: str, payload: bytes) -> None:
        """Take one payload; it is dropped if it is neither a sighting nor a position of this vehicle."""
        parts = self._parts
        if topic == external_positions.TOPIC:
            if parts.positions is not None and (position := parts.positions.take(payload, time.time())) is not None:
                parts.link.locate(position)
            return
        seen = parts.perception.take(payload, parts.clock.now_s(), max(parts.clock.time_scale, 1.0))
        if seen is not None:
            parts.core.take(seen)


HOLD_BEFORE_LANDING_S = 3.0
_AFTER_TICK_S = 1e-3
"""The end of the mission comes after a tick at the same time, which belongs to the mission."""

_JUDGED_EVERY_S = 0.5
"""How often an announcement of one that is not in the mission file is judged: it is repeated more often [wall s]."""
_ALL_BUT_KILL = tuple(kind for kind in ActivityKind if kind is not ActivityKind.KILL)


class Agent:
    """One vehicle's agent: its core, its link, its bus, and its life from take-off to landing."""

    def __init__(self, parts: AgentParts) -> None:
        self._parts = parts
        self._core, self._link, self._clock = parts.core, parts.link, parts.clock
        self._start_agreement = StartAgreement(
            parts.bus,
            parts.clock,
            parts.config.vehicle_id,
            parts.config.starters,
            parts.mission,
            is_added=parts.config.added == parts.config.vehicle_id,
        )
        self._loop = ControlLoop(parts)
        self._reporter = Reporter(parts, lambda: self._loop.newest, lambda: self.clock_lags_s, lambda: self.unaccounted)
        self._activities = Activities(self._happen, self._fail)
        self._phase = Phase.GROUND
        self._over = asyncio.Event()
        self.started = asyncio.Event()  # by an operator, if it waits on the ground; also set when its motors are cut
        self.rejoining = asyncio.Event()
        """Set while an operator's command to take off again awaits `fly_again` or `stay`; its flight has ended."""
        self._adopting = Event.ADOPT
        self.in_reserve = False
        """Whether it stays on the ground in reserve, and has not flown."""
        self._judged_s = -inf
        self._begin()
        self._duration_s = 0.0
        self._stop = Stop()
        self._perform = self._performers()

    def _begin(self) -> None:
        """Begin a flight: nothing of it has happened yet."""
        self._over.clear()
        self.rejoining.clear()
        self._refusal: VehicleRefusedError | None = None
        self._override_reason = ""
        self._outcome = Outcome(FlightEnd.LANDED)
        self._failure: Exception | None = None
        self._flew = self._took_off = self._is_unaccounted = False
        self._ended_s: float | None = None

    @property
    def phase(self) -> Phase:
        """The present phase."""
        return self._phase

    @property
    def loop(self) -> TickerStatistics:
        """The ticks of the control loop so far."""
        return self._loop.report

    @property
    def start_s(self) -> float | None:
        """The mission's start on the shared clock, None until agreed."""
        return self._start_agreement.start_s

    @property
    def ended_s(self) -> float | None:
        """When the mission ended and the return began, on the shared clock."""
        return self._ended_s

    @property
    def outlook(self) -> Outlook | None:
        """What holds the vehicle and what it does next, with the mission's end; None while nothing is due."""
        return self._reporter.outlook

    @property
    def clock_lags_s(self) -> dict[int, float]:
        """How far the clocks of the peers' computers are behind this one's, as far as measured [wall s]."""
        return self._start_agreement.clock_lags_s

    @property
    def last_position(self) -> LastPosition | None:
        """The newest position that has been received, None before the first."""
        return self._reporter.last_position

    @property
    def unaccounted(self) -> LastPosition | None:
        """The newest position of a vehicle whose flight ended without a report that it is down; None for all others.

        A vehicle that fell with its motors cut is unaccounted for; one that a pilot flies on a live link is not.
        """
        return self._reporter.last_position if self._is_unaccounted else None

    @property
    def added(self) -> tuple[int, AddedVehicle] | None:
        """The vehicle that is not in the mission file and has joined the flight, with its id."""
        return self._core.added

    async def connect(self) -> None:
        """Connect to the vehicle and the peers at once; nothing moves. Raises VehicleRefusedError."""
        linking = asyncio.create_task(self.connect_link())
        try:
            await self._parts.bus.open(self._receive, OutsideSensors(self._parts).take, self._note_presence)
            await linking
        finally:
            linking.cancel()
            await asyncio.gather(linking, return_exceptions=True)

    async def connect_link(self) -> None:
        """Connect to the vehicle alone, again after it was not received. Raises VehicleRefusedError."""
        await self._link.connect(self._sense)

    def announce(self) -> None:
        """Send time and reports and compare clocks from now on; to be called once connected, with the clock set."""
        self._start_agreement.announce()
        self._reporter.begin()

    def wait_on_ground(self, start_blockers: str) -> None:
        """Wait for an operator's start, and report it; `start_blockers` forbid the start, empty: none do."""
        refusal = self._start_agreement.refusal
        start_blockers = printable(start_blockers or (refusal.reason if refusal else ""))[:START_BLOCKERS_LIMIT]
        self._core.take(Ground(start_blockers))
        self._reporter.wait(start_blockers)

    async def fly(self, duration_s: float, stop: Stop) -> Outcome:
        """Fly the mission from take-off to landing; in every case the vehicle lands or is handed over.

        An exception that is not a refusal is raised once the vehicle is on the ground.
        """
        return await self._live(LifeEvent.FLY, duration_s, stop)

    def stand_by(self, duration_s: float) -> None:
        """Stay on the ground in reserve, until `fly_again`, during a mission of this duration."""
        self.in_reserve = True
        self._reporter.stand_by()
        self._start_agreement.bound(duration_s)
        self._report(UNUSED)
        self._happen(LifeEvent.STAND_BY)

    def introduce(self, vehicle: AddedVehicle) -> Mapping[int, AddedAnswer]:
        """Announce that this vehicle, which stands by and is not in the mission file, joins the others.

        Returns what they answer, by their ids, which grows.
        """
        self._start_agreement.introduce(vehicle)
        return self._start_agreement.answers

    @property
    def start_refusal(self) -> VehicleRefusedError | None:
        """The refusal to take off with the peers received so far, None if there is no reason."""
        return self._start_agreement.refusal

    def look(self) -> None:
        """Let the core of a vehicle that stands by tick once: its status has the peers, and they receive its state."""
        self._core.take(TimeScale(max(self._clock.time_scale, 1.0)))
        self._loop.tick_only()

    async def fly_again(self, duration_s: float, stop: Stop) -> Outcome:
        """Fly the mission that the others fly, after an earlier flight or in reserve; ends and raises as `fly`.

        `duration_s` is that of the mission, from its start on.
        """
        self.in_reserve = False
        self._core.take(Rejoined(self._clock.now_s(), ""))
        self._begin()
        self._loop.restart()
        self._loop.tick_only()  # it answers
        self._reporter.begin_again()
        return await self._live(LifeEvent.FLY_AGAIN, duration_s, stop)

    def stay(self, refusal: str) -> None:
        """Answer that the vehicle does not take off again, and why."""
        self.rejoining.clear()
        self._core.take(Rejoined(self._clock.now_s(), refusal))
        self._loop.answer()

    async def recover(self, together: Collection[int], hold_s: float, stop: Stop) -> Outcome:
        """Take a vehicle that is in the air, hold it where it is, and bring it home; ends and raises as `fly`.

        The vehicles `together`, with this one, begin to return at once, `hold_s` after all of them hold.
        """
        self._start_agreement.with_only(together)
        return await self._live(LifeEvent.ADOPT, hold_s, stop)

    async def take_over(self, together: Collection[int], duration_s: float, stop: Stop) -> Outcome:
        """Take a vehicle that is in the air, hold it where it is, and fly the mission; ends and raises as `fly`.

        The mission of the vehicles `together`, with this one, begins once all of them hold.
        """
        self._adopting = Event.TAKE_OVER
        self._start_agreement.with_only(together)
        return await self._live(LifeEvent.ADOPT, duration_s, stop)

    async def accompany(self, stop: Stop) -> Outcome:
        """Send the state of a vehicle that its pilot flies to the peers, which keep apart from it, until `stop`."""
        return await self._live(LifeEvent.ACCOMPANY, inf, stop)

    async def _live(self, begin: LifeEvent, duration_s: float, stop: Stop) -> Outcome:
        self._core.take(TimeScale(max(self._clock.time_scale, 1.0)))
        self._duration_s, self._stop = duration_s, stop
        self._reporter.wait(None)
        self._start_agreement.bound(duration_s)
        try:
            self._happen(begin)
            await self._over.wait()
        except asyncio.CancelledError:
            self._happen(LifeEvent.ABORTED)
            await self._over.wait()
            raise
        finally:
            await self._activities.stop(*_ALL_BUT_KILL)
        if self._failure is not None:
            raise self._failure
        return replace(self._outcome, flew=self._flew)

    def obey(self, command: OperatorCommand) -> None:
        """Take a command of an operator at this computer."""
        if self._is_for_flying(command):
            return
        self._core.take(AutopilotStatus(self._link.status))
        self._core.take(Command(self._clock.now_s(), command))
        self._act_on_commands()

    def answer(self, key: CommandKey) -> CommandAnswer | None:
        """Return its newest answer to a command, None before it has taken it."""
        return self._core.commands.answer(key, self._clock.now_s())

    @property
    def commanded_rings(self) -> tuple[CommandedRing, ...]:
        """The values of the mission's rings that operators commanded last, in order, as it has received them."""
        return tuple(self._core.commands.commanded_rings)

    def see(self, sighting: Sighting) -> None:
        """Take a sighting from outside the team."""
        self._core.take(sighting)

    def note_computer(self, short_of: str) -> None:
        """Take the resource that this computer is short of, empty if none."""
        self._core.take(Computer(short_of))

    def note_lying(self, vehicle_id: int, position_m: tuple[float, float]) -> None:
        """Take where another vehicle of the mission lies on the ground, which does not fly."""
        self._core.take(Lying(vehicle_id, position_m))

    async def close(self) -> None:
        """Leave the bus and release the link."""
        self._start_agreement.stop_announcing()
        await self._reporter.close()
        await self._parts.bus.close()
        await self._link.close()

    # Events.

    def _happen(self, event: LifeEvent, refusal: VehicleRefusedError | None = None) -> None:
        """Take an event: change the phase and perform the actions. A failed action does not prevent the next ones."""
        self._phase, actions = next_phase(self._phase, event)
        self._refusal = refusal
        for action in actions:
            try:
                self._perform[action]()
            except Exception as error:
                self._fail(ActivityKind.TICKS, error)
        if self._phase is Phase.ENDED:
            if not self._over.is_set():
                self._account()
            self._reporter.end(FAILED if self._failure else self._outcome)
            self._over.set()

    def _account(self) -> None:
        """Note at the end of the flight whether the vehicle is unaccounted for, and whether its link was lost."""
        status, how, last = self._link.status, self._outcome.how, self._reporter.last_position
        is_silent = last is None or last.age_s > LINK_SILENT_S
        if not self._took_off:
            return
        is_lost = not status.connected or (status.armed and is_silent)
        if is_lost and how not in (FlightEnd.KILLED, FlightEnd.PILOT):
            self._report(LOST)
        if is_lost or (status.armed and how is not FlightEnd.PILOT):
            self._is_unaccounted = True

    def _fail(self, kind: ActivityKind, error: Exception) -> None:
        """Take an exception that is not a refusal: `fly` raises the first one at its end."""
        self._failure = self._failure or error
        self._happen(LifeEvent.ABORTED if kind in (ActivityKind.CALL, ActivityKind.KILL) else LifeEvent.FAULT)

    def _sense(self, telemetry: Telemetry) -> None:
        self._reporter.sense(telemetry.position_m)
        self._loop.position_m = telemetry.position_m[:2]
        if self._flew:
            self._core.take(telemetry)

    def _is_for_flying(self, command: OperatorCommand) -> bool:
        """Return whether a command to all does not concern this vehicle, which is in reserve; a kill concerns all."""
        return self.in_reserve and command.vehicle is None and command.verb != "kill"

    def _receive(self, message: BusMessage) -> None:
        if isinstance(message, MemberState):  # nearly all are
            self._core.take(Message(self._clock.now_s(), message))
            return
        if isinstance(message, OperatorCommand) and self._is_for_flying(message):
            return
        if isinstance(message, OperatorCommand):
            self._core.take(AutopilotStatus(self._link.status))  # what it answers depends on it
        if isinstance(message, StartProposal) and message.adds is not None:
            self._meet(message, message.adds)
        if not self._is_answered_alone(message):
            self._core.take(Message(self._clock.now_s(), message))
        if isinstance(message, OperatorCommand):
            self._act_on_commands()
        self._start_agreement.receive(message)

    def _is_answered_alone(self, message: BusMessage) -> bool:
        """Return whether a message announces a vehicle that is no member: the core would count it as a stranger's."""
        if not isinstance(message, StartProposal) or message.adds is None:
            return False
        return self._core.added is None or self._core.added[0] != message.sender

    def _meet(self, message: StartProposal, vehicle: AddedVehicle) -> None:
        """Answer a vehicle that is not in the mission file and joins, and take it as a member if it may.

        One that has another mission is not answered: it finds the difference itself. Nor is one that this process
        brings home together with this vehicle.
        """
        parts, core, sender, now_s = self._parts, self._core, message.sender, self._clock.now_s()
        if parts.mission is None or message.mission != parts.mission or sender in parts.config.slots:
            return
        is_new = core.added != (sender, vehicle)
        if is_new and now_s - self._judged_s < _JUDGED_EVERY_S * self._clock.time_scale:
            return
        if is_new:
            self._judged_s = now_s
            core.take(VehicleJoins(sender, vehicle))
            if not core.added_refusal:
                parts.bus.admit(sender)
            refusal = core.added_refusal
        else:  # one that flies is ready; one that is not yet is about to take off, also from where it landed
            refusal = "" if message.ready else core.added_aloft
        self._start_agreement.answer(sender, vehicle, refusal)

    def _act_on_commands(self) -> None:
        """Execute commands that do not wait for a tick; a vehicle on the ground, which does not tick, answers here."""
        commands = self._core.commands
        if self._phase is Phase.ENDED:
            self._loop.answer()
        if self._phase is Phase.GROUND and (commands.starts or commands.start_blockers is not None):
            self._loop.tick_only()
        if commands.rejoins:
            self._prepare_to_rejoin()
        if commands.kills:
            self._happen(LifeEvent.KILL)
        if commands.starts or commands.kills:
            self.started.set()

    def _prepare_to_rejoin(self) -> None:
        """Let what flies the team check a vehicle whose flight has ended, also one that its pilot has landed."""
        self._happen(LifeEvent.REJOIN)
        if self._phase is Phase.ENDED:
            self._loop.answer()
            self.rejoining.set()
        else:
            self.stay("its flight has not ended")

    def _note_presence(self, vehicle_id: int, present: bool) -> None:
        self._start_agreement.note_presence(vehicle_id, present)
        self._core.take(Presence(vehicle_id, present))

    # Activities: each returns the event of its end.

    async def _tick_in_take_off(self) -> None:
        async for _ in self._loop.ticker():
            self._loop.tick_only()
            if self._core.tactic is Tactic.LAND:
                self._happen(LifeEvent.LAND_DECIDED)

    async def _tick_in_control(self) -> None:
        async for tick in self._loop.control_ticker():
            if is_taken_over(status := self._link.status):
                if not without_setpoints(status):
                    self._happen(LifeEvent.TAKEN_OVER)
                elif not self._activities.running(ActivityKind.CALL):
                    self._happen(LifeEvent.SETPOINTS_LOST)
            if resumed(self._phase, self._core.tactic):
                self._happen(LifeEvent.RESUME)
            if self._loop.tick_control(tick.skipped):
                self._happen(LifeEvent.SETPOINT_SENT)
            self._reporter.note_tick()
            self._send_heartbeat()
            if self._core.tactic is Tactic.LAND:
                self._happen(LifeEvent.LAND_DECIDED)

    async def _tick_in_landing(self) -> None:
        async for _ in self._loop.ticker():
            self._loop.tick_only()
            self._send_heartbeat()

    async def _watch_operator(self) -> LifeEvent:
        await self._stop.wanted.wait()
        self._happen(LifeEvent.OPERATOR_STOP)
        await self._stop.hurried.wait()
        return LifeEvent.OPERATOR_HURRY

    async def _agree_on_clocks(self) -> LifeEvent:
        await self._start_agreement.compare_clocks()
        return LifeEvent.OPERATOR_STOP if self._stop.wanted.is_set() else LifeEvent.CLOCKS_AGREE

    async def _agree_on_start(self) -> LifeEvent:
        await self._start_agreement.agree()
        return LifeEvent.START_AGREED

    async def _fly_duration(self, start_s: float) -> LifeEvent:
        await self._clock.sleep_until(start_s + self._duration_s + _AFTER_TICK_S)
        return LifeEvent.DURATION_OVER

    async def _come_to_rest(self) -> LifeEvent:
        await self._clock.sleep(HOLD_BEFORE_LANDING_S)
        return LifeEvent.HOLD_OVER

    async def _call_take_off(self) -> LifeEvent:
        await self._link.take_off(self._parts.config.take_off_altitude_m)
        return LifeEvent.TAKE_OFF_DONE

    async def _wait_for_arming(self) -> LifeEvent:
        await self._link.catch_up()
        return self._armed()

    async def _call_offboard(self) -> LifeEvent:
        await self._link.start_offboard()
        return LifeEvent.OFFBOARD_CONFIRMED

    async def _call_offboard_anew(self) -> LifeEvent:
        await self._clock.sleep(2.0 * self._loop.period_s)  # setpoints have to be streaming first
        return await self._call_offboard()

    async def _call_stop_offboard(self) -> LifeEvent:
        await self._link.stop_offboard()
        return LifeEvent.OFFBOARD_LEFT

    async def _call_land(self) -> LifeEvent:
        await self._link.land()
        return LifeEvent.LANDED

    async def _call_kill(self) -> LifeEvent:
        falls = self._took_off and self._link.status.armed
        try:
            await self._link.kill()
        except VehicleRefusedError as refusal:
            self._answer_kill(refusal.reason)
            raise
        self._is_unaccounted = self._is_unaccounted or falls
        self._answer_kill("")
        return LifeEvent.MOTORS_CUT

    # Actions.

    def _take_off(self) -> None:
        self._parts.heartbeat.rising()
        self._took_off = True
        self._activities.start(ActivityKind.CALL, self._call_take_off, LifeEvent.TAKE_OFF_REFUSED)
        self._activities.start(ActivityKind.OPERATOR, self._watch_operator)
        self._activities.start(ActivityKind.TICKS, self._tick_in_take_off)

    def _adopt(self) -> None:
        self._parts.heartbeat.rising()
        self._took_off = True
        self._activities.start(ActivityKind.OPERATOR, self._watch_operator)
        self._loop.tick_only()  # it gives the core the time and the autopilot's status
        self._core.take(TacticEvent(self._adopting))

    def _start_control(self) -> None:
        self._flew = True
        self._activities.start(ActivityKind.TICKS, self._tick_in_control)

    def _agree_start(self) -> None:
        self._activities.start(ActivityKind.START, self._agree_on_start, LifeEvent.START_REFUSED)
        self._activities.start(
            ActivityKind.OPERATOR, self._watch_operator
        )  # a stop requested meanwhile takes effect now

    def _start_mission(self) -> None:
        start_s = self._start_agreement.start_s
        assert start_s is not None
        self._loop.sensor = self._parts.make_sensor(start_s)
        self._core.take(Start(start_s))
        if self._adopting is Event.TAKE_OVER and self._phase is Phase.FLYING:
            self._core.take(TacticEvent(Event.RESUME))
        self._reporter.start_mission(start_s, self._duration_s)
        self._activities.start(ActivityKind.START, lambda: self._fly_duration(start_s))

    def _hold(self) -> None:
        self._core.take(TacticEvent(Event.HOLD))
        self._reporter.end_at(self._clock.now_s() + HOLD_BEFORE_LANDING_S, "stop")
        self._activities.start(ActivityKind.HOLD, self._come_to_rest)

    def _end_mission(self) -> None:
        self._activities.cancel(ActivityKind.START, ActivityKind.HOLD)
        if self._ended_s is None:
            self._ended_s = self._clock.now_s()
        self._core.take(TacticEvent(Event.END))

    def _hand_over(self) -> None:
        status = self._link.status
        self._link.hand_over()
        self._activities.cancel(ActivityKind.CALL)
        self._core.take(AutopilotStatus(status))  # it may hold the reason
        self._core.take(TacticEvent(Event.HANDED_OVER))
        if self._refusal is not None and self._phase is Phase.PILOT_OVERRIDE:
            self._override_reason = self._refusal.reason
        elif is_taken_over(status):
            self._override_reason = override_reason(status)

    def _take_back(self) -> None:
        self._link.take_back()
        self._activities.start(ActivityKind.CALL, self._call_offboard_anew, LifeEvent.OFFBOARD_REFUSED)

    def _check_armed(self) -> None:
        self._activities.cancel(*_ALL_BUT_KILL)
        self._happen(self._armed())

    def _prepare_landing(self) -> None:
        self._flew = True
        self._activities.start(ActivityKind.TICKS, self._tick_in_landing)
        self._core.take(TacticEvent(Event.LAND))

    def _cut_motors(self) -> None:
        self._flew = True
        self._activities.cancel(ActivityKind.CALL, ActivityKind.START, ActivityKind.OPERATOR, ActivityKind.HOLD)
        if not self._activities.running(ActivityKind.KILL):
            self._activities.start(ActivityKind.KILL, self._call_kill, LifeEvent.KILL_REFUSED)

    def _report(self, outcome: Outcome) -> None:
        self._outcome = outcome

    def _report_land_decision(self) -> None:
        self._report(outcome_of(self._core.landing_cause))

    def _report_refusal(self) -> None:
        if self._refusal is not None:
            self._report(Outcome(FlightEnd.REFUSED, self._refusal.clause, self._refusal.next_step))

    def _performers(self) -> dict[Action, Callable[[], object]]:
        begin = self._activities.start
        return {
            Action.COMPARE_CLOCKS: lambda: begin(ActivityKind.START, self._agree_on_clocks, LifeEvent.CLOCKS_DIFFER),
            Action.ADOPT: self._adopt,
            Action.TAKE_OFF: self._take_off,
            Action.ABANDON_TAKE_OFF: lambda: begin(ActivityKind.CALL, self._wait_for_arming),
            Action.START_CONTROL: self._start_control,
            Action.START_OFFBOARD: lambda: begin(ActivityKind.CALL, self._call_offboard, LifeEvent.OFFBOARD_REFUSED),
            Action.AGREE_START: self._agree_start,
            Action.START_MISSION: self._start_mission,
            Action.HOLD: self._hold,
            Action.END_MISSION: self._end_mission,
            Action.HAND_OVER: self._hand_over,
            Action.TAKE_BACK: self._take_back,
            Action.CHECK_ARMED: self._check_armed,
            Action.PREPARE_LANDING: self._prepare_landing,
            Action.STOP_OFFBOARD: lambda: begin(ActivityKind.CALL, self._call_stop_offboard, LifeEvent.OFFBOARD_KEPT),
            Action.LAND: lambda: begin(ActivityKind.CALL, self._call_land, LifeEvent.LANDING_REFUSED),
            Action.CUT_MOTORS: self._cut_motors,
            Action.REPORT_COMPLETED: self._report_land_decision,
            Action.REPORT_STOPPED: lambda: self._report(self._stop.outcome),
            Action.REPORT_LAND_DECISION: self._report_land_decision,
            Action.REPORT_REFUSAL: self._report_refusal,
            Action.REPORT_OVERRIDE: lambda: self._report(
                override_outcome(self._override_reason, restarted=self._link.status.restarts > 0)
            ),
            Action.REPORT_KILLED: lambda: self._report(KILLED),
            Action.END_SUPERVISION: self._parts.heartbeat.ended,
        }

    # Helpers.

    def _answer_kill(self, refusal: str) -> None:
        self._core.take(Killed(self._clock.now_s(), refusal))
        self._loop.tick_only()

    def _armed(self) -> LifeEvent:
        return LifeEvent.ARMED if self._link.status.armed else LifeEvent.DISARMED

    def _send_heartbeat(self) -> None:
        if self._phase is not Phase.ENDED:  # the end has been reported to the supervisor
            self._loop.send_heartbeat()
