"""Cuts the small logs of tests/data from longer ones: `python -m tests.cut_logs DIRECTORY`. Records stay as they were.

Whole records are left out: other topics, other times, and of fast topics all but every n-th.
"""

import struct
import sys
from collections import Counter
from pathlib import Path

DATA = Path(__file__).parent / "data"

ULOG_HEADER_BYTES = 16
ULOG_SPAN_US = (20_500_000, 43_000_000)
ULOG_EVERY = {
    "trajectory_setpoint": 1,
    "vehicle_local_position": 5,
    "vehicle_local_position_groundtruth": 5,
    "vehicle_status": 1,
}
ULOG_PARAMETERS = (b"MAV_SYS_ID", b"COM_OF_LOSS_T", b"COM_OBL_RC_ACT", b"MPC_XY_VEL_MAX", b"MPC_TILTMAX_AIR")

BIN_UNTIL_US = 72_600_000
BIN_KEPT = {"FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "MODE", "VER", "EV", "ORGN", "GUIP", "XKF1", "SIM"}
BIN_PARAMETERS = (b"SYSID_THISMAV", b"LOG_DISARMED", b"EK3_PRIMARY", b"FRAME_CLASS", b"GUID_OPTIONS")

CSV_ROWS = 450


def cut_ulog(log: bytes) -> bytes:
    out, at = bytearray(log[:ULOG_HEADER_BYTES]), ULOG_HEADER_BYTES
    topics: dict[int, str] = {}
    seen: Counter[str] = Counter()
    while at < len(log):
        size, kind = struct.unpack_from("<HB", log, at)
        record, body = log[at : at + 3 + size], log[at + 3 : at + 3 + size]
        at += 3 + size
        if kind == ord("A"):
            topics[struct.unpack_from("<H", body, 1)[0]] = body[3:].decode()
            keep = body[3:].decode() in ULOG_EVERY
        elif kind == ord("D"):
            number, stamp_us = struct.unpack_from("<HQ", body)
            topic = topics[number]
            keep = topic in ULOG_EVERY and ULOG_SPAN_US[0] <= stamp_us < ULOG_SPAN_US[1]
            seen[topic] += keep
            keep = keep and seen[topic] % ULOG_EVERY[topic] == 0
        elif kind == ord("F"):
            keep = body.partition(b":")[0].decode() in ULOG_EVERY
        elif kind in b"PQ":
            keep = any(name in body for name in ULOG_PARAMETERS)
        else:
            keep = kind in b"BIL"
        out += record if keep else b""
    return bytes(out)


def cut_bin(log: bytes) -> bytes:
    out, at = bytearray(), 0
    formats: dict[int, tuple[str, int]] = {0x80: ("FMT", 89)}
    while at + 3 <= len(log):
        name, length = formats[log[at + 2]]
        record = log[at : at + length]
        at += length
        if name == "FMT":
            formats[record[3]] = (record[5:9].rstrip(b"\0").decode(), record[4])
            keep = formats[record[3]][0] in BIN_KEPT
        elif name == "FMTU":
            keep = formats[record[11]][0] in BIN_KEPT
        else:
            keep = name in BIN_KEPT and struct.unpack_from("<Q", record, 3)[0] < BIN_UNTIL_US
            keep = keep and (name != "PARM" or record[11:27].rstrip(b"\0") in BIN_PARAMETERS)
        out += record if keep else b""
    return bytes(out)


def main(source: Path) -> None:
    (DATA / "px4-quad.ulg").write_bytes(cut_ulog((source / "px4-quad-excitation.ulg").read_bytes()))
    (DATA / "arducopter.bin").write_bytes(cut_bin((source / "arducopter-excitation.bin").read_bytes()))
    for name in ("px4-quad", "arducopter"):
        lines = (source / f"{name}-excitation.csv").read_text(encoding="utf-8").splitlines(keepends=True)
        (DATA / f"{name}.csv").write_text("".join(lines[: CSV_ROWS + 1]), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
