"""The stub vehicles of a drill, in this process: their true state is known, and faults can be injected."""

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from pathlib import Path

from agents.ports import VehicleRefusedError
from estimation.frames import Triple
from gcs.drill.flight import DrillFlight
from gcs.flight.faults.team_faults import Injection
from gcs.flight.stubs import clock_refusal, prepared_configs, preparing_speed
from sitl.server.governed_clock import GovernedClock
from sitl.server.server import Stub, serve
from sitl.server.shared_clock import ClockError, Rank, new_clock

_AIRBORNE_M = 0.5


class StubFlight(DrillFlight):
    """A flight of stub vehicles."""

    def __init__(
        self, text: str, speed: float, logs: Path | None = None, profile_texts: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(text, speed, logs, profile_texts)
        self.stubs: dict[int, Stub] = {}
        self._governed: GovernedClock | None = None
        self._received: dict[int, int] = {}

    async def serve(self, stack: AsyncExitStack) -> None:
        """Start the stubs."""
        stop, ready = asyncio.Event(), asyncio.Event()
        by_system = {vehicle.system_id: vehicle.id for vehicle in self.mission.vehicles}

        def take(stubs: Sequence[Stub]) -> None:
            self.stubs = {by_system[stub.config.vehicle_id]: stub for stub in stubs}
            ready.set()

        self.clock = self._governed = stack.enter_context(self._new_clock(stack))
        configs = prepared_configs(self.mission, self.mission.ids, self.clock.time_scale)
        serving = asyncio.create_task(serve(configs, self.clock, stop, take))
        stack.push_async_callback(_stopped, stop, serving)
        waiting = asyncio.create_task(ready.wait())
        await asyncio.wait((serving, waiting), return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if serving.done():
            raise VehicleRefusedError(f"the stub vehicles did not start: {serving.exception()}", "try again")

    def _new_clock(self, stack: AsyncExitStack) -> GovernedClock:
        try:
            speed = min(self.speed, preparing_speed(len(self.mission.vehicles)))
            return GovernedClock(stack.enter_context(new_clock(speed)), Rank.STUBS)
        except ClockError as error:
            raise clock_refusal(error) from error

    def clock_arguments(self) -> tuple[str, ...]:
        """Return the number of the clock, and the speed."""
        return () if self._governed is None else (str(self._governed.name.number), str(self.speed))

    @property
    def has_begun(self) -> bool:
        """Return whether the mission has begun."""
        return self._governed is not None and self._governed.mission_began_s is not None

    def observe(self, now_s: float) -> None:
        """Record true modes, setpoints and positions."""
        for i, stub in self.stubs.items():
            autopilot = stub.autopilot
            self.log.note_mode(now_s, i, autopilot.mode.name.lower() if autopilot.armed else "disarmed")
            if autopilot.setpoints_received != self._received.get(i):
                self._received[i], self.log.setpoint_s[i] = autopilot.setpoints_received, now_s
        bodies = {i: stub.autopilot.airframe for i, stub in self.stubs.items()}
        self.log.note_places(now_s, {i: b.position_m for i, b in bodies.items() if b.height_m > _AIRBORNE_M})

    def places_m(self) -> Mapping[int, Triple]:
        """Return the vehicles' true positions [m]."""
        return {i: stub.autopilot.airframe.position_m for i, stub in self.stubs.items()}

    def _inject(self, injection: Injection) -> None:
        super()._inject(injection)
        for i, each in injection.vehicles.items():
            self.stubs[i].inject(each)

    def clear_faults(self) -> None:
        """Clear the faults of flying process, links and vehicles."""
        super().clear_faults()
        for stub in self.stubs.values():
            stub.faults.clear()


async def _stopped(stop: asyncio.Event, serving: "asyncio.Task[object]") -> None:
    stop.set()
    await asyncio.gather(serving, return_exceptions=True)
