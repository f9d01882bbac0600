"""Measure the target filter on seeded tracks of targets.

Every track lasts 80 s and is seen by three sensors at 5 Hz with 0.5 m of noise per axis; one sighting in 20 is an
outlier by 3 to 20 m. Exit code 1 if the target filter does not reach the figures of docs/notes/target.md.
"""

import sys
from dataclasses import dataclass
from math import pi
from time import process_time

import numpy as np

from estimation.filters.target import TargetFilter
from estimation.settings import TargetFilterSettings
from estimation.state import Sighting, Vector
from tests.experiments.arguments import parser

DURATION_S, STEP_S, TICK_S, SETTLED_S = 80.0, 0.01, 0.1, 5.0
SENSORS, RATE_HZ, NOISE_M, OUTLIERS = 3, 5.0, 0.5, 0.05
ERROR_MAX_M = 0.5
KINDS = ("steady", "turns", "stop and go", "circle")


@dataclass(frozen=True)
class Track:
    """A target's position (T, 2) and velocity (T, 2), every hundredth of a second."""

    position_m: Vector
    velocity_m_s: Vector

    def at(self, time_s: float) -> Vector:
        """Return the motion (4,)."""
        place = round(time_s / STEP_S)
        return np.concatenate([self.position_m[place], self.velocity_m_s[place]])


def track(kind: str, seed: int) -> Track:
    """Return a target that keeps its velocity, turns by 90 degrees, stops and starts at 1 m/s², or circles."""
    random = np.random.default_rng([seed, KINDS.index(kind)])
    steps = round(DURATION_S / STEP_S)
    fastest_m_s = random.uniform(0.05, 1.0) if kind == "steady" else 2.0
    bend_rad_s = fastest_m_s / random.uniform(8.0, 20.0) * random.choice([-1.0, 1.0]) if kind == "circle" else 0.0
    course_rad, speed_m_s, wanted_m_s = random.uniform(0.0, 2.0 * pi), fastest_m_s, fastest_m_s
    change_s = random.uniform(10.0, 14.0)
    velocity = np.empty((steps, 2))
    for step in range(steps):
        if kind in ("turns", "stop and go") and step * STEP_S >= change_s:
            change_s += random.uniform(6.0, 12.0)
            if kind == "turns":
                course_rad += random.choice([-1.0, 1.0]) * pi / 2.0
            else:
                wanted_m_s = fastest_m_s - wanted_m_s
        speed_m_s += float(np.clip(wanted_m_s - speed_m_s, -STEP_S, STEP_S))
        course_rad += bend_rad_s * STEP_S
        velocity[step] = speed_m_s * np.cos(course_rad), speed_m_s * np.sin(course_rad)
    position = np.vstack([np.zeros(2), np.cumsum(velocity[:-1] * STEP_S, axis=0)])
    return Track(position, velocity)


def sightings(seen: Track, seed: int, noise_m: float = NOISE_M, outliers: float = OUTLIERS) -> list[Sighting]:
    """Return the sightings of a track, in order of time."""
    random = np.random.default_rng([seed, len(KINDS)])
    found = []
    for sensor in range(1, SENSORS + 1):
        for time_s in np.arange(random.uniform(0.0, 1.0 / RATE_HZ), DURATION_S - STEP_S, 1.0 / RATE_HZ).tolist():
            place = seen.at(time_s)[:2] + random.normal(0.0, noise_m, 2)
            if random.random() < outliers:
                angle_rad, off_m = random.uniform(0.0, 2.0 * pi), random.uniform(3.0, 20.0)
                place = place + off_m * np.array([np.cos(angle_rad), np.sin(angle_rad)])
            x, y = place.tolist()
            found.append(Sighting(time_s, sensor, (x, y), (noise_m**2, 0.0, noise_m**2), 0.8, 0.2))
    return sorted(found, key=lambda one: one.time_s)


@dataclass(frozen=True)
class Figures:
    """The results of the filter: errors (T,) of position and velocity at ticks, the position's normalised error
    squared (T,), and the time per sighting [us].
    """

    position_m: Vector
    velocity_m_s: Vector
    consistency: Vector
    cost_us: float


def figures(kind: str, seed: int) -> Figures:
    """Run a new filter on one track, and compare it with the truth at every tick once it has settled."""
    truth, target = track(kind, seed), TargetFilter(TargetFilterSettings())
    coming, rows, spent_s = iter(sightings(truth, seed)), [], 0.0
    sighting, count = next(coming), 0
    for time_s in np.arange(0.0, DURATION_S - 2.0 * TICK_S, TICK_S).tolist():
        while sighting.time_s <= time_s:
            began_s = process_time()
            target.sight(sighting)
            spent_s += process_time() - began_s
            sighting, count = next(coming), count + 1
        if time_s > SETTLED_S:
            estimate = target.estimate(time_s)
            assert estimate is not None
            error = estimate.mean - truth.at(time_s)
            squared = float(error[:2] @ np.linalg.solve(estimate.covariance[:2, :2], error[:2]))
            rows.append((np.hypot(*error[:2]), np.hypot(*error[2:]), squared))
    position_m, velocity_m_s, consistency = np.array(rows).T
    return Figures(position_m, velocity_m_s, consistency, spent_s / count * 1e6)


def together(kind: str, count: int) -> Figures:
    """Return the figures over a number of tracks of a kind."""
    each = [figures(kind, seed) for seed in range(count)]
    return Figures(
        np.concatenate([one.position_m for one in each]),
        np.concatenate([one.velocity_m_s for one in each]),
        np.concatenate([one.consistency for one in each]),
        float(np.median([one.cost_us for one in each])),
    )


def row(kind: str, found: Figures) -> str:
    """Return a row of the table."""
    return (
        f"| {kind} | {rms(found.position_m):.3f} | {np.percentile(found.position_m, 99):.2f} "
        f"| {rms(found.velocity_m_s):.3f} | {found.consistency.mean():.1f} | {found.cost_us:.0f} |"
    )


def rms(values: Vector) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main(count: int) -> int:
    """Print the table over a number of tracks of each kind."""
    worst_m = 0.0
    print("| track | position rms [m] | 99 % [m] | velocity rms [m/s] | NEES (2) | per sighting [µs] |")
    print("|---|---|---|---|---|---|")
    for kind in KINDS:
        found = together(kind, count)
        worst_m = max(worst_m, rms(found.position_m))
        print(row(kind, found), flush=True)
    print(f"\nthe worst: {worst_m:.3f} m rms, at most {ERROR_MAX_M} m promised")
    return int(worst_m > ERROR_MAX_M)


if __name__ == "__main__":
    reader = parser("target_tracks", __doc__)
    reader.add_argument("count", nargs="?", type=int, default=10, help="tracks of each kind (default: %(default)s)")
    sys.exit(main(reader.parse_args().count))
