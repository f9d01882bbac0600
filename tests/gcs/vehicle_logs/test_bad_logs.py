"""Damaged, foreign and lying logs: a clear fault that names the file, or the rest of the log and a note. Never more."""

import struct
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gcs.flightlog.container import LogError
from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import VehicleLog
from tests.support.paths import DATA
from tests.support.telemetry_log import flight

pytestmark = pytest.mark.slow

ULOG, BIN = (DATA / "px4-quad.ulg").read_bytes(), (DATA / "arducopter.bin").read_bytes()
TLOG = bytes(flight((3,), seconds=5.0).log)
LOGS = {"ulg": ULOG, "bin": BIN, "tlog": TLOG}
Read = Callable[[bytes], VehicleLog]
SETPOINT, LOCAL = "trajectory_setpoint", "vehicle_local_position"
ULOG_HEADER_BYTES = 16
READ_MAX_S = 5.0


def ulog_records(log: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Where each record begins, its kind and its body."""
    at = ULOG_HEADER_BYTES
    while at < len(log):
        size, kind = struct.unpack_from("<HB", log, at)
        yield at, kind, log[at + 3 : at + 3 + size]
        at += 3 + size


def topic_records(topic: str) -> list[int]:
    """Where the data records of a topic begin."""
    added = [body for _, kind, body in ulog_records(ULOG) if kind == ord("A") and body[3:] == topic.encode()]
    number = added[0][1:3]
    return [at for at, kind, body in ulog_records(ULOG) if kind == ord("D") and body[:2] == number]


def scaled(topic: str, offset: int, kind: str, factor: float) -> bytes:
    """The log of PX4 with some neighbouring fields of a topic multiplied; offsets are into its message."""
    log = bytearray(ULOG)
    for at in topic_records(topic):
        values = struct.unpack_from(kind, log, at + 5 + offset)
        struct.pack_into(kind, log, at + 5 + offset, *(value * factor for value in values))
    return bytes(log)


def bin_records(log: bytes) -> Iterator[tuple[int, str]]:
    """Where each record of ArduPilot's log begins, and what it is called."""
    formats, at = {0x80: ("FMT", 89)}, 0
    while at < len(log):
        name, length = formats[log[at + 2]]
        if name == "FMT":
            formats[log[at + 3]] = (log[at + 5 : at + 9].rstrip(b"\0").decode(), log[at + 4])
        yield at, name
        at += length


def faults(read: Read, log: bytes) -> str:
    with pytest.raises(LogError) as refused:
        read(log)
    assert all("flight.log" in fault for fault in refused.value.faults)
    return str(refused.value)


# What is no log


def test_what_is_no_log_is_refused(subtests: pytest.Subtests, read: Read) -> None:
    for content, fault in (
        (b"", "is empty"),
        (b"time_s,x\n0,1\n", "unknown format; the readable formats are PX4"),
        (b"ULog\x01\x12\x35", "cannot be read as a PX4 log"),
        (b"ULog\x01\x12\x35\x01" + bytes(8), "holds none of the topics trajectory_setpoint"),
        (b"\xa3\x95\x80" + bytes(40), "holds none of the messages XKF1"),
        (struct.pack(">Q", 1_763_700_000_000_000) + b"\xfd" + bytes(400), "no HEARTBEAT of an autopilot"),
    ):
        with subtests.test(fault=fault):
            assert fault in faults(read, content)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No such file"):
        read_vehicle_logs(tmp_path / "nowhere.ulg")
    with pytest.raises(LogError, match="is not a file"):
        read_vehicle_logs(tmp_path)


def test_a_hundred_gigabytes_are_not_read(tmp_path: Path) -> None:
    huge = tmp_path / "huge.ulg"
    huge.write_bytes(ULOG)
    with huge.open("r+b") as file:
        file.truncate(100_000_000_000)  # sparse: it takes no room
    begin_s = time.process_time()
    with pytest.raises(LogError, match=r"has 100.0 GB; the limit is 1.1 GB"):
        read_vehicle_logs(huge)
    assert time.process_time() - begin_s < 1.0


# Formats that claim too much


def record(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def test_formats_cannot_claim_gigabytes(subtests: pytest.Subtests, read: Read) -> None:
    for formats in (
        [b"vehicle_status:uint64_t timestamp;vehicle_status[60000] me;"],
        [b"vehicle_status:uint64_t timestamp;a[60000] x;", b"a:b[60000] x;", b"b:uint8_t x;"],
        [b"vehicle_status:uint64_t timestamp;a[60000] x;", b"a:b[60000] x;", b"b:"],
        [b"vehicle_status:uint64_t timestamp;" + b"".join(b"uint8_t[65535] a%d;" % i for i in range(3000))],
    ):
        with subtests.test():
            added = b"".join(record("A", struct.pack("<BH", 0, number) + b"vehicle_status") for number in range(50))
            begin_s = time.process_time()
            told = faults(read, ULOG[:ULOG_HEADER_BYTES] + b"".join(record("F", body) for body in formats) + added)
            assert "declare more fields than a PX4 log can have" in told
            assert time.process_time() - begin_s < READ_MAX_S


def test_a_format_of_ardupilot_that_makes_no_sense_costs_its_own_records_only(
    subtests: pytest.Subtests, read: Read
) -> None:
    """A length of 0, of less than a header, of too much; a letter that is none; one that changes the length."""
    for offset, value in ((4, 0), (4, 2), (4, 255), (9, ord("!"))):
        with subtests.test(offset=offset, value=value):
            log = bytearray(BIN)
            at = next(at for at, name in bin_records(BIN) if name == "FMT" and BIN[at + 5 : at + 9] == b"GUIP")
            log[at + offset] = value
            vehicle = read(bytes(log))
            assert "GUIP" in vehicle.missing
            assert vehicle.series()["position"].time_s.size > 200
            assert any("GUIP" in note for note in vehicle.notes)


def test_pyulog_does_not_search_beyond_the_end_for_ever(read: Read) -> None:
    """Found by fuzzing: an unknown record that claims more than is left sends it back by what was not there."""
    told = record("I", b"\x0bchar[2] key" + b"ab")
    log = ULOG[:ULOG_HEADER_BYTES] + told * 2000 + struct.pack("<HB", 15_000, 1) + bytes(range(1, 200))
    begin_s = time.process_time()
    assert "holds none of the topics" in faults(read, log)
    assert time.process_time() - begin_s < READ_MAX_S


# Logs that end early


def test_a_log_of_px4_is_read_as_far_as_it_goes(read: Read) -> None:
    cut = len(ULOG) * 2 // 3
    whole = [at for at, _, body in ulog_records(ULOG) if at + 3 + len(body) <= cut]
    last = max(at for at in topic_records(LOCAL) if at in whole)
    log = read(ULOG[:cut])
    begins = next(at for at, _, body in ulog_records(ULOG) if at + 3 + len(body) > cut)
    assert f"ends in the middle of a record at byte {begins}" in log.notes
    stamp_us = struct.unpack_from("<Q", ULOG, last + 5)[0]
    assert log.series()["position"].time_s[-1] == pytest.approx((stamp_us - 192_000) / 1e6)


def test_a_log_of_ardupilot_is_read_as_far_as_it_goes(read: Read) -> None:
    begins = [at for at, name in bin_records(BIN) if name == "XKF1"]
    log = read(BIN[: begins[300] + 20])
    assert log.series()["position"].time_s.size == 150, "of two cores"
    assert f"ends in the middle of a record at byte {begins[300]}" in log.notes


def test_a_telemetry_log_is_read_as_far_as_it_goes(read: Read) -> None:
    assert not read(TLOG).notes
    log = read(TLOG[:-3])
    assert any(note.startswith("ends in the middle of a record at byte") for note in log.notes)


ZEROS, PACKETS, HEADS = bytes(2_000_000), b"\xfd" * 2_000_000, b"\xa3\x95" * 1_000_000


@pytest.mark.parametrize(
    ("kind", "tail"),
    [("ulg", ZEROS), ("bin", HEADS), ("tlog", PACKETS), ("tlog", ZEROS)],
    ids=["ulg, zeros", "bin, heads", "tlog, packets", "tlog, zeros"],
)
def test_what_is_no_record_is_passed_over_soon(kind: str, tail: bytes, read: Read) -> None:
    """Two megabytes behind a log, as of a file that was made larger than its log."""
    log = LOGS[kind]
    begin_s = time.process_time()
    whole, padded = read(log).series()["position"], read(log + tail).series()["position"]
    assert padded.values.tolist() == whole.values.tolist()
    assert time.process_time() - begin_s < READ_MAX_S


# Time and units


def test_time_going_backwards_in_a_log_of_px4_is_refused_with_topic_and_time(read: Read) -> None:
    first, second = topic_records(LOCAL)[100:102]
    log = bytearray(ULOG)
    stamps = [log[at + 5 : at + 13] for at in (first, second)]
    log[first + 5 : first + 13], log[second + 5 : second + 13] = stamps[1], stamps[0]
    later_s = (struct.unpack("<Q", stamps[1])[0] - 192_000) / 1e6
    assert f"vehicle_local_position: time goes backwards at {later_s:.6f} s" in faults(read, bytes(log))


def test_a_stamp_that_is_no_time_is_refused(read: Read) -> None:
    log = bytearray(ULOG)
    at = topic_records(LOCAL)[-1] + 5
    log[at : at + 8] = b"\xff" * 8
    assert "vehicle_local_position: sample 561 is stamped 4.6" in faults(read, bytes(log))


X, VELOCITY, PLACE = (40, "<3f"), (64, "<3f"), (24, "<2d")


def test_other_units_are_refused_with_topic_and_time(subtests: pytest.Subtests, read: Read) -> None:
    for log, fault in (
        (scaled(LOCAL, *X, 1000.0), "vehicle_local_position: the position moves about 1000 times"),
        (scaled(LOCAL, *VELOCITY, 1000.0), "m/s at"),
        (scaled(LOCAL, *VELOCITY, 100.0), "moves about 0.01 times"),
        (scaled(LOCAL, *X, 3.28), "the position moves 2.9"),
        (scaled(LOCAL, *PLACE, 1e7), "s since boot: its origin, Geodetic("),
        (scaled(SETPOINT, 8, "<3f", 1000.0), "trajectory_setpoint: the setpoints move about 1000 times"),
        (scaled(SETPOINT, 8, "<3f", 1e7), "is not a plausible setpoint (at most 100000 m)"),
    ):
        with subtests.test(fault=fault):
            told = faults(read, log)
            assert fault in told
            assert " s" in told.partition(" at ")[2]


def guided(multiplier: bytes, change: Callable[[float, float, float], tuple[float, float, float]]) -> bytes:
    """ArduPilot's log with another unit told of its setpoints, and other setpoints."""
    log = bytearray(BIN)
    kind = next(BIN[at + 3] for at, name in bin_records(BIN) if name == "FMT" and BIN[at + 5 : at + 9] == b"GUIP")
    for at, name in bin_records(BIN):
        if name == "FMTU" and BIN[at + 11] == kind:
            log[at + 28 : at + 44] = log[at + 28 : at + 44].replace(b"B", multiplier)
        if name == "GUIP":
            struct.pack_into("<3f", log, at + 12, *change(*struct.unpack_from("<3f", log, at + 12)))
    return bytes(log)


def test_setpoints_are_in_the_unit_that_the_log_tells(read: Read) -> None:
    """Older firmware logs centimetres and up, newer metres and down."""
    as_is, newer = (
        read(BIN).series()["setpoint"],
        read(guided(b"0", lambda x, y, z: (x / 100.0, y / 100.0, -z / 100.0))).series()["setpoint"],
    )
    assert newer.values == pytest.approx(as_is.values, abs=1e-6)


def test_velocities_beside_setpoints_are_north_west_and_up(read: Read) -> None:
    """PX4 has them for every setpoint; ArduPilot feeds those of one submode forward, and logs them with its units."""
    ulog, copter = bytearray(ULOG), bytearray(BIN)
    for at in topic_records(SETPOINT):
        struct.pack_into("<3f", ulog, at + 5 + 20, 0.3, -0.4, 0.1)
    for at, name in bin_records(BIN):
        if name == "GUIP":
            copter[at + 11] = 3
            struct.pack_into("<3f", copter, at + 25, 30.0, -40.0, -10.0)
    for log in (read(bytes(ulog)), read(bytes(copter))):
        assert (log.series()["setpoint_velocity"].time_s == log.series()["setpoint"].time_s).all()
        assert log.series()["setpoint_velocity"].values == pytest.approx(
            np.tile((0.3, 0.4, -0.1), (log.series()["setpoint"].time_s.size, 1))
        )
    assert read(BIN).setpoint_velocity is None, "to a position alone none belongs"


def renamed(log: bytes, names: dict[bytes, bytes]) -> bytes:
    """ArduPilot's log with records of other names."""
    out = bytearray(log)
    for at, name in bin_records(log):
        if name == "FMT" and (renamed := names.get(log[at + 5 : at + 9])):
            out[at + 5 : at + 9] = renamed
    return bytes(out)


def test_the_names_of_older_firmware_are_read(read: Read) -> None:
    """Before Copter 4.2 the setpoints are GUID, which says metres and means centimetres; EKF2 logs NKF1."""
    as_is = read(BIN)
    older = read(renamed(guided(b"0", lambda x, y, z: (x, y, z)), {b"GUIP": b"GUID", b"XKF1": b"NKF1"}))
    for name in ("setpoint", "position", "velocity", "attitude"):
        assert older.series()[name].values.tolist() == as_is.series()[name].values.tolist()
    assert (older.series()["setpoint"].topic, older.series()["position"].topic) == ("GUID", "NKF1")


def test_a_velocity_of_firmware_before_copter_4_1_is_no_position(read: Read) -> None:
    """It is logged as the second submode, with zeros as its position."""
    log = renamed(guided(b"0", lambda x, y, z: (0.0, 0.0, 0.0) if abs(x) > 100.0 else (x, y, z)), {b"GUIP": b"GUID"})
    found, as_is = read(log).series()["setpoint"], read(BIN).series()["setpoint"]
    zeros = np.abs(as_is.values[:, 0]) > 1.0
    assert 0 < zeros.sum() < zeros.size
    assert np.isnan(found.values).all(axis=1).tolist() == zeros.tolist()


def test_of_two_estimators_that_in_use_is_read(read: Read) -> None:
    """EKF2 beside EKF3: the parameter AHRS_EKF_TYPE says which of them flies."""
    both, twin = bytearray(), 0x91
    places = [*bin_records(BIN), (len(BIN), "")]
    for (at, name), (end, _) in pairwise(places):
        record = bytearray(BIN[at:end])
        both += record
        if name == "FMT" and record[5:9] == b"XKF1":
            record[3], record[5:9] = twin, b"NKF1"
            both += record
        if name == "XKF1":
            record[2] = twin
            struct.pack_into("<f", record, 34, struct.unpack_from("<f", record, 34)[0] + 50.0)
            both += record
    for number, moved_m in ((3.0, 0.0), (2.0, 50.0)):
        log = bytearray(both)
        at = next(
            at for at, name in bin_records(bytes(both)) if name == "PARM" and b"GUID_OPTIONS" in both[at : at + 27]
        )
        struct.pack_into("<16sf", log, at + 11, b"AHRS_EKF_TYPE", number)
        found, as_is = read(bytes(log)).series()["position"], read(BIN).series()["position"]
        assert found.values[:, 0] == pytest.approx(as_is.values[:, 0] + moved_m, abs=1e-4)


def test_a_unit_that_is_told_wrongly_is_refused(read: Read) -> None:
    assert "GUIP: the setpoints move about 100 times" in faults(read, guided(b"0", lambda x, y, z: (x, y, z)))


def test_the_estimators_core_that_flies_is_read(read: Read) -> None:
    """The second core's position is moved 50 m north: nobody sees that, unless the parameters say that it flies."""
    log = bytearray(BIN)
    for at, name in bin_records(BIN):
        if name == "XKF1" and log[at + 11] == 1:
            struct.pack_into("<f", log, at + 34, struct.unpack_from("<f", log, at + 34)[0] + 50.0)
    as_is, moved = read(BIN).series()["position"], read(bytes(log)).series()["position"]
    assert moved.values.tolist() == as_is.values.tolist()
    chosen = next(at for at, name in bin_records(BIN) if name == "PARM" and b"EK3_PRIMARY" in BIN[at : at + 27])
    struct.pack_into("<f", log, chosen + 27, 1.0)
    second = read(bytes(log)).series()["position"]
    assert second.values[:, 0].min() > 45.0


def test_a_damaged_name_of_a_topic_costs_that_topic_only(read: Read) -> None:
    """Found by fuzzing: a name that is no text made the whole log unreadable."""
    at = next(at for at, kind, body in ulog_records(ULOG) if kind == ord("A") and body[3:] == SETPOINT.encode())
    log = read(ULOG[: at + 8] + b"\xee" + ULOG[at + 9 :])
    assert (log.missing, log.position is not None) == ((SETPOINT,), True)


def test_a_format_of_ardupilot_with_a_column_without_a_name_costs_its_records_only(read: Read) -> None:
    """Found by fuzzing: it made the whole log unreadable."""
    begin = BIN.index(b"SIM\0") + 20
    columns = BIN[begin : begin + 64].replace(b"Alt,", b",").ljust(64, b"\0")
    log = read(BIN[:begin] + columns + BIN[begin + 64 :])
    assert (log.true_position, log.position is not None) == (None, True)
    assert any("the format of SIM is inconsistent" in note for note in log.notes)


def test_missing_topics_are_named(read: Read) -> None:
    dropped = set(topic_records(SETPOINT))
    kept = b"".join(
        struct.pack("<HB", len(body), kind) + body for at, kind, body in ulog_records(ULOG) if at not in dropped
    )
    log = read(ULOG[:ULOG_HEADER_BYTES] + kept)
    assert log.missing == ("trajectory_setpoint",)
    with pytest.raises(LogError, match=r"vehicle 1: the log has no setpoint; looked for trajectory_setpoint"):
        log.require("position", "setpoint")
