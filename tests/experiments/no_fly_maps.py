"""Fly missions on random maps with no-fly zones, and report who enters a zone, and which missions complete.

A seed determines 1 to 6 zones (circles and polygons, some with a floor or a ceiling), the number of vehicles, their
true plants, the target and the ring. Positions and sightings have noise, and positions wander. A target rests on four
maps of five; of those a grid search, which shares nothing with the product, says whether the mission is feasible. A
mission is complete if all vehicles fly the ring, then return on command and are at home. Exit code 1 if a vehicle
enters a zone, or if less than 95 % of the feasible missions complete.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from math import ceil, cos, hypot, inf, pi, sin

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from agents.tactics import Tactic
from estimation.state import Vector
from gcs.flight.simulated import fly_simulated
from gcs.flight.simulated_events import Commanded, SimulatedEvents
from gcs.metrics.metrics import evaluated
from gcs.metrics.record import FlightRecord
from gcs.mission.file import MissionError
from gcs.mission.mission import Mission
from tests.experiments.arguments import seeded_parser
from tests.support.mission_text import Content, content, drawn_vehicle, parsed
from tests.support.paths import MISSIONS

FIELD = (MISSIONS / "case2-wander.toml").read_text(encoding="utf-8")
PLANT_OFF_MOST = 0.15
ARRIVES_S, HOME_S = 40.0, 90.0
"""Enough time to fly to the ring, and home from it."""
RING_TURNS_RAD = 1.3 * pi
"""By how much a vehicle on the ring turns between; half a turn of each is wanted."""
FLYING_M, LAYER_M = 8.0, 2.0
HOME_M = 2.0
LEAST_SHARE = 0.95

# The rooms that docs/safety.md states, for the grid search.
ROOM_M, ROOM_S, RING_FASTER = 1.0, 0.5, 1.2
LEAST_AREA_M2 = 1.0
GRID_M, BEARINGS, RADII_M = 0.5, 360, 0.1


def random_map(seed: int) -> Content:
    """Return the mission of a seed, which may be refused."""
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 5))
    radius_m = float(random.uniform(8.0, 14.0))
    rate_rad_s = float(random.uniform(0.5, 1.3) / radius_m * random.choice([-1.0, 1.0]))
    target_m = float(random.uniform(28.0, 45.0)), float(random.uniform(-12.0, 12.0))
    moves = random.random() < 0.2
    course_rad, speed_m_s = random.uniform(-pi, pi), random.uniform(0.05, 0.3)
    mission = content(FIELD)
    on_ring_s = ARRIVES_S + RING_TURNS_RAD / abs(rate_rad_s)
    mission["mission"] |= {"name": f"map {seed}", "duration_s": on_ring_s + HOME_S}
    mission["formation"] |= {"leader": 1, "speed_m_s": 0.2}
    # With a height of its ring, the simulation has heights.
    ring = {"radius_m": radius_m, "angular_rate_rad_s": rate_rad_s, "altitude_m": FLYING_M}
    mission["encirclement"] |= ring
    mission["verdicts"]["radius_error_rms_m"] = 0.2
    mission["decision"] |= {"distance_max_m": 100.0}
    mission["choreography"] = {"landing": "return", "layer_m": LAYER_M}
    mission["safety"] |= {"keep_out_m": float(random.uniform(0.0, radius_m / 3.0))}
    mission["safety"]["no_fly"] = [
        {"name": f"zone-{k}"} | _zone(random, target_m, radius_m) for k in range(int(random.integers(1, 7)))
    ]
    velocity_m_s = [float(speed_m_s * np.cos(course_rad)), float(speed_m_s * np.sin(course_rad))]
    mission["target"] |= {"start_m": list(target_m), "velocity_m_s": velocity_m_s if moves else [0.0, 0.0]}
    mission["target"]["sensor"]["range_m"] = 150.0
    mission["vehicles"] = [
        drawn_vehicle(random, slot, (0.0, 5.0 * ((count - 1) / 2.0 - slot)), PLANT_OFF_MOST)
        | {"profile": "stub-wandering", "altitude_m": FLYING_M}
        for slot in range(count)
    ]
    return mission


def _zone(random: np.random.Generator, target_m: tuple[float, float], radius_m: float) -> Content:
    """Return a zone on the ring, on the way there, or anywhere; one of two has a floor, a ceiling, or both."""
    where, turn_rad = random.random(), random.uniform(-pi, pi)
    if where < 0.4:
        off_m = random.uniform(0.6, 1.4) * radius_m
        x, y = target_m[0] + off_m * cos(turn_rad), target_m[1] + off_m * sin(turn_rad)
    elif where < 0.7:
        share = random.uniform(0.2, 0.7)
        x, y = share * target_m[0], share * target_m[1] + random.uniform(-6.0, 6.0)
    else:
        x, y = random.uniform(-15.0, 65.0), random.uniform(-35.0, 35.0)
    zone: Content = {}
    if random.random() < 0.5:
        zone |= {"center_m": [float(x), float(y)], "radius_m": float(random.uniform(0.5, 4.0))}
    else:
        corners = int(random.integers(3, 8))
        turns = np.sort(random.uniform(0.0, 0.8, corners) + np.arange(corners)) * 2.0 * pi / corners
        sizes = random.uniform(1.0, 5.0, corners)
        polygon = np.stack((x + sizes * np.cos(turns), y + sizes * np.sin(turns)), axis=1)
        zone["polygon_m"] = polygon.tolist()
    height = random.random()
    if height < 0.3:
        zone["ceiling_m"] = float(random.uniform(3.0, 25.0))
    elif height < 0.5:
        zone["floor_m"] = float(random.uniform(2.0, 25.0))
        if random.random() < 0.5:
            zone["ceiling_m"] = zone["floor_m"] + float(random.uniform(1.0, 10.0))
    return zone


def shape(zone: Content) -> shapely.Geometry:
    """Return a zone seen from above."""
    if "polygon_m" in zone:
        return shapely.Polygon(zone["polygon_m"])
    return shapely.Point(zone["center_m"]).buffer(zone["radius_m"], quad_segs=64)


def is_feasible(mission: Content) -> bool:
    """Search a grid for a ring about the resting target and for ways there, with the documented rooms.

    A mission with a polygon that encloses less than is documented is not a mission.
    """
    if any("polygon_m" in each and shape(each).area < LEAST_AREA_M2 for each in mission["safety"]["no_fly"]):
        return False
    highest_m = FLYING_M + len(mission["vehicles"]) * LAYER_M
    zones = [
        (shape(each), each)
        for each in mission["safety"]["no_fly"]
        if each.get("floor_m", -inf) <= highest_m + ROOM_M and each.get("ceiling_m", inf) >= FLYING_M - ROOM_M
    ]
    low = [s for s, each in zones] + [
        shape(each) for each in mission["safety"]["no_fly"] if each.get("floor_m", -inf) <= highest_m + ROOM_M
    ]
    starts = [shapely.Point(vehicle["start_m"]) for vehicle in mission["vehicles"]]
    target = shapely.Point(mission["target"]["start_m"])
    if any(each.distance(start) < ROOM_M for each in low for start in starts):
        return False
    shapes = [each for each, _ in zones]
    if any(each.contains(target) for each in shapes):
        return False
    return _has_ring(mission, shapes) and _has_ways(mission, shapes)


def _distance_m(shapes: list[shapely.Geometry], x: Vector, y: Vector) -> Vector:
    places = shapely.points(x, y)
    nothing = np.full(np.shape(places), inf)  # no zone is at the flying heights
    return np.asarray(np.min([nothing, *(shapely.distance(each, places) for each in shapes)], axis=0))


def _has_ring(mission: Content, shapes: list[shapely.Geometry]) -> bool:
    """Search closed rings on a polar grid: which radii lead, bearing by bearing, back to themselves after a turn."""
    ring, safety, (x, y) = mission["encirclement"], mission["safety"], mission["target"]["start_m"]
    rate_rad_s, radius_m, count = abs(ring["angular_rate_rad_s"]), ring["radius_m"], len(mission["vehicles"])
    fastest_m = 0.95 * ring.get("speed_max_m_s", 3.0) / rate_rad_s
    least_m = max(1.0, safety["keep_out_m"], safety["separation_m"] / (2.0 * sin(pi / count)))
    radii_m = np.arange(least_m, fastest_m, RADII_M)
    turns = np.arange(BEARINGS) * 2.0 * pi / BEARINGS
    room_m = ROOM_M + ROOM_S * RING_FASTER * rate_rad_s * radius_m
    free = _distance_m(shapes, x + np.outer(np.cos(turns), radii_m), y + np.outer(np.sin(turns), radii_m)) >= room_m
    steepest_m = np.sqrt(np.maximum(fastest_m**2 - radii_m**2, 0.0)) * 2.0 * pi / BEARINGS
    near = np.abs(radii_m[:, None] - radii_m[None, :]) <= np.maximum(steepest_m[:, None], RADII_M)
    leads = np.diag(free[0])
    for k in range(1, BEARINGS + 1):
        leads = ((leads.astype(np.float32) @ near.astype(np.float32)) > 0.0) & free[k % BEARINGS][None, :]
    return bool(np.diag(leads).any())


def _has_ways(mission: Content, shapes: list[shapely.Geometry]) -> bool:
    """Flood a grid from the ring's surroundings; every start has to be in the flood."""
    (x, y), radius_m = mission["target"]["start_m"], mission["encirclement"]["radius_m"]
    across = np.arange(-60.0, 110.0, GRID_M)
    grid_x, grid_y = np.meshgrid(across, across - 25.0, indexing="ij")
    free = _distance_m(shapes, grid_x, grid_y) >= ROOM_M
    parts, _ = ndimage.label(free, structure=np.ones((3, 3)))
    near_ring = np.abs(np.hypot(grid_x - x, grid_y - y) - radius_m) < radius_m / 2.0
    reached = set(parts[near_ring & free].tolist())
    for vehicle in mission["vehicles"]:
        start_x, start_y = vehicle["start_m"]
        i, k = round((start_x + 60.0) / GRID_M), round((start_y + 85.0) / GRID_M)
        around = parts[i - 1 : i + 2, k - 1 : k + 2]
        if not reached & set(around[around > 0].tolist()):
            return False
    return True


