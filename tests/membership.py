"""Members that come, go and are lost, over many seeds: `python -m tests.membership 50`.

Everything follows from a seed: who it is, when and where, the ring's rate, the target's course, true plants up to 20 %
off the plant file in each number, and a network that loses and delays; telemetry and sightings are as noisy as in
case2-field. What is measured is the truth of the simulation. Exit code 1 when a limit is missed.
"""

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import cos, inf, isnan, pi, sin, tau

import numpy as np
from numpy.typing import NDArray

from agents.core import VehicleCore
from agents.messages import OperatorCommand, decode, encode
from agents.settings import AgentConfig
from agents.shapes import Shape
from estimation.state import POSITION, Vector
from gcs.mission import Mission
from gcs.simulated import simulated_vehicles
from sitl.absence import Absence
from sitl.simulation import NetworkModel, SimulatedFlight, simulate
from tests.conftest import MISSIONS
from tests.mission_text import Content, content, drawn_vehicle, parsed

FIELD = (MISSIONS / "case2-field.toml").read_text(encoding="utf-8")
CHANGE_S = 60.0
PLANT_OFF_MOST = 0.2
RADIUS_SHARE = 0.05
NEAR_RING_SHARE = 0.15
SPACING_DEG, SPACING_M = 5.0, 0.3


@dataclass(frozen=True)
class Draw:
    """One flight: how long it took until all was well for good, and what must not happen on the way."""

    seed: int
    settled_s: float
    separation_left_m: float
    overtakings: int
    innermost_share: float
    off_most_m: float = 0.0

    def __str__(self) -> str:
        return (
            f"seed {self.seed}: settled after {self.settled_s:.1f} s, separation {self.separation_left_m:+.2f} m, "
            f"{self.overtakings} overtakings, innermost {self.innermost_share:.2f} R, most off {self.off_most_m:.2f} m"
        )


@dataclass(frozen=True)
class Scene:
    """A mission, who is away when, how long it is flown, and from when on settling counts.

    Where somebody was lost the ring is bent: then only the spacing is to settle, not the radius. In formation an
    operator asks for the `shapes` at their times. The radio of `unheard_id` is gone from `CHANGE_S` on, both ways.
    """

    mission: Mission
    absences: tuple[Absence, ...]
    duration_s: float
    from_s: float
    bent: bool = False
    shapes: tuple[tuple[float, Shape], ...] = ()
    unheard_id: int | None = None

    def there(self, time_s: Vector) -> NDArray[np.bool_]:
        """Return whose agents are there (T, N)."""
        there = np.ones((time_s.size, len(self.mission.ids)), dtype=np.bool_)
        for absence in self.absences:
            away = (time_s >= absence.from_s) & (time_s < absence.to_s)
            there[away, self.mission.ids.index(absence.vehicle_id)] = False
        return there


class _CutOff(VehicleCore):
    """An agent that hears nothing of one whose radio is gone; that one hears nothing at all."""

    def __init__(self, unheard_id: int, config: AgentConfig) -> None:
        super().__init__(config)
        self._unheard_id, self._hears = unheard_id, config.vehicle_id != unheard_id

    def on_message(self, payload: bytes, now_s: float) -> None:
        message = decode(payload)
        sender = None if isinstance(message, OperatorCommand) else message.sender
        if now_s < CHANGE_S or (self._hears and sender != self._unheard_id):
            super().on_message(payload, now_s)


def flown(scene: Scene, seed: int) -> SimulatedFlight:
    """Fly a scene."""
    network = scene.mission.network
    core = VehicleCore if scene.unheard_id is None else partial(_CutOff, scene.unheard_id)
    vehicles = simulated_vehicles(scene.mission, seed, core, scene.absences)
    shapes = list(scene.shapes)

    def tell(now_s: float) -> None:
        if shapes and now_s >= shapes[0][0]:
            _, shape = shapes.pop(0)
            # One hears it; the others have it from each other.
            told = next(vehicle for vehicle in vehicles if vehicle.present)
            command = OperatorCommand(now_s, "formation", None, "tower", len(shapes), shape)
            told.core.on_message(encode(command), now_s)

    return simulate(
        vehicles,
        NetworkModel(network.range_m, network.delay_s, network.loss),
        rate_hz=scene.mission.mission.rate_hz,
        duration_s=scene.duration_s,
        seed=seed,
        observe=lambda *_: None,
        progress=tell,
    )


