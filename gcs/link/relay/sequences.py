"""The sequence numbers of a vehicle's frames: the number of lost frames, and whether two senders use one id."""

DOUBLED_MIN, DOUBLED_SHARE = 5, 0.1
"""This many steps backwards show two senders: a restart is one step, and networks swap and repeat few frames."""


class Sequences:
    """Counts the frames of one system, separately for each of its components."""

    def __init__(self) -> None:
        self.received = 0
        self.missed = 0
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
        else:
            self._back += 1
