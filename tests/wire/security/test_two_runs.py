"""Two runs on one computer: the second is refused before it starts anything, and the first flies on."""

import asyncio
import json
import os
import re
import signal
import socket
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from agents.ports import VehicleRefusedError
from agents.shell.zenoh_bus import single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.codec import encode
from agents.team.messages import BusMessage, OperatorCommand, StartProposal
from agents.team.participant import vehicle
from agents.team.perception import ExternalSighting
from gcs.console.command_client import CommandClient
from gcs.console.watch import WatchView, watch
from gcs.link.ports import fed_ports, flight_claims, free_ports, stub_claims
from gcs.mission.file import enlarged_mission, load_mission, parse_mission
from tests.support.mission_text import INSECURE, LOW
from tests.support.paths import ROOT
from tests.support.wire import PATIENCE_S, running

pytestmark = pytest.mark.wire

MISSED_SHARE_MAX = 0.01
"""Of the ticks of the first flight: the other runs take processor time to start and to be refused."""


async def refused(*arguments: str) -> str:
    """Run a command that is to be refused, and return what it says."""
    async with asyncio.timeout(PATIENCE_S), running(*arguments) as process:
        out, err = await process.communicate()
    assert (process.returncode, out) == (3, b""), (arguments, process.returncode, err.decode())
    assert "Traceback" not in err.decode()
    return " ".join(err.decode().split())


async def line_with(process: Process, text: str) -> None:
    assert process.stderr is not None
    async with asyncio.timeout(PATIENCE_S):
        while text not in (line := (await process.stderr.readline()).decode()):
            assert line, "it has ended"


@pytest.fixture
def missions(mission_file: Callable[..., str], tmp_path: Path) -> tuple[str, str, str]:
    """Return a mission; another one on the same ports; and another one of the same team on other ports."""
    text = Path(mission_file("case2", LOW)).read_text(encoding="utf-8")
    renamed = text.replace('name = "case2"', 'name = "survey"')
    moved = renamed
    for port in sorted({word for word in text.replace('"', ":").split(":") if word.isdecimal()}):
        moved = moved.replace(f"127.0.0.1:{port}", f"127.0.0.1:{free_ports(1)[0]}")
    paths = [tmp_path / name for name in ("flown.toml", "renamed.toml", "moved.toml")]
    for path, each in zip(paths, (text, renamed, moved), strict=True):
        path.write_text(each, encoding="utf-8")
    return str(paths[0]), str(paths[1]), str(paths[2])


async def test_a_second_run_is_refused_and_the_first_flies_on(missions: tuple[str, str, str]) -> None:
    flown, renamed, moved = map(load_mission, missions)
    section = flown.vehicles[0].section
    fed = f"udp port {section.url.rpartition(':')[2]} receives the vehicle of another run, by process "
    async with running("sitl", missions[0], "--lockstep", "--speed", "4") as stubs:
        await line_with(stubs, "Ctrl-C ends it")
        async with running("fly", missions[0], "--no-log", "--json") as flight:
            await line_with(flight, "standby -> formation")
            serving, said = await asyncio.gather(
                refused("sitl", missions[1]), refused("fly", missions[0], "--sitl", "--no-log")
            )
            assert fed in serving, serving
            for part in (section.url, f"endpoint {section.endpoint} is in use by", fed):
                assert part in said, said
            with pytest.raises(VehicleRefusedError, match="flies another mission on this computer, by process"):
                flight_claims(moved, moved.ids).__enter__()
            sighting = ExternalSighting("mission", (35.0, -5.0), (1.0, 0.0, 1.0), 0.8, 0.2)
            for stranger in (
                CommandClient(renamed).command("kill", renamed.ids, None),
                CommandClient(renamed).send_sighting(sighting, 0.0),
                watch(renamed, WatchView(Console(file=StringIO())), asyncio.Event()),
            ):
                with pytest.raises(VehicleRefusedError, match="'case2', not 'survey'"):
                    await stranger
            assert flight.returncode is None, "it has to fly all the time"
            answers = await CommandClient(flown).command("land", flown.ids, None)
            assert {answer.did for answer in answers.values() if answer is not None} == {"lands"}
            out, err = await flight.communicate()
        stubs.send_signal(signal.SIGINT)
        await stubs.communicate()
        assert stubs.returncode == 0
    result = json.loads(out)
    assert result["loop"]["missed"] <= MISSED_SHARE_MAX * result["loop"]["ticks"], err.decode()
    tactics = {event["text"].partition(":")[0] for event in result["events"] if event["kind"] == "tactic"}
    assert tactics == {"standby -> formation", "formation -> land"}


