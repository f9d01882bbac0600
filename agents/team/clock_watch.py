"""Detects clock steps and drifts of peers from the ages of their messages."""

from dataclasses import dataclass
from typing import Final

STEP_S: Final = 0.5
"""A larger deviation from the usual age is a step [wall s]: above jitter, below what makes peers' plans invalid."""
RECEIVED_WITHIN_S: Final = 1.0
"""A peer without messages for this long is silent, not one with a stepped clock."""
_FOLLOWING: Final = 0.1
"""The share by which the usual age follows the present one, because networks get slower and faster."""
_SETTLING_S: Final = 5.0
"""The usual age this long after a peer's first message is the reference for slow drifts."""


@dataclass(slots=True)
class ClockStep:
    """A clock step of a peer: its begin, the time of the last message, and how far the clock went ahead [wall s]."""

    since_s: float
    received_s: float
    by_s: float


class ClockWatch:
    """Compares the age of each peer's messages with their usual age."""

    def __init__(self) -> None:
        self._usual_s: dict[int, float] = {}
        self._reference_s: dict[int, tuple[float, float]] = {}
        self.off: dict[int, ClockStep] = {}

    def receive(self, sender: int, age_s: float, now_s: float) -> None:
        """Take the age [wall s] of a peer's message on arrival, whether it was accepted or not."""
        usual_s = self._usual_s.get(sender, age_s)
        ahead_s = usual_s - age_s
        if abs(ahead_s) <= STEP_S:
            self._usual_s[sender] = usual_s - _FOLLOWING * ahead_s
            if self.off:
                self.off.pop(sender, None)
        elif sender in self.off:
            self.off[sender].received_s, self.off[sender].by_s = now_s, ahead_s
        else:
            self.off[sender] = ClockStep(now_s, now_s, ahead_s)

    def drifted(self, now_s: float) -> dict[int, float]:
        """Return how far clocks have drifted ahead since their first messages [wall s], where that exceeds the limit.

        It detects drifts that are too slow to be steps. To be called periodically, first when peers are new.
        """
        drifted_s: dict[int, float] = {}
        for sender, usual_s in self._usual_s.items():
            settled_s, first_s = self._reference_s.get(sender, (now_s + _SETTLING_S, usual_s))
            if now_s <= settled_s:
                self._reference_s[sender] = settled_s, usual_s
            elif abs(first_s - usual_s) > STEP_S:
                drifted_s[sender] = first_s - usual_s
        return drifted_s

    def stepped(self, now_s: float, time_scale: float) -> dict[int, ClockStep]:
        """Return the peers whose clocks have stepped and that are still received."""
        self.off = {
            s: step for s, step in self.off.items() if now_s - step.received_s <= RECEIVED_WITHIN_S * time_scale
        }
        return self.off
