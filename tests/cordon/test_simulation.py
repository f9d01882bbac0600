"""Flights that are simulated and read by cordon's functions, with plants, planners and target paths of a user's own."""

import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from math import cos, sin
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import cordon
from agents.control.aims import resting
from sitl.vehicle.plant_step import Motion, Pair
from tests.support.flight_logs import engaging, record_simulation
from tests.support.wire import PATIENCE_S

pytestmark = pytest.mark.slow

PLANT = cordon.Plant(cordon.PlantAxis(0.5, 0.9), cordon.PlantAxis(0.7, 1.1), delay_s=0.15)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("log") / "flight.mcap"


@pytest.fixture(scope="module")
def flight(log: Path) -> cordon.Flight:
    """A flight in noise, with losses, in which all engage one after the other."""
    mission = engaging("case2-field", (("target", "start_m"), [14.0, 0.0]), (("target", "velocity_m_s"), [0.0, 0.0]))
    return cordon.simulate(mission, seed=3, duration_s=40.0, log=log)


def test_metrics_are_those_of_the_command_line() -> None:
    command = [sys.executable, "-m", "cordon", "sim", "case1", "--seed", "5", "--duration", "5", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    flown = cordon.simulate("case1", seed=5, duration_s=5.0)
    assert json.loads(done.stdout) == json.loads(flown.metrics.untimed().to_json())


def test_channels_are_the_same_in_a_simulation_and_in_its_log(flight: cordon.Flight, log: Path) -> None:
    read = cordon.read(log)
    assert read.metrics.untimed() == flight.metrics.untimed()
    assert [*read.vehicles] == [*flight.vehicles] == [1, 2, 3]
    for vehicle_id, channels in flight.vehicles.items():
        logged = read.vehicles[vehicle_id].columns()
        for name, column in channels.columns().items():
            np.testing.assert_array_equal(logged[name], column, err_msg=f"vehicle {vehicle_id}: {name}")


def test_channels_are_of_the_motion_about_the_target(flight: cordon.Flight) -> None:
    for channels in flight.vehicles.values():
        assert channels.time_s.tolist() == pytest.approx(np.arange(401) / 10.0)
        on_ring = channels.tactic == "encircle"
        assert 0 < on_ring.sum() < 401
        off_m = channels.position_m - flight.record.target_position_m
        np.testing.assert_allclose(channels.radius_m[on_ring], np.linalg.norm(off_m, axis=1)[on_ring])
        assert np.isnan(channels.radius_m[~on_ring]).all()
        np.testing.assert_allclose(np.tan(channels.bearing_rad[on_ring]), (off_m[:, 1] / off_m[:, 0])[on_ring])
        error_m = np.linalg.norm(channels.position_estimate_m - channels.position_m, axis=1)
        assert 0.0 < np.sqrt(np.mean(error_m**2)) < 0.2
        off_target_m = channels.target_position_estimate_m - flight.record.target_position_m
        assert np.nanmax(np.abs(off_target_m[-100:])) < 1.0
        assert np.abs(channels.setpoint_m[:, :2] - channels.position_m).max() < 5.0
        assert (channels.tick_us > 0.0).all()
    leads = np.array([channels.lead_rad[-1] for channels in flight.vehicles.values()])
    assert leads.sum() == pytest.approx(2.0 * np.pi)


def test_a_frame_has_a_row_for_each_vehicle_and_time(flight: cordon.Flight) -> None:
    frame = flight.frame()
    assert len(frame) == 3 * 401
    second = frame[frame.vehicle == 2]
    np.testing.assert_array_equal(second.position_y_m, flight.vehicles[2].position_m[:, 1])
    np.testing.assert_array_equal(second.setpoint_velocity_z_m_s, flight.vehicles[2].setpoint_velocity_m_s[:, 2])
    assert {"time_s", "tactic", "lead_rad", "target_velocity_estimate_x_m_s"} < {*frame.columns}


def test_a_frame_without_pandas_says_how_to_install_it(flight: cordon.Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install 'cordon-gcs\[pandas\]'"):
        flight.frame()


def test_a_flight_is_drawn_with_and_without_a_file(flight: cordon.Flight, tmp_path: Path) -> None:
    titles = {axes.get_title(loc="left") for axes in flight.plot().axes}
    written = flight.plot(tmp_path / "flight.svg")
    assert titles == {axes.get_title(loc="left") for axes in written.axes}
    assert (tmp_path / "flight.svg").read_bytes().startswith(b"<?xml")
    for path in (tmp_path / "flight.gif", tmp_path / "gone" / "flight.png"):
        with pytest.raises(cordon.InputError, match=path.name):
            flight.plot(path)


# Own plants, planners and paths


def exact(motion: Motion, aim_m: Pair, push_m_s2: Pair, step_s: float) -> Motion:
    """PLANT by the exponential of its whole matrix, inputs held as two more states."""
    a0, a1 = PLANT.a0_per_s2, PLANT.a1_per_s
    whole = np.zeros((6, 6))
    whole[0:2, 2:4] = np.eye(2)
    whole[2:4, 0:2], whole[2:4, 2:4], whole[2:4, 4:6] = -np.diag(a0), -np.diag(a1), np.eye(2)
    x, y, x_rate, y_rate, _, _ = expm(whole * step_s) @ [*motion, *(a0 * aim_m + push_m_s2)]
    return x, y, x_rate, y_rate


def test_a_plant_and_a_function_that_steps_it_fly_alike_and_not_as_the_profile_does() -> None:
    mission = cordon.load("case1", {"simulation.wind_m_s2": [0.05, -0.03]})
    # The delay of a function's vehicle is that of the plant behind it.
    function = cordon.simulate(mission, duration_s=10.0, plants={2: exact})
    delay_s = mission.vehicle(2).plant.delay_s
    plant = cordon.simulate(mission, duration_s=10.0, plants={2: cordon.Plant(PLANT.x, PLANT.y, delay_s)})
    profile = cordon.simulate(mission, duration_s=10.0)
    paths_m = [each.vehicles[2].position_m for each in (function, plant, profile)]
    np.testing.assert_allclose(paths_m[0], paths_m[1], atol=1e-9)
    assert np.abs(paths_m[1] - paths_m[2]).max() > 0.01


def circle(time_s: float) -> tuple[float, float]:
    return 12.0 + 3.0 * cos(0.2 * time_s), 3.0 * sin(0.2 * time_s)


def test_a_target_flies_along_a_path_which_the_log_has_too(tmp_path: Path) -> None:
    """Of a long flight, every other tick is the end of a chord."""
    mission = cordon.load("case1").replace(
        mission={"rate_hz": 10.0}, formation={"leader": 2}, vehicles=[{"id": 2, "start_m": [0.0, 0.0]}]
    )
    flown = cordon.simulate(mission, duration_s=110.0, target=circle, log=tmp_path / "flight.mcap")
    wanted_m = np.array([circle(time_s) for time_s in flown.record.time_s.tolist()])
    np.testing.assert_allclose(flown.record.target_position_m[::2], wanted_m[::2], atol=1e-9)
    # The sagitta of a chord: between its ends the target is as much off the circle.
    chord_s = 2.0 / 10.0
    np.testing.assert_allclose(flown.record.target_position_m, wanted_m, atol=3.0 * (0.2 * chord_s) ** 2 / 8.0 + 1e-9)
    seen_m = flown.vehicles[2].target_position_estimate_m
    assert np.nanmax(np.abs(seen_m[-50:] - wanted_m[-50:])) < 0.3
    read = cordon.read(tmp_path / "flight.mcap")
    np.testing.assert_array_equal(read.record.target_position_m, flown.record.target_position_m)


def test_a_target_may_rest_on_its_path() -> None:
    flown = cordon.simulate("case1", duration_s=4.0, target=lambda time_s: (max(time_s, 2.0), 1.0))
    wanted_m = np.maximum(flown.record.time_s, 2.0)
    np.testing.assert_allclose(flown.record.target_position_m[:, 0], wanted_m, atol=1e-9)


def test_a_target_that_does_not_react_flies_as_one_along_the_same_path() -> None:
    mission = cordon.load("case1").replace(vehicles={2: {"start_m": [0.0, 0.0]}})
    along = cordon.simulate(mission, duration_s=12.0, target=circle)
    alone = cordon.simulate(mission, duration_s=12.0, target=cordon.ReactingTarget(lambda time_s, _: circle(time_s)))
    np.testing.assert_allclose(alone.record.target_position_m, along.record.target_position_m, atol=1e-9)
    # Central differences of a circle: v sin(w dt) / (w dt), off by v (w dt)²/6; of half a chord at the ends.
    off_m_s = alone.record.target_velocity_m_s[1:-1] - np.array(
        [(-0.6 * sin(0.2 * t), 0.6 * cos(0.2 * t)) for t in alone.record.time_s[1:-1].tolist()]
    )
    assert np.abs(off_m_s).max() < 0.6 * 0.02**2
    for vehicle_id, channels in along.vehicles.items():
        np.testing.assert_allclose(alone.vehicles[vehicle_id].position_m, channels.position_m, atol=1e-9)


def test_a_target_that_reacts_is_called_once_a_tick_with_the_true_team_and_is_in_the_log(tmp_path: Path) -> None:
    called: list[tuple[float, dict[int, Motion]]] = []

    def ahead(time_s: float, team: Mapping[int, Motion]) -> Pair:
        """Keep 8 m ahead of vehicle 2, seen along x."""
        called.append((time_s, dict(team)))
        return team[2][0] + 8.0, 1.0

    target = cordon.ReactingTarget(ahead)
    flown = cordon.simulate("case2-field", seed=2, duration_s=15.0, target=target, log=tmp_path / "flight.mcap")
    record = flown.record
    assert [time_s for time_s, _ in called] == record.time_s.tolist()
    for track in record.vehicles:
        motions = [team[track.vehicle_id] for _, team in called]
        np.testing.assert_array_equal(np.hstack([track.position_m, track.velocity_m_s]), motions)
    np.testing.assert_array_equal(record.target_position_m[:, 0], record.vehicles[1].position_m[:, 0] + 8.0)
    assert np.nanmax(np.abs(flown.vehicles[2].target_position_estimate_m[-1] - record.target_position_m[-1])) < 1.5
    assert flown.mission.target.source == "external"
    read = cordon.read(tmp_path / "flight.mcap")
    np.testing.assert_array_equal(read.record.target_position_m, record.target_position_m)
    assert read.metrics.untimed() == flown.metrics.untimed()


def test_planners_of_others_plan_for_the_vehicles_that_they_are_made_for() -> None:
    place_m = np.array([2.0, 6.0])

    class Waiting:
        def __init__(self, config: cordon.AgentConfig) -> None:
            self._first = config.vehicle_id == 1

        def plan(self, task: cordon.Task) -> cordon.Plan | None:
            return resting(place_m) if self._first else None

    flown = cordon.simulate("case1", duration_s=20.0, planner=Waiting)
    ends_m = {vehicle_id: channels.position_m[-1] for vehicle_id, channels in flown.vehicles.items()}
    np.testing.assert_allclose(ends_m[1], place_m, atol=0.1)
    assert np.linalg.norm(ends_m[2] - place_m) > 3.0


def not_finite(*_: object) -> Motion:
    return 0.0, 0.0, float("nan"), 0.0


def accelerating(motion: Motion, _aim_m: Pair, _push: Pair, step_s: float) -> Motion:
    """The velocity along x doubles in each step of 0.1 s, from 1 m/s: it is 2 ** 10 m/s at 1.1 s."""
    x, y, x_rate, _ = motion
    return x + step_s * x_rate, y, max(1.0, 2.0 * x_rate), 0.0


@pytest.mark.parametrize(
    ("fly", "facts"),
    [
        (lambda: cordon.simulate("case1", duration_s=-1.0, seed=-2), ("duration_s", "-1", "seed", "-2")),
        (lambda: cordon.simulate("case7"), ("case7", "case1")),
        (lambda: cordon.simulate("case1", plants={9: PLANT}), ("plants", "9", "1, 2, 3")),
        (lambda: cordon.simulate("case1", plants={2: not_finite}), ("plants", "vehicle 2", "nan")),
        (lambda: cordon.simulate("case1", target=lambda t: (30.0 * t, 0.0)), ("target", "30 m/s", "20 m/s")),
        (lambda: cordon.simulate("case1", target=lambda _: (1.0,)), ("target", "(1.0,)", "x_m, y_m")),  # type: ignore[arg-type,return-value]
        (lambda: reacting(lambda t, _: (30.0 * t, 0.0)), ("target", "30 m/s at 0 s", "20 m/s")),
        (lambda: reacting(lambda t, _: (t, float("nan") if t > 1.0 else 0.0)), ("target", "at 1.1 s", "nan")),
        (lambda: cordon.simulate("evader", target=circle), ("target", "[target.evades]")),
        (lambda: cordon.simulate("evader", target=cordon.ReactingTarget(lambda _, team: team[1][:2])), ("evades",)),
        (lambda: cordon.read("nothing.mcap"), ("nothing.mcap",)),
        (lambda: cordon.load(3), ("mission", "3")),  # type: ignore[arg-type]
        (lambda: cordon.load("case1", ["a=1"]), ("overrides", "['a=1']")),  # type: ignore[arg-type]
        (lambda: cordon.load("case1", {"vehicles": {9: {"altitude_m": 8.0}}}), ("vehicles", "9", "1, 2, 3")),
        (lambda: cordon.simulate("case1", seed="3"), ("seed", "'3'")),  # type: ignore[arg-type]
        (lambda: cordon.simulate("case1", seed=True), ("seed", "True")),
        (lambda: cordon.simulate("case1", duration_s="3"), ("duration_s", "'3'")),  # type: ignore[arg-type]
        (lambda: cordon.simulate("case1", log=3), ("log", "3")),  # type: ignore[arg-type]
        (lambda: cordon.simulate("case1", target=(3.0, 4.0)), ("target", "(3.0, 4.0)", "ReactingTarget")),  # type: ignore[arg-type]
        (lambda: cordon.simulate("case1", plants=PLANT), ("plants", "PlantAxis", "{1: plant}")),  # type: ignore[arg-type]
        (lambda: cordon.simulate("case1", plants={2: None}), ("plants", "vehicle 2", "None", "cordon.Plant")),  # type: ignore[dict-item]
        (lambda: cordon.simulate("case1", plants={2: accelerating}), ("plants", "vehicle 2", "1.10 s", "diverged")),
        (lambda: cordon.simulate("case1", log="/nowhere/a.mcap"), ("log: '/nowhere/a.mcap'",)),
    ],
)
def test_bad_input_is_named(fly: Callable[[], object], facts: tuple[str, ...]) -> None:
    with pytest.raises(cordon.InputError) as raised:
        fly()
    for fact in facts:
        assert fact in str(raised.value)


def test_overrides_may_be_nested_as_in_replace() -> None:
    loaded = cordon.load("case1", {"encirclement": {"radius_m": 12.0}, "vehicles": {2: {"altitude_m": 9.0}}})
    replaced = cordon.load("case1").replace(encirclement={"radius_m": 12.0}, vehicles={2: {"altitude_m": 9.0}})
    assert (loaded.encirclement.radius_m, loaded.vehicle(2).section.altitude_m) == (12.0, 9.0)
    assert loaded == replaced


def test_a_mission_has_the_teams_decision() -> None:
    mission = cordon.load("case2", {"decision": {"threat_max": 0.3}, "vehicles[1].decision.threat_max": 0.4})
    assert mission.decision.threat_max == 0.3
    assert [vehicle.decision.threat_max for vehicle in mission.vehicles] == [0.3, 0.4, 0.3]


def test_a_plants_axes_are_plant_axes() -> None:
    with pytest.raises((ValueError, TypeError), match="PlantAxis"):  # compiled, the type is checked first
        cordon.Plant((0.8, 0.9), (0.8, 0.9))  # type: ignore[arg-type]


def reacting(position: Callable[[float, Mapping[int, Motion]], Pair]) -> cordon.Flight:
    return cordon.simulate("case1", duration_s=3.0, target=cordon.ReactingTarget(position))


def test_a_log_that_is_there_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "flight.mcap").write_text("mine")
    with pytest.raises(cordon.InputError, match=r"flight\.mcap"):
        cordon.simulate("case1", duration_s=2.0, log=tmp_path / "flight.mcap")
    assert (tmp_path / "flight.mcap").read_text() == "mine"


def test_the_faults_of_a_log_are_warnings(tmp_path: Path) -> None:
    log = tmp_path / "flight.mcap"
    record_simulation(engaging(), log, duration_s=5.0, flush_s=1.0)
    log.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    with pytest.warns(UserWarning, match=r"flight\.mcap: it was never closed") as warned:
        cordon.read(log)
    assert {Path(each.filename).name for each in warned} == {"test_simulation.py"}, "they point to the call"


def test_a_path_is_of_one_target() -> None:
    for target in (lambda _: (1.0, 2.0), cordon.ReactingTarget(lambda _, __: (1.0, 2.0))):
        with pytest.raises(cordon.InputError, match="2 targets"):
            cordon.simulate("two-targets", duration_s=1.0, target=target)
