"""Every command of the command line on what is installed: exit codes, and the documented keys with `--json`.

The drill: `tests/wire/security/test_hostile_folder.py`; the flight for identification: `tests/wire/test_excite.py`.
"""

import json
import os
import stat
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.support.hostile_modules import imported, write_modules
from tests.support.result_keys import OUTPUT_KEYS
from tests.support.verb_runs import (
    AFTER,
    ALONE,
    BESIDE,
    BESIDE_STUBS,
    DRILL,
    EXCITE,
    EXCITED,
    FLIGHT,
    START,
    STUBS,
    Ran,
    beside,
    commands,
    fault,
    finished,
    finished_in_turn,
    write_missions,
)

ALL = (*ALONE, DRILL, EXCITE, *EXCITED, STUBS, *BESIDE_STUBS, FLIGHT, *BESIDE, AFTER)


def test_every_command_is_run_and_with_json_where_it_has_it() -> None:
    assert {run.command: bool(run.keys) for run in ALL} == commands()


def test_other_codes_keys_and_tracebacks_are_faults() -> None:
    good = json.dumps(dict.fromkeys(OUTPUT_KEYS["start"].split()))
    assert fault(START, 0, good, "") == ""
    assert "3" in fault(START, 3, good, "")
    assert "JSON" in fault(START, 0, "started", "")
    assert "vehicles" in fault(START, 0, good.replace("vehicles", "drones"), "")
    assert fault(START, 0, good, "Traceback (most recent call last):")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of missions from elsewhere, whose modules no process may import."""
    made = tmp_path_factory.mktemp("verbs")
    write_missions(made)
    write_modules(made)
    return made


def judge(ran: Sequence[Ran], folder: Path, subtests: pytest.Subtests) -> None:
    for each in ran:
        with subtests.test(command=each.run.command):
            assert each.fault == "", each.err
    assert imported(folder) == ""


@pytest.mark.wire
@pytest.mark.long
def test_commands_that_run_alone(folder: Path, subtests: pytest.Subtests) -> None:
    ran = finished_in_turn([run for run in ALONE if not run.lasts], folder)
    judge([*ran, *(finished(run, folder) for run in ALONE if run.lasts)], folder, subtests)


@pytest.mark.wire
def test_commands_beside_stubs(folder: Path, subtests: pytest.Subtests) -> None:
    judge(list(beside(STUBS, BESIDE_STUBS, folder)), folder, subtests)


@pytest.mark.wire
def test_commands_beside_a_flight_and_on_its_log(folder: Path, subtests: pytest.Subtests) -> None:
    before = os.umask(0o022)
    try:
        ran = [*beside(FLIGHT, BESIDE, folder), finished(AFTER, folder)]
    finally:
        os.umask(before)
    judge(ran, folder, subtests)
    assert stat.S_IMODE((folder / "fly.mcap").stat().st_mode) == 0o600
