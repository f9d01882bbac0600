"""The flight about the target: the ring that is flown, the vehicle's place on it, and its encirclement task."""

from collections.abc import Sequence
from math import copysign, cos, floor, hypot, inf, sin, tau
from typing import Final

from agents.control.aims import along
from agents.control.encirclement import Approach, EncirclementPlanner, RingTask, undisturbed_m
from agents.control.plan import Plan, RingReport
from agents.notes import RingChange
from agents.ring.bent_ring import RingBend, RingBends, places_on, waiting_places_m
from agents.ring.commanded_ring import Orbit
from agents.ring.detour import Headway, Motion, Obstacle, bend_m, bends, met
from agents.ring.feasibility import RingFeasibility
from agents.ring.joining import Joining
from agents.ring.place import (
    EVEN,
    RingPlace,
    RingSize,
    even_places,
    neighbours,
    place_errors_rad,
    ring_place,
    weights_of,
)
from agents.ring.reference import RingReference, RingWay
from agents.ring.transition import Mover
from agents.safety.barriers import demanded_from_m, unsure_m
from agents.safety.fence import Fence
from agents.safety.neighbours import Neighbours
from agents.safety.routes import WAY_SHARE, Way, flown_zones, way_of
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.numbers import StateNumbers
from agents.team.ring_members import BESIDE_FOR_S
from agents.team.team import Team
from estimation.polar import Polar, polar_from_motion
from estimation.state import POSITION, VELOCITY, Vector
from estimation.vectors import Pair

_ORBIT: Final = Approach.ORBIT
_RETURN = Tactic.RETURN_AND_LAND.value
_HEADWAY: Final = 1.6
"""In separations: a little more than the room that a vehicle needs to enter."""
_ABREAST: Final = 1.2
_PASSED: Final = 1.25
"""Vehicles whose radii differ by more may pass each other: in headways for one that comes in, and in separations for
one on the ring, which passes those that wait outside of it.
"""
_HEADWAY_SHARE: Final = 0.8
"""In narrowest wanted gaps: the largest headway, for a ring that is nearly full."""
_HELD_S: Final = 5.0
"""The guard holds a vehicle at a zone for this long before it flies around it near the ring."""
_BENT_FROM: Final = 1.4
"""The ring bends around an obstacle from so many times the distance on at which the guard would act. Nearer, the guard
slows down every vehicle on a fast ring that passes.
"""
_LOOKED_AHEAD_RAD: Final = 0.5
_FENCE_MARGIN_M: Final = 0.5
"""How far ahead of a waiting vehicle the fence is checked, and the margin to it. A waiting place outside the fence is
never reached, and the vehicles on the ring would keep room for it.
"""


_PHASE: Final = 0.618
"""In periods: how much later vehicles of the next id look at all on the ring, so that not all do in the same tick."""


class RingRoom:
    """How many vehicles share the ring, while none comes or goes.

    `size` is that of the ring, `places` the number of even places as near to each other as its nearest, and
    `coming_places` the same with those that wait for room.
    """

    def __init__(self, revision: int, weights: Sequence[float], coming: Sequence[float]) -> None:
        self.revision: Final = revision
        self.size: Final = RingSize(len(weights), sum(weights))
        self.places: Final = even_places(weights)
        self.coming_places: Final = even_places(coming)


class RingView:
    """What a vehicle finds among all on its ring, until another one is `due`.

    `room` is the ring's. Vehicles `beside` may be next to the vehicle meanwhile, `weights` are those of its gap and
    theirs. `movers` are those of the spacing law, empty until the vehicle has joined.
    """

    def __init__(self, due: tuple[int, int], room: RingRoom, beside: tuple[int, ...], weights: Sequence[float]) -> None:
        self.due: Final = due
        self.room: Final = room
        self.beside: Final = beside
        self.weights: Final = weights
        self.movers: Sequence[Mover] = ()


