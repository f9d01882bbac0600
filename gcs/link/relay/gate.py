"""Decides which frames of a connection are passed on: only those of verified vehicles, from the address of each.

No sockets and no clock: addresses, bytes and times are arguments.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from statistics import median

from gcs.link.rates import LOCAL_POSITION_NED
from gcs.link.relay.frames import (
    AUTOPILOT_COMPONENT,
    HEAD_V2,
    FrameStream,
    buffer_free,
    custom_mode,
    estimator_resets,
    header,
    is_autopilot_heartbeat,
    is_failsafe,
    is_hil,
    sequence,
    timesync_answer,
)
from gcs.link.relay.signing import SignatureCheck, Signing

DOUBLED_MIN, DOUBLED_SHARE = 5, 0.1
"""This many steps backwards show two senders: a restart is one step, and networks swap and repeat few frames."""


class Sequences:
    """Counts the frames of one system, separately for each of its components."""

    def __init__(self) -> None:
        self.received = 0
        self.missed = 0
        self.bursts = 0
        """How often some were missed in a row."""
        self._back = 0
        self._last: dict[int, int] = {}

    @property
    def is_doubled(self) -> bool:
        """Whether two senders use the id: the numbers jump back and forth."""
        return self._back >= max(DOUBLED_MIN, DOUBLED_SHARE * self.received)

    def take(self, component: int, number: int) -> None:
        """Add the number of a frame."""
        self.received += 1
        step = (number - self._last.get(component, number - 1)) % 256
        self._last[component] = number
        if 0 < step < 128:
            self.missed += step - 1
            self.bursts += step > 1
        else:
            self._back += 1


KEPT = 15
"""Number of round trips in the median: half a minute of them."""
NEWEST = 3
"""Number of those that show a growth."""
PENDING = 16


class RoundTrips:
    """Measures round trips: each answer returns the time of its request."""

    def __init__(self) -> None:
        self._asked_ns: deque[int] = deque(maxlen=PENDING)
        self._newest_s: deque[float] = deque(maxlen=KEPT)
        self._shortest_s = inf

    @property
    def grown_s(self) -> float:
        """By how much the newest round trips are longer than the shortest [wall s]: messages wait somewhere."""
        newest_s = list(self._newest_s)[-NEWEST:]
        return median(newest_s) - self._shortest_s if len(newest_s) == NEWEST else 0.0

    @property
    def median_s(self) -> float | None:
        """The median of the newest round trips [wall s]; None before the first."""
        return median(self._newest_s) if self._newest_s else None

    def asked(self, time_ns: int) -> None:
        """Note a request that has been sent."""
        self._asked_ns.append(time_ns)

    def answered(self, asked_ns: int, now_ns: int) -> bool:
        """Note an answer; return whether it is the first one to a request of this computer."""
        if asked_ns not in self._asked_ns:
            return False
        self._asked_ns.remove(asked_ns)
        self._newest_s.append((now_ns - asked_ns) * 1e-9)
        self._shortest_s = min(self._shortest_s, self._newest_s[-1])
        return True


SILENCE_S = 3.0
"""The link's timeout, as MAVSDK's: a vehicle may continue from another address only after this silence [wall s]."""
REPEAT_AFTER_S, REPEAT_FOR_S, BREAK_S = 1.5, 10.0, 1.0
"""MAVSDK reports a vehicle as lost after 3 s without a heartbeat, even while other messages arrive. A radio sometimes
loses two of the heartbeats in a row, which come once a second. So the newest is repeated then, if it is recent enough.
After a break without any message it is not repeated: its flight mode may be out of date.
"""
ADDRESSES_MAX = 16
"""Most senders that are counted by address; frames of further ones are counted together."""
OTHER_ADDRESS = "other address"
"""Why a frame with a vehicle's system id is dropped, beside the verdicts on its signature."""

Address = tuple[object, ...]
"""A host and its port, as the socket states them; a serial device and its rate."""


def shown(address: Address) -> str:
    """Return an address as text."""
    return f"{address[0]}:{address[1]}"


@dataclass(frozen=True, slots=True)
class LinkReport:
    """Counts of what arrived with the system id of one vehicle.

    `address` is the verified one, `impostors` others that used the same system id, with their number of frames;
    `moves` are the addresses from which the vehicle continued after a silence; `dropped` counts frames by reason.
    `doubled`: two vehicles send with this system id from one address, so that sequence numbers jump back and forth.
    `hil`: the newest heartbeat has the flag of a simulated body. `failsafe`: a failsafe of the autopilot began with the
    newest change of the flight mode; if it acted before, someone else may have changed it.
    `round_trip_s` is the time from a request to its answer [wall s], None before the first answer.
    `estimator_resets` is the newest count of its estimator's resets, None where none is sent.
    """

    address: str = ""
    signed: bool = False
    impostors: Mapping[str, int] = field(default_factory=dict)
    moves: tuple[str, ...] = ()
    dropped: Mapping[str, int] = field(default_factory=dict)
    doubled: bool = False
    hil: bool = False
    round_trip_s: float | None = None
    estimator_resets: int | None = None
    failsafe: bool = False


