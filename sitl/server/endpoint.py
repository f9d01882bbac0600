"""The UDP endpoint of one stub vehicle, whose faults it has, and the clock that stubs and clients share."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from math import inf
from typing import Protocol, cast

from sitl.faults import VehicleFaults

DATAGRAM_MAX = 1400
SILENCE_S = 3.0
"""After this silence of its client another address may claim a vehicle [wall s], as links let a vehicle move."""
MAGIC = (0xFD, 0xFE)
"""The first byte of a frame of MAVLink 2 and 1."""
LOOPBACK = "127.0.0.1"

Address = tuple[str, int]


class StubClock(Protocol):
    """The clock of the stubs, which is also that of their clients: monotonic simulated seconds."""

    @property
    def speed(self) -> float:
        """How many times as fast as the wall's it runs, at most."""

    def now_s(self) -> float:
        """Return the present time."""

    def call_at(self, time_s: float, call: Callable[[], object]) -> object:
        """Call a function at a time, on the running event loop."""

    async def sleep_until(self, time_s: float) -> float:
        """Wait until a time has come, yielding at least once."""

    def close(self) -> None:
        """Leave the clock."""


class Endpoint(asyncio.DatagramProtocol):
    """One vehicle's socket: it obeys, and sends to, the client that has claimed it.

    The configured client claims it by every frame, another address only while the present client is silent. What others
    send is dropped and reported to `on_stranger`; if that is None, the vehicle judges all senders by their signatures.
    The configured client is sent to in any case: it receives before it sends.
    """

    def __init__(
        self,
        receive: Callable[[bytes], list[bytes]],
        client: Address,
        faults: VehicleFaults,
        clock: StubClock,
        on_stranger: Callable[[], object] | None = None,
    ) -> None:
        self._receive = receive
        self._on_stranger = on_stranger
        self._client = self._claimed_by = client
        self._heard_s = -inf
        self._faults = faults
        self._clock = clock
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the socket."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Take a datagram of the client, and answer it."""
        now_s = time.monotonic()
        may_claim = addr in (self._client, self._claimed_by) or now_s - self._heard_s > SILENCE_S
        if may_claim and data[:1] and data[0] in MAGIC:
            self._claimed_by, self._heard_s = addr, now_s
        if may_claim or self._on_stranger is None:
            self._carry(lambda: self.send(self._receive(data)))
        else:
            self._on_stranger()

    def send(self, packets: list[bytes], on_sent: Callable[[], object] = lambda: None) -> None:
        """Send packets as the link's faults demand; `on_sent` is called when they are sent."""
        if packets:
            self._carry(lambda: self._send(packets, on_sent))

    def _carry(self, deliver: Callable[[], object]) -> None:
        """Deliver packets as the link's faults demand: at once, late, or not at all."""
        if self._faults.link_cut:
            return
        if self._faults.link_delay_s > 0.0:
            self._clock.call_at(self._clock.now_s() + self._faults.link_delay_s, deliver)
        else:
            deliver()

    def _send(self, packets: list[bytes], on_sent: Callable[[], object] = lambda: None) -> None:
        on_sent()
        if self._transport is None or self._transport.is_closing():
            return
        for datagram in _bundled(packets):
            for address in {self._client, self._claimed_by}:
                self._transport.sendto(datagram, address)


@asynccontextmanager
async def bound(endpoint: Endpoint, port: int) -> AsyncIterator[None]:
    """Bind an endpoint to a port, 0 for any, within a context; raises OSError."""
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: endpoint, local_addr=(LOOPBACK, port))
    try:
        yield
    finally:
        transport.close()


def _bundled(packets: list[bytes]) -> list[bytes]:
    """Join packets into datagrams that fit an Ethernet frame, as PX4 does."""
    datagrams: list[bytes] = []
    for packet in packets:
        if datagrams and len(datagrams[-1]) + len(packet) <= DATAGRAM_MAX:
            datagrams[-1] += packet
        else:
            datagrams.append(packet)
    return datagrams