def field(
    random: np.random.Generator,
    starts_m: list[tuple[float, float]],
    *,
    radius_m: float,
    rate_rad_s: float,
    target_m: tuple[float, float],
) -> Content:
    """Return case2-field with this many vehicles, which all see the target and want to encircle it."""
    mission = content(FIELD)
    course_rad, speed_m_s = float(random.uniform(0.0, tau)), float(random.uniform(0.0, 0.2))
    mission["encirclement"] |= {"radius_m": radius_m, "angular_rate_rad_s": rate_rad_s, "radius_far_m": 3.0 * radius_m}
    mission["decision"]["distance_max_m"] = 200.0
    mission["target"] |= {
        "start_m": list(target_m),
        "velocity_m_s": [speed_m_s * cos(course_rad), speed_m_s * sin(course_rad)],
    }
    mission["target"]["sensor"]["range_m"] = 200.0
    mission["network"] |= {"delay_s": float(random.uniform(0.0, 0.15)), "loss": float(random.uniform(0.0, 0.3))}
    vehicles = (drawn_vehicle(random, slot, start_m, PLANT_OFF_MOST) for slot, start_m in enumerate(starts_m))
    mission["vehicles"] = list(vehicles)
    return mission


def abreast(count: int) -> list[tuple[float, float]]:
    return [(0.0, ((count - 1) / 2.0 - slot) * 5.0) for slot in range(count)]


def drawn_rate(random: np.random.Generator, least: float, most: float) -> float:
    return float(random.uniform(least, most) * random.choice([-1.0, 1.0]))


# The scenes


def loss_on_the_ring(seed: int) -> Scene:
    """Three on the ring; one dies."""
    random = np.random.default_rng([1, seed])
    mission = field(random, abreast(3), radius_m=10.0, rate_rad_s=drawn_rate(random, 0.05, 0.15), target_m=(14.0, -5.0))
    lost = Absence(int(random.integers(1, 4)), CHANGE_S)
    return Scene(parsed(mission), (lost,), 130.0, CHANGE_S, bent=True)


def cut_off_on_the_ring(seed: int) -> Scene:
    """Three to eight on the ring; one's radio fails, and it flies on until it notices."""
    random = np.random.default_rng([9, seed])
    count = int(random.integers(3, 9))
    radius_m = max(10.0, float(random.uniform(1.5, 2.5)) * 3.0 / (2.0 * sin(pi / count)))
    rate = drawn_rate(random, 0.05, min(0.15, 1.5 / radius_m))
    mission = field(random, abreast(count), radius_m=radius_m, rate_rad_s=rate, target_m=(radius_m + 4.0, -5.0))
    unheard_id = int(random.integers(1, count + 1))
    return Scene(parsed(mission), (), 130.0, CHANGE_S, bent=True, unheard_id=unheard_id)


def join_on_the_ring(seed: int) -> Scene:
    """Two on the ring; a third comes up somewhere outside of it, or comes back there."""
    random = np.random.default_rng([2, seed])
    mission = field(random, abreast(3), radius_m=10.0, rate_rad_s=drawn_rate(random, 0.05, 0.15), target_m=(14.0, -5.0))
    bearing_rad, away_m = random.uniform(0.0, tau), random.uniform(14.0, 30.0)
    place_m = float(14.0 + away_m * cos(bearing_rad)), float(-5.0 + away_m * sin(bearing_rad))
    left_s = float(random.choice([0.0, 20.0]))
    comer = Absence(int(random.integers(1, 4)), left_s, CHANGE_S, place_m)
    return Scene(parsed(mission), (comer,), 130.0, CHANGE_S)


def leader_lost(seed: int) -> Scene:
    """Three to six in formation; the leader dies."""
    random = np.random.default_rng([3, seed])
    count = int(random.integers(3, 7))
    mission = field(random, abreast(count), radius_m=10.0, rate_rad_s=0.05, target_m=(14.0, -5.0))
    leader = int(random.integers(1, count + 1))
    mission["target"]["threat"] = 0.9
    mission["formation"] |= {"leader": leader, "speed_m_s": float(random.uniform(0.1, 1.0))}
    return Scene(parsed(mission), (Absence(leader, CHANGE_S),), 100.0, CHANGE_S)


def leader_cut_off(seed: int) -> Scene:
    """Three to six in formation; the leader's radio fails, and it flies on until it notices."""
    scene = leader_lost(seed)
    return replace(scene, absences=(), unheard_id=scene.mission.formation.leader)


def leader_back(seed: int) -> Scene:
    """Three to six in formation; the leader dies, and comes back from somewhere behind."""
    scene = leader_lost(seed)
    (lost,), random = scene.absences, np.random.default_rng([6, seed])
    back_s = CHANGE_S + float(random.uniform(10.0, 30.0))
    speed_m_s = scene.mission.formation.speed_m_s
    place_m = speed_m_s * back_s - float(random.uniform(8.0, 16.0)), float(random.uniform(-10.0, 10.0))
    return replace(scene, absences=(replace(lost, to_s=back_s, at_m=place_m),), duration_s=150.0, from_s=back_s)


