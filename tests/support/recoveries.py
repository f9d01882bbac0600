"""A team of stubs whose flight is killed, and which another process brings home."""

import asyncio
import json
import os
import signal
from asyncio.subprocess import Process
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any

import psutil

from sitl.autopilot.modes import NavMode
from tests.support.served_team import Team
from tests.support.wire import PATIENCE_S, hurried, running, until

HOME_M = 1.5
"""How far from its start a vehicle lands that returns there."""


@asynccontextmanager
async def in_mid_ring(team: Team, offboard_s: float = 45.0) -> AsyncIterator[Process]:
    """Fly the mission, until all have flown for a time in offboard [s of the team's clock]."""
    async with running("fly", team.path, "--no-log") as flight:
        flown = team.vehicles.values()
        await until(lambda: any(each.armed for each in flown), waiting_for="a take-off")
        with hurried(team.clock):
            await until(
                lambda: all(each.mode is NavMode.OFFBOARD for each in flown), 300.0, "offboard", clock=team.clock
            )
            await team.clock.sleep(offboard_s)
        yield flight


def kill_whole(supervisor: int) -> None:
    """Kill the supervisor of a flight, and at once its flying process."""
    flying = [each for each in psutil.Process(supervisor).children() if "fly" in each.cmdline()]
    assert len(flying) == 1
    for process_id in (supervisor, flying[0].pid):
        os.kill(process_id, signal.SIGKILL)


async def take_off(team: Team, heights_m: Mapping[int, float]) -> None:
    """Let vehicles hover above the places where they stand, as another ground station left them."""
    await until(lambda: all(each.armable for each in team.vehicles.values()), 10.0, "positions", clock=team.clock)
    for i, height_m in heights_m.items():
        team.vehicles[i].arm()
        team.vehicles[i].take_off(height_m)
    with hurried(team.clock):
        await until(
            lambda: all(team.vehicles[i].mode is NavMode.HOLD for i in heights_m), 60.0, "hovering", clock=team.clock
        )


async def recovered(
    team: Team, *options: str, path: str = "", log: str = "", patience_s: float = PATIENCE_S
) -> tuple[int, str, Any]:
    """Recover the team; return the exit code, what was said, and the result."""
    arguments = (
        path or team.path,
        "--yes",
        "--json",
        "--speed",
        "max",
        *(("--log", log) if log else ("--no-log",)),
        *options,
    )
    async with asyncio.timeout(patience_s), running("recover", *arguments) as process:
        out, err = await process.communicate()
    assert process.returncode is not None
    assert "Traceback" not in err.decode(), err.decode()
    return process.returncode, err.decode(), json.loads(out)
