"""The asynchronous shell around one `VehicleCore`: from the ground into the mission and back to the ground.

It reads the world, ticks the core at absolute deadlines, and writes; it decides nothing that the core could decide.
"""

import asyncio
from collections.abc import Callable, Collection
from contextlib import suppress
from time import perf_counter

from agents.core import VehicleCore
from agents.outputs import CoreStatus, TickOutput
from agents.ports import (
    FlightMode,
    Heartbeat,
    PeerBus,
    TargetSensor,
    VehicleLink,
    VehicleRefusedError,
)
from agents.shell.clock import MissionClock
from agents.shell.kill_switch import KillSwitch
from agents.shell.outcome import (
    Ending,
    LoopReport,
    Outcome,
    Stop,
)
from agents.shell.start_agreement import StartAgreement
from agents.shell.ticker import Ticker, TickerStatistics
from agents.tactics import Event, Tactic
from agents.team.messages import TOPICS, OperatorCommand, encode
from agents.team.perception import Perception, is_external_sighting
from estimation.state import Sighting, Telemetry

ARMED_HEARD_AFTER_S = 2.5
"""Heartbeats come once a second: after this, an arming that was under way has been heard of."""
HOLD_BEFORE_LANDING_S = 3.0

_STOPPED = Outcome(Ending.STOPPED, "the operator ended the flight")
_KILLED = Outcome(Ending.KILLED, "an operator had its motors cut", "find it, and see to it before it flies again")


