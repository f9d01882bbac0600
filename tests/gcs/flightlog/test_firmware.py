"""The version of an autopilot's firmware, as it gets into a log."""

from typing import Any

import pytest
from mavsdk.plugins.info import Identification, InfoError, InfoResult, Product, Version

from gcs.preflight import link_facts

Kind = Version.FlightSoftwareVersionType


class TacticEvent:
    """MAVSDK's plugin, with what a vehicle told of itself."""

    def __init__(self, version: Version | None) -> None:
        self.version = version
        self.destroyed = False

    def get_version(self) -> Version:
        if self.version is None:
            raise InfoError(InfoResult.INFORMATION_NOT_RECEIVED_YET, "get_version()")
        return self.version

    def get_identification(self) -> Identification:
        return Identification(legacy_uid=77)

    def get_product(self) -> Product:
        return Product(vendor_id=0x26AC)

    def destroy(self) -> None:
        self.destroyed = True


@pytest.mark.parametrize(
    ("version", "words"),
    [
        (None, ""),
        (Version(4, 6, 3, flight_sw_version_type=Kind.RELEASE, flight_sw_git_hash="3fc7011a0"), "4.6.3+3fc7011a0"),
        (Version(1, 18, 0, flight_sw_version_type=Kind.DEV, flight_sw_git_hash="0d1e"), "1.18.0-dev+0d1e"),
        (Version(1, 2, 3, flight_sw_version_type=Kind.UNKNOWN), "1.2.3"),
    ],
)
def test_a_version_in_words(version: Any, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    told = TacticEvent(version)
    monkeypatch.setattr(link_facts, "Info", lambda _system: told)
    monkeypatch.setattr(link_facts, "MavlinkDirect", lambda _system: told)
    read = link_facts.read_identity(told, 0.0)
    assert read.firmware == words
    assert (read.uid, read.vendor_id) == ((77, 0x26AC) if version else (None, None))
    assert told.destroyed
