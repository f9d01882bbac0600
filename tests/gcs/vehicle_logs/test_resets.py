"""What changes the meaning of a vehicle's positions within a log: resets, jumps and restarts."""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from estimation.identification.excerpts import excerpts_of
from gcs.identify.reading import recording_of
from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import VehicleLog
from tests.gcs.vehicle_logs.test_bad_logs import BIN, LOCAL, ULOG, Read, bin_records, topic_records
from tests.gcs.vehicle_logs.test_own_log import written
from tests.gcs.vehicle_logs.test_tlog import beat, packed, place
from tests.support.paths import DATA
from tests.support.telemetry_log import Flown

pytestmark = pytest.mark.slow

JUMP_M = 25.0
RESET_US = 50_000_000
HALF_US = 110_000_000
XKF4, XY_RESET_COUNTER = 0x90, 180
EXCITATION = (DATA / "arducopter-excitation.bin").read_bytes()


def stamp_us(log: bytes, at: int) -> int:
    return int(struct.unpack_from("<Q", log, at + 3)[0])


def shifted(log: bytes, since_us: int, jump_m: float = JUMP_M) -> bytes:
    """ArduPilot's log whose position jumps north while its velocity stays what it is."""
    out = bytearray(log)
    for at, name in bin_records(log):
        if name == "XKF1" and stamp_us(log, at) >= since_us:
            struct.pack_into("<f", out, at + 34, struct.unpack_from("<f", out, at + 34)[0] + jump_m)
    return bytes(out)


def with_status(log: bytes, since_us: int) -> bytes:
    """ArduPilot's log with the estimator's status, which tells of a reset to the north, beside each position."""
    columns = b"TimeUS,C,OFN,OFE,PI"
    form = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", XKF4, 21, b"XKF4", b"QBffb", columns)

    def records() -> Iterator[bytes]:
        yield form
        places = [*(at for at, _ in bin_records(log)), len(log)]
        for (at, name), end in zip(bin_records(log), places[1:], strict=True):
            yield log[at:end]
            if name == "XKF1":
                reset_m = JUMP_M if stamp_us(log, at) >= since_us else 0.0
                yield b"\xa3\x95" + struct.pack("<BQBffb", XKF4, stamp_us(log, at), log[at + 11], reset_m, 0.0, 0)

    return b"".join(records())


def reset_s(log: VehicleLog, since_us: int, begin_us: int) -> tuple[float, float]:
    """Return the times of the last position before the reset, and of the first after it."""
    times_s = log.series()["position"].time_s
    after = int(np.searchsorted(times_s, (since_us - begin_us) / 1e6 - 1e-6))
    return float(times_s[after - 1]), float(times_s[after])


def begin_us(log: bytes) -> int:
    return min(stamp_us(log, at) for at, name in bin_records(log) if name in ("XKF1", "GUIP", "MODE"))


def test_a_reset_that_the_estimator_logs_is_one(read: Read) -> None:
    log = read(with_status(BIN, RESET_US))
    before_s, after_s = reset_s(log, RESET_US, begin_us(BIN))
    assert log.position_resets_s == pytest.approx((before_s, after_s))
    assert read(with_status(BIN, 0)).position_resets_s == ()


def test_a_position_that_jumps_against_its_velocity_is_reset(read: Read) -> None:
    log = read(shifted(BIN, RESET_US))
    _, after_s = reset_s(log, RESET_US, begin_us(BIN))
    assert log.position_resets_s == pytest.approx((after_s,))
    assert any("XKF1: 1 jumps" in note and "25.0 m" in note for note in log.notes)
    assert read(BIN).position_resets_s == ()


def test_a_position_that_stands_still_against_its_velocity_is_none(read: Read) -> None:
    """As of telemetry that is stuck: it contradicts the velocity until it moves again, by a jump."""
    log, stuck = bytearray(EXCITATION), dict[int, bytes]()
    for at, name in bin_records(EXCITATION):
        if name == "XKF1" and 0 <= stamp_us(EXCITATION, at) - HALF_US < 5_000_000:
            log[at + 34 : at + 42] = stuck.setdefault(log[at + 11], bytes(log[at + 34 : at + 42]))
    found = read(bytes(log))
    assert any("XKF1: the position contradicts the velocity for" in note for note in found.notes)
    begin_s = (HALF_US - begin_us(EXCITATION)) / 1e6
    parts = excerpts_of(recording_of(found))
    assert sum(part.duration_s for part in parts) > 130.0
    assert not any(((part.time_s > begin_s + 0.6) & (part.time_s < begin_s + 4.4)).any() for part in parts)


