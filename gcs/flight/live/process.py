"""The program's handle on the flying process that it started (gcs.flight.live_program.py).

It is supervised as that of `cordon fly` is, in a session of its own: a signal to the program's terminal does not reach
it. When the program ends, however that happens, the vehicles hold, then land.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe
from pathlib import Path

from gcs.flight.live.exchange import END, PROGRAM_VARIABLE, Asked, LiveRequest, Message
from gcs.flight.supervision_protocol import HEARTBEAT_VARIABLE

_PROGRAM = "gcs.flight.live_program"


class FlyingProcess:
    """A flying process. Its messages and, at last, None for its end are passed to `on_message` on another thread."""

    def __init__(self, request: LiveRequest, on_message: Callable[[Message | None], None]) -> None:
        self._connection, theirs = Pipe()
        # The path of the program's own modules, too; Python ignores what is no text there.
        path = os.pathsep.join(str(each) or str(Path.cwd()) for each in sys.path)
        # A table and keys on the program's terminal are not wanted: "dumb" makes them lines of text.
        environment = {**os.environ, PROGRAM_VARIABLE: str(theirs.fileno()), "PYTHONPATH": path, "TERM": "dumb"}
        environment.pop(HEARTBEAT_VARIABLE, None)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", _PROGRAM],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,
            )
        self._send(request)
        self._on_message = on_message
        threading.Thread(target=self._listen, name="flying process", daemon=True).start()

    def command(self, asked: Asked) -> None:
        """Send a command to its vehicles."""
        self._send(asked)

    def end(self) -> None:
        """Let the vehicles hold, then land; at a second call they land at once."""
        self._send(END)

    def _send(self, message: object) -> None:
        with suppress(OSError):  # it has ended: the listening thread tells
            self._connection.send(message)

    def _listen(self) -> None:
        try:
            with suppress(EOFError, OSError):
                while True:
                    self._on_message(self._connection.recv())
        finally:
            self._process.wait()
            self._on_message(None)
