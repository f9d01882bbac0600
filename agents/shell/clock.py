"""The clock that all agents of a team share: seconds since 1970, passing `speed` times as fast as the wall's."""

import time


class MissionClock:
    """Mission-clock seconds; equal in every process of a machine, and never running backwards."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        # The wall clock may be set while flying: it is read once.
        self._offset_s = time.time() - time.monotonic()

    def set_speed(self, speed: float) -> None:
        """Run at another speed from now on: before anything flies by this clock, once the speed has been measured."""
        self.speed = speed

    def now_s(self) -> float:
        """Return the present time."""
        return (time.monotonic() + self._offset_s) * self.speed
