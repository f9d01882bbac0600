"""Fly random missions, and report each that breaks separation, fence, setpoint or speed limits.

It reports also each in which a vehicle does not engage, and the preflight did not warn that the target is out of its
reach; or engages despite such a warning, while the guard left all vehicles in their places in formation.

A seed determines the number of vehicles and their starts, their true plants, target, ring, thresholds, and a fence as
close to starts and ring as the mission check allows. Telemetry and network are as in case2-field. Exit code 1 if a
mission breaks the invariant.
"""

import sys
from collections.abc import Collection
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import combinations
from math import hypot, inf, pi, sin

import numpy as np

from agents.outputs import TickOutput
from agents.safety.fence import Corner, Fence
from agents.tactics import Tactic
from estimation.state import POSITION, VELOCITY, Vector
from gcs.metrics.ending import named
from gcs.mission.mission import Mission
from gcs.preflight.findings import MISSION, Grade
from gcs.preflight.mission import encounter
from tests.experiments.arguments import seeded_parser
from tests.support.mission_text import Content, content, drawn_vehicle, parsed
from tests.support.observed_flight import observed
from tests.support.paths import MISSIONS

FIELD = (MISSIONS / "case2-field.toml").read_text(encoding="utf-8")
DURATION_S = 90.0
PLANT_OFF_MOST = 0.15
START_CLEARANCE_M = 0.5
RING_CLEARANCE_M = 0.05

SEPARATION_SLACK_M = 0.3
# The bound of a setpoint's lead is relative to the estimated position when the setpoint acts.
LEAD_SLACK_M = 0.5
SPEED_SLACK_M_S = 1.0


def random_mission(seed: int) -> Mission:
    """Return a mission that the mission check accepts."""
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 7))
    separation_m = float(random.uniform(2.0, 3.5))
    radius_m = max(6.0, 1.25 * separation_m / (2.0 * sin(pi / count))) + float(random.uniform(0.0, 5.0))
    rate_rad_s = float(random.uniform(0.3, 1.0) * min(0.2, 1.8 / radius_m) * random.choice([-1.0, 1.0]))
    target_m = float(random.uniform(5.0, 30.0)), float(random.uniform(-8.0, 8.0))
    course_rad, speed_m_s = random.uniform(0.0, 2.0 * pi), random.uniform(0.0, 0.4)
    velocity_m_s = float(speed_m_s * np.cos(course_rad)), float(speed_m_s * np.sin(course_rad))
    spacing_m = separation_m * float(random.uniform(1.2, 2.0))
    starts_m = [
        (
            float(random.uniform(-2.0, 2.0)),
            ((count - 1) / 2.0 - slot) * spacing_m + separation_m * float(random.uniform(-0.05, 0.05)),
        )
        for slot in range(count)
    ]
    end_m = target_m[0] + velocity_m_s[0] * DURATION_S, target_m[1] + velocity_m_s[1] * DURATION_S
    fence = _tight_fence(random, starts_m, (target_m, end_m), radius_m)
    mission = content(FIELD)
    mission["mission"] |= {"name": f"random {seed}", "duration_s": DURATION_S}
    mission["formation"] |= {
        "spacing_m": spacing_m,
        "speed_m_s": float(random.uniform(0.1, 0.5)),
        "leader": int(random.integers(1, count + 1)),
    }
    mission["encirclement"] |= {"radius_m": radius_m, "angular_rate_rad_s": rate_rad_s}
    mission["safety"] |= {
        "separation_m": separation_m,
        "keep_out_m": float(random.uniform(0.0, radius_m / 2.0)),
        "fence_m": [list(corner) for corner in fence],
    }
    mission["target"] |= {"start_m": list(target_m), "velocity_m_s": list(velocity_m_s)}
    mission["target"]["sensor"]["range_m"] = float(random.uniform(10.0, 40.0))
    mission["vehicles"] = [_vehicle(random, slot, start_m) for slot, start_m in enumerate(starts_m)]
    return parsed(mission)


