"""The supervisor of a flight: runs it in a second process, and kills that process when a control loop stops ticking.

MAVSDK repeats the last setpoint from a thread of its own: a vehicle whose control loop hangs stays in offboard for as
long as the process lives. Once the process is gone, the autopilot's own failsafe acts. The supervisor only watches and
passes on the operator's signals, and imports nothing heavy. When the supervisor dies, the vehicles land.
"""

import os
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from math import inf
from typing import Protocol

from agents.flight_end import FlightEnd
from gcs.errors import Exit
from gcs.flight.supervision_protocol import ALIVE, HEARTBEAT_VARIABLE, JOINED, POLL_PERIOD_S, STOP, LoopMonitor
from gcs.metrics.ending import RECOVERY, SEARCH, UNACCOUNTED, LostFlight, TeamEnding, named, watch_them
from gcs.metrics.json_output import json_output
from gcs.preflight.priority import raise_supervisor
from gcs.signals import relay
from sitl.server.shared_clock import US_PER_S, ClockError, ClockName, Rank, Seat

ENDS_WITHIN_S = 0.2
"""A process whose loops are silent because it has been killed takes a while to end."""
HEEDS_WITHIN_S = 20.0
"""Wall time in which a flying process ends, once the operator asks for it while no vehicle flies."""
OVERLOAD = 1.5
"""The load average per core from which a computer counts as overloaded."""
_HERE = "\x1b7"
_NO_LIVE_VIEW = "\x1b[?25h\x1b[?2004l"
"""Shows the cursor, which the live view hides, and ends the marking of pasted text."""
_ERASED = "\x1b8\x1b[J"
"""Erases the live view, which shows vehicles in flight, from its beginning, or from _HERE if none was drawn."""


class FlightPage(Protocol):
    """The operator's page beside a flight."""

    @property
    def kept_open(self) -> Sequence[int]:
        """File descriptors that the flying process inherits, and holds as long as it lives."""

    def lose(self, flight: LostFlight) -> None:
        """Show that the flying process has ended before its vehicles had landed."""

    def interrupt(self) -> None:
        """Take a signal of the operator; called on another thread."""


class _Nothing:
    """Implements `FlightPage` for a flight without a page."""

    kept_open = ()

    def lose(self, flight: LostFlight) -> None:
        pass

    def interrupt(self) -> None:
        pass


_NOTHING = _Nothing()


def is_supervised() -> bool:
    """Return whether this process is the flying one."""
    return HEARTBEAT_VARIABLE in os.environ


def supervise(*, json: bool = False, page: FlightPage = _NOTHING, recovery: str = RECOVERY) -> int:
    """Run this process's command line once more as the flying process; return the exit code of the whole.

    Signals must be blocked already. Problems are written to standard error; with `json`, the ending of a flight
    whose process was killed is written to standard output. `recovery` is the command that brings its vehicles home
    then.
    """
    for number in (signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU):
        signal.signal(number, signal.SIG_IGN)  # a terminal must not stop a flight: Ctrl-Z does not make it hold
    terminal = _Terminal()
    ours, theirs = socket.socketpair()
    with ours:
        ours.setblocking(False)
        with theirs:
            flying = _start(theirs.fileno(), page.kept_open)
        raise_supervisor()

        end_request = _EndRequest()

        def request() -> None:
            _send(ours, STOP)
            end_request.make()
            page.interrupt()

        relay(request)
        monitor = LoopMonitor()
        silences_s = _watch(flying, ours, monitor, end_request)
        code = flying.wait()
        monitor.receive(_received(ours))
    lines, lost = _report(flying.pid, code, silences_s, monitor, end_request, recovery)
    if not lines:
        if monitor.unaccounted:
            page.lose(_over(monitor.unaccounted))
        return code
    if lost is not None:
        page.lose(lost)
        if json and code < 0 and lost.vehicles:
            _write(sys.stdout.fileno(), json_output({"ended": asdict(_ending(lost, monitor))}))
    for line in (*terminal.restored(killed=code < 0), *lines):
        _write(sys.stderr.fileno(), line)
    return Exit.ENDED_IN_FLIGHT if monitor.has_flown else Exit.REFUSED


def _start(heartbeat: int, kept_open: Sequence[int]) -> subprocess.Popen[bytes]:
    """Start the flying process: the same command line in the same interpreter, with its end of the socket pair."""
    environment = {**os.environ, HEARTBEAT_VARIABLE: str(heartbeat)}
    return subprocess.Popen([sys.executable, *sys.orig_argv[1:]], pass_fds=[heartbeat, *kept_open], env=environment)


class _EndRequest:
    """The operator's request to end, made while no vehicle flies. A request in flight is for the control loops."""

    def __init__(self) -> None:
        self._made = threading.Event()
        self._due_s = inf
        self.is_overdue = False

    def make(self) -> None:
        """Make it; called on another thread."""
        self._made.set()

    def poll(self, *, flying: bool) -> bool:
        """Return whether the process has not heeded it in time."""
        if flying:
            self._made.clear()
        if not self._made.is_set():
            self._due_s = inf
        else:
            self._due_s = min(self._due_s, time.monotonic() + HEEDS_WITHIN_S)
        self.is_overdue = time.monotonic() >= self._due_s
        return self.is_overdue


