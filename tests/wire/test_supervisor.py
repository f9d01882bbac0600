"""The dead-man: a flying process that is killed, stopped or hangs is out of offboard in time; who is orphaned lands.

The vehicles are stubs of this process, on a governed clock, of which all times are.
The controls fly the same process unsupervised: the test holds the other end of the socket pair, and watches nothing.
"""

import asyncio
import os
import re
import signal
import socket
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from math import dist
from pathlib import Path

import pytest

from estimation.frames import Geodetic, Triple
from gcs.drill.flight import ProcessUnderTest
from gcs.drill.process_under_test import SOCKET
from gcs.flight.faults.team_faults import Hang, TeamFaults
from gcs.flight.stubs import stub_configs
from gcs.flight.supervision_protocol import ALIVE, HEARTBEAT_VARIABLE, POLL_PERIOD_S
from gcs.mission.file import load_mission
from sitl.autopilot.modes import NavMode
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.terminals import take_terminal, terminal
from tests.support.wire import PATIENCE_S, Served, hurried, served, until

pytestmark = pytest.mark.wire

FAST = 10.0
OUT_OF_OFFBOARD_MAX_S = 2.0
HOLD_S = 3.0
"""How long a vehicle holds before it comes down when somebody ends its flight."""
LAST_PLACE = re.compile(r"Vehicle (\d) is unaccounted for: last at (\S+), (\S+), height (\S+) m, \d+ s ago")

Fault = signal.Signals | Hang


class Flight:
    """A team in flight: the process that was started, the one that flies, and the vehicles as they truly are."""

    def __init__(self, process: asyncio.subprocess.Process, under_test: ProcessUnderTest, served: Served) -> None:
        self.process = process
        self.clock = served.clock
        self.frame = served.stubs[1].config.frame
        self.under_test = under_test
        self._served = served

    @property
    def flying_pid(self) -> int:
        return self.under_test.pid

    def strike(self, fault: Fault) -> None:
        """Send the flying process a signal, or let it hang by itself."""
        if isinstance(fault, signal.Signals):
            os.kill(self.flying_pid, fault)
        else:
            self.under_test.inject(TeamFaults(hang=fault))

    @property
    def all_in_offboard(self) -> bool:
        return {vehicle.mode for vehicle in self._served.vehicles.values()} == {NavMode.OFFBOARD}

    @property
    def none_in_offboard(self) -> bool:
        return NavMode.OFFBOARD not in {vehicle.mode for vehicle in self._served.vehicles.values()}

    @property
    def all_down(self) -> bool:
        return not self.any_armed

    @property
    def any_armed(self) -> bool:
        return any(vehicle.armed for vehicle in self._served.vehicles.values())

    @property
    def places_m(self) -> dict[int, Triple]:
        """Where the vehicles truly are."""
        return {i: vehicle.airframe.position_m for i, vehicle in self._served.vehicles.items()}

    @property
    def setpoints(self) -> int:
        """How many setpoints the vehicle has received that has received the fewest."""
        return min(stub.setpoints for stub in self._served.stubs.values())

    async def until(self, condition: Callable[[], bool], timeout_s: float, waiting_for: str) -> float:
        """Wait for a condition on the clock, and return the time when it became true."""
        return await until(condition, timeout_s, waiting_for, clock=self.clock)

    async def aloft(self) -> None:
        """Wait until everybody is in offboard; by the wall for a process that starts, for which no clock waits."""
        await until(lambda: self.any_armed, waiting_for="a take-off")
        with hurried(self.clock):
            await self.until(lambda: self.all_in_offboard, 300.0, "everybody in offboard")
            await self.clock.sleep(2.0)

    async def ended(self) -> tuple[int, str]:
        """Wait for the end of both processes; return the exit code of the one started, and what both told."""
        out, err = await asyncio.wait_for(self.process.communicate(), PATIENCE_S)
        assert out == b""
        assert self.process.returncode is not None
        return self.process.returncode, (err or b"").decode()


Fly = Callable[..., Awaitable[Flight]]