def _vehicle(random: np.random.Generator, slot: int, start_m: Corner) -> Content:
    vehicle = drawn_vehicle(random, slot, start_m, PLANT_OFF_MOST)
    return vehicle | {"decision": {"distance_max_m": float(random.uniform(8.0, 40.0))}}


def _tight_fence(
    random: np.random.Generator, starts_m: list[Corner], path_m: tuple[Corner, Corner], radius_m: float
) -> list[Corner]:
    """Return a box about starts and ring with random dents as deep as possible; without dents it is convex."""
    rooms = [(start, START_CLEARANCE_M) for start in starts_m]
    steps = np.linspace(path_m[0], path_m[1], 200).tolist()
    rooms += [((x, y), radius_m + RING_CLEARANCE_M) for x, y in steps]
    low_x, low_y, high_x, high_y = (
        random.uniform(0.1, 3.0) + max(sign * place[axis] + room_m for place, room_m in rooms)
        for sign, axis in ((-1.0, 0), (-1.0, 1), (1.0, 0), (1.0, 1))
    )
    corners = [(-low_x, -low_y), (high_x, -low_y), (high_x, high_y), (-low_x, high_y)]
    fence: list[Corner] = []
    for index, (x, y) in enumerate(corners):
        end_x, end_y = corners[(index + 1) % 4]
        fence.append((float(x), float(y)))
        if random.random() < 0.5:
            share = random.uniform(0.2, 0.8)
            middle = x + share * (end_x - x), y + share * (end_y - y)
            length_m = hypot(end_x - x, end_y - y)
            inward = (y - end_y) / length_m, (end_x - x) / length_m
            rest = [(float(a), float(b)) for a, b in corners[index + 1 :]]
            depth_m = random.uniform(0.3, 1.0) * _deepest_dent_m(fence, rest, middle, inward, rooms)
            fence.append((float(middle[0] + depth_m * inward[0]), float(middle[1] + depth_m * inward[1])))
    return fence[::-1] if random.random() < 0.5 else fence


def _deepest_dent_m(
    before: list[Corner], after: list[Corner], middle: Corner, inward: Corner, rooms: list[tuple[Corner, float]]
) -> float:
    """Return how far inwards a corner between two others may move before a room is cut."""

    def fits(depth_m: float) -> bool:
        dent = middle[0] + depth_m * inward[0], middle[1] + depth_m * inward[1]
        fence = Fence([*before, dent, *after])
        return fence.crossed_edges() is None and all(fence.clearance_m(place) >= room_m for place, room_m in rooms)

    low_m, high_m = 0.0, 40.0
    while high_m - low_m > 0.1:
        tried_m = (low_m + high_m) / 2.0
        low_m, high_m = (tried_m, high_m) if fits(tried_m) else (low_m, tried_m)
    return low_m


@dataclass(frozen=True)
class Flown:
    """The margins of a flight to the bounds, positive inside; lead and speed are the largest values."""

    seed: int
    vehicles: int
    separation_left_m: float
    fence_left_m: float
    lead_left_m: float
    speed_left_m_s: float
    interventions: int
    misjudged: tuple[int, ...]

    @property
    def holds(self) -> bool:
        """Whether the flight kept the invariant; False for NaN."""
        return (
            self.separation_left_m >= -SEPARATION_SLACK_M
            and self.fence_left_m >= 0.0
            and self.lead_left_m >= -LEAD_SLACK_M
            and self.speed_left_m_s >= -SPEED_SLACK_M_S
            and not self.misjudged
        )

    def __str__(self) -> str:
        return (
            f"seed {self.seed}, {self.vehicles} vehicles: separation {self.separation_left_m:+.2f} m, "
            f"fence {self.fence_left_m:+.2f} m, lead {self.lead_left_m:+.2f} m, speed {self.speed_left_m_s:+.2f} m/s, "
            f"{self.interventions} interventions"
            f"{f', misjudged the reach of {named(self.misjudged)}' if self.misjudged else ''}"
        )


