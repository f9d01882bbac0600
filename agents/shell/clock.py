"""The clock that all agents of a team share: seconds since 1970, at `speed` times the wall clock's rate."""

import time


class MissionClock:
    """Mission-clock seconds, equal in every process of a computer, and monotonic."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        # Read once, because the wall clock may be set in flight.
        self._offset_s = time.time() - time.monotonic()

    def set_speed(self, speed: float) -> None:
        """Set the speed once it has been measured, before any flight uses this clock."""
        self.speed = speed

    def now_s(self) -> float:
        """Return the present time."""
        return (time.monotonic() + self._offset_s) * self.speed