@pytest.fixture
async def fly(mission_file: Callable[..., str], tmp_path: Path) -> AsyncIterator[Fly]:
    """Return a starter of a flight of two, supervised or not, on a terminal or not; all of it ends with the test."""
    path = mission_file(
        "case2",
        ('name = "case2"', 'name = "dead-man"'),
        ("separation_m = 3.0", "separation_m = 2.0"),  # they may land together
        LOW,
    )
    with_first_vehicles(path, 2)
    under_test = ProcessUnderTest()
    server = await asyncio.start_unix_server(under_test.accept, tmp_path / "socket")
    environment = {**os.environ, "COLUMNS": "200", SOCKET: str(tmp_path / "socket")}

    async def start(*, supervised: bool = True, terminal: int | None = None) -> Flight:
        command = (sys.executable, "-m", "gcs.drill.process_under_test", path, "300", number, str(FAST))
        fds: list[int] = []
        variables = {**environment, "TERM": "dumb" if terminal is None else "xterm"}
        if not supervised:
            heartbeat = await stack.enter_async_context(_careless())
            fds, variables[HEARTBEAT_VARIABLE] = [heartbeat], str(heartbeat)
        process = await asyncio.create_subprocess_exec(
            *command,
            env=variables,
            stdin=terminal,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE if terminal is None else terminal,
            pass_fds=fds,
            start_new_session=True,
            preexec_fn=None if terminal is None else take_terminal,
        )
        flight = Flight(process, under_test, stubs)
        stack.push_async_callback(_end, flight)
        return flight

    async with served(stub_configs(load_mission(path)), FAST) as stubs, AsyncExitStack() as stack:
        number = str(stubs.clock.name.number)
        yield start
    server.close()


async def _end(flight: Flight) -> None:
    if flight.process.returncode is None:
        flight.process.kill()
    if flight.flying_pid:
        with suppress(ProcessLookupError):
            os.kill(flight.flying_pid, signal.SIGKILL)
    await flight.process.communicate()


@asynccontextmanager
async def _careless() -> AsyncIterator[int]:
    """Be a supervisor that is there and does nothing: yields the flying process's end of the socket pair."""
    ours, theirs = socket.socketpair()
    ours.setblocking(False)

    async def live() -> None:
        while True:
            with suppress(OSError):
                ours.send(ALIVE)
            with suppress(OSError):
                ours.recv(1 << 20)
            await asyncio.sleep(POLL_PERIOD_S)

    living = asyncio.create_task(live())
    with ours, theirs:
        yield theirs.fileno()
        living.cancel()


# What happens to the flying process


@pytest.mark.long
async def test_one_that_hangs_before_a_vehicle_flies_is_ended_by_ctrl_c(fly: Fly) -> None:
    flight = await fly()
    await until(lambda: flight.flying_pid > 0, waiting_for="the flying process")  # it does not hold the clock yet
    flight.strike(signal.SIGSTOP)
    flight.clock.set_speed(1.0)  # the stubs' time goes on
    assert not flight.any_armed
    flight.process.send_signal(signal.SIGINT)
    code, said = await flight.ended()
    assert code == 3, said
    assert f"the flying process {flight.flying_pid} was killed: it had not ended within 20 s" in said


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("exit", "ended with exit code 0 before its vehicles had landed"),
        (signal.SIGSTOP, "no tick of the control loop of vehicle "),
    ],
    ids=["exited", "stopped"],
)
async def test_who_flies_no_more_is_out_of_offboard_in_time(fault: Fault, reason: str, fly: Fly) -> None:
    flight = await fly()
    await flight.aloft()
    flight.clock.set_speed(1.0)
    await flight.clock.sleep(1.0)  # positions are reported by the wall's clock
    flight.clock.set_speed(FAST)
    pid, began_s, places_m = flight.flying_pid, flight.clock.now_s(), flight.places_m
    flight.strike(fault)
    out_s = await flight.until(lambda: flight.none_in_offboard, 5.0, "everybody out of offboard")
    code, told = await flight.ended()
    print(f"MEASURED {fault}: out of offboard after {out_s - began_s:.2f} s")
    assert out_s - began_s <= OUT_OF_OFFBOARD_MAX_S
    assert code == 4
    assert f"{pid}" in told
    assert reason in told
    if fault is signal.SIGSTOP:  # ticks are spread over the period: of one vehicle first, or of several at once
        assert re.search(r"vehicle [12] for 0\.6 s", told)
    assert "vehicles 1 and 2, unaccounted for: only their autopilots control them now" in told
    assert "next: " in told
    for vehicle, *where in LAST_PLACE.findall(told):
        latitude_deg, longitude_deg, height_m = map(float, where)
        x, y, _ = flight.frame.mission_from_geodetic(Geodetic(latitude_deg, longitude_deg, 488.0))
        assert dist((x, y, height_m), places_m.pop(int(vehicle))) < 1.0, told
    assert not places_m, told
    with pytest.raises(ProcessLookupError):  # a stopped process would fly on once it is continued
        os.kill(pid, signal.SIGCONT)