def reshaped(seed: int) -> Scene:
    """Three to six in one shape are told to take another."""
    scene, random = leader_lost(seed), np.random.default_rng([7, seed])
    before, after = random.permutation(["line", "column", "wedge"])[:2].tolist()
    return replace(scene, absences=(), shapes=((0.0, before), (CHANGE_S, after)), duration_s=120.0)


def sixteen(seed: int) -> Scene:
    """Sixteen in a line encircle one target."""
    random = np.random.default_rng([4, seed])
    target_m = float(random.uniform(20.0, 60.0)), float(random.uniform(-20.0, 20.0))
    mission = field(random, abreast(16), radius_m=40.0, rate_rad_s=drawn_rate(random, 0.02, 0.05), target_m=target_m)
    return Scene(parsed(mission), (), 200.0, 0.0)


def two_groups(seed: int) -> Scene:
    """Two groups come to one target from two sides, at first out of each other's reach."""
    random = np.random.default_rng([8, seed])
    here, there = (int(each) for each in random.integers(1, 5, 2))
    away_m = float(random.uniform(30.0, 40.0))
    starts = [(0.0, y) for _, y in abreast(here)] + [(away_m * 2.0, y) for _, y in abreast(there)]
    rate = drawn_rate(random, 0.05, 0.12)
    mission = field(random, starts, radius_m=12.0, rate_rad_s=rate, target_m=(away_m, 0.0))
    mission["network"]["range_m"] = 40.0
    return Scene(parsed(mission), (), 120.0, 0.0)


