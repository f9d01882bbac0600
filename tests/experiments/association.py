"""Measure how often the tracks of two targets that cross exchange their targets.

Two targets pass each other at 1 m, at random speeds and angles, each seen by three sensors at random rates from 2 to
10 Hz with 0.3 m of noise per axis; one sighting in 20 is an outlier by 3 to 20 m. Compared are cordon's tracks, also
with sightings up to 0.3 s late; a plain nearest neighbour, where a sighting goes to the nearest of two target filters
with the widest gate; and the global nearest neighbour of Stone Soup, where it can be imported, with cordon's process
noise. An exchange is a track that follows the other target after the crossing; one is *unmarked* if the track does not
say that its identity is uncertain, and *marked* are all draws with tracks that say so. Lost are targets whose track of
before the crossing ends, false tracks those that never follow a target. Exit code 1 if cordon's tracks do not reach the
figures of docs/notes/target.md.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import groupby, permutations
from math import hypot, inf, pi
from time import process_time
from typing import Any, Protocol

import numpy as np

from estimation.filters.target import TargetFilter
from estimation.filters.target_tracks import TargetTracks
from estimation.settings import TargetFilterSettings
from estimation.state import Sighting, Vector
from tests.experiments.arguments import positive, seeded_parser

DURATION_S, CROSSING_S, TICK_S = 20.0, 10.0, 0.1
FIRST_S, BEFORE_S = 2.0, 4.0
"""Errors are measured from the first time on; a target's track is the one nearest to it at the second."""
SENSORS, NOISE_M, OUTLIERS, LATE_S = 3, 0.3, 0.05, 0.3
CLOSEST_M, NEAR_M = 1.0, 1.5
"""The distance of the crossing, and the largest one between a target and its track."""
STONE_SOUP_GATE_SIGMA = 4.0
"""Better than cordon's 5.66 sigma, with which Stone Soup takes a third longer."""
EXCHANGED_SHARE, UNMARKED_SHARE = 0.05, 0.01
"""What cordon's tracks promise at most: shares of draws with an exchange at 1 m, and with an unmarked one."""
Pair = tuple[float, float]


@dataclass(frozen=True)
class Crossing:
    """Two targets with constant velocities: positions at the crossing (2, 2) and velocities (2, 2)."""

    position_m: Vector
    velocity_m_s: Vector

    def at(self, time_s: float) -> Vector:
        """Return the positions (2, 2) of the targets."""
        return self.position_m + (time_s - CROSSING_S) * self.velocity_m_s


def crossing(random: np.random.Generator, closest_m: float) -> Crossing:
    """Return a random crossing."""
    course_rad, angle_rad = random.uniform(0.0, 2.0 * pi), random.uniform(pi / 6.0, 5.0 * pi / 6.0)
    speeds_m_s, courses_rad = random.uniform(0.5, 2.5, 2), np.array([course_rad, course_rad + angle_rad])
    velocity = speeds_m_s[:, None] * np.column_stack([np.cos(courses_rad), np.sin(courses_rad)])
    along_x, along_y = velocity[1] - velocity[0]
    apart = closest_m * random.choice([-1.0, 1.0]) * np.array([-along_y, along_x]) / hypot(along_x, along_y)
    return Crossing(np.array([[0.0, 0.0], apart]), velocity)


def sightings(seen: Crossing, random: np.random.Generator) -> list[Sighting]:
    """Return what the sensors see, in order of time and in random order at each time."""
    found = []
    for sensor in range(1, SENSORS + 1):
        period_s = 1.0 / random.uniform(2.0, 10.0)
        for time_s in np.arange(random.uniform(0.0, period_s), DURATION_S, period_s).tolist():
            for place in random.permutation(seen.at(time_s)):
                x, y = place + random.normal(0.0, NOISE_M, 2)
                if random.random() < OUTLIERS:
                    side_rad, off_m = random.uniform(0.0, 2.0 * pi), random.uniform(3.0, 20.0)
                    x, y = x + off_m * np.cos(side_rad), y + off_m * np.sin(side_rad)
                covariance = NOISE_M**2, 0.0, NOISE_M**2
                found.append(Sighting(time_s, sensor, (float(x), float(y)), covariance, 0.8, 0.2))
    return sorted(found, key=lambda one: one.time_s)


class Tracker(Protocol):
    """What is compared."""

    def sight(self, batch: Sequence[Sighting]) -> None:
        """Process what a sensor saw at a time."""

    def places(self, now_s: float) -> Mapping[str, tuple[Pair, bool]]:
        """Return the position of each confirmed track, and whether its identity is uncertain."""


class Cordon:
    """cordon's tracks."""

    def __init__(self) -> None:
        self._tracks = TargetTracks(TargetFilterSettings())

    def sight(self, batch: Sequence[Sighting]) -> None:
        """Process what a sensor saw at a time."""
        self._tracks.sight(*batch)

    def places(self, now_s: float) -> Mapping[str, tuple[Pair, bool]]:
        """Return the position of each confirmed track, and whether its identity is uncertain."""
        found = {}
        for track in self._tracks.tracks(now_s):
            x, y, *_ = track.estimate.mean.tolist()
            found[track.track_id] = (x, y), track.uncertain_since_s is not None
        return found


