"""Measure how fast the spacing errors of 2 to 32 vehicles decay on one ring, in simulation: V of (18) against (20).

The vehicles start on the ring, a little off even places drawn from a seed, and without noise. V is that of their true
bearings; its rate is fitted between 1e-2 and 1e-5 rad^2, while no bound of a transition is active. With --range
vehicles hear only those within that distance, with --loss a share of the messages is lost. Exit code 1 if a rate is not
within 5 % of 2 gamma although all vehicles hear each other.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from math import cos, inf, nan, sin, tau

import numpy as np

from estimation.state import POSITION, Vector
from gcs.mission.mission import Mission
from sitl.simulation.simulation import NetworkModel
from tests.experiments.arguments import parser, positive
from tests.support.mission_text import content, parsed
from tests.support.observed_flight import observed
from tests.support.ring_mission import ring_mission

COUNTS = (2, 3, 6, 12, 24, 32)
RADIUS_M, SPEED_M_S = 40.0, 2.0
BEGINS_RAD2, FROM_RAD2, TO_RAD2 = 0.03, 1e-2, 1e-5
TOLERANCE = 0.05


def off_places(count: int, seed: int, duration_s: float) -> Mission:
    """Return a mission whose vehicles start on the ring, so far off even places that V begins with BEGINS_RAD2."""
    off_rad = np.random.default_rng([count, seed]).normal(size=count)
    errors_rad = np.roll(off_rad, -1) - off_rad
    off_rad *= (2.0 * BEGINS_RAD2 / np.sum(errors_rad**2)) ** 0.5
    links = list(range(14540, 14540 + count))
    mission = content(ring_mission(count, duration_s, links, [port + 1000 for port in links]))
    mission["encirclement"] |= {"radius_m": RADIUS_M, "angular_rate_rad_s": SPEED_M_S / RADIUS_M}
    mission["target"]["sensor"]["noise_m"] = 0.0
    for row, (vehicle, off) in enumerate(zip(mission["vehicles"], off_rad.tolist(), strict=True)):
        x, y = RADIUS_M * cos(tau * row / count + off), RADIUS_M * sin(tau * row / count + off)
        vehicle |= {"start_m": [x, y], "slot_m": [x - RADIUS_M, y]}
    return parsed(mission)


def lyapunov_rad2(places_m: Vector) -> Vector:
    """Return V (T,) - (18) of the places (T, n, 2) about the target at the origin."""
    turns = np.sort(np.arctan2(places_m[..., 1], places_m[..., 0]), axis=1)
    gaps = np.diff(turns, axis=1, append=turns[:, :1] + tau)
    return np.asarray(0.5 * ((gaps - tau / turns.shape[1]) ** 2).sum(axis=1))


def fitted_per_s(time_s: Vector, value_rad2: Vector) -> float:
    """Return the rate of an exponential through V between the two bounds, NaN where it does not pass both."""
    below, at_end = np.flatnonzero(value_rad2 < FROM_RAD2), np.flatnonzero(value_rad2 < TO_RAD2)
    if not (below.size and at_end.size):
        return nan
    fitted = slice(int(below[0]), int(at_end[0]))
    return -float(np.polyfit(time_s[fitted], np.log(value_rad2[fitted]), 1)[0])


def flown(
    range_m: float, loss: float, duration_s: float, seed: int, count: int
) -> tuple[int, int, float, float, float]:
    """Fly a team; return its size, how many each hears, 2 gamma, the fitted rate and the last V."""
    mission = off_places(count, seed, duration_s)
    flight = observed(mission, seed, network=NetworkModel(range_m, 0.05, loss))
    value_rad2 = lyapunov_rad2(flight.motion[..., POSITION])
    chords_m = 2.0 * RADIUS_M * np.sin(np.pi * np.arange(count) / count)
    heard = int((chords_m <= range_m).sum())
    wanted_per_s = 2.0 * mission.encirclement.spacing_gain_per_s
    return count, heard, wanted_per_s, fitted_per_s(flight.time_s, value_rad2), float(value_rad2[-1])


def main(counts: Sequence[int], range_m: float, loss: float, duration_s: float, seed: int) -> int:
    """Fly the teams and print the table."""
    print("| vehicles | each hears, itself included | V decays with, 1/s | 2 gamma, 1/s | off | V at the end, rad² |")
    print(f"{'|---' * 6}|", flush=True)
    missed = False
    with ProcessPoolExecutor() as pool:
        for count, heard, wanted, fitted, last in pool.map(partial(flown, range_m, loss, duration_s, seed), counts):
            print(
                f"| {count} | {heard} | {fitted:.3f} | {wanted:.3f} | {fitted / wanted - 1.0:+.1%} | {last:.1e} |",
                flush=True,
            )
            missed = missed or (heard == count and not abs(fitted / wanted - 1.0) <= TOLERANCE)
    return 1 if missed else 0


if __name__ == "__main__":
    reader = parser("spacing_decay", __doc__)
    reader.add_argument("counts", nargs="*", type=int, default=COUNTS, help="numbers of vehicles (default: 2 to 32)")
    reader.add_argument("--range", type=positive, default=inf, help="radio range [m] (default: all are heard)")
    reader.add_argument("--loss", type=float, default=0.0, help="share of lost messages (default: %(default)s)")
    reader.add_argument("--duration", type=positive, default=60.0, help="length of a flight [s] (default: %(default)s)")
    reader.add_argument("--seed", type=int, default=0, help="draw of the starts (default: %(default)s)")
    given = reader.parse_args()
    sys.exit(main(given.counts, given.range, given.loss, given.duration, given.seed))
