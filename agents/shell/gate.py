"""The gate of a session that listens with keys: it passes callers on to Zenoh's own listener, few of a host at a time.

Zenoh's listener for TLS holds any number of silent connections, and accepts nothing for 100 ms after each failed
handshake: strangers would keep operators out while they call, and for minutes afterwards. Zenoh limits sessions for all
together: one holder of keys, also of revoked ones, could take the places of all others. TLS stays between the peers:
the gate passes bytes on, and learns from their number and from time alone who has authenticated.
"""

import asyncio
import socket
import threading
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from ipaddress import ip_network
from typing import cast

from agents.shell.socket_filter import LOOPBACK, admit, listener_at

BACKLOG = 1024
HELLO_S = 3.0
"""By then a caller has sent the first message of TLS [wall s]."""
SILENT_MAX = 256
"""Most callers that have not. The newest is let in: of the host that has most of them the oldest is dropped."""
HELLO_MAX_BYTES = 16_384 + 5
PROVEN_S, PROVEN_BYTES = 6.0, 4096
"""Who has stayed for longer than a handshake may take, or has received more than its bytes, is no stranger."""
FAILED_MAX, FAILED_S = 16, 5.0
"""Most handshakes of a host that are under way or have failed within a time; its further callers are refused."""
HOSTS_MAX = 1024
BUFFER_BYTES = 65_536

_HANDSHAKE, _CLIENT_HELLO, _RECORD_HEAD = 22, 1, 5


class Gate:
    """Accepts connections at an endpoint such as `tls/0.0.0.0:7447`, and passes them to a listener of this computer."""

    def __init__(self, endpoint: str, host_max: int, refuse: Callable[[str, str], None]) -> None:
        """Take the endpoint, and the most connections that a host may have; nothing is opened before `open`.

        `refuse` counts callers beyond a limit, by their host and the limit, on the gate's thread.
        """
        self._scheme, _, place = endpoint.partition("/")
        host, _, port = place.rpartition(":")
        self._place = host.strip("[]"), int(port)
        self._host_max, self._refuse = host_max, refuse
        self._inner_port = 0
        self._inner: socket.socket | None = None
        self._own_ports: set[int] = set()
        self._admitting = threading.Lock()
        self._callers: set[_Caller] = set()
        self._silent: dict[_Caller, str] = {}
        self._under_way: Counter[str] = Counter()
        self._passed_on: Counter[str] = Counter()
        self._failed_s: dict[str, deque[float]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    def open(self) -> str:
        """Begin to accept, on a thread of its own, and return the endpoint where Zenoh has to listen now.

        Raises OSError if the endpoint cannot be used.
        """
        family, _, _, _, address = socket.getaddrinfo(*self._place, type=socket.SOCK_STREAM)[0]
        listener = socket.create_server(address, family=family, backlog=BACKLOG)
        with socket.create_server((LOOPBACK, 0)) as free:
            self._inner_port = int(free.getsockname()[1])
        loop = self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, args=(loop, listener), name="gate", daemon=True)
        self._thread.start()
        return f"{self._scheme}/{LOOPBACK}:{self._inner_port}"

    def keep_others_out(self) -> None:
        """Let Zenoh, which listens now, take connections from this gate only, where the system can do that.

        Its port is open to all users of this computer, and a few failed handshakes there keep everybody out.
        """
        with self._admitting:
            listener = listener_at(self._inner_port)
            if listener is None:
                return
            try:
                admit(listener, self._own_ports)
            except OSError:  # a sandbox without filters: as on other systems
                listener.close()
            else:
                self._inner = listener

    def _admit(self) -> None:
        if self._inner is not None:
            admit(self._inner, self._own_ports)

    def _run(self, loop: asyncio.AbstractEventLoop, listener: socket.socket) -> None:
        serving = loop.create_server(lambda: _Caller(self, loop), sock=listener, backlog=BACKLOG)
        server = loop.run_until_complete(serving)
        loop.run_forever()
        server.close()
        for caller in tuple(self._callers):
            caller.transport.abort()
        while self._callers or asyncio.all_tasks(loop):
            for task in asyncio.all_tasks(loop):
                task.cancel()
            loop.run_until_complete(asyncio.sleep(0))
        loop.close()

    def close(self) -> None:
        """Stop accepting, and end what passes. May be called twice, and without `open`."""
        loop, self._loop = self._loop, None
        if loop is not None and self._thread is not None:
            loop.call_soon_threadsafe(loop.stop)
            self._thread.join()
        if self._inner is not None:
            self._inner.close()

    def came(self, caller: "_Caller") -> None:
        """Take a caller that has said nothing yet."""
        self._callers.add(caller)
        self._silent[caller] = caller.host
        if len(self._silent) > SILENT_MAX:
            host, _ = Counter(self._silent.values()).most_common(1)[0]
            next(each for each, other in self._silent.items() if other == host).refuse("too many silent connections")

    def greeted(self, caller: "_Caller") -> str:
        """Take a caller that has begun a handshake; return the limit that its host has reached, empty if none."""
        self._silent.pop(caller, None)
        now_s = asyncio.get_running_loop().time()
        failed_s = self._failed_s.get(caller.host, ())
        failed = sum(now_s - each < FAILED_S for each in failed_s)
        if self._under_way[caller.host] + failed >= FAILED_MAX:
            return "too many handshakes"
        if self._passed_on[caller.host] >= self._host_max:
            return "too many connections"
        self._under_way[caller.host] += 1
        self._passed_on[caller.host] += 1
        return ""

    def proved(self, host: str, *, failed: bool) -> None:
        """Take the end of a handshake."""
        self._under_way[host] -= 1
        if not self._under_way[host]:
            del self._under_way[host]
        if failed:
            self._failed_s.setdefault(host, deque(maxlen=FAILED_MAX)).append(asyncio.get_running_loop().time())
            if len(self._failed_s) > HOSTS_MAX:
                del self._failed_s[next(iter(self._failed_s))]

    def dropped(self, caller: "_Caller", limit: str) -> None:
        """Take a caller that is being dropped, and the limit that its host or all have reached, empty if none."""
        self._silent.pop(caller, None)
        if limit:
            self._refuse(f"address {caller.host}", limit)

    def left(self, caller: "_Caller", *, passed_on: bool) -> None:
        """Forget a caller that has left."""
        self._callers.discard(caller)
        self._silent.pop(caller, None)
        if passed_on:
            self._passed_on[caller.host] -= 1
            if not self._passed_on[caller.host]:
                del self._passed_on[caller.host]

    async def connect(self, caller: "_Caller") -> "_Inside":
        """Connect a caller to Zenoh, from a port that is admitted as long as it is bound; raises OSError."""
        loop, own = asyncio.get_running_loop(), socket.socket()
        try:
            own.setblocking(False)
            own.bind((LOOPBACK, 0))
            port = own.getsockname()[1]
            with self._admitting:
                self._own_ports.add(port)
                self._admit()
            await loop.sock_connect(own, (LOOPBACK, self._inner_port))
            _, inside = await loop.create_connection(lambda: _Inside(caller, port), sock=own)
        except BaseException:
            self.disconnected(own.getsockname()[1])
            own.close()
            raise
        return inside

    def disconnected(self, port: int) -> None:
        """Take the end of a connection to Zenoh, before its port is free for others."""
        with self._admitting, suppress(OSError):  # Zenoh has closed its listener
            self._own_ports.discard(port)
            self._admit()


