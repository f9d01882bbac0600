"""Kill flights of sixteen stubs in mid-ring, and bring them home by `cordon recover`: distances, times and ends.

Each seed draws plants up to 15 % off their profiles, noise, and how long they encircle before supervisor and flying
process are killed. Two teams are flown of each: from one all come home; from the other a pilot takes one vehicle, and
another falls. Measured are the true motions. Exit code 1 if two come too near each other, a vehicle does not come home,
though one whose start is near the pilot's or the fallen one lands aside, or the one with a pilot is moved.
"""

import asyncio
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import dist
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

from gcs.flight.stubs import preparing_speed
from gcs.link.ports import free_ports
from sitl.autopilot.modes import NavMode
from tests.experiments.arguments import seeded_parser
from tests.support.recoveries import HOME_M, in_mid_ring, kill_whole, recovered
from tests.support.ring_mission import ring_mission
from tests.support.served_team import Team, team_of
from tests.support.wire import until

COUNT = 16
PATIENCE_S = 1800.0
NEAR = 2.0
"""In separations: one whose start is nearer than this to a vehicle in the way may land aside."""


@dataclass(frozen=True)
class Recovery:
    """A recovery by the true motions: distances from the kill until all are down."""

    name: str
    least_m: float
    least_level_m: float
    took_s: float
    ends: dict[str, int]
    off_start_m: float
    aside: str
    faults: tuple[str, ...]

    def __str__(self) -> str:
        ends = ", ".join(f"{count} {how}" for how, count in sorted(self.ends.items()))
        return (
            f"{self.name}: {ends} after {self.took_s:.0f} s; least distance in the air {self.least_m:.2f} m, "
            f"at like heights {self.least_level_m:.2f} m; landed at most {self.off_start_m:.2f} m from their starts"
            f"{self.aside}"
            f"{''.join(f'; FAULT: {each}' for each in self.faults)}"
        )


async def flown(seed: int, folder: Path, *, troubled: bool) -> Recovery:
    """Fly a seed's team; `troubled`, a pilot takes one vehicle after the kill, and one falls."""
    draw = np.random.default_rng(seed)
    path = _mission(seed, draw, folder)
    pilot, fallen = (int(each) for each in draw.permutation(COUNT)[:2] + 1) if troubled else (0, 0)
    async with team_of(path) as team:
        team.clock.set_speed(preparing_speed(COUNT))
        async with in_mid_ring(team, float(draw.uniform(40.0, 120.0))) as flight:
            kill_whole(flight.pid)
        async with team.watched():
            with _sticks_centred():
                await until(lambda: _all_hold(team), 30.0, "the autopilots' failsafe", clock=team.clock)
                if troubled:
                    team.vehicles[pilot]._intention.mode = NavMode.POSITION
                    team.vehicles[fallen].disarm(force=True)
                    await team.clock.sleep(5.0)
                    piloted_m = team.place_m(pilot)
                code, said, result = await recovered(team, patience_s=PATIENCE_S)
        home = [i for i in team.vehicles if i not in (pilot, fallen)]
        in_the_way_m = [team.place_m(i)[:2] for i in (pilot, fallen) if i]
        aside = [i for i in home if team.off_start_m(i) > HOME_M and _is_near(team, i, in_the_way_m)]
        off_m = max(team.off_start_m(i) for i in home if i not in aside)
        faults = [*_faults(team, result, home, off_m), *_faults_aside(team, aside, in_the_way_m)]
        if troubled and (team.aloft != {pilot} or dist(team.place_m(pilot), piloted_m) > 0.5):
            faults.append(f"the pilot's vehicle {pilot} was moved")
        if code != (4 if troubled else 0):
            faults.append(f"exit code {code}: {said}")
    ends = [each["how"] or each["treatment"] for each in result["vehicles"]]
    name = f"seed {seed}, " + (f"a pilot flies {pilot}, {fallen} has fallen" if troubled else "all in the air")
    count = {how: ends.count(how) for how in ends}
    sidesteps = "".join(f"; {i} landed aside, {team.off_start_m(i):.2f} m from its start" for i in aside)
    return Recovery(
        name, team.least_m, team.least_level_m, result["duration_s"], count, off_m, sidesteps, tuple(faults)
    )


def _is_near(team: Team, i: int, places_m: list[tuple[float, ...]]) -> bool:
    """Return whether a vehicle's start is near a place in the way: there it must not land."""
    near_m = NEAR * team.mission.safety.separation_m
    return any(dist(team.mission.vehicle(i).section.start_m, each) < near_m for each in places_m)


def _faults_aside(team: Team, aside: list[int], places_m: list[tuple[float, ...]]) -> Iterator[str]:
    """Yield which of those that landed aside are too near to another vehicle, or to what is in the way."""
    least_m = team.mission.safety.separation_m
    for i in aside:
        others_m = [team.place_m(other)[:2] for other in team.vehicles if other != i]
        if min(dist(team.place_m(i)[:2], each) for each in (*others_m, *places_m)) < least_m:
            yield f"{i} landed too near to another"


def _faults(team: Team, result: Any, home: list[int], off_m: float) -> Iterator[str]:
    if team.least_level_m < team.mission.safety.separation_m:
        yield "two came nearer than the separation"
    if off_m > HOME_M:
        yield "one landed elsewhere"
    how = {each["id"]: each["how"] for each in result["vehicles"]}
    if others := [i for i in home if how[i] != "landed" or i in team.aloft]:
        yield f"vehicles {others} did not land"


def _all_hold(team: Team) -> bool:
    return all(each.mode is NavMode.HOLD for each in team.vehicles.values())


def _sticks_centred() -> AbstractContextManager[object]:
    """Let a stub's pilot hold it where it is."""
    return patch("sitl.autopilot.guidance.NEEDS_STICKS", frozenset())


def _mission(seed: int, draw: np.random.Generator, folder: Path) -> str:
    """Write the mission of a seed, with ports and a team's name of its own."""
    ports = free_ports(2 * COUNT)
    text = ring_mission(COUNT, 900.0, ports[:COUNT], ports[COUNT:]).replace("rate_hz = 20.0", "rate_hz = 10.0")
    text = text.replace("duration_s", f"seed = {seed}\nduration_s", 1)
    head, *vehicles = text.split("[[vehicles]]")
    noise = "[simulation]\nposition_noise_m = 0.05\nvelocity_noise_m_s = 0.05\n"
    scales = draw.uniform(0.85, 1.15, (COUNT, 2)).tolist()
    text = head + noise
    for vehicle, (a0, a1) in zip(vehicles, scales, strict=True):
        text += f"[[vehicles]]{vehicle}true_scale = {{ a0 = {a0:.3f}, a1 = {a1:.3f} }}\n"
    path = folder / f"recovery-{min(ports)}.toml"
    path.write_text(text.replace('team = "ring-', f'team = "recovery-{min(ports)}-'), encoding="utf-8")
    return str(path)


def main() -> int:
    """Fly all seeds, and print each recovery."""
    arguments = seeded_parser("recoveries", __doc__ or "", 1).parse_args()
    recoveries: list[Recovery] = []
    with TemporaryDirectory() as folder:
        for seed in range(arguments.first, arguments.first + arguments.count):
            for troubled in (False, True):
                recoveries.append(asyncio.run(flown(seed, Path(folder), troubled=troubled)))
                print(recoveries[-1], flush=True)
    return int(any(each.faults for each in recoveries))


if __name__ == "__main__":
    sys.exit(main())