class RingFlight:
    """Plans one vehicle's flight about the target; its state is the ring flown, and whether it has joined."""

    def __init__(self, config: AgentConfig, team: Team) -> None:
        self._vehicle_id = config.vehicle_id
        self._plant = config.plant
        self._safety = config.safety
        self._fence = Fence(config.safety.fence_m) if config.safety.fence_m else None
        self._team = team
        self._neighbours = Neighbours(config)
        self._guarded = False
        self._view: RingView | None = None
        self._make(config)

    def _make(self, config: AgentConfig) -> None:
        self._take(config)
        self._encirclement = EncirclementPlanner(config)
        self._reference = RingReference(config)
        self._feasibility = RingFeasibility(config)
        self._joining = Joining(config)
        self._view = None
        self._bends: RingBends | None = None
        self._way: Way | None = None
        self._way_speed_m_s = WAY_SHARE * min(config.encirclement.speed_max_m_s, config.safety.speed_max_m_s)
        self._unheld_s = inf
        self._avoid_zones(config)

    @property
    def rate_rad_s(self) -> float:
        """The angular rate at which the ring is flown, without corrections of the spacing."""
        return self._feasibility.orbit.angular_rate_rad_s

    def reset(self) -> None:
        """Restart, when the vehicle comes from another tactic."""
        self._view = None
        self._encirclement.reset()
        self._reference.reset()
        self._feasibility.reset()
        self._joining.reset()
        self._unheld_s = inf

    def change(self, config: AgentConfig) -> None:
        """Fly the ring of another configuration from now on; a vehicle on the ring changes to it within bounds."""
        self._view = None
        self._take(config)
        self._feasibility.change(config.encirclement)
        self._neighbours.change(config)
        self._reference.change(config)
        self._joining.change(config)
        self._avoid_zones(config)

    def _take(self, config: AgentConfig) -> None:
        self._settings = config.encirclement
        self._gaps = EVEN if all(weight == 1.0 for weight in config.gaps.values()) else config.gaps

    def _avoid_zones(self, config: AgentConfig) -> None:
        """Keep out of the zones at the heights of a configuration, to the ring and on it."""
        zones = flown_zones(config)
        if not zones:
            self._bends = None
        elif self._bends is None:
            self._bends = RingBends(zones, config.encirclement, config.safety, places_on(config))
        else:
            self._bends.change(zones, config.encirclement, places_on(config))
        self._bend: RingBend | None = None
        self._way = way_of(config, self._way_speed_m_s, before=self._way)

    def leave_for(self, config: AgentConfig) -> None:
        """Fly another of the mission's rings from now on, once the vehicle is there."""
        if _limits(config.encirclement) == _limits(self._settings):
            self.change(config)
            self.reset()
        else:  # programmes with other bounds take milliseconds to make
            self._make(config)
            self._neighbours.change(config)

    def sent(self, *, guarded: bool) -> None:
        """Record whether the guard has changed the aim of the last plan."""
        self._guarded = guarded

    def plan(self, situation: Situation, centre: Vector, mixing: float) -> Plan:
        """Plan about the centre's motion (4,) at the acting time; `mixing` is the share of this plan in the aim."""
        polar = polar_from_motion(situation.acting_motion, centre)
        _, _, centre_x_rate, centre_y_rate = centre.tolist()
        orbit, news = self._orbit(situation.now_s, hypot(centre_x_rate, centre_y_rate))
        if self._bends is not None:
            self._bend = self._bends.about((centre.item(0), centre.item(1)), situation.now_s)
            if (way_in := self._way_in(situation, centre, polar, orbit, mixing)) is not None:
                return way_in
        task, place = self._task(situation, centre, polar, orbit, mixing)
        plan = self._encirclement.plan(task)
        report = RingReport(
            mixing,
            orbit.angular_rate_rad_s,
            self._feasibility.words,
            self._feasibility.needed,
            self._joining.joined,
            place if self._joining.joined else None,
            plan.approach,
            news,
            task.reference if self._joining.joined else None,
        )
        if plan.approach is not _ORBIT:
            self._reference.reset()
        undisturbed = undisturbed_m(plan.aim_m, situation.compensation, self._plant)
        return Plan(plan.aim_m, undisturbed, situation.acting_motion[VELOCITY], plan.status, ring=report)

    def _way_in(self, situation: Situation, centre: Vector, polar: Polar, orbit: Orbit, mixing: float) -> Plan | None:
        """Return the plan to fly around zones to the waiting circle; None once the straight way there is free.

        Near the ring vehicles wait beside zones and pass them on the waiting circle. There such a way begins after the
        guard has held the vehicle at a zone between it and the ring for a while, and ends with the least room.
        """
        bend, way, now_s = self._bend, self._way, situation.now_s
        if bend is None or way is None or self._joining.inside:
            return None
        off_m, aside_m = bend.at_one(polar.bearing_rad)[0], self._joining.waiting_m - orbit.radius_m
        outside_m = polar.radius_m - orbit.radius_m - off_m
        (x, y), (centre_x, centre_y) = situation.acting_motion[POSITION].tolist(), centre[POSITION].tolist()
        share = (orbit.radius_m + off_m + min(aside_m, bend.room_at_m(polar.bearing_rad))) / polar.radius_m
        entry_m = centre_x + share * (x - centre_x), centre_y + share * (y - centre_y)
        if outside_m > 2.0 * aside_m:
            self._unheld_s = now_s
            if way.routes.is_straight((x, y), entry_m):
                return None
        elif now_s - self._unheld_s <= _HELD_S:
            if outside_m <= 0.0 or not self._guarded or way.routes.bare.is_straight((x, y), entry_m):
                self._unheld_s = now_s
            return None
        elif outside_m <= 0.0 or way.routes.narrow.is_straight((x, y), entry_m):
            self._unheld_s = now_s
            return None
        self._reference.reset()
        self._encirclement.reset()
        next_m = way.next_m((x, y), *waiting_places_m((centre_x, centre_y), orbit.radius_m, aside_m, bend))
        return along(situation, next_m, self._plant, self._way_speed_m_s, self.report(mixing))

    def report(self, mixing: float) -> RingReport:
        """Return the report while there is no target."""
        feasibility = self._feasibility
        return RingReport(mixing, self.rate_rad_s, feasibility.words, feasibility.needed, self._joining.joined)

    def clear_m(self, situation: Situation, *, isolated: bool) -> float:
        """Return the radius beyond which a vehicle is clear of the ring; larger if the others do not receive it."""
        if not isolated:
            return self._joining.clear_m
        sigma_m = situation.position_sigma_m
        return self._joining.isolated_m(unsure_m(self._safety.uncertainty_sigmas, sigma_m, sigma_m))

    def _orbit(self, now_s: float, target_m_s: float) -> tuple[Orbit, RingChange | None]:
        """Return the ring that all members fly now, and what has changed about it.

        A vehicle that waits outside adopts it at once.
        """
        changed = self._feasibility.find(target_m_s, self._team.ring.shares(), now_s, joined=self._joining.joined)
        orbit = self._feasibility.orbit
        self._joining.ring_m = orbit.radius_m
        return orbit, None if changed is None else RingChange(changed)

    def _task(
        self, situation: Situation, centre: Vector, polar: Polar, orbit: Orbit, mixing: float
    ) -> tuple[RingTask, RingPlace]:
        """Return the task, and the vehicle's place among all that are engaged.

        Radii of the way in and of the reference are those about the ring as if it were not bent around zones: a vehicle
        that is as far outside of a bent ring is there (`level`).
        """
        level = polar if self._bend is None else _level(polar, self._bend)
        view, acting_s, ring = self._look(situation, polar), situation.acting_s, self._team.ring
        joined = self._joining.look(level, view.room.places)
        if joined and not view.movers:
            view.movers = self._movers(situation, level, orbit)
        movers = view.movers if joined else (self._joining.mover(0.0, level.radius_m, orbit),)
        beside_rad = ring.bearings_rad(acting_s, view.beside) if joined else ()
        place = ring_place(polar.bearing_rad, beside_rad, view.weights, view.room.size)
        obstacles = self._obstacles(situation, centre, polar)
        radius_m = self._joining.radius_m(level, place, movers[0].error_rad) if joined else self._joining.waiting_m
        passes = self._joining.inside and not bends(orbit.radius_m, obstacles, level.radius_m)
        room = self._headway(situation, centre, polar, orbit, view, passes=passes)
        rates_rad_s = room.rates_rad_s
        if self._joining.inside:
            # Where the ring is bent outwards it is as far out as one that comes in, and may fly backwards.
            rates_rad_s = _forwards(rates_rad_s, orbit.angular_rate_rad_s)
        else:
            radius_m = max(radius_m, room.least_m + level.radius_m - polar.radius_m)
        if radius_m > orbit.radius_m and self._bend is not None:
            ahead_rad = polar.bearing_rad + copysign(_LOOKED_AHEAD_RAD, orbit.angular_rate_rad_s)
            outside_m = self._bend.room_at_m(polar.bearing_rad, ahead_rad)
            radius_m = max(orbit.radius_m, min(radius_m, orbit.radius_m + outside_m))
        elif radius_m > orbit.radius_m and self._fence is not None:
            radius_m = max(orbit.radius_m, min(radius_m, self._fence_m(self._fence, centre, polar, orbit)))
        way = RingWay(
            orbit,
            radius_m,
            # Until it flies the ring's setpoints alone its bearing is the formation's to change.
            movers if mixing >= 1.0 else (self._joining.mover(0.0, level.radius_m, orbit),),
            self._joining.acceleration,
            rates_rad_s,
            mixing,
            bend_m(radius_m, level, obstacles),
            self._guarded,
        )
        task = RingTask(
            motion=situation.acting_motion,
            target=centre,
            polar=polar,
            compensation_m_s2=situation.compensation,
            # Farther outside or inside a vehicle may pass: a clearance to it would make both turn back.
            neighbours=neighbours(
                polar.bearing_rad,
                ring.abreast(acting_s, polar.radius_m, self._safety.separation_m, view.beside),
            ),
            orbit=orbit,
            radius_m=radius_m,
            reference=self._reference.advance(level, way, acting_s),
            authority=situation.authority,
            obstacles=obstacles,
            bend=self._bend,
        )
        return task, place

    def _fence_m(self, fence: Fence, centre: Vector, polar: Polar, orbit: Orbit) -> float:
        """Return the largest radius to wait on: inside the fence at the present bearing and ahead of it."""
        x, y = centre[POSITION].tolist()
        next_rad = polar.bearing_rad + copysign(_LOOKED_AHEAD_RAD, orbit.angular_rate_rad_s)
        return min(fence.reach_m((x, y), (cos(at), sin(at))) for at in (polar.bearing_rad, next_rad)) - _FENCE_MARGIN_M

    def _look(self, situation: Situation, polar: Polar) -> RingView:
        """Return the view of all on the ring, a new one where it is due or peers have come or gone."""
        ring, team, own_id = self._team.ring, self._team, self._vehicle_id
        due = floor(situation.now_s / BESIDE_FOR_S + _PHASE * own_id), ring.revision
        if self._view is not None and self._view.due == due:
            return self._view
        if self._view is not None and self._view.room.revision == ring.revision:
            room = self._view.room
        else:
            coming = [own_id, *(each.sender for each in team.members() if team.encircles(each))]
            weights = weights_of((own_id, *ring.ids), self._gaps)
            room = RingRoom(ring.revision, weights, weights_of(coming, self._gaps))
        beside = ring.beside(polar.bearing_rad, polar.radius_m, situation.acting_s, self._safety.separation_m)
        self._view = RingView(due, room, beside, weights_of((own_id, *beside), self._gaps))
        return self._view

    def _movers(self, situation: Situation, polar: Polar, orbit: Orbit) -> Sequence[Mover]:
        """Return how far the vehicles' places are from even ones, and their bounds, the vehicle's own first.

        While the vehicles on the ring do not all know the same references, a place among those that it knows is none
        among all: the vehicle then corrects towards the middle between its neighbours, as (22) states.
        """
        mover, ring = self._joining.mover, self._team.ring
        own_rad = self._reference.place_rad(polar, orbit, situation.acting_s)
        ids, others_rad, radii_m = ring.others(situation.acting_s)
        ids.insert(0, self._vehicle_id)
        if not ring.is_known_to_all(self._vehicle_id):
            error_rad = ring_place(own_rad, others_rad, weights_of(ids, self._gaps)).error_rad
            return mover(error_rad, polar.radius_m, orbit), mover(-error_rad, polar.radius_m, orbit)
        errors_rad = place_errors_rad([own_rad, *others_rad], ids, self._gaps)
        return self._joining.movers(errors_rad, [polar.radius_m, *radii_m], orbit)

    def _headway(
        self, situation: Situation, centre: Vector, polar: Polar, orbit: Orbit, view: RingView, *, passes: bool
    ) -> Headway:
        """Return the angular rates and the radius that keep the headway to the vehicles around.

        A vehicle on the ring `passes` those farther out: they wait there, unless the ring is bent.
        """
        headway_m = min(
            _HEADWAY * self._safety.separation_m, _HEADWAY_SHARE * tau / view.room.coming_places * orbit.radius_m
        )
        abreast_m = _PASSED * self._safety.separation_m if passes else _ABREAST * headway_m
        headway, team = Headway(polar, headway_m, abreast_m), self._team
        acting_s, about = situation.acting_s, _motion_of(centre)
        for each in team.near_numbers():
            if each.on_ring == team.ring_number:
                headway.keep_to(_motion(each, acting_s, about))
        return headway

    def _obstacles(self, situation: Situation, centre: Vector, polar: Polar) -> list[Obstacle]:
        """Return the obstacles on the ring: peers that fell silent there, and those that stay or return.

        Each is where it will be when the vehicle passes it.
        """
        team = self._team
        others = [team.member(each.sender) for each in team.near_numbers() if each.is_off_ring]
        lost = team.lost(situation.now_s, self._safety.lost_avoided_s)
        if not (others or lost):
            return []
        # One that has left the ring may still brake: it soon rests.
        returning, about = [each.sender for each in others if each.tactic == _RETURN], _motion_of(centre)
        found, along_m_s = [], abs(self.rate_rad_s) * polar.radius_m
        for body in self._neighbours.bodies(situation, others, lost):
            velocity_m_s = body.velocity_m_s if body.vehicle_id in returning else (0.0, 0.0)
            motion = _relative(body.position_m, velocity_m_s, about)
            guarded_m = demanded_from_m(along_m_s, body.distance_m, self._safety.barrier_rate_per_s)
            obstacle = met(polar, self.rate_rad_s, motion, body.distance_m, _BENT_FROM * guarded_m)
            off_m = 0.0 if self._bend is None else self._bend.at_one(obstacle.bearing_rad)[0]
            found.append(obstacle.nearer(off_m) if off_m else obstacle)
        return found