def _host(address: tuple[object, ...] | None) -> str:
    """Return the host of a socket's address; of IPv6 its network, where a computer has any number of addresses."""
    host, _, _ = str(address[0] if address else "").partition("%")
    return str(ip_network((host, 64), strict=False)) if ":" in host else host


class _Side(asyncio.Protocol):
    """One of the two connections; what it receives is written to the other."""

    other: "_Side | None" = None
    transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(BUFFER_BYTES)

    def data_received(self, data: bytes) -> None:
        if self.other is not None and not self.other.transport.is_closing():
            self.other.transport.write(data)

    def connection_lost(self, _error: Exception | None) -> None:
        if self.other is not None:
            self.other.transport.close()

    def pause_writing(self) -> None:
        if self.other is not None:
            self.other.transport.pause_reading()

    def resume_writing(self) -> None:
        if self.other is not None:
            self.other.transport.resume_reading()


class _Caller(_Side):
    def __init__(self, gate: Gate, loop: asyncio.AbstractEventLoop) -> None:
        self.gate, self._loop = gate, loop
        self.host = ""
        self._hello = b""
        self._received = 0
        self._passing: asyncio.Task[None] | None = None
        self._is_proven = False
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.host = _host(transport.get_extra_info("peername"))
        self._timer = self._loop.call_later(HELLO_S, self.refuse)
        self.gate.came(self)

    def refuse(self, limit: str = "") -> None:
        """Drop the connection, which may be one beyond a limit."""
        self.gate.dropped(self, limit)
        self.transport.abort()

    def data_received(self, data: bytes) -> None:
        if self.other is not None:
            super().data_received(data)
            return
        self._hello += data
        if self._passing is not None or self.transport.is_closing():
            return
        head = self._hello[: _RECORD_HEAD + 1]
        if head[:1] != bytes((_HANDSHAKE,)) or head[_RECORD_HEAD:] not in (b"", bytes((_CLIENT_HELLO,))):
            self.refuse()
        elif len(self._hello) >= _RECORD_HEAD + int.from_bytes(head[3:_RECORD_HEAD]) > _RECORD_HEAD:
            self._greet()
        elif len(self._hello) > HELLO_MAX_BYTES:
            self.refuse()

    def _greet(self) -> None:
        if limit := self.gate.greeted(self):
            self.refuse(limit)
            return
        assert self._timer is not None
        self._timer.cancel()
        self._timer = self._loop.call_later(PROVEN_S, self._prove)
        self.transport.pause_reading()
        self._passing = self._loop.create_task(self._go_on())

    async def _go_on(self) -> None:
        try:
            self.other = await self.gate.connect(self)
        except OSError:  # Zenoh has closed
            self.refuse()
            return
        if self.transport.is_closing():
            self.other.transport.close()
            return
        self.other.transport.write(self._hello)
        self._hello = b""
        self.transport.resume_reading()

    def count(self, length: int) -> None:
        """Count bytes that are sent to the caller."""
        self._received += length
        if self._received > PROVEN_BYTES:
            self._prove()

    def _prove(self, *, failed: bool = False) -> None:
        if self._passing is not None and not self._is_proven:
            self._is_proven = True
            self.gate.proved(self.host, failed=failed)

    def connection_lost(self, error: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self.gate.left(self, passed_on=self._passing is not None)
        self._prove(failed=True)
        super().connection_lost(error)


class _Inside(_Side):
    """The connection to Zenoh."""

    def __init__(self, caller: _Caller, port: int) -> None:
        self.other = self._caller = caller
        self._port = port

    def data_received(self, data: bytes) -> None:
        self._caller.count(len(data))
        super().data_received(data)

    def connection_lost(self, error: Exception | None) -> None:
        self._caller.gate.disconnected(self._port)
        super().connection_lost(error)
