"""Which logs of others are damaged, and which only end early: exit codes rest on it."""

import json
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from gcs.errors import Exit
from gcs.vehicle_logs.foreign import read_vehicle_logs
from tests.conftest import RunHere
from tests.gcs.vehicle_logs.test_bad_logs import (
    BIN,
    LOCAL,
    LOGS,
    TLOG,
    ULOG,
    Read,
    bin_records,
    topic_records,
    ulog_records,
)
from tests.support.flight_logs import record_simulation
from tests.support.mission_text import content, parsed
from tests.support.result_keys import OUTPUT_KEYS

STAMP_BYTES, V2_OVERHEAD_BYTES = 8, 12


def flipped(log: bytes, at: int, bit: int) -> bytes:
    return log[:at] + bytes([log[at] ^ 1 << bit]) + log[at + 1 :]


def packets(log: bytes) -> Iterator[tuple[int, int]]:
    """Where each packet of a telemetry log begins, with its stamp, and its message id."""
    at = 0
    while at < len(log):
        head = log[at + STAMP_BYTES :]
        yield at, int.from_bytes(head[7:10], "little")
        at += STAMP_BYTES + V2_OVERHEAD_BYTES + head[1]


def middle(places: list[int]) -> int:
    return places[len(places) // 2]


ATTITUDE, LOCAL_POSITION_NED = 30, 32
LAST_ATTITUDE = [at for at, kind in packets(TLOG) if kind == ATTITUDE][-1]
"""A position comes after it."""
PLACES = [at for at, kind in packets(TLOG) if kind == LOCAL_POSITION_NED]
ESTIMATES = [at for at, name in bin_records(BIN) if name == "XKF1"]
NONSENSE = np.random.default_rng(2).integers(0, 256, 1000, dtype=np.uint8).tobytes()
LAST_ULOG = [at for at, _, body in ulog_records(ULOG) if at + 3 + len(body) < len(ULOG) - 400][-1]
DAMAGED = {
    "ulg: the kind of a record": flipped(ULOG, middle(topic_records(LOCAL)) + 2, 7),
    "ulg: the length of a record": flipped(ULOG, middle(topic_records(LOCAL)), 3),
    "ulg: a length beyond the end": flipped(ULOG, LAST_ULOG + 1, 7),
    "ulg: nonsense at the end": ULOG + NONSENSE,
    "bin: the kind of a record": flipped(BIN, middle(ESTIMATES) + 2, 7),
    "bin: nonsense at the end": BIN + NONSENSE,
    "tlog: a value": flipped(TLOG, middle(PLACES) + STAMP_BYTES + 14, 2),
    "tlog: a length beyond the end": flipped(TLOG, LAST_ATTITUDE + STAMP_BYTES + 1, 7),
    "tlog: nonsense at the end": TLOG + NONSENSE,
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_noticed_and_costs_what_it_hit(name: str, read: Read) -> None:
    found, whole = read(DAMAGED[name]), read(LOGS[name.partition(":")[0]])
    assert (found.is_damaged, whole.is_damaged) == (True, False)
    assert any("damaged" in note for note in found.notes)
    assert found.series()["position"].time_s.size >= 0.9 * whole.series()["position"].time_s.size
    kept = np.isin(found.series()["position"].time_s, whole.series()["position"].time_s)
    assert kept.mean() > 0.9


@pytest.mark.parametrize("kind", LOGS)
def test_padding_is_an_early_end_and_no_damage(kind: str, read: Read) -> None:
    """As of a file that was made larger before it was filled; also where the last record is not whole."""
    log = LOGS[kind]
    for begin, value in ((log, 0x00), (log[:-7], 0xFF)):
        padded, whole = read(begin + bytes([value]) * 5000), read(begin)
        assert not padded.is_damaged, padded.notes
        assert any("bytes of padding at the end" in note for note in padded.notes)
        assert padded.series()["position"].time_s.tolist() == whole.series()["position"].time_s.tolist()


def test_an_erased_block_costs_what_was_in_it(read: Read, subtests: pytest.Subtests) -> None:
    """4 kB, the block of a memory card, in the middle of each log."""
    for (kind, log), value in product(LOGS.items(), (0x00, 0xFF)):
        with subtests.test(kind=kind, value=value):
            half = len(log) // 2
            found, whole = read(log[:half] + bytes([value]) * 4096 + log[half + 4096 :]), read(log)
            assert found.is_damaged
            lost = 1.0 - found.series()["position"].time_s.size / whole.series()["position"].time_s.size
            assert lost < 3.0 * 4096 / len(log)
            assert found.series()["position"].time_s[-1] == whole.series()["position"].time_s[-1]


@pytest.mark.parametrize("kind", LOGS)
def test_a_log_that_ends_early_is_not_damaged(kind: str, read: Read) -> None:
    """As without power: after any byte, within a record or between two."""
    log = LOGS[kind]
    for at in np.random.default_rng(5).integers(len(log) // 2, len(log), 8):
        assert not read(log[:at]).is_damaged, at


def test_report_gives_its_result_and_says_by_its_exit_code_that_a_log_is_damaged(
    tmp_path: Path, run_here: RunHere, subtests: pytest.Subtests
) -> None:
    for name, log, code in (
        ("nonsense at the end", BIN + NONSENSE, Exit.VERDICT_FAILED),
        ("cut", BIN[:-7], Exit.HOLDS),
    ):
        with subtests.test(name=name):
            file = tmp_path / "flight.log"
            file.write_bytes(log)
            ended, out, err = run_here("report", str(file), "--json")
            assert ended == code
            (result,) = json.loads(out)["logs"]
            assert list(result) == OUTPUT_KEYS["logs[] of report"].split()
            assert result["damaged"] is (code is Exit.VERDICT_FAILED)
            assert result["series"]["position"]["samples"] > 100
            assert result["notes"]
            assert all(note in err for note in result["notes"])


def test_a_damaged_log_of_cordon_is_damaged_to_identification_too(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    record_simulation(parsed(content()), path, duration_s=15.0)
    assert not any(log.is_damaged for log in read_vehicle_logs(path))
    log = path.read_bytes()
    path.write_bytes(flipped(log, len(log) // 2, 3))
    logs = read_vehicle_logs(path)
    assert logs
    assert all(each.is_damaged for each in logs)
    for end in (log[: len(log) * 2 // 3], log[: len(log) * 2 // 3] + bytes(5000), log + b"\xff" * 5000):
        path.write_bytes(end)
        assert not any(each.is_damaged for each in read_vehicle_logs(path))
