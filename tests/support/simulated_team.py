"""A whole team below the wire: real agents and stub autopilots on an event loop in simulated time, without sockets.

Links and bus pass values instead of MAVLink and Zenoh messages; the faults of vehicles, buses and sensors are those of
drills.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from math import hypot
from types import MappingProxyType
from typing import Self

from agents.core import VehicleCore
from agents.drops import NO_DROPS, Refusals
from agents.outputs import CoreStatus
from agents.ports import FlightMode, Setpoint, VehicleRefusedError, VehicleStatus
from agents.shell.agent import Agent
from agents.shell.control_loop import AgentParts
from agents.shell.outcome import Outcome, Stop
from agents.team.codec import decode
from agents.team.external_positions import ExternalPosition
from agents.team.messages import BusMessage, OperatorCommand
from agents.team.perception import Perception
from agents.team.verbs import Verb
from estimation.frames import Triple
from estimation.state import Telemetry
from gcs.autopilots import px4
from gcs.flight.faults.failing_equipment import FailingBus, FailingSensor
from gcs.flight.faults.team_faults import PresentFaults
from gcs.flight.team import TrueSensor
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.simulation import target_sensor
from sitl.autopilot.autopilot import MavResult
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.modes import NavMode
from sitl.autopilot.px4 import Px4
from sitl.faults import VehicleFaults, VehicleInjection, shifted
from sitl.mavlink.reports import POSITION_GATE_M
from tests.support.fake_flight import TELEMETRY_PERIOD_S, FakeHeartbeat, SimulatedClock

CALL_TIMEOUT_S = 60.0
LAST_S = 3600.0


class AutopilotLink:
    """The link to a PX4 stub, which it advances; implements `agents.ports.VehicleLink`."""

    def __init__(self, vehicle: MissionVehicle, on_step: Callable[[], None]) -> None:
        self.faults = VehicleFaults()
        self.autopilot = Px4(vehicle.true_plant, (*vehicle.section.start_m, 0.0))
        for name, value in px4.AUTOPILOT.failsafe_parameters(1.0).items():
            assert self.autopilot.parameters.set(name, value)
        self._on_step = on_step
        self._clock = SimulatedClock(1.0)
        self._booted_s = asyncio.get_running_loop().time()
        self._handed_over = False
        self._flying: asyncio.Task[None] | None = None

    @property
    def status(self) -> VehicleStatus:
        autopilot, faults = self.autopilot, self.faults
        off_x, off_y, _ = faults.estimate_offset_m
        return VehicleStatus(
            connected=True,
            armed=autopilot.armed,
            in_air=not autopilot.landed,
            mode=FlightMode[autopilot.mode.name],
            battery=min(autopilot.battery_fraction, 1.0 if faults.second_battery is None else faults.second_battery),
            local_position_ok=autopilot.estimator_ready,
            armable=autopilot.armable,
            estimator_ratio=max(faults.estimator_ratio, (hypot(off_x, off_y) / POSITION_GATE_M) ** 2),
            endurance_s=faults.endurance_s,
        )

    @property
    def estimate_m(self) -> Triple:
        """The autopilot's estimate of its position."""
        return shifted(self.autopilot.airframe.position_m, self.faults.offset_m)

    def inject(self, injection: VehicleInjection) -> None:
        """Inject faults from now on."""
        self.faults.add(injection.faults)
        if injection.battery_fraction is not None:
            self.autopilot.battery_fraction = injection.battery_fraction
        if injection.selects_hold:
            self.autopilot.select(NavMode.HOLD)

    async def connect(self, on_telemetry: Callable[[Telemetry], None]) -> None:
        self._handed_over = False
        self._flying = asyncio.create_task(self._fly(on_telemetry))

    async def _fly(self, on_telemetry: Callable[[Telemetry], None]) -> None:
        loop, autopilot, faults = asyncio.get_running_loop(), self.autopilot, self.faults
        while True:
            autopilot.step(loop.time() - self._booted_s, faults.push_m_s2)
            self._on_step()
            if autopilot.estimator_ready and not faults.motion_silent:
                sample = Telemetry(self._clock.now_s(), self.estimate_m, autopilot.airframe.velocity_m_s)
                loop.call_later(faults.link_delay_s, on_telemetry, sample)
            await asyncio.sleep(TELEMETRY_PERIOD_S)

    async def take_off(self, altitude_m: float) -> None:
        await self._until(lambda: self.autopilot.armable)
        self._carry_out(self.autopilot.take_off(altitude_m))
        self._carry_out(self.autopilot.arm())
        await self._until(lambda: self.autopilot.mode is NavMode.HOLD)

    async def start_offboard(self) -> None:
        await asyncio.sleep(TELEMETRY_PERIOD_S)  # the first setpoint arrives before the command
        self._carry_out(self.autopilot.select(NavMode.OFFBOARD))

    async def stop_offboard(self) -> None:
        self._carry_out(self.autopilot.select(NavMode.HOLD))

    async def catch_up(self) -> None:
        pass

    async def land(self) -> None:
        self._carry_out(self.autopilot.land())
        await self._until(lambda: not self.autopilot.armed)

    async def kill(self) -> None:
        self._carry_out(self.autopilot.disarm(force=True))

    def locate(self, position: ExternalPosition) -> None:
        raise AssertionError("its estimate needs no external position")

    def hand_over(self) -> None:
        self._handed_over = True

    def take_back(self) -> None:
        self._handed_over = False

    def send(self, setpoint: Setpoint) -> None:
        if not self._handed_over:
            asyncio.get_running_loop().call_later(self.faults.link_delay_s, self._receive, setpoint)

    def _receive(self, setpoint: Setpoint) -> None:
        (x, y, z), (dx, dy, dz) = setpoint.position_m, self.faults.offset_m
        target = PositionTarget((x - dx, y - dy, z - dz), None, setpoint.velocity_m_s)
        self.autopilot.receive_setpoint(self.autopilot.time_s, target)

    async def close(self) -> None:
        if self._flying is not None:
            self._flying.cancel()

    @staticmethod
    def _carry_out(result: MavResult) -> None:
        if result is not MavResult.ACCEPTED:
            raise VehicleRefusedError(result.value, "examine the vehicle")

    @staticmethod
    async def _until(condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(CALL_TIMEOUT_S):
            while not condition():
                await asyncio.sleep(TELEMETRY_PERIOD_S)


class TeamBus:
    """The bus of all participants; `observe` receives every message as well."""

    def __init__(self, observe: Callable[[BusMessage], None]) -> None:
        self._observe = observe
        self._members: dict[int, MemberBus] = {}

    def of(self, vehicle_id: int) -> "MemberBus":
        """Return a vehicle's bus, not yet open."""
        return MemberBus(self, vehicle_id)

    def join(self, member: "MemberBus") -> None:
        for other in self._members.values():
            other.on_presence(member.vehicle_id, True)
            member.on_presence(other.vehicle_id, True)
        self._members[member.vehicle_id] = member

    def leave(self, member: "MemberBus") -> None:
        del self._members[member.vehicle_id]
        for other in self._members.values():
            other.on_presence(member.vehicle_id, False)

    def send(self, sender: int, payload: bytes) -> None:
        message, loop = decode(payload), asyncio.get_running_loop()
        self._observe(message)
        for vehicle_id, member in self._members.items():
            if vehicle_id != sender:
                loop.call_soon(member.on_message, message)


class MemberBus:
    """One vehicle's part of the bus; implements `agents.ports.PeerBus`."""

    operated, operators_seen, revoked, drops = False, 0, (), NO_DROPS
    refusals: Refusals = MappingProxyType({})
    heads: Mapping[str, bytes] = MappingProxyType({})

    def __init__(self, team: TeamBus, vehicle_id: int) -> None:
        self.alive = True
        self._team = team
        self.vehicle_id = vehicle_id
        self.on_message: Callable[[BusMessage], None] = lambda _message: None
        self.on_presence: Callable[[int, bool], None] = lambda _vehicle_id, _present: None

    async def open(
        self,
        on_message: Callable[[BusMessage], None],
        on_sensor: Callable[[str, bytes], None],
        on_presence: Callable[[int, bool], None],
    ) -> None:
        self.on_message, self.on_presence = on_message, on_presence
        self._team.join(self)

    def admit(self, vehicle_id: int) -> None:
        pass

    def publish(self, topic: str, payload: bytes) -> None:
        if self.alive:
            self._team.send(self.vehicle_id, payload)

    def break_off(self) -> None:
        """Lose the session for good."""
        if self.alive:
            self._team.leave(self)
        self.alive = False

    async def close(self) -> None:
        self.break_off()


class SimulatedTeam:
    """The vehicles of a mission, their agents, their buses and their faults; use it as a context manager.

    `observe` receives every message, `step` is called as often as vehicles send telemetry. Times are those of the
    running loop. `newest` are the vehicles' newest statuses, `flights` the agents' flights.
    """

    def __init__(
        self,
        mission: Mission,
        observe: Callable[[BusMessage], None] = lambda _: None,
        step: Callable[[], None] = lambda: None,
    ) -> None:
        self.mission, self.faults, self.stop = mission, PresentFaults(), Stop()
        self.links: dict[int, AutopilotLink] = {}
        self.agents: dict[int, Agent] = {}
        self.buses: dict[int, MemberBus] = {}
        self.newest: dict[int, CoreStatus] = {}
        self.flights: dict[int, asyncio.Task[Outcome]] = {}
        self._bus = TeamBus(observe)
        self._clock = SimulatedClock(1.0)
        self._step = step
        self._numbers = count(1)

    async def __aenter__(self) -> Self:
        self.links = {vehicle.id: AutopilotLink(vehicle, self._step) for vehicle in self.mission.vehicles}
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.gather(*map(self.end, self.agents))

    async def begin(self, duration_s: float = LAST_S, vehicles: Sequence[int] = ()) -> None:
        """Connect new agents of some vehicles, or of all, and take off."""
        ids = vehicles or self.mission.ids
        for i in ids:
            self.buses[i] = self._bus.of(i)
            self.agents[i] = self._agent(self.mission.vehicle(i))
        await asyncio.gather(*(self.agents[i].connect() for i in ids))
        for i in ids:
            self.agents[i].announce()
            self.flights[i] = asyncio.create_task(self.agents[i].fly(duration_s, self.stop))

    async def end(self, vehicle: int) -> None:
        """End a vehicle's flight, unless it has ended, and close its agent."""
        self.flights[vehicle].cancel()
        await asyncio.gather(self.flights[vehicle], return_exceptions=True)
        await self.agents[vehicle].close()

    def tactics(self) -> list[str]:
        """Return the present tactics of the vehicles in line, empty before the first tick."""
        return [self.newest[i].tactic.value if i in self.newest else "" for i in self.mission.ids]

    async def until(self, condition: Callable[[], bool], timeout_s: float = 60.0) -> float:
        """Wait for a condition, and return the time when it was true."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + timeout_s
        while not condition():
            assert loop.time() < end_s, self.tactics()
            await asyncio.sleep(0.05)
        return loop.time()

    @staticmethod
    async def until_s(time_s: float) -> None:
        """Wait until a time."""
        await asyncio.sleep(time_s - asyncio.get_running_loop().time())

    def command(self, verb: Verb, vehicle: int) -> None:
        """Pass an operator's command to a vehicle's agent."""
        self.agents[vehicle].obey(OperatorCommand(self._clock.now_s(), verb, vehicle, "test", next(self._numbers)))

    def _agent(self, vehicle: MissionVehicle) -> Agent:
        mission, link, config = self.mission, self.links[vehicle.id], self.mission.agent_config(vehicle)

        def sensor(start_s: float) -> TrueSensor:
            failing = FailingSensor(target_sensor(mission, vehicle.id, start_s, mission.mission.seed), self.faults)
            return TrueSensor(failing, lambda _: link.autopilot.airframe.position_m[:2], lambda _: link.estimate_m[:2])

        def observe(status: CoreStatus, _tick_us: float | None) -> None:
            self.newest[vehicle.id] = status

        return Agent(
            AgentParts(
                core=VehicleCore(config),
                config=config,
                link=link,
                bus=FailingBus(self.buses[vehicle.id], self._clock, self.faults, vehicle.id),
                clock=self._clock,
                make_sensor=sensor,
                observe=observe,
                heartbeat=FakeHeartbeat(),
                perception=Perception(mission.mission_frame(), lambda _reason: None, config.targets),
                mission=mission.identity,
            )
        )
