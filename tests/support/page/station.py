"""A station for tests: its server over real sockets, with pictures that a test publishes; and vehicles that answer."""

import asyncio
import http.client
import json
import re
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from http.client import HTTPMessage
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import websockets
from websockets.asyncio.client import ClientConnection

from agents.ring.commanded_ring import RingBounds
from agents.shell.zenoh_bus import single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.codec import encode
from agents.team.messages import (
    BusMessage,
    CommandAnswer,
    CommandedRing,
    MemberState,
    OperatorCommand,
    RingValues,
    StartProposal,
    VehicleReport,
)
from agents.team.participant import vehicle
from agents.team.verbs import Verb
from gcs.console.vehicle_view import VehicleView
from gcs.mission.mission import Mission
from gcs.station.access import Access, checked_access
from gcs.station.broadcast import Broadcast, Published
from gcs.station.commands import Commands
from gcs.station.picture import EventPicture, MissionPicture, OperatorRights, TeamPicture
from gcs.station.server import listen, serve_team
from gcs.station.tiles import MapTiles
from gcs.viewer.origin_gate import Address
from tests.support.wire import LOOPBACK, PATIENCE_S, free_port, until

HERE = (0.0, 0.0)


class CannedSource:
    """A source that publishes the test's pictures."""

    def __init__(self) -> None:
        self.publish: Callable[[Published], None] = lambda _picture: None
        self.runs = False
        self.recovered: list[int] = []

    def recover(self, vehicle_id: int) -> None:
        self.recovered.append(vehicle_id)

    def mission(self, operator: OperatorRights) -> MissionPicture:
        ring, bounds = RingValues(10.0, 0.05, 8.0, 0.0), RingBounds(2.0, 40.0, 2.0, 0.5, 2.0, 30.0, 1.0)
        return MissionPicture("canned", "sitl", 60.0, 10.0, None, 0.0, ring, bounds, 3.0, 2.0, None, None, (), operator)

    async def run(self, publish: Callable[[Published], None]) -> None:
        self.publish, self.runs = publish, True
        await asyncio.Event().wait()

    def team(self, time_s: float, vehicles: int = 3) -> None:
        rows = tuple(VehicleView(i + 1, 0.1, False, tactic="encircle") for i in range(vehicles))
        self.publish(TeamPicture(time_s, 1.7e9 + time_s, rows))

    def event(self, text: str) -> None:
        self.publish(EventPicture(0, None, 1.7e9, "information", text))


@dataclass
class Station:
    """A server that runs."""

    access: Access
    source: CannedSource
    commands: list[Commands] = field(default_factory=list)

    @property
    def ring_radii_m(self) -> set[float | None]:
        """The radius that the operator's session has received as commanded."""
        return {each._client.commanded_rings[0].radius_m for each in self.commands if each._client is not None}

    @property
    def tactics(self) -> dict[int, str]:
        """The tactics of the vehicles that the operator's session has received states from."""
        clients = (each._client for each in self.commands)
        return {i: tactic for client in clients if client is not None for i, tactic in client.tactics.items()}

    @property
    def port(self) -> int:
        return self.access.address.port

    def connected(self, secret: str | None = None, **headers: str) -> AbstractAsyncContextManager[ClientConnection]:
        """Connect a page that enters by the station's secret or another; headers replace its own."""
        return stream(self.port, self.access.secret if secret is None else secret, **headers)

    async def get(self, path: str, method: str = "GET", /, **headers: str) -> tuple[int, HTTPMessage, bytes]:
        """Request a file without a ticket."""
        return await asyncio.to_thread(requested, self.port, path, method, headers)

    async def get_as_page(self, path: str, method: str = "GET", /, **headers: str) -> tuple[int, HTTPMessage, bytes]:
        """Request a file by the ticket of a page that has entered."""
        async with self.connected() as page:
            return await self.get(path, method, Authorization=f"Bearer {tickets[page]}", **headers)


@asynccontextmanager
async def station(mission: Mission, page: Path, tiles: MapTiles | None = None) -> AsyncIterator[Station]:
    """Run a server of the page and of map tiles, with commands to a mission's team."""
    access = checked_access(Address(LOOPBACK, free_port()), None, None)
    source, stop, made = CannedSource(), asyncio.Event(), list[Commands]()

    def commands(broadcast: Broadcast) -> Commands:
        made.append(Commands(mission, None, broadcast.publish))
        return made[-1]

    serving = asyncio.create_task(serve_team(source, commands, access, listen(access), stop, page, tiles))
    try:
        await until(lambda: source.runs or serving.done())
        yield Station(access, source, made)
    finally:
        stop.set()
        await asyncio.wait_for(serving, PATIENCE_S)


@dataclass
class AnsweringTeam:
    """Vehicles of a mission that send their states and answer commands; what each has received is kept."""

    received: list[tuple[int, OperatorCommand]] = field(default_factory=list)
    sightings: list[tuple[int, dict[str, Any]]] = field(default_factory=list)
    tactics: dict[int, str] = field(default_factory=dict)
    ring: CommandedRing | None = None
    silent: set[int] = field(default_factory=set)
    ended: set[int] = field(default_factory=set)

    def numbers(self, verb: Verb) -> set[int]:
        """Return the numbers of the commands of this verb."""
        return {command.number for _, command in self.received if command.verb == verb}


