"""Two runs on one computer: the second is refused before it starts anything, and the first flies on."""

import asyncio
import json
import os
import signal
import socket
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from agents.ports import VehicleRefusedError
from gcs.console.command_client import CommandClient
from gcs.mission.file import load_mission
from tests.support.paths import ROOT
from tests.support.wire import free_ports

pytestmark = pytest.mark.wire

DURATION_S = "45"


@asynccontextmanager
async def cordon(*arguments: str) -> AsyncIterator[Process]:
    """Run a command of cordon in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "400"}
    command = [sys.executable, "-m", "gcs", *arguments]
    process = await asyncio.create_subprocess_exec(*command, stdout=PIPE, stderr=PIPE, env=environment)
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            process.kill()


async def refused(*arguments: str) -> str:
    """Run a command that is to be refused, and return what it says."""
    async with asyncio.timeout(30.0), cordon(*arguments) as process:
        out, err = await process.communicate()
    assert (process.returncode, out) == (3, b""), (arguments, process.returncode, err.decode())
    assert "Traceback" not in err.decode()
    return " ".join(err.decode().split())


async def line_with(process: Process, text: str) -> None:
    assert process.stderr is not None
    async with asyncio.timeout(60.0):
        while text not in (line := (await process.stderr.readline()).decode()):
            assert line, "it has ended"


@pytest.fixture
def missions(mission_file: Callable[..., str], tmp_path: Path) -> tuple[str, str, str]:
    """Return a mission; another one on the same ports; and another one of the same team on other ports."""
    text = Path(mission_file("case2")).read_text(encoding="utf-8")
    renamed = text.replace('name = "case2"', 'name = "survey"')
    moved = renamed
    for port in sorted({word for word in text.replace('"', ":").split(":") if word.isdecimal()}):
        moved = moved.replace(f"127.0.0.1:{port}", f"127.0.0.1:{free_ports(1)[0]}")
    paths = [tmp_path / name for name in ("flown.toml", "renamed.toml", "moved.toml")]
    for path, each in zip(paths, (text, renamed, moved), strict=True):
        path.write_text(each, encoding="utf-8")
    return str(paths[0]), str(paths[1]), str(paths[2])


async def test_a_second_run_is_refused_and_the_first_misses_no_tick(missions: tuple[str, str, str]) -> None:
    flown, renamed, moved = missions
    vehicle = load_mission(flown).vehicles[0].section
    async with cordon("fly", flown, "--sitl", "--duration", DURATION_S, "--no-log", "--json") as flight:
        await line_with(flight, "standby -> formation")
        for second in (("sitl", flown), ("sitl", renamed)):
            said = await refused(*second)
            assert f"udp port {vehicle.url.rpartition(':')[2]} receives the vehicle of another run" in said
            assert "flown.toml --sitl" in said, "it names the process that is in the way"
        said = await refused("fly", flown, "--sitl", "--no-log")
        for part in (vehicle.url, f"endpoint {vehicle.endpoint} is in use by process", "receives the vehicle"):
            assert part in said
        said = await refused("fly", moved, "--sitl", "--no-log")
        assert "flies another mission on this computer, by process" in said
        for stranger in (("command", "land"), ("target", "35", "-5"), ("watch",)):
            said = await refused(*stranger, "--mission", renamed)
            assert "'case2'" in said
            assert "'survey'" in said
        with pytest.raises(VehicleRefusedError, match="'case2', not 'survey'"):
            await CommandClient(load_mission(renamed)).command("kill", (1, 2, 3), None)
        assert flight.returncode is None, "it has to fly all the time"
        out, err = await flight.communicate()
    result = json.loads(out)
    assert result["loop"]["missed"] == 0, err.decode()
    assert {event["kind"] for event in result["events"]} <= {"tactic", "guard"}, result["events"]
    tactics = {event["text"] for event in result["events"] if event["kind"] == "tactic"}
    assert {text.partition(":")[0] for text in tactics} == {"standby -> formation", "formation -> return and land"}


async def test_stub_vehicles_and_one_flight_go_together_and_a_second_of_either_does_not(
    missions: tuple[str, str, str],
) -> None:
    flown, _, _ = missions
    async with cordon("sitl", flown) as stubs:
        await line_with(stubs, "Ctrl-C ends it")
        assert "receives the vehicle of another run" in await refused("sitl", flown)
        assert "receives the vehicle of another run" in await refused("fly", flown, "--sitl", "--no-log")
        async with cordon("fly", flown, "--speed", "1", "--no-log") as flight:
            await line_with(flight, "standby -> formation")
            assert "is in use by process" in await refused("fly", flown, "--no-log")
            answers = await CommandClient(load_mission(flown)).command("land", (1, 2, 3), None)
            assert {answer.did for answer in answers.values() if answer is not None} == {"lands"}
            await flight.communicate()
        stubs.send_signal(signal.SIGINT)
        await stubs.communicate()
        assert stubs.returncode == 0


async def test_stub_vehicles_serve_a_ground_station_that_listens_already(missions: tuple[str, str, str]) -> None:
    flown, _, _ = missions
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", int(load_mission(flown).vehicles[0].section.url.rpartition(":")[2])))
        station.settimeout(20.0)
        async with cordon("sitl", flown):
            assert (await asyncio.to_thread(station.recv, 2048))[0] in (0xFD, 0xFE), "MAVLink arrives"
