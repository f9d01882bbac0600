"""A swap on stubs: a vehicle lands with a low battery in mid-ring, its autopilot restarts, and it rejoins the others.

Measured are the true motions, about the target's true path.
"""

import asyncio
import signal
from asyncio.subprocess import Process
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from math import atan2, degrees, dist, inf, tau
from pathlib import Path

from agents.inputs import Start
from gcs.flightlog.reader import FlightLog, read_log
from sitl.autopilot.modes import NavMode
from tests.support.served_team import Team
from tests.support.wire import PATIENCE_S, at_speed, hurried, running, until

NEAR_TARGET = (
    ("start_m = [35.0, -5.0]", "start_m = [22.0, 0.0]"),
    ("radius_m = 10.0\nangular_rate_rad_s = 0.05", "radius_m = 7.0\nangular_rate_rad_s = 0.07"),
    ("distance_max_m = 12.0", "distance_max_m = 40.0"),
    ("range_m = 15.0", "range_m = 60.0"),
    ("separation_m = 3.0", 'separation_m = 3.0\n\n[choreography]\nlayer_m = 3.0\nlanding = "return"'),
)
"""A change of case2: its vehicles engage at once, away from their starts, and come home in layers."""
SETTLING_S = 30.0
EVEN_DEG, ROUND_SHARE = 5.0, 0.05
"""A ring is even once every spacing is within the first and every radius within the second of the ring's."""


@dataclass(frozen=True)
class Sample:
    """A moment on the team's clock: where the vehicles in the air truly are [m]."""

    time_s: float
    places_m: dict[int, tuple[float, ...]]


@dataclass(frozen=True)
class Figures:
    """A ring over a time: its mean radius, the largest error of a radius and of a spacing, least distance."""

    vehicles: int
    radius_m: float
    radius_off_m: float
    spacing_off_deg: float
    least_m: float

    def __str__(self) -> str:
        return (
            f"{self.vehicles} vehicles: mean radius {self.radius_m:.2f} m, most {self.radius_off_m:.2f} m off, "
            f"spacing most {self.spacing_off_deg:.1f} deg off, least distance {self.least_m:.2f} m"
        )


class Tracks:
    """The true tracks of a team while they are recorded."""

    def __init__(self, team: Team) -> None:
        self._team = team
        self.samples: list[Sample] = []

    async def record(self) -> None:
        """Record until cancelled."""
        while True:
            team = self._team
            self.samples.append(Sample(team.clock.now_s(), {i: team.place_m(i) for i in team.aloft}))
            await team.clock.sleep(0.1)

    def least_m(self, until_s: float = inf) -> float:
        """Return the least distance of any two in the air until a time of the clock."""
        return min((_least_m(each) for each in self.samples if each.time_s < until_s), default=inf)


@dataclass(frozen=True)
class Swap:
    """A swap: when the battery ran low, the vehicle was down, was told to rejoin, and took off [s of the clock]."""

    vehicle: int
    low_s: float
    down_s: float
    rejoined_s: float
    armed_s: float


async def swap(
    team: Team, vehicle: int, *, silent_s: float = 4.0, emptied: bool = False, runs_low: bool = True
) -> Swap:
    """Let a vehicle run low; once it is down, restart its autopilot with a full battery, and let it rejoin.

    One that does not run low lands for another reason. One that is `emptied` is told to rejoin before that as well,
    which is refused.
    """
    low_s = team.clock.now_s()
    if runs_low:
        team.vehicles[vehicle].battery_fraction = 0.19
    with hurried(team.clock):
        down_s = await until(lambda: not team.vehicles[vehicle].armed, 200.0, "its landing", clock=team.clock)
    if emptied:
        code, said = await told(team, vehicle)
        assert (code, "battery" in said) == (3, True), said
    with hurried(team.clock):
        stub = team.stubs.stubs[vehicle]
        stub.faults.link_cut = True
        await team.clock.sleep(silent_s)
        stub.restart(1.0)
        stub.faults.link_cut = False
    await until(lambda: team.vehicles[vehicle].armable, 30.0, "its position", clock=team.clock)
    await team.clock.sleep(5.0)
    rejoined_s = team.clock.now_s()
    code, said = await told(team, vehicle)
    assert code == 0, said
    armed_s = await until(lambda: team.vehicles[vehicle].armed, 30.0, "its take-off", clock=team.clock)
    return Swap(vehicle, low_s, down_s, rejoined_s, armed_s)


