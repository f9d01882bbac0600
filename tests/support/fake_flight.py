"""One agent with a scripted vehicle, bus, clock and operator, on an event loop in simulated time."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import count, groupby
from types import MappingProxyType
from typing import ClassVar

from msgspec import structs

from agents.core import VehicleCore
from agents.drops import NO_DROPS, Refusals
from agents.inputs import CoreInput, TacticEvent
from agents.outputs import CoreStatus
from agents.ports import FlightMode, Setpoint, VehicleRefusedError, VehicleStatus
from agents.recording import RecordedCore
from agents.settings.config import AgentConfig
from agents.settings.sections import FormationSettings
from agents.shell.agent import Agent
from agents.shell.clock import WallClock
from agents.shell.control_loop import AgentParts
from agents.shell.life import Phase
from agents.shell.outcome import Outcome, Stop
from agents.tactics import Event
from agents.team.external_positions import ExternalPosition
from agents.team.messages import BusMessage, OperatorCommand, StartProposal
from agents.team.perception import Perception
from agents.team.verbs import Verb
from estimation.frames import Geodetic, MissionFrame
from estimation.state import Sighting, Telemetry
from tests.conftest import CONFIG

ALONE = replace(CONFIG, vehicle_id=1, slots=(1,), formation=FormationSettings(spacing_m=5.0, speed_m_s=0.2, leader=1))
PAIR = replace(ALONE, slots=(1, 2))
EPOCH_S = 1_000.0
TELEMETRY_PERIOD_S = 0.05
CATCHES_UP_AFTER_S = 2.5
"""Longer than an arming takes to be reported."""
LOSS_SHOWS_AFTER_S = 3.0
"""The time after the last heartbeat at which a link is lost."""


class SimulatedClock(WallClock):
    """A mission clock on the event loop's time."""

    def now_s(self) -> float:
        return EPOCH_S + asyncio.get_running_loop().time() * self.speed


