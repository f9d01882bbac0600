"""Read-only live view of a flight over the Foxglove WebSocket, with the channels of the log.

The oldest messages for a slow viewer are dropped, and a dead viewer is removed. The flight waits for neither.
"""

import logging
import ssl
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import foxglove
from foxglove import Context

from agents.ports import VehicleRefusedError
from gcs.viewer.origin_gate import PERMITTED, Address, OriginGate

if TYPE_CHECKING:
    from gcs.keys.certificates import KeyPair

SERVER_NAME = "cordon"
BACKLOG = 256
"""Messages queued for a slow viewer: a few seconds of a team's messages."""

STOP_TIMEOUT_S = 1.0


# The server's log messages about viewers would break the live table in the terminal.
logging.getLogger("foxglove").addHandler(logging.NullHandler())


@contextmanager
def live_server(address: Address, context: Context, origins: Collection[str] = ()) -> Iterator[None]:
    """Serve the channels of the context to viewers; web pages need an origin in `origins` or `PERMITTED`.

    Raises VehicleRefusedError when the address is not available.
    """
    keys, tls = _keys_of_the_gate()
    server = foxglove.start_server(
        name=SERVER_NAME,
        host="127.0.0.1",
        port=0,
        capabilities=[],
        context=context,
        message_backlog_size=BACKLOG,
        tls_cert=keys.certificate_pem,
        tls_key=keys.private_key_pem,
    )
    gate = OriginGate(address.host, address.port, server.port, tls, PERMITTED | set(origins))
    try:
        _open(gate, address)
        yield
    finally:
        # `stop` waits for viewers to disconnect, which a hung viewer never does.
        stopping = threading.Thread(target=server.stop, name="live-server-stop", daemon=True)
        stopping.start()
        stopping.join(STOP_TIMEOUT_S)
        gate.close(STOP_TIMEOUT_S)


def _open(gate: OriginGate, address: Address) -> None:
    try:
        gate.open()
    except OSError as error:
        raise VehicleRefusedError(
            f"--live: cannot listen at {address.host}:{address.port} ({error.strerror or error})",
            "end the program that uses the port, or choose another address with --live-address HOST:PORT",
        ) from error


def _keys_of_the_gate() -> "tuple[KeyPair, ssl.SSLContext]":
    """Return the server's certificate, new for each flight and never stored, and a context that accepts only it."""
    from gcs.keys.certificates import DAY_S, CertificateAuthority  # noqa: PLC0415

    authority = CertificateAuthority.made(1.0)
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    tls.check_hostname = False
    tls.load_verify_locations(cadata=authority.keys.certificate_pem.decode())
    return authority.issue("live-view", time.time() + DAY_S), tls
