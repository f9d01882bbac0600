"""The folder of a sweep: its plan, its journal, a copy of its mission and profiles, and its table.

The journal of a sweep: one line for each finished run, flushed to disk before the next one is written.

A killed process leaves at most its last line incomplete. Runs whose lines cannot be read are flown again.
"""

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from estimation.input_file import open_plain
from estimation.profile.profile import bundled_profiles
from gcs.errors import InputError
from gcs.keys.private_files import FOLDER_MODE, create
from gcs.mission.file import bundled_missions
from gcs.sweep.columns import Row
from gcs.sweep.plan import SweepPlan


class _Line(msgspec.Struct):
    run: int
    row: Row


_DECODER = msgspec.json.Decoder(_Line)


def read_rows(path: Path) -> dict[int, Row]:
    """Return the rows of a journal by run index; raises OSError."""
    rows: dict[int, Row] = {}
    with open_plain(path) as file:
        lines = file.read().splitlines()
    for line in lines:
        try:
            read = _DECODER.decode(line)
        except (msgspec.MsgspecError, RecursionError):
            continue
        rows[read.run] = read.row
    return rows


class SweepJournal:
    """A journal to append to, as a context manager, locked by one process at a time.

    `finished` are the indexes of its runs. Their rows stay in the file: those of 10 000 runs take 55 MB of memory.
    Raises InputError if another process has locked it, OSError if it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file = create(path, "ab")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._file.close()
            raise InputError([f"{path}: another sweep writes to it; end that sweep, or wait for it"]) from error
        whole = path.read_bytes().rfind(b"\n") + 1
        self._file.truncate(whole)  # removes an incomplete last line
        self._path, self.finished = path, set(read_rows(path))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def append(self, run: int, row: Row) -> None:
        """Append a finished run; raises OSError if it cannot be written."""
        self.finished.add(run)
        self._file.write(msgspec.json.encode(_Line(run, row)) + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def rows(self) -> dict[int, Row]:
        """Return the rows of the finished runs by run index; raises OSError."""
        return read_rows(self._path)


PLAN, JOURNAL, TABLE, MISSION = "sweep.json", "runs.jsonl", "runs.parquet", "mission"


class _Stored(msgspec.Struct):
    mission: str
    plan: SweepPlan


class SweepFolder:
    """A folder that holds one sweep."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def table(self) -> Path:
        """The path of the table."""
        return self.path / TABLE

    def opened(self, mission: str, plan: SweepPlan) -> SweepJournal:
        """Return the journal of a new or continued sweep; raises InputError if the folder holds another sweep.

        A folder without finished runs accepts any sweep.
        """
        try:
            self.path.mkdir(FOLDER_MODE, parents=True, exist_ok=True)
            journal = SweepJournal(self.path / JOURNAL)
            if journal.finished:
                self._require_same(plan)
            else:
                self._keep(mission, plan)
        except OSError as error:
            raise InputError([f"--out: {self.path}: {error.strerror or error}"]) from error
        return journal

    def read(self) -> tuple[SweepPlan, dict[int, Row]]:
        """Return the plan, and the rows of the finished runs by run index; raises InputError."""
        plan = self._stored().plan
        try:
            rows = read_rows(self.path / JOURNAL)
        except OSError as error:
            raise InputError([f"{self.path / JOURNAL}: {error.strerror or error}"]) from error
        return plan, {index: row for index, row in rows.items() if index < len(plan.runs)}

    def mission(self) -> str:
        """Return the mission for repeated flights: a bundled one's name, or the sweep's copy; raises InputError."""
        given = self._stored().mission
        return given if given in bundled_missions() else str(self.path / MISSION / Path(given).name)

    def _stored(self) -> _Stored:
        path = self.path / PLAN
        try:
            with open_plain(path) as file:
                return msgspec.json.decode(file.read(), type=_Stored)
        except OSError as error:
            raise InputError(
                [f"{path}: {error.strerror or error}; `cordon sweep --out` creates such a folder"]
            ) from error
        except (msgspec.MsgspecError, RecursionError) as error:
            raise InputError([f"{path}: damaged: {error}; repeat the sweep in another folder"]) from error

    def _require_same(self, plan: SweepPlan) -> None:
        """Raise InputError if the folder holds another sweep."""
        if different := self._stored().plan.differences(plan):
            raise InputError(
                [
                    f"--out: {self.path} holds another sweep, which differs in: {', '.join(different)}; use another "
                    f"folder, or continue that sweep with its mission, {self.mission()}"
                ]
            )

    def _keep(self, mission: str, plan: SweepPlan) -> None:
        """Write the mission and its profiles, and last the plan: if there is a plan, the others are complete."""
        if mission not in bundled_missions():
            own = {name: text for name, text in plan.profile_texts.items() if name not in bundled_profiles()}
            for name, text in (own | {Path(mission).name: plan.mission_text}).items():
                path = self.path / MISSION / name
                path.parent.mkdir(FOLDER_MODE, parents=True, exist_ok=True)
                with create(path) as file:
                    file.write(text.encode())
        write_whole(self.path / PLAN, msgspec.json.format(msgspec.json.encode(_Stored(mission, plan))))


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically; raises OSError."""
    partial = path.with_name(f".{path.name}.part")
    with create(partial) as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
