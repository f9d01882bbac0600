"""Agreeing on the mission's start without a leader: everybody proposes, the earliest proposal holds."""

from collections import Counter
from collections.abc import Collection, Iterable

from agents.ports import VehicleRefusedError
from agents.team.messages import TOPICS, StartProposal

LEAD_TIME_S = 2.0
"""How far ahead a start is proposed: longer than a proposal takes to reach everybody."""
HEARD_LEAST = 5
CLOCK_OFFSET_LIMIT_S = 0.5
_AGE_MAX_S = TOPICS[StartProposal].age_max_s


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

    def unjudged(self, peers: Iterable[int]) -> list[int]:
        """Return which of `peers` have not been heard often enough yet."""
        return sorted(peer for peer in peers if self._count[peer] < HEARD_LEAST)

    def require_one_time(self) -> None:
        """Refuse to fly with a peer whose clock is another: what it says would be too old, or of tomorrow.

        Raises VehicleRefusedError.
        """
        for peer, lag_s in self.lags_s().items():
            if abs(lag_s) > CLOCK_OFFSET_LIMIT_S:
                side = "ahead of" if lag_s > 0.0 else "behind"
                raise VehicleRefusedError(
                    f"this computer's clock is {abs(lag_s):.2f} s {side} that of vehicle {peer}'s",
                    "let both computers' clocks be set by one time server (chrony, NTP), then fly again",
                )


class Assembly:
    """One vehicle's view of who is up and ready, and of the start agreed on.

    A vehicle that hears everybody ready proposes a start a lead time ahead; each takes the earliest it hears of. A
    member that falls silent before there is a proposal is waited for; afterwards the start stands.
    """

    def __init__(self, vehicle_id: int, members: Collection[int]) -> None:
        self._vehicle_id = vehicle_id
        self.others = frozenset(members) - {vehicle_id}
        self._heard_s: dict[int, float] = {}
        self._start_s: float | None = None

    @property
    def start_s(self) -> float | None:
        """The start agreed on so far, None until somebody has proposed one."""
        return self._start_s

    def missing(self, now_s: float) -> list[int]:
        """Return who has not been heard lately."""
        return sorted(i for i in self.others if now_s - self._heard_s.get(i, -_AGE_MAX_S) >= _AGE_MAX_S)

    def hear(self, message: StartProposal) -> None:
        """Take in a peer's readiness and proposal; who is not ready yet says nothing about the start."""
        if message.sender not in self.others or not message.ready:
            return
        self._heard_s[message.sender] = max(message.time_s, self._heard_s.get(message.sender, message.time_s))
        if message.start_s is not None:
            self._start_s = message.start_s if self._start_s is None else min(self._start_s, message.start_s)

    def speak(self, now_s: float, *, ready: bool = True) -> StartProposal:
        """Return what to tell the peers now."""
        if not ready:
            return StartProposal(self._vehicle_id, now_s, None, ready=False)
        if self._start_s is None and not self.missing(now_s):
            self._start_s = now_s + LEAD_TIME_S
        return StartProposal(self._vehicle_id, now_s, self._start_s)
