"""`cordon check` against stub vehicles over UDP: what operators read when all is well, and when it is not."""

import asyncio
import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from mavsdk.plugins.geofence import Circle, FenceType, Geofence, GeofenceData, Point, Polygon
from mavsdk.plugins.mission_raw import MissionRaw
from mavsdk.plugins.param import Param

from agents.shell.clock import WallClock
from gcs.cli import main
from gcs.flight.stubs import stub_configs
from gcs.link.hub import MavsdkHub
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.preflight import link_facts
from gcs.preflight.findings import Grade
from gcs.preflight.link_facts import gather_facts
from gcs.preflight.preflight import preflight
from gcs.zones.plan_file import plan_text
from sitl.mavlink.reports import EstimatorNoise
from sitl.radio import RadioSpec
from sitl.server.process import StubProcess
from sitl.server.server import StubConfig
from tests.support.mission_text import with_first_vehicles
from tests.support.wire import LOOPBACK, PATIENCE_S, repeated_now
from tests.support.wording import facts_missing
from tests.wire.link.test_radio import BAUD, emulated

pytestmark = [
    pytest.mark.wire,
    pytest.mark.filterwarnings("ignore:Cyclopts application invoked without tokens"),
]

SPEED = 5.0
WELL = {"COM_OBL_RC_ACT": 4}
LAYERED = ("[safety]", '[choreography]\nlayer_m = 3.0\nlanding = "return"\n\n[safety]')
Checked = Callable[..., tuple[int, list[dict[str, str]]]]


@pytest.fixture
def mission(mission_file: Callable[..., str]) -> Callable[..., tuple[str, Mission]]:
    """Return a maker of missions: case 2 on free ports, with pieces of its text replaced."""

    def make(*changes: tuple[str, str]) -> tuple[str, Mission]:
        path = mission_file("case2", *changes)
        return path, load_mission(path)

    return make


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Checked:
    """Return a runner of `cordon check`: its exit code and findings; it runs in this process, which is faster."""

    def run(path: str) -> tuple[int, list[dict[str, str]]]:
        monkeypatch.setattr(sys, "argv", ["cordon", "check", path, "--json"])
        with pytest.raises(SystemExit) as ended:
            main()
        told = json.loads(capsys.readouterr().out)
        assert isinstance(ended.value.code, int)
        return ended.value.code, told["findings"]

    return run


@contextmanager
def stubs(configs: Sequence[StubConfig], speed: float = SPEED) -> Iterator[None]:
    process = StubProcess(configs, partial(WallClock, speed))
    process.start()
    try:
        yield
    finally:
        process.stop()


def write(mission: Mission, vehicle_id: int, plugin: Any, call: Callable[[Any], object]) -> None:
    """Do what the operator is told to do with a ground station: cordon itself writes nothing to a vehicle."""

    async def connected() -> None:
        hub, vehicle = MavsdkHub(), mission.vehicle(vehicle_id)
        system = await hub.find(vehicle.section.url, vehicle.system_id, PATIENCE_S)
        used = plugin(system)
        await asyncio.to_thread(call, used)
        used.destroy()
        system.destroy()
        await hub.release(vehicle.section.url, vehicle.system_id)
        await hub.close()

    asyncio.run(connected())


def set_parameters(mission: Mission, vehicle_id: int, values: Mapping[str, int | float]) -> None:
    def put(param: Any) -> None:
        for name, value in values.items():
            (param.set_param_int if isinstance(value, int) else param.set_param_float)(name, value)

    write(mission, vehicle_id, Param, put)


def upload_fence(mission: Mission, vehicle_id: int, half_m: float) -> None:
    """Let a vehicle have a fence about the mission's origin."""
    frame = mission.mission_frame()
    square = ((-half_m, -half_m), (half_m, -half_m), (half_m, half_m), (-half_m, half_m))
    places = [frame.geodetic_from_mission((x, y, 0.0)) for x, y in square]
    corners = [Point(place.latitude_deg, place.longitude_deg) for place in places]
    around = Circle(Point(places[0].latitude_deg, places[0].longitude_deg), 5000.0, FenceType.INCLUSION)
    fence = GeofenceData([Polygon(corners, FenceType.INCLUSION)], [around] if half_m > 1000.0 else [])
    write(mission, vehicle_id, Geofence, lambda geofence: geofence.upload_geofence(fence))


