"""The protocol between a flying process and its supervisor, and when a vehicle's control loop counts as dead.

Each holds one end of a socket pair; the flying process finds the number of its end in the environment. The flying
process sends the heartbeats of the vehicles' agents, one small record each, and the vehicles' newest positions; the
supervisor sends its own heartbeat and the operator's requests to end.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntEnum
from math import ceil, isnan, nan
from struct import Struct

from gcs.metrics.ending import Unaccounted

HEARTBEAT_VARIABLE = "CORDON_HEARTBEAT"
"""The environment variable that makes a process the flying one: the number of its end of the socket pair."""
POLL_PERIOD_S = 0.1
SILENCE_MIN_S = 0.6
"""Shorter silences of a control loop are tolerated. With PX4's offboard timeout (1.1 s): out of offboard in 2 s."""
OVERDUE_MAX_S = 0.3
"""How late the tick of a slow loop may be."""
ALIVE, STOP, JOINED = b".", b"!", b"+"
"""What the supervisor sends: its heartbeat, the operator's request to end, and that it has joined the clock."""

_RECORD = Struct("!BBI")
_POSITION = Struct("!6d")
"""After the record of a position: when it was received [s of the computer's monotonic clock], and where."""
_NUMBER_MAX = 0xFFFFFFFF


class Beat(IntEnum):
    """The content of a record.

    An agent is about to take off, its control loop ticked, or it has ended; or silence is from now on measured on the
    governed clock of this number, or on the wall's again; or a vehicle is unaccounted for; or its newest position.
    """

    RISING = 1
    TICK = 2
    ENDED = 3
    GOVERNED = 4
    UNGOVERNED = 5
    UNACCOUNTED = 6
    POSITION = 7


def encode_beat(beat: Beat, vehicle_id: int = 0, due_s: float = 0.0) -> bytes:
    """Return a record; `due_s` is the time until the next tick is due [s of the link]."""
    return _RECORD.pack(beat, vehicle_id, min(round(due_s * 1000.0), _NUMBER_MAX))


def encode_clock(number: int | None) -> bytes:
    """Return the record of the clock that silence is measured on from now on; None for the wall's."""
    return _RECORD.pack(Beat.UNGOVERNED if number is None else Beat.GOVERNED, 0, number or 0)


def encode_position(last: Unaccounted, now_s: float) -> bytes:
    """Return the record of a vehicle's newest position; `now_s` is the time [s of the computer's monotonic clock]."""
    assert last.position_m is not None
    assert last.age_s is not None
    place = [nan if each is None else each for each in (last.latitude_deg, last.longitude_deg)]
    return _RECORD.pack(Beat.POSITION, last.vehicle, 0) + _POSITION.pack(now_s - last.age_s, *place, *last.position_m)


@dataclass(slots=True)
class _Watched:
    """A ticking control loop: the allowed and the present number of polls in a row without a tick."""

    timeout_polls: int
    silent_polls: int = 0
    ticked: bool = True


class LoopMonitor:
    """Follows which vehicles fly and which control loops have stopped ticking.

    Silence is counted in polls, not in seconds: while the whole computer stalls, the monitor does not poll either.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._rising: set[int] = set()
        self._watched: dict[int, _Watched] = {}
        self._unaccounted: set[int] = set()
        self._positions: dict[int, tuple[float, Unaccounted]] = {}
        self.has_flown = False
        self.clock: int | None = None
        """The number of the governed clock that polls follow, None for the wall's."""

    @property
    def flying(self) -> tuple[int, ...]:
        """The vehicles that have begun to take off and have not ended."""
        return tuple(sorted(self._rising | set(self._watched)))

    @property
    def unaccounted(self) -> tuple[int, ...]:
        """The vehicles that are unaccounted for although their flights have ended."""
        return tuple(sorted(self._unaccounted))

    def last_seen(self, vehicles: Iterable[int], now_s: float) -> tuple[Unaccounted, ...]:
        """Return vehicles with their newest positions at a time [s of the computer's monotonic clock]."""
        return tuple(self._last_seen(vehicle_id, now_s) for vehicle_id in vehicles)

    def _last_seen(self, vehicle_id: int, now_s: float) -> Unaccounted:
        if vehicle_id not in self._positions:
            return Unaccounted(vehicle_id)
        received_s, last = self._positions[vehicle_id]
        return replace(last, age_s=now_s - received_s)

    def receive(self, data: bytes) -> None:
        """Take the bytes received, which may end within a record; raises ValueError for an unknown record."""
        self._rest += data
        while len(self._rest) >= _RECORD.size:
            kind, vehicle_id, number = _RECORD.unpack_from(self._rest)
            beat = Beat(kind)
            size = _RECORD.size + (_POSITION.size if beat is Beat.POSITION else 0)
            if len(self._rest) < size:
                return
            record, self._rest = self._rest[:size], self._rest[size:]
            if beat in (Beat.GOVERNED, Beat.UNGOVERNED):
                self.clock = number if beat is Beat.GOVERNED else None
            elif beat is Beat.UNACCOUNTED:
                self._unaccounted.add(vehicle_id)
            elif beat is Beat.POSITION:
                self._positions[vehicle_id] = _position(vehicle_id, record)
            else:
                self._take(beat, vehicle_id, number / 1000.0)

    def poll(self) -> dict[int, float]:
        """Count a poll; return the vehicles whose control loop is dead, with how long it has been silent [s]."""
        for one in self._watched.values():
            one.silent_polls = 0 if one.ticked else one.silent_polls + 1
            one.ticked = False
        return {
            vehicle_id: one.silent_polls * POLL_PERIOD_S
            for vehicle_id, one in sorted(self._watched.items())
            if one.silent_polls >= one.timeout_polls
        }

    def _take(self, beat: Beat, vehicle_id: int, due_s: float) -> None:
        self.has_flown = True
        self._rising.discard(vehicle_id)
        if beat is Beat.RISING:
            self._rising.add(vehicle_id)
            self._unaccounted.discard(vehicle_id)
        elif beat is Beat.TICK:
            self._watched[vehicle_id] = _Watched(_timeout_polls(due_s))
        else:
            self._watched.pop(vehicle_id, None)


def _position(vehicle_id: int, record: bytes) -> tuple[float, Unaccounted]:
    received_s, *place, x, y, z = _POSITION.unpack_from(record, _RECORD.size)
    latitude_deg, longitude_deg = (None if isnan(each) else each for each in place)
    return received_s, Unaccounted(vehicle_id, latitude_deg, longitude_deg, (x, y, z))


def _timeout_polls(due_s: float) -> int:
    timeout_s = max(SILENCE_MIN_S, due_s + OVERDUE_MAX_S)
    return ceil(timeout_s / POLL_PERIOD_S - 1e-6)
