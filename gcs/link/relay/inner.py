"""The connection between MAVSDK and its relay: TCP on the loopback interface, within this process.

MAVSDK could also pass frames through its `raw://` connection. But then its threads, and each call that sends a
setpoint, wait for Python's interpreter lock. A TCP connection accepts MAVSDK's frames at once, and other processes
cannot write to it, as they could to a UDP socket.
"""

import os
import socket
from contextlib import suppress
from pathlib import Path
from stat import S_ISSOCK

from gcs.link.relay.carriers import Stream, connected

LOOPBACK = "127.0.0.1"
ACCEPT_WITHIN_S = 5.0
QUICK_ACKNOWLEDGEMENT = getattr(socket, "TCP_QUICKACK", None)


class InnerListener:
    """Waits for MAVSDK's connection."""

    def __init__(self) -> None:
        self._listener = socket.create_server((LOOPBACK, 0), backlog=1)
        self._listener.settimeout(ACCEPT_WITHIN_S)

    @property
    def url(self) -> str:
        """The url that MAVSDK has to connect to."""
        return f"tcpout://{LOOPBACK}:{self._listener.getsockname()[1]}"

    def accept(self) -> "InnerConnection":
        """Return the connection of this process; no other connection is possible afterwards.

        Raises OSError when another process connected first.
        """
        with self._listener:
            connection, address = self._listener.accept()
        if not _is_of_this_process(address):
            connection.close()
            raise OSError(f"another process ({address[0]}:{address[1]}) connected to {self.url}")
        return InnerConnection(connection)

    def close(self) -> None:
        """Stop waiting."""
        self._listener.close()


class InnerConnection(Stream):
    """The relay's end: what MAVSDK sends is read, and written bytes reach MAVSDK."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        stream = connected(connection)
        super().__init__(stream.descriptor, stream.close)

    def read(self) -> bytes | None:
        """Return what MAVSDK sent. It is acknowledged at once; otherwise MAVSDK's next frame waits for 40 ms."""
        data = super().read()
        if QUICK_ACKNOWLEDGEMENT is not None:
            with suppress(OSError):  # closed
                self._connection.setsockopt(socket.IPPROTO_TCP, QUICK_ACKNOWLEDGEMENT, 1)
        return data


def _is_of_this_process(address: tuple[str, int]) -> bool:
    """Return whether one of this process's own sockets has an address."""
    for descriptor in (int(path.name) for path in Path("/dev/fd").iterdir()):
        with suppress(OSError):  # closed meanwhile
            if S_ISSOCK(os.fstat(descriptor).st_mode):
                with socket.socket(fileno=os.dup(descriptor)) as each:
                    if each.getsockname() == address:
                        return True
    return False
