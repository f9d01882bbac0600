"""Agreeing on the mission's start without a leader: everybody proposes, the earliest proposal holds."""

from collections import Counter
from collections.abc import Collection

from agents.messages import TOPICS, Muster

LEAD_TIME_S = 2.0
"""How far ahead a start is proposed: longer than a proposal takes to reach everybody."""
HEARD_LEAST = 5
_AGE_MAX_S = TOPICS[Muster].age_max_s


class PeerClocks:
    """How far the clocks of the peers' computers are behind one's own, by the messages that they date.

    No message takes less than no time: the least lag of several is nearest to the clocks' offset.
    """

    def __init__(self) -> None:
        self._least_s: dict[int, float] = {}
        self._count: Counter[int] = Counter()

    def hear(self, sender: int, lag_s: float) -> None:
        """Take in how old a peer's message was when it came, in seconds of the wall's clock."""
        self._count[sender] += 1
        self._least_s[sender] = min(lag_s, self._least_s.get(sender, lag_s))

    def lags_s(self) -> dict[int, float]:
        """Return the least lag by peer, of those that have been heard often enough to be judged."""
        return {sender: lag_s for sender, lag_s in self._least_s.items() if self._count[sender] >= HEARD_LEAST}


class Assembly:
    """One vehicle's view of who is up and ready, and of the start agreed on.

    A vehicle that hears everybody ready proposes a start a lead time ahead; each takes the earliest it hears of. A
    member that falls silent before there is a proposal is waited for; afterwards the start stands.
    """

    def __init__(self, vehicle_id: int, members: Collection[int]) -> None:
        self._vehicle_id = vehicle_id
        self._others = frozenset(members) - {vehicle_id}
        self._heard_s: dict[int, float] = {}
        self._start_s: float | None = None

    @property
    def start_s(self) -> float | None:
        """The start agreed on so far, None until somebody has proposed one."""
        return self._start_s

    def missing(self, now_s: float) -> list[int]:
        """Return who has not been heard lately."""
        return sorted(i for i in self._others if now_s - self._heard_s.get(i, -_AGE_MAX_S) >= _AGE_MAX_S)

    def hear(self, message: Muster) -> None:
        """Take in a peer's readiness and proposal."""
        if message.sender not in self._others:
            return
        self._heard_s[message.sender] = max(message.time_s, self._heard_s.get(message.sender, message.time_s))
        if message.start_s is not None:
            self._start_s = message.start_s if self._start_s is None else min(self._start_s, message.start_s)

    def speak(self, now_s: float) -> Muster:
        """Return what to tell the peers now."""
        if self._start_s is None and not self.missing(now_s):
            self._start_s = now_s + LEAD_TIME_S
        return Muster(self._vehicle_id, now_s, self._start_s)
