"""Orders and delays the frames to the vehicles of a connection: no more than it carries, important ones first.

A serial device or a radio accepts bytes faster than it sends them, and frames in its buffers are outdated when sent. So
frames wait here, where a newer setpoint replaces an older one. No clock and no sockets: times are arguments [s].
"""

from collections import deque
from math import inf

from gcs.link.relay.frames import COMMANDS, HEARTBEAT, SETPOINT, header, target_system
from gcs.link.relay.gate import Address

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
    is sent `setpoint_hz` times a second; MAVSDK repeats the last one more often. Vehicles take turns.
    """

    def __init__(self, bytes_s: float = inf, setpoint_hz: float = inf, extra_bytes: int = 0) -> None:
        self.bytes_s, self.setpoint_hz, self.extra_bytes = bytes_s, setpoint_hz, extra_bytes
        self.dropped = 0
        self._commands: deque[Outgoing] = deque()
        self._others: deque[Outgoing] = deque()
        self._setpoints: dict[tuple[int, Address], _Slot] = {}
        self._free_s = -inf
        """When the connection has sent all frames passed to it."""

    def put(self, frame: bytes, address: Address) -> None:
        """Add a frame to send."""
        message = header(frame).message
        if message == SETPOINT:
            self._setpoints.setdefault((target_system(frame), address), _Slot()).put(frame)
        elif message == HEARTBEAT or message in COMMANDS:
            self._commands.append((frame, address))
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

    def due_s(self, now_s: float) -> float:
        """Return when the next frame is due [s], infinity without one."""
        if self._commands or self._others:
            return max(self._free_s, now_s)
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
        return self._others.popleft() if self._others else None


class _Slot:
    """One vehicle's newest unsent setpoint, and when it may be sent."""

    def __init__(self) -> None:
        self._frame: bytes | None = None
        self._target = b""
        self._is_new = True
        self._next_s = -inf

    def put(self, frame: bytes) -> None:
        target = _target(frame)
        self._is_new = self._is_new or target != self._target
        self._frame, self._target = frame, target

    def due_s(self, period_s: float) -> float:
        if self._frame is None:
            return inf
        return self._next_s - (EARLY_SHARE * period_s if self._is_new else 0.0)

    def take(self, now_s: float, period_s: float) -> bytes:
        frame, self._frame, self._is_new = self._frame, None, False
        assert frame is not None
        planned_s = self._next_s + period_s
        self._next_s = planned_s if planned_s > now_s else now_s + period_s
        return frame


def _target(frame: bytes) -> bytes:
    """Return a setpoint without its header, its time, its checksum and its signature: equal in repetitions."""
    return frame[14:63]
