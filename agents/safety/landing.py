"""Where a vehicle can land: whether the place is free of other vehicles, and the nearest place that is.

What lands is not guarded, so before a landing the place below has to be free of vehicles that do not evade: those that
a pilot flies, that land, that fell silent, or that lie on the ground. One below that evades keeps itself apart.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import dist, pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.safety.barriers import unsure_m
from agents.safety.fence import Area
from agents.safety.routes import ZONE_MARGIN_M
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.state import Vector
from estimation.vectors import Pair

PAST: Final = 1.25
"""In separations, with the uncertainty beyond: a vehicle does not land past one in the air that is nearer."""
ON_GROUND: Final = 0.5
"""In separations: how far from one on the ground a vehicle lands at least. Neither moves."""
ASIDE: Final = 1.5
"""In separations: how far the place aside is from others and their landing places. Vehicles sway, pilots drift."""
REACH: Final = 20.0
"""In separations: how far the place aside is searched for."""
_STEP: Final = 0.25
_BEARINGS: Final = 48
_SIGMAS_OF_BOUNDARIES: Final = 4.0
_PILOTED, _LANDS = Tactic.PILOT_OVERRIDE.value, Tactic.LAND.value


class OtherVehicles(NamedTuple):
    """The other vehicles, as one that lands knows them.

    `members` are received, `lost` are the last states of those that fell silent, in flight or landed, and `lying_m` are
    the places of vehicles on the ground that do not fly, by their ids.
    """

    members: Sequence[MemberState]
    lost: Sequence[MemberState]
    lying_m: Mapping[int, Pair]


class InTheWay(NamedTuple):
    """A vehicle past or onto which another must not land, as text, and whether it is on its way down."""

    text: str
    comes_down: bool = False


class LandingPlaces:
    """Judges and finds the places where one vehicle lands."""

    def __init__(self, config: AgentConfig) -> None:
        self._safety = config.safety
        self._separation_m = config.safety.separation_m
        self._low_m = config.lowest_m / 2.0
        self._area = Area(config.safety)
        self._others_m = [spot_m for _, spot_m in config.others_landing_places_m]
        self._keep_m = ASIDE * config.safety.separation_m

    def obstacle(self, place_m: Pair, situation: Situation, others: OtherVehicles) -> InTheWay | None:
        """Return a vehicle past or onto which this one would land at a place; None if the place is free.

        One that is only about to be down comes last.
        """
        last: InTheWay | None = None
        for member in others.members:
            if member.tactic in (_PILOTED, _LANDS) and self._is_in_the_way(member, place_m, situation):
                found = _obstacle(member.sender, dist(member.position_m, place_m), member.tactic)
                if not found.comes_down:
                    return found
                last = found
        for member in others.lost:
            is_down = member.tactic == _LANDS and member.altitude_m < self._low_m
            away_m = dist(member.position_m, place_m)
            if away_m < (ON_GROUND * self._separation_m if is_down else self._past_m(member, situation)):
                return _obstacle(member.sender, away_m, "lies there" if is_down else "was last received there")
        for vehicle_id, lying_m in others.lying_m.items():
            if (away_m := dist(lying_m, place_m)) < ON_GROUND * self._separation_m:
                return _obstacle(vehicle_id, away_m, "lies there")
        return last

    def nearest_m(
        self, wanted_m: Pair, situation: Situation, others: OtherVehicles, *, from_landing_places: bool
    ) -> Pair | None:
        """Return the free place that is nearest to a wanted one, which may be this; None if there is none in reach.

        It is `ASIDE` separations from the vehicles, from where they go, and `from_landing_places` from where they land;
        outside of targets' discs; inside the fence, and outside of zones at any height down to the ground.
        """
        places = self._places_about(wanted_m)
        free = self._inside(places, situation)
        for x, y, keep_m in self._discs(situation, others, from_landing_places=from_landing_places):
            if dist((x, y), wanted_m) < REACH * self._separation_m + keep_m:
                free &= np.hypot(places[:, 0] - x, places[:, 1] - y) >= keep_m
        if not free.any():
            return None
        x, y = places[int(np.argmax(free))].tolist()
        return x, y

    def _discs(
        self, situation: Situation, others: OtherVehicles, *, from_landing_places: bool
    ) -> Iterator[tuple[float, float, float]]:
        """Yield the centre and the radius of every disc in which the vehicle must not land."""
        for member in (*others.members, *others.lost):
            keep_m = self._keep_m + self._unsure_m(member, situation)
            yield *member.position_m, keep_m
            if member.goal is not None:
                yield member.goal.x_m, member.goal.y_m, self._keep_m
        for x, y in (*others.lying_m.values(), *(self._others_m if from_landing_places else ())):
            yield x, y, self._keep_m
        own = situation.acting_target
        for target in (*(() if own is None else (own,)), *situation.acting_others.values()):
            yield target.item(0), target.item(1), self._safety.keep_out_m

    def _inside(self, places: Vector, situation: Situation) -> NDArray[np.bool_]:
        """Return which places (n, 2) are inside the fence and outside of zones, from the vehicle to the ground."""
        area, room_m = self._area, max(self._separation_m / 2.0, ZONE_MARGIN_M)
        room_m += _SIGMAS_OF_BOUNDARIES * situation.boundary_sigma_m
        inside: NDArray[np.bool_] = np.ones(len(places), dtype=np.bool_)
        if area.fence is not None:
            inside &= area.fence.clearances_m(places) >= room_m
        for zone in area.zones:
            if zone.floor_m < situation.height_m + ZONE_MARGIN_M:
                inside &= zone.boundary.clearances_m(places) >= room_m
        return inside

    def _places_about(self, wanted_m: Pair) -> Vector:
        """Return the places (n, 2) that come into question, the nearest first."""
        radii_m = self._separation_m * np.arange(_STEP, REACH + _STEP / 2.0, _STEP)
        bearings = 2.0 * pi / _BEARINGS * np.arange(_BEARINGS)
        directions = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
        about = (radii_m[:, None, None] * directions).reshape(-1, 2)
        places: Vector = np.array(wanted_m) + np.concatenate((np.zeros((1, 2)), about))
        return places

    def _is_in_the_way(self, member: MemberState, place_m: Pair, situation: Situation) -> bool:
        """Return whether a vehicle that does not evade is about or below this one's height, and too near to a place."""
        is_above = member.altitude_m >= situation.height_m + self._safety.vertical_separation_m
        return not is_above and dist(member.position_m, place_m) < self._past_m(member, situation)

    def _past_m(self, member: MemberState, situation: Situation) -> float:
        return PAST * self._separation_m + self._unsure_m(member, situation)

    def _unsure_m(self, member: MemberState, situation: Situation) -> float:
        sigmas = self._safety.uncertainty_sigmas
        return min(unsure_m(sigmas, situation.position_sigma_m, member.position_sigma_m), self._separation_m)


def _obstacle(vehicle_id: int, away_m: float, what: str) -> InTheWay:
    does = {_PILOTED: "is flown by a pilot there", _LANDS: "lands there"}.get(what, what)
    return InTheWay(f"vehicle {vehicle_id} {does}, {away_m:.1f} m away", what == _LANDS)
