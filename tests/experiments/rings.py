"""Fly random teams about several targets and on several rings, and measure places, rings, separation and changes.

A seed determines whether there are two to four targets with a ring each, or rings of one target that are stacked or
concentric; how many vehicles of which plants come from a line, noise, delay and loss of messages; and whether one of
them is lost in flight, or the first target becomes unimportant. Measured is the true motion. Exit code 1 if a limit is
exceeded.
"""

import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import combinations, pairwise
from math import cos, dist, inf, pi, sin, tau

import numpy as np
from numpy.typing import NDArray

from agents.outputs import TickOutput
from agents.tactics import Tactic
from gcs.metrics.record import Mask
from gcs.mission.mission import Mission
from sitl.simulation.simulation import Absence, SimulatedFlight
from tests.experiments.arguments import seeded_parser
from tests.experiments.membership_scenes import PLANT_OFF_MOST, Scene, abreast, drawn_rate, flown
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


def drawn(seed: int) -> Scene:
    """Return the mission of a seed, and who is lost."""
    random = np.random.default_rng([21, seed])
    kind, count = str(random.choice(["targets", "stack", "concentric"])), int(random.integers(3, 13))
    number = int(random.integers(2, 5 if kind == "targets" else 4))
    mission = content(CASE2)
    starts_m = abreast(count)
    mission["formation"] |= {"leader": count // 2 + 1, "speed_m_s": 0.3}
    mission["vehicles"] = [drawn_vehicle(random, slot, at_m, PLANT_OFF_MOST) for slot, at_m in enumerate(starts_m)]
    mission["mission"]["duration_s"] = DURATION_S
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
        if random.random() < 0.5:
            mission["targets"][0]["changes"] = [[FALLEN_S, 0.2, 0.2]]
    lost = (Absence(int(random.integers(1, count + 1)), LOST_S),) if random.random() < 0.5 else ()
    return Scene(parsed(mission), lost, DURATION_S, ON_RINGS_S)


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


@dataclass(frozen=True)
class Rings:
    """One flight: what misses its limit, how often vehicles changed rings, and the worst of each quantity."""

    seed: int
    vehicles: int
    rings: int
    kind: str
    changes: int
    left_m: float
    radius_m: float
    rate_rad_s: float
    spacing_deg: float
    reasons: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"seed {self.seed}: {self.vehicles} vehicles, {self.rings} rings ({self.kind}), {self.changes} changes, "
            f"separation {self.left_m:+.2f} m, radius {self.radius_m:.3f} m, rate {self.rate_rad_s:.5f} rad/s, "
            f"spacing {self.spacing_deg:.2f} deg{''.join(f'; {each}' for each in self.reasons)}"
        )


def measured(seed: int) -> Rings:
    """Fly the team of a seed, and measure."""
    scene = drawn(seed)
    mission, count = scene.mission, len(scene.mission.ids)
    ticks = round(scene.duration_s * mission.mission.rate_hz) + 1
    on = np.full((ticks, count), -1)

    def observe(tick: int, vehicle: int, output: TickOutput) -> None:
        status = output.status
        on[tick, vehicle] = status.ring if status.tactic is Tactic.ENCIRCLE else -1

    flight = flown(scene, seed, observe)
    there, judged_from = scene.there(flight.time_s), ticks - round(JUDGED_S * mission.mission.rate_hz)
    on[~there] = -1
    each_changes = [_changes(on[:, index]) for index in range(count)]
    fallen = bool(mission.targets) and bool(mission.targets[0].changes)
    most = len(scene.absences) + fallen
    reasons = [f"vehicle {i} changed {n} times" for i, n in zip(mission.ids, each_changes, strict=True) if n > most]
    if fallen and there[-1].sum() <= sum(each.places for each in mission.rings[1:]) and (on[judged_from:] == 0).any():
        reasons.append("a vehicle stays with the unimportant target though there is a place elsewhere")
    worst = np.zeros(3)
    judged = flight.time_s >= flight.time_s[judged_from]
    for number, ring in enumerate(mission.rings):
        members = np.flatnonzero((on[judged] == number).any(axis=0))
        if len(members) > ring.places:
            reasons.append(f"{len(members)} vehicles on {ring.places} places of {ring.name}")
        if members.size:
            found = np.array([*_ring(mission.of_ring(number), flight, judged, members)])
            worst = np.maximum(worst, found)
    without = [mission.ids[index] for index in range(count) if there[-1, index] and (on[judged, index] < 0).any()]
    reasons += [f"vehicle {each} is on no ring" for each in without]
    radius_m, rate_rad_s, spacing_deg = worst.tolist()
    for value, limit, name in zip(
        worst, (RADIUS_M, RATE_RAD_S, SPACING_DEG), ("radius", "rate", "spacing"), strict=True
    ):
        reasons += [f"{name} {value:.4g}"] if value > limit else []
    left_m = separation_left_m(scene, flight)
    reasons += [f"separation {left_m:+.2f} m"] if left_m < 0.0 else []
    kind = (
        "targets"
        if mission.targets
        else "stack"
        if mission.rings[0].encirclement.altitude_m is not None
        else "concentric"
    )
    return Rings(
        seed,
        count,
        len(mission.rings),
        kind,
        sum(each_changes),
        left_m,
        radius_m,
        rate_rad_s,
        spacing_deg,
        tuple(reasons),
    )


