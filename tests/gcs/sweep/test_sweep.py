"""Flying a sweep with workers that die, by workers whose futures this test ends itself."""

from collections import Counter
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from functools import partial
from pathlib import Path

import pytest

from gcs.sweep.columns import Row
from gcs.sweep.folder import SweepJournal
from gcs.sweep.plan import SweepPlan, SweepTask, Tasks, planned
from gcs.sweep.sweep import TRIES, PlannedFlights, WorkersError, fly_missing
from gcs.sweep.workers import Task, UnlikeWorkerError, flown


class DeathError(Exception):
    pass


class FakeWorkers:
    """Three workers that answer at once; `outcome` raises what ends a run, by its seed and how often it was tried."""

    at_once = 3
    losses = (DeathError,)

    def __init__(self, outcome: Callable[[int, int], Row]) -> None:
        self.tries: Counter[int] = Counter()
        self._outcome = outcome

    def submit(self, task: Task) -> "Future[Row]":
        assert isinstance(task, partial)
        seed = task.args[0].seed
        self.tries[seed] += 1
        future: Future[Row] = Future()
        try:
            future.set_result(self._outcome(seed, self.tries[seed]))
        except Exception as error:
            future.set_exception(error)
        return future

    def close(self) -> None:
        pass


@pytest.fixture
def plan() -> SweepPlan:
    return planned("case2", (), tuple(range(8)), {}, None)[0]


def fly(
    plan: SweepPlan, folder: Path, workers: FakeWorkers, interrupted: Callable[[], bool] = lambda: False
) -> list[Row]:
    finished: list[Row] = []
    with SweepJournal(folder / "runs.jsonl") as journal:
        fly_missing(PlannedFlights(plan), journal, workers, finished.append, interrupted)
    return finished


def lines(folder: Path) -> int:
    return (folder / "runs.jsonl").read_bytes().count(b"\n")


def test_a_run_whose_worker_died_is_flown_again_and_kept_once(plan: SweepPlan, tmp_path: Path) -> None:
    def outcome(seed: int, tries: int) -> Row:
        if seed in (2, 7) and tries < TRIES:
            raise DeathError
        return {"closest_approach_m": float(seed)}

    workers = FakeWorkers(outcome)
    rows = fly(plan, tmp_path, workers)
    assert sorted(float(row["closest_approach_m"]) for row in rows) == list(range(8))
    assert workers.tries == {seed: TRIES if seed in (2, 7) else 1 for seed in range(8)}
    assert lines(tmp_path) == 8


def test_a_run_under_which_every_worker_dies_fails(plan: SweepPlan, tmp_path: Path) -> None:
    def outcome(seed: int, _tries: int) -> Row:
        if seed == 5:
            raise DeathError
        return {"holds": True}

    rows = fly(plan, tmp_path, FakeWorkers(outcome))
    assert [row["error"] for row in rows if "error" in row] == [f"its worker process died {TRIES} times"]
    assert len(rows) == 8


def test_what_is_finished_is_kept_when_the_sweep_ends_early(plan: SweepPlan, tmp_path: Path) -> None:
    for error in (CancelledError(), UnlikeWorkerError("other numpy"), ModuleNotFoundError("gcs"), KeyboardInterrupt()):

        def outcome(seed: int, _tries: int, error: BaseException = error) -> Row:
            if seed == 7 and isinstance(error, Exception):
                raise error
            return {"holds": True}

        workers, folder = FakeWorkers(outcome), tmp_path / type(error).__name__
        folder.mkdir()
        with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else WorkersError):
            fly(plan, folder, workers, lambda: isinstance(error, KeyboardInterrupt) and workers.tries.total() > 5)  # noqa: B023
        kept = lines(folder)
        assert 3 <= kept < 8
        again = FakeWorkers(lambda _seed, _tries: {"holds": True})
        fly(plan, folder, again)
        assert (again.tries.total(), lines(folder)) == (8 - kept, 8)


def test_a_run_that_raises_is_a_row_and_unlike_workers_fly_nothing(plan: SweepPlan) -> None:
    task = Tasks(plan).of(plan.runs[0])
    broken = SweepTask("", {}, 0, 1.0, task.versions)
    assert "mission: this section is missing" in str(flown(broken)["error"])
    endless = SweepTask(task.mission_text, task.profile_texts, 0, -1.0, task.versions)
    assert str(flown(endless)["error"]).startswith("ValueError: ")
    other = SweepTask(task.mission_text, task.profile_texts, 0, 1.0, {**task.versions, "numpy": "0.1"})
    with pytest.raises(UnlikeWorkerError, match=r"numpy .* instead of 0\.1"):
        flown(other)
