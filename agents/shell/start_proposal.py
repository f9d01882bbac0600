"""The start agreement without a leader: each vehicle may propose a start, and the earliest proposal is used."""

from collections import Counter
from collections.abc import Collection, Iterable
from math import ceil

from agents.ports import VehicleRefusedError
from agents.team.messages import TOPICS, StartProposal

LEAD_TIME_S = 2.0
"""The lead time of a proposed start: longer than a proposal takes to reach all members."""
GRID_S = 1.0
"""Missions start at whole seconds: ticks and samples then come at the same times of the mission in each flight."""
SAMPLES_MIN = 5
CLOCK_OFFSET_LIMIT_S = 0.5
_AGE_MAX_S = TOPICS[StartProposal].age_max_s


def is_possible(message: StartProposal, now_s: float, duration_s: float) -> bool:
    """Return whether a message proposes no start, or one with which the mission is not over at `now_s`.

    A new proposal is one lead time ahead; its time stamp may be wrong by up to `_AGE_MAX_S`.
    """
    start_s = message.start_s
    return start_s is None or now_s - duration_s <= start_s <= now_s + LEAD_TIME_S + GRID_S + _AGE_MAX_S


class PeerClocks:
    """The offsets of the peers' clocks, from the ages of their messages.

    Transmission times are not negative: the smallest age of several messages is nearest to the clocks' offset.
    """

    def __init__(self) -> None:
        self._least_s: dict[int, float] = {}
        self._count: Counter[int] = Counter()

    def receive(self, sender: int, lag_s: float) -> None:
        """Take the age of a peer's message on its arrival [wall s]."""
        self._count[sender] += 1
        self._least_s[sender] = min(lag_s, self._least_s.get(sender, lag_s))

    def lags_s(self) -> dict[int, float]:
        """Return the smallest age by peer, for the peers with enough samples [wall s]."""
        return {sender: lag_s for sender, lag_s in self._least_s.items() if self._count[sender] >= SAMPLES_MIN}

    def unmeasured(self, peers: Iterable[int]) -> list[int]:
        """Return which of `peers` have not sent enough samples yet."""
        return sorted(peer for peer in peers if self._count[peer] < SAMPLES_MIN)

    def require_one_time(self) -> None:
        """Refuse to fly with a peer whose clock differs: its messages would be too old or from the future.

        Raises VehicleRefusedError.
        """
        for peer, lag_s in self.lags_s().items():
            if abs(lag_s) > CLOCK_OFFSET_LIMIT_S:
                side = "ahead of" if lag_s > 0.0 else "behind"
                raise VehicleRefusedError(
                    f"this computer's clock is {abs(lag_s):.2f} s {side} that of vehicle {peer}'s",
                    "let both computers' clocks be set by one time server (chrony, NTP), then fly again",
                )


class TeamReadiness:
    """One vehicle's part in the start agreement: which members are ready, and the earliest start proposed.

    A vehicle that receives the readiness of all others proposes a start one lead time ahead; each vehicle uses the
    earliest proposal. Before there is a proposal a silent member is waited for; afterwards the start is final.
    """

    def __init__(self, vehicle_id: int, members: Collection[int]) -> None:
        self._vehicle_id = vehicle_id
        self.others = frozenset(members) - {vehicle_id}
        self._ready_s: dict[int, float] = {}
        self._start_s: float | None = None

    @property
    def start_s(self) -> float | None:
        """The earliest start proposed so far, None before the first proposal."""
        return self._start_s

    def missing(self, now_s: float) -> list[int]:
        """Return the members that have not reported readiness recently."""
        return sorted(i for i in self.others if now_s - self._ready_s.get(i, -_AGE_MAX_S) >= _AGE_MAX_S)

    def receive(self, message: StartProposal) -> None:
        """Take a peer's readiness and proposal; both are ignored from a peer that is not ready."""
        if message.sender not in self.others or not message.ready:
            return
        self._ready_s[message.sender] = max(message.time_s, self._ready_s.get(message.sender, message.time_s))
        if message.start_s is not None:
            self._start_s = message.start_s if self._start_s is None else min(self._start_s, message.start_s)

    def message(self, now_s: float, *, ready: bool = True) -> StartProposal:
        """Return the message to the peers; the first one after all members are ready proposes a start."""
        if not ready:
            return StartProposal(self._vehicle_id, now_s, None, ready=False)
        if self._start_s is None and not self.missing(now_s):
            self._start_s = GRID_S * ceil((now_s + LEAD_TIME_S) / GRID_S)
        return StartProposal(self._vehicle_id, now_s, self._start_s)
