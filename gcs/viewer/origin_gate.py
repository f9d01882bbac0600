"""The address of the live view, and the gate in front of it: only web pages of permitted origins can read a flight.

Browsers let every page open WebSockets to this computer, and send the page's origin in the header `Origin` (RFC 6455,
section 10.2). The Foxglove server does not check it. So the gate listens in its place, reads the head of each
request, and passes on the bytes of permitted ones. The server itself listens behind it on loopback, by TLS with
a certificate that only the gate accepts and browsers refuse.
"""

import asyncio
import ssl
import threading
from collections.abc import Collection, Sequence
from concurrent.futures import Future
from contextlib import suppress
from ipaddress import ip_address
from typing import NamedTuple, Self

from gcs.errors import InputError
from gcs.viewer.connections import ConnectionLimits, listening_sockets

_EXAMPLE = "127.0.0.1:8765"


class Address(NamedTuple):
    """Host and port that viewers connect to."""

    host: str
    port: int

    @classmethod
    def parsed(cls, text: str, option: str = "--live-address") -> Self:
        """Parse HOST:PORT, or [HOST]:PORT for IPv6, as an option has it; raises InputError."""
        host, _, port = text.rpartition(":")
        bare = host.removeprefix("[").removesuffix("]")
        bracketed = host == f"[{bare}]"
        if not bare or (":" in bare) != bracketed or not port.isdecimal() or not 0 < int(port) < 65536:
            raise InputError(
                [f"{option}: it must be HOST:PORT, for example {_EXAMPLE} or [::1]:8765 (given: {text!r})"]
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


PERMITTED = frozenset({"https://app.foxglove.dev", "file://"})
"""The origins of Foxglove in a browser, and of viewers installed on this computer, whose pages are files."""
VIEWERS_MAX = 16
_HEAD_MAX_BYTES = 16384
_PIECE_BYTES = 65536
_REFUSED = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def is_permitted(sent: Sequence[str], origins: Collection[str]) -> bool:
    """Return whether the `Origin` headers of a request are none, as of a program, or a page's of these origins."""
    return not sent or (len(sent) == 1 and sent[0].lower() in {origin.lower() for origin in origins})


def _origins_in(head: bytes) -> list[str]:
    lines = head.decode("latin-1").split("\r\n")[1:]
    return [value.strip() for name, _, value in (line.partition(":") for line in lines) if name.lower() == "origin"]


class OriginGate:
    """Listens in its own thread until it is closed, and passes permitted connections on to the server."""

    def __init__(self, host: str, port: int, server_port: int, tls: ssl.SSLContext, origins: Collection[str]) -> None:
        """Take the address to listen at, and the server's port on loopback; `open` begins to listen."""
        self._listen = host, port
        self._server_port = server_port
        self._tls = tls
        self._origins = origins
        self._limits = ConnectionLimits()
        self._viewers = 0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="live-gate", daemon=True)
        self._opened: Future[None] = Future()
        self._closed = asyncio.Event()

    def open(self) -> None:
        """Listen; raises OSError when the address is not available."""
        self._thread.start()
        self._opened.result()

    def close(self, timeout_s: float) -> None:
        """Close all connections."""
        with suppress(RuntimeError):  # it never opened
            self._loop.call_soon_threadsafe(self._closed.set)
        self._thread.join(timeout_s)

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            try:
                runner.run(self._serve())
            except Exception as error:
                if not self._opened.done():
                    self._opened.set_exception(error)

    async def _serve(self) -> None:
        host, port = self._listen
        listening = listening_sockets(self._limits, [host], port)
        servers = [await asyncio.start_server(self._take, sock=each, limit=_HEAD_MAX_BYTES) for each in listening]
        self._opened.set_result(None)
        await self._closed.wait()
        for server in servers:
            server.close()  # the runner cancels the connections that are left

    async def _take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection; a fault ends only that connection."""
        try:
            with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
                head = await reader.readuntil(b"\r\n\r\n")
                if self._viewers >= VIEWERS_MAX or not is_permitted(_origins_in(head), self._origins):
                    writer.write(_REFUSED)
                    await writer.drain()
                else:
                    self._limits.admit(writer.get_extra_info("peername")[:2])
                    self._viewers += 1
                    try:
                        await self._pass_on(head, reader, writer)
                    finally:
                        self._viewers -= 1
        finally:
            writer.transport.abort() if writer.transport.get_write_buffer_size() else writer.close()

    async def _pass_on(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass bytes both ways until one side ends; the server queues what a slow viewer does not read."""
        there, back = await asyncio.open_connection("127.0.0.1", self._server_port, ssl=self._tls)
        try:
            back.write(head)
            ways = [asyncio.create_task(_carry(reader, back)), asyncio.create_task(_carry(there, writer))]
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
        finally:
            back.transport.abort()


async def _carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while piece := await reader.read(_PIECE_BYTES):
        writer.write(piece)
        await writer.drain()
