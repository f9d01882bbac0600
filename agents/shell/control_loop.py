"""The ticks of one core: its inputs on each tick, and the transmission of its setpoints and messages."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

from agents.broadcast import command_answer
from agents.core import VehicleCore
from agents.inputs import AutopilotStatus, Bus, LateTicks
from agents.outputs import CoreStatus, TickOutput
from agents.ports import Heartbeat, PeerBus, TargetSensor, VehicleLink
from agents.settings.config import AgentConfig
from agents.shell.clock import MissionClock
from agents.shell.ticker import Ticker, TickerStatistics, first_deadline_s
from agents.team.external_positions import ExternalPositions
from agents.team.messages import MissionIdentity
from agents.team.perception import Perception


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentParts:
    """The parts of one agent.

    `core` was made from `config`. `make_sensor(start_s)` makes the sensor of the target once the start is known.
    `positions` reads externally measured positions, None if the autopilot needs none. `mission` is compared with that
    of peers and operators. `observe` is called on each tick with the core's status and its computing time [us], None
    outside the control loop.
    """

    core: VehicleCore
    config: AgentConfig
    link: VehicleLink
    bus: PeerBus
    clock: MissionClock
    make_sensor: Callable[[float], TargetSensor]
    observe: Callable[[CoreStatus, float | None], None]
    heartbeat: Heartbeat
    perception: Perception
    positions: ExternalPositions | None = None
    mission: MissionIdentity | None = None


class ControlLoop:
    """Ticks a core with or without control of the vehicle."""

    def __init__(self, parts: AgentParts) -> None:
        self._parts = parts
        self.period_s = 1.0 / parts.config.rate_hz
        """The period of a tick [mission s]."""
        self.sensor: TargetSensor | None = None
        self.position_m = (0.0, 0.0)
        """The position of the vehicle, for the sensor."""
        self.newest: TickOutput | None = None
        """The output of the newest tick."""
        self._control_ticker: Ticker | None = None
        self._before = TickerStatistics()

    @property
    def report(self) -> TickerStatistics:
        """The ticks with control of the vehicle, done and missed so far."""
        return self._before if self._control_ticker is None else self._before.plus(self._control_ticker.statistics)

    def restart(self) -> None:
        """Begin another flight; the ticks of those before count."""
        self._before, self._control_ticker = self.report, None
        self.sensor = self.newest = None

    def ticker(self) -> Ticker:
        """Return a ticker at the core's rate, beginning within a period.

        The ticks of a team's vehicles are spread evenly over the period, in the order of their ids: if they were
        simultaneous, the last vehicle of a process would be late by the ticks of all others.
        """
        clock, config = self._parts.clock, self._parts.config
        phase = sorted(config.slots).index(config.vehicle_id) / len(config.slots)
        start_s = first_deadline_s(clock.now_s(), self.period_s, phase)
        return Ticker(self.period_s, clock, start_s)

    def control_ticker(self) -> Ticker:
        """Return the same for ticks with control of the vehicle, which are counted."""
        self._control_ticker = self.ticker()
        return self._control_ticker

    def tick_control(self, late_ticks: int) -> bool:
        """Tick the core and send its setpoint, if any; return whether there was one."""
        core, link = self._parts.core, self._parts.link
        core.take(AutopilotStatus(link.status))
        core.take(LateTicks(late_ticks))
        bus = self._parts.bus
        core.take(Bus(bus.alive, bus.operated, bus.revoked))
        core.take(self._parts.bus.drops)
        now_s = self._parts.clock.now_s()
        sightings = self.sensor.sight(now_s, self.position_m) if self.sensor else ()
        began = perf_counter()
        for sighting in sightings:
            core.take(sighting)
        output = core.tick(now_s)
        tick_us = (perf_counter() - began) * 1e6
        if output.setpoint is not None:
            link.send(output.setpoint)
        self._publish(output, tick_us)
        return output.setpoint is not None

    def tick_only(self) -> None:
        """Tick the core without control of the vehicle, for its messages to peers and answers to operators."""
        self._parts.core.take(AutopilotStatus(self._parts.link.status))
        self._publish(self._parts.core.tick(self._parts.clock.now_s()), None)

    def answer(self) -> None:
        """Send the core's answers to operators, without a tick: its flight is over, and peers do not wait for it."""
        for message in map(command_answer, self._parts.core.commands.answers(self._parts.clock.now_s())):
            self._parts.bus.publish(message.topic, message.payload)

    def send_heartbeat(self) -> None:
        """Report the tick to the supervisor."""
        self._parts.heartbeat.tick(self.period_s / self._parts.clock.time_scale)

    def _publish(self, output: TickOutput, tick_us: float | None) -> None:
        self.newest = output
        for message in output.messages:
            self._parts.bus.publish(message.topic, message.payload)
        self._parts.observe(output.status, tick_us)
