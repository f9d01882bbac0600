"""A team in flight for a drill: its flying process, its messages, and its vehicles' states."""

import asyncio
import os
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from math import inf
from pathlib import Path
from typing import Self

import msgspec

from agents.ports import VehicleRefusedError
from agents.shell.clock import MissionClock, WallClock
from agents.tactics import Tactic
from agents.team.messages import BusMessage, MemberState, VehicleReport
from estimation.frames import Triple
from estimation.profile.profile import bundled_profiles
from gcs.console.command_client import CommandClient
from gcs.console.team_bus import guest_bus
from gcs.drill.faults import Roles
from gcs.drill.judge import OFFBOARD, TeamLog
from gcs.drill.process_under_test import LOGS, SOCKET
from gcs.flight.faults.catalogue import required_fault
from gcs.flight.faults.team_faults import Injection, TeamFaults, TeamInFlight, UnauthorisedClient
from gcs.keys.team_keys import NoKeys, TeamKeys, flight_keys
from gcs.mission.file import parse_mission
from sitl.server.one_core import OneCore

_POLL_S = 0.02
_BEGUN_TIMEOUT_S = 300.0
"""Wall time: starting a process and connecting it to the vehicles takes none of theirs."""
_ALOFT_TIMEOUT_S = 300.0
"""Time of the team's clock, once the flight has begun."""
_TAKEN_WITHIN_S = 1.0
"""Wall time: a stopped process takes none."""
_END_TIMEOUT_S = 10.0
_RESUME_TIMEOUT_S = 6.0
_FLIGHT_S = 3600.0


class ProcessUnderTest:
    """The flying process: its id, 0 until it has connected, and the connection that faults are sent through."""

    def __init__(self) -> None:
        self.pid = 0
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._untaken = 0

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Accept its connection, as a server's callback."""
        self.pid = int(await reader.readline())
        self._reader, self._writer = reader, writer

    def inject(self, faults: TeamFaults) -> None:
        """Set its present faults."""
        if self._writer is not None:
            self._writer.write(msgspec.json.encode(faults) + b"\n")
            self._untaken += 1

    async def taken(self) -> None:
        """Wait until it has taken all faults, or has ended, at most `_TAKEN_WITHIN_S`."""
        with suppress(TimeoutError, OSError):
            async with asyncio.timeout(_TAKEN_WITHIN_S):
                while self._untaken and self._reader is not None and await self._reader.readline():
                    self._untaken -= 1
        self._untaken = 0


