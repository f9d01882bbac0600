"""Aircraft outside the team, from the states of the vehicles that receive them."""

from agents.safety.traffic import AGED_S
from agents.team.messages import Aircraft, MemberState
from gcs.station.picture import TrafficPicture

_KNOWN_MAX = 64


class SeenTraffic:
    """Keeps the newest report of each aircraft, whichever vehicle received it, for `AGED_S` [wall s]."""

    def __init__(self) -> None:
        self._heard: dict[str, tuple[float, Aircraft]] = {}

    def take(self, state: MemberState, now_s: float) -> None:
        """Take what a vehicle receives, at a time on the monotonic clock [s]."""
        for each in state.traffic or ():
            heard_s = now_s - max(state.time_s - each.time_s, 0.0)
            before_s = self._heard[each.label][0] if each.label in self._heard else None
            if (before_s is None and len(self._heard) < _KNOWN_MAX) or (before_s is not None and heard_s >= before_s):
                self._heard[each.label] = heard_s, each

    def pictures(self, now_s: float) -> tuple[TrafficPicture, ...]:
        """Return the aircraft now, in the order of their labels; forget old ones."""
        self._heard = {label: (at_s, each) for label, (at_s, each) in self._heard.items() if now_s - at_s <= AGED_S}
        return tuple(
            TrafficPicture(label, each.position_m, each.velocity_m_s, each.altitude_m, now_s - at_s)
            for label, (at_s, each) in sorted(self._heard.items())
        )
