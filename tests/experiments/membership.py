"""Fly teams whose members join, leave and are lost, and measure the settling times of rings and formations.

A seed determines the member, time and place, the ring's rate, the target's path, true plants with parameters up to 20 %
off the plant file, and a network with loss and delay; telemetry and sightings are as noisy as in case2-field. Measured
is the true motion. Exit code 1 if a limit is exceeded.
"""

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import inf, isnan, pi, tau

import numpy as np
from numpy.typing import NDArray

from estimation.state import POSITION, Vector
from sitl.simulation.simulation import SimulatedFlight
from tests.experiments.arguments import parser
from tests.experiments.membership_scenes import SCENES, Scene, flown

ON_RING_SHARE = 0.05
NEAR_RING_SHARE = 0.15
SPACING_DEG, SPACING_M = 5.0, 0.3
HEIGHTS_OFF_M = 0.5
"""How far the heights of two vehicles above each other are off theirs, in sum."""


@dataclass(frozen=True)
class Draw:
    """One flight: its settling times, and violations before.

    The spacing has settled once every spacing stays within its limit; the ring, once every radius does as well.
    """

    seed: int
    spaced_s: float
    settled_s: float
    separation_left_m: float
    overtakings: int
    innermost_share: float
    off_most_m: float = 0.0

    def __str__(self) -> str:
        return (
            f"seed {self.seed}: spaced after {self.spaced_s:.1f} s, settled after {self.settled_s:.1f} s, "
            f"separation {self.separation_left_m:+.2f} m, {self.overtakings} overtakings, "
            f"innermost {self.innermost_share:.2f} R, most off {self.off_most_m:.2f} m"
        )


def measured(build: Callable[[int], Scene], in_formation: bool, seed: int) -> Draw:
    """Fly the scene of a seed and measure."""
    scene = build(seed)
    flight = flown(scene, seed)
    stay = np.array([each not in scene.gone for each in scene.mission.ids])
    if in_formation:
        settled_s, off_m = formation_settled_s(scene, flight, stay)
        return Draw(seed, settled_s, settled_s, separation_left_m(scene, flight), 0, inf, off_m)
    target = scene.mission.target.motion
    about = np.array([target.position_m(time_s) for time_s in flight.time_s.tolist()])
    polar = (flight.motion[..., POSITION] - about[:, None]) @ np.array([1.0, 1.0j])
    ring_m = scene.mission.encirclement.radius_m
    after = flight.time_s >= scene.from_s
    polar_there = np.where(scene.there(flight.time_s), polar, np.nan)
    since_s = flight.time_s[after] - scene.from_s
    return Draw(
        seed,
        *ring_settled_s(since_s, polar[after][:, stay], scene.radius_share, ring_m),
        separation_left_m(scene, flight),
        overtakings(polar_there, ring_m),
        innermost_share(polar_there, ring_m),
    )


def settled_s(time_s: Vector, well: NDArray[np.bool_]) -> float:
    """Return the time from which a condition stays true, inf if it is false at the end."""
    if not well[-1]:
        return inf
    bad = np.flatnonzero(~well)
    return 0.0 if bad.size == 0 else float(time_s[bad[-1] + 1])


def ring_settled_s(
    time_s: Vector, polar: NDArray[np.complex128], radius_share: float, ring_m: float
) -> tuple[float, float]:
    """Return the settling times of the spacings, and of spacings and radii."""
    turns = np.sort(np.angle(polar), axis=1)
    gaps = np.diff(turns, axis=1, append=turns[:, :1] + tau)
    even = np.degrees(np.abs(gaps - tau / polar.shape[1])).max(axis=1) <= SPACING_DEG
    round_ = np.abs(np.abs(polar) / ring_m - 1.0).max(axis=1) <= radius_share
    return settled_s(time_s, even), settled_s(time_s, even & round_)


def formation_settled_s(scene: Scene, flight: SimulatedFlight, stay: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the settling time of the spacings between neighbours after the loss, and the largest error."""
    config = scene.mission.agent_config(scene.mission.vehicles[0])
    if scene.shape is not None:
        config = config.reshaped(scene.shape)
    slots = np.array([config.slot_offset_m(each, scene.mission.ids[0]) for each in scene.mission.ids])
    off = (flight.motion[..., POSITION] - slots)[:, stay]
    error_m = np.linalg.norm(np.diff(off, axis=1), axis=-1).max(axis=1)
    after = flight.time_s >= scene.from_s
    return settled_s(flight.time_s[after] - scene.from_s, error_m[after] <= SPACING_M), float(error_m[after].max())


def separation_left_m(scene: Scene, flight: SimulatedFlight) -> float:
    """Return the smallest distance between two vehicles in the air beyond the separation.

    With several rings two that are above each other are left out.
    """
    least, safety = inf, scene.mission.safety
    above_m = safety.vertical_separation_m - HEIGHTS_OFF_M if scene.mission.rings else inf
    for one, other in combinations(range(flight.motion.shape[1]), 2):
        both = flight.aloft[:, one] & flight.aloft[:, other]
        near = both & (np.abs(flight.altitude_m[:, one] - flight.altitude_m[:, other]) < above_m)
        apart_m = np.linalg.norm(flight.motion[near, one, :2] - flight.motion[near, other, :2], axis=-1)
        least = min(least, float(apart_m.min(initial=inf)))
    return least - safety.separation_m


def overtakings(polar: NDArray[np.complex128], ring_m: float) -> int:
    """Return the number of overtakings on the ring."""
    count = 0
    near = np.abs(np.abs(polar) / ring_m - 1.0) <= NEAR_RING_SHARE
    for one, other in combinations(range(polar.shape[1]), 2):
        between = np.angle(polar[:, one] * polar[:, other].conj())
        both = near[:, one] & near[:, other]
        passed = (np.sign(between[1:]) != np.sign(between[:-1])) & (np.abs(between[1:]) < pi / 2.0)
        count += int((passed & both[1:] & both[:-1]).sum())
    return count


def innermost_share(polar: NDArray[np.complex128], ring_m: float) -> float:
    """Return the smallest radius after reaching the ring, as a share of the ring's; absence (NaN) restarts."""
    least = inf
    for radius in np.abs(polar).T:
        reached = False
        for share in (radius / ring_m).tolist():
            reached = not isnan(share) and (reached or share >= 1.0 - ON_RING_SHARE)
            least = min(least, share) if reached else least
    return least


def main(count: int, chosen: list[str]) -> int:
    """Fly a number of seeds of each scene whose name begins with one of the given texts; without any, of all."""
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
                f"{name}: spaced after {max(d.spaced_s for d in draws):.1f} s at worst; settled after "
                f"{np.median(took_s):.1f} s in the middle, {took_s.max():.1f} s at worst (limit {limit_s:g} s); "
                f"separation {min(d.separation_left_m for d in draws):+.2f} m; "
                f"{sum(d.overtakings for d in draws)} overtakings; innermost "
                f"{min(d.innermost_share for d in draws):.2f} R; most off {max(d.off_most_m for d in draws):.2f} m; "
                f"{len(bad)} of {count} miss",
                *bad,
                sep="\n  ",
                flush=True,
            )
    return 1 if missed else 0


if __name__ == "__main__":
    reader = parser("membership", __doc__)
    reader.add_argument("count", nargs="?", type=int, default=50, help="number of seeds (default: %(default)s)")
    reader.add_argument("scenes", nargs="*", help="beginnings of the scenes' names (default: all)")
    given = reader.parse_args()
    sys.exit(main(given.count, given.scenes))