class Nearest:
    """Two target filters, begun by the first two sightings; every sighting goes to the nearest, far or not."""

    def __init__(self) -> None:
        self._targets: list[TargetFilter] = []

    def sight(self, batch: Sequence[Sighting]) -> None:
        """Process what a sensor saw at a time."""
        for each in batch:
            if len(self._targets) < 2:
                self._targets.append(TargetFilter(TargetFilterSettings(gate_sigma=20.0)))
                self._targets[-1].sight(each)
                continue
            x, y = each.position_m
            places = [place for place, _ in self.places(each.time_s).values()]
            away_m = [hypot(x - place[0], y - place[1]) for place in places]
            self._targets[away_m.index(min(away_m))].sight(each)

    def places(self, now_s: float) -> Mapping[str, tuple[Pair, bool]]:
        """Return the position of each track."""
        found = {}
        for number, target in enumerate(self._targets):
            estimate = target.estimate(now_s)
            x, y, *_ = (inf, inf) if estimate is None else estimate.mean.tolist()
            found[str(number)] = (x, y), False
        return found


class StoneSoup:
    """Stone Soup's Kalman filter, global nearest neighbour and initiator of three sightings; sightings in order."""

    def __init__(self) -> None:
        # Imported here: cordon does not depend on it.
        from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
        from stonesoup.deleter.time import UpdateTimeDeleter
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.initiator.simple import MultiMeasurementInitiator
        from stonesoup.measures import Mahalanobis
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.models.transition.linear import (
            CombinedLinearGaussianTransitionModel,
            ConstantVelocity,
        )
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.types.detection import Detection
        from stonesoup.types.state import GaussianState
        from stonesoup.updater.kalman import KalmanUpdater

        settings = TargetFilterSettings()
        noise = settings.acceleration_noise_m_s2**2
        moving = CombinedLinearGaussianTransitionModel([ConstantVelocity(noise), ConstantVelocity(noise)])
        self._predictor, self._detection = KalmanPredictor(moving), Detection
        self._updater = KalmanUpdater(None)
        hypothesiser = DistanceHypothesiser(
            self._predictor, self._updater, Mahalanobis(), missed_distance=STONE_SOUP_GATE_SIGMA
        )
        self._associator = GNNWith2DAssignment(hypothesiser)
        self._model = LinearGaussian(4, (0, 2), np.diag([NOISE_M**2, NOISE_M**2]))
        self._deleter = UpdateTimeDeleter(timedelta(seconds=3.0))
        self._initiator = MultiMeasurementInitiator(
            prior_state=GaussianState([0.0] * 4, np.diag([0.0, settings.velocity_prior_m_s**2] * 2)),
            deleter=UpdateTimeDeleter(timedelta(seconds=1.5)),
            data_associator=self._associator,
            updater=self._updater,
            measurement_model=self._model,
            min_points=3,
        )
        self._tracks: set[Any] = set()

    def sight(self, batch: Sequence[Sighting]) -> None:
        """Process what a sensor saw at a time."""
        time = _date(batch[0].time_s)
        seen = {
            self._detection(np.array(each.position_m), timestamp=time, measurement_model=self._model) for each in batch
        }
        used = set()
        for track, hypothesis in self._associator.associate(self._tracks, seen, time).items():
            if hypothesis:
                track.append(self._updater.update(hypothesis))
                used.add(hypothesis.measurement)
            else:
                track.append(hypothesis.prediction)
        self._tracks -= self._deleter.delete_tracks(self._tracks, timestamp=time)
        self._tracks |= self._initiator.initiate(seen - used, time)

    def places(self, now_s: float) -> Mapping[str, tuple[Pair, bool]]:
        """Return the position of each track."""
        found = {}
        for track in self._tracks:
            x, x_rate, y, y_rate = np.asarray(track.state_vector, dtype=float).ravel().tolist()
            ahead_s = (_date(now_s) - track.timestamp).total_seconds()
            found[track.id] = (x + ahead_s * x_rate, y + ahead_s * y_rate), False
        return found


def _date(time_s: float) -> datetime:
    return datetime(2026, 1, 1) + timedelta(seconds=time_s)  # any date


@dataclass
class Figures:
    """Counts over draws, squared errors [m²], and the time [s] that the sightings took."""

    draws: int = 0
    exchanged: int = 0
    unmarked: int = 0
    marked: int = 0
    lost: int = 0
    false: int = 0
    squared_m2: list[float] = field(default_factory=list)
    spent_s: float = 0.0
    seen: int = 0