@asynccontextmanager
async def answering_team(mission: Mission, dead: int | None = None) -> AsyncIterator[AnsweringTeam]:
    """Run a team on the bus of a mission, without vehicle `dead`."""
    team = AnsweringTeam(tactics=dict.fromkeys(mission.ids, "encircle"))
    async with AsyncExitStack() as stack:
        for vehicle_id in set(mission.ids) - {dead}:
            await stack.enter_async_context(_member(mission, vehicle_id, team))
        yield team


@asynccontextmanager
async def _member(mission: Mission, vehicle_id: int, team: AnsweringTeam) -> AsyncIterator[None]:
    own = mission.vehicle(vehicle_id).section.endpoint
    bus = single_bus(vehicle(vehicle_id), BusTeam(mission.network.team, mission.ids), own)

    def receive(message: BusMessage) -> None:
        if isinstance(message, OperatorCommand) and message.vehicle in (None, vehicle_id):
            team.received.append((vehicle_id, message))
            if vehicle_id not in team.silent | team.ended:
                answer = CommandAnswer(
                    vehicle_id, time.time(), message.number, "holds", message.verb, message.origin, "obeyed"
                )
                bus.publish("answer", encode(answer))

    async def send() -> None:
        while True:
            tactic = team.tactics[vehicle_id]
            state = MemberState(vehicle_id, time.time(), tactic, HERE, HERE, HERE, HERE, ring=team.ring)
            bus.publish("member", encode(state))
            bus.publish("start", encode(StartProposal(vehicle_id, time.time(), 0.0, mission=mission.identity)))
            ended = "landed and disarmed" if vehicle_id in team.ended else ""
            bus.publish("@report", encode(VehicleReport(vehicle_id, time.time(), "hold", ended=ended)))
            await asyncio.sleep(0.1)

    def sight(_source: str, payload: bytes) -> None:
        team.sightings.append((vehicle_id, json.loads(payload)))

    await bus.open(receive, sight, lambda _vehicle, _present: None)
    sending = asyncio.create_task(send())
    try:
        yield
    finally:
        sending.cancel()
        await bus.close()


def entered(line: str) -> tuple[int, str]:
    """Return the port and the secret in the line that `cordon station` prints."""
    found = re.search(r"http://[0-9a-f]+\.localhost:(\d+)/#(\S+)", line)
    assert found is not None, line
    return int(found[1]), found[2]


def requested(
    port: int, path: str, method: str = "GET", headers: Mapping[str, str] | None = None
) -> tuple[int, HTTPMessage, bytes]:
    """Return the status, the headers and the body of a station's answer to a request."""
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=PATIENCE_S)
    connection.request(method, path, headers=dict(headers or {}))
    answer = connection.getresponse()
    return answer.status, answer.headers, answer.read()


class RefusedPageError(Exception):
    """A station has refused a page, or has not proved to be the one that the page knows."""


tickets: "WeakKeyDictionary[ClientConnection, str]" = WeakKeyDictionary()
"""The tickets of pages that have entered."""


@asynccontextmanager
async def stream(port: int, secret: str, **headers: str) -> AsyncIterator[ClientConnection]:
    """Connect to the pictures as a page that enters by a secret; raises RefusedPageError.

    Empty headers are omitted.
    """
    name = headers.pop("Host", f"{LOOPBACK}:{port}")
    given = {key: value for key, value in ({"Origin": f"http://{LOOPBACK}:{port}"} | headers).items() if value}
    access = Access(Address(LOOPBACK, port), secret)
    try:
        async with websockets.connect(
            f"ws://{name}/stream", host=LOOPBACK, port=port, additional_headers=given, compression=None, proxy=None
        ) as page:
            await _enter(page, access)
            yield page
    except websockets.InvalidStatus as error:
        raise RefusedPageError(str(error.response.status_code)) from error


async def _enter(page: ClientConnection, access: Access) -> None:
    nonce = "a nonce"
    await page.send(json.dumps({"kind": "hello", "nonce": nonce}))
    challenge = json.loads(await page.recv())
    is_known = challenge["proof"] == access.proof("station", nonce, challenge["nonce"])
    await page.send(json.dumps({"kind": "proof", "proof": access.proof("page", nonce, challenge["nonce"])}))
    try:
        tickets[page] = json.loads(await page.recv())["ticket"]
    except websockets.ConnectionClosed as error:
        assert not is_known
        raise RefusedPageError(str(page.close_code)) from error
    assert is_known, "it lets a page enter without a proof of its own"


async def received(page: ClientConnection, kind: str, timeout_s: float = PATIENCE_S) -> dict[str, Any]:
    """Return the next message of a kind."""
    async with asyncio.timeout(timeout_s):
        while True:
            message: dict[str, Any] = json.loads(await page.recv())
            if message["kind"] == kind:
                return message


async def commanding(page: ClientConnection) -> None:
    """Wait until a page may command."""
    while not (await received(page, "mission"))["operator"]["may"]:
        pass


def asked(request: str, verb: str, vehicles: list[int] | None = None, **more: object) -> str:
    """Return a request as a page sends it."""
    return json.dumps({"kind": "command", "request": request, "verb": verb, "vehicles": vehicles, **more})
