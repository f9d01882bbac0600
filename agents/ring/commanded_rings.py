"""The rings that operators have commanded, as one vehicle has received them: from operators, and from peers' states.

A vehicle that missed a command takes it from a peer, but nothing that an operator could not command it to fly: the
peer's program may be faulty, or lie.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from math import dist, inf
from typing import Final, NamedTuple

from agents.notes import PeerRingRefusal
from agents.ring.bent_ring import Bender, places_on
from agents.ring.commanded_ring import circles_apart_m, impossible_value, ring_refusal
from agents.safety.fence import Fence
from agents.safety.neighbours import ring_bands_m
from agents.safety.routes import flown_zones
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings, NoFlySection, SafetySettings
from agents.team.messages import MISSION_RING, CommandedRing
from estimation.vectors import Pair

TargetPlace = Callable[[str | None], Pair | None]
"""Returns where the target of a name is, None if that is not known; the only target has no name."""
_GRID_M: Final = 0.5
"""Whether a ring can bend around zones is judged about the place on this grid that is nearest to the target."""
NOTED_AGAIN_S: Final = 10.0
"""Other refused values of a peer's ring are noted at most this often: a vehicle that lies must not fill the log."""


class _Refused(NamedTuple):
    ring: CommandedRing
    noted_s: float


class CommandedRings:
    """The newest commanded values of each ring, `newest` by its number, and how they are flown.

    Every vehicle that has received the same commands flies the same rings, in whatever order it has received them.
    """

    def __init__(self, mission: AgentConfig) -> None:
        self._mission = mission
        self.newest = [MISSION_RING] * max(len(mission.rings), 1)
        self._refused: dict[tuple[int, int], _Refused] = {}

    def change(self, mission: AgentConfig) -> None:
        """Judge rings by another configuration of the mission from now on; what was commanded stays."""
        self._mission = mission

    def flown(self, number: int, commanded: CommandedRing) -> AgentConfig:
        """Return the mission's configuration on a ring with commanded values.

        Two operators may command values that do not go together, each to vehicles that have not received the other's.
        All then fly the earlier one, with the later one if that is possible, whatever they have received first.
        """
        flown = self._mission.on_ring(number)
        for each in [commanded] if not ring_refusal(changed(flown, commanded), inf) else commanded.in_order():
            wanted = changed(flown, each)
            flown = flown if ring_refusal(wanted, inf) else wanted
        return flown

    def refusal(self, number: int, commanded: CommandedRing, config: AgentConfig, target_m: TargetPlace) -> str:
        """Return why the vehicle cannot fly all commanded values of a ring beside the other rings, empty if it can.

        `config` is the present one, with the other rings as they are flown.
        """
        return self._refusal(number, changed(self._mission.on_ring(number), commanded), config, target_m)

    def of_peer(
        self, sender: int, rings: Mapping[int, CommandedRing], config: AgentConfig, target_m: TargetPlace, now_s: float
    ) -> tuple[list[int], list[PeerRingRefusal]]:
        """Return the numbers of the rings in a peer's state that the vehicle may fly, and the refusals to note.

        They are checked together: one may be possible only with another. What is refused is checked again with the
        peer's next state. Where a fence has to hold and the target is not known, a ring waits until it is.
        """
        wanted = {number: self.newest[number].with_(ring) for number, ring in rings.items()}
        wanted = {
            number: ring
            for number, ring in wanted.items()
            if ring != self.newest[number] and self._can_be_judged(number, target_m)
        }
        refusals = []
        while wanted:
            together = config
            for number, ring in wanted.items():
                together = together.with_flown(number, self.flown(number, ring).encirclement)
            reasons = {
                number: impossible_value(self._mission.on_ring(number), rings[number])
                or self._change_refusal(number, ring, config, together, target_m)
                for number, ring in wanted.items()
            }
            wanted = {number: ring for number, ring in wanted.items() if not reasons[number]}
            refused = {number: reason for number, reason in reasons.items() if reason}
            if not refused:
                break
            for number, reason in refused.items():
                if self._is_news(sender, number, rings[number], now_s):
                    refusals.append(PeerRingRefusal(sender, reason, config.rings[number].name if config.rings else ""))
        return list(wanted), refusals

    def _can_be_judged(self, number: int, target_m: TargetPlace) -> bool:
        mission = self._mission.on_ring(number)
        return not mission.safety.fence_m or target_m(mission.target) is not None

    def _change_refusal(
        self, number: int, newest: CommandedRing, config: AgentConfig, together: AgentConfig, target_m: TargetPlace
    ) -> str:
        """Return why a ring must not change to its newest values, empty if it may, or does not change by them."""
        flown = self.flown(number, newest)
        if flown.encirclement == _settings(config, number):
            return ""
        return self._refusal(number, flown, together, target_m)

    def _refusal(self, number: int, flown: AgentConfig, rings: AgentConfig, target_m: TargetPlace) -> str:
        """Return why the vehicle cannot fly a ring as in `flown` beside the others as in `rings`, empty if it can."""
        place_m, fence_m = target_m(flown.target), flown.safety.fence_m
        reach_m = inf if place_m is None or not fence_m else Fence(fence_m).clearance_m(place_m)
        return (
            ring_refusal(flown, reach_m)
            or cut_refusal(rings.with_flown(number, flown.encirclement).on_ring(number), target_m)
            or zones_refusal(flown, place_m)
        )

    def _is_news(self, sender: int, number: int, ring: CommandedRing, now_s: float) -> bool:
        before = self._refused.get((sender, number))
        if before is not None and (before.ring == ring or now_s - before.noted_s < NOTED_AGAIN_S):
            return False
        self._refused[sender, number] = _Refused(ring, now_s)
        return True