class FakeLink:
    """A vehicle that completes each call after `takes_s`, unless the call is in `refused`, `broken` or `stuck`.

    `calls` are all calls in order, `send` once for each uninterrupted sequence. A `stuck` call is not answered until
    `release`. Once the link is lost, no call is answered.
    """

    takes_s: ClassVar = {"take_off": 4.0, "start_offboard": 0.3, "stop_offboard": 0.3, "land": 5.0, "kill": 0.2}

    def __init__(self) -> None:
        self.status = VehicleStatus(connected=True, mode=FlightMode.READY, local_position_ok=True, armable=True)
        self.position_m = (0.0, 0.0, 0.0)
        self.located: list[ExternalPosition] = []
        self.refused: set[str] = set()
        self.broken: set[str] = set()
        self.stuck: set[str] = set()
        self.telemetry = True
        self.cancelled: list[str] = []
        self.overlapping: list[str] = []
        """Calls made before another call had ended, except kills, which do not wait."""
        self._under_way: list[str] = []
        self._calls: list[str] = []
        self._lost, self._released = asyncio.Event(), asyncio.Event()
        self._telling: asyncio.Task[None] | None = None
        self._arming: asyncio.TimerHandle | None = None

    @property
    def connected(self) -> bool:
        return self._telling is not None

    @property
    def calls(self) -> list[str]:
        return [call for i, call in enumerate(self._calls) if call != "send" or self._calls[i - 1 : i] != ["send"]]

    def change(self, **changes: object) -> None:
        self.status = structs.replace(self.status, **changes)

    def release(self) -> None:
        """Continue stuck calls."""
        self.stuck.clear()
        self._released.set()

    def lose(self) -> None:
        """Cut the link: telemetry ends now, the loss is detected later."""
        self.telemetry = False
        self._lost.set()
        asyncio.get_running_loop().call_later(LOSS_SHOWS_AFTER_S, lambda: self.change(connected=False))

    async def connect(self, on_telemetry: Callable[[Telemetry], None]) -> None:
        self._telling = asyncio.create_task(self._tell(on_telemetry))

    async def take_off(self, altitude_m: float) -> None:
        if not (self._lost.is_set() or "arm" in self.refused):  # reported late, whatever the result
            arm = partial(self.change, armed=True, mode=FlightMode.TAKE_OFF)
            self._arming = asyncio.get_running_loop().call_later(1.0, arm)
        await self._carry_out("take_off")
        self.position_m = (0.0, 0.0, altitude_m)
        self.change(in_air=True, mode=FlightMode.HOLD)

    async def start_offboard(self) -> None:
        await self._carry_out("start_offboard")
        self.change(mode=FlightMode.OFFBOARD)

    async def stop_offboard(self) -> None:
        await self._carry_out("stop_offboard")
        self.change(mode=FlightMode.HOLD)

    async def catch_up(self) -> None:
        await asyncio.sleep(CATCHES_UP_AFTER_S)

    async def land(self) -> None:
        self.change(mode=FlightMode.LAND)
        await self._carry_out("land")
        self.change(armed=False, in_air=False)

    async def kill(self) -> None:
        await self._carry_out("kill")
        if self._arming is not None:
            self._arming.cancel()
        self.change(armed=False)

    def locate(self, position: ExternalPosition) -> None:
        self.located.append(position)

    def hand_over(self) -> None:
        self._calls.append("hand_over")

    def take_back(self) -> None:
        self._calls.append("take_back")

    def send(self, setpoint: Setpoint) -> None:
        self._calls.append("send")

    async def close(self) -> None:
        if self._telling is not None:
            self._telling.cancel()

    async def _carry_out(self, call: str) -> None:
        self._calls.append(call)
        self.overlapping += [f"{call} during {other}" for other in self._under_way if call != "kill"]
        self._under_way.append(call)
        try:
            if call in self.broken:
                raise ZeroDivisionError(call)
            if call in self.stuck:
                await self._released.wait()
            if call == "take_off" and "arm" in self.refused:
                raise VehicleRefusedError("refused to arm", "look at it")
            if await _within(self._lost, self.takes_s[call]):
                await asyncio.sleep(2.0)
                raise VehicleRefusedError(f"does not answer to {call}", "check the link")
            if call in self.refused:
                raise VehicleRefusedError(f"refused to {call}", "look at it")
        except asyncio.CancelledError:
            await asyncio.sleep(0.05)  # a real link takes time to close as well
            self.cancelled.append(call)
            raise
        finally:
            self._under_way.remove(call)

    async def _tell(self, on_telemetry: Callable[[Telemetry], None]) -> None:
        clock = SimulatedClock(1.0)
        while True:
            if self.telemetry:
                on_telemetry(Telemetry(clock.now_s(), self.position_m, (0.0, 0.0, 0.0)))
            await asyncio.sleep(TELEMETRY_PERIOD_S)


async def _within(event: asyncio.Event, longest_s: float) -> bool:
    try:
        await asyncio.wait_for(event.wait(), longest_s)
    except TimeoutError:
        return False
    return True


class FakeBus:
    """A bus that keeps published messages; the test sends what others do."""

    alive = True
    operated = False
    operators_seen = 0
    revoked: tuple[str, ...] = ()
    refusals: Refusals = MappingProxyType({})
    heads: Mapping[str, bytes] = MappingProxyType({})
    drops = NO_DROPS

    def __init__(self) -> None:
        self.published: list[tuple[str, bytes]] = []
        self.admitted: list[int] = []
        self.deliver: Callable[[BusMessage], None] = lambda _message: None
        self.sense: Callable[[str, bytes], None] = lambda _topic, _payload: None
        self.appear: Callable[[int, bool], None] = lambda _vehicle_id, _present: None

    async def open(
        self,
        on_message: Callable[[BusMessage], None],
        on_sensor: Callable[[str, bytes], None],
        on_presence: Callable[[int, bool], None],
    ) -> None:
        self.deliver, self.sense, self.appear = on_message, on_sensor, on_presence

    def admit(self, vehicle_id: int) -> None:
        self.admitted.append(vehicle_id)

    def publish(self, topic: str, payload: bytes) -> None:
        self.published.append((topic, payload))

    async def close(self) -> None:
        pass

    def payloads(self, topic: str) -> list[bytes]:
        """Return the messages published on a topic so far."""
        return [payload for each, payload in self.published if each == topic]


