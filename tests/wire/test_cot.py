"""Cursor-on-Target on the wire: a second program receives the team's events, and events move the ring."""

import asyncio
import re
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from math import cos, dist, pi, radians, sin, sqrt
from typing import NamedTuple
from xml.etree.ElementTree import Element

import pytest

from gcs.cot.sightings import EventRefusal
from gcs.flight.flight import FlightOutcome
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from tests.support.cot import checked, event_bytes
from tests.support.flights import flying, in_flight, unseen_view
from tests.support.mission_text import LOW
from tests.support.wire import Served, hurried, running, served, until

pytestmark = pytest.mark.wire

SPEED = 5.0
TARGET_M_S = 0.5
RADIUS_M = 10.0
EXTERNAL = ("[target]\n", '[target]\nsource = "external"\n')
BEARING = ("x_bearing_deg = 90.0", "x_bearing_deg = 30.0")
LISTENER = """
import socket, sys
receiving = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiving.bind(("127.0.0.1", 0))
print(receiving.getsockname()[1], flush=True)
while True:
    print(receiving.recv(65536).hex(), flush=True)
"""


def degrees_of(x_m: float, y_m: float) -> tuple[float, float]:
    """Return latitude and longitude of a place in the mission, whose x is 30 degrees clockwise from north."""
    north_m, east_m = x_m * cos(pi / 6) + y_m * sin(pi / 6), x_m * sin(pi / 6) - y_m * cos(pi / 6)
    lat, e2 = radians(47.397742), (2.0 - 1.0 / 298.257223563) / 298.257223563
    across_m = 6378137.0 / sqrt(1.0 - e2 * sin(lat) ** 2)
    along_m = across_m * (1.0 - e2) / (1.0 - e2 * sin(lat) ** 2)
    return (
        47.397742 + north_m / (along_m + 488.0) * 180.0 / pi,
        8.545594 + east_m / ((across_m + 488.0) * cos(lat)) * 180.0 / pi,
    )


class SecondProgram:
    """A process that receives datagrams; `events` are the newest of each uid, all checked by the schema."""

    def __init__(self, process: asyncio.subprocess.Process, port: int) -> None:
        self.port = port
        self.events: dict[str, Element] = {}
        self._process = process

    async def listen(self) -> None:
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            event = checked(bytes.fromhex(line.decode()))
            self.events[re.sub(r"cordon-.*-(?=vehicle|target|ring)", "", event.get("uid", ""))] = event

    def place_deg(self, uid: str) -> tuple[float, float]:
        point = self.events[uid].find("point")
        assert point is not None
        return float(point.get("lat", "")), float(point.get("lon", ""))


@asynccontextmanager
async def second_program() -> AsyncIterator[SecondProgram]:
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", LISTENER, stdout=asyncio.subprocess.PIPE)
    assert process.stdout is not None
    program = SecondProgram(process, int(await process.stdout.readline()))
    listening = asyncio.create_task(program.listen())
    try:
        yield program
        assert not listening.done() or listening.result() is None, "an event is not as the schema says"
    finally:
        listening.cancel()
        process.kill()
        await process.wait()


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


class Handheld:
    """A device that sees the target and sends its events, from `begun_m` to `goal_m` at 0.5 m/s of the flight."""

    def __init__(self, port: int, stubs: Served, begun_m: tuple[float, float]) -> None:
        self._port, self._stubs = port, stubs
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.place_m = self.goal_m = begun_m

    def send(self, payload: bytes) -> None:
        with suppress(ConnectionRefusedError):
            self._socket.sendto(payload, ("127.0.0.1", self._port))

    async def run(self) -> None:
        before_s = self._stubs.clock.now_s()
        while True:
            now_s = self._stubs.clock.now_s()
            (x, y), (x_goal, y_goal) = self.place_m, self.goal_m
            share = min(1.0, TARGET_M_S * (now_s - before_s) / max(dist(self.place_m, self.goal_m), 1e-9))
            self.place_m, before_s = (x + share * (x_goal - x), y + share * (y_goal - y)), now_s
            self.send(event_bytes(*degrees_of(*self.place_m), time.time()))
            await asyncio.sleep(0.05)


class TrackedFlight(NamedTuple):
    """A flight of three stubs in formation, whose target only sensors outside see."""

    path: str
    stubs: Served
    task: asyncio.Task[FlightOutcome]

    async def until(self, condition: Callable[[], bool], waiting_for: str) -> None:
        await in_flight(self.task, condition, waiting_for, self.stubs.clock)

    def circles(self, place_m: tuple[float, float]) -> bool:
        """Return whether the vehicles truly are on a ring of the mission's radius about a place."""
        places_m = [stub.airframe.position_m[:2] for stub in self.stubs.vehicles.values()]
        return all(abs(dist(each, place_m) - RADIUS_M) < 0.5 for each in places_m)


