"""Fly random teams about several targets and on several rings, and measure places, rings, separation and changes.

A seed determines whether there are two to four targets with a ring each, or rings of one target that are stacked or
concentric; how many vehicles of which plants come from a line, noise, delay and loss of messages; and whether one of
them is lost in flight, or the first target becomes unimportant. Measured is the true motion. Exit code 1 if a limit is
exceeded.
"""

import sys
from collections.abc import Iterator
from itertools import pairwise
from math import cos, dist, pi, sin, tau

import numpy as np
from numpy.typing import NDArray

from gcs.metrics.record import FlightRecord, Mask
from gcs.metrics.references import DesiredRing, ring_references
from gcs.mission.mission import Mission
from sitl.simulation.simulation import Absence
from tests.experiments.arguments import seeded_parser
from tests.experiments.judged import Judged, Measure, judged_flights
from tests.experiments.membership import separation_left_m
from tests.experiments.membership_scenes import PLANT_OFF_MOST, Scene, abreast, drawn_rate
from tests.experiments.random_joins import recorded
from tests.support.mission_text import CASE2, Content, content, drawn_vehicle, parsed

ON_RINGS_S, LOST_S, FALLEN_S, JUDGED_S = 80.0, 90.0, 95.0, 40.0
"""When all are on their rings, when one is lost or a target unimportant, and how long the flight's end is judged."""
DURATION_S = 200.0
LOST_AVOIDED_S = 30.0
"""How long the ring is bent around a lost vehicle: it is round again when it is judged."""
RADIUS_M, RATE_RAD_S, SPACING_DEG = 0.3, 0.002, 4.0
"""Limits of a ring at the end, root mean squares, and the mean of the rate, with noise and plants that are off."""
ALTITUDES_M = (8.0, 12.0, 16.0)
VERTICAL_M = 3.0
KINDS = ("targets", "stack", "concentric")


def drawn(seed: int) -> Scene:
    """Return the mission of a seed, and who is lost."""
    random = np.random.default_rng([21, seed])
    mission = team(random)
    mission["mission"]["duration_s"] = DURATION_S
    if "targets" in mission and random.random() < 0.5:
        mission["targets"][0]["changes"] = [[FALLEN_S, 0.2, 0.2]]
    count = len(mission["vehicles"])
    lost = (Absence(int(random.integers(1, count + 1)), LOST_S),) if random.random() < 0.5 else ()
    return Scene(parsed(mission), lost, DURATION_S, ON_RINGS_S)


