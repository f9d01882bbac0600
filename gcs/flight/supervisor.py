"""`cordon fly` from outside: flies in a process of its own, and ends that process when a control loop falls silent.

MAVSDK repeats the last setpoint from a thread of its own: a vehicle whose control loop hangs stays in offboard for as
long as the process lives. With the process gone the autopilot's own failsafe has the vehicle. This process does nothing
but watch, and pass on the operator's signals; it stays light. When it dies itself, the vehicles land.
"""

import os
import signal
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from contextlib import suppress

from gcs.errors import Exit
from gcs.flight.supervision import (
    ALIVE,
    LIFELINE,
    POLL_PERIOD_S,
    STOP,
    Vigil,
)
from gcs.signals import relay

Tell = Callable[[str], object]

_FROM_HERE_ON = (
    "their autopilots are on their own now: PX4 leaves offboard about 1 s after the last setpoint and does what"
    " COM_OBL_RC_ACT says, hold or land; ArduPilot stays at its last setpoint until its FS_GCS_ENABLE acts"
)
_NEXT_STEP = (
    "next: watch them, and take them over by remote control or a ground station; nothing else will come back to them"
)
_BELOW_THE_LIVE_VIEW = "\x1b[?25h\n"
"""Shows the cursor, which the live view hides, and leaves its last line."""


def is_supervised() -> bool:
    """Return whether this process is the flying one."""
    return LIFELINE in os.environ


def supervise(tell: Tell) -> int:
    """Run this process's command line once more as the flying process; return the exit code of the whole.

    Signals must be held back already. What goes wrong is told, a line each.
    """
    for number in (signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU):
        signal.signal(number, signal.SIG_IGN)  # a terminal must not stop what flies: Ctrl-Z is no way to hold
    terminal = _Terminal()
    ours, theirs = socket.socketpair()
    with ours:
        ours.setblocking(False)
        with theirs:
            flying = _start(theirs.fileno())
        relay(lambda: _say(ours, STOP))
        vigil = Vigil()
        silences_s = _watch(flying, ours, vigil)
        code = flying.wait()
        vigil.hear(_heard(ours))
    lines = _told(flying.pid, code, silences_s, vigil)
    if not lines:
        return code
    for line in (*terminal.restored(), *lines):
        tell(line)
    return Exit.ENDED_IN_FLIGHT if vigil.has_flown else Exit.REFUSED


def _start(heartbeat: int) -> subprocess.Popen[bytes]:
    """Start the flying process: the same command line in the same interpreter, with a lifeline."""
    return subprocess.Popen(
        [sys.executable, *sys.orig_argv[1:]], pass_fds=[heartbeat], env={**os.environ, LIFELINE: str(heartbeat)}
    )


def _watch(flying: subprocess.Popen[bytes], connection: socket.socket, vigil: Vigil) -> dict[int, float]:
    """Watch until the process ends; kill it when a loop is dead. Return the silences that were its reason [s]."""
    while flying.poll() is None:
        time.sleep(POLL_PERIOD_S)
        _say(connection, ALIVE)
        vigil.hear(_heard(connection))
        if silences_s := vigil.poll():
            flying.kill()
            return silences_s
    return {}


def _say(connection: socket.socket, words: bytes) -> None:
    with suppress(OSError):  # it has ended, or hangs and reads no more
        connection.send(words)


def _heard(connection: socket.socket) -> bytes:
    """Return all that has arrived."""
    heard = b""
    with suppress(OSError):
        while data := connection.recv(65536):
            heard += data
    return heard


def _told(process_id: int, code: int, silences_s: dict[int, float], vigil: Vigil) -> list[str]:
    """Return what to tell of a flight that did not end by itself in the way it should."""
    ended = f"by signal {-code}" if code < 0 else f"with exit code {code}"
    if silences_s:
        loops = ", ".join(f"vehicle {i} for {silence_s:.1f} s" for i, silence_s in silences_s.items())
        reason = f"no tick of the control loop of {loops}: the flying process {process_id} was killed"
    elif vigil.flying:
        reason = f"the flying process {process_id} ended {ended} before its vehicles had come down"
    elif code < 0:
        return [f"the flying process {process_id} ended {ended} while no vehicle flew"]
    else:
        return []
    flying = ", ".join(map(str, vigil.flying))
    return [reason, f"vehicle {flying}: {_FROM_HERE_ON}" if flying else _FROM_HERE_ON, _NEXT_STEP]


class _Terminal:
    """The terminal as it was before the flight: a process that is killed may leave it without cursor or echo."""

    def __init__(self) -> None:
        self._attributes = termios.tcgetattr(sys.stdin) if sys.stdin.isatty() else None

    def restored(self) -> list[str]:
        """Bring it back, and return what is to be written to it for that."""
        if self._attributes is not None:
            with suppress(termios.error):  # it is gone
                termios.tcsetattr(sys.stdin, termios.TCSANOW, self._attributes)
        return [_BELOW_THE_LIVE_VIEW] if sys.stderr.isatty() else []
