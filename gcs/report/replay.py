"""The replay in a report: the operator's page and a recorded flight, packed into one text that the report unpacks."""

import gzip
from base64 import b64encode
from math import inf
from pathlib import Path

import msgspec

from gcs import station
from gcs.flightlog.reader import FlightLog
from gcs.station.picture import FlightPicture
from gcs.station.recorded_flight import recorded_flight

PAGE = Path(station.__file__).parent / "page"
FLIGHT = "flight.json"
"""The file of the page that holds the recorded flight."""
_KINDS = frozenset({".css", ".html", ".js", ".mjs", ".svg"})
_VEHICLE_PICTURES = 16_000
"""A vehicle at one time takes about 30 bytes of a report, and 90 where hardly a number repeats: at most 1.4 MB."""


def replay_flight(*logs: FlightLog) -> FlightPicture:
    """Return the logs of a flight's processes as a report replays them; raises LogError as `recorded_flight` does.

    Long flights and large teams are shown less often than five times a second; the replay says how often.
    """
    return recorded_flight(*logs, vehicle_pictures=_VEHICLE_PICTURES, step_max_s=inf)


def packed_replay(flight: FlightPicture) -> str:
    """Return the files of the operator's page with a recorded flight: a JSON object of texts by name, gzip, base64."""
    texts = {name: path.read_text(encoding="utf-8") for name, path in _page_files().items()}
    texts[FLIGHT] = msgspec.json.encode(flight).decode()
    return b64encode(gzip.compress(msgspec.json.encode(texts), compresslevel=9, mtime=0)).decode()


def licences() -> str:
    """Return the licences of the libraries of the page: who gives them on has to give these with them."""
    return "\n".join(path.read_text(encoding="utf-8") for path in sorted(PAGE.rglob("*.LICENSE.txt")))


def _page_files() -> dict[str, Path]:
    """Return the files that a browser loads, by their names relative to the page's folder."""
    return {path.relative_to(PAGE).as_posix(): path for path in sorted(PAGE.rglob("*")) if path.suffix in _KINDS}
