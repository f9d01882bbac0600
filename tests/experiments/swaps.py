"""Swap vehicles of a ring at random: which, when, why, plants and noise; distances and the time to even spacing.

Each draw is a flight of three stubs with plants up to 15 % off their profiles and noisy estimates. One vehicle comes
home with a low battery, or because the operator lets it return; its autopilot restarts, and it rejoins the ring.
Measured are the true motions. Exit code 1 if a draw comes nearer than the separation, or has no even ring again.
"""

import asyncio
import re
import sys
from dataclasses import dataclass
from math import isinf
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gcs.link.ports import free_ports
from tests.conftest import own_team
from tests.experiments.arguments import seeded_parser
from tests.support.paths import MISSIONS
from tests.support.served_team import team_of
from tests.support.swaps import NEAR_TARGET, RingTruth, Tracks, commanded, ended, in_offboard, swap
from tests.support.wire import hurried, running

AGAIN_S = 90.0
"""How long the flight goes on after the vehicle has taken off again [s of its clock]."""


@dataclass(frozen=True)
class Draw:
    """One flight: what was drawn, and what was measured."""

    seed: int
    vehicle: int
    after_s: float
    verb: str
    least_m: float
    separation_m: float
    even_after_s: float

    def __str__(self) -> str:
        why = "battery low" if not self.verb else self.verb
        return (
            f"seed {self.seed}: vehicle {self.vehicle} after {self.after_s:.0f} s ({why}): even again "
            f"{self.even_after_s:.1f} s after its take-off, least distance {self.least_m:.2f} m"
        )

    @property
    def fails(self) -> bool:
        """Whether two vehicles came too near, or the ring was not even again."""
        return self.least_m < self.separation_m or isinf(self.even_after_s)


async def drawn(seed: int, folder: Path) -> Draw:
    """Fly the swap of a seed."""
    draw = np.random.default_rng(seed)
    vehicle, after_s = int(draw.integers(1, 4)), float(draw.uniform(20.0, 80.0))
    verb = str(draw.choice(["", "rtl"]))
    path, log = _mission(seed, draw, folder), folder / f"swap-{seed}.mcap"
    async with team_of(path) as team, running("fly", path, "--log", str(log)) as flight:
        tracks = Tracks(team)
        recording = asyncio.create_task(tracks.record())
        await in_offboard(team)
        with hurried(team.clock):
            await team.clock.sleep(after_s)
        if verb:
            code, said = await commanded(team, "command", verb, "--vehicle", str(vehicle))
            assert code == 0, said
        swapped = await swap(team, vehicle, silent_s=float(draw.uniform(1.0, 10.0)), runs_low=not verb)
        with hurried(team.clock):
            await team.clock.sleep(AGAIN_S)
        ends_s = team.clock.now_s()
        await ended(team, flight)
        recording.cancel()
        separation_m = team.mission.safety.separation_m
    even_s = RingTruth(team, log, tracks.samples).even_after_s(team.mission.ids, swapped.armed_s, ends_s)
    return Draw(seed, vehicle, after_s, verb, tracks.least_m(until_s=ends_s), separation_m, even_s)


def _mission(seed: int, draw: np.random.Generator, folder: Path) -> str:
    """Write a team of its own that flies the mission of a seed."""
    text = (MISSIONS / "case2.toml").read_text(encoding="utf-8")
    for old, new in NEAR_TARGET:
        text = text.replace(old, new)
    for y in ("4.0", "0.0", "-4.0"):
        a0, a1 = draw.uniform(0.85, 1.15, 2)
        start = f"start_m = [0.0, {y}]"
        text = text.replace(start, f"{start}\ntrue_scale = {{ a0 = {a0:.3f}, a1 = {a1:.3f} }}")
    noise = "\n[simulation]\nposition_noise_m = 0.05\nvelocity_noise_m_s = 0.05\n"
    text = text.replace("rate_hz = 10.0\n", f"rate_hz = 10.0\nseed = {seed}\n", 1) + noise
    ports = sorted(set(re.findall(r"127\.0\.0\.1:(\d+)", text)))
    own = dict(zip(ports, free_ports(len(ports)), strict=True))
    text = re.sub(r"(127\.0\.0\.1):(\d+)", lambda found: f"{found[1]}:{own[found[2]]}", text)
    path = folder / f"swap-{seed}.toml"
    path.write_text(own_team(text, f"swap-{min(own.values())}"), encoding="utf-8")
    return str(path)


def main() -> int:
    """Fly all draws, and print each and the worst."""
    arguments = seeded_parser("swaps", __doc__ or "", 10).parse_args()
    draws: list[Draw] = []
    with TemporaryDirectory() as folder:
        for seed in range(arguments.first, arguments.first + arguments.count):
            draws.append(asyncio.run(drawn(seed, Path(folder))))
            print(draws[-1], flush=True)
    least_m, even_s = min(each.least_m for each in draws), max(each.even_after_s for each in draws)
    print(f"{len(draws)} swaps: least distance {least_m:.2f} m, even again at most {even_s:.1f} s after take-off")
    return int(any(each.fails for each in draws))


if __name__ == "__main__":
    sys.exit(main())
