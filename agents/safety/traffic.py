"""Aircraft outside the team, by ADS-B and Remote ID: as received by the own autopilot and by peers.

The newest report of an aircraft counts, for `AGED_S`. Vehicles of the team are received as well, as they carry
transmitters: an aircraft that is at a member's place when it is first heard is taken as that member.

The guard keeps the horizontal distance `safety.traffic_distance_m` as from a body that neither evades nor publishes a
plan: extrapolated at constant velocity. Own vehicles, no-fly zones and the fence come first: an aircraft that is not
there, since anyone can transmit, leads no vehicle over them.
"""

from collections.abc import Iterable, Sequence
from math import hypot
from typing import Final

from agents.safety.barriers import Body
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.team.messages import TRAFFIC_MAX, Aircraft, MemberState

AGED_S: Final = 10.0
"""ADS-B and Remote ID are sent once a second; after this time without a report an aircraft is forgotten."""
_KNOWN_MAX = 2 * TRAFFIC_MAX
_OURS_M: Final = 15.0
"""The errors of two GPS receivers, and the way of a vehicle in a second."""
_SHARED_S: Final = 1.0
"""How often the traffic is sent to peers and operators."""


class KnownTraffic:
    """The aircraft that one vehicle knows of; `received` are those that its own autopilot receives."""

    def __init__(self, config: AgentConfig) -> None:
        self._distance_m = config.safety.traffic_distance_m
        self._height_m = config.safety.traffic_height_m
        self._known: dict[str, Aircraft] = {}
        self._received: Sequence[Aircraft] = ()
        self._ours: dict[str, bool] = {}
        self._shared_s = 0.0

    def receive(self, received: Sequence[Aircraft]) -> None:
        """Take what the own autopilot receives at present."""
        if received != self._received:
            self._received = received
            self.hear(received)

    def hear(self, aircraft: Iterable[Aircraft]) -> None:
        """Take reports of aircraft, also from peers; one that is older than the known one has no effect."""
        for each in aircraft:
            before = self._known.get(each.label)
            is_new = before is None and len(self._known) < _KNOWN_MAX
            if is_new or (before is not None and each.time_s > before.time_s):
                self._known[each.label] = each

    def update(self, situation: Situation, members: Sequence[MemberState]) -> None:
        """Forget what is old, and find which of the aircraft are of the team."""
        now_s = situation.now_s
        if not self._known:
            return
        for each in list(self._known.values()):
            if abs(now_s - each.time_s) > AGED_S:
                del self._known[each.label]
                self._ours.pop(each.label, None)
        x, y = situation.own.mean.item(0), situation.own.mean.item(1)
        places = [(x, y, situation.height_m), *((*each.position_m, each.altitude_m) for each in members)]
        for label, each in self._known.items():
            if label not in self._ours:
                self._ours[label] = any(_is_at(each, place, now_s) for place in places)

    @property
    def others(self) -> tuple[Aircraft, ...]:
        """The aircraft outside the team."""
        return tuple([each for each in self._known.values() if self._ours.get(each.label) is False])

    def shared(self, now_s: float) -> tuple[Aircraft, ...]:
        """Return the aircraft that the own autopilot receives if they are due to be sent, else none."""
        if not self._received or now_s - self._shared_s < _SHARED_S:
            return ()
        self._shared_s = now_s
        heard = {each.label for each in self._received}
        return tuple([each for each in self.others if each.label in heard])[:TRAFFIC_MAX]

    def near(self, situation: Situation) -> str:
        """Return the aircraft that are nearer than the distance to keep, as text; empty if none are."""
        x, y = situation.own.mean.item(0), situation.own.mean.item(1)
        found = []
        for each in self._at_height(situation.height_m):
            its_x, its_y = _ahead(each, situation.now_s)
            away_m = hypot(its_x - x, its_y - y)
            if away_m < self._distance_m:
                above = "" if each.altitude_m is None else f", {each.altitude_m - situation.height_m:+.0f} m in height"
                found.append((away_m, f"{each.label} {away_m:.0f} m away{above}"))
        return ", ".join([text for _, text in sorted(found)])

    def bodies(self, situation: Situation) -> list[Body]:
        """Return the aircraft as bodies to keep away from when the setpoint acts."""
        return [
            Body(_ahead(each, situation.acting_s), each.velocity_m_s, (0.0, 0.0), self._distance_m, False)
            for each in self._at_height(situation.height_m)
        ]

    def _at_height(self, height_m: float) -> list[Aircraft]:
        """Return the others that may be at a height; none if no distance is to be kept."""
        if self._distance_m <= 0.0 or not self._known:
            return []
        return [
            each for each in self.others if each.altitude_m is None or abs(each.altitude_m - height_m) < self._height_m
        ]


def _ahead(aircraft: Aircraft, at_s: float) -> tuple[float, float]:
    """Return where an aircraft is at a time, at constant velocity."""
    (x, y), (x_rate, y_rate), ahead_s = aircraft.position_m, aircraft.velocity_m_s, at_s - aircraft.time_s
    return x + x_rate * ahead_s, y + y_rate * ahead_s


def _is_at(aircraft: Aircraft, place_m: tuple[float, float, float], now_s: float) -> bool:
    x, y = _ahead(aircraft, now_s)
    same_height = aircraft.altitude_m is None or abs(aircraft.altitude_m - place_m[2]) < _OURS_M
    return hypot(x - place_m[0], y - place_m[1]) < _OURS_M and same_height