def zones_refusal(flown: AgentConfig, target_m: Pair | None) -> str:
    """Return why the ring of a configuration cannot bend around the zones at its heights; empty if it can."""
    if target_m is None or not (zones := flown_zones(flown)):
        return ""
    x, y = (_GRID_M * round(each / _GRID_M) for each in target_m)
    if _can_bend(zones, flown.encirclement, flown.safety, places_on(flown), (x, y)):
        return ""
    names = ", ".join(f"'{each.name}'" for each in zones)
    return f"the ring cannot bend around {names}: choose another radius, rate or altitude"


@lru_cache(maxsize=16)
def _can_bend(
    zones: tuple[NoFlySection, ...], ring: EncirclementSettings, safety: SafetySettings, places: float, centre_m: Pair
) -> bool:
    """Return whether a ring can bend around zones; every state of a peer asks again what was refused."""
    return Bender(zones, ring, safety, places).bend(centre_m) is not None


def cut_refusal(config: AgentConfig, target_m: TargetPlace) -> str:
    """Return why the ring of a configuration comes too near to another one of the mission, empty if it does not.

    Targets are where they are now; a ring about another one that is not known is left out. What the planned motions of
    the targets cause later, and a margin, are checked before a command is sent (`gcs/mission/tubes.py`).
    """
    safety, bands_m = config.safety, ring_bands_m(config)
    for number, other in enumerate(config.rings):
        own = config.rings[config.ring]
        if number == config.ring or own.shared or other.shared:
            continue
        (low_m, high_m), (other_low_m, other_high_m) = bands_m[config.ring], bands_m[number]
        apart_m = _apart_m(config, number, target_m)
        if max(other_low_m - high_m, low_m - other_high_m) >= safety.vertical_separation_m or apart_m is None:
            continue
        away_m = circles_apart_m(own.encirclement.radius_m, other.encirclement.radius_m, apart_m)
        if away_m < safety.separation_m:
            return (
                f"{own.encirclement.radius_m:g} m is {away_m:.1f} m from ring '{other.name}': it takes "
                f"{safety.separation_m:g} m, or {safety.vertical_separation_m:g} m in height"
            )
    return ""


def _apart_m(config: AgentConfig, other: int, target_m: TargetPlace) -> float | None:
    """Return the distance of the target of a configuration's ring from that of another, None if one is not known."""
    names = config.target, config.on_ring(other).target
    if names[0] == names[1]:
        return 0.0
    here_m, there_m = target_m(names[0]), target_m(names[1])
    return None if here_m is None or there_m is None else dist(here_m, there_m)


def _settings(config: AgentConfig, number: int) -> EncirclementSettings:
    return config.rings[number].encirclement if config.rings else config.encirclement


def changed(config: AgentConfig, commanded: CommandedRing) -> AgentConfig:
    """Return a configuration with the commanded values of its ring."""
    return config.with_ring(commanded.radius_m, commanded.angular_rate_rad_s, commanded.altitude_m, commanded.tilt_deg)