def team(random: np.random.Generator, most: int = 12, off_most: float = PLANT_OFF_MOST) -> Content:
    """Return the mission of three to `most` vehicles, whose plants are off by up to a share, in a line before rings."""
    kind = KINDS[random.integers(len(KINDS))]
    count = int(random.integers(3, most + 1))
    number = int(random.integers(2, 5 if kind == "targets" else 4))
    mission = content(CASE2)
    starts_m = abreast(count)
    mission["formation"] |= {"leader": count // 2 + 1, "speed_m_s": 0.3}
    mission["vehicles"] = [drawn_vehicle(random, slot, at_m, off_most) for slot, at_m in enumerate(starts_m)]
    mission["decision"]["distance_max_m"] = 300.0
    mission["safety"] |= {"vertical_separation_m": VERTICAL_M, "lost_avoided_s": LOST_AVOIDED_S}
    mission["network"] = {
        "range_m": 500.0,
        "delay_s": float(random.uniform(0.0, 0.15)),
        "loss": float(random.uniform(0.0, 0.3)),
    }
    mission["simulation"] = {"position_noise_m": 0.1, "velocity_noise_m_s": 0.05}
    target = mission["target"]
    target["sensor"] |= {"range_m": 300.0, "noise_m": float(random.uniform(0.05, 0.4))}
    target["velocity_m_s"] = [0.0, 0.0]
    places = _places(random, count, number)
    least_m = [max(6.0, 1.5 * 3.0 / (2.0 * sin(pi / max(each, 2)))) for each in places]
    radii_m = [float(random.uniform(each, each + 6.0)) for each in least_m]
    if kind == "stack":
        radii_m = [max(radii_m)] * number
    if kind == "concentric":
        radii_m = [least_m[0] + sum(least_m[1 : k + 1]) + 7.0 * k for k in range(number)]
    clear_m = max(radii_m) + 10.0
    target["start_m"] = [clear_m, 0.0]
    mission["rings"] = [
        {
            "name": f"ring{k}",
            "places": places[k],
            "radius_m": radii_m[k],
            "angular_rate_rad_s": _rate(random, radii_m[k]),
        }
        for k in range(number)
    ]
    if kind == "stack":
        for ring, altitude_m in zip(mission["rings"], ALTITUDES_M, strict=False):
            ring["altitude_m"] = altitude_m
    if kind == "targets":
        mission["targets"] = _targets(random, radii_m, clear_m)
        for k, ring in enumerate(mission["rings"]):
            ring["target"] = f"target{k}"
    return mission


def _places(random: np.random.Generator, count: int, number: int) -> list[int]:
    """Return the places of each ring: enough for all, and up to two more."""
    places = [1] * number
    for _ in range(max(0, count - number) + int(random.integers(0, 3))):
        places[int(random.integers(number))] += 1
    return places


def _rate(random: np.random.Generator, radius_m: float) -> float:
    return drawn_rate(random, 0.4 / radius_m, 1.2 / radius_m)


def _targets(random: np.random.Generator, radii_m: list[float], ahead_m: float) -> list[Content]:
    """Return targets ahead of the line that drift slowly, whose rings stay apart."""
    placed: list[tuple[float, float]] = []
    while len(placed) < len(radii_m):
        at_m = float(ahead_m + random.uniform(0.0, 60.0)), float(random.uniform(-70.0, 70.0))
        mine_m = radii_m[len(placed)]
        if all(dist(at_m, each) > mine_m + radius_m + 25.0 for each, radius_m in zip(placed, radii_m, strict=False)):
            placed.append(at_m)
    targets = []
    for number, at_m in enumerate(placed):
        course_rad, speed_m_s = float(random.uniform(0.0, tau)), float(random.uniform(0.0, 0.04))
        velocity_m_s = [speed_m_s * cos(course_rad), speed_m_s * sin(course_rad)]
        worth = {"importance": float(random.uniform(0.7, 1.0)), "threat": float(random.uniform(0.0, 0.4))}
        targets.append({"name": f"target{number}", "start_m": list(at_m), "velocity_m_s": velocity_m_s, **worth})
    return targets


def measured(seed: int) -> Judged:
    """Fly the team of a seed, and measure."""
    scene = drawn(seed)
    mission = scene.mission
    record, flight, _ = recorded(scene, seed)
    on = on_rings(record)
    changes = {vehicle: _changes(row) for vehicle, row in zip(mission.ids, on, strict=True)}
    fallen = bool(mission.targets) and bool(mission.targets[0].changes)
    most = len(scene.absences) + fallen
    faults = [f"vehicle {vehicle} changed {times} times" for vehicle, times in changes.items() if times > most]
    judged, there = late(record, JUDGED_S), scene.there(flight.time_s)[-1]
    if fallen and there.sum() <= sum(each.places for each in mission.rings[1:]) and (on[:, judged] == 0).any():
        faults.append("a vehicle stays with the unimportant target though there is a place elsewhere")
    about = (
        f"{len(mission.ids)} vehicles, {len(mission.rings)} rings ({kind_of(mission)}), {sum(changes.values())} changes"
    )
    faults += place_faults(mission, on[:, judged], there)
    separation = Measure("separation", separation_left_m(scene, flight), 0.0, "m", at_least=True)
    return Judged(seed, about, (separation, *conditions(mission, record, JUDGED_S)), tuple(faults))


def kind_of(mission: Mission) -> str:
    """Return what kind the rings of a mission of `team` are."""
    if mission.targets:
        return "targets"
    altitudes_m = {each.encirclement.altitude_m for each in mission.rings}
    return "stack" if len(altitudes_m) > 1 else "concentric"


def on_rings(record: FlightRecord) -> NDArray[np.intp]:
    """Return the number of the ring (V, T) on which a vehicle encircles, -1 for none."""
    rows = [np.where(each.encircles(), 0 if each.ring is None else each.ring, -1) for each in record.vehicles]
    return np.array(rows, dtype=np.intp)


def late(record: FlightRecord, last_s: float) -> Mask:
    """Return the last samples (T,) of a flight."""
    return np.asarray(record.time_s >= record.time_s[-1] - last_s)


def place_faults(mission: Mission, on: NDArray[np.intp], there: Mask) -> list[str]:
    """Return which rings (V, T) had more vehicles than places, and which vehicles that are there were on none."""
    faults = []
    for number, ring in enumerate(mission.rings):
        members = (on == number).any(axis=1).sum()
        faults += [f"{members} vehicles on {ring.places} places of {ring.name}"] if members > ring.places else []
    without = there & (on < 0).any(axis=1)
    return faults + [
        f"vehicle {each} is on no ring" for each, is_off in zip(mission.ids, without, strict=True) if is_off
    ]


def conditions(mission: Mission, record: FlightRecord, last_s: float) -> tuple[Measure, ...]:
    """Return how far rings miss the paper's conditions at the end, as they were commanded last, the worst of each.

    These are the radius error (root mean square), the error of the mean rate, and the spacing error (root mean square).
    """
    worst, judged, on = np.zeros(3), late(record, last_s), on_rings(record)
    for number, ring in enumerate(ring_references(mission, record)):
        if (members := np.flatnonzero((on[:, judged] == number).any(axis=1))).size:
            worst = np.maximum(worst, [*_ring(record.of_ring(number), ring, judged, members)])
    limits = (("radius", RADIUS_M, "m"), ("rate", RATE_RAD_S, "rad/s"), ("spacing", SPACING_DEG, "deg"))
    return tuple(
        Measure(name, value, limit, unit) for value, (name, limit, unit) in zip(worst.tolist(), limits, strict=True)
    )


def _changes(rings: NDArray[np.intp]) -> int:
    """Return how often a vehicle went from one ring to another."""
    flown_on = rings[rings >= 0]
    return sum(1 for before, after in pairwise(flown_on.tolist()) if before != after)


def _ring(record: FlightRecord, ring: DesiredRing, judged: Mask, members: NDArray[np.intp]) -> Iterator[float]:
    """Return of a ring the largest radius error (rms), error of the mean rate, and spacing error (rms)."""
    time_s = record.time_s[judged]
    place_m = np.array([record.vehicles[each].position_m - record.target_position_m for each in members])[:, judged]
    radius_m = np.hypot(place_m[..., 0], place_m[..., 1])
    bearing_rad = np.unwrap(np.arctan2(place_m[..., 1], place_m[..., 0]), axis=1)
    yield float(np.sqrt(np.mean((radius_m - ring.radius_m) ** 2, axis=1)).max())
    rates = (bearing_rad[:, -1] - bearing_rad[:, 0]) / (time_s[-1] - time_s[0])
    yield float(np.abs(rates - ring.angular_rate_rad_s).max())
    in_order = np.sort(bearing_rad % tau, axis=0)
    gaps_rad = np.diff(in_order, axis=0, append=in_order[:1] + tau)
    yield float(np.degrees(np.sqrt(np.mean((gaps_rad - tau / len(members)) ** 2, axis=1)).max()))


if __name__ == "__main__":
    given = seeded_parser("rings", __doc__, 20).parse_args()
    flights = judged_flights(measured, given.first, given.count)
    sys.exit(1 if any(each.reasons for each in flights) else 0)
