"""A team that flies over MAVLink and Zenoh is recorded, and its flight replayed: every decision is the same again."""

import asyncio
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gcs.flightlog.reader import read_log
from gcs.replay.cores import replay
from gcs.replay.timeline import timeline_of
from tests.support.mission_text import LOW
from tests.support.paths import ROOT

pytestmark = pytest.mark.wire

SPEED, SECONDS = 5.0, 30.0


async def cordon(*arguments: str) -> tuple[int | None, str, str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gcs", *arguments),
        env=environment,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    out, err = await asyncio.wait_for(process.communicate(), 100.0)
    return process.returncode, out.decode(), err.decode()


async def test_a_flight_on_stubs_is_replayed_bit_for_bit(mission_file: Callable[..., str], tmp_path: Path) -> None:
    near = ("start_m = [35.0, -5.0]", "start_m = [8.0, -5.0]")
    log = str(tmp_path / "flight.mcap")
    flight = ("--sitl", "--speed", str(SPEED), "--duration", str(SECONDS), "--log", log)
    code, _, told = await cordon("fly", mission_file("case2", near, LOW), *flight)
    assert code in (0, 1), told  # a verdict may fail: it is short
    recorded = read_log(Path(log))
    replayed = replay(recorded)
    assert (replayed.same, replayed.other_versions) == (True, ())
    for vehicle in replayed.vehicles:
        assert vehicle.ticks == vehicle.compared == vehicle.identical
        assert vehicle.ticks > 0.7 * 10.0 * SECONDS, "it has flown, and skipped few ticks"
    assert [vehicle.vehicle_id for vehicle in replayed.vehicles] == [1, 2, 3]
    lines = [entry.text for entry in timeline_of(recorded, 2).entries]
    for passage in ("standby -> formation: start", "formation -> encircle: engage", "mode offboard"):
        assert passage in lines
    assert any(line.startswith("return and land -> land") for line in lines)