def of(findings: list[dict[str, str]], grade: str) -> list[tuple[str, str, str]]:
    return [(each["subject"], each["check"], each["found"]) for each in findings if each["grade"] == grade]


def test_a_healthy_team_with_one_failsafe_set_wrong(mission: Callable[..., Any], checked: Checked) -> None:
    path, team = mission()
    with stubs(stub_configs(team)):
        set_parameters(team, 1, WELL)
        set_parameters(team, 2, {"COM_OBL_RC_ACT": 0, "COM_OF_LOSS_T": 6.0, "GF_MAX_HOR_DIST": 40.0})
        set_parameters(team, 3, WELL)
        upload_fence(team, 2, 20.0)
        upload_fence(team, 3, 2000.0)
        repeated_now(lambda: judge_one_set_wrong(*checked(path)))


FIELD = (
    "[safety]",
    '[[safety.no_fly]]\nname = "mast"\ncenter_m = [20.0, 60.0]\nradius_m = 8.0\n\n[safety]\n'
    'rally = [{ name = "hill", place_m = [0.0, 30.0] }]\n'
    "fence_m = [[-50.0, -50.0], [150.0, -50.0], [150.0, 100.0], [-50.0, 100.0]]",
)


def test_the_exported_plan_on_the_autopilots_is_the_missions(mission: Callable[..., Any], checked: Checked) -> None:
    """MAVSDK reads the plan as QGroundControl's, and uploads it.

    Vehicle 2 gets one whose mast is 6 m farther east, and the other vehicle's spot at the rally point.
    """
    path = with_first_vehicles(mission(FIELD)[0], 2)
    team = load_mission(path)
    moved = load_mission(path, {"safety.no_fly[0].center_m": [26.0, 60.0]})
    with stubs(stub_configs(team)):
        for vehicle_id, flown in ((1, team), (2, moved)):
            write(team, vehicle_id, MissionRaw, partial(upload_plan, plan_text(flown, flown.vehicle(1))))
        repeated_now(lambda: judge_plans(checked(path)[1]))


def upload_plan(plan: str, missions: Any) -> None:
    read = missions.import_qgroundcontrol_mission_from_string(plan)
    missions.upload_geofence(read.geofence_items)
    missions.upload_rally_points(read.rally_items)


def judge_plans(findings: list[dict[str, str]]) -> None:
    told = {(each["subject"], each["check"].split()[0]): each for each in findings if "compared" in each["check"]}
    for vehicle_id, check, grade, words in (
        (1, "geofence", "pass", ("fence", "'mast'")),
        (2, "geofence", "warning", ("'mast' is up to 6 m off",)),
        (1, "rally", "pass", ("1 of the vehicle's 1",)),
        (2, "rally", "warning", ("0 of the vehicle's 1", "(0, 32)")),
    ):
        finding = told[f"vehicle {vehicle_id}", check]
        assert finding["grade"] == grade
        assert facts_missing(finding["found"], *words) == []


def judge_one_set_wrong(code: int, findings: list[dict[str, str]]) -> None:
    assert code == 3
    assert of(findings, "refuse") == [
        ("vehicle 2", "COM_OF_LOSS_T", "COM_OF_LOSS_T = 6: 6 s without setpoints until the failsafe acts"),
    ]
    warned = {found for subject, _, found in of(findings, "warning") if subject == "vehicle 2"}
    assert "COM_OBL_RC_ACT = 0: position mode when setpoints stop" in warned
    assert any(all(fact in found for fact in ("120 m", "GF_MAX_HOR_DIST", "40 m")) for found in warned)
    assert any("geofence with 1 areas" in found and "(45, -5)" in found for found in warned)
    # The others are well, but for what the stub does not know. The mission has no fence.
    others = [each for each in findings if each["subject"] != "vehicle 2" and each["grade"] != "pass"]
    assert {each["check"] for each in others} <= {"acceleration limit", "mission fence"}
    areas = [each["found"] for each in findings if each["check"] == "fence areas" and each["subject"] == "vehicle 3"]
    assert len(areas) == 1
    assert "geofence with 2 areas" in areas[0]
    told = {each["check"]: each["found"] for each in findings if each["subject"] == "vehicle 1"}
    assert told["gps"] == "GPS: 3D fix, 14 satellites"
    assert told["battery"] == "its battery is at 100%"
    assert told["clock"] == "its clock runs 5 times as fast as the wall's: it is a simulator's"
    assert told["health"] == "all of its 7 health items are good"
    assert re.search(r"ratio 0\.0\d", told["estimator"])
    assert told["armed"] == "it is disarmed, on the ground"
    rate = re.search(r"([\d.]+) Hz", told["telemetry"])
    assert rate is not None
    assert float(rate[1]) == pytest.approx(20.0, rel=0.1)


