"""Sockets that listen for operators and viewers, and that others cannot occupy.

Whoever reaches a port can open any number of connections. Those that have not been admitted are few, in all and from
one host, and end by themselves. The newest is always taken: where there are too many, the oldest of those that have
requested nothing ends, then the oldest of the others. So a flood delays an operator while it lasts, and not longer.
"""

import asyncio
import socket
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from errno import EADDRNOTAVAIL, EAFNOSUPPORT
from ipaddress import IPv6Address, ip_address
from typing import Any

WAITING_MAX, WAITING_OF_HOST_MAX = 256, 64
SILENT_MAX_S, ASKED_MAX_S = 15.0, 120.0
"""A connection that has not been admitted ends when its first request takes longer to arrive, or any to be answered:
a file of the page comes slowly over a poor link."""
_BACKLOG = 100
_NOT_HERE = (EADDRNOTAVAIL, EAFNOSUPPORT)

Client = tuple[str, int]
"""Host and port at the other end."""


@dataclass(slots=True)
class _Waiting:
    connection: socket.socket
    host: str
    since_s: float
    end: asyncio.TimerHandle
    has_asked: bool = False


class ConnectionLimits:
    """The limits of one server for connections that have not been admitted; used inside its event loop."""

    def __init__(self) -> None:
        self._waiting: dict[Client, _Waiting] = {}

    def take(self, connection: socket.socket, client: Client) -> None:
        """Take a new connection, and end another one if there are too many."""
        for gone in [each for each, waiting in self._waiting.items() if waiting.connection.fileno() < 0]:
            self._leave(gone)
        end = asyncio.get_running_loop().call_later(SILENT_MAX_S, self._end, client)
        taken = self._waiting[client] = _Waiting(connection, _network(client[0]), time.monotonic(), end)
        others = [each for each in self._waiting if each != client]
        of_host = [each for each in others if self._waiting[each].host == taken.host]
        if len(of_host) >= WAITING_OF_HOST_MAX:
            self._end(min(of_host, key=self._worth))
        elif len(others) >= WAITING_MAX:
            self._end(min(others, key=self._worth))

    def ask(self, client: Client) -> None:
        """Take that a connection has sent a whole request."""
        if waiting := self._waiting.get(client):
            waiting.end.cancel()
            waiting.end = asyncio.get_running_loop().call_later(ASKED_MAX_S, self._end, client)
            waiting.has_asked = True

    def admit(self, client: Client) -> None:
        """Admit a connection: it stays until one of its ends closes it."""
        self._leave(client)

    def _worth(self, client: Client) -> tuple[bool, float]:
        waiting = self._waiting[client]
        return waiting.has_asked, waiting.since_s

    def _leave(self, client: Client) -> socket.socket | None:
        waiting = self._waiting.pop(client, None)
        if waiting is None:
            return None
        waiting.end.cancel()
        return waiting.connection

    def _end(self, client: Client) -> None:
        connection = self._leave(client)
        if connection is not None:
            with suppress(OSError):  # it has ended
                connection.shutdown(socket.SHUT_RDWR)  # its protocol closes it then


class ListeningSocket(socket.socket):
    """A socket whose connections wait for their admission."""

    limits: ConnectionLimits

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection; the event loop calls this."""
        connection, client = super().accept()
        self.limits.take(connection, client[:2])
        return connection, client


def listening_sockets(limits: ConnectionLimits, hosts: Sequence[str], port: int) -> list[ListeningSocket]:
    """Return sockets that listen at all addresses of these hosts that this computer has; raises OSError without one.

    Connections inherit the options of these sockets.
    """
    found = [each for host in hosts for each in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)]
    ends = dict.fromkeys((family, end) for family, _, _, _, end in found)
    listening: list[ListeningSocket] = []
    missing: list[OSError] = []
    with ExitStack() as opened:
        for family, end in ends:
            try:
                listening.append(opened.enter_context(_listening(family, end, is_alone=len(ends) == 1)))
            except OSError as error:
                if error.errno not in _NOT_HERE:
                    raise
                missing.append(error)
        if not listening:
            raise missing[0]
        opened.pop_all()
    for each in listening:
        each.limits = limits
    return listening


def _listening(family: int, end: Any, *, is_alone: bool) -> ListeningSocket:
    listening = ListeningSocket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6 and not is_alone:
            listening.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listening.bind(end)
        listening.listen(_BACKLOG)
    except OSError:
        listening.close()
        raise
    return listening


def _network(host: str) -> str:
    """Return what one computer has to itself of the addresses: of IPv6 a network of 64 bits."""
    address = ip_address(host.partition("%")[0])
    if isinstance(address, IPv6Address) and not address.is_loopback and address.ipv4_mapped is None:
        return str(int(address) >> 64)
    return str(address)
