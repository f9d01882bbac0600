"""A swap: a vehicle lands in mid-ring, its battery and its autopilot are new, and it rejoins the flight of its team.

The vehicles are stubs of this process, on a governed clock, with plants that differ from their profiles.
"""

import asyncio
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.served_team import UNLIKE, team_of
from tests.support.swaps import NEAR_TARGET, SETTLING_S, RingTruth, Tracks, in_offboard, swap, told
from tests.support.wire import PATIENCE_S, hurried, running, until

pytestmark = pytest.mark.wire


@pytest.mark.long
async def test_a_vehicle_that_landed_with_a_low_battery_comes_back_into_the_ring(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    """It is refused before it is ready, and once the team returns; the log of it all is replayed bit for bit."""
    path, log = mission_file("case2", *UNLIKE, *NEAR_TARGET), tmp_path / "swap.mcap"
    async with team_of(path) as team, asyncio.timeout(PATIENCE_S), running("fly", path, "--log", str(log)) as flight:
        tracks = Tracks(team)
        recording = asyncio.create_task(tracks.record())
        await in_offboard(team)
        with hurried(team.clock):
            await team.clock.sleep(SETTLING_S)
        code, said = await told(team, 2)
        assert (code, "it has not landed" in said) == (3, True), said
        swapped = await swap(team, 2)
        with hurried(team.clock):
            await team.clock.sleep(2.0 * SETTLING_S)
        rejoined_s = team.clock.now_s()
        flight.send_signal(signal.SIGINT)
        await until(
            lambda: any(not each.armed for each in team.vehicles.values()), 200.0, "a landing", clock=team.clock
        )
        await until(lambda: not team.aloft, 200.0, "all landings", clock=team.clock)
        recording.cancel()
        _, err = await flight.communicate()
    ring = RingTruth(team, log, tracks.samples)
    before = ring.figures((1, 2, 3), swapped.low_s - 10.0, swapped.low_s)
    between = ring.figures((1, 3), swapped.rejoined_s - 8.0, swapped.rejoined_s)
    after = ring.figures((1, 2, 3), rejoined_s - 20.0, rejoined_s)
    even_s = ring.even_after_s((1, 2, 3), swapped.rejoined_s, rejoined_s)
    print(f"MEASURED before: {before}\nbetween: {between}\nafter: {after}\neven {even_s:.1f} s after the command")
    print(f"least distance of the whole flight {tracks.least_m:.2f} m")
    print(err.decode())
    async with running("replay", str(log)) as replay:
        out, err = await replay.communicate()
        assert replay.returncode == 0, err.decode() + out.decode()
        assert b"compared bit for bit" in out + err
