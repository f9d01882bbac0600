"""A station for tests of the page: serves its folder and prepared pictures over a WebSocket, and keeps requests."""

import mimetypes
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec
from playwright.sync_api import Page
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from gcs.station.access import Access, Challenge, Entered, Hello, Proof, camera_origins
from gcs.station.picture import (
    AnswerPicture,
    ChecklistPicture,
    CommandRequest,
    EventPicture,
    FlightPicture,
    MissionPicture,
    ReceiptPicture,
    RecoveredRequest,
    SightingRequest,
    TeamPicture,
    TickRequest,
)
from gcs.station.server import RECORDED
from gcs.viewer.origin_gate import Address
from tests.support.paths import ROOT
from tests.support.wire import PATIENCE_S, until_now

PAGE = ROOT / "gcs" / "station" / "page"
RATE_HZ = 5.0
"""Half a station's rate: without a graphics card each picture on the map takes much processor time."""

MARK = "mark"

Live = MissionPicture | TeamPicture | EventPicture | AnswerPicture | ReceiptPicture | ChecklistPicture


class CannedStation:
    """Serves a live team, whose pictures `team` returns for the seconds since the start, or a recorded flight.

    Use it as a context manager. Tests may change `team` and `is_silent` at any time. `requests` are the requests of
    pages, of which a station that `is_slow` has received none, `sightings` their reports of the target, `recovered` the
    vehicles whose recovery they confirmed.
    """

    def __init__(
        self,
        mission: MissionPicture | None = None,
        team: Callable[[float], TeamPicture] | None = None,
        flight: FlightPicture | None = None,
        *,
        page: Path = PAGE,
        rate_hz: float = RATE_HZ,
    ) -> None:
        """Prepare to serve a page's folder on a free port of loopback, and pictures of a live team at a rate."""
        self._page, self._rate_hz = page, rate_hz
        self.begin(mission, team, flight)
        self._connections: set[ServerConnection] = set()
        self._newest: ServerConnection | None = None
        self._sent = 0
        self._sending = threading.Lock()
        self._marks = threading.Semaphore(0)
        self._stopped = threading.Event()
        # Without pings: a browser on a busy computer may answer none for so long that the connection would be closed.
        self._server: Server = serve(
            self._serve, "127.0.0.1", 0, process_request=self._answer, compression=None, ping_interval=None
        )
        self._access = Access(Address("127.0.0.1", self._server.socket.getsockname()[1]), 32 * "a")
        self._threads = [threading.Thread(target=work) for work in (self._server.serve_forever, self._publish)]

    def begin(
        self,
        mission: MissionPicture | None = None,
        team: Callable[[float], TeamPicture] | None = None,
        flight: FlightPicture | None = None,
    ) -> None:
        """Serve this from now on, as at the start."""
        self.mission, self.team, self.flight = mission, team, flight
        self.is_silent = self.is_refusing = self.is_slow = False
        self.requests: list[CommandRequest] = []
        self.sightings: list[SightingRequest] = []
        self.ticks: list[TickRequest] = []
        self.recovered: list[int] = []
        self.events: list[EventPicture] = []

    @property
    def url(self) -> str:
        """The page's address."""
        return self._access.url

    def __enter__(self) -> Self:
        """Begin to serve."""
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all connections and threads."""
        self._stopped.set()
        self.disconnect()
        self._server.shutdown()
        for thread in self._threads:
            thread.join(5.0)

    def send(self, picture: Live) -> None:
        """Send a picture to all pages."""
        if isinstance(picture, EventPicture):
            self.events.append(picture)
        for connection in tuple(self._connections):
            self._send(connection, picture)

    def await_requests(self, page: Page) -> None:
        """Wait until all that a page has sent has arrived: a mark that it sends on the same connection follows it."""
        page.evaluate(f"socket.send('{MARK}')")
        assert self._marks.acquire(timeout=PATIENCE_S)

    def await_pictures(self, page: Page) -> None:
        """Wait until all that was sent on the newest connection, that of the page, has arrived."""
        sent = self._sent
        until_now(lambda: page.evaluate("heard") >= sent, "the pictures")

    def disconnect(self) -> None:
        """Close the connections of all pages."""
        for connection in tuple(self._connections):
            connection.close()

    def _serve(self, connection: ServerConnection) -> None:
        with self._sending:
            self._newest, self._sent = connection, 0
        if not self._admits(connection):
            return
        if self.flight is not None:
            self._send_text(connection, RECORDED)
        for picture in (self.mission, self.team and self.team(0.0), *self.events):
            if picture is not None:
                self._send(connection, picture)
        self._connections.add(connection)
        with suppress(ConnectionClosed):  # of a page that is reloaded
            for message in connection:
                self._take(connection, message)
        self._connections.discard(connection)

    def _take(self, connection: ServerConnection, message: str | bytes) -> None:
        if message == MARK:
            self._marks.release()
            return
        request = msgspec.json.decode(message, type=CommandRequest | SightingRequest | RecoveredRequest | TickRequest)
        if isinstance(request, TickRequest):
            self.ticks.append(request)
            return
        if isinstance(request, RecoveredRequest):
            self.recovered.append(request.vehicle_id)
            return
        if isinstance(request, SightingRequest):
            self.sightings.append(request)
        else:
            self.requests.append(request)
        if not self.is_slow:
            self._send(connection, ReceiptPicture(request.request))

    def _publish(self) -> None:
        began_s = time.monotonic()
        while not self._stopped.wait(1.0 / self._rate_hz):
            if (team := self.team) is not None and not self.is_silent:
                self.send(team(time.monotonic() - began_s))

    def _admits(self, connection: ServerConnection) -> bool:
        with suppress(ConnectionClosed):
            page = msgspec.json.decode(connection.recv(), type=Hello).nonce
            station = "a nonce"
            self._send(connection, Challenge(station, self._access.proof("station", page, station), ""))
            given = msgspec.json.decode(connection.recv(), type=Proof).proof
            self._send(connection, Entered("a ticket"))
            return given == self._access.proof("page", page, station)
        return False

    def _send(self, connection: ServerConnection, picture: Live | Challenge | Entered) -> None:
        self._send_text(connection, msgspec.json.encode(picture).decode())

    def _send_text(self, connection: ServerConnection, text: str) -> None:
        with self._sending, suppress(ConnectionClosed):
            connection.send(text)
            self._sent += connection is self._newest

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        path = request.path.partition("?")[0]
        if path == "/stream" and not self.is_refusing:
            return None
        if path == "/flight.json" and self.flight is not None:
            return self._response(200, "application/json", msgspec.json.encode(self.flight))
        file = self._page / (path.lstrip("/") or "index.html")
        if not file.is_file():
            return self._response(404, "text/plain", b"not here")
        return self._response(200, mimetypes.guess_type(file.name)[0] or "text/plain", file.read_bytes())

    def _response(self, status: int, kind: str, body: bytes) -> Response:
        planned = [] if self.mission is None else self.mission.vehicles
        access = replace(self._access, cameras=camera_origins(each.camera_url for each in planned))
        headers = Headers({"Content-Type": kind, "Content-Length": str(len(body))})
        headers["Content-Security-Policy"] = access.content_policy
        if status == 200 and kind not in ("text/html", "application/json"):
            headers["Cache-Control"] = "max-age=3600"  # a page that is reloaded takes its scripts from the cache
        return Response(status, "", headers, body)