class DrillFlight:
    """One flight, as a context manager: processes and vehicles end with it.

    A subclass defines the vehicles: it runs them, observes them, and clears the faults injected into them.
    """

    def __init__(
        self, text: str, speed: float, logs: Path | None = None, profile_texts: Mapping[str, str] | None = None
    ) -> None:
        """Take the texts of a mission and its profiles; the flight is recorded to the folder `logs`, if given."""
        self.mission = parse_mission(text, None, profile_texts)
        self.log = TeamLog(self.mission.gaps)
        self.speed = speed
        self.clock: MissionClock = WallClock(speed)
        """The team's clock, of which all times in the log are."""
        self.positions_m: dict[int, Triple] = {}
        self._text = text
        self._logs = logs
        self._under_test = ProcessUnderTest()
        self._stack = AsyncExitStack()
        self._process: asyncio.subprocess.Process | None = None
        self._output = ""
        self._keys: TeamKeys = NoKeys()
        self._unauthorised_client: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        """Start it; raises VehicleRefusedError."""
        try:
            await self._start()
        except BaseException:
            await self._stack.aclose()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        """End the processes first, then the vehicles."""
        await self._stack.aclose()

    def now_s(self) -> float:
        """Return the time of the log."""
        return self.clock.now_s()

    def fail(self, fault: str, roles: Roles) -> None:
        """Inject a fault of the catalogue; subclasses inject those of vehicles."""
        self._inject(required_fault(fault).inject(self._scene(roles)))

    async def faults_taken(self) -> None:
        """Wait until the flying process has taken the faults, while its time stands still."""
        with self.clock.held():
            await self._under_test.taken()

    def _scene(self, roles: Roles) -> TeamInFlight:
        return TeamInFlight(roles.mission, roles.subject, roles.airborne, self.places_m())

    def places_m(self) -> Mapping[int, Triple]:
        """Return the vehicles' reported positions [m]."""
        return self.positions_m

    def _inject(self, injection: Injection) -> None:
        if injection.signal is not None:
            os.kill(self._under_test.pid, injection.signal)
        if injection.unauthorised_client:
            self._start_unauthorised_client()
        self._under_test.inject(injection.team)

    async def serve(self, stack: AsyncExitStack) -> None:
        """Start the vehicles, to be ended with the stack; raises VehicleRefusedError."""
        raise NotImplementedError

    def observe(self, now_s: float) -> None:
        """Record the vehicles' present states."""
        raise NotImplementedError

    def clear_faults(self) -> None:
        """Clear all faults that can be cleared."""
        self._under_test.inject(TeamFaults())
        if self._unauthorised_client is not None:
            self._unauthorised_client.cancel()
            self._unauthorised_client = None

    def _start_unauthorised_client(self) -> None:
        """Send forged messages and commands in the vehicles' names, until the faults are cleared."""
        self._unauthorised_client = asyncio.create_task(UnauthorisedClient(self.mission, self.clock).run())
        self._stack.push_async_callback(_cancelled, self._unauthorised_client)

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition; return whether it became true."""
        end_s = self.now_s() + timeout_s
        while not condition():
            if self.now_s() > end_s:
                return False
            await self.clock.sleep(_POLL_S)
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
            return tactics(vehicle) != Tactic.ENCIRCLE.value or (
                bool(radii) and abs(radii[-1][1] - radius_m) < 0.1 * radius_m
            )

        with suppress(TimeoutError):
            async with asyncio.timeout(_BEGUN_TIMEOUT_S):
                await self.until(lambda: self._has_ended or self.has_begun, inf)
        await self.until(lambda: self._has_ended or all(map(settled, vehicles)), _ALOFT_TIMEOUT_S)
        if self._has_ended or not all(map(settled, vehicles)):
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
        server = await asyncio.start_unix_server(self._under_test.accept, path)
        self._stack.callback(server.close)
        await self._fly(mission_file, path)
        self._stack.enter_context(OneCore())  # the flying process does not inherit it, but has its own
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
                f"{_FLIGHT_S:g}",
                *self.clock_arguments(),
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

    def clock_arguments(self) -> tuple[str, ...]:
        """Return the number of the governed clock that the flying process joins and its speed, if there is one."""
        return ()

    @property
    def has_begun(self) -> bool:
        """Return whether the flight has begun: its process has connected or, where that is known, its mission."""
        return self._under_test.pid > 0

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
            with suppress(ProcessLookupError):  # it has just ended
                process.kill()
            await process.wait()

    async def _listen(self) -> None:
        bus = guest_bus(self.mission, self._keys.identity("observer"), self.clock)
        await bus.open(self._receive, lambda *_: None, lambda *_: None)
        self._stack.push_async_callback(bus.close)

    def _receive(self, message: BusMessage) -> None:
        if isinstance(message, VehicleReport) and message.unaccounted_m is not None:
            self.log.unaccounted_s.setdefault(message.sender, message.time_s)
        if isinstance(message, MemberState):
            now_s = message.time_s
            self.log.note_status(now_s, message.sender, message.tactic, message.alert)
            self.positions_m[message.sender] = (*message.position_m, message.altitude_m)
            if message.angle is not None:
                self.log.radii_m[message.sender].append((now_s, message.angle.radius_m))
                self.log.bearings_rad[message.sender] = (now_s, message.angle.bearing_rad)

    async def _watch(self) -> None:
        while True:
            self.observe(self.now_s())
            await self.clock.sleep(_POLL_S)

    @property
    def _has_ended(self) -> bool:
        return self._process is not None and self._process.returncode is not None

    @property
    def _last_output(self) -> str:
        return self._output.strip()[-600:]


async def _cancelled(task: "asyncio.Task[None]") -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
