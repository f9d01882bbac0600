"""Looking on while a team flies: what a viewer gets to see over the WebSocket, and that viewers disturb nobody."""

import asyncio
import json
import re
import ssl
import subprocess
import sys
import time
from asyncio.subprocess import Process
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, suppress
from math import dist
from pathlib import Path
from typing import Any

import pytest
from foxglove import Context
from foxglove.channels import PointCloudChannel
from foxglove.messages import PointCloud

from cordon.lockstep import LockstepClient
from gcs.console.command_client import CommandClient
from gcs.errors import Exit
from gcs.flight.stubs import url_ports
from gcs.mission.file import load_mission
from gcs.viewer import connections
from gcs.viewer.live_server import STOP_TIMEOUT_S, live_server
from gcs.viewer.origin_gate import Address
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.onlooker import Onlooker
from tests.support.paths import ROOT, finds_tests
from tests.support.wire import LOOPBACK, PATIENCE_S, free_port, running

pytestmark = pytest.mark.wire

SPEED = 5.0
VEHICLES = (1, 2)
MESSAGES, WATCHES = 200, 2
TOPICS = ("/scene", "/tf", "/points", *(f"/vehicle/{i}/{name}" for i in VEHICLES for name in ("decision", "pose")))


def flown(mission: str, *arguments: str) -> AbstractAsyncContextManager[Process]:
    """Fly a team of stubs in a process of its own."""
    return running("fly", mission, "--sitl", "--speed", str(SPEED), *arguments)


async def looking_at(port: int) -> Onlooker:
    """Connect as soon as somebody listens."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            with suppress(OSError):
                return await Onlooker.connected(port)
            await asyncio.sleep(0.05)


async def watch_and_be_killed(mission: str) -> None:
    """Watch the team from another terminal, and die."""
    async with running("watch", "--mission", mission) as watching:
        assert watching.stderr is not None
        while not re.search(r"vehicle \d: connected", line := (await watching.stderr.readline()).decode()):
            assert line, "it saw nobody"


@pytest.mark.long
async def test_a_viewer_sees_the_team_fly_and_others_that_hang_or_die_disturb_nobody(
    mission_file: Callable[..., str],
) -> None:
    port, path = free_port(), with_first_vehicles(mission_file("case2", LOW), len(VEHICLES))
    mission = load_mission(path)
    live = ("--live", "--live-address", f"{LOOPBACK}:{port}", "--no-log", "--json")
    async with flown(path, *live) as flight:
        viewer, hanging, dying = [await looking_at(port) for _ in range(3)]
        await asyncio.gather(*(each.subscribe(*TOPICS) for each in (viewer, hanging, dying)))
        seen: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in TOPICS}
        await viewer.message()
        # Watches come by the wall's clock.
        with LockstepClient(*url_ports(mission, mission.ids).values(), speed=1.0):
            watching = asyncio.gather(*(watch_and_be_killed(path) for _ in range(WATCHES)))
            while not (watching.done() and all(seen.values())):
                topic, time_ns, message = await viewer.message()
                seen[topic].append((time_ns, message))
        await watching
        assert flight.returncode is None, "they have to watch it in flight"
        await dying.close()
        for _ in range(MESSAGES):
            topic, time_ns, message = await viewer.message()
            seen[topic].append((time_ns, message))
        await CommandClient(mission).command("land", VEHICLES, None)
        out, err = await flight.communicate()
    result = json.loads(out)
    assert flight.returncode == Exit.ENDED_IN_FLIGHT, err.decode()
    assert {event["kind"] for event in result["events"]} <= {"tactic", "guard", "command"}, "viewers cause no event"
    changes = [event["text"] for event in result["events"] if event["kind"] == "tactic"]
    assert changes[:2] == ["standby -> formation: start"] * 2
    assert set(changes[2:]) <= {"formation -> encircle: engage", "formation -> land: land", "encircle -> land: land"}
    assert f"live: ws://{LOOPBACK}:{port} (open it in Foxglove or Lichtblick)" in err.decode()
    assert "client" not in err.decode(), "the server's words about a viewer are among those about the flight"
    assert viewer.info["capabilities"] == [], "viewers are told that they could do something"
    _agree(seen)


def _agree(seen: dict[str, list[tuple[int, Any]]]) -> None:
    """The vehicles are drawn where their own records say that they are."""
    compared = 0
    for vehicle_id in VEHICLES:
        beliefs = [each for _, each in seen[f"/vehicle/{vehicle_id}/decision"] if each.HasField("own")]
        for time_ns, scene in seen["/scene"]:
            entities = {entity.id: entity for entity in scene.entities}
            place = entities[f"vehicle {vehicle_id}"].arrows[0].pose.position
            near = min(beliefs, key=lambda each: abs(each.time_s - time_ns / 1e9), default=None)
            if near is not None and abs(near.time_s - time_ns / 1e9) < 0.1:
                compared += 1
                assert dist((place.x, place.y), near.own.mean[:2]) < 0.3
    assert compared > 10


HANGS_S = 60.0
HANGS = f"""
import asyncio, sys, time
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.onlooker import Onlooker