class FakeHeartbeat:
    """Records the heartbeat; one entry for each uninterrupted sequence of ticks."""

    def __init__(self) -> None:
        self.all: list[str] = []

    @property
    def signs(self) -> list[str]:
        return [sign for sign, _ in groupby(self.all)]

    def rising(self) -> None:
        self.all.append("rising")

    def tick(self, due_s: float) -> None:
        self.all.append("tick")

    def ended(self) -> None:
        self.all.append("ended")


class _NoTarget:
    def sight(self, now_s: float, position_m: tuple[float, float]) -> tuple[Sighting, ...]:
        return ()


class FakeFlight:
    """An agent with all its parts; `inputs` are the inputs of its core in order, with their times."""

    def __init__(self, config: AgentConfig = ALONE) -> None:
        self.link, self.bus, self.heartbeat = FakeLink(), FakeBus(), FakeHeartbeat()
        self.clock, self.stop = SimulatedClock(1.0), Stop()
        self.inputs: list[tuple[float, CoreInput]] = []
        self.statuses: list[CoreStatus] = []
        self._numbers = count(1)
        self.core: VehicleCore = RecordedCore(config, self)
        frame = MissionFrame(Geodetic(47.4, 8.5, 488.0))
        self.parts = AgentParts(
            core=self.core,
            config=config,
            link=self.link,
            bus=self.bus,
            clock=self.clock,
            make_sensor=lambda _start_s: _NoTarget(),
            observe=lambda status, _tick_us: self.statuses.append(status),
            heartbeat=self.heartbeat,
            perception=Perception(frame, lambda _reason: None),
        )
        self.agent = Agent(self.parts)
        self.task: asyncio.Task[Outcome] | None = None

    def write(self, item: object) -> None:
        """Take the items of a recorded core."""
        if isinstance(item, CoreInput):
            self.inputs.append((self.clock.now_s(), item))

    async def begin(self, duration_s: float = 20.0) -> None:
        """Connect if necessary, and fly in a task."""
        if not self.link.connected:
            await self.agent.connect()
        self.agent.announce()
        self.task = asyncio.create_task(self.agent.fly(duration_s, self.stop))

    async def until(self, phase: Phase, longest_s: float = 300.0) -> None:
        """Wait until the agent is in a phase."""
        end_s = asyncio.get_running_loop().time() + longest_s
        while self.agent.phase is not phase:
            assert asyncio.get_running_loop().time() < end_s, f"{self.agent.phase}, not {phase}: {self.link.calls}"
            await asyncio.sleep(0.01)

    async def outcome(self) -> Outcome:
        """Wait for the end, and close the agent."""
        assert self.task is not None
        try:
            return await asyncio.wait_for(self.task, 1_000.0)
        finally:
            await self.agent.close()

    def command(self, verb: Verb) -> None:
        """Pass a command of an operator at the agent's computer."""
        number = next(self._numbers)
        self.agent.obey(OperatorCommand(self.clock.now_s(), verb, None, "test", number))

    def events(self) -> list[Event]:
        """Return the events passed to the core."""
        return [item.event for _, item in self.inputs if isinstance(item, TacticEvent)]

    def hear_peer_clock(self, ahead_s: float, times: int = 10) -> None:
        """Make vehicle 2 present and send a time that is `ahead_s` ahead of the agent's."""
        self.bus.appear(2, True)
        for _ in range(times):
            self.bus.deliver(StartProposal(2, self.clock.now_s() + ahead_s, None, ready=False))
