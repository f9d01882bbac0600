"""Users' planners: what loads them, what a log holds of them, and their replay."""

import sys
from collections.abc import Callable, Iterator
from math import atan2, pi, tau
from pathlib import Path

import numpy as np
import pytest

import cordon
from estimation.state import Vector
from gcs.flight.plan import FlightPlan
from gcs.flightlog.reader import read_log
from gcs.mission.file import load_mission
from gcs.mission.planner import VARIABLE, given_planner, named_planner
from gcs.replay.cores import replay
from gcs.report.evidence.reading import read_flight
from gcs.report.tables import value_table
from tests.support.flight_logs import engaging
from tests.support.paths import DOCS

EXAMPLE, OTHER = "cyclic_pursuit:CyclicPursuit", "nmpc:Nmpc"


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(DOCS / "examples" / "planners"))
    yield
    for name in ("cyclic_pursuit", "nmpc"):
        sys.modules.pop(name, None)


@pytest.mark.slow
@pytest.mark.parametrize("name", [EXAMPLE, OTHER])
def test_the_examples_meet_c1_to_c3_on_perturbed_plants(name: str) -> None:
    axis = cordon.PlantAxis
    plants = {1: cordon.Plant(axis(0.95, 0.8), axis(0.7, 1.0)), 3: cordon.Plant(axis(0.7, 0.95), axis(0.9, 0.8), 0.05)}
    flight = cordon.simulate(
        cordon.load("case2", {"target.start_m": [14.0, -5.0]}),
        duration_s=150.0,
        plants=plants,
        planner=named_planner(name, allowed=True).factory,
    )
    verdicts = flight.metrics.verdicts
    assert (verdicts.c1, verdicts.c2, verdicts.c3, verdicts.separation) == (True, True, True, True)
    bearings_rad = {each.vehicle_id: bearing_rad(flight, each.position_m[-1]) for each in flight.vehicles.values()}
    for vehicle_id, channels in flight.vehicles.items():
        # What its planner saw is what there was; estimates differ from the truth by little.
        others = [rad for other, rad in bearings_rad.items() if other != vehicle_id]
        ahead_rad = [(rad - bearings_rad[vehicle_id]) % tau for rad in others]
        seen = {"gap_rad": min(ahead_rad), "lag_rad": sum(ahead_rad) / 2.0 - pi}
        shown = {key: values[-1] for key, values in channels.values.items() if key in seen}
        assert shown
        assert shown == pytest.approx({key: seen[key] for key in shown}, abs=0.05)


def bearing_rad(flight: cordon.Flight, position_m: Vector) -> float:
    x, y = position_m - flight.record.target_position_m[-1]
    return atan2(y, x)


def pursuit() -> Callable[[cordon.AgentConfig], cordon.TaskPlanner]:
    return named_planner(EXAMPLE, allowed=True).factory