class Claim:
    """A system id on a connection: the senders that use it, and once verified, the only address that counts.

    Before verification `candidates` holds the newest heartbeat of each autopilot with this id, by address, and
    `rejected` the verdict on those that are not authentic.
    """

    def __init__(self, signing: Signing | None = None) -> None:
        self.signing = signing
        self.address: Address | None = None
        self.muted = False
        """Whether setpoints to it are dropped."""
        self.listeners: Mapping[int, Callable[[bytes], object]] = {}
        """What receives the autopilot's frames with these messages, at once."""
        self.candidates: dict[Address, bytes] = {}
        self.rejected: dict[Address, SignatureCheck] = {}
        self._received_s = -inf
        self.heartbeat = b""
        """The newest of the verified sender."""
        self._heartbeat_s = self._passed_s = -inf
        self._impostors: Counter[Address] = Counter()
        self._moves: list[Address] = []
        self._dropped: Counter[str] = Counter()
        self.sequences = Sequences()
        self.messages: Counter[int] = Counter()
        """How many of each number have arrived. Both count the frames from the verified address."""
        self.round_trips = RoundTrips()
        self._hil = self._is_failsafe = self._changed_by_failsafe = False
        self._mode: int | None = None
        self._estimator_resets: int | None = None

    def admits(self, frame: bytes, address: Address, now_s: float) -> bool:
        """Return whether a frame with this system id is the vehicle's, and for MAVSDK."""
        if self.address is None:
            self._consider(frame, address)
            return False
        moves = address != self.address
        if moves and not self.may_move(address, now_s):
            self.count_impostor(address)
            return False
        verdict = self._verdict(frame)
        if moves and is_autopilot_heartbeat(frame):
            self._move(address, verdict)
        if verdict is not SignatureCheck.AUTHENTIC or address != self.address:
            return False
        if now_s - self._received_s > BREAK_S:
            self.heartbeat = b""
        self._received_s = now_s
        head = header(frame)
        self.sequences.take(head.component, sequence(frame))
        self.messages[head.message] += 1
        if is_autopilot_heartbeat(frame):
            self._take_mode(frame)
            self.heartbeat, self._heartbeat_s = frame, now_s
            self._passed_s = now_s
        if (resets := estimator_resets(frame)) is not None:
            self._estimator_resets = resets
        listener = self.listeners.get(head.message) if head.component == AUTOPILOT_COMPONENT else None
        if listener is not None:
            listener(frame)
            return head.message != LOCAL_POSITION_NED  # the most frequent: MAVSDK needs it for nothing else
        asked_ns = timesync_answer(frame)
        return asked_ns is None or not self.round_trips.answered(asked_ns, round(now_s * 1e9))

    def repeated(self, now_s: float) -> bytes:
        """Return the newest heartbeat if it must be repeated, because other messages of the vehicle arrive."""
        is_received, since_s = now_s == self._received_s, now_s - self._heartbeat_s
        if not is_received or since_s > REPEAT_FOR_S or now_s - self._passed_s < REPEAT_AFTER_S:
            return b""
        self._passed_s = now_s
        return self.heartbeat

    def verify(self, address: Address, now_s: float) -> bytes:
        """Accept and address only this sender from now on; return its newest heartbeat."""
        self.address, self._received_s = address, now_s
        self.heartbeat = self.candidates.pop(address, b"")
        return self.heartbeat

    def gone(self, address: Address) -> None:
        """Note that the connection to an address has ended: its vehicle may continue from another one at once."""
        self.candidates.pop(address, None)
        if address == self.address:
            self._received_s = -inf

    def may_move(self, address: Address, now_s: float) -> bool:
        """Return whether the vehicle may continue from another address: after silence, and unsigned on its host only.

        A simulator restarts on another port of its host. A radio that reconnects may have another host's address, and
        then only a signature shows that it is the same vehicle.
        """
        same_host = self.address is not None and address[0] == self.address[0]
        return now_s - self._received_s > SILENCE_S and (self.signing is not None or same_host)

    def count_impostor(self, address: Address) -> None:
        """Count a frame that was dropped for its address."""
        self._dropped[OTHER_ADDRESS] += 1
        if address in self._impostors or len(self._impostors) < ADDRESSES_MAX:
            self._impostors[address] += 1

    def to_set_in_time(self) -> list[Address]:
        """Return the candidates with the key and a time that is behind: a signed heartbeat sets a vehicle's time."""
        return [address for address, verdict in self.rejected.items() if verdict is SignatureCheck.OLD]

    def report(self) -> LinkReport:
        """Return the counts so far."""
        return LinkReport(
            "" if self.address is None else shown(self.address),
            self.signing is not None,
            {shown(address): frames for address, frames in self._impostors.items()},
            tuple(map(shown, self._moves)),
            dict(self._dropped),
            self.sequences.is_doubled,
            self._hil,
            self.round_trips.median_s,
            self._estimator_resets,
            self._changed_by_failsafe,
        )

    def _take_mode(self, heartbeat: bytes) -> None:
        was_failsafe, self._is_failsafe = self._is_failsafe, is_failsafe(heartbeat)
        before, self._mode = self._mode, custom_mode(heartbeat)
        if self._mode != before:
            self._changed_by_failsafe = self._is_failsafe and not was_failsafe
        self._hil = is_hil(heartbeat)

    def _move(self, address: Address, verdict: SignatureCheck) -> None:
        if verdict is SignatureCheck.AUTHENTIC:
            self.address = address
            self._moves.append(address)
            self.rejected.clear()
        else:
            self._reject(address, verdict)

    def _reject(self, address: Address, verdict: SignatureCheck) -> None:
        """Note a verdict; those on senders with the key replace others."""
        if address not in self.rejected and len(self.rejected) >= ADDRESSES_MAX:
            without_key = (each for each, other in self.rejected.items() if other is not SignatureCheck.OLD)
            replaced = next(without_key, None) if verdict is SignatureCheck.OLD else None
            if replaced is None:
                return
            del self.rejected[replaced]
        self.rejected[address] = verdict

    def _consider(self, frame: bytes, address: Address) -> None:
        if not is_autopilot_heartbeat(frame):
            return
        verdict = self._verdict(frame)
        if verdict is SignatureCheck.AUTHENTIC:
            self.rejected.pop(address, None)
            if address in self.candidates or len(self.candidates) < ADDRESSES_MAX:
                self.candidates[address] = frame
        elif address not in self.candidates:
            self._reject(address, verdict)

    def _verdict(self, frame: bytes) -> SignatureCheck:
        verdict = SignatureCheck.AUTHENTIC if self.signing is None else self.signing.verify(frame)
        if verdict is not SignatureCheck.AUTHENTIC:
            self._dropped[verdict.value] += 1
        return verdict


