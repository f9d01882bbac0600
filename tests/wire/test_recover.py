"""`cordon recover`: a team whose flight was killed comes home by another process, apart, and nobody else is touched.

The vehicles are stubs of this process, on a governed clock, with plants that differ from their profiles.
"""

import asyncio
import os
import re
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from itertools import combinations
from math import dist

import psutil
import pytest

from gcs.flight.stubs import prepared_configs
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from sitl.autopilot.modes import NavMode
from sitl.server.governed_clock import GovernedClock
from tests.support.wire import PATIENCE_S, Served, hurried, running, served, until

pytestmark = pytest.mark.wire

FAST = 10.0
HOLDS = {"COM_OBL_RC_ACT": 5}
"""The vehicles hold once no setpoints arrive."""
HOME_M = 1.5
"""How far from its start a vehicle lands that returns there."""
ON_RING = (
    ("start_m = [35.0, -5.0]", "start_m = [14.0, 0.0]"),
    ("distance_max_m = 12.0", "distance_max_m = 30.0"),
    ("start_m = [0.0, 4.0]", "start_m = [0.0, 4.0]\ntrue_scale = { a0 = 1.15, a1 = 0.9 }"),
    ("start_m = [0.0, 0.0]", "start_m = [0.0, 0.0]\ntrue_scale = { a0 = 0.88, a1 = 1.1 }"),
    ("start_m = [0.0, -4.0]", "start_m = [0.0, -4.0]\ntrue_scale = { a0 = 1.1, a1 = 1.1 }"),
)
"""Changes of case2: its target is at hand, and its vehicles engage at once; their plants are off by up to 15 %."""


class Team:
    """The vehicles as they truly are, and the least distance of any two in the air since `watch` began."""

    def __init__(self, path: str, mission: Mission, stubs: Served) -> None:
        self.path, self.mission, self.stubs = path, mission, stubs
        self.clock: GovernedClock = stubs.clock
        self.vehicles = stubs.vehicles
        self.least_m = float("inf")

    def place_m(self, i: int) -> tuple[float, ...]:
        return tuple(self.vehicles[i].airframe.position_m)

    @property
    def aloft(self) -> set[int]:
        return {i for i, each in self.vehicles.items() if each.armed and not each.landed}

    def off_start_m(self, i: int) -> float:
        return dist(self.place_m(i)[:2], self.mission.vehicle(i).section.start_m)

    async def watch(self) -> None:
        while True:
            for one, other in combinations(sorted(self.aloft), 2):
                self.least_m = min(self.least_m, dist(self.place_m(one), self.place_m(other)))
            await self.clock.sleep(0.1)


@asynccontextmanager
async def team_of(path: str) -> AsyncIterator[Team]:
    mission = load_mission(path)
    configs = [replace(each, parameters=HOLDS) for each in prepared_configs(mission, mission.ids, 1.0)]
    async with served(configs, FAST) as stubs:
        yield Team(path, mission, stubs)


async def kill_in_mid_ring(team: Team, at_s: float = 45.0) -> None:
    """Fly the mission, and kill supervisor and flying process while the vehicles encircle."""
    async with running("fly", team.path, "--no-log") as flight:
        await until(lambda: any(each.armed for each in team.vehicles.values()), waiting_for="a take-off")
        with hurried(team.clock):
            modes = team.vehicles.values()
            await until(
                lambda: all(each.mode is NavMode.OFFBOARD for each in modes), 300.0, "offboard", clock=team.clock
            )
            await team.clock.sleep(at_s)
        both = psutil.Process(flight.pid)
        flying = [each for each in both.children(recursive=True) if "fly" in each.cmdline()]
        assert flying
        os.kill(flight.pid, signal.SIGKILL)
        for each in flying:
            each.send_signal(signal.SIGKILL)
        psutil.wait_procs(flying, timeout=PATIENCE_S)
    await until(
        lambda: all(each.mode is not NavMode.OFFBOARD for each in team.vehicles.values()), 30.0, clock=team.clock
    )


async def recovered(team: Team, *options: str) -> tuple[int, str]:
    """Recover the team; return the exit code and what was said."""
    async with asyncio.timeout(PATIENCE_S), running("recover", team.path, "--yes", "--no-log", *options) as process:
        out, err = await process.communicate()
    assert out == b""
    assert process.returncode is not None
    assert "Traceback" not in err.decode(), err.decode()
    return process.returncode, err.decode()


@pytest.mark.long
async def test_a_team_whose_flight_was_killed_in_mid_ring_comes_home(mission_file: Callable[..., str]) -> None:
    async with team_of(mission_file("case2", *ON_RING)) as team, AsyncExitStack() as stack:
        await kill_in_mid_ring(team)
        assert team.aloft == {1, 2, 3}
        assert min(map(team.off_start_m, (1, 2, 3))) > 2.0, "they are on the ring"
        print({i: (each.mode, team.place_m(i)) for i, each in team.vehicles.items()})
        watching = asyncio.create_task(team.watch())
        stack.callback(watching.cancel)
        began_s = team.clock.now_s()
        code, said = await recovered(team)
        took_s = team.clock.now_s() - began_s
    print(said)
    print(f"MEASURED least distance {team.least_m:.2f} m, {took_s:.0f} s from the command to the end")
    assert code == 0, said
    assert not team.aloft
    assert max(map(team.off_start_m, (1, 2, 3))) < HOME_M
    assert team.least_m >= team.mission.safety.separation_m
