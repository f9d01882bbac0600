"""A peer whose clock is set while it flies dates all that it says otherwise than before: who does, and by how much."""

from dataclasses import dataclass

HEARD_WITHIN_S = 1.0
"""A peer that says nothing at all any more is silent, whatever its clock."""
_FOLLOWING = 0.1
"""The share by which the usual lag follows the present one: networks get slower and faster."""
_SETTLING_S = 5.0
"""How long after a peer's first message its usual lag is the reference for a slow drift."""


@dataclass(slots=True)
class Step:
    """A peer's clock off what was usual: since when, when it was heard last, and by how much it went ahead [wall s]."""

    since_s: float
    heard_s: float
    by_s: float


class ClockWatch:
    """Compares how old each peer's messages are with how old they usually are."""

    def __init__(self, limit_s: float) -> None:
        """Take how far off what is usual a message may be dated [wall s]."""
        self._limit_s = limit_s
        self._usual_s: dict[int, float] = {}
        self._reference_s: dict[int, tuple[float, float]] = {}
        self.off: dict[int, Step] = {}

    def hear(self, sender: int, age_s: float, now_s: float) -> None:
        """Take in how old [wall s] a peer's message was when it came, whether it was believed or not."""
        usual_s = self._usual_s.setdefault(sender, age_s)
        ahead_s = usual_s - age_s
        if abs(ahead_s) <= self._limit_s:
            self._usual_s[sender] = usual_s - _FOLLOWING * ahead_s
            if self.off:
                self.off.pop(sender, None)
        elif sender in self.off:
            self.off[sender].heard_s, self.off[sender].by_s = now_s, ahead_s
        else:
            self.off[sender] = Step(now_s, now_s, ahead_s)

    def drifted(self, now_s: float) -> dict[int, float]:
        """Return by how much clocks have gone ahead of their first messages [wall s], where that is beyond the limit.

        A drift too slow for the limit of a step adds up. To be called once in a while, first of all when peers are new.
        """
        drifted_s: dict[int, float] = {}
        for sender, usual_s in self._usual_s.items():
            settled_s, first_s = self._reference_s.get(sender, (now_s + _SETTLING_S, usual_s))
            if now_s <= settled_s:
                self._reference_s[sender] = settled_s, usual_s
            elif abs(first_s - usual_s) > self._limit_s:
                drifted_s[sender] = first_s - usual_s
        return drifted_s

    def stepped(self, now_s: float, time_scale: float) -> dict[int, Step]:
        """Return the peers that are off and still heard; those that fell silent are off no more."""
        self.off = {s: step for s, step in self.off.items() if now_s - step.heard_s <= HEARD_WITHIN_S * time_scale}
        return self.off