async def test_control_unsupervised_a_team_stays_in_offboard_or_returns_to_it(
    fly: Fly, subtests: pytest.Subtests
) -> None:
    flight = await fly(supervised=False)
    await flight.aloft()
    flight.clock.set_speed(0.7)  # MAVSDK repeats the last setpoint by the wall's clock
    with subtests.test("event loop blocked"):
        flight.strike("event loop")
        await flight.clock.sleep(0.5)
        before = flight.setpoints
        await flight.clock.sleep(OUT_OF_OFFBOARD_MAX_S)
        assert flight.all_in_offboard
        await until(lambda: flight.setpoints - before > 10, waiting_for="MAVSDK's repetitions")
    flight.clock.set_speed(FAST)
    with subtests.test("stopped"):
        flight.strike(signal.SIGSTOP)
        await flight.until(lambda: flight.none_in_offboard, 60.0, "everybody out of offboard")
        os.kill(flight.flying_pid, signal.SIGCONT)
        await flight.until(lambda: flight.all_in_offboard, 60.0, "everybody back in offboard")


# What happens to its supervisor


async def test_who_is_orphaned_holds_and_lands(fly: Fly) -> None:
    flight = await fly()
    await flight.aloft()
    await flight.clock.sleep(1.5 * HOLD_S)
    assert flight.all_in_offboard, "the control: a supervisor that lives ends nothing"
    began_s = flight.clock.now_s()
    os.kill(flight.process.pid, signal.SIGSTOP)
    out_s = await flight.until(lambda: flight.none_in_offboard, 15.0, "everybody out of offboard")
    assert out_s - began_s >= HOLD_S, "they hold first"
    await flight.until(lambda: flight.all_down, 30.0, "everybody down")
    flight.process.send_signal(signal.SIGCONT)
    code, told = await flight.ended()
    assert code == 4
    assert "supervisor process has ended: the vehicles hold, then land" in told


# Ctrl-C


async def test_ctrl_c_on_a_terminal_counts_once_and_ctrl_z_stops_nothing(fly: Fly) -> None:
    with terminal() as (here, there, shown):
        flight = await fly(terminal=there)
        await flight.aloft()
        os.write(here, b"\x1a")
        await flight.clock.sleep(3.0)
        assert flight.all_in_offboard, "stopped by the terminal"
        await until(lambda: "offboard" in shown.decode(errors="replace"), waiting_for="the live view")
        began_s = flight.clock.now_s()
        os.write(here, b"\x03")
        out_s = await flight.until(lambda: flight.none_in_offboard, 10.0, "everybody out of offboard")
        assert out_s - began_s >= HOLD_S, "they hold first: in a hurry they would not"
        code, _ = await flight.ended()
    text = shown.decode(errors="replace")
    assert code == 4, text
    assert flight.all_down, text
    assert "holding, then landing; Ctrl-C again: land at once" in text
    assert text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l"), "the cursor is there again"


async def test_a_killed_process_leaves_no_vehicle_in_offboard_nor_on_its_terminal(
    fly: Fly,
) -> None:
    with terminal() as (_, there, shown):
        flight = await fly(terminal=there)
        await flight.aloft()
        await until(lambda: b"offboard" in shown, waiting_for="the live view")
        began_s = flight.clock.now_s()
        flight.strike(signal.SIGKILL)
        out_s = await flight.until(lambda: flight.none_in_offboard, 5.0, "everybody out of offboard")
        code, _ = await flight.ended()
        await until(lambda: b"next: " in shown, waiting_for="the supervisor's words")
    assert out_s - began_s <= OUT_OF_OFFBOARD_MAX_S
    assert code == 4
    text = shown.decode(errors="replace")
    erased = text.rindex("\x1b8\x1b[J")
    assert "\x1b7" in text[: text.rindex("dead-man")][-20:], "each table marks where it begins"
    assert "offboard" in text[:erased]
    assert "ended by signal 9 before its vehicles had landed" in text[erased:]
    assert text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l"), "the cursor is there again"
    assert text.rindex("\x1b[?2004l") > text.rindex("\x1b[?2004h"), "pasted text is not marked any more"
    assert "leaves offboard" in text[erased:]
    assert not re.search(r"offboard +\d", text[erased:])


async def test_a_signal_to_the_supervisor_counts_and_a_second_one_means_at_once(fly: Fly) -> None:
    flight = await fly()
    await flight.aloft()
    began_s = flight.clock.now_s()
    flight.process.send_signal(signal.SIGINT)
    await flight.clock.sleep(0.5)
    flight.process.send_signal(signal.SIGTERM)
    out_s = await flight.until(lambda: flight.none_in_offboard, 10.0, "everybody out of offboard")
    assert out_s - began_s < HOLD_S - 0.5
    code, told = await flight.ended()
    assert code == 4
    assert flight.all_down
    assert "the operator ended the flight" in told
    assert "supervisor" not in told
