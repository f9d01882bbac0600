"""The server of the operator's page: its files, the stream of pictures and commands, and recorded flights.

A page that is slow, dead or sends invalid data does not affect other pages.
"""

import asyncio
import gzip
import re
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
import uvicorn
from msgspec.structs import replace
from starlette.applications import Starlette
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from agents.ports import VehicleRefusedError
from gcs.checklist import Checklist
from gcs.station.access import Access, AccessGate
from gcs.station.broadcast import Broadcast, Reading, Source
from gcs.station.checklist_board import ChecklistBoard
from gcs.station.commands import Commands
from gcs.station.picture import (
    CommandRequest,
    FlightPicture,
    MissionPicture,
    OperatorRights,
    ReceiptPicture,
    RecoveredRequest,
    SightingRequest,
    TickRequest,
)
from gcs.station.tiles import MapTiles
from gcs.viewer.connections import ConnectionLimits, ListeningSocket, listening_sockets

PAGE = Path(__file__).parent / "page"
PAGES_MAX = 100
REQUEST_MAX_BYTES = 4096
_DEAD_AFTER_S = 10
"""A page that reads nothing for this time is removed."""
_PING_PERIOD_S = 5.0
WAITING_MAX_BYTES = 8192
"""What may wait to be sent on a connection, once in this process and once in the kernel."""
LEFT_AFTER_S = 30.0
"""A station that outlives its flight ends when no page has been open for this long."""
RECORDED = '{"kind":"recorded"}'
"""The only message about a recorded flight."""
_Request = CommandRequest | SightingRequest | RecoveredRequest | TickRequest
_MALFORMED, _TOO_MANY = 1007, 1013
_TILE_PLACE = re.compile("([0-9]{1,2})/([0-9]{1,8})/([0-9]{1,8})")


class Stream:
    """The WebSocket of live pages: pictures, events and answers out, requests of commands in."""

    def __init__(
        self,
        broadcast: Broadcast,
        commands: Commands,
        recover: Callable[[int], object] = lambda _vehicle_id: None,
        tick: Callable[[TickRequest], object] = lambda _tick: None,
    ) -> None:
        """Take the content for pages, and the receivers of their requests, of confirmed recoveries, and of ticks."""
        self._broadcast = broadcast
        self._commands = commands
        self._recover = recover
        self._tick = tick
        self.pages = 0
        """Number of open pages."""

    async def serve(self, page: WebSocket) -> None:
        """Serve one page until it disconnects."""
        if self.pages >= PAGES_MAX:
            await page.close(_TOO_MANY, f"{PAGES_MAX} pages are open already")
            return
        await page.accept()
        self.pages += 1
        reading = Reading()
        ways = [asyncio.create_task(self._show(page, reading)), asyncio.create_task(self._listen(page, reading))]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.pages -= 1
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)

    async def _show(self, page: WebSocket, reading: Reading) -> None:
        with suppress(WebSocketDisconnect):
            while True:
                for text in await self._broadcast.news(reading):
                    await page.send_text(text)

    async def _listen(self, page: WebSocket, reading: Reading) -> None:
        while (message := await page.receive())["type"] != "websocket.disconnect":
            try:
                request = msgspec.json.decode(message.get("text") or "", type=_Request)
            except (msgspec.DecodeError, RecursionError) as error:  # a msgspec.ValidationError is one
                with suppress(WebSocketDisconnect, RuntimeError):  # the page has disconnected meanwhile
                    await page.close(_MALFORMED, str(error)[:100])
                return
            if isinstance(request, RecoveredRequest):
                self._recover(request.vehicle_id)
            elif isinstance(request, TickRequest):
                self._tick(request)
            else:
                self._broadcast.answer(reading, ReceiptPicture(request.request))
                self._commands.take(request, lambda answer: self._broadcast.answer(reading, answer))


def live_app(stream: Stream, tiles: MapTiles | None = None) -> ASGIApp:
    """Return what pages of a running team receive once they have entered."""
    return _app([WebSocketRoute("/stream", stream.serve)], tiles)


def recorded_app(flight: FlightPicture, tiles: MapTiles | None = None) -> ASGIApp:
    """Return what pages of a recorded flight receive once they have entered."""
    shown = replace(flight, mission=_with_tiles(flight.mission, tiles))
    packed = gzip.compress(msgspec.json.encode(shown), compresslevel=6)
    headers = {"Content-Encoding": "gzip", "Cache-Control": "no-store"}

    async def recorded(_request: Request) -> Response:
        return Response(packed, media_type="application/json", headers=headers)

    return _app([Route("/flight.json", recorded), WebSocketRoute("/stream", _hold_open)], tiles)


async def _hold_open(page: WebSocket) -> None:
    """Refer a page to the recorded flight, which its ticket lets it request until it disconnects."""
    await page.accept()
    await page.send_text(RECORDED)
    while (await page.receive())["type"] != "websocket.disconnect":
        pass