@pytest.fixture
async def tracked(mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[TrackedFlight]:
    path = mission_file("case2", LOW, ('name = "case2"', 'name = "tracked"'), EXTERNAL, BEARING)
    mission, view, tactics = load_mission(path), unseen_view(), dict[int, str]()
    monkeypatch.setattr(view, "update", lambda rows, *_: tactics.update({row.vehicle_id: row.tactic for row in rows}))
    async with served(stub_configs(mission), SPEED) as stubs:
        plan = FlightPlan(mission, 600.0, mission.vehicles, speed=None, clock=stubs.clock.name)
        async with flying(plan, view) as task:
            flight = TrackedFlight(path, stubs, task)
            with hurried(stubs.clock):
                await flight.until(lambda: list(tactics.values()) == ["formation"] * 3, "formation")
            yield flight


async def test_events_show_the_team_and_move_its_ring(tracked: TrackedFlight, subtests: pytest.Subtests) -> None:
    """What is no event of the target does not move it, and is counted; the gateway ends, the flight goes on."""
    begun_m, moved_m, port = (8.0, 0.0), (14.0, -5.0), free_udp_port()
    handheld = Handheld(port, tracked.stubs, begun_m)
    async with second_program() as program:
        addresses = ("--to", f"udp://127.0.0.1:{program.port}", "--from", f"udp://127.0.0.1:{port}")
        async with running("cot", tracked.path, *addresses, "--track", "BOAT") as gateway:
            vehicles = {f"vehicle-{number}" for number in (1, 2, 3)}
            await until(
                lambda: gateway.returncode is not None or vehicles <= program.events.keys(), waiting_for="the vehicles"
            )
            assert gateway.returncode is None, (await gateway.communicate())[1].decode()
            with subtests.test("vehicles are where they are"):
                for number, stub in tracked.stubs.vehicles.items():
                    x_m, y_m, _ = stub.airframe.position_m
                    assert program.place_deg(f"vehicle-{number}") == pytest.approx(degrees_of(x_m, y_m), abs=5e-5)
            seeing = asyncio.create_task(handheld.run())
            with subtests.test("the team encircles what the device sees"):
                await tracked.until(lambda: tracked.circles(begun_m), "a ring")
            with subtests.test("the ring follows it"):
                handheld.goal_m = moved_m
                await tracked.until(lambda: tracked.circles(moved_m), "the ring to follow")
            with subtests.test("target and ring are shown about it"):
                await tracked.until(lambda: {"target", "ring"} <= program.events.keys(), "target and ring")
                begin_s = tracked.stubs.clock.now_s()
                await tracked.until(lambda: tracked.stubs.clock.now_s() > begin_s + 15.0, "new events")
                for name in ("target", "ring"):
                    assert program.place_deg(name) == pytest.approx(degrees_of(*moved_m), abs=1e-5), "a metre"
                ellipse = program.events["ring"].find("detail/shape/ellipse")
                assert ellipse is not None
                assert float(ellipse.get("major", "")) == RADIUS_M
            with subtests.test("what is no event of the target changes nothing"):
                far_deg = degrees_of(60.0, 60.0)
                handheld.send(b"<event")
                handheld.send(b"<event")
                handheld.send(event_bytes(*far_deg, time.time(), uid="car-1", callsign="CAR"))
                handheld.send(event_bytes(*far_deg, time.time() - 100.0))
                begin_s = tracked.stubs.clock.now_s()
                await tracked.until(lambda: tracked.stubs.clock.now_s() > begin_s + 10.0, "10 s")
                assert tracked.circles(moved_m)
            seeing.cancel()
            gateway.send_signal(signal.SIGINT)
            _, output = await gateway.communicate()
            assert gateway.returncode == 0
            lines = output.decode().splitlines()
            with subtests.test("each is counted by its reason, and told once"):
                assert f"2: {EventRefusal.MALFORMED.value}" in lines[-1]
                assert re.search(rf"\b[1-9]\d*: {EventRefusal.STALE.value}", lines[-1])
                assert "1 events of others" in lines[-1]
                assert sum(EventRefusal.MALFORMED.value in line for line in lines[:-1]) == 1
    assert not tracked.task.done()