async def told(team: Team, vehicle: int) -> tuple[int, str]:
    """Tell a vehicle to rejoin; return the exit code and what was said."""
    return await commanded(team, "rejoin", str(vehicle))


async def commanded(team: Team, *command: str) -> tuple[int, str]:
    """Send a command to a team; return the exit code and what was said."""
    with at_speed(team.clock, 1.0):
        async with asyncio.timeout(PATIENCE_S), running(*command, "--mission", team.path) as process:
            _, err = await process.communicate()
    assert process.returncode is not None
    assert "Traceback" not in err.decode(), err.decode()
    return process.returncode, " ".join(err.decode().split())


async def ended(team: Team, flight: Process, *, interrupts: int = 2) -> tuple[str, str]:
    """End a flight as an operator does at once, after two interrupts in all; return its output once all are down."""
    for _ in range(interrupts):
        flight.send_signal(signal.SIGINT)
        await team.clock.sleep(1.0)
    with hurried(team.clock):
        await until(lambda: not team.aloft, 200.0, "all landings", clock=team.clock)
    out, err = await flight.communicate()
    return out.decode(), err.decode()


async def in_offboard(team: Team) -> None:
    """Wait until all vehicles fly in offboard."""
    flown = team.vehicles.values()
    await until(lambda: any(each.armed for each in flown), waiting_for="a take-off")
    with hurried(team.clock):
        await until(lambda: all(each.mode is NavMode.OFFBOARD for each in flown), 300.0, "offboard", clock=team.clock)


class RingTruth:
    """The ring of a recorded flight by true motions: its target moves as the mission says."""

    def __init__(self, team: Team, log_path: Path, samples: Sequence[Sample]) -> None:
        self._target, self.ring_m = team.mission.target.motion, team.mission.encirclement.radius_m
        self.start_s = start_of(read_log(log_path))
        self._samples = samples

    def figures(self, ids: Collection[int], from_s: float, to_s: float) -> Figures:
        """Return the figures of the ring of these vehicles between two times of the clock."""
        inside = [each for each in self._samples if from_s <= each.time_s < to_s]
        radii_m = [radius_m for each in inside for radius_m, _ in self._polar(each, ids)]
        spacings_deg = [self._spacing_off_deg(each, ids) for each in inside]
        radius_off_m = max(abs(each - self.ring_m) for each in radii_m)
        least_m = min(map(_least_m, inside))
        return Figures(len(ids), sum(radii_m) / len(radii_m), radius_off_m, max(spacings_deg), least_m)

    def even_after_s(self, ids: Collection[int], from_s: float, to_s: float) -> float:
        """Return how long after a time the ring of these vehicles is even and stays so until another; inf if never."""
        inside = [each for each in self._samples if from_s <= each.time_s < to_s]
        uneven = [each.time_s for each in inside if not self._is_even(each, ids)]
        if not inside or (uneven and uneven[-1] == inside[-1].time_s):
            return inf
        return (uneven[-1] if uneven else from_s) - from_s

    def _is_even(self, sample: Sample, ids: Collection[int]) -> bool:
        if not set(ids) <= sample.places_m.keys():
            return False
        round_ = all(abs(radius_m / self.ring_m - 1.0) <= ROUND_SHARE for radius_m, _ in self._polar(sample, ids))
        return round_ and self._spacing_off_deg(sample, ids) <= EVEN_DEG

    def _polar(self, sample: Sample, ids: Collection[int]) -> list[tuple[float, float]]:
        x, y = self._target.position_m(sample.time_s - self.start_s)
        places = [sample.places_m[i] for i in ids]
        return [(dist(place[:2], (x, y)), atan2(place[1] - y, place[0] - x)) for place in places]

    def _spacing_off_deg(self, sample: Sample, ids: Collection[int]) -> float:
        bearings = sorted(bearing for _, bearing in self._polar(sample, ids))
        gaps = [after - before for before, after in pairwise([*bearings, bearings[0] + tau])]
        return max(degrees(abs(gap - tau / len(bearings))) for gap in gaps)


def start_of(log: FlightLog) -> float:
    """Return the mission's start on the clock of a recorded flight."""
    starts = [each.plain()["at_s"] for records in log.vehicles.values() for each in records if each.kind is Start]
    return float(min(starts))


def _least_m(sample: Sample) -> float:
    return min((dist(one, other) for one, other in combinations(sample.places_m.values(), 2)), default=inf)