def test_a_logged_flight_is_replayed_bit_for_bit_and_holds_planner_and_values(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    mission = engaging()
    flown = cordon.simulate(mission, duration_s=20.0, log=path, planner=pursuit())
    log = read_log(path)
    again = replay(log, planner=named_planner(EXAMPLE, allowed=True))
    assert again.same
    assert again.other_versions == ()
    assert {each.identical for each in again.vehicles} == {201}
    assert not replay(log).same, "cordon's own planner decides otherwise"
    read = cordon.read(path)
    for vehicle_id, channels in flown.vehicles.items():
        assert set(channels.values) == {"gap_rad", "rate_rad_s"}
        assert np.isfinite(channels.values["gap_rad"][channels.tactic == "encircle"]).any()
        for name, values in channels.values.items():
            np.testing.assert_array_equal(read.vehicles[vehicle_id].values[name], values)
    assert "values.gap_rad" in flown.vehicles[1].columns()
    evidence = read_flight([log]).evidence
    assert evidence.facts["planner"].startswith(f"{EXAMPLE}, source ")
    rows = {(row[0], row[1]): row[2:] for row in value_table(evidence).rows}
    seen = flown.vehicles[2].values["gap_rad"]
    figures = (np.nanmin(seen), np.nanmean(seen), np.nanmax(seen), seen[-1])
    assert rows["2", "gap_rad"] == tuple(f"{each:.4g}" for each in figures)


def test_another_source_of_a_replayed_planner_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, module = tmp_path / "flight.mcap", tmp_path / "standing.py"
    monkeypatch.syspath_prepend(str(tmp_path))
    module.write_text("class Standing:\n    def __init__(self, config): pass\n    def plan(self, task): return None\n")
    cordon.simulate("case1", duration_s=2.0, log=path, planner=named_planner("standing:Standing", allowed=True).factory)
    module.write_text(module.read_text() + "# changed\n")
    (other,) = replay(read_log(path), planner=named_planner("standing:Standing", allowed=True)).other_versions
    assert "planner standing:Standing" in other


def test_a_mission_names_a_planner_that_is_flown_only_where_it_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    mission = engaging().replace(mission={"planner": EXAMPLE})
    with pytest.raises(cordon.InputError, match=f"{EXAMPLE}.*--allow-plugins or {VARIABLE}=1"):
        cordon.simulate(mission, duration_s=2.0)
    assert "cyclic_pursuit" not in sys.modules, "nothing was imported"
    monkeypatch.setenv(VARIABLE, "1")
    by_name = cordon.simulate(mission, duration_s=20.0)
    given = cordon.simulate(engaging(), duration_s=20.0, planner=pursuit())
    np.testing.assert_array_equal(by_name.vehicles[2].position_m, given.vehicles[2].position_m)
    with pytest.raises(cordon.InputError, match="does not fly"):
        FlightPlan(mission, 1.0, mission.vehicles, 1.0)


def test_a_planner_is_part_of_a_missions_identity_only_where_it_is_named() -> None:
    plain, own = load_mission("case2"), load_mission("case2", {"mission.planner": EXAMPLE})
    assert load_mission("case2", {"mission.planner": "cordon"}).identity == plain.identity
    assert own.identity != plain.identity


class Planning:
    """Returns anything."""

    def __init__(self, plan: Callable[[cordon.Task], object]) -> None:
        self._plan = plan

    def plan(self, task: cordon.Task) -> object:
        return self._plan(task) if task.situation.now_s > 0.95 else None


def at_rest(**more: object) -> Callable[[cordon.Task], cordon.Plan]:
    return lambda _: cordon.Plan((1.0, 2.0), (1.0, 2.0), (0.0, 0.0), **more)  # type: ignore[arg-type]


def fails(_: cordon.Task) -> object:
    raise ZeroDivisionError("no plan")


def changing(task: cordon.Task) -> object:
    return at_rest(values={"a" if task.situation.now_s < 1.05 else "b": 1.0})(task)


@pytest.mark.parametrize(
    ("plan", "facts"),
    [
        (fails, ("vehicle 1, 1.0 s", "ZeroDivisionError: no plan")),
        (lambda _: (1.0, 2.0), ("vehicle 1, 1.0 s", "(1.0, 2.0)", "cordon.Plan")),
        (at_rest(values={"a": float("nan")}), ("vehicle 1, 1.0 s", "values['a']", "nan")),
        (at_rest(values={"a b": 1.0}), ("vehicle 1, 1.0 s", "'a b'")),
        (changing, ("vehicle 1, 1.1 s", "'a', 'b'")),
    ],
)
def test_a_fault_of_a_planner_names_vehicle_and_time(plan: Callable[..., object], facts: tuple[str, ...]) -> None:
    with pytest.raises(cordon.InputError) as raised:
        cordon.simulate("case1", duration_s=2.0, planner=lambda _: Planning(plan))  # type: ignore[arg-type,return-value]
    for fact in facts:
        assert fact in str(raised.value)


def test_a_plan_may_hold_tuples() -> None:
    flown = cordon.simulate("case1", duration_s=2.0, planner=lambda _: Planning(at_rest()))  # type: ignore[arg-type,return-value]
    assert np.isfinite(flown.vehicles[1].setpoint_m[-1]).all()


def test_values_are_kept_where_the_slew_limit_or_the_guard_moves_the_aim() -> None:
    """All are sent to one place at once, far from where they are."""
    flown = cordon.simulate("case1", duration_s=6.0, planner=lambda _: Planning(at_rest(values={"a": 1.0})))  # type: ignore[arg-type,return-value]
    assert flown.record.guard is not None
    assert flown.record.guard.interventions > 0
    for channels in flown.vehicles.values():
        np.testing.assert_array_equal(channels.values["a"][10:], 1.0)


def test_what_makes_no_planner_is_named(subtests: pytest.Subtests) -> None:
    for given, fact in ((Planning(fails), "instance"), (int, "no method plan"), ("x:Y", "give a class")):
        with subtests.test(fact), pytest.raises(cordon.InputError, match=fact):
            given_planner(given)
    for name, fact in (("nowhere:Planner", "PYTHONPATH"), ("cyclic_pursuit:Other", "Other"), ("other", "entry point")):
        with subtests.test(name), pytest.raises(cordon.InputError, match=fact):
            named_planner(name, allowed=True)
    with pytest.raises(cordon.InputError, match=r"vehicle 1.*no method plan"):
        cordon.simulate("case1", duration_s=1.0, planner=lambda _: 3)  # type: ignore[arg-type,return-value]
