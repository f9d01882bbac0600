from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.sweep.columns import Row
from gcs.sweep.folder import PLAN, SweepFolder, SweepJournal, read_rows
from gcs.sweep.plan import planned

pytestmark = pytest.mark.slow

NESTED = b'{"":' + b"[" * 5000
ROWS: dict[int, Row] = {0: {"holds": True, "closest_approach_m": 0.1 + 0.2}, 2: {"error": 'it "failed"\nbadly'}}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    with SweepJournal(tmp_path / "runs.jsonl") as journal:
        for index, row in ROWS.items():
            journal.append(index, row)
    return tmp_path / "runs.jsonl"


def test_rows_are_read_back_as_they_were(path: Path) -> None:
    assert read_rows(path) == ROWS


def test_a_journal_that_is_cut_anywhere_goes_on(path: Path) -> None:
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        with SweepJournal(path) as journal:
            kept: dict[int, Row] = {index: ROWS[index] for index in (0,) if size >= len(lines[0])}
            assert journal.finished == {*kept}
            journal.append(1, {"holds": False})
            assert journal.finished == {*kept, 1}
            assert journal.rows() == kept | {1: {"holds": False}}


def test_a_line_that_cannot_be_read_is_as_if_its_run_were_not_flown(path: Path) -> None:
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b'{"run": "x"}\n' + b"\0\0\0\n" + NESTED + b"\n" + lines[1])
    assert read_rows(path) == {2: ROWS[2]}


def test_a_plan_that_cannot_be_read_is_bad_input(tmp_path: Path) -> None:
    for content in (b"{", NESTED):
        (tmp_path / PLAN).write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            SweepFolder(tmp_path).read()


def test_one_sweep_at_a_time_writes(path: Path) -> None:
    with SweepJournal(path), pytest.raises(InputError, match="another sweep"):
        SweepJournal(path)
    SweepJournal(path)


def test_a_folder_takes_another_sweep_only_while_no_run_is_finished(tmp_path: Path) -> None:
    folder = SweepFolder(tmp_path / "results")
    plans = [planned("case2", (), seeds, {}, None)[0] for seeds in ((0,), (0, 1))]
    folder.opened("case2", plans[0])
    with folder.opened("case2", plans[1]) as journal:
        journal.append(1, {"holds": True})
    assert folder.read() == (plans[1], {1: {"holds": True}})
    with pytest.raises(InputError, match="differs in: seeds"):
        folder.opened("case2", plans[0])