def test_estimators_whose_sensors_disagree_and_versions_of_firmware(mission: Callable[..., Any]) -> None:
    _, team = mission()
    one, two, three = stub_configs(team)
    shaken = EstimatorNoise(velocity_m_s=20.0)

    def attempt() -> None:
        facts = asyncio.run(gather_facts(team))
        assert [each.firmware for each in facts] == ["1.17.0", "4.7.0-dev", "1.17.0"]
        estimators = [each for each in preflight(team, facts) if each.check == "estimator"]
        found = {each.subject: (each.grade, each.found.startswith("velocity: rejected")) for each in estimators}
        refused = (Grade.REFUSE, True)
        assert found == {"vehicle 1": refused, "vehicle 2": refused, "vehicle 3": (Grade.PASS, False)}

    with stubs([replace(one, noise=shaken), replace(two, noise=shaken, autopilot="ardupilot"), three]):
        repeated_now(attempt)


def test_altitudes_of_gps_that_would_invert_layers_are_refused(mission: Callable[..., Any], checked: Checked) -> None:
    path, team = mission(LAYERED)
    one, two, three = stub_configs(team)
    with stubs([one, replace(two, height_error_m=-1.9), replace(three, height_error_m=1.9)]):

        def attempt() -> None:
            code, findings = checked(path)
            assert code == 3
            ((subject, check, found),) = of(findings, "refuse")
            assert (subject, check) == ("mission", "standing heights")
            assert facts_missing(found, "vehicles 2 and 3", "3.8 m", "3 m apart", "0.8 m in truth") == []

        repeated_now(attempt)


def test_a_line_whose_bursts_would_end_offboard_is_refused(
    mission_file: Callable[..., str], checked: Checked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_facts, "LOSSES_S", 10.0)  # of so many losses a quarter of the time is enough
    path, line = with_first_vehicles(mission_file("case2", ("leader = 2", "leader = 1")), 1), tmp_path / "line"
    configs = stub_configs(load_mission(path))
    url = f"udpin://{LOOPBACK}:{configs[0].client_port}"
    file = Path(path)
    file.write_text(file.read_text(encoding="utf-8").replace(url, f"serial://{line}:{BAUD}"), encoding="utf-8")
    spec = RadioSpec(baud=BAUD, latency_ms=100.0, jitter_ms=30.0, loss=0.1, burst=6.0)
    with stubs(configs, speed=1.0), emulated(spec, f"pty:{line}", url):
        code, findings = checked(path)
    assert code == 3
    (losses,) = [each for each in findings if each["check"] == "losses"]
    assert (losses["subject"], losses["grade"]) == ("vehicle 1", "refuse")
    assert facts_missing(losses["why"], "1 s without setpoints it leaves offboard", "COM_OF_LOSS_T") == []


def test_vehicles_that_are_silent_misplaced_or_carry_anothers_id(mission: Callable[..., Any], checked: Checked) -> None:
    path, team = mission()
    misplaced, twin, _silent = stub_configs(team)
    configs = [
        replace(misplaced, start_position_m=(12.0, 3.0), battery_fraction=0.2),
        replace(twin, vehicle_id=1),
    ]
    urls = [vehicle.section.url for vehicle in team.vehicles]
    facts = (
        ("vehicle 1", "start", ("12.0 m", "start_m (0, 4)", "+12.0 m along x", "-1.0 m along y")),
        ("vehicle 1", "battery", ("20%",)),
        ("vehicle 2", "link", (urls[1], "system id 1, not 2")),
        ("vehicle 3", "link", (urls[2], "no heartbeat", "5 s")),
    )

    def attempt() -> None:
        code, findings = checked(path)
        assert code == 3
        refused = of(findings, "refuse")
        assert [(subject, check) for subject, check, _ in refused] == [each[:2] for each in facts]
        assert [facts_missing(found, *told) for (*_, found), (*_, told) in zip(refused, facts, strict=True)] == [[]] * 4

    with stubs(configs):
        repeated_now(attempt)