def matched(truth: Vector, places: Mapping[str, tuple[Pair, bool]]) -> list[str | None]:
    """Return the track of each target: both together so that most have one and the distances are least."""
    names: list[str | None] = [*places, None, None]
    best: tuple[tuple[int, float], list[str | None]] = ((3, inf), [None, None])
    for chosen in permutations(names, 2):
        missing, off_m = 0, 0.0
        for name, (x, y) in zip(chosen, truth.tolist(), strict=True):
            away_m = inf if name is None else hypot(x - places[name][0][0], y - places[name][0][1])
            missing += away_m > NEAR_M
            off_m += away_m if away_m <= NEAR_M else 0.0
        best = min(best, ((missing, off_m), list(chosen)), key=lambda one: one[0])
    return [
        name if name is not None and hypot(*(np.array(places[name][0]) - target)) <= NEAR_M else None
        for name, target in zip(best[1], truth, strict=True)
    ]


def arrivals(seen: Sequence[Sighting], random: np.random.Generator | None) -> Iterator[tuple[float, list[Sighting]]]:
    """Yield the batches with the times at which they arrive: at once, or late by up to `LATE_S`."""
    batches = [list(batch) for _, batch in groupby(seen, key=lambda one: (one.time_s, one.sensor_id))]
    late_s = np.zeros(len(batches)) if random is None else random.uniform(0.0, LATE_S, len(batches))
    coming = [(batch[0].time_s + wait_s, batch) for batch, wait_s in zip(batches, late_s.tolist(), strict=True)]
    yield from sorted(coming, key=lambda one: one[0])


def draw(tracker: Tracker, seed: int, figures: Figures, late: bool, closest_m: float) -> None:
    """Add the figures of a tracker on one draw."""
    random = np.random.default_rng([seed, 7])
    targets = crossing(random, closest_m)
    seen = sightings(targets, random)
    coming = list(arrivals(seen, random if late else None))
    mine: list[str | None] = [None, None]
    held: set[str] = set()
    confirmed: set[str] = set()
    places: Mapping[str, tuple[Pair, bool]] = {}
    last: list[str | None] = [None, None]
    for tick in range(1, round(DURATION_S / TICK_S)):
        now_s = tick * TICK_S
        began_s = process_time()
        while coming and coming[0][0] <= now_s:
            figures.seen += len(coming[0][1])
            tracker.sight(coming.pop(0)[1])
        figures.spent_s += process_time() - began_s
        if now_s < FIRST_S:
            continue
        places = tracker.places(now_s)
        truth = targets.at(now_s)
        last = matched(truth, places)
        confirmed |= set(places)
        held |= {name for name in last if name is not None}
        for name, place in zip(last, truth, strict=True):
            if name is not None:
                figures.squared_m2.append(float(np.sum((np.array(places[name][0]) - place) ** 2)))
        if round((now_s - BEFORE_S) / TICK_S) == 0:
            mine = last
    figures.draws += 1
    figures.lost += sum(name is None or name not in last for name in mine)
    figures.false += len(confirmed - held)
    uncertain = [uncertain for _, uncertain in places.values()]
    figures.marked += any(uncertain)
    if any(name is not None and name == other for name, other in zip(mine, reversed(last), strict=True)):
        figures.exchanged += 1
        figures.unmarked += not all(places[name][1] for name in last if name is not None)


def row(name: str, found: Figures) -> str:
    """Return a row of the table."""
    rms_m = float(np.sqrt(np.mean(found.squared_m2)))
    return (
        f"| {name} | {found.exchanged} | {found.unmarked} | {found.marked} | {found.lost} | {found.false} "
        f"| {rms_m:.3f} | {found.spent_s / found.seen * 1e6:.0f} |"
    )


def main(count: int, first: int, closest_m: float) -> int:
    """Print the table over a number of draws."""
    compared: list[tuple[str, Any, bool]] = [
        ("cordon", Cordon, False),
        ("cordon, late sightings", Cordon, True),
        ("plain nearest neighbour", Nearest, False),
        ("Stone Soup", StoneSoup, False),
    ]
    print(f"{count} draws, two targets each that pass at {closest_m} m\n")
    print("| tracks | exchanged | unmarked | marked | lost | false | position rms [m] | per sighting [µs] |")
    print("|---|---|---|---|---|---|---|---|")
    result = 0
    for name, make, late in compared:
        found = Figures()
        try:
            for seed in range(first, first + count):
                draw(make(), seed, found, late, closest_m)
        except ModuleNotFoundError as error:
            print(f"| {name} | skipped: {error}; `pip install stonesoup` | | | | | | |")
            continue
        print(row(name, found), flush=True)
        if make is Cordon:
            result |= found.unmarked > UNMARKED_SHARE * count
            result |= closest_m >= CLOSEST_M and found.exchanged > EXCHANGED_SHARE * count
    return int(result)


if __name__ == "__main__":
    reader = seeded_parser("association", __doc__, 200)
    reader.add_argument(
        "--closest", type=positive, default=CLOSEST_M, help="distance at which they pass [m] (default: %(default)s)"
    )
    arguments = reader.parse_args()
    sys.exit(main(arguments.count, arguments.first, arguments.closest))
