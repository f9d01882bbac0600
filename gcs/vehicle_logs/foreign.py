"""Reads flight logs of all formats, cordon's own included; the first bytes of a file give its format."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from estimation.input_file import open_plain
from gcs.flightlog.container import LogError
from gcs.vehicle_logs.log_file import MAVLINK_MAGICS, STAMP_BYTES, STAMPS_US, LogFile, open_log, quiet
from gcs.vehicle_logs.vehicle_log import VehicleLog

ULOG_MAGIC = b"ULog\x01\x12\x35"
DATAFLASH_MAGIC = b"\xa3\x95\x80"
MCAP_MAGIC = b"\x89MCAP0\r\n"
_HEAD_BYTES = 64


@dataclass(frozen=True, slots=True)
class Reader:
    """One format: its name, the test of its first bytes, and the module of this folder that reads it."""

    format: str
    recognises: Callable[[bytes], bool]
    module: str

    def read(self, log: LogFile) -> tuple[VehicleLog, ...]:
        """Return the log of each vehicle, imported now: the readers' libraries are slow to import; raises LogError."""
        read: Callable[[LogFile], tuple[VehicleLog, ...]] = import_module(f"gcs.vehicle_logs.{self.module}").read
        return read(log)


def is_foreign(path: Path) -> bool:
    """Return whether a file begins like a log of another program; False for one that cannot be opened."""
    try:
        with open_plain(path) as stream:
            head = stream.read(_HEAD_BYTES)
    except (OSError, ValueError):
        return False
    return any(reader.recognises(head) for reader in FOREIGN)


def read_vehicle_logs(path: Path) -> tuple[VehicleLog, ...]:
    """Return the log of each vehicle in a file, by ascending system id.

    Raises LogError, which names the file, the topic and the time, for whatever cannot be read. No content of a file
    raises another error or prints anything, and the work is bounded by the file's size.
    """
    log = open_log(path)
    reader = next((reader for reader in READERS if reader.recognises(log.head)), None)
    if reader is None:
        known = ", ".join(reader.format for reader in READERS)
        raise LogError([f"{log.name}: unknown format; the readable formats are {known}"])
    try:
        with quiet():
            return reader.read(log)
    except LogError:
        raise
    except Exception as error:  # untrusted bytes: any exception of a reader is bad input
        reason = f"{type(error).__name__}: {error}"
        raise LogError([f"{log.name}: cannot be read as a {reader.format}: it is damaged ({reason})"]) from error


def _is_tlog(head: bytes) -> bool:
    stamp_us = int.from_bytes(head[:STAMP_BYTES], "big")
    return len(head) > STAMP_BYTES and head[STAMP_BYTES] in MAVLINK_MAGICS and stamp_us in STAMPS_US


FOREIGN = (
    Reader("PX4 log (.ulg)", lambda head: head.startswith(ULOG_MAGIC), "ulog"),
    Reader("ArduPilot log (.bin)", lambda head: head.startswith(DATAFLASH_MAGIC), "dataflash"),
    Reader("MAVLink telemetry log (.tlog)", _is_tlog, "tlog"),
)
"""Other programs' formats, in the order in which they are tried."""

READERS = (*FOREIGN, Reader("log of cordon (.mcap)", lambda head: head.startswith(MCAP_MAGIC), "own_log"))
"""Every format."""
