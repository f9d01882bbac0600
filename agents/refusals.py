"""Why a vehicle must not go to a place, why one that has landed must not take off again, and why one that is not in the
mission file must not join.
"""

from collections.abc import Collection, Iterable
from math import atan2, dist, inf

from agents.ports import VehicleStatus
from agents.ring.bent_ring import bend_of
from agents.ring.commanded_ring import ring_refusal
from agents.ring.commanded_rings import TargetPlace, zones_refusal
from agents.safety.fence import Area
from agents.safety.neighbours import ring_bands_m
from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from agents.team.messages import AddedVehicle, Goal, MemberState
from estimation.vectors import Pair

_KEEPS_ITS_PLACE = ("hold", "aside", "land", "return and land", "pilot override")
"""The tactics of peers where no other vehicle is sent."""
_COMES_DOWN = {Tactic.RETURN_AND_LAND.value, Tactic.LAND.value}
_HOLDS = ("hold", "aside", "pilot override")
"""The tactics of peers that stay in the air where they are: a vehicle must not take off below or beside them."""
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
    """Return why a vehicle at `here_m` (None: not known) must not go to a place at its height; empty if it may.

    Peers on a ring are as far out as they tell: it may be on its way to another radius. `config` has it as commanded.
    """
    there_m, separation_m = (place.x_m, place.y_m), config.safety.separation_m
    if here_m is None:
        return "its position is not known"
    if (way_m := dist(here_m, there_m)) > _GO_MAX_M:
        return f"{place.text} is {way_m:.0f} m away, and {_GO_MAX_M:g} m at most are allowed"
    area = Area(config.safety)
    below_m = [zone.ceiling_m for zone in area.zones if zone.ceiling_m < height_m] if place.lands else []
    for each_m in (height_m, *below_m):
        if hindrance := area.hindrance(there_m, each_m, separation_m / 2.0):
            return f"{place.text} is {hindrance}"
    for name in config.targets or (config.target,):
        at_m = target_m(name)
        if at_m is not None and dist(at_m, there_m) < config.safety.keep_out_m:
            return f"{place.text} is {dist(at_m, there_m):.1f} m from the target, nearer than safety.keep_out_m"
    for peer in peers:
        away_m = dist(peer.position_m, there_m)
        if peer.tactic in _KEEPS_ITS_PLACE and away_m < separation_m:
            return f"{place.text} is {away_m:.1f} m from vehicle {peer.sender}, nearer than safety.separation_m"
    return _kept_free(place, config, height_m, target_m, peers)


def _kept_free(
    place: Goal, config: AgentConfig, height_m: float, target_m: TargetPlace, peers: Collection[MemberState]
) -> str:
    """Return which ring, other vehicle's goal or landing place a place is too near to; empty if there is none."""
    there_m, separation_m = (place.x_m, place.y_m), config.safety.separation_m
    needed = f"{separation_m:g} m at least are needed"
    for peer in peers:
        if peer.goal is not None and (away_m := dist((peer.goal.x_m, peer.goal.y_m), there_m)) < separation_m:
            return f"{place.text} is {away_m:.1f} m from where vehicle {peer.sender} goes: {needed}, or hold it first"
    for other, spot_m in config.others_landing_places_m:
        if (away_m := dist(spot_m, there_m)) < separation_m:
            return f"{place.text} is {away_m:.1f} m from a landing place of vehicle {other}: {needed}"
    bands_m = ring_bands_m(config)
    for number in range(max(len(config.rings), 1)):
        flown = config.on_ring(number)
        if (at_m := target_m(flown.target)) is None or (bands_m and _is_apart(bands_m[number], height_m, config)):
            continue
        bearing_rad = atan2(there_m[1] - at_m[1], there_m[0] - at_m[0])
        bend = bend_of(flown, at_m)
        bent_m = 0.0 if bend is None else bend.at_one(bearing_rad)[0]
        out_m, angles = dist(at_m, there_m) - bent_m, [each.angle for each in peers if each.ring_number == number]
        radii_m = [flown.encirclement.radius_m, *[each.radius_m for each in angles if each is not None]]
        off_m = max(min(radii_m) - out_m, out_m - max(radii_m), 0.0)
        if off_m < separation_m:
            name = f" '{config.rings[number].name}'" if config.rings else ""
            return f"{place.text} is {off_m:.1f} m from the ring{name} of {radii_m[0]:g} m: {needed}"
    return ""


