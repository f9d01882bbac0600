"""Cuts the small logs of tests/data from longer ones: `python -m tests.support.cut_logs DIRECTORY`.

Records stay as they were.

Whole records are left out: other topics, other times, and all but every n-th record of fast topics.
"""

import struct
import sys
from collections import Counter
from collections.abc import Mapping, Set
from pathlib import Path
from types import MappingProxyType

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from tests.support.paths import DATA

WHOLE_US = (0, 10**12)

ULOG_HEADER_BYTES = 16
ULOG_SPAN_US = (20_500_000, 43_000_000)
ULOG_EVERY = {
    "trajectory_setpoint": 1,
    "vehicle_local_position": 5,
    "vehicle_local_position_groundtruth": 5,
    "vehicle_status": 1,
}
EXCITATION_ULOG_EVERY = {"trajectory_setpoint": 1, "vehicle_local_position": 12, "vehicle_status": 1}
"""Positions at 10 Hz, the rate that identification uses."""
ULOG_PARAMETERS = (b"MAV_SYS_ID", b"COM_OF_LOSS_T", b"COM_OBL_RC_ACT", b"MPC_XY_VEL_MAX", b"MPC_TILTMAX_AIR")

BIN_UNTIL_US = 72_600_000
EXCITATION_BIN_KEPT = {"FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "MODE", "VER", "EV", "ORGN", "GUIP", "XKF1"}
BIN_KEPT = EXCITATION_BIN_KEPT | {"SIM"}
BIN_PARAMETERS = (b"SYSID_THISMAV", b"LOG_DISARMED", b"EK3_PRIMARY", b"FRAME_CLASS", b"GUID_OPTIONS")

ULOG_LIMITS = (*ULOG_PARAMETERS, b"MPC_ACC_HOR")
BIN_LIMITS = (*BIN_PARAMETERS, b"WPNAV_SPEED", b"WPNAV_ACCEL")
"""Profiles hold limits: whole flights keep the parameters that set them."""

MCAP_KEPT = {"run", "vehicle", "start", "telemetry", "decision", "end"}

CSV_ROWS = 450


def cut_ulog(
    log: bytes, span_us: tuple[int, int], every: dict[str, int], parameters: tuple[bytes, ...] = ULOG_PARAMETERS
) -> bytes:
    out, at = bytearray(log[:ULOG_HEADER_BYTES]), ULOG_HEADER_BYTES
    topics: dict[int, str] = {}
    seen: Counter[str] = Counter()
    while at < len(log):
        size, kind = struct.unpack_from("<HB", log, at)
        record, body = log[at : at + 3 + size], log[at + 3 : at + 3 + size]
        at += 3 + size
        if kind == ord("A"):
            topics[struct.unpack_from("<H", body, 1)[0]] = body[3:].decode()
            keep = body[3:].decode() in every
        elif kind == ord("D"):
            number, stamp_us = struct.unpack_from("<HQ", body)
            topic = topics[number]
            keep = topic in every and span_us[0] <= stamp_us < span_us[1]
            seen[topic] += keep
            keep = keep and seen[topic] % every[topic] == 0
        elif kind == ord("F"):
            keep = body.partition(b":")[0].decode() in every
        elif kind in b"PQ":
            keep = any(name in body for name in parameters)
        else:
            keep = kind in b"BIL"
        out += record if keep else b""
    return bytes(out)


def cut_bin(
    log: bytes,
    until_us: int,
    kept: Set[str],
    parameters: tuple[bytes, ...] = BIN_PARAMETERS,
    every: Mapping[str, int] = MappingProxyType({}),
) -> bytes:
    out, at = bytearray(), 0
    seen: Counter[str] = Counter()
    formats: dict[int, tuple[str, int]] = {0x80: ("FMT", 89)}
    while at + 3 <= len(log):
        name, length = formats[log[at + 2]]
        record = log[at : at + length]
        at += length
        if name == "FMT":
            formats[record[3]] = (record[5:9].rstrip(b"\0").decode(), record[4])
            keep = formats[record[3]][0] in kept
        elif name == "FMTU":
            keep = formats[record[11]][0] in kept
        else:
            keep = name in kept and struct.unpack_from("<Q", record, 3)[0] < until_us
            keep = keep and (name != "PARM" or record[11:27].rstrip(b"\0") in parameters)
            seen[name] += keep
            keep = keep and seen[name] % every.get(name, 1) == 0
        out += record if keep else b""
    return bytes(out)


def cut_mcap(source: Path, target: Path) -> None:
    with source.open("rb") as log, target.open("wb") as cut:
        writer = Writer(cut, compression=CompressionType.ZSTD)
        writer.start()
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(log).iter_messages(log_time_order=False):
            if channel.topic.rpartition("/")[2] not in MCAP_KEPT or schema is None:
                continue
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, number, channel.metadata
                )
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]


def main(source: Path) -> None:
    px4 = (source / "px4-quad-excitation.ulg").read_bytes()
    (DATA / "px4-quad.ulg").write_bytes(cut_ulog(px4, ULOG_SPAN_US, ULOG_EVERY))
    (DATA / "px4-quad-excitation.ulg").write_bytes(cut_ulog(px4, WHOLE_US, EXCITATION_ULOG_EVERY, ULOG_LIMITS))
    arducopter = (source / "arducopter-excitation.bin").read_bytes()
    (DATA / "arducopter.bin").write_bytes(cut_bin(arducopter, BIN_UNTIL_US, BIN_KEPT))
    excited = (source / "arducopter-excite.bin").read_bytes()
    whole = cut_bin(excited, WHOLE_US[1], EXCITATION_BIN_KEPT, BIN_LIMITS)
    (DATA / "arducopter-excitation.bin").write_bytes(whole)
    cut_mcap(source / "stub-excitation.mcap", DATA / "stub-excitation.mcap")
    for name in ("px4-quad", "arducopter"):
        lines = (source / f"{name}-excitation.csv").read_text(encoding="utf-8").splitlines(keepends=True)
        (DATA / f"{name}.csv").write_text("".join(lines[: CSV_ROWS + 1]), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
