from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.mission.overrides import overridden
from gcs.sweep.plan import SweepPlan, Tasks, planned
from gcs.sweep.variation import Variation, variation
from tests.support.paths import MISSIONS, PROFILES

RADII = Variation("encirclement.radius_m", (8, 12))
SHAPES = Variation("formation.shape", ("line", "wedge"))


def plan_of(*variations: Variation, seeds: tuple[int, ...] = (0, 1), mission: str = "case2") -> SweepPlan:
    return planned(mission, variations, seeds, {}, None)[0]


def test_runs_are_the_product_of_values_and_seeds() -> None:
    runs = plan_of(RADII, SHAPES).runs
    assert [(*run.values.values(), run.seed) for run in runs] == [
        (radius, shape, seed) for radius in (8, 12) for shape in ("line", "wedge") for seed in (0, 1)
    ]
    assert [run.index for run in runs] == list(range(8))


def test_without_seeds_the_missions_own_is_flown() -> None:
    plan, _ = planned("case2", (), (), {"mission.seed": 5}, None)
    assert plan.seeds == (5,)


def test_text_and_profiles_are_fixed_when_the_sweep_is_planned(tmp_path: Path) -> None:
    text = (MISSIONS / "case2.toml").read_text().replace("id = 1\n", 'id = 1\nprofile = "own.toml"\n')
    mission, profile = tmp_path / "mission.toml", tmp_path / "own.toml"
    mission.write_text(text)
    profile.write_text((PROFILES / "stub.toml").read_text())
    plan = plan_of(RADII, mission=str(mission))
    of_plan = Tasks(plan)
    tasks = [of_plan.of(run) for run in plan.runs]
    assert [task.mission_text for task in tasks] == [
        overridden(text, {RADII.place: radius}) for radius in RADII.values for _ in plan.seeds
    ]
    assert all(task.profile_texts["own.toml"] == profile.read_text() for task in tasks)
    profile.unlink()
    mission.unlink()
    assert [Tasks(plan).of(run) for run in plan.runs] == tasks  # as a sweep that continues


def test_runs_without_a_valid_mission_are_known_beforehand() -> None:
    _, faults = planned("case2", [Variation("encirclement.radius_m", (-1, 8, "x"))], (0, 1), {}, None)
    assert sorted(faults) == [0, 1, 4, 5]
    assert "greater than 0 (given: -1)" in faults[1]
    assert "'x'" in faults[4]


def test_a_sweep_that_cannot_be_is_refused(subtests: pytest.Subtests) -> None:
    for vary, fixed, seeds, duration_s, named in (
        (("encirclement.radios_m=8:16:2",), {}, (), None, "did you mean 'radius_m'"),
        (("encirclement.radius_m=-2:0",), {}, (), None, "encirclement.radius_m: it must be greater than 0"),
        (("vehicles[9].id=4,5",), {}, (), None, r"vehicles\[9\].id: there is no \[9\]"),
        (("encirclement.radius_m=8", "encirclement.radius_m=9"), {}, (), None, "given twice"),
        (("encirclement.radius_m=8",), {"encirclement.radius_m": 9}, (), None, "--set"),
        (("mission.seed=1,2",), {}, (), None, "--seeds"),
        ((), {"mission.seed": 4}, (1,), None, "--seeds"),
        (("mission.duration_s=10,20",), {}, (), 5.0, "--duration"),
    ):
        with subtests.test(vary=vary, named=named), pytest.raises(InputError, match=named):
            planned("case2", [variation(given) for given in vary], seeds, fixed, duration_s)


def test_plans_differ_in_what_they_fly() -> None:
    plan = plan_of(RADII)
    assert plan.differences(plan_of(Variation("encirclement.radius_m", (8, 12)))) == []
    assert plan.differences(plan_of(SHAPES, seeds=(3,), mission="case1")) == ["mission text", "varied values", "seeds"]
