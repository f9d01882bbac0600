"""What a flying process and its supervisor tell each other, and when a vehicle's control loop counts as dead.

The flying process holds one end of a socket pair, whose number it finds in the environment, its supervisor the other.
Signs of life go up, one small record each; the supervisor's own sign of life and the operator's wish to end go down.
"""

from dataclasses import dataclass
from enum import IntEnum
from math import ceil
from struct import Struct

LIFELINE = "CORDON_LIFELINE"
"""The environment variable that makes a process the flying one."""
POLL_PERIOD_S = 0.1
SILENCE_MIN_S = 0.6
"""Shorter silences of a control loop are none: with PX4's offboard timeout of 1.1 s, out of offboard within 2 s."""
OVERDUE_MAX_S = 0.3
"""How much later than it was due a slow loop's tick may come."""
ALIVE, STOP = b".", b"!"
"""What the supervisor says: that it is there, and that the operator wants to end."""

_RECORD = Struct("!BBH")
_DUE_MAX_MS = 0xFFFF


class Sign(IntEnum):
    """What a vehicle's agent shows: it is about to take off, its control loop ticked, it has come down."""

    RISING = 1
    TICK = 2
    ENDED = 3


def encode_sign(sign: Sign, vehicle_id: int, due_s: float = 0.0) -> bytes:
    """Return a record; `due_s` is when the next tick is due [wall s]."""
    return _RECORD.pack(sign, vehicle_id, min(round(due_s * 1000.0), _DUE_MAX_MS))


@dataclass(slots=True)
class _Watched:
    """A ticking control loop: how many polls in a row may pass without a tick of it, and how many have."""

    patience_polls: int
    silent_polls: int = 0
    heard: bool = True


class Vigil:
    """Knows who flies and whose control loop has fallen silent.

    Silence is counted in polls, not in seconds: while the whole machine stalls, nobody polls.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._rising: set[int] = set()
        self._watched: dict[int, _Watched] = {}
        self.has_flown = False

    @property
    def flying(self) -> tuple[int, ...]:
        """The vehicles that have begun to take off and have not ended."""
        return tuple(sorted(self._rising | set(self._watched)))

    def hear(self, data: bytes) -> None:
        """Take what has arrived, which may end within a record; raises ValueError for what is no sign."""
        data = self._rest + data
        whole = len(data) - len(data) % _RECORD.size
        self._rest = data[whole:]
        for kind, vehicle_id, due_ms in _RECORD.iter_unpack(data[:whole]):
            self._take(Sign(kind), vehicle_id, due_ms / 1000.0)

    def poll(self) -> dict[int, float]:
        """Count a poll; return the vehicles whose control loop is dead, with how long it has been silent [s]."""
        for one in self._watched.values():
            one.silent_polls = 0 if one.heard else one.silent_polls + 1
            one.heard = False
        return {
            vehicle_id: one.silent_polls * POLL_PERIOD_S
            for vehicle_id, one in sorted(self._watched.items())
            if one.silent_polls >= one.patience_polls
        }

    def _take(self, sign: Sign, vehicle_id: int, due_s: float) -> None:
        self.has_flown = True
        self._rising.discard(vehicle_id)
        if sign is Sign.RISING:
            self._rising.add(vehicle_id)
        elif sign is Sign.TICK:
            self._watched[vehicle_id] = _Watched(_patience_polls(due_s))
        else:
            self._watched.pop(vehicle_id, None)


def _patience_polls(due_s: float) -> int:
    patience_s = max(SILENCE_MIN_S, due_s + OVERDUE_MAX_S)
    return ceil(patience_s / POLL_PERIOD_S - 1e-6)
