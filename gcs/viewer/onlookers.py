"""Viewers that look on while it flies, over the Foxglove WebSocket: shown what the log holds, and able to do nothing.

A viewer that is slow misses messages, the oldest first; one that dies is forgotten. Neither is waited for.
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
"""Messages that wait for a slow viewer: some seconds of a team's."""

PARTING_S = 1.0


# What becomes of viewers is theirs to know: the server's words about it would tear the view of the flight apart.
logging.getLogger("foxglove").addHandler(logging.NullHandler())


class Address(NamedTuple):
    """Where viewers connect to."""

    host: str
    port: int

    @classmethod
    def parsed(cls, text: str) -> Self:
        """Return what HOST:PORT says, [HOST]:PORT for IPv6; raises InputError."""
        host, _, port = text.rpartition(":")
        bare = host.removeprefix("[").removesuffix("]")
        bracketed = host == f"[{bare}]"
        if not bare or (":" in bare) != bracketed or not port.isdecimal() or not 0 < int(port) < 65536:
            raise InputError([f"--live-address: an address is like {_EXAMPLE} or [::1]:8765 (given: {text!r})"])
        return cls(bare, int(port))

    @property
    def url(self) -> str:
        """What a viewer is told to open."""
        return f"ws://[{self.host}]:{self.port}" if ":" in self.host else f"ws://{self.host}:{self.port}"

    @property
    def is_loopback(self) -> bool:
        """Whether nobody else's computer can connect to it."""
        try:
            return ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


@contextmanager
def onlookers(address: Address, context: Context) -> Iterator[None]:
    """Show viewers whatever is written to the context; raises VehicleRefusedError when nobody can listen there."""
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
            f"--live: nobody can listen at {address.host}:{address.port} ({error})",
            "end what listens there already, or name another place by --live-address HOST:PORT",
        ) from error
    try:
        yield
    finally:
        # It waits for viewers to take their leave, and one that hangs never does.
        parting = threading.Thread(target=server.stop, name="onlookers' leave", daemon=True)
        parting.start()
        parting.join(PARTING_S)
