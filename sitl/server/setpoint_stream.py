"""The setpoints that a client streams to a stub without taking part in its clock."""

import os
import time
from collections.abc import Callable

from sitl.server.wall_limit import WallLimit

STREAM_AGE_MAX_S = 0.5
"""The age of the newest setpoint, on the clock, at which the time waits for the next: half of PX4's COM_OF_LOSS_T."""
LOST_AFTER_S, LOST_LONGEST_S = 3.0, 10.0
"""Wall time without a setpoint after which the stream has ended: by itself, and where the processor lacks."""


class SetpointStream:
    """Implements `sitl.server.governed_clock.Arriving` for a stream that is to go on.

    Once it has ended, none is waited for until a setpoint has arrived again.
    """

    def __init__(self, age_s: Callable[[], float]) -> None:
        """Take what returns the age of the newest setpoint on the clock, 0 if none is needed."""
        self._age_s = age_s
        self._ended = False
        self._waits: WallLimit | None = None

    def arrived(self) -> bool:
        """Return whether the time may go on."""
        if self._age_s() < STREAM_AGE_MAX_S:
            self._ended, self._waits = False, None
        elif not self._ended:
            wall_s = time.monotonic()
            self._waits = self._waits or WallLimit(LOST_AFTER_S, LOST_LONGEST_S, os.getpid(), wall_s)
            self._ended = self._waits.is_over(wall_s)
            return self._ended
        return True

    def forget(self) -> None:
        """Wait on: a stream has gaps that are longer than a message takes."""
