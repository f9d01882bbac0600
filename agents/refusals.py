"""Why a vehicle must not go to a place, and why one that has landed must not take off again."""

from collections.abc import Collection
from math import dist

from agents.ports import VehicleStatus
from agents.ring.commanded_rings import TargetPlace
from agents.safety.fence import Area
from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from agents.team.messages import Goal, MemberState
from estimation.vectors import Pair

_KEEPS_ITS_PLACE = ("hold", "aside", "land", "return and land", "pilot override")
"""The tactics of peers where no other vehicle is sent."""
_COMES_DOWN = {Tactic.RETURN_AND_LAND.value, Tactic.LAND.value}
_GO_MAX_M = 1000.0
"""A vehicle is sent no farther: a longer way is likely a slip."""


def place_refusal(
    place: Goal,
    config: AgentConfig,
    height_m: float,
    here_m: Pair | None,
    target_m: TargetPlace,
    peers: Collection[MemberState],
) -> str:
    """Return why a vehicle at `here_m` (None: not known) must not go to a place at its height; empty if it may."""
    there_m, separation_m = (place.x_m, place.y_m), config.safety.separation_m
    if here_m is None:
        return "its position is not known"
    if (way_m := dist(here_m, there_m)) > _GO_MAX_M:
        return f"{place.text} is {way_m:.0f} m away, and {_GO_MAX_M:g} m at most are allowed"
    hindrance = Area(config.safety).hindrance(there_m, height_m, separation_m / 2.0)
    if hindrance:
        return f"{place.text} is {hindrance}"
    for name in config.targets or (config.target,):
        at_m = target_m(name)
        if at_m is not None and dist(at_m, there_m) < config.safety.keep_out_m:
            return f"{place.text} is {dist(at_m, there_m):.1f} m from the target, nearer than safety.keep_out_m"
    for peer in peers:
        away_m = dist(peer.position_m, there_m)
        if peer.tactic in _KEEPS_ITS_PLACE and away_m < separation_m:
            return f"{place.text} is {away_m:.1f} m from vehicle {peer.sender}, nearer than safety.separation_m"
    return ""


def rejoin_refusal(
    status: VehicleStatus,
    tactic: Tactic,
    peers: Collection[MemberState],
    recent_s: float,
    *,
    fell: bool,
    is_over: bool,
) -> str:
    """Return why a vehicle must not take off again, as far as it knows; empty if it may.

    It may not once its mission `is_over`, or if it `fell`. Peers that were last heard before `recent_s` do not count.
    """
    if fell:
        return "it fell: recover and inspect it, and fly it in another flight"
    if not status.connected:
        return "its link is lost: rejoin once it is received again"
    if status.armed or status.in_air:
        flown = tactic is Tactic.PILOT_OVERRIDE
        return "it is in a pilot's hands: let its pilot land and disarm it" if flown else "it has not landed"
    if is_over:
        return "its mission is over"
    tactics = {each.tactic for each in peers if each.time_s >= recent_s}
    return "the others return and land" if tactics and tactics <= _COMES_DOWN else ""
