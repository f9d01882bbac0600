"""The one door to everybody's flight logs, cordon's own too: what a file is, is told by its first bytes alone."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from estimation.plain_file import open_plain
from gcs.flightlog.log_error import LogError
from gcs.vehicle_logs.log_file import LogFile, open_log, quiet
from gcs.vehicle_logs.packet_stamp import MAVLINK_MAGICS, STAMP_BYTES, STAMPS_US
from gcs.vehicle_logs.vehicle_log import VehicleLog

ULOG_MAGIC = b"ULog\x01\x12\x35"
DATAFLASH_MAGIC = b"\xa3\x95\x80"
MCAP_MAGIC = b"\x89MCAP0\r\n"
_HEAD_BYTES = 64


@dataclass(frozen=True, slots=True)
class Reader:
    """One format: what it is called, how its first bytes are recognised, and what reads it."""

    format: str
    recognises: Callable[[bytes], bool]
    read: Callable[[LogFile], tuple[VehicleLog, ...]]


def is_foreign(path: Path) -> bool:
    """Return whether a file begins as a log of somebody else's does; one that cannot be opened does not."""
    try:
        with open_plain(path) as stream:
            head = stream.read(_HEAD_BYTES)
    except (OSError, ValueError):
        return False
    return any(reader.recognises(head) for reader in FOREIGN)


def read_vehicle_logs(path: Path) -> tuple[VehicleLog, ...]:
    """Return what a log holds, one for each vehicle in it, by ascending system id.

    Raises LogError, which names the file, the topic and the time, for whatever cannot be read: nothing else is raised
    for what a file holds, nothing is printed, and the work is bounded by the file's size.
    """
    log = open_log(path)
    reader = next((reader for reader in READERS if reader.recognises(log.head)), None)
    if reader is None:
        known = ", ".join(reader.format for reader in READERS)
        raise LogError([f"{log.name}: is none of the logs that can be read: {known}"])
    try:
        with quiet():
            return reader.read(log)
    except LogError:
        raise
    except Exception as error:  # bytes from outside: whatever they do to a reader is bad input
        told = f"{type(error).__name__}: {error}"
        raise LogError([f"{log.name}: cannot be read as a {reader.format}, it is damaged ({told})"]) from error


# The libraries behind the readers are slow to import: only the one that is needed is.


def _read_ulog(log: LogFile) -> tuple[VehicleLog, ...]:
    from gcs.vehicle_logs.ulog import read_ulog  # noqa: PLC0415

    return read_ulog(log)


def _read_dataflash(log: LogFile) -> tuple[VehicleLog, ...]:
    from gcs.vehicle_logs.dataflash import read_dataflash  # noqa: PLC0415

    return read_dataflash(log)


def _read_tlog(log: LogFile) -> tuple[VehicleLog, ...]:
    from gcs.vehicle_logs.tlog import read_tlog  # noqa: PLC0415

    return read_tlog(log)


def _read_own(log: LogFile) -> tuple[VehicleLog, ...]:
    from gcs.vehicle_logs.own_log import read_own_log  # noqa: PLC0415

    return read_own_log(log)


def _is_tlog(head: bytes) -> bool:
    stamp_us = int.from_bytes(head[:STAMP_BYTES], "big")
    return len(head) > STAMP_BYTES and head[STAMP_BYTES] in MAVLINK_MAGICS and stamp_us in STAMPS_US


FOREIGN = (
    Reader("PX4 log (.ulg)", lambda head: head.startswith(ULOG_MAGIC), _read_ulog),
    Reader("ArduPilot log (.bin)", lambda head: head.startswith(DATAFLASH_MAGIC), _read_dataflash),
    Reader("MAVLink telemetry log (.tlog)", _is_tlog, _read_tlog),
)
"""Other programs' formats, in the order in which they are asked; another one is another row."""

READERS = (*FOREIGN, Reader("log of cordon (.mcap)", lambda head: head.startswith(MCAP_MAGIC), _read_own))
"""Every format."""
