"""The stub vehicles of a drill, in this process: their true state is known, and faults can be injected."""

import asyncio
import time
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from pathlib import Path

from agents.ports import VehicleRefusedError
from estimation.frames import Triple
from gcs.drill.flight import DrillFlight
from gcs.flight.faults.injection import Injection
from gcs.flight.stubs import prepared_configs, station_timeout_s
from sitl.mavlink.dialects import AutopilotKind
from sitl.server.server import Stub, serve

_AIRBORNE_M = 0.5


class StubClock:
    """The clock that stubs and agents share: fast at first, later at the wall clock's rate."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._since_s = (time.monotonic(), time.time() * speed)

    def now_s(self) -> float:
        """Return its time; while it is fast, that of `sitl.server.process.unix_clock`."""
        wall_s, since_s = self._since_s
        return since_s + (time.monotonic() - wall_s) * self.speed

    def run_at_wall_speed(self) -> None:
        """Run at the wall clock's rate from now on, in which autopilots' timeouts are measured."""
        self._since_s = (time.monotonic(), self.now_s())
        self.speed = 1.0


class StubFlight(DrillFlight):
    """A flight of stub vehicles."""

    def __init__(
        self, text: str, speed: float, logs: Path | None = None, profile_texts: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(text, speed, logs, profile_texts)
        self.stubs: dict[int, Stub] = {}
        self._clock = StubClock(speed)
        self._received: dict[int, int] = {}

    async def serve(self, stack: AsyncExitStack) -> None:
        """Start the stubs."""
        stop, ready = asyncio.Event(), asyncio.Event()
        by_system = {vehicle.system_id: vehicle.id for vehicle in self.mission.vehicles}

        def take(stubs: Sequence[Stub]) -> None:
            self.stubs = {by_system[stub.config.vehicle_id]: stub for stub in stubs}
            ready.set()

        configs = prepared_configs(self.mission, self.mission.ids, self.speed)
        serving = asyncio.create_task(
            serve(configs, speed=self.speed, now_s=self._clock.now_s, stop=stop, on_ready=take)
        )
        stack.push_async_callback(_stopped, stop, serving)
        waiting = asyncio.create_task(ready.wait())
        await asyncio.wait((serving, waiting), return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if serving.done():
            raise VehicleRefusedError(f"the stub vehicles did not start: {serving.exception()}", "try again")

    def observe(self, now_s: float) -> None:
        """Record true modes, setpoints and positions."""
        for i, stub in self.stubs.items():
            autopilot = stub.autopilot
            self.log.note_mode(now_s, i, autopilot.mode.name.lower() if autopilot.armed else "disarmed")
            if autopilot.setpoints_received != self._received.get(i):
                self._received[i], self.log.setpoint_s[i] = autopilot.setpoints_received, now_s
        bodies = {i: stub.autopilot.airframe for i, stub in self.stubs.items()}
        self.log.note_places(now_s, {i: b.position_m for i, b in bodies.items() if b.height_m > _AIRBORNE_M})

    def mission_now_s(self) -> float:
        """Return the time of the stubs' clock."""
        return self._clock.now_s()

    def abandon(self) -> None:
        """Run at the wall clock's rate, with its timeouts: what follows is measured in wall time."""
        self._clock.run_at_wall_speed()
        for stub in self.stubs.values():
            if stub.config.autopilot is AutopilotKind.ARDUPILOT:
                stub.autopilot.parameters.set("FS_GCS_TIMEOUT", station_timeout_s(self._clock.speed))

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