def _watch(
    flying: subprocess.Popen[bytes], connection: socket.socket, monitor: LoopMonitor, end_request: _EndRequest
) -> dict[int, float]:
    """Watch until the process ends; kill it when a loop is dead, or when it does not heed a request to end.

    Return the silences of loops that were the reason [s].
    """
    pace = _PollPace()
    try:
        while flying.poll() is None:
            if pace.follow(monitor.clock):
                _send(connection, JOINED)
            pace.wait()
            _send(connection, ALIVE)
            monitor.receive(_received(connection))
            if silences_s := monitor.poll():
                try:
                    flying.wait(ENDS_WITHIN_S)  # they may be silent because it ends
                except subprocess.TimeoutExpired:
                    flying.kill()
                    return silences_s
            if end_request.poll(flying=bool(monitor.flying)):
                flying.kill()
                return {}
        return {}
    finally:
        pace.leave_clock()


class _PollPace:
    """Waits from one poll to the next: by the wall's clock, or on the governed clock of a flight of stubs."""

    def __init__(self) -> None:
        self._number: int | None = None
        self._seat: Seat | None = None

    def follow(self, clock: int | None) -> bool:
        """Wait on the clock of this number from now on, None for the wall's; return whether it was joined now."""
        if clock == self._number:
            return False
        self.leave_clock()
        self._number = clock
        with suppress(ClockError):  # without such a clock, by the wall's
            self._seat = None if clock is None else Seat(ClockName(clock), Rank.SUPERVISOR)
        return self._seat is not None

    def wait(self) -> None:
        if self._seat is None:
            time.sleep(POLL_PERIOD_S)
        elif not self._seat.wait_until(self._seat.now_us + round(POLL_PERIOD_S * US_PER_S)):
            self.leave_clock()  # nothing moves it any more: by the wall's from now on

    def leave_clock(self) -> None:
        if self._seat is not None:
            self._seat.leave()
        self._seat = None


def _send(connection: socket.socket, data: bytes) -> None:
    with suppress(OSError):  # the flying process has ended, or hangs and no longer reads
        connection.send(data)


def _received(connection: socket.socket) -> bytes:
    """Return all that has arrived."""
    received = b""
    with suppress(OSError):
        while data := connection.recv(65536):
            received += data
    return received


def _write(descriptor: int, line: str) -> None:
    with suppress(OSError):  # the terminal may be gone
        os.write(descriptor, f"{line}\n".encode())


def _report(
    process_id: int,
    code: int,
    silences_s: dict[int, float],
    monitor: LoopMonitor,
    end_request: _EndRequest,
    recovery: str = RECOVERY,
) -> tuple[list[str], LostFlight | None]:
    """Return lines about a flight whose process did not end normally, otherwise none; and the flight if it is lost."""
    ended = f"by signal {-code}" if code < 0 else f"with exit code {code}"
    if silences_s:
        loops = ", ".join(f"vehicle {i} for {silence_s:.1f} s" for i, silence_s in silences_s.items())
        reason = f"no tick of the control loop of {loops}: the flying process {process_id} was killed"
    elif monitor.flying or (monitor.unaccounted and code < 0):
        reason = f"the flying process {process_id} ended {ended} before its vehicles had landed"
    elif end_request.is_overdue:
        return [f"the flying process {process_id} was killed: it had not ended within {HEEDS_WITHIN_S:g} s"], None
    else:
        return [f"the flying process {process_id} ended {ended} while no vehicle flew"] if code < 0 else [], None
    reason += overload(os.getloadavg()[0], os.cpu_count() or 1)
    vehicles = tuple(sorted({*monitor.flying, *monitor.unaccounted}))
    lost = LostFlight(reason, vehicles, time.time(), next_step=watch_them(recovery))
    ending = _ending(lost, monitor)
    places = [each.line for each in ending.unaccounted]
    flying = f"{named(vehicles)}, {UNACCOUNTED}: " if vehicles else ""
    headline = ending.headline if silences_s else f"Ended {ended}: {named(vehicles)}"
    return [*places, headline, reason, f"{flying}{lost.autopilots}", f"next: {lost.next_step}"], lost


def _over(unaccounted: tuple[int, ...]) -> LostFlight:
    """Return a flight that is over, with vehicles that are unaccounted for, as the page shows it."""
    return LostFlight("the flight is over", unaccounted, time.time(), "", SEARCH)


def _ending(lost: LostFlight, monitor: LoopMonitor) -> TeamEnding:
    reason = f"{lost.reason[:1].upper()}{lost.reason[1:]}."
    return TeamEnding(FlightEnd.WATCHDOG, reason, lost.vehicles, monitor.last_seen(lost.vehicles, time.monotonic()))


def overload(load: float, cores: int) -> str:
    """Return a clause about an overloaded computer, by its load average over a minute; empty if it was not."""
    if load <= OVERLOAD * cores:
        return ""
    return f"; this computer was overloaded (load {load:.1f} on {cores} cores): fly slower, or close other programs"


class _Terminal:
    """The terminal's state before the flight: a killed process may leave it without cursor or echo."""

    def __init__(self) -> None:
        self._attributes = termios.tcgetattr(sys.stdin) if sys.stdin.isatty() else None
        self._shows = sys.stderr.isatty()
        if self._shows:
            with suppress(OSError):
                os.write(sys.stderr.fileno(), _HERE.encode())

    def restored(self, killed: bool) -> list[str]:
        """Restore its attributes, and return what to write to it; the live view of a killed process is erased.

        A process that ended by itself has marked the vehicles' last state as such.
        """
        if self._attributes is not None:
            with suppress(termios.error):  # it is gone
                termios.tcsetattr(sys.stdin, termios.TCSANOW, self._attributes)
        if not self._shows:
            return []
        return [_NO_LIVE_VIEW + (_ERASED if killed else "")]