SQUATTER = """
import os, socket, sys
os.setuid(12345)
taken = [socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in sys.argv[1:]]
for each, name in zip(taken, sys.argv[1:]):
    each.bind(chr(0) + name)
port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
print("taken", flush=True)
port.bind(("127.0.0.1", int(sys.stdin.readline())))
print("bound", flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may become another user")
async def test_sockets_of_another_user_refuse_no_run(missions: tuple[str, str, str]) -> None:
    mission = load_mission(missions[0])
    team, ports = mission.network.team, fed_ports(mission.vehicles)
    names = [
        f"cordon/flight/{team}/0123/1/00",
        f"cordon/flight/{team}/4567/x\n",
        *(f"cordon/fed/udp/{p}" for p in ports),
    ]
    squatter = await asyncio.create_subprocess_exec(sys.executable, "-c", SQUATTER, *names, stdin=PIPE, stdout=PIPE)
    try:
        assert squatter.stdout is not None
        assert await squatter.stdout.readline() == b"taken\n"
        with flight_claims(mission, mission.ids):
            pass
        with stub_claims(ports):
            pass
        assert squatter.stdin is not None
        squatter.stdin.write(b"%d\n" % ports[0])
        assert await squatter.stdout.readline() == b"bound\n"
        with (
            pytest.raises(VehicleRefusedError, match=f"udp port {ports[0]} of .* is in use"),
            flight_claims(mission, mission.ids),
        ):
            pass
    finally:
        squatter.kill()
        await squatter.communicate()


async def test_stubs_serve_a_station_that_listens_already_and_claims_of_a_killed_run_count_for_nothing(
    missions: tuple[str, str, str],
) -> None:
    mission = load_mission(missions[0])
    *_, port = fed_ports(mission.vehicles)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", port))
        station.settimeout(PATIENCE_S)
        async with running("sitl", missions[0]) as stubs:
            await line_with(stubs, "Ctrl-C ends it")
            assert (await asyncio.to_thread(station.recv, 2048))[0] in (0xFD, 0xFE), "MAVLink arrives"
            with (
                pytest.raises(VehicleRefusedError, match=f"by process {stubs.pid} "),
                flight_claims(mission, mission.ids),
            ):
                pass
            stubs.kill()
            await stubs.communicate()
    with flight_claims(mission, mission.ids):
        pass


def test_a_vehicle_that_joins_a_flight_is_pointed_to_its_own_options(missions: tuple[str, str, str]) -> None:
    mission, other = (load_mission(missions[0], {"mission.rate_hz": rate_hz}) for rate_hz in (10.0, 20.0))
    start_m = min(each.section.start_m[0] for each in mission.vehicles) - 50.0, 0.0
    keys = {"id": 9, "start_m": start_m, "altitude_m": mission.vehicles[-1].section.altitude_m}
    [port] = free_ports(1)
    joining = enlarged_mission(mission, keys | {"url": f"udpin://127.0.0.1:{port}"})
    for claimed, options in (
        (stub_claims([port]), ("--url", "--endpoint")),
        (flight_claims(other, ()), ("--set",)),
    ):
        with claimed, pytest.raises(VehicleRefusedError) as refusal, flight_claims(joining, (9,)):
            pass
        assert all(option in refusal.value.next_step for option in options), refusal.value.next_step
        assert ("--set" in refusal.value.next_step) is ("--set" in options)


def test_a_folder_of_claims_that_cannot_be_written_is_named(
    missions: tuple[str, str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    (port, *_) = fed_ports(load_mission(missions[0]).vehicles)
    with stub_claims([port]):
        (claim,) = runtime.glob(f"cordon/.claims-*/fed.udp.{port}")
    assert not claim.exists()
    claim.mkdir()
    with pytest.raises(VehicleRefusedError, match=re.escape(str(claim.parent))), stub_claims([port]):
        pass


async def test_processes_that_were_given_other_values_do_not_fly_together(missions: tuple[str, str, str]) -> None:
    flown = load_mission(missions[0])
    with flight_claims(flown, flown.ids[:1]):
        said = await refused("fly", missions[0], "--only", "2", "--no-log", "--set", "mission.rate_hz=20")
    assert "flies another mission" in said


async def test_the_same_mission_changed_since_is_commanded_down_but_not_on(missions: tuple[str, str, str]) -> None:
    flown = parse_mission(load_mission(missions[0]).text.replace(*INSECURE), None)
    changed = parse_mission(flown.text.replace("separation_m = ", "keep_out_m = 1.0\nseparation_m = "), None)
    assert changed.identity != flown.identity
    bus = single_bus(vehicle(1), BusTeam(flown.network.team, flown.ids), flown.vehicle(1).section.endpoint)
    await bus.open(lambda *_: None, lambda *_: None, lambda *_: None)

    async def fly() -> None:
        while True:
            bus.publish("start", encode(StartProposal(1, time.time(), None, mission=flown.identity)))
            await asyncio.sleep(0.1)

    flying = asyncio.create_task(fly())
    try:
        with pytest.raises(VehicleRefusedError, match="another version of the mission 'case2'"):
            await CommandClient(changed).command("resume", (1,), 1)
        operator = CommandClient(changed)
        assert await operator.command("hold", (1,), 1) == {1: None}, "sent, and this vehicle never answers"
        assert "another version" in operator.difference
    finally:
        flying.cancel()
        await bus.close()


async def test_a_kill_is_not_refused_for_what_one_vehicle_tells(missions: tuple[str, str, str]) -> None:
    """Vehicle 2 is all that the operator receives, tells of another mission, and its clock is off by a century."""
    text = load_mission(missions[0]).text.replace(*INSECURE)
    flown, other = parse_mission(text, None), parse_mission(text.replace('name = "case2"', 'name = "survey"'), None)
    buses = [
        single_bus(vehicle(i), BusTeam(flown.network.team, flown.ids), flown.vehicle(i).section.endpoint)
        for i in (1, 2)
    ]
    received = asyncio.Queue[BusMessage]()
    await buses[0].open(received.put_nowait, lambda *_: None, lambda *_: None)
    await buses[1].open(lambda *_: None, lambda *_: None, lambda *_: None)

    async def lie() -> None:
        while True:
            buses[1].publish("start", encode(StartProposal(2, time.time() + 3e9, None, mission=other.identity)))
            await asyncio.sleep(0.01)

    lying = asyncio.create_task(lie())
    operator = CommandClient(flown)
    commanding = asyncio.create_task(operator.command("kill", flown.ids, None))
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not isinstance(await received.get(), OperatorCommand):
                pass
        assert operator.difference == "vehicle 2 reports 'survey', not 'case2'"
        with pytest.raises(VehicleRefusedError, match="'survey', not 'case2'"):
            await CommandClient(flown).command("resume", flown.ids, None)
    finally:
        lying.cancel()
        commanding.cancel()
        await asyncio.gather(*(bus.close() for bus in buses))


async def test_free_ports_of_two_processes_differ_and_no_connection_takes_them_meanwhile() -> None:
    command = (
        sys.executable,
        "-c",
        "from gcs.link.ports import free_ports; print(*free_ports(100), flush=True); input()",
    )
    runs = [await asyncio.create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE, cwd=ROOT) for _ in range(2)]
    told = [[int(port) for port in (await run.stdout.readline()).split()] for run in runs if run.stdout is not None]
    for run in runs:
        await run.communicate(b"\n")
    ephemeral_from = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text(encoding="ascii").split()[0])
    assert len({*told[0], *told[1]}) == 200
    assert max(map(max, told)) < ephemeral_from
