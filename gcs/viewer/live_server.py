"""Read-only live view of a flight over the Foxglove WebSocket, with the channels of the log.

For a slow viewer the oldest messages are dropped, and a dead viewer is removed. The flight waits for neither.
"""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from ipaddress import ip_address
from typing import NamedTuple, Self

import foxglove
from foxglove import Context

from agents.ports import VehicleRefusedError
from gcs.errors import InputError

SERVER_NAME = "cordon"
_EXAMPLE = "127.0.0.1:8765"
BACKLOG = 256
"""Messages queued for a slow viewer: some seconds of a team's messages."""

STOP_TIMEOUT_S = 1.0


# The server's log messages about viewers would break the live table in the terminal.
logging.getLogger("foxglove").addHandler(logging.NullHandler())


class Address(NamedTuple):
    """Host and port that viewers connect to."""

    host: str
    port: int

    @classmethod
    def parsed(cls, text: str) -> Self:
        """Parse HOST:PORT, or [HOST]:PORT for IPv6; raises InputError."""
        host, _, port = text.rpartition(":")
        bare = host.removeprefix("[").removesuffix("]")
        bracketed = host == f"[{bare}]"
        if not bare or (":" in bare) != bracketed or not port.isdecimal() or not 0 < int(port) < 65536:
            raise InputError(
                [f"--live-address: it must be HOST:PORT, for example {_EXAMPLE} or [::1]:8765 (given: {text!r})"]
            )
        return cls(bare, int(port))

    @property
    def url(self) -> str:
        """The URL to open in a viewer."""
        return f"ws://[{self.host}]:{self.port}" if ":" in self.host else f"ws://{self.host}:{self.port}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer can connect to it."""
        try:
            return ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


@contextmanager
def live_server(address: Address, context: Context) -> Iterator[None]:
    """Serve the channels of the context to viewers; raises VehicleRefusedError when the address is not available."""
    try:
        server = foxglove.start_server(
            name=SERVER_NAME,
            host=address.host,
            port=address.port,
            capabilities=[],
            context=context,
            message_backlog_size=BACKLOG,
        )
    except RuntimeError as error:
        raise VehicleRefusedError(
            f"--live: cannot listen at {address.host}:{address.port} ({error})",
            "end the program that uses the port, or choose another address by --live-address HOST:PORT",
        ) from error
    try:
        yield
    finally:
        # `stop` waits for viewers to disconnect, and a hung viewer never does.
        stopping = threading.Thread(target=server.stop, name="live-server-stop", daemon=True)
        stopping.start()
        stopping.join(STOP_TIMEOUT_S)