def _level(polar: Polar, bend: RingBend) -> Polar:
    """Return a polar state on a ring that is bent around zones as it would be on the circle."""
    off_m, slope_m_rad = bend.at_one(polar.bearing_rad)
    radial_m_s = polar.radial_speed_m_s - slope_m_rad * polar.angular_rate_rad_s
    return Polar(polar.radius_m - off_m, polar.bearing_rad, radial_m_s, polar.angular_rate_rad_s)


def _limits(ring: EncirclementSettings) -> dict[str, object]:
    """Return what a commanded ring never changes: the limits of speed and acceleration, and the tuning."""
    commanded = {"radius_m", "angular_rate_rad_s", "altitude_m", "tilt_deg", "tilt_bearing_deg"}
    return ring.model_dump(exclude=commanded) | {"radius_far_m": ring.far_m}


def _forwards(rates_rad_s: Pair, ring_rad_s: float) -> Pair:
    """Return the rates that are not against the ring's."""
    least_rad_s, most_rad_s = rates_rad_s
    if ring_rad_s == 0.0:
        return rates_rad_s
    return (max(least_rad_s, 0.0), most_rad_s) if ring_rad_s > 0.0 else (least_rad_s, min(most_rad_s, 0.0))


def _motion_of(vector: Vector) -> Motion:
    x, y, x_rate, y_rate = vector.tolist()
    return x, y, x_rate, y_rate


def _motion(member: StateNumbers, at_s: float, centre: Motion) -> Motion:
    """Return a peer's motion relative to the centre's (4,) at a time, extrapolated at its published velocity."""
    ahead_s = at_s - member.time_s
    (x, y), (x_rate, y_rate) = member.position_m, member.velocity_m_s
    return _relative((x + x_rate * ahead_s, y + y_rate * ahead_s), (x_rate, y_rate), centre)


def _relative(position_m: Pair, velocity_m_s: Pair, centre: Motion) -> Motion:
    centre_x, centre_y, centre_x_rate, centre_y_rate = centre
    return (
        position_m[0] - centre_x,
        position_m[1] - centre_y,
        velocity_m_s[0] - centre_x_rate,
        velocity_m_s[1] - centre_y_rate,
    )