def flown(mission: Mission, seed: int) -> Flown:
    """Fly a mission and measure the margins on the true paths."""
    outputs: dict[tuple[int, int], TickOutput] = {}
    flight = observed(mission, seed, lambda tick, vehicle, output: outputs.update({(tick, vehicle): output}))
    places, speeds = flight.motion[..., POSITION], np.hypot(*np.moveaxis(flight.motion[..., VELOCITY], -1, 0))
    safety = mission.safety
    fence = Fence(safety.fence_m) if safety.fence_m else None
    acts_after_s = np.array([vehicle.plant.delay_s for vehicle in mission.vehicles]) + 0.5 / mission.mission.rate_hz
    lead_m = np.full(speeds.shape, -inf)
    for (tick, vehicle), output in outputs.items():
        if output.setpoint is not None:
            lead_m[tick, vehicle] = hypot(*(places[tick, vehicle] - output.setpoint.position_m[:2]).tolist())
    return Flown(
        seed,
        len(mission.vehicles),
        _closest_m(places) - safety.separation_m,
        inf if fence is None else min(fence.clearance_m((x, y)) for x, y in places.reshape(-1, 2).tolist()),
        float((safety.setpoint_lead_max_m + speeds * acts_after_s - lead_m).min()),
        safety.speed_max_m_s - float(speeds.max()),
        sum(output.status.guarded is not None and bool(output.status.guarded.causes) for output in outputs.values()),
        tuple(sorted(_misjudged(mission, outputs.values()))),
    )


def _misjudged(mission: Mission, outputs: Collection[TickOutput]) -> set[int]:
    """Return the vehicles that engage, or do not, against what the preflight check says of their reach."""
    found = [each.about for each in encounter(mission) if each.check == "reach" and each.grade is Grade.WARNING]
    warned = {*mission.ids} if MISSION in found else {about for about in found if isinstance(about, int)}
    engaged = {output.status.vehicle_id for output in outputs if output.status.tactic is Tactic.ENCIRCLE}
    moved = any(
        output.status.tactic is Tactic.FORMATION and output.status.guarded is not None and output.status.guarded.causes
        for output in outputs
    )
    return {*mission.ids} - engaged - warned if moved else {*mission.ids} - (engaged ^ warned)


def _closest_m(places: Vector) -> float:
    pairs = combinations(range(places.shape[1]), 2)
    return float(min(np.linalg.norm(places[:, one] - places[:, other], axis=-1).min() for one, other in pairs))


def random_flight(seed: int) -> Flown:
    """Fly the random mission of a seed."""
    return flown(random_mission(seed), seed)


def main(count: int, first: int) -> int:
    """Fly a number of missions, from the seed `first` on, on all cores."""
    with ProcessPoolExecutor() as pool:
        flights = []
        for flight in pool.map(random_flight, range(first, first + count)):
            flights.append(flight)
            if not flight.holds:
                print(f"broken: {flight}", file=sys.stderr, flush=True)
    broken = [flight for flight in flights if not flight.holds]
    for title, worst in (
        ("closest to each other", sorted(flights, key=lambda flight: flight.separation_left_m)[:5]),
        ("closest to the fence", sorted(flights, key=lambda flight: flight.fence_left_m)[:5]),
        ("farthest setpoints", sorted(flights, key=lambda flight: flight.lead_left_m)[:3]),
        ("fastest", sorted(flights, key=lambda flight: flight.speed_left_m_s)[:3]),
        (f"{len(broken)} of {count} break the invariant", broken),
    ):
        print(f"{title}:", *worst, sep="\n  ", flush=True)
    return 1 if broken else 0


if __name__ == "__main__":
    given = seeded_parser("random_missions", __doc__, 200).parse_args()
    sys.exit(main(given.count, given.first))
