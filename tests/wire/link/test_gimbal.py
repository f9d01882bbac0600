"""Cameras on gimbals over UDP: they look at the target, and a gimbal that is not there or that fails is told."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from math import inf
from urllib.parse import urlsplit

import pytest

from agents.flight_end import FlightEnd
from agents.ports import VehicleRefusedError
from gcs.flight.flight import fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.metrics.metrics import evaluated
from gcs.mission.file import load_mission
from gcs.preflight.findings import Finding, Grade
from tests.support.arducopter import OWN_DEFAULTS, ArduCopterMissing, ArduCopterSimulator
from tests.support.flights import in_flight, unseen_view
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.wire import free_port, served

pytestmark = pytest.mark.wire

SEEN = (
    LOW,
    ("start_m = [35.0, -5.0]", "start_m = [14.0, 2.0]"),
    ("angular_rate_rad_s = 0.05", "angular_rate_rad_s = 0.15"),
    ("start_m = [0.0,", "gimbal = { target_height_m = 0.5 }\nstart_m = [0.0,"),
)
"""Case 2 with cameras, and a target that is engaged at once."""


async def test_cameras_look_at_the_target_with_a_fixed_yaw_and_one_that_fails_is_an_alert_alone(
    mission_file: Callable[..., str],
) -> None:
    mission = load_mission(with_first_vehicles(mission_file("case2", *SEEN), 2))
    assert mission.encirclement.yaw == "fixed"
    output = StringIO()
    async with served(stub_configs(mission), inf) as stubs:
        plan = FlightPlan(mission, 80.0, mission.vehicles, speed=None, clock=stubs.clock.name)
        flight = asyncio.create_task(fly(plan, unseen_view(output)))
        await in_flight(flight, lambda: output.getvalue().count("-> encircle") == 2, "a ring", stubs.clock)
        await stubs.clock.sleep(45.0)
        headings_rad = [each.airframe.heading_rad for each in stubs.vehicles.values()]
        assert headings_rad == pytest.approx([headings_rad[0]] * 2, abs=1e-6)
        assert stubs.vehicles[1].mount is not None
        stubs.stubs[2].faults.gimbal_silent = True
        outcome = await flight
    assert [each.how for each in outcome.outcomes.values()] == [FlightEnd.LANDED] * 2
    record = outcome.record
    assert record is not None
    assert record.reference == "truth"
    for vehicle in evaluated(mission, record).vehicles:
        # The attitudes are dated by their arrival: on a busy computer, at this speed, that counts as an error.
        assert vehicle.pointing_error_rms_deg == pytest.approx(1.0, abs=1.0)
    failed = [(each.vehicle, each.alert.is_over) for each in record.events if each.alert and "gimbal" in each.text]
    assert failed == [(2, False)]
    orders = [(each.vehicle, each.text) for each in record.events if each.kind == "tactic"]
    assert [text for vehicle, text in orders if vehicle == 2] == [text for vehicle, text in orders if vehicle == 1], (
        "it flies on as the other one does"
    )


@pytest.mark.parametrize(
    ("gimbal", "controller", "found"),
    [(False, (0, 0), "no gimbal answers"), (True, (255, 190), "system 255 controls its gimbal")],
    ids=["none", "another station's"],
)
async def test_a_gimbal_that_is_not_there_or_is_not_free_is_refused_on_the_ground(
    mission_file: Callable[..., str],
    monkeypatch: pytest.MonkeyPatch,
    gimbal: bool,
    controller: tuple[int, int],
    found: str,
) -> None:
    monkeypatch.setattr("gcs.preflight.link_facts.FOUND_WITHIN_S", 2.0)
    mission = load_mission(with_first_vehicles(mission_file("case2", *SEEN), 2))
    configs, told = stub_configs(mission), list[Finding]()
    async with served([configs[0], replace(configs[1], gimbal=gimbal)], 5.0) as stubs:
        manager = stubs.stubs[2]._vehicle.gimbal
        if manager is not None:
            manager.controller = controller
        plan = FlightPlan(mission, 2.0, mission.vehicles, speed=None, clock=stubs.clock.name)
        with pytest.raises(VehicleRefusedError):
            await fly(plan, unseen_view(), told.extend)
        refused = {(each.about, each.check, each.found) for each in told if each.grade is Grade.REFUSE}
        assert refused == {(2, "gimbal", found)}
        assert not any(each.armed for each in stubs.vehicles.values())
        if manager is not None:
            assert manager.controller == controller, "nothing is taken from another station"


MOUNT = {
    "MNT1_TYPE": 7,  # brushless, stabilised by itself: its report is the direction on earth
    "MNT1_PITCH_MIN": -90,
    "MNT1_PITCH_MAX": 20,
    "MNT1_YAW_MIN": -180,
    "MNT1_YAW_MAX": 180,
    "SERVO9_FUNCTION": 6,  # pan
    "SERVO10_FUNCTION": 7,  # tilt
}
PLACE = (47.397742 + 4.0 / 111_195.0, 8.545594, 488.0)
"""The start of the first vehicle of ardupilot-trio, 4 m north of the origin."""


@pytest.mark.ardupilot
@pytest.mark.timeout(600)
async def test_arducopters_simulated_mount_keeps_the_camera_on_the_target(mission_file: Callable[..., str]) -> None:
    """On a ring of 10 m at 0.15 rad/s: 0.5 degrees rms of the true direction, 0.7 with the error of its heading."""
    alone = (
        ("leader = 2", "leader = 1"),
        ("start_m = [20.0, 0.0]", "start_m = [16.0, 4.0]"),
        ("id = 1\n", "id = 1\ngimbal = true\n"),
    )
    mission = load_mission(with_first_vehicles(mission_file("ardupilot-trio", *alone), 1))
    port = urlsplit(mission.vehicles[0].section.url).port
    assert port is not None
    try:
        simulator = ArduCopterSimulator(
            port, free_port(), speed=1.0, place=PLACE, instance=0, parameters={**OWN_DEFAULTS, **MOUNT}
        )
    except ArduCopterMissing as missing:
        pytest.skip(str(missing))
    try:
        simulator.start()
        outcome = await fly(FlightPlan(mission, 60.0, mission.vehicles, speed=1.0), unseen_view())
    finally:
        simulator.close()
    record = outcome.record
    assert record is not None
    assert record.reference == "truth"
    (vehicle,) = evaluated(mission, record).vehicles
    assert vehicle.pointing_error_rms_deg == pytest.approx(0.5, abs=0.5)
    assert not [each.text for each in record.events if "gimbal" in each.text]
