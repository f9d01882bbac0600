"""The transport of a connection: UDP, TCP or a serial device, by its url.

A vehicle connects to this end (udpin, tcpin), or this end to it (udpout, tcpout, serial), at a known address. One
thread uses a carrier.
"""

import os
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Protocol

import serial

from gcs.link.relay.gate import Address

DATAGRAM_MAX = 65_535
READ_MAX = 4096
BATCH_MAX = 64
"""Most datagrams received, or callers accepted, in one turn: a flood must not delay sending."""
BACKLOG_MAX = 4096
"""Most bytes that wait for a blocked stream; frames beyond are dropped whole."""
CALLERS_MAX = 8
CALLER_S = 5.0
"""A caller from which no vehicle has been received within this time is dropped [wall s]: heartbeats come every second.
"""
CALL_PERIOD_S = 1.0

Received = tuple[bytes, Address]
IsVehicle = Callable[[Address], bool]
"""Whether a vehicle's heartbeat has come from an address."""


def _all_are(_address: Address) -> bool:
    return True


class Carrier(Protocol):
    """A connection's bytes, by address."""

    @property
    def known(self) -> Address | None:
        """The address that this end connects to; None where vehicles connect."""
        ...

    @property
    def blocks(self) -> bool:
        """Whether `call_again` may block for a moment."""
        ...

    def watched(self) -> Sequence[int]:
        """Return the file descriptors that become readable."""
        ...

    def receive(self) -> Iterator[Received]:
        """Yield what has arrived; no bytes mean that the connection to the address has ended. Also send what waits."""
        ...

    def send(self, frame: bytes, address: Address) -> bool:
        """Send one frame; return whether it was accepted."""
        ...

    def call_again(self) -> None:
        """Connect again after the connection has ended."""
        ...

    def close(self) -> None:
        """Close; the port or device is free afterwards."""
        ...


def open_carrier(url: str, is_vehicle: IsVehicle = _all_are) -> Carrier:
    """Open the connection of a url; of callers there the vehicles are kept.

    Raises OSError, or ValueError for an invalid url.
    """
    scheme, _, rest = url.partition("://")
    place, _, number = rest.rpartition(":")
    make = _CARRIERS.get(scheme)
    if make is None or not place or not number.isdecimal():
        raise ValueError("it is not a valid connection url")
    host, port = place.strip("[]"), int(number)
    return make(host, port) if make is not _TcpServer else _TcpServer(host, port, is_vehicle)


class _Udp:
    """One UDP socket: bound to the port that vehicles send to, or sending to one of them."""

    blocks = False

    def __init__(self, bound: socket.socket, known: Address | None = None) -> None:
        self.known = known
        self._socket = bound
        bound.setblocking(False)

    @classmethod
    def listening(cls, host: str, port: int) -> "_Udp":
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        return cls(_opened(family, kind, lambda opened: opened.bind(address)))

    @classmethod
    def calling(cls, host: str, port: int) -> "_Udp":
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        local = "::" if family is socket.AF_INET6 else "0.0.0.0"
        return cls(_opened(family, kind, lambda opened: opened.bind((local, 0))), address)

    def watched(self) -> Sequence[int]:
        return (self._socket.fileno(),)

    def receive(self) -> Iterator[Received]:
        with suppress(OSError):  # nothing more has arrived, or the peer refused what was sent
            for _ in range(BATCH_MAX):
                yield self._socket.recvfrom(DATAGRAM_MAX)

    def send(self, frame: bytes, address: Address) -> bool:
        try:
            self._socket.sendto(frame, address)
        except OSError:  # no route, or no buffer: the frame is lost
            return False
        return True

    def call_again(self) -> None:
        pass

    def close(self) -> None:
        self._socket.close()


class StreamCarrier:
    """A file descriptor that carries a stream of bytes; frames are sent whole or not at all."""

    def __init__(self, descriptor: int, close: Callable[[], object]) -> None:
        self.descriptor = descriptor
        self.close = close
        self._backlog = b""
        os.set_blocking(descriptor, False)

    def read(self) -> bytes | None:
        """Return what has arrived; None when nothing has, empty when the stream has ended."""
        try:
            return os.read(self.descriptor, READ_MAX)
        except BlockingIOError:
            return None
        except OSError:
            return b""

    def write(self, frame: bytes = b"") -> bool:
        """Send what waits, and then a frame; return whether it was accepted."""
        if len(self._backlog) + len(frame) > BACKLOG_MAX:
            return False
        self._backlog += frame
        if self._backlog:
            with suppress(OSError):  # it accepts no more now; a later read reports its end
                self._backlog = self._backlog[os.write(self.descriptor, self._backlog) :]
        return True


