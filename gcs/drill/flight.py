"""A team in flight for a drill: its flying process, its messages, and its vehicles' states."""

import asyncio
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from agents.ports import VehicleRefusedError
from agents.team.messages import BusMessage, MemberState
from estimation.frames import Triple
from estimation.profile.shelf import bundled_profiles
from gcs.console.command_client import CommandClient
from gcs.console.team_bus import guest_bus
from gcs.drill.judge import OFFBOARD, TeamLog
from gcs.drill.process_under_test import LOGS, SOCKET
from gcs.drill.roles import Roles
from gcs.flight.faults.catalogue import required_fault
from gcs.flight.faults.injection import Injection, Scene
from gcs.flight.faults.stranger import Stranger
from gcs.flight.faults.team_faults import TeamFaults
from gcs.keys.team_keys import NoKeys, TeamKeys, flight_keys
from gcs.mission.file import parse_mission

_POLL_S = 0.004
_STALL_S = 0.1
_ALOFT_TIMEOUT_S = 90.0
_END_TIMEOUT_S = 10.0
_RESUME_TIMEOUT_S = 6.0
_FLIGHT_S = 3600.0


class ProcessUnderTest:
    """The flying process: its id, 0 until it has connected, and the connection that faults are sent through."""

    def __init__(self) -> None:
        self.pid = 0
        self._writer: asyncio.StreamWriter | None = None

    async def meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Accept its connection, as a server's callback."""
        self.pid = int(await reader.readline())
        self._writer = writer

    def inject(self, faults: TeamFaults) -> None:
        """Set its present faults."""
        if self._writer is not None:
            self._writer.write(msgspec.json.encode(faults) + b"\n")