async def hang():
    viewer = await Onlooker.connected(int(sys.argv[1]))
    await viewer.subscribe("/points")
    await viewer.writer.drain()
    print("looking", flush=True)
    time.sleep({HANGS_S})

asyncio.run(hang())
"""


def test_whoever_writes_waits_for_no_viewer_that_hangs_and_neither_does_who_ends() -> None:
    context, address = Context(), Address(LOOPBACK, free_port())
    channel, message = PointCloudChannel("/points", context=context), PointCloud(data=bytes(20_000))
    command, pipe = [sys.executable, "-c", HANGS, str(address.port)], subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, cwd=ROOT, env=finds_tests()) as viewer:
        try:
            with live_server(address, context):
                assert viewer.stdout is not None
                assert viewer.stdout.readline() == b"looking\n"
                time.sleep(0.2)  # until the server knows of it as well
                began_s = time.monotonic()
                for k in range(5000):  # 100 MB: no socket's buffer takes that
                    channel.log(message, log_time=k)
                wrote_s = time.monotonic()
            ended_s = time.monotonic()
        finally:
            viewer.kill()
    assert wrote_s - began_s < 0.5 * HANGS_S
    assert ended_s - wrote_s < STOP_TIMEOUT_S + 0.5 * HANGS_S


async def test_a_web_page_reads_nothing_unless_its_origin_is_permitted() -> None:
    context, address = Context(), Address(LOOPBACK, free_port())
    with live_server(address, context, ["http://localhost:8080"]):
        PointCloudChannel("/points", context=context)
        for permitted in ((), ("Origin: https://app.foxglove.dev",), ("origin: http://LOCALHOST:8080",)):
            viewer = await Onlooker.connected(address.port, *permitted)
            await viewer.know("/points")
            await viewer.close()
        for page in (
            ("Origin: https://evil.example",),
            ("Origin: null",),
            ("Origin:",),
            ("Origin: https://app.foxglove.dev", "ORIGIN: https://evil.example"),
            ("Origin: https://app.foxglove.dev.evil.example",),
            ("Origin: http://localhost:8081",),
        ):
            with pytest.raises(AssertionError, match="403 Forbidden"):
                await Onlooker.connected(address.port, *page)


async def test_what_serves_behind_the_gate_speaks_to_the_gate_alone() -> None:
    address, before = Address(LOOPBACK, free_port()), set(listening_ports())
    with live_server(address, Context()):
        (port,) = set(listening_ports()) - before - {address.port}
        with pytest.raises((AssertionError, OSError, EOFError)):
            await asyncio.wait_for(Onlooker.connected(port), 5.0)
        with pytest.raises(ssl.SSLCertVerificationError):  # as a browser does
            await asyncio.open_connection(LOOPBACK, port, ssl=ssl.create_default_context())


def listening_ports() -> list[int]:
    """The TCP ports on which this process listens, by Linux's own tables."""
    links = (str(each.readlink()) for each in Path("/proc/self/fd").iterdir() if each.is_symlink())
    own = {link[8:-1] for link in links if link.startswith("socket:[")}
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return [int(row[1].rpartition(":")[2], 16) for row in rows if row[3] == "0A" and row[9] in own]


async def test_connections_that_say_nothing_or_too_much_end_by_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    context, address = Context(), Address(LOOPBACK, free_port())
    with live_server(address, context):
        PointCloudChannel("/points", context=context)
        with monkeypatch.context() as patch:
            patch.setattr(connections, "SILENT_MAX_S", 0.5)
            silent = [await asyncio.open_connection(LOOPBACK, address.port) for _ in range(100)]
            talker = await asyncio.open_connection(LOOPBACK, address.port)
            talker[1].write(b"GET / HTTP/1.1\r\n" + b"x" * 1_000_000)
            async with asyncio.timeout(PATIENCE_S):
                for reader, _ in (talker, *silent):
                    with suppress(ConnectionResetError):
                        assert await reader.read() == b""


async def test_connections_that_say_nothing_do_not_keep_viewers_out() -> None:
    context, address = Context(), Address(LOOPBACK, free_port())
    with live_server(address, context):
        PointCloudChannel("/points", context=context)
        silent = [await asyncio.open_connection(LOOPBACK, address.port) for _ in range(300)]
        viewer = await Onlooker.connected(address.port)
        await viewer.know("/points")
        await viewer.close()
        for _, writer in silent:
            writer.transport.abort()