def _app(data: Sequence[BaseRoute], tiles: MapTiles | None) -> Starlette:
    return Starlette(routes=[*data, *([] if tiles is None else [_tiles_route(tiles)])])


def _files(page: Path) -> ASGIApp:
    """Return the files of the page, the same for everybody."""
    files = GZipMiddleware(StaticFiles(directory=page, html=True, check_dir=False), compresslevel=4)
    return Starlette(routes=[Mount("/", files)])


def _tiles_route(tiles: MapTiles) -> Route:
    """Return the route of map tiles; the path is three numbers."""

    def tile(request: Request) -> Response:  # not async: in a thread, so that a slow disk does not hold up the stream
        place = _TILE_PLACE.fullmatch(request.path_params["place"])
        image = None if place is None else tiles.tile(*map(int, place.groups()))
        if image is None:
            return PlainTextResponse("no such tile", 404)
        return Response(image.data, media_type=image.media_type)

    return Route("/tiles/{place:path}", tile)


def _with_tiles(mission: MissionPicture, tiles: MapTiles | None) -> MissionPicture:
    return mission if tiles is None else replace(mission, tiles=tiles.picture)


_NO_CHECKLIST = Checklist("", ())


async def serve_team(
    source: Source,
    commands: Callable[[Broadcast], Commands],
    access: Access,
    listening: Sequence[ListeningSocket],
    stop: asyncio.Event,
    page: Path = PAGE,
    tiles: MapTiles | None = None,
    outlives: Callable[[], bool] = lambda: False,
    checklist: Checklist = _NO_CHECKLIST,
) -> None:
    """Serve the pages of a running team until `stop`; raises InputError when the source does.

    While `outlives()` the flight that started the station is over: the station ends when its pages have been left.
    """
    broadcast = Broadcast()
    ours = commands(broadcast)
    board = ChecklistBoard(checklist, lambda: ours.name)
    stream = Stream(broadcast, ours, source.recover, lambda given: board.tick(given.item, ticked=given.ticked))

    def publish(rights: OperatorRights) -> None:
        broadcast.publish(_with_tiles(source.mission(rights), tiles))

    serving = asyncio.create_task(serve(live_app(stream, tiles), access, listening, stop, page))
    running = [
        asyncio.create_task(source.run(broadcast.publish)),
        asyncio.create_task(ours.run(publish)),
        asyncio.create_task(board.run(broadcast.publish)),
        serving,
        asyncio.create_task(_left(stream, outlives)),
    ]
    try:
        done, _ = await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        stop.set()
        for task in running:
            if task is not serving:
                task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


async def _left(stream: Stream, outlives: Callable[[], bool]) -> None:
    """Return when no page has been open for a while after the end of the flight."""
    read_s = time.monotonic()
    while time.monotonic() - read_s < LEFT_AFTER_S:
        if stream.pages or not outlives():
            read_s = time.monotonic()
        await asyncio.sleep(1.0)


class _PromptSocket(WebSocketsSansIOProtocol):
    """A WebSocket that holds back little: on a slow link what waits is replaced by newer pictures, not sent late."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport of a connection."""
        super().connection_made(transport)
        if isinstance(transport, asyncio.WriteTransport):
            transport.set_write_buffer_limits(high=WAITING_MAX_BYTES)


async def serve(
    app: ASGIApp, access: Access, listening: Sequence[ListeningSocket], stop: asyncio.Event, page: Path = PAGE
) -> None:
    """Serve the files of the page, and an application to pages that have entered, until `stop` disconnects them."""
    certificate, key = access.tls or (None, None)
    config = uvicorn.Config(
        AccessGate(app, _files(page), access, listening[0].limits),
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        ws=_PromptSocket,
        ws_max_size=REQUEST_MAX_BYTES,
        ws_ping_interval=_PING_PERIOD_S,
        ws_ping_timeout=_DEAD_AFTER_S,
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )
    server = uvicorn.Server(config)
    serving = asyncio.create_task(server.serve(list(listening)))
    stopped = asyncio.create_task(stop.wait())
    await asyncio.wait([serving, stopped], return_when=asyncio.FIRST_COMPLETED)
    stopped.cancel()
    server.should_exit = server.force_exit = True
    await serving


def listen(access: Access) -> list[ListeningSocket]:
    """Return listening sockets; raises VehicleRefusedError when the address is not available."""
    try:
        listening = listening_sockets(ConnectionLimits(), access.hosts, access.address.port)
    except OSError as error:
        raise _unavailable(access, error) from error
    for name, value in (("TCP_USER_TIMEOUT", _DEAD_AFTER_S * 1000), ("TCP_NOTSENT_LOWAT", WAITING_MAX_BYTES)):
        if hasattr(socket, name):  # connections inherit it
            for each in listening:
                each.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
    return listening


def _unavailable(access: Access, error: OSError) -> VehicleRefusedError:
    return VehicleRefusedError(
        f"cannot listen at {access.address.host}:{access.address.port} ({error.strerror or error})",
        "end the program that uses the port (another station?), or choose another port with --address HOST:PORT",
    )
