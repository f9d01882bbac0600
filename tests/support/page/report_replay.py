"""Helpers for tests of the replay in a report: flights that are hard to embed, and a report's embedded files."""

import gzip
import re
from base64 import b64decode

import msgspec
from msgspec.structs import replace

from gcs.station.picture import FlightPicture
from tests.support.page.station_pictures import ring_flight


def nasty_flight(text: str) -> FlightPicture:
    """Return a recorded flight whose mission and events are named by a text."""
    flight = ring_flight()
    events = tuple(replace(event, text=text) for event in flight.events)
    return replace(flight, mission=replace(flight.mission, mission=text), events=events)


def held_files(html: str) -> dict[str, str]:
    """Return the texts of the files that a report holds for its replay, by name."""
    found = re.search(r'<script type="text/plain" id="replay-files">([^<]*)</script>', html)
    assert found
    files: dict[str, str] = msgspec.json.decode(
        gzip.decompress(b64decode(found[1], validate=True)), type=dict[str, str]
    )
    return files
