"""Sweeps with users' planners: what is imported where, and what becomes of another source."""

import sys
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import msgspec
import pytest

from gcs.errors import InputError
from gcs.mission.planner import VARIABLE
from gcs.sweep.columns import Row
from gcs.sweep.plan import SweepPlan, Tasks, planned
from gcs.sweep.summary import worst_cases
from gcs.sweep.variation import variation
from gcs.sweep.workers import UnlikeWorkerError, _imported, flown

MINE, OTHER = "mine_of_a_sweep:Mine", "other_of_a_sweep:Other"
SOURCE = """
class {name}:
    def __init__(self, config):
        pass

    def plan(self, task):
        {body}
"""


@pytest.fixture(autouse=True)
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Write the planners' modules; forget what was imported, as in a process that begins."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.syspath_prepend(str(tmp_path))
    write(tmp_path, MINE, "return None")
    write(tmp_path, OTHER, "raise ZeroDivisionError('no plan')")
    forget()
    yield
    forget()


def write(folder: Path, planner: str, body: str) -> str:
    """Write a planner's module, and return its digest."""
    module, _, name = planner.partition(":")
    path = folder / f"{module}.py"
    path.write_text(SOURCE.format(name=name, body=body))
    return sha256(path.read_bytes()).hexdigest()[:16]


def forget() -> None:
    _imported.cache_clear()
    for planner in (MINE, OTHER):
        sys.modules.pop(planner.partition(":")[0], None)


def plan_of(values: str, *, allowed: bool = True) -> SweepPlan:
    given = [variation(f"mission.planner={values}")]
    return planned("case1", given, (), {}, 2.0, allow_plugins=allowed)[0]


def test_no_planner_is_imported_that_is_not_allowed_and_all_faults_are_named() -> None:
    with pytest.raises(InputError) as refused:
        plan_of(f"cordon,{MINE},{OTHER}", allowed=False)
    assert [MINE in fault or OTHER in fault for fault in refused.value.faults] == [True, True]
    assert "--allow-plugins" in refused.value.faults[0]
    assert MINE.partition(":")[0] not in sys.modules, "nothing was imported"
    with pytest.raises(InputError, match=r"nowhere:Planner.*PYTHONPATH"):
        plan_of(f"cordon,{MINE},nowhere:Planner")
    task = Tasks(plan_of(MINE)).of(plan_of(MINE).runs[0])
    forget()
    assert "error" in flown(msgspec.structs.replace(task, planners={})), "a task names what is allowed"
    assert MINE.partition(":")[0] not in sys.modules


def test_a_sweep_has_the_digests_of_its_planners_and_goes_on_with_no_other(tmp_path: Path) -> None:
    first, digest = plan_of(f"cordon,{MINE}"), write(tmp_path, MINE, "return None")
    assert first.planners == {MINE: digest}
    forget()
    changed = write(tmp_path, MINE, "return None  # as before")
    second = plan_of(f"cordon,{MINE}")
    assert second.planners == {MINE: changed}
    assert first.differences(second) == ["sources of planners"]


def test_a_worker_flies_its_planner_only_from_the_source_of_the_sweep(tmp_path: Path) -> None:
    plan = plan_of(f"cordon,{MINE},{OTHER}")
    cordons, mine, other = map(Tasks(plan).of, plan.runs)
    assert "error" not in flown(cordons)
    assert "error" not in flown(mine)
    assert str(flown(other)["error"]).startswith("planner: vehicle 1, 0.0 s: ZeroDivisionError: no plan")
    write(tmp_path, MINE, "raise ValueError")
    assert "error" not in flown(mine), "what was imported is still what flies"
    forget()
    changed = write(tmp_path, MINE, "raise ValueError('no plan either')")
    with pytest.raises(UnlikeWorkerError, match=f"{MINE} of source {changed} instead of {plan.planners[MINE]}"):
        flown(mine)
    forget()
    (tmp_path / "mine_of_a_sweep.py").unlink()
    with pytest.raises(UnlikeWorkerError, match=f"{MINE}.*ModuleNotFoundError"):
        flown(mine)


def test_commands_allow_the_planners_of_their_runs() -> None:
    plan = plan_of(f"cordon,{MINE}")
    rows: dict[int, Row] = {0: {"error": "one"}, 1: {"error": "two"}}
    ends = [case.command.endswith("--allow-plugins") for case in worst_cases(plan, rows, (), "case1", 2)]
    assert ends == [False, True]
    fixed = planned("case1", (), (0,), {"mission.planner": MINE}, 2.0, allow_plugins=True)[0]
    (case,) = worst_cases(fixed, {0: {"error": "one"}}, (), "case1", 2)
    assert case.command.endswith(f"--set mission.planner={MINE} --seed 0 --duration 2 --allow-plugins")