class DrillFlight:
    """One flight, as a context manager: processes and vehicles end with it.

    A subclass defines the vehicles: it runs them, observes them, and clears the faults injected into them.
    """

    def __init__(
        self, text: str, speed: float, logs: Path | None = None, profile_texts: Mapping[str, str] | None = None
    ) -> None:
        """Take the texts of a mission and its profiles; the flight is recorded to the folder `logs`, if given."""
        self.mission = parse_mission(text, None, profile_texts)
        self.log = TeamLog()
        self.speed = speed
        self.positions_m: dict[int, Triple] = {}
        self._text = text
        self._logs = logs
        self._under_test = ProcessUnderTest()
        self._stack = AsyncExitStack()
        self._process: asyncio.subprocess.Process | None = None
        self._output = ""
        self._keys: TeamKeys = NoKeys()
        self._stranger: asyncio.Task[None] | None = None
        self._stalls: list[tuple[float, float]] = []

    async def __aenter__(self) -> Self:
        """Start it; raises VehicleRefusedError."""
        try:
            await self._start()
        except BaseException:
            await self._stack.aclose()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the processes first, then the vehicles."""
        await self._stack.aclose()

    @staticmethod
    def now_s() -> float:
        """Return the time of the log [wall s]."""
        return time.monotonic()

    def fail(self, fault: str, roles: Roles) -> None:
        """Inject a fault of the catalogue; subclasses inject those of vehicles."""
        self._inject(required_fault(fault).inject(self._scene(roles)))

    def _scene(self, roles: Roles) -> Scene:
        return Scene(roles.mission, roles.subject, roles.airborne, self.places_m(), self.speed)

    def places_m(self) -> Mapping[int, Triple]:
        """Return the vehicles' reported positions [m]."""
        return self.positions_m

    def _inject(self, injection: Injection) -> None:
        if injection.ends_flight:
            self.abandon()
        if injection.signal is not None:
            os.kill(self._under_test.pid, injection.signal)
        if injection.stranger:
            self._intrude()
        self._under_test.inject(injection.team)

    async def serve(self, stack: AsyncExitStack) -> None:
        """Start the vehicles, to be ended with the stack; raises VehicleRefusedError."""
        raise NotImplementedError

    def observe(self, now_s: float) -> None:
        """Record the vehicles' present states."""
        raise NotImplementedError

    def abandon(self) -> None:
        """Prepare for the end of the flying process: called before it is killed or stopped."""

    def clear_faults(self) -> None:
        """Clear all faults that can be cleared."""
        self._under_test.inject(TeamFaults())
        if self._stranger is not None:
            self._stranger.cancel()
            self._stranger = None

    def mission_now_s(self) -> float:
        """Return the time of the team's clock [mission s]."""
        raise NotImplementedError

    def _intrude(self) -> None:
        """Send forged messages and commands in the vehicles' names, until the faults are cleared."""
        self._stranger = asyncio.create_task(Stranger(self.mission, self.mission_now_s).run())
        self._stack.push_async_callback(_cancelled, self._stranger)

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition [wall s]; return whether it became true."""
        end_s = self.now_s() + timeout_s
        while not condition():
            if self.now_s() > end_s:
                return False
            await asyncio.sleep(_POLL_S)
        return True

    async def reach_mission(self, vehicles: Sequence[int], tactics: Callable[[int], str]) -> None:
        """Wait until all vehicles fly their tactics without an alert; raises VehicleRefusedError after a timeout."""
        radius_m = self.mission.encirclement.radius_m

        def settled(vehicle: int) -> bool:
            if (
                self.log.mode(vehicle) != OFFBOARD
                or self.log.tactic(vehicle) != tactics(vehicle)
                or self.log.alert(vehicle)
            ):
                return False
            radii = self.log.radii_m[vehicle]
            return tactics(vehicle) != "encircle" or (bool(radii) and abs(radii[-1][1] - radius_m) < 0.1 * radius_m)

        # Connecting takes wall time, flying takes mission time.
        timeout_s = 20.0 + _ALOFT_TIMEOUT_S / self.speed
        if not await self.until(lambda: self._has_ended or all(map(settled, vehicles)), timeout_s) or self._has_ended:
            states = ", ".join(f"{i}: {self.log.mode(i) or '-'} {self.log.tactic(i) or '-'}" for i in vehicles)
            raise VehicleRefusedError(
                f"the team of the drill did not reach its mission ({states})",
                self._last_output or "check that `cordon fly --sitl` flies it, and the load of this computer",
            )

    async def resume(self, vehicle: int) -> None:
        """Command a vehicle once to resume its mission."""
        with suppress(VehicleRefusedError, TimeoutError):
            await asyncio.wait_for(
                CommandClient(self.mission).command("resume", (vehicle,), vehicle),
                _RESUME_TIMEOUT_S,
            )

    async def _start(self) -> None:
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="cordon-drill-")))
        mission_file, path = folder / "mission.toml", folder / "socket"
        mission_file.write_text(self._text, encoding="utf-8")
        self._write_profiles(folder)
        await self.serve(self._stack)
        self._keys = self._stack.enter_context(flight_keys(self.mission))
        server = await asyncio.start_unix_server(self._under_test.meet, path)
        self._stack.callback(server.close)
        await self._fly(mission_file, path)
        await self._listen()
        watching = asyncio.create_task(self._watch())
        self._stack.push_async_callback(_cancelled, watching)

    def _write_profiles(self, folder: Path) -> None:
        """Write the profiles beside the mission: their names are relative to its folder."""
        for name, text in self.mission.profile_texts.items():
            if name not in bundled_profiles():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_text(text, encoding="utf-8")

    async def _fly(self, mission_file: Path, path: Path) -> None:
        self._process = await asyncio.create_subprocess_exec(
            *(
                sys.executable,
                "-m",
                "gcs.drill.process_under_test",
                str(mission_file),
                f"{self.speed:g}",
                f"{_FLIGHT_S:g}",
            ),
            env={**os.environ, SOCKET: str(path), LOGS: str(self._logs or ""), "TERM": "dumb", "COLUMNS": "200"},
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the drill, which ends its flight itself
        )
        reading = asyncio.create_task(self._read(self._process))
        self._stack.push_async_callback(_cancelled, reading)
        self._stack.push_async_callback(self._end, self._process)

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        assert process.stderr is not None
        async for line in process.stderr:
            self._output = (self._output + line.decode(errors="replace"))[-4000:]

    async def _end(self, process: asyncio.subprocess.Process) -> None:
        """Kill the flying process, which may be stopped; its supervisor then ends by itself."""
        if self._under_test.pid and process.returncode is None:
            with suppress(ProcessLookupError):
                os.kill(self._under_test.pid, 9)
        try:
            await asyncio.wait_for(process.wait(), _END_TIMEOUT_S if self._under_test.pid else 0.0)
        except TimeoutError:
            process.kill()
            await process.wait()

    async def _listen(self) -> None:
        bus = guest_bus(self.mission, self._keys.identity("observer"))
        await bus.open(self._receive, lambda *_: None, lambda *_: None)
        self._stack.push_async_callback(bus.close)

    def _receive(self, message: BusMessage) -> None:
        now_s = self.now_s()
        if isinstance(message, MemberState):
            self.log.note_status(now_s, message.sender, message.tactic, message.alert)
            self.positions_m[message.sender] = (*message.position_m, message.altitude_m)
            if message.angle is not None:
                self.log.radii_m[message.sender].append((now_s, message.angle.radius_m))
                self.log.bearings_rad[message.sender] = (now_s, message.angle.bearing_rad)

    def stalled_s(self, since_s: float) -> float:
        """Return the longest time without an observation of the vehicles, caused by load of this computer [wall s]."""
        return max((gap_s for at_s, gap_s in self._stalls if at_s >= since_s), default=0.0)

    async def _watch(self) -> None:
        observed_s = self.now_s()
        while True:
            now_s = self.now_s()
            if now_s - observed_s > _STALL_S:
                self._stalls.append((now_s, now_s - observed_s))
            observed_s = now_s
            self.observe(now_s)
            await asyncio.sleep(_POLL_S)

    @property
    def _has_ended(self) -> bool:
        return self._process is not None and self._process.returncode is not None

    @property
    def _last_output(self) -> str:
        return self._output.strip()[-600:]


async def _cancelled(task: "asyncio.Task[None]") -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