def _changes(rings: NDArray[np.intp]) -> int:
    """Return how often a vehicle went from one ring to another."""
    flown_on = rings[rings >= 0]
    return sum(1 for before, after in pairwise(flown_on.tolist()) if before != after)


def _ring(mission: Mission, flight: SimulatedFlight, judged: Mask, members: NDArray[np.intp]) -> Iterator[float]:
    """Return of a ring the largest radius error (rms), error of the mean rate, and spacing error (rms)."""
    time_s = flight.time_s[judged]
    centre_m, _ = mission.target.motion.over(time_s)
    place_m = flight.motion[judged][:, members, :2] - centre_m[:, None]
    radius_m, bearing_rad = (
        np.hypot(*np.moveaxis(place_m, 2, 0)),
        np.unwrap(np.arctan2(place_m[..., 1], place_m[..., 0]), axis=0),
    )
    ring = mission.encirclement
    yield float(np.sqrt(np.mean((radius_m - ring.radius_m) ** 2, axis=0)).max())
    rates = (bearing_rad[-1] - bearing_rad[0]) / (time_s[-1] - time_s[0])
    yield float(np.abs(rates - ring.angular_rate_rad_s).max())
    in_order = np.sort(bearing_rad % tau, axis=1)
    gaps_rad = np.diff(in_order, axis=1, append=in_order[:, :1] + tau)
    yield float(np.degrees(np.sqrt(np.mean((gaps_rad - tau / len(members)) ** 2, axis=0)).max()))


def separation_left_m(scene: Scene, flight: SimulatedFlight) -> float:
    """Return the smallest distance beyond the separation between two in the air that are not above each other."""
    least, safety = inf, scene.mission.safety
    for one, other in combinations(range(flight.motion.shape[1]), 2):
        both = flight.aloft[:, one] & flight.aloft[:, other]
        level = np.abs(flight.altitude_m[:, one] - flight.altitude_m[:, other]) < safety.vertical_separation_m - 0.5
        near = both & level
        apart_m = np.linalg.norm(flight.motion[near, one, :2] - flight.motion[near, other, :2], axis=-1)
        least = min(least, float(apart_m.min(initial=inf)))
    return least - safety.separation_m


def main(count: int, first: int) -> int:
    """Fly a number of teams, from the seed `first` on, on all cores."""
    flights = []
    with ProcessPoolExecutor() as pool:
        for flight in pool.map(measured, range(first, first + count)):
            flights.append(flight)
            print(flight, flush=True)
    missed = [each for each in flights if each.reasons]
    print(f"separation left: {min(each.left_m for each in flights):+.2f} m at least")
    radius_m, spacing_deg = max(each.radius_m for each in flights), max(each.spacing_deg for each in flights)
    print(f"radius {radius_m:.3f} m, spacing {spacing_deg:.2f} deg at most")
    print(f"{len(missed)} of {count} miss a limit")
    return 1 if missed else 0


if __name__ == "__main__":
    given = seeded_parser("rings", __doc__, 20).parse_args()
    sys.exit(main(given.count, given.first))
