"""The relay of one connection: it passes the frames of verified vehicles to MAVSDK, and MAVSDK's frames to them.

MAVSDK itself accepts any sender, and sends setpoints to each. So it connects only to the relay.

Orders and delays the frames to the vehicles of a connection: no more than it carries, important ones first.

A serial device or a radio accepts bytes faster than it sends them, and frames in its buffers are outdated when sent. So
frames wait here, where a newer setpoint replaces an older one. No clock and no sockets: times are arguments [s].
"""

import os
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import suppress
from math import inf
from pathlib import Path
from stat import S_ISSOCK

from gcs.link.rates import ROUND_TRIP_HZ, Traffic
from gcs.link.relay.carriers import StreamCarrier, connected, open_carrier
from gcs.link.relay.frames import (
    COMMANDS,
    HEARTBEAT,
    MAGIC_V2,
    POINTING,
    SETPOINT,
    SIGNATURE_LENGTH,
    FrameStream,
    header,
    station_heartbeat,
    target_system,
    timesync_request,
)
from gcs.link.relay.gate import Address, Claim, FrameGate, LinkReport
from gcs.link.relay.relay_thread import RelayThread
from gcs.link.relay.signing import SignatureCheck, Signing

BURST_S = 0.03
"""The idle time that a burst may use up."""
OTHERS_MAX_BYTES = 4096
"""Most other frames that wait (parameters, missions). Further ones are dropped; their protocols request them again."""
EARLY_SHARE = 0.25
"""Share of its period by which a new setpoint may be early: tick times vary."""

Outgoing = tuple[bytes, Address]


class TransmitQueue:
    """Frames that wait to be sent on a connection that carries `bytes_s` to the vehicles, `extra_bytes` with each.

    Commands go before setpoints, and setpoints before the rest. Of each vehicle's setpoints the newest is kept, and one
    is sent `setpoint_hz` times a second, each `copies` times at most: a copy has left a burst of losses behind. MAVSDK
    repeats the last one more often. Vehicles take turns. The newest direction of each vehicle's gimbal comes last.
    """

    def __init__(self, bytes_s: float = inf, setpoint_hz: float = inf, extra_bytes: int = 0) -> None:
        self.bytes_s, self.setpoint_hz, self.extra_bytes = bytes_s, setpoint_hz, extra_bytes
        self.copies = 1
        self.dropped = 0
        self._commands: deque[Outgoing] = deque()
        self._others: deque[Outgoing] = deque()
        self._pointings: dict[tuple[int, Address], bytes] = {}
        self._setpoints: dict[tuple[int, Address], _Slot] = {}
        self._free_s = -inf
        """When the connection has sent all frames passed to it."""

    def put(self, frame: bytes, address: Address) -> None:
        """Add a frame to send."""
        message = header(frame).message
        if message == SETPOINT:
            self._setpoints.setdefault((target_system(frame), address), _Slot()).put(frame, self.copies)
        elif message == HEARTBEAT or message in COMMANDS:
            self._commands.append((frame, address))
        elif message == POINTING:
            self._pointings[target_system(frame), address] = frame
        elif sum(len(each) for each, _ in self._others) + len(frame) <= OTHERS_MAX_BYTES:
            self._others.append((frame, address))
        else:
            self.dropped += 1

    def due(self, now_s: float) -> list[Outgoing]:
        """Return the frames to send now."""
        sent: list[Outgoing] = []
        self._free_s = max(self._free_s, now_s - BURST_S)
        while self._free_s <= now_s and (outgoing := self._next(now_s)) is not None:
            sent.append(outgoing)
            self._free_s += (len(outgoing[0]) + self.extra_bytes) / self.bytes_s
        return sent

    def due_s(self) -> float:
        """Return when the next frame is due [s], which may be past; infinity without one."""
        if self._commands or self._others or self._pointings:
            return self._free_s
        waiting = (slot.due_s(1.0 / self.setpoint_hz) for slot in self._setpoints.values())
        return max(self._free_s, min(waiting, default=inf))

    def _next(self, now_s: float) -> Outgoing | None:
        if self._commands:
            return self._commands.popleft()
        period_s = 1.0 / self.setpoint_hz
        for key, slot in self._setpoints.items():
            if slot.due_s(period_s) <= now_s:
                frame = slot.take(now_s, period_s)
                self._setpoints[key] = self._setpoints.pop(key)  # the others' turns come first now
                return frame, key[1]
        if self._others:
            return self._others.popleft()
        if self._pointings:
            first = next(iter(self._pointings))
            return self._pointings.pop(first), first[1]
        return None


