"""The version of an autopilot's firmware, as it gets into a log."""

from pathlib import Path
from typing import Any

import pytest
from foxglove import Context
from mavsdk.plugins.info import Identification, InfoError, InfoResult, Product, Version
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from agents.shell.clock import WallClock
from gcs.autopilots import px4
from gcs.flightlog.flight import Recording
from gcs.flightlog.writer import LogWriter
from gcs.preflight import link_facts
from gcs.preflight.findings import VehicleFacts

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
        (Version(1, 17, 0, flight_sw_version_type=Kind.RELEASE, flight_sw_git_hash="000000000"), "1.17.0"),
        (Version(4, 6, 3, flight_sw_version_type=Kind.RELEASE, flight_sw_git_hash="3fc7011a0"), "4.6.3+3fc7011a0"),
        (Version(1, 16, 1, flight_sw_version_type=Kind.BETA, flight_sw_git_hash=""), "1.16.1-beta"),
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


def test_a_log_holds_it_beside_the_parameters(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with Recording(LogWriter(path, Context()), WallClock(1.0)) as recording:
        parameters = {"COM_OBL_RC_ACT": 4.0, "NOT_THERE": None}
        recording.begin_vehicle(
            VehicleFacts(vehicle_id=2, autopilot=px4.AUTOPILOT, firmware="1.17.0", parameters=parameters)
        )
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        ((_, _, _, vehicle),) = reader.iter_decoded_messages(topics="/vehicle/2/vehicle")
    assert (vehicle.autopilot, vehicle.firmware) == ("PX4", "1.17.0")
    assert [(each.name, each.value) for each in vehicle.parameters] == [("COM_OBL_RC_ACT", 4.0)]
