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
import time
from contextlib import suppress
from dataclasses import asdict

from gcs.errors import Exit
from gcs.flight.supervision.protocol import ALIVE, HEARTBEAT_VARIABLE, POLL_PERIOD_S, STOP, LoopMonitor
from gcs.metrics.ending import FlightEnding, How
from gcs.metrics.json_output import json_output
from gcs.preflight.computer.priority import raise_supervisor
from gcs.signals import relay

OVERLOAD = 1.5
"""The load average per core from which a computer counts as overloaded."""
_CONSEQUENCE = (
    "only their autopilots control them now: PX4 leaves offboard about 1 s after the last setpoint, then holds or lands"
    " (COM_OBL_RC_ACT); ArduPilot stays at its last setpoint until its ground station failsafe acts (FS_GCS_ENABLE)"
)
_NEXT_STEP = "next: watch them, and take over by remote control or a ground station; cordon does not reconnect to them"
_HERE = "\x1b7"
_NO_LIVE_VIEW = "\x1b[?25h\x1b[?2004l"
"""Shows the cursor, which the live view hides, and ends the marking of pasted text."""
_ERASED = "\x1b8\x1b[J"
"""Erases the live view, which shows vehicles in flight, from its beginning, or from _HERE if none was drawn."""


def is_supervised() -> bool:
    """Return whether this process is the flying one."""
    return HEARTBEAT_VARIABLE in os.environ


def supervise(*, json: bool = False) -> int:
    """Run this process's command line once more as the flying process; return the exit code of the whole.

    Signals must be blocked already. Problems are written to standard error; with `json`, the ending of a flight
    whose process was killed is written to standard output.
    """
    for number in (signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU):
        signal.signal(number, signal.SIG_IGN)  # a terminal must not stop a flight: Ctrl-Z does not make it hold
    terminal = _Terminal()
    ours, theirs = socket.socketpair()
    with ours:
        ours.setblocking(False)
        with theirs:
            flying = _start(theirs.fileno())
        raise_supervisor()
        relay(lambda: _send(ours, STOP))
        monitor = LoopMonitor()
        silences_s = _watch(flying, ours, monitor)
        code = flying.wait()
        monitor.receive(_received(ours))
    lines = _report(flying.pid, code, silences_s, monitor)
    if not lines:
        return code
    if json and code < 0 and monitor.flying:
        with suppress(OSError):
            os.write(sys.stdout.fileno(), f"{json_output({'ended': asdict(_ending(monitor, lines[1]))})}\n".encode())
    for line in (*terminal.restored(killed=code < 0), *lines):
        with suppress(OSError):  # the terminal may be gone
            os.write(sys.stderr.fileno(), f"{line}\n".encode())
    return Exit.ENDED_IN_FLIGHT if monitor.has_flown else Exit.REFUSED


def _start(heartbeat: int) -> subprocess.Popen[bytes]:
    """Start the flying process: the same command line in the same interpreter, with its end of the socket pair."""
    environment = {**os.environ, HEARTBEAT_VARIABLE: str(heartbeat)}
    return subprocess.Popen([sys.executable, *sys.orig_argv[1:]], pass_fds=[heartbeat], env=environment)


def _watch(flying: subprocess.Popen[bytes], connection: socket.socket, monitor: LoopMonitor) -> dict[int, float]:
    """Watch until the process ends; kill it when a loop is dead. Return the silences that were the reason [s]."""
    while flying.poll() is None:
        time.sleep(POLL_PERIOD_S)
        _send(connection, ALIVE)
        monitor.receive(_received(connection))
        if silences_s := monitor.poll():
            flying.kill()
            return silences_s
    return {}


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


def _report(process_id: int, code: int, silences_s: dict[int, float], monitor: LoopMonitor) -> list[str]:
    """Return lines about a flight whose process did not end normally, otherwise none."""
    ended = f"by signal {-code}" if code < 0 else f"with exit code {code}"
    if silences_s:
        loops = ", ".join(f"vehicle {i} for {silence_s:.1f} s" for i, silence_s in silences_s.items())
        reason = f"no tick of the control loop of {loops}: the flying process {process_id} was killed"
    elif monitor.flying:
        reason = f"the flying process {process_id} ended {ended} before its vehicles had landed"
    elif code < 0:
        return [f"the flying process {process_id} ended {ended} while no vehicle flew"]
    else:
        return []
    flying = ", ".join(map(str, monitor.flying))
    reason += overload(os.getloadavg()[0], os.cpu_count() or 1)
    return [
        _ending(monitor, reason).headline,
        reason,
        f"vehicle {flying}: {_CONSEQUENCE}" if flying else _CONSEQUENCE,
        _NEXT_STEP,
    ]


def _ending(monitor: LoopMonitor, reason: str) -> FlightEnding:
    return FlightEnding(How.WATCHDOG, f"{reason[:1].upper()}{reason[1:]}.", monitor.flying)


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