class _Slot:
    """One vehicle's newest setpoint, how many times it may still be sent, and when."""

    def __init__(self) -> None:
        self._frame = b""
        self._left = 0
        self._target = b""
        self._is_new = True
        self._next_s = -inf

    def put(self, frame: bytes, copies: int) -> None:
        target = _target(frame)
        self._is_new = self._is_new or target != self._target
        self._frame, self._left, self._target = frame, copies, target

    def due_s(self, period_s: float) -> float:
        if not self._left:
            return inf
        return self._next_s - (EARLY_SHARE * period_s if self._is_new else 0.0)

    def take(self, now_s: float, period_s: float) -> bytes:
        frame, self._left, self._is_new = self._frame, self._left - 1, False
        planned_s = self._next_s + period_s
        self._next_s = planned_s if planned_s > now_s else now_s + period_s
        return frame


def _target(frame: bytes) -> bytes:
    """Return a setpoint without its header, its time, its checksum and its signature: equal in repetitions."""
    return frame[14:63]


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


class InnerConnection(StreamCarrier):
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


CALL_PERIOD_S = 0.5
ROUND_TRIP_PERIOD_S = 1.0 / ROUND_TRIP_HZ


class Relay:
    """One connection to the outside, by its url, and one to MAVSDK. Use it from any thread.

    It runs in the thread `shared`, or in its own thread where connecting may block. Raises OSError when the
    connection cannot be opened, ValueError for an invalid url.
    """

    def __init__(self, url: str, shared: RelayThread, now_s: Callable[[], float] = time.monotonic) -> None:
        """Take the clock of round trips and senders."""
        self._now_s = now_s
        self._carrier = open_carrier(url, self._is_vehicle)
        self._own_thread = RelayThread(f"relay {url}") if self._carrier.blocks else None
        self._thread = self._own_thread or shared
        self._gate = FrameGate()
        self._lock = threading.Lock()
        self._again: list[bytes] = []
        """Heartbeats for MAVSDK that were received before."""
        self._called = 0
        self._shows_life = False
        self._call_next_s = -inf
        self._round_trips = 0
        self._round_trip_next_s = -inf
        self._outgoing = FrameStream()
        self._queue: TransmitQueue | None = None
        self._down_bytes = 0
        self._listener = InnerListener()
        self._inner: InnerConnection | None = None

    @property
    def inner_url(self) -> str:
        """The url that MAVSDK has to connect to, before `start`."""
        return self._listener.url

    def start(self) -> None:
        """Begin to pass frames on; raises OSError when another process than this one connected."""
        self._inner = self._listener.accept()
        self._thread.add(self)

    def claim(self, system_id: int, signing: Signing | None) -> None:
        """Wait for the heartbeats of a vehicle."""
        with self._lock:
            self._gate.claims[system_id] = Claim(signing)
            self._gate.others.discard(system_id)

    def release(self, system_id: int) -> None:
        """Remove a vehicle."""
        with self._lock:
            self._gate.claims.pop(system_id, None)

    def candidates(self, system_id: int) -> list[Address]:
        """Return the addresses whose heartbeats have a system id; with signing, only those with its key."""
        with self._lock:
            return list(self._gate.claims[system_id].candidates)

    def rejected(self, system_id: int) -> dict[Address, SignatureCheck]:
        """Return the addresses whose heartbeats have a system id but are not authentic."""
        with self._lock:
            return dict(self._gate.claims[system_id].rejected)

    def others(self, system_id: int) -> list[int]:
        """Return the system ids of other autopilots than this on the connection."""
        with self._lock:
            verified = {each for each, claim in self._gate.claims.items() if claim.address is not None}
            return sorted((verified | self._gate.others) - {system_id})

    def verify(self, system_id: int, address: Address) -> None:
        """Accept and address only this sender from now on, and pass its last heartbeat to MAVSDK."""
        with self._lock:
            claim = self._gate.claims[system_id]
            self._again.append(claim.verify(address, self._now_s()))
            self._round_trip_next_s = -inf
        self._thread.wake()

    def repeat_heartbeat(self, system_id: int) -> None:
        """Pass a vehicle's newest heartbeat to MAVSDK again."""
        with self._lock:
            if (claim := self._gate.claims.get(system_id)) is not None:
                self._again.append(claim.heartbeat)
        self._thread.wake()

    def listen(self, system_id: int, listeners: Mapping[int, Callable[[bytes], object]]) -> None:
        """Call these functions, by message, with the frames of a vehicle's autopilot, in the relay's thread.

        They must be quick, and must not raise.
        """
        with self._lock:
            if (claim := self._gate.claims.get(system_id)) is not None:
                claim.listeners = listeners

    def mute(self, system_id: int, muted: bool) -> None:
        """Send a vehicle no setpoint from now on, or again: MAVSDK repeats the last one, and one may be under way."""
        with self._lock:
            if (claim := self._gate.claims.get(system_id)) is not None:
                claim.muted = muted

    def report(self, system_id: int) -> LinkReport:
        """Return the report of what arrived with the system id of a vehicle."""
        with self._lock:
            claim = self._gate.claims.get(system_id)
            return LinkReport() if claim is None else claim.report()

    def messages(self, system_id: int) -> dict[int, int]:
        """Return how many messages of each number have arrived from a vehicle."""
        with self._lock:
            claim = self._gate.claims.get(system_id)
            return {} if claim is None else dict(claim.messages)

    def traffic(self) -> Traffic:
        """Return the counts of this connection."""
        with self._lock:
            every = [claim.sequences for claim in self._gate.claims.values()]
            return Traffic(
                self._down_bytes,
                sum(each.received for each in every),
                sum(each.missed for each in every),
                sum(each.bursts for each in every),
                self._gate.buffer_free,
                max((claim.round_trips.grown_s for claim in self._gate.claims.values()), default=0.0),
            )

    def pace(self, up_bytes_s: float | None, setpoint_hz: float, copies: int = 1) -> None:
        """Limit sending from now on to this many bytes a second, and this many setpoints a second to each vehicle.

        Each setpoint is sent `copies` times at most.
        """
        with self._lock:
            signed = any(claim.signing is not None for claim in self._gate.claims.values())
        queue = self._queue or TransmitQueue()
        queue.bytes_s = inf if up_bytes_s is None else up_bytes_s
        queue.setpoint_hz, queue.copies = setpoint_hz, copies
        queue.extra_bytes = SIGNATURE_LENGTH if signed else 0
        self._queue = queue

    def send_heartbeats(self) -> None:
        """Send a heartbeat to every verified vehicle now."""
        self._shows_life = True
        self._thread.wake()

    def close(self) -> None:
        """End both connections; the port is free afterwards."""
        self._thread.remove(self)
        for each in (self._inner, self._listener, self._carrier, self._own_thread):
            if each is not None:
                each.close()

    def watched(self) -> tuple[int, ...]:
        """Return the file descriptors of both connections."""
        assert self._inner is not None
        return self._inner.descriptor, *self._carrier.watched()

    def due_s(self) -> float:
        """Return when the next waiting frame is due [s, monotonic]; infinity without one."""
        queue = self._queue
        return inf if queue is None else queue.due_s()

    def turn(self, readable: Container[int]) -> None:
        """Pass on what has arrived."""
        inner = self._inner
        assert inner is not None
        self._carrier.call_again()
        # Each system call releases the interpreter lock, and waits to acquire it again.
        sent = self._outbound(inner.read() or b"") if inner.descriptor in readable else []
        outgoing = self._paced([*sent, *self._requests(), *self._heartbeats()])
        for frame, address in (*self._signed_all(outgoing), *self._calls()):
            if not self._is_muted(frame):
                self._carrier.send(frame, address)
        arrives = any(descriptor in readable for descriptor in self._carrier.watched())
        received = list(self._carrier.receive()) if arrives else []
        for frames in (b"", *self._inbound(received)):
            inner.write(frames)

    def _is_vehicle(self, address: Address) -> bool:
        with self._lock:
            return self._gate.is_vehicle(address)

    def _is_muted(self, frame: bytes) -> bool:
        if header(frame).message != SETPOINT:
            return False
        claim = self._gate.claims.get(target_system(frame))
        return claim is not None and claim.muted

    def _inbound(self, received: Iterable[tuple[bytes, Address]]) -> list[bytes]:
        """Return the arrived frames that are passed to MAVSDK."""
        with self._lock:
            passed, self._again = self._again, []
            for data, address in received:
                self._down_bytes += len(data)
                if data:
                    passed.append(self._gate.admit(data, address, self._now_s()))
                else:
                    self._gate.gone(address)
        return passed

    def _outbound(self, data: bytes) -> list[Outgoing]:
        """Return MAVSDK's frames, each with the address of every vehicle that it is for."""
        frames = self._outgoing.feed(data)
        with self._lock:
            addresses = list(self._gate.peers())
            places = {each: [claim.address] for each, claim in self._gate.claims.items() if claim.address is not None}
        return [(frame, address) for frame in frames for address in places.get(target_system(frame), addresses)]

    def _paced(self, frames: list[Outgoing]) -> list[Outgoing]:
        """Return the frames to send now: these, or on a connection with a pace, those that are due."""
        queue = self._queue
        if queue is None:
            return frames
        for frame, address in frames:
            queue.put(frame, address)
        return queue.due(time.monotonic())

    def _signed_all(self, frames: list[Outgoing]) -> list[Outgoing]:
        """Return signed frames; they are signed last, so that signature times increase in the order of sending."""
        if not frames:
            return []
        with self._lock:
            peers = self._gate.peers()
            return [each for frame, address in frames for each in _signed(frame, address, peers.get(address, ()))]

    def _requests(self) -> list[Outgoing]:
        """Return the TIMESYNC requests that are due, one for each address: all vehicles there answer it."""
        now_s = self._now_s()
        if now_s < self._round_trip_next_s:
            return []
        self._round_trip_next_s = now_s + ROUND_TRIP_PERIOD_S
        self._round_trips += 1
        now_ns = round(now_s * 1e9)
        with self._lock:
            peers = self._gate.peers()
            for claim in (claim for claims in peers.values() for claim in claims):
                claim.round_trips.asked(now_ns)
        request = timesync_request(self._round_trips, now_ns)
        return [(request, address) for address in peers]

    def _heartbeats(self) -> list[Outgoing]:
        """Return the heartbeats that were requested."""
        if not self._shows_life:
            return []
        self._shows_life = False
        self._called += 1
        heartbeat = station_heartbeat(self._called)
        with self._lock:
            return [(heartbeat, address) for address in self._gate.peers()]

    def _calls(self) -> list[tuple[bytes, Address]]:
        """Return the heartbeats that are due to senders that are not verified yet, to which MAVSDK sends none.

        They go to the address that this end connects to, and to senders with the key whose time is behind.
        """
        if time.monotonic() < self._call_next_s:
            return []
        self._call_next_s = time.monotonic() + CALL_PERIOD_S
        self._called += 1
        heartbeat, known = station_heartbeat(self._called), self._carrier.known
        with self._lock:
            return [
                each
                for claim in self._gate.claims.values()
                for address in {*claim.to_set_in_time(), *([known] if known and claim.address is None else ())}
                for each in _signed(heartbeat, address, [claim])
            ]


def _signed(frame: bytes, address: Address, claims: Iterable[Claim]) -> Iterator[tuple[bytes, Address]]:
    """Yield a frame to an address, once for each key of the vehicles there."""
    for signing in {claim.signing for claim in claims}:
        if signing is None:
            yield frame, address
        elif frame[0] == MAGIC_V2:
            yield signing.sign(frame), address
