"""Fly vehicles whose plants differ from their profile's, and count those that are reported as stiffer or softer.

Missions, wind, limits, telemetry and the estimators' errors are those of plant_family. A vehicle can be reported once
four windows with enough motion are compared, which on slow rings does not happen. Exit code 1 if a vehicle within 10 %
of its profile is reported, or one is reported as stiffer that has more lag, or as softer that has less.
"""

import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from agents.core import VehicleCore
from agents.outputs import TickOutput
from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from estimation.plant.model import Plant, PlantAxis
from estimation.plant.watch import WINDOWS_LEAST
from gcs.flight.simulated import simulated_vehicles
from tests.experiments.arguments import seeded_parser
from tests.experiments.plant_family import drawn
from tests.support.observed_flight import observed

DURATION_S = 140.0
Random = np.random.Generator
KINDS: dict[str, Callable[[Random], tuple[float, float, float]]] = {
    "the profile's plant": lambda _: (1.0, 1.0, 0.0),
    "a0 and a1 within 10 %, the delay within 0.05 s": lambda random: (
        *random.uniform(0.9, 1.1, 2).tolist(),
        random.uniform(-0.05, 0.05),
    ),
    "a0 and a1 within 50 %": lambda random: (*random.uniform(0.5, 1.5, 2).tolist(), random.uniform(-0.1, 0.2)),
    "a0 2.8 times, a1 1.31 times": lambda _: (2.8, 1.31, -0.015),
    "a0 0.4 times, a1 0.7 times": lambda _: (0.4, 0.7, 0.05),
}
"""The factors of a0 and a1 and what is added to the delay of each vehicle's true plant."""
LIKE = tuple(KINDS)[:2]


@dataclass(frozen=True)
class Told:
    """Whether a vehicle could be reported, as what it was, when after it engaged [s], and what it is."""

    compared: bool
    difference: str | None
    after_s: float
    true: str


def flown(kind: str, seed: int) -> list[Told]:
    """Fly the draw of a seed with true plants of a kind."""
    draw, random = drawn(seed, linear=False), np.random.default_rng([seed, 11])
    vehicles = tuple(
        replace(each, true_plant=_true(each.plant, *KINDS[kind](random))) for each in draw.mission.vehicles
    )
    mission = replace(draw.mission, vehicles=vehicles)
    cores: list[VehicleCore] = []

    def new_core(config: AgentConfig) -> VehicleCore:
        cores.append(VehicleCore(config))
        return cores[-1]

    imperfections = {key: each.imperfections for key, each in draw.family.items()}
    simulated = simulated_vehicles(mission, seed, new_core, imperfections=imperfections)
    watches = [core._vehicle.plant for core in cores]
    engaged_s, reported_s = [[0.0] * len(vehicles) for _ in range(2)]

    def observe(_tick: int, vehicle: int, output: TickOutput) -> None:
        if watches[vehicle].found is None:
            reported_s[vehicle] = output.status.time_s
            if output.status.tactic is not Tactic.ENCIRCLE:
                engaged_s[vehicle] = output.status.time_s

    observed(mission, seed, observe, duration_s=DURATION_S, vehicles=simulated)
    return [
        Told(
            len(watch._windows) >= WINDOWS_LEAST,
            None if watch.found is None else watch.found.difference,
            reported - engaged,
            "stiffer" if _lag_s(each.true_plant) < _lag_s(each.plant) else "softer",
        )
        for each, watch, engaged, reported in zip(vehicles, watches, engaged_s, reported_s, strict=True)
    ]


def _true(profile: Plant, a0: float, a1: float, later_s: float) -> Plant:
    x, y = (PlantAxis(axis.a0_per_s2 * a0, axis.a1_per_s * a1) for axis in (profile.x, profile.y))
    return replace(profile, x=x, y=y, delay_s=max(0.0, profile.delay_s + later_s))


def _lag_s(plant: Plant) -> float:
    return plant.x.a1_per_s / plant.x.a0_per_s2 + plant.delay_s


def main(count: int, first: int) -> int:
    """Fly a number of draws of each kind, from the seed `first` on, on all cores."""
    wrong = 0
    with ProcessPoolExecutor(initializer=os.nice, initargs=(10,)) as pool:
        for kind in KINDS:
            vehicles = [each for team in pool.map(partial(flown, kind), range(first, first + count)) for each in team]
            reported = [each for each in vehicles if each.difference is not None]
            right = [each for each in reported if each.difference == each.true and kind not in LIKE]
            after_s = [each.after_s for each in reported]
            when = f", {np.median(after_s):.0f} s after engaging (median)" if reported else ""
            compared = sum(each.compared for each in vehicles)
            print(f"{kind}: {len(reported)} of {compared} reported, {len(right)} rightly{when}", flush=True)
            wrong += len(reported) - len(right)
    return 1 if wrong else 0


if __name__ == "__main__":
    given = seeded_parser("unlike_plants", __doc__, 50).parse_args()
    sys.exit(main(given.count, given.first))