def coming_and_going(seed: int) -> Scene:
    """Up to ten at a ring with little room to spare: some come late, some are lost, some of these come back."""
    random = np.random.default_rng([5, seed])
    count = int(random.integers(4, 11))
    radius_m = max(8.0, float(random.uniform(1.5, 2.5)) * 3.0 / (2.0 * sin(pi / count)))
    rate = drawn_rate(random, 0.04, min(0.15, 1.5 / radius_m))
    mission = field(random, abreast(count), radius_m=radius_m, rate_rad_s=rate, target_m=(radius_m + 4.0, -5.0))
    absences = []
    for vehicle_id in random.permutation(count)[: count // 2] + 1:
        bearing_rad, away_m = random.uniform(0.0, tau), radius_m + random.uniform(10.0, 25.0)
        place_m = float(radius_m + 4.0 + away_m * cos(bearing_rad)), float(-5.0 + away_m * sin(bearing_rad))
        from_s = float(random.choice([0.0, 5.0 * random.integers(8, 14)]))
        back_s = float(random.choice([CHANGE_S * 2.0 - random.integers(0, 40), inf])) if from_s else CHANGE_S
        absences.append(Absence(int(vehicle_id), from_s, back_s, place_m))
    last_s = max(time_s for absence in absences for time_s in (absence.from_s, absence.to_s) if time_s < inf)
    return Scene(parsed(mission), tuple(absences), 240.0, last_s, bent=True)


# What is measured


def measured(build: Callable[[int], Scene], in_formation: bool, seed: int) -> Draw:
    """Fly the scene of a seed and measure."""
    scene = build(seed)
    flight = flown(scene, seed)
    gone = [scene.unheard_id, *(absence.vehicle_id for absence in scene.absences if absence.to_s == inf)]
    stay = np.array([each not in gone for each in scene.mission.ids])
    if in_formation:
        settled_s, off_m = formation_settled_s(scene, flight, stay)
        return Draw(seed, settled_s, separation_left_m(scene, flight), 0, inf, off_m)
    target = scene.mission.target.motion
    about = np.array([target.position_m(time_s) for time_s in flight.time_s.tolist()])
    polar = (flight.motion[..., POSITION] - about[:, None]) @ np.array([1.0, 1.0j])
    ring_m = scene.mission.encirclement.radius_m
    after = flight.time_s >= scene.from_s
    polar_there = np.where(scene.there(flight.time_s), polar, np.nan)
    since_s = flight.time_s[after] - scene.from_s
    return Draw(
        seed,
        ring_settled_s(since_s, polar[after][:, stay], inf if scene.bent else RADIUS_SHARE, ring_m),
        separation_left_m(scene, flight),
        overtakings(polar_there, ring_m),
        innermost_share(polar_there, ring_m),
    )


def settled_s(time_s: Vector, well: NDArray[np.bool_]) -> float:
    """Return from when on all is well for good, inf if it is not at the end."""
    if not well[-1]:
        return inf
    bad = np.flatnonzero(~well)
    return 0.0 if bad.size == 0 else float(time_s[bad[-1] + 1])


def ring_settled_s(time_s: Vector, polar: NDArray[np.complex128], radius_share: float, ring_m: float) -> float:
    turns = np.sort(np.angle(polar), axis=1)
    gaps = np.diff(turns, axis=1, append=turns[:, :1] + tau)
    even = np.degrees(np.abs(gaps - tau / polar.shape[1])).max(axis=1) <= SPACING_DEG
    round_ = np.abs(np.abs(polar) / ring_m - 1.0).max(axis=1) <= radius_share
    return settled_s(time_s, even & round_)


def formation_settled_s(scene: Scene, flight: SimulatedFlight, stay: NDArray[np.bool_]) -> tuple[float, float]:
    """Return when every spacing between neighbours is right for good after the loss, and how wrong one was."""
    config = scene.mission.agent_config(scene.mission.vehicles[0])
    if scene.shapes:
        config = config.reshaped(scene.shapes[-1][1])
    slots = np.array([config.slot_offset_m(each, scene.mission.ids[0]) for each in scene.mission.ids])
    off = (flight.motion[..., POSITION] - slots)[:, stay]
    error_m = np.linalg.norm(np.diff(off, axis=1), axis=-1).max(axis=1)
    after = flight.time_s >= scene.from_s
    return settled_s(flight.time_s[after] - scene.from_s, error_m[after] <= SPACING_M), float(error_m[after].max())


def separation_left_m(scene: Scene, flight: SimulatedFlight) -> float:
    """Return by how much the closest two in the air were farther apart than they must."""
    least = inf
    for one, other in combinations(range(flight.motion.shape[1]), 2):
        both = flight.aloft[:, one] & flight.aloft[:, other]
        apart_m = np.linalg.norm(flight.motion[both, one, :2] - flight.motion[both, other, :2], axis=-1)
        least = min(least, float(apart_m.min(initial=inf)))
    return least - scene.mission.safety.separation_m


def overtakings(polar: NDArray[np.complex128], ring_m: float) -> int:
    """Return how often one passed another while both were at the ring."""
    count = 0
    near = np.abs(np.abs(polar) / ring_m - 1.0) <= NEAR_RING_SHARE
    for one, other in combinations(range(polar.shape[1]), 2):
        between = np.angle(polar[:, one] * polar[:, other].conj())
        both = near[:, one] & near[:, other]
        passed = (np.sign(between[1:]) != np.sign(between[:-1])) & (np.abs(between[1:]) < pi / 2.0)
        count += int((passed & both[1:] & both[:-1]).sum())
    return count


def innermost_share(polar: NDArray[np.complex128], ring_m: float) -> float:
    """Return how far in anybody came who was on the ring, as a share of its radius; absence (NaN) begins anew."""
    least = inf
    for radius in np.abs(polar).T:
        reached = False
        for share in (radius / ring_m).tolist():
            reached = not isnan(share) and (reached or share >= 1.0 - RADIUS_SHARE)
            least = min(least, share) if reached else least
    return least


SCENES: dict[str, tuple[Callable[[int], Scene], bool, float]] = {
    "3 -> 2 on the ring": (loss_on_the_ring, False, 40.0),
    "cut off on the ring": (cut_off_on_the_ring, False, 60.0),
    "2 -> 3 on the ring": (join_on_the_ring, False, 60.0),
    "leader lost in formation": (leader_lost, True, 20.0),
    "leader cut off in formation": (leader_cut_off, True, 20.0),
    "leader back in formation": (leader_back, True, 45.0),
    "another shape": (reshaped, True, 45.0),
    "16 on a ring of 40 m": (sixteen, False, 180.0),
    "two groups at one target": (two_groups, False, 90.0),
    "coming and going": (coming_and_going, False, 60.0),
}


def main(arguments: list[str]) -> int:
    """Fly as many seeds of each scene as the first argument says; further ones choose scenes by their beginnings."""
    count, chosen = int(arguments[0]), arguments[1:]
    missed = 0
    with ProcessPoolExecutor() as pool:
        for name, (build, in_formation, limit_s) in SCENES.items():
            if chosen and not any(name.startswith(each) for each in chosen):
                continue
            draws = list(pool.map(partial(measured, build, in_formation), range(count)))
            took_s = np.array([draw.settled_s for draw in draws])
            bad = [d for d in draws if not (d.settled_s <= limit_s and d.separation_left_m >= 0.0)]
            missed += len(bad)
            print(
                f"{name}: settled after {np.median(took_s):.1f} s in the middle, {took_s.max():.1f} s at worst (limit "
                f"{limit_s:g} s); separation {min(d.separation_left_m for d in draws):+.2f} m; "
                f"{sum(d.overtakings for d in draws)} overtakings; innermost "
                f"{min(d.innermost_share for d in draws):.2f} R; most off {max(d.off_most_m for d in draws):.2f} m; "
                f"{len(bad)} of {count} miss",
                *bad,
                sep="\n  ",
                flush=True,
            )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
