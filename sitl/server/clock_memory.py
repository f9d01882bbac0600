"""The layout of the shared memory of a governed clock."""

from mmap import mmap
from struct import Struct
from typing import Any

NEVER_US = 1 << 56
VERSION = 3
SEAT_BITS = 6
SEATS = 1 << SEAT_BITS
IDLE = NEVER_US << SEAT_BITS
"""The event of a seat that waits for none."""
VEHICLES = 256
"""Vehicles are identified by their ids modulo this."""
MOTION = Struct("<6f")
"""Position and velocity in a vehicle's NED."""
SETPOINT = Struct("<3f")
"""A position in a vehicle's NED."""
_WORD = 8
_MOTIONS = 16
"""How many motions of a vehicle may be under way before the oldest is forgotten."""


class ClockMemory:
    """The sections of the shared memory. Integers are written whole; only the participant that goes on writes `now`."""

    def __init__(self, buffer: mmap) -> None:
        self._buffer = buffer
        self._views: list[memoryview[Any]] = []
        self._used = 0
        self.version, self.now_us, self.begin_us = (self._integers(1) for _ in range(3))
        self.epoch_s, self.speed = self._section(_WORD).cast("d"), self._section(_WORD).cast("d")
        self._views += [self.epoch_s, self.speed]
        self.event, self.hung, self.serial, self.process, self.waits = (self._integers(SEATS) for _ in range(5))
        self._motions_sent, self._setpoints_sent, self.states_sent = (self._integers(VEHICLES) for _ in range(3))
        self._motion_us = self._integers(VEHICLES * _MOTIONS)
        self._motions = self._section(VEHICLES * _MOTIONS * MOTION.size)
        self._setpoints = self._section(VEHICLES * SETPOINT.size)

    @classmethod
    def size(cls) -> int:
        """Return its length [bytes]."""
        words = 5 + 5 * SEATS + 3 * VEHICLES + VEHICLES * _MOTIONS
        return words * _WORD + VEHICLES * (_MOTIONS * MOTION.size + SETPOINT.size)

    def motions(self, system_id: int) -> int:
        """Return how many motions a vehicle has sent."""
        return int(self._motions_sent[system_id])

    def send_motion(self, system_id: int, motion: bytes) -> None:
        """State that a vehicle sends a motion now."""
        sent = self.motions(system_id)
        place = system_id * _MOTIONS + sent % _MOTIONS
        self._motion_us[place] = self.now_us[0]
        self._motions[place * MOTION.size : (place + 1) * MOTION.size] = motion
        self._motions_sent[system_id] = sent + 1

    def find_motion(self, system_id: int, first: int, motion: bytes) -> tuple[int, int | None]:
        """Return which of a vehicle's motions, from the `first` on, is this one, and when it was sent; else None."""
        sent = self.motions(system_id)
        for number in range(max(first, sent - _MOTIONS), sent):
            place = system_id * _MOTIONS + number % _MOTIONS
            if self._motions[place * MOTION.size : (place + 1) * MOTION.size] == motion:
                return number, int(self._motion_us[place])
        return sent, None

    def send_setpoint(self, system_id: int, setpoint: bytes) -> None:
        """State that a vehicle is sent a setpoint now."""
        self._setpoints[system_id * SETPOINT.size : (system_id + 1) * SETPOINT.size] = setpoint
        self._setpoints_sent[system_id] += 1

    def newest_setpoint(self, system_id: int) -> tuple[int, bytes]:
        """Return how many setpoints a vehicle was sent, and the newest."""
        setpoint = self._setpoints[system_id * SETPOINT.size : (system_id + 1) * SETPOINT.size]
        return int(self._setpoints_sent[system_id]), bytes(setpoint)

    def _section(self, length: int) -> "memoryview[int]":
        view = memoryview(self._buffer)[self._used : self._used + length]
        self._used += length
        self._views.append(view)
        return view

    def _integers(self, count: int) -> "memoryview[int]":
        view = self._section(count * _WORD).cast("q")
        self._views.append(view)
        return view

    def close(self) -> None:
        """Release the memory."""
        for view in reversed(self._views):
            view.release()
        self._buffer.close()
