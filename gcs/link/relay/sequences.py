"""The sequence numbers of a vehicle's frames: how many were lost, and whether one sender alone counts them."""

DOUBLED_MIN, DOUBLED_SHARE = 5, 0.1
"""Steps that are not forwards show two senders: a restart is one, and networks swap and double few frames."""


class Sequences:
    """Counts the frames of one system, each of its components by itself."""

    def __init__(self) -> None:
        self.received = 0
        self.missed = 0
        self._back = 0
        self._last: dict[int, int] = {}

    @property
    def is_doubled(self) -> bool:
        """Whether two senders count: their numbers go forth and back."""
        return self._back >= max(DOUBLED_MIN, DOUBLED_SHARE * self.received)

    def take(self, component: int, number: int) -> None:
        """Take the number of a frame."""
        self.received += 1
        step = (number - self._last.get(component, number - 1)) % 256
        self._last[component] = number
        if 0 < step < 128:
            self.missed += step - 1
        else:
            self._back += 1
