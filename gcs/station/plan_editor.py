"""The operator's page as an editor of a mission's fence and no-fly zones, before a flight."""

import asyncio
import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from gcs.errors import InputError
from gcs.mission.area_text import with_areas
from gcs.mission.file import load_mission, parse_mission
from gcs.mission.mission import Mission
from gcs.station.access import Access
from gcs.station.picture import OperatorRights, PlanAnswer, PlanPicture, PlanRequest, ZonePicture, mission_picture
from gcs.station.server import PAGE, app_of, serve
from gcs.station.tiles import MapTiles
from gcs.viewer.connections import ListeningSocket

REQUEST_MAX_BYTES = 1_000_000
_MALFORMED = 1007


class PlanEditor:
    """Shows one mission file to pages, and takes fences and zones from them."""

    def __init__(self, path: Path, tiles: MapTiles | None = None) -> None:
        """Take the mission's file; raises InputError for one that is not valid or not a file of the user's."""
        self._path, self._tiles = path, tiles
        self.mission = load_mission(str(path))
        if not path.is_file() or not os.access(path, os.W_OK):
            raise InputError([f"--edit: {path}: not a file that can be written; `cordon new` writes one"])

    def take(self, request: PlanRequest) -> PlanAnswer:
        """Check a fence and zones, and save them if that is asked for and they have no faults."""
        try:
            text = with_areas(
                self._path.read_text(encoding="utf-8-sig"), request.fence_m, list(map(_keys, request.zones))
            )
            mission = parse_mission(text, self._path.parent)
            if request.save:
                self._write(text)
                self.mission = mission
        except InputError as error:
            return PlanAnswer(request.request, tuple(error.faults), is_saved=False)
        except OSError as error:
            return PlanAnswer(request.request, (f"{self._path}: {error.strerror or error}",), is_saved=False)
        return PlanAnswer(request.request, (), is_saved=request.save)

    async def serve_page(self, page: WebSocket) -> None:
        """Serve one page until it disconnects."""
        await page.accept()
        with suppress(WebSocketDisconnect, RuntimeError):
            await _send(page, self._mission_picture())
            await _send(page, plan_picture(self.mission, self._path.name))
            while (message := await page.receive())["type"] != "websocket.disconnect":
                try:
                    request = msgspec.json.decode(message.get("text") or "", type=PlanRequest)
                except (msgspec.DecodeError, RecursionError) as error:
                    await page.close(_MALFORMED, str(error)[:100])
                    return
                await _send(page, await asyncio.to_thread(self.take, request))

    async def serve(self, access: Access, listening: Sequence[ListeningSocket], stop: asyncio.Event) -> None:
        """Serve pages until `stop`."""
        app = app_of([WebSocketRoute("/stream", self.serve_page)], self._tiles)
        await serve(app, access, listening, stop, PAGE, request_max_bytes=REQUEST_MAX_BYTES)

    def _mission_picture(self) -> msgspec.Struct:
        rights = OperatorRights(read_only="it edits the mission")
        picture = mission_picture(self.mission, "plan", self.mission.mission.duration_s, rights)
        return picture if self._tiles is None else msgspec.structs.replace(picture, tiles=self._tiles.picture)

    def _write(self, text: str) -> None:
        beside = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        beside.write_text(text, encoding="utf-8")
        shutil.copymode(self._path, beside)
        beside.replace(self._path)


def plan_picture(mission: Mission, file: str) -> PlanPicture:
    """Return the fence and the zones of a mission, to be edited."""
    picture = mission_picture(mission, "plan", 0.0)
    return PlanPicture(file, tuple(mission.safety.fence_m), picture.zones)


def _keys(zone: ZonePicture) -> dict[str, Any]:
    """Return a zone as a table of a mission file."""
    keys = {name: value for name, value in msgspec.structs.asdict(zone).items() if value not in (None, ())}
    if "polygon_m" in keys:
        keys["polygon_m"] = [list(corner) for corner in zone.polygon_m]
    if zone.center_m is not None:
        keys["center_m"] = list(zone.center_m)
    return keys


async def _send(page: WebSocket, picture: msgspec.Struct) -> None:
    await page.send_text(msgspec.json.encode(picture).decode())