def test_a_telemetry_log_and_cordons_own_have_jumps_too(tmp_path: Path) -> None:
    flown = [(step * 0.1, place(100.0 + step * 0.1, step * 0.1 + JUMP_M * (step >= 40))) for step in range(80)]
    path = tmp_path / "flight.tlog"
    path.write_bytes(packed((0.0, beat(0)), *flown))
    (log,) = read_vehicle_logs(path)
    assert log.position_resets_s == pytest.approx((4.0,))
    times_s = [step * 0.02 for step in range(2000)]
    flight = Flown(1, (0.0, 0.0, 0.0), times_s, [(at_s / 2.0, 0.0, 5.0) for at_s in times_s], [1.0], [(0.0, 0.0, 5.0)])
    flight.offboard_s = [1.0]
    jump_m = np.outer(np.array(times_s) >= 20.0, (0.0, JUMP_M, 0.0))
    (log,) = read_vehicle_logs(written(tmp_path / "flight.mcap", flight))
    assert log.position_resets_s == ()
    (log,) = read_vehicle_logs(written(tmp_path / "jumped.mcap", flight, jump_m=jump_m))
    assert log.position_resets_s == pytest.approx((20.0,))


def test_no_part_of_a_flight_reaches_into_the_interval_of_a_jump(read: Read) -> None:
    """Between the last position before it and the first after it, nothing is known."""
    log = read(shifted(EXCITATION, HALF_US))
    before_s, after_s = reset_s(log, HALF_US, begin_us(EXCITATION))
    parts = excerpts_of(recording_of(log))
    assert sum(part.duration_s for part in parts) > 145.0
    assert not any((part.time_s > before_s).any() and (part.time_s < after_s).any() for part in parts)
    assert all(np.abs(np.diff(part.position_m, axis=0)).max() < 1.0 for part in parts)


def test_a_vehicle_on_its_way_back_from_a_jump_is_left_out(read: Read) -> None:
    """It is at its limits of speed and acceleration."""
    log = read(shifted(EXCITATION, HALF_US, -JUMP_M))
    recording, plain = recording_of(log), recording_of(read(EXCITATION))
    since_s = recording.position_time_s - log.position_resets_s[0]
    recording.position_m[:, 0] += np.where(since_s >= 0.0, np.minimum(JUMP_M, 3.0 * since_s), 0.0)
    parts = excerpts_of(recording)
    assert sum(part.duration_s for part in parts) > 135.0
    for part in parts:
        as_it_was_m = np.interp(part.time_s, plain.position_time_s, plain.position_m[:, 0])
        assert np.abs(part.position_m[:, 0] - as_it_was_m).max() < 4.0


def test_setpoints_that_are_none_end_a_part(read: Read) -> None:
    """A target in latitude and longitude, as "fly here" gives it, and then local setpoints again."""
    log = bytearray(EXCITATION)
    sent = [at for at, name in bin_records(EXCITATION) if name == "GUIP" and stamp_us(EXCITATION, at) >= HALF_US]
    for at, submode in zip(sent[:100], (1, 2) * 50, strict=True):
        log[at + 11] = submode
        struct.pack_into("<3f", log, at + 12, 473977420.0, 85455940.0, 800.0)
    found, plain = read(bytes(log)), read(EXCITATION)
    assert any("GUIP: 100 targets in latitude and longitude" in note for note in found.notes)
    given = np.isfinite(found.series()["setpoint"].values).all(axis=1)
    assert (~given).sum() == len({stamp_us(EXCITATION, at) for at in sent[:100]})
    assert found.series()["setpoint"].values[given].tolist() == plain.series()["setpoint"].values[given].tolist()
    begin_s, end_s = ((stamp_us(EXCITATION, at) - begin_us(EXCITATION)) / 1e6 for at in (sent[0], sent[100]))
    parts = excerpts_of(recording_of(found))
    assert sum(part.duration_s for part in parts) > 135.0
    assert not any(((part.time_s >= begin_s) & (part.time_s <= end_s)).any() for part in parts)


def test_reset_counters_of_px4_are_read(read: Read) -> None:
    log, places = bytearray(ULOG), topic_records(LOCAL)
    for at in places[100:]:
        log[at + 5 + XY_RESET_COUNTER] += 1
    assert read(ULOG).position_resets_s == ()
    after_us = struct.unpack_from("<Q", ULOG, places[100] + 5)[0]
    begin_log_us = struct.unpack_from("<Q", ULOG, 8)[0]
    assert read(bytes(log)).position_resets_s == pytest.approx(((after_us - begin_log_us) / 1e6,))


def test_of_an_autopilot_that_restarted_the_longest_boot_is_read(read: Read, subtests: pytest.Subtests) -> None:
    """A log goes on in the same file."""
    for name, log, short_first in (("bin", BIN, True), ("ulg", ULOG, False)):
        with subtests.test(name=name):
            short = log[: len(log) * 2 // 3]
            both, alone = read(short + log if short_first else log + short), read(log)
            assert both.series()["position"].values.tolist() == alone.series()["position"].values.tolist()
            assert both.series()["position"].time_s == pytest.approx(alone.series()["position"].time_s)
            assert any(f"the longest was read, number {1 + short_first}" in note for note in both.notes)
