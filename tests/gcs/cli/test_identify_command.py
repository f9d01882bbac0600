"""`cordon identify` as users and scripts meet it: files, exit codes, tables, JSON, a plant file and a page."""

import json
import re
from dataclasses import replace
from datetime import date
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from estimation.plant.model import COVARIANCE_OF, PlantGrade
from estimation.profile.profile import LimitsSection, ProfileLibrary
from estimation.settings import OwnFilterSettings
from estimation.state import Vector
from gcs.mission.file import excitation_mission
from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import ModeSegment, Series, Span, VehicleLog
from tests.conftest import Ran, RunHere
from tests.support.flight_logs import record_simulation
from tests.support.mission_text import content, parsed, put
from tests.support.paths import DATA
from tests.support.result_keys import OUTPUT_KEYS
from tests.support.synthetic_flights import Truth, recorded

pytestmark = pytest.mark.slow

TRUTH = Truth((1.5, 1.1), (1.9, 1.6), 0.2)


def log_of(name: str = "flight.ulg", system_id: int = 3, **changes: Any) -> VehicleLog:
    """Return a log as a reader of PX4's would."""
    recording = recorded(TRUTH, 5)
    if changes.pop("fed", False):
        recording = recorded(replace(TRUTH, feedforward=0.9), 5, fed=True)
        assert recording.velocity_m_s is not None
        time_s, velocity = recording.setpoint_time_s, recording.velocity_m_s
        climbing = np.column_stack((velocity, np.zeros(time_s.size)))
        changes["setpoint_velocity"] = Series("trajectory_setpoint", ("x", "y", "z"), time_s, climbing)

    def series(topic: str, time_s: Vector, values: Vector) -> Series:
        return Series(topic, ("x", "y", "z"), time_s, np.column_stack((values, np.full(time_s.size, 8.0))))

    log = VehicleLog(
        path=name,
        format="PX4 log (.ulg)",
        sha256=sha256(name.encode()).hexdigest(),
        autopilot="px4",
        firmware='v1.17 "alpha"',
        system_id=system_id,
        duration_s=150.0,
        setpoint=series("trajectory_setpoint", recording.setpoint_time_s, recording.setpoint_m),
        position=series("vehicle_local_position", recording.position_time_s, recording.position_m),
        modes=(ModeSegment(Span(0.0, 150.0), "offboard", external=True),),
        parameters=MappingProxyType({}),
    )
    return replace(log, **changes)


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_here: RunHere) -> "Runner":
    return Runner(tmp_path, monkeypatch, run_here)