@dataclass(frozen=True)
class Flown:
    """A map: its zones, whether the grid search finds it feasible (None: the target moves), and what became of it.

    `clearance_m` is the least true distance to a zone at its heights.
    """

    seed: int
    zones: int
    feasible: bool | None
    refused: str = ""
    clearance_m: float = inf
    entered: int = 0
    encircled: bool = False
    home: bool = False
    holds: tuple[bool | None, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether all flew the ring and are at home, and nobody entered a zone."""
        return self.encircled and self.home and not self.entered

    def __str__(self) -> str:
        verdicts = "".join({True: "+", False: "-", None: "."}[each] for each in self.holds)
        what = self.refused or (
            f"least distance {self.clearance_m:.2f} m, {self.entered} entered, "
            f"{'ring' if self.encircled else 'no ring'}, {'home' if self.home else 'not home'}, C1-C3 {verdicts}"
        )
        return f"map {self.seed}, {self.zones} zones, {_FEASIBLE[self.feasible]}: {what}"


_FEASIBLE = {True: "feasible", False: "infeasible", None: "moving target"}


def clearances_m(mission: Mission, record: FlightRecord) -> Vector:
    """Return the least true distance of each vehicle to the zones that are closed at its height, negative inside."""
    least_m = np.full(len(record.vehicles), inf)
    for zone in mission.safety.no_fly:
        outline = shape(zone.model_dump(exclude_none=True, exclude_defaults=True))
        for row, track in enumerate(record.vehicles):
            height_m = track.altitude_m
            assert height_m is not None
            floor_m = -inf if zone.floor_m is None else zone.floor_m
            closed: NDArray[np.bool_] = (height_m >= floor_m) & (height_m <= (zone.ceiling_m or inf))
            places = shapely.points(track.position_m[closed & np.isfinite(track.position_m[:, 0])])
            away_m = shapely.distance(outline, places)
            inside = shapely.contains(outline, places)
            deep_m = -shapely.distance(shapely.boundary(outline), places)
            least_m[row] = min(least_m[row], np.where(inside, deep_m, away_m).min(initial=inf))
    return least_m


def fly(seed: int) -> Flown:
    """Fly the map of a seed."""
    drawn = random_map(seed)
    zones, rests = len(drawn["safety"]["no_fly"]), drawn["target"]["velocity_m_s"] == [0.0, 0.0]
    feasible = is_feasible(drawn) if rests else None
    try:
        mission = parsed(drawn)
    except MissionError as error:
        return Flown(seed, zones, feasible, refused="refused: " + "; ".join(error.faults))
    duration_s = mission.mission.duration_s
    events = SimulatedEvents(mission, [Commanded(duration_s - HOME_S, "rtl")])
    record = fly_simulated(mission, seed, duration_s, lambda _: None, events=events)
    least_m = clearances_m(mission, record)
    starts_m = [vehicle.section.start_m for vehicle in mission.vehicles]
    ends = zip(record.vehicles, starts_m, strict=True)
    verdicts = evaluated(mission, record).verdicts
    return Flown(
        seed,
        zones,
        feasible,
        clearance_m=float(least_m.min()),
        entered=int((least_m <= 0.0).sum()),
        encircled=all(_turned_rad(mission, record, row) > pi for row in range(len(record.vehicles))),
        home=all(
            track.last_tactic == Tactic.LAND.value and hypot(*(track.position_m[-1] - start)) < HOME_M
            for track, start in ends
        ),
        holds=(verdicts.c1, verdicts.c2, verdicts.c3),
    )


def _turned_rad(mission: Mission, record: FlightRecord, row: int) -> float:
    """Return by how much a vehicle has turned about the target while it encircled, nearer than twice the radius."""
    away_m = (record.vehicles[row].position_m - record.target_path_m)[record.vehicles[row].encircles()]
    near = away_m[np.hypot(*away_m.T) < 2.0 * mission.encirclement.radius_m]
    return float(abs(np.ptp(np.unwrap(np.arctan2(near[:, 1], near[:, 0]))))) if len(near) else 0.0


def table(flights: Sequence[Flown]) -> tuple[str, bool]:
    """Return the table of flights, and whether they hold what is wanted of them."""
    flown = [each for each in flights if not each.refused]
    feasible = [each for each in flights if each.feasible]
    complete = [each for each in feasible if each.complete]
    refused = [each for each in flights if each.refused]
    moving = [each for each in flown if each.feasible is None]
    judged = [each.holds for each in complete if None not in each.holds]
    rows = [
        ("maps", len(flights), ""),
        ("missions flown", len(flown), ""),
        ("vehicles that entered a zone", sum(each.entered for each in flown), ""),
        ("least distance to a zone", f"{min((each.clearance_m for each in flown), default=inf):.2f} m", ""),
        ("feasible by the grid search", len(feasible), ""),
        ("of these complete", len(complete), f"{len(complete) / max(len(feasible), 1):.1%}"),
        ("of these C1, C2 and C3 hold", sum(map(all, judged)), f"of {len(judged)} judged"),
        ("of these refused", sum(bool(each.refused) for each in feasible), ""),
        ("refused about a target at rest", sum(each.feasible is not None for each in refused), ""),
        ("of these infeasible by the grid search", sum(each.feasible is False for each in refused), ""),
        ("infeasible by the grid search, and flown", sum(each.feasible is False for each in flown), ""),
        ("about a moving target", len(moving), f"{sum(each.complete for each in moving)} complete"),
    ]
    lines = ["| | | |", "|---|---|---|", *(f"| {what} | {value} | {note} |" for what, value, note in rows)]
    holds = not any(each.entered for each in flown) and len(complete) >= ceil(LEAST_SHARE * len(feasible))
    return "\n".join(lines), holds


def main(count: int, first: int) -> int:
    """Fly a number of maps, from the seed `first` on, on all cores, and print the table."""
    with ProcessPoolExecutor() as pool:
        flights = []
        for flight in pool.map(fly, range(first, first + count)):
            flights.append(flight)
            if not flight.complete:
                print(flight, file=sys.stderr, flush=True)
    text, holds = table(flights)
    print(text)
    return 0 if holds else 1


if __name__ == "__main__":
    given = seeded_parser("no_fly_maps", __doc__, 300).parse_args()
    sys.exit(main(given.count, given.first))