def _is_apart(band_m: Pair, height_m: float, config: AgentConfig) -> bool:
    """Return whether a height is well above or below the heights of a ring."""
    return max(band_m[0] - height_m, height_m - band_m[1]) >= config.safety.vertical_separation_m


def rejoin_refusal(
    status: VehicleStatus,
    tactic: Tactic,
    config: AgentConfig,
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
    recent = [each for each in peers if each.time_s >= recent_s]
    if recent and {each.tactic for each in recent} <= _COMES_DOWN:
        return "the others return and land"
    return "" if config.home_m is None else _take_off_refusal(config.home_m, config.safety.separation_m, recent)


def _take_off_refusal(home_m: Pair, separation_m: float, peers: Collection[MemberState]) -> str:
    """Return which peer holds too near to a take-off place, or goes there; empty if none does."""
    for peer in peers:
        goal_m = None if peer.goal is None else (peer.goal.x_m, peer.goal.y_m)
        there_m, does = (peer.position_m, "holds") if goal_m is None else (goal_m, "goes to a place")
        away_m = dist(there_m, home_m)
        if away_m < separation_m and (goal_m is not None or peer.tactic in _HOLDS):
            return f"vehicle {peer.sender} {does} {away_m:.1f} m from its take-off place: send it elsewhere first"
    return ""


def aloft_refusal(vehicle_id: int, states: Iterable[MemberState], config: AgentConfig) -> str:
    """Return why a vehicle that has joined before must not take off anew: its last state is in the air; else empty."""
    for state in states:
        if state.sender == vehicle_id and state.altitude_m > config.lowest_m / 2.0:
            last = f"it was in the air last, {state.altitude_m:.1f} m high"
            return f"{last}: bring it home by `cordon recover --add {vehicle_id} --only {vehicle_id}`"
    return ""


def added_refusal(vehicle_id: int, added: AddedVehicle, config: AgentConfig, target_m: TargetPlace) -> str:
    """Return why a vehicle that is not in the mission file must not join this one's team; empty if it may.

    `config` has the ring as it is commanded now, which has to have room for one more.
    """
    if vehicle_id in config.slots and vehicle_id != config.added:
        return f"vehicle {vehicle_id} is in the mission: rejoin it without --add"
    if config.added not in (None, vehicle_id):
        return f"vehicle {config.added} has been added already: a flight takes one more vehicle than its mission"
    if config.rings or config.excitation is not None:
        return "it flies for identification" if config.excitation is not None else "its mission has several rings"
    if len(added.slot_m) != (2 if config.slots_m else 0):
        return "a vehicle of a free formation needs a slot, and in another one it has none"
    highest_m = config.altitude_m if config.layers_from_m is None else config.layers_from_m
    if not config.lowest_m <= added.altitude_m <= highest_m:
        return f"{added.altitude_m:g} m is not between the team's altitudes, {config.lowest_m:g} to {highest_m:g} m"
    enlarged = config.with_added(vehicle_id, added.start_m, added.slot_m)
    return _places_refusal(enlarged) or ring_refusal(enlarged, inf) or zones_refusal(enlarged, target_m(None))


def _places_refusal(config: AgentConfig) -> str:
    """Return which start or slot the added vehicle's, the last in line, is too near to; empty if there is none."""
    separation_m = config.safety.separation_m
    for what, places_m in (("start", config.starts_m), ("slot", config.slots_m)):
        for other, place_m in zip(config.slots[:-1], places_m[:-1], strict=False):
            if (away_m := dist(place_m, places_m[-1])) < separation_m:
                return f"its {what} is {away_m:.1f} m from that of vehicle {other}: {separation_m:g} m at least"
    return ""