class _TcpServer:
    """A listening TCP socket, and its connections.

    Of callers that are no vehicles, those beyond `CALLERS_MAX` and those that stay so for `CALLER_S` are dropped: first
    of the host that has most of them, and of these the oldest.
    """

    known = None
    blocks = False

    def __init__(self, host: str, port: int, is_vehicle: IsVehicle = _all_are) -> None:
        self._is_vehicle = is_vehicle
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]

        def listen(opened: socket.socket) -> None:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(address)
            opened.listen(BATCH_MAX)

        self._listener = _opened(family, kind, listen)
        self._listener.setblocking(False)
        self._callers: dict[Address, StreamCarrier] = {}
        self._since_s: dict[Address, float] = {}

    def watched(self) -> Sequence[int]:
        return (self._listener.fileno(), *(stream.descriptor for stream in self._callers.values()))

    def receive(self) -> Iterator[Received]:
        for address in self._superfluous():
            self._drop(address)
            yield b"", address
        with suppress(OSError):  # nobody calls, or the caller has gone
            for _ in range(BATCH_MAX):
                caller, address = self._listener.accept()
                self._callers[address], self._since_s[address] = connected(caller), time.monotonic()
        for address, stream in list(self._callers.items()):
            stream.write()
            data = stream.read()
            if data is None:
                continue
            if not data:
                self._drop(address)
            yield data, address

    def _superfluous(self) -> list[Address]:
        """Return the callers that are no vehicles, and too many or too old."""
        old_s = time.monotonic() - CALLER_S
        others = [each for each in self._callers if not self._is_vehicle(each)]
        left = [each for each in others if self._since_s[each] >= old_s]
        while len(left) > CALLERS_MAX:
            host, _ = Counter(host for host, *_ in left).most_common(1)[0]
            left.remove(next(each for each in left if each[0] == host))
        return [each for each in others if each not in left]

    def _drop(self, address: Address) -> None:
        del self._since_s[address]
        self._callers.pop(address).close()

    def send(self, frame: bytes, address: Address) -> bool:
        caller = self._callers.get(address)
        return caller is not None and caller.write(frame)

    def call_again(self) -> None:
        pass

    def close(self) -> None:
        self._listener.close()
        for stream in self._callers.values():
            stream.close()


class _Called:
    """A connection to a TCP server or a serial device, opened again when it has ended."""

    blocks = True

    def __init__(self, known: Address, call: Callable[[], StreamCarrier]) -> None:
        self.known: Address = known
        self._call = call
        self._stream = call()
        self._ended = False
        self._call_next_s = 0.0

    def watched(self) -> Sequence[int]:
        return () if self._ended else (self._stream.descriptor,)

    def receive(self) -> Iterator[Received]:
        if self._ended:
            return
        self._stream.write()
        if (data := self._stream.read()) is not None:
            if not data:
                self._ended = True
                self._stream.close()
            yield data, self.known

    def send(self, frame: bytes, address: Address) -> bool:
        return not self._ended and address == self.known and self._stream.write(frame)

    def call_again(self) -> None:
        if self._ended and time.monotonic() >= self._call_next_s:
            self._call_next_s = time.monotonic() + CALL_PERIOD_S
            with suppress(OSError):
                self._stream = self._call()
                self._ended = False

    def close(self) -> None:
        if not self._ended:
            self._stream.close()


def _tcp_client(host: str, port: int) -> _Called:
    return _Called((host, port), lambda: connected(socket.create_connection((host, port), CALL_PERIOD_S)))


def _serial(device: str, baud: int) -> _Called:
    def call() -> StreamCarrier:
        try:
            # With an inter_byte_timeout a read without data raises, and no bytes mean the end of the stream.
            port = serial.Serial(device, baud, timeout=0.0, write_timeout=0.0, inter_byte_timeout=0.0)
        except ValueError as error:
            raise OSError(f"{baud} is not a rate of a serial device") from error
        return StreamCarrier(port.fileno(), port.close)

    return _Called((device, baud), call)


def connected(connection: socket.socket) -> StreamCarrier:
    """Return the stream of a TCP connection; setpoints are sent at once."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return StreamCarrier(connection.fileno(), connection.close)


def _opened(family: int, kind: int, prepare: Callable[[socket.socket], object]) -> socket.socket:
    opened = socket.socket(family, kind)
    try:
        prepare(opened)
    except OSError:
        opened.close()
        raise
    return opened


_CARRIERS: dict[str, Callable[[str, int], Carrier]] = {
    "udpin": _Udp.listening,
    "udpout": _Udp.calling,
    "tcpin": _TcpServer,
    "tcpout": _tcp_client,
    "serial": _serial,
}