class Agent:
    """One vehicle's agent: its core, its link, its bus, and the loop between them."""

    def __init__(
        self,
        core: VehicleCore,
        link: VehicleLink,
        bus: PeerBus,
        clock: MissionClock,
        *,
        vehicle_id: int,
        members: Collection[int],
        altitude_m: float,
        rate_hz: float,
        sensor: Callable[[float], TargetSensor],
        observe: Callable[[CoreStatus, float | None], None],
        heartbeat: Heartbeat,
        perception: Perception,
    ) -> None:
        """Take the parts; `sensor(start_s)` makes the sensor once the start is known, `observe` sees each tick.

        It is told its computing time [us], None outside the control loop.
        """
        self._core = core
        self._link = link
        self._bus = bus
        self._clock = clock
        self._altitude_m = altitude_m
        self._start_agreement = StartAgreement(bus, clock, vehicle_id, members)
        self._period_s = 1.0 / rate_hz
        self._ticker: Ticker | None = None
        self._make_sensor = sensor
        self._sensor: TargetSensor | None = None
        self._observe = observe
        self._heartbeat = heartbeat
        self._perception = perception
        self._position_m = (0.0, 0.0)
        self._flying = False
        self._in_charge = False
        self._stood_down = ""
        self._ended: Outcome | None = None
        self._ended_s: float | None = None
        self._restarts = 0
        self._returning: asyncio.Task[None] | None = None
        self._kill = KillSwitch(link, self._on_killed)

    @property
    def loop(self) -> LoopReport:
        """How the control loop has fared so far."""
        statistics = TickerStatistics() if self._ticker is None else self._ticker.statistics
        return LoopReport(statistics.ticks, statistics.missed)

    @property
    def start_s(self) -> float | None:
        """The mission's start on the shared clock, once agreed on."""
        return self._start_agreement.start_s

    @property
    def ended_s(self) -> float | None:
        """When the mission ended and the way down began, on the shared clock."""
        return self._ended_s

    @property
    def clock_lags_s(self) -> dict[int, float]:
        """How far the clocks of the peers' computers are behind this one's, as far as is known [wall s]."""
        return self._start_agreement.clock_lags_s

    async def connect(self) -> None:
        """Reach the vehicle and the peers; nothing moves. Raises VehicleRefusedError."""
        await self._bus.open(self._hear, self._note_presence)
        await self._link.connect(self._sense)

    def announce(self) -> None:
        """Tell the peers the time from now on, and compare with theirs: once connected, with the clock at its speed."""
        self._start_agreement.announce()

    async def fly(self, duration_s: float, stop: Stop) -> Outcome:
        """Fly the mission from the ground to the ground: whatever happens, it comes down or is handed over."""
        self._core.set_time_scale(max(self._clock.speed, 1.0))
        outcome = Outcome(Ending.COMPLETED)
        try:
            outcome = _STOPPED
            await self._start_agreement.compare_clocks()
            if await self._took_off(stop):
                self._flying = True
                outcome = await self._control_until_end(duration_s, stop)
        except VehicleRefusedError as refusal:
            outcome = Outcome(Ending.REFUSED, refusal.reason, refusal.next_step)
        finally:
            if self._returning is not None:
                self._returning.cancel()
            over = self._stood_down and not self._kill.thrown
            outcome = self._handed_over() if over else await self._bring_down(outcome)
            self._heartbeat.ended()
        return Outcome(outcome.ending, outcome.reason, outcome.next_step, self._flying)

    def _handed_over(self) -> Outcome:
        reason, step = self._stood_down, "whoever changed the mode has the vehicle: land it from there"
        if self._link.status.restarts > self._restarts:
            reason, step = f"{reason}: its autopilot restarted", "go and see, and look at its log for the reason"
        return Outcome(Ending.PILOT_OVERRIDE, reason, step)

    def obey(self, command: OperatorCommand) -> None:
        """Take a command of an operator at this computer."""
        self._core.on_command(command, self._clock.now_s())
        self._kill_if_told()

    def see(self, sighting: Sighting) -> None:
        """Take a sighting from outside the team."""
        self._core.on_sighting(sighting)

    def pass_on(self, command: OperatorCommand) -> None:
        """Say a command to everybody else on the bus."""
        self._bus.publish(TOPICS[OperatorCommand].name, encode(command))

    async def close(self) -> None:
        """Leave the bus and release the link."""
        self._start_agreement.fall_silent()
        await self._bus.close()
        await self._link.close()

    async def _took_off(self, stop: Stop) -> bool:
        """Take off, unless the operator ends it on the way."""
        if stop.wanted.is_set() or self._kill.thrown:
            return False
        self._heartbeat.rising()
        rising = asyncio.create_task(self._link.take_off(self._altitude_m))
        stopped = asyncio.create_task(stop.wanted.wait())
        ordered = asyncio.create_task(self._tick_beside(until_landing=True))
        try:
            await asyncio.wait((rising, stopped, ordered), return_when=asyncio.FIRST_COMPLETED)
            if rising.done():
                rising.result()
                return True
            rising.cancel()
            await self._sleep(ARMED_HEARD_AFTER_S)
            return False
        finally:
            for task in (rising, stopped, ordered):
                task.cancel()

    async def _control_until_end(self, duration_s: float, stop: Stop) -> Outcome:
        first_setpoint = asyncio.Event()
        control = asyncio.create_task(self._control(first_setpoint))
        mission = asyncio.create_task(self._mission(first_setpoint, duration_s, stop))
        try:
            # Whichever ends first ends both: a loop that died must not leave the vehicle in offboard.
            await asyncio.wait((control, mission), return_when=asyncio.FIRST_COMPLETED)
            return mission.result() if mission.done() else control.result()
        finally:
            for task in (mission, control):
                task.cancel()
                with suppress(asyncio.CancelledError, Exception):
                    await task

    async def _mission(self, first_setpoint: asyncio.Event, duration_s: float, stop: Stop) -> Outcome:
        await first_setpoint.wait()
        await self._link.start_offboard()
        self._in_charge = True
        self._ended = await self._fly_until_stopped(duration_s, stop)
        self._ended_s = self._clock.now_s()
        await self._come_down(stop)
        return self._ended

    async def _fly_until_stopped(self, duration_s: float, stop: Stop) -> Outcome:
        ended = asyncio.create_task(stop.wanted.wait())
        mission = asyncio.create_task(self._assemble_and_fly(duration_s))
        try:
            await asyncio.wait((ended, mission), return_when=asyncio.FIRST_COMPLETED)
            if mission.done():
                return mission.result()
            await self._hold(stop)
            return _STOPPED
        finally:
            ended.cancel()
            mission.cancel()

    async def _come_down(self, stop: Stop) -> None:
        """Let the core bring the vehicle to where it lands: the control loop ends once it is there.

        A vehicle that an operator holds on its way, and then sends back to its mission, goes on coming down.
        """
        self._core.on_event(Event.END)
        while not (stop.hurried.is_set() or self._stood_down):
            if self._core.tactic in (Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.EXCITE):
                self._core.on_event(Event.END)
            await self._sleep(self._period_s)

    async def _assemble_and_fly(self, duration_s: float) -> Outcome:
        start_s = await self._start_agreement.agree()
        self._sensor = self._make_sensor(start_s)
        self._core.start(start_s)
        await self._sleep(start_s + duration_s - self._clock.now_s())
        return Outcome(Ending.COMPLETED)

    def _yield_to_foreign_mode(self) -> None:
        """Stand down once the autopilot is in a mode that this agent did not ask for: somebody has the vehicle.

        So it is once it has disarmed: PX4 that a failsafe landed out of offboard rests in offboard.
        """
        status = self._link.status
        own = status.armed and status.mode in (FlightMode.OFFBOARD, FlightMode.UNKNOWN)
        if self._in_charge and status.connected and not own:
            self._in_charge = False
            self._link.hand_over()
            self._core.on_event(Event.PILOT_TOOK_OVER)
            what = f"the flight mode became '{status.mode.value}'" if status.armed else "it disarmed"
            self._stood_down = f"{what}, which cordon did not ask for"

    def _take_back_if_told(self) -> None:
        """Return to the mission once the core has been told to: by a command, never by itself."""
        if self._in_charge or not self._stood_down or self._core.tactic is Tactic.PILOT_OVERRIDE or self._returning:
            return
        self._link.take_back()
        self._returning = asyncio.create_task(self._return_to_mission())

    async def _return_to_mission(self) -> None:
        try:
            await self._sleep(2.0 * self._period_s)  # setpoints have to flow first
            await self._link.start_offboard()
            self._in_charge, self._stood_down = True, ""
        except VehicleRefusedError as refusal:
            self._link.hand_over()
            self._core.on_event(Event.PILOT_TOOK_OVER)
            self._stood_down = refusal.reason
        finally:
            self._returning = None

    async def _control(self, first_setpoint: asyncio.Event) -> Outcome:
        self._ticker = Ticker(self._period_s, self._clock.now_s, speed=self._clock.speed)
        async for tick in self._ticker:
            self._yield_to_foreign_mode()
            self._take_back_if_told()
            self._core.on_vehicle(self._link.status)
            self._core.on_loop(tick.skipped)
            self._core.on_bus(self._bus.alive)
            if self._tick(self._clock.now_s()):
                first_setpoint.set()
            self._show_life()
            if self._core.tactic is Tactic.LAND or self._kill.thrown:
                break
        why = f"failsafe: {self._core.alert}" if self._core.alert else "it was told to land"
        return self._ended or Outcome(Ending.STOPPED, why)

    def _tick(self, now_s: float) -> bool:
        """Tick the core once, and carry out what it asks for; return whether that was a setpoint."""
        sighting = self._sensor.sight(now_s, self._position_m) if self._sensor else None
        began = perf_counter()
        if sighting is not None:
            self._core.on_sighting(sighting)
        output = self._core.tick(now_s)
        tick_us = (perf_counter() - began) * 1e6
        if output.setpoint is not None:
            self._link.send(output.setpoint)
        self._tell(output)
        self._observe(output.status, tick_us)
        return output.setpoint is not None

    def _tell(self, output: TickOutput) -> None:
        for message in output.messages:
            self._bus.publish(message.topic, message.payload)

    async def _hold(self, stop: Stop) -> None:
        """Let the vehicle come to rest, unless the operator is in a hurry."""
        self._core.on_event(Event.HOLD)
        with suppress(TimeoutError):
            await asyncio.wait_for(stop.hurried.wait(), HOLD_BEFORE_LANDING_S / self._clock.speed)

    async def _bring_down(self, outcome: Outcome) -> Outcome:
        """Leave offboard and land, or cut the motors; what fails is told beside what ended the flight."""
        if not (self._link.status.armed or self._kill.thrown):
            return outcome
        self._flying = True
        self._core.on_event(Event.LAND)
        ticking = asyncio.create_task(self._tick_beside())
        try:
            if (landed := await self._kill.unless_thrown(self._land(outcome))) is not None:
                return landed
            if (failure := await self._kill.failure()) is None:
                return _KILLED
            return await self._land(Outcome(Ending.REFUSED, failure.reason, failure.next_step))
        finally:
            ticking.cancel()

    async def _land(self, outcome: Outcome) -> Outcome:
        for step in (self._link.stop_offboard, self._link.land):
            try:
                await step()
            except VehicleRefusedError as refusal:
                outcome = Outcome(Ending.REFUSED, refusal.reason, refusal.next_step)
        return outcome

    async def _tick_beside(self, *, until_landing: bool = False) -> None:
        """Tick outside the control loop: peers are told where it is, operators are answered; nothing is steered."""
        async for _ in Ticker(self._period_s, self._clock.now_s, speed=self._clock.speed):
            self._tick_once_beside()
            if not until_landing:
                self._show_life()
            if until_landing and (self._core.tactic is Tactic.LAND or self._kill.thrown):
                return

    def _tick_once_beside(self) -> None:
        output = self._core.tick(self._clock.now_s())
        self._tell(output)
        self._observe(output.status, None)

    def _on_killed(self, refusal: str) -> None:
        """Answer what came of a kill, also where nothing ticks any more."""
        self._core.on_killed(refusal, self._clock.now_s())
        self._tick_once_beside()

    def _show_life(self) -> None:
        self._heartbeat.tick(self._period_s / self._clock.speed)

    def _sense(self, telemetry: Telemetry) -> None:
        self._position_m = telemetry.position_m[:2]
        if self._flying:
            self._core.on_telemetry(telemetry)

    def _hear(self, payload: bytes) -> None:
        if is_external_sighting(payload):
            seen = self._perception.take(payload, self._clock.now_s(), max(self._clock.speed, 1.0))
            if seen is not None:
                self.see(seen)
            return
        message = self._core.on_message(payload, self._clock.now_s())
        self._kill_if_told()
        if message is not None:
            self._start_agreement.hear(message)

    def _kill_if_told(self) -> None:
        if self._core.kills:
            self._kill.throw()

    def _note_presence(self, vehicle_id: int, present: bool) -> None:
        self._start_agreement.note_presence(vehicle_id, present)
        self._core.on_presence(vehicle_id, present)

    async def _sleep(self, mission_s: float) -> None:
        await asyncio.sleep(max(mission_s, 0.0) / self._clock.speed)