class FrameGate:
    """The claims on one connection, and the frames that arrive there. `others` are system ids without a claim.

    `buffer_free` is the free share of the radio's transmit buffer, by its newest RADIO_STATUS.
    """

    def __init__(self) -> None:
        self.claims: dict[int, Claim] = {}
        self.others: set[int] = set()
        self.buffer_free: float | None = None
        self._streams: dict[Address, FrameStream] = {}

    def admit(self, data: bytes, address: Address, now_s: float) -> bytes:
        """Return the frames among `data` that are passed on."""
        if self._is_unverified(address, now_s):
            self._count_unverified(data, address)
            return b""
        frames = self._stream(address).feed(data)
        passed = [frame for frame in frames if self._admits(frame, address, now_s)]
        return b"".join((*passed, *(claim.repeated(now_s) for claim in self.claims.values() if frames)))

    def gone(self, address: Address) -> None:
        """Note that the connection to an address has ended."""
        self._streams.pop(address, None)
        for claim in self.claims.values():
            claim.gone(address)

    def is_vehicle(self, address: Address) -> bool:
        """Return whether a vehicle is at an address, or one that may be verified or set in time."""
        return any(
            address == claim.address or address in claim.candidates or address in claim.to_set_in_time()
            for claim in self.claims.values()
        )

    def peers(self) -> dict[Address, list[Claim]]:
        """Return the verified addresses, and the claims of each."""
        peers: dict[Address, list[Claim]] = {}
        for claim in self.claims.values():
            if claim.address is not None:
                peers.setdefault(claim.address, []).append(claim)
        return peers

    def _is_unverified(self, address: Address, now_s: float) -> bool:
        """Return whether no frame from this address can be accepted: then its bytes are not parsed."""
        return all(
            claim.address not in (None, address) and not claim.may_move(address, now_s)
            for claim in self.claims.values()
        )

    def _count_unverified(self, data: bytes, address: Address) -> None:
        claim = self.claims.get(header(data).system_id) if len(data) >= HEAD_V2 else None
        if claim is not None:
            claim.count_impostor(address)

    def _stream(self, address: Address) -> FrameStream:
        stream = self._streams.get(address)
        if stream is None:
            stream = FrameStream()
            if len(self._streams) < ADDRESSES_MAX or any(address == each.address for each in self.claims.values()):
                self._streams[address] = stream
        return stream

    def _admits(self, frame: bytes, address: Address, now_s: float) -> bool:
        system_id = header(frame).system_id
        claim = self.claims.get(system_id)
        if claim is not None:
            return claim.admits(frame, address, now_s)
        if is_autopilot_heartbeat(frame):
            self.others.add(system_id)
        elif (free := buffer_free(frame)) is not None:
            self.buffer_free = free
        return False