class Runner:
    """Runs the command in this process, on logs that are at hand or in files."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, run_here: RunHere) -> None:
        self.folder, self._patch, self._run_here = folder, patch, run_here
        patch.chdir(folder)

    def hold(self, *logs: VehicleLog) -> None:
        """Let these logs be what files of their names hold."""
        read = read_vehicle_logs
        names = {log.path for log in logs}

        def held(path: Path) -> tuple[VehicleLog, ...]:
            return tuple(log for log in logs if log.path == str(path)) if str(path) in names else read(path)

        self._patch.setattr("gcs.identify.reading.read_vehicle_logs", held)

    def __call__(self, *arguments: str) -> Ran:
        return self._run_here("identify", *arguments)


def test_a_flight_becomes_a_profile_that_flies_and_says_where_it_is_from(ran: Runner) -> None:
    ran.hold(log := log_of())
    text = "delay_s = 0.2\n[x]\na0_per_s2 = 1.5\na1_per_s = 1.9\n[y]\na0_per_s2 = 1.1\na1_per_s = 1.6\n"
    (ran.folder / "truth.toml").write_text(text, encoding="utf-8")
    others = ("--against", "truth.toml", "--against", "stub")
    code, out, err = ran(log.path, "-o", "own.toml", "--json", "--html", "own.html", "--plot", "own.png", *others)
    assert code == 0
    assert (ran.folder / "own.png").read_bytes().startswith(b"\x89PNG")
    assert "verdict: good" in err
    file = ProfileLibrary(ran.folder).load("own.toml")
    origin, result = file.identified, json.loads(out)
    assert origin is not None
    assert list(result) == OUTPUT_KEYS["identify"].split()
    plant = (file.plant.x.a0_per_s2, file.plant.x.a1_per_s, file.plant.y.a0_per_s2, file.plant.y.a1_per_s)
    assert plant == pytest.approx((1.5, 1.9, 1.1, 1.6), rel=0.05)
    assert file.plant.delay_s == pytest.approx(0.2, abs=0.03)
    assert (origin.vehicle, origin.autopilot, origin.firmware) == (3, "px4", 'v1.17 "alpha"')
    assert origin.date == date.today().isoformat()
    assert [(each.name, each.sha256) for each in origin.logs] == [(log.path, log.sha256)]
    assert origin.verdict is PlantGrade.GOOD
    deviations = np.sqrt([origin.covariance[at][at] for at in range(len(COVARIANCE_OF))])
    assert (np.abs(np.subtract((*plant, file.plant.delay_s), (1.5, 1.9, 1.1, 1.6, 0.2))) < 4.0 * deviations).all()
    bundled = ProfileLibrary(ran.folder).load("px4")
    assert (file.autopilot, file.own_filter, file.limits) == ("px4", bundled.own_filter, bundled.limits)
    assert result["verdict"] == "good"
    assert result["plant"]["x"]["a0_per_s2"]["value"] == pytest.approx(plant[0], rel=1e-3)
    assert re.search(rf"a0 \[1/s²\] +{result['plant']['x']['a0_per_s2']['value']:.3f} ", err)
    page = (ran.folder / "own.html").read_text(encoding="utf-8")
    assert page.count('role="img"') == 10
    assert f"{result['plant']['x']['fit_percent']:.1f}" in page
    assert "all checks passed" in page
    against = result["plant"]["others_fit_percent"]
    truth, stub = against["truth.toml"], against["stub"]
    assert min(truth) > 90.0
    assert truth == pytest.approx([result["plant"][axis]["fit_percent"] for axis in "xy"], abs=2.0)
    assert max(stub) < min(truth) - 10.0, "another vehicle"
    told = [rf"of '{name}' \[%\] +{x:.1f} +{y:.1f}" for name, (x, y) in (("truth.toml", truth), ("stub", stub))]
    assert all(re.search(words, err) for words in told), err
    assert f"{stub[0]:.1f}" in page


def test_a_damaged_log_of_an_unknown_autopilot_gives_a_profile_for_any_and_exit_code_one(ran: Runner) -> None:
    ran.hold(log := log_of(is_damaged=True, notes=("damaged: 100 bytes were skipped",), autopilot="simulation"))
    code, out, err = ran(log.path, "-o", "own.toml", "--json")
    assert code == 1
    result = json.loads(out)
    assert (result["verdict"], result["logs"][0]["damaged"]) == ("good", True)
    profile = ProfileLibrary(ran.folder).load("own.toml")
    assert (profile.autopilot, profile.own_filter, profile.limits) == (None, OwnFilterSettings(), LimitsSection())
    assert f"{log.path}: damaged: 100 bytes" in err


def test_an_excitation_with_velocities_becomes_a_plant_file_of_that_kind(ran: Runner) -> None:
    """Flown by a plant file that is 20 to 25 % off; the vehicle feeds 0.8 of what it is sent forward."""
    flying: dict[str, object] = {
        "profile": "stub-feedforward",
        "true_scale": {"a0": 1.2, "a1": 0.75, "feedforward": 0.8},
    }
    mission = put(content(), ("simulation",), {"position_noise_m": 0.03, "velocity_noise_m_s": 0.03})
    for key, value in flying.items():
        mission = put(mission, ("vehicles", 0, key), value)
    excited = excitation_mission(parsed(mission), 1)
    record_simulation(excited, ran.folder / "own.mcap", duration_s=excited.mission.duration_s)
    (read,) = read_vehicle_logs(ran.folder / "own.mcap")
    assert read.setpoint_velocity is not None
    assert read.setpoint is not None
    assert (read.setpoint_velocity.time_s == read.setpoint.time_s).all()
    swept = read.setpoint.time_s > 140.0  # north along the sweeps: what is sent is the setpoint's own velocity
    moved = np.gradient(read.setpoint.values[swept, :2], read.setpoint.time_s[swept], axis=0)
    assert np.median(np.abs(moved - read.setpoint_velocity.values[swept, :2])) < 0.05
    code, out, err = ran("own.mcap", "-o", "own.toml", "--json", "--html", "own.html")
    assert code == 0, err
    file, result = ProfileLibrary(ran.folder).load("own.toml"), json.loads(out)
    assert file.plant.feedforward == pytest.approx(0.8, abs=0.03)
    assert file.plant.x.a0_per_s2 == pytest.approx(1.2 * 0.80, rel=0.05)
    assert file.plant.y.a1_per_s == pytest.approx(0.75 * 0.87, rel=0.05)
    assert result["plant"]["feedforward"]["value"] == pytest.approx(file.plant.feedforward, rel=1e-3)
    assert result["plant"]["covariance_of"][5] == "feedforward"
    assert re.search(rf"feed-forward +{result['plant']['feedforward']['value']:.2f} ", err)
    assert file.identified is not None
    assert file.identified.feeds
    assert (ran.folder / "own.html").read_text(encoding="utf-8").count('role="img"') == 10


def test_a_flight_that_teaches_nothing_ends_in_1_with_the_reason_and_no_file(ran: Runner) -> None:
    wrong = log_of(modes=(ModeSegment(Span(0.0, 150.0), "mission", external=False),))
    ran.hold(wrong)
    code, out, err = ran(wrong.path, "-o", "own.toml", "--json", "--html", "own.html", "--plot", "own.png")
    assert code == 1
    assert "own.png: not written: no plant was found" in err
    assert not (ran.folder / "own.png").exists()
    assert "wrong mode: at no time" in err
    assert json.loads(out)["plant"] is None
    assert not (ran.folder / "own.toml").exists()
    assert "wrong mode: at no time" in (ran.folder / "own.html").read_text(encoding="utf-8")


def test_the_bundled_profile_is_what_the_command_writes(ran: Runner) -> None:
    assert ran(str(DATA / "px4-quad-excitation.ulg"), "-o", "own.toml")[0] == 0
    own, bundled = (ProfileLibrary(ran.folder).load(name) for name in ("own.toml", "px4"))
    assert (own.autopilot, own.limits) == (bundled.autopilot, bundled.limits)
    for found, stored in ((own.plant.x, bundled.plant.x), (own.plant.y, bundled.plant.y)):
        assert (found.a0_per_s2, found.a1_per_s) == pytest.approx((stored.a0_per_s2, stored.a1_per_s), rel=2e-3)
    assert own.plant.delay_s == pytest.approx(bundled.plant.delay_s, rel=2e-3)
    assert own.own_filter.model_dump() == pytest.approx(bundled.own_filter.model_dump(), rel=1e-2)
    assert own.identified is not None
    assert own.identified.delay_spread_s == pytest.approx(0.024, abs=0.005)


def test_a_short_log_of_real_firmware_is_told_to_be_too_short(ran: Runner) -> None:
    code, _, err = ran(str(DATA / "px4-quad.ulg"))
    assert code == 1
    assert "too short: 18 s were flown" in err


REFUSED: dict[tuple[str, ...], str] = {
    ("nowhere.ulg",): "nowhere.ulg: cannot be read: No such file or directory",
    ("a.ulg", "a.ulg"): "a.ulg: given more than once",
    ("a.ulg", "-o", "own.txt"): "--output: 'own.txt' must end in .toml",
    ("a.ulg", "-o", "here.toml"): "--output: 'here.toml' exists already",
    ("a.ulg", "--against", "missing.toml"): "--against: no profile 'missing.toml'",
    ("a.ulg", "--vehicle", "9"): "--vehicle: the logs have no vehicle 9 (they have 3)",
    ("a.ulg", "b.ulg"): "--vehicle: the logs hold vehicles 3, 4; choose one of them",
    ("a.ulg", "c.bin"): "the logs are of different autopilots; identify them separately",
    ("a.ulg", "e.ulg"): (
        "setpoints with and without velocities: identify them separately: "
        "a.ulg: without velocities; e.ulg: with velocities"
    ),
    ("d.ulg",): "d.ulg: vehicle 3: the log has no setpoint; looked for trajectory_setpoint",
}


def test_bad_input_is_told_before_anything_is_done(ran: Runner, subtests: pytest.Subtests) -> None:
    ran.hold(
        log_of("a.ulg"),
        log_of("b.ulg", 4),
        log_of("c.bin", autopilot="ardupilot"),
        log_of("d.ulg", setpoint=None, missing=("trajectory_setpoint",)),
        log_of("e.ulg", fed=True),
    )
    (ran.folder / "here.toml").touch()
    for arguments, complaint in REFUSED.items():
        with subtests.test(arguments=arguments):
            code, out, err = ran(*arguments)
            assert (code, out) == (2, "")
            assert err.startswith(complaint)


def test_one_of_several_vehicles_is_chosen(ran: Runner) -> None:
    ran.hold(log_of("a.ulg"), log_of("b.ulg", 4, modes=()))
    code, _, err = ran("a.ulg", "b.ulg", "--vehicle", "4")
    assert code == 1
    assert "vehicle 4, px4" in err
