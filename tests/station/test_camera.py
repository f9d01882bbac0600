"""Cameras' streams on the page, from a server that sends pictures as cameras on a network do (MJPEG over HTTP)."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from msgspec.structs import replace
from playwright.sync_api import Page, expect

from gcs.station.picture import MissionPicture
from tests.station.conftest import NO_WEBGL, OpenPage
from tests.support.page.canned_station import CannedStation
from tests.support.page.map_tiles import png
from tests.support.page.station_pictures import ring_mission, ring_team
from tests.support.wire import until_now

pytestmark = pytest.mark.browser
SCRIPT = NO_WEBGL
SIDE_PX = 48


class Camera(ThreadingHTTPServer):
    """A camera at `/video`; `watching` counts those that receive its pictures."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Stream)
        self.watching = 0

    @property
    def url(self) -> str:
        """The address of its stream."""
        return f"http://127.0.0.1:{self.server_port}/video"


class _Stream(BaseHTTPRequestHandler):
    server: Camera

    def do_GET(self) -> None:
        if self.path != "/video":
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
        self.end_headers()
        self.server.watching += 1
        try:
            while True:
                picture = png((200, 60, 20), SIDE_PX)
                head = f"--next\r\nContent-Type: image/png\r\nContent-Length: {len(picture)}\r\n\r\n"
                self.wfile.write(head.encode() + picture + b"\r\n")
                threading.Event().wait(0.05)
        except OSError:
            self.server.watching -= 1

    def log_message(self, *_: object) -> None: ...


@contextmanager
def camera() -> Iterator[Camera]:
    with Camera() as served:
        threading.Thread(target=served.serve_forever, daemon=True).start()
        yield served
        served.shutdown()


def with_cameras(*addresses: str) -> MissionPicture:
    """Return the mission with streams of its first vehicles."""
    mission = ring_mission()
    first = [replace(each, camera_url=url) for each, url in zip(mission.vehicles, addresses, strict=False)]
    return replace(mission, vehicles=(*first, *mission.vehicles[len(first) :]))


def opened(page: Page, vehicle_id: int) -> Page:
    page.get_by_text(f"Picture of vehicle {vehicle_id}").click()
    return page


def test_a_stream_over_http_is_shown_as_a_picture_while_it_is_open(open_page: OpenPage) -> None:
    with camera() as served:
        mission = with_cameras(served.url, "rtsp://127.0.0.1:554/main", f"{served.url}s")
        with CannedStation(mission, lambda _: ring_team(mission, 100.0)) as station:
            page = open_page(station.url)
            expect(page.get_by_role("link", name="Camera of vehicle 2")).to_have_attribute(
                "href", "rtsp://127.0.0.1:554/main"
            )
            expect(page.get_by_text("Picture of vehicle 2")).to_have_count(0)
            assert served.watching == 0
            picture = opened(page, 1).get_by_role("img", name="What the camera of vehicle 1 sees")
            until_now(lambda: served.watching == 1, "the stream")
            until_now(lambda: picture.evaluate("image => image.naturalWidth") == SIDE_PX, "the picture")
            box = picture.bounding_box()
            assert box is not None
            assert box["width"] == box["height"] > SIDE_PX
            opened(page, 1)
            until_now(lambda: served.watching == 0, "the end of the stream")
            expect(opened(page, 3).get_by_text("shows no picture of the stream")).to_be_visible()
