"""The preflight's checks, from facts built by hand: each finding at its threshold, and the words of the grave ones."""

import json
import re
from dataclasses import replace
from io import StringIO
from math import cos, hypot, pi, sin
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs
from rich.console import Console

from agents.ports import FlightMode, VehicleStatus
from agents.settings.sections import NoFlySection, RallySection
from gcs.autopilots import ardupilot, px4, registry
from gcs.autopilots.autopilot import STUB_UID
from gcs.autopilots.px4 import SITL_UID
from gcs.errors import Exit
from gcs.keys.roster import Holder
from gcs.link.batteries import BatteryReport
from gcs.link.rates import Losses
from gcs.link.relay.gate import LinkReport
from gcs.link.self_reports import EstimatorReport
from gcs.link.status_texts import HealthItem
from gcs.mission.file import enlarged_mission, load_mission
from gcs.mission.mission import Mission
from gcs.preflight.findings import MISSION, FenceArea, Finding, GpsFix, Grade, VehicleFacts
from gcs.preflight.keys import KeyFacts
from gcs.preflight.mission import extent_m, feasibility
from gcs.preflight.preflight import exit_code, findings_json, findings_view, preflight, worst
from tests.support.mission_text import content, parsed, put
from tests.support.result_keys import OUTPUT_KEYS
from tests.support.wording import facts_missing

OPEN = load_mission("case2")
FENCE_M = ((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0))
CASE2 = replace(OPEN, safety=OPEN.safety.model_copy(update={"fence_m": FENCE_M}))
PX4 = {
    "COM_OBL_RC_ACT": 4.0,
    "COM_OF_LOSS_T": 1.0,
    "NAV_DLL_ACT": 0.0,
    "GF_ACTION": 2.0,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_ACC_HOR": 3.0,
    "SYS_HITL": 0.0,
}
ARDUCOPTER = {
    "FS_THR_ENABLE": 3.0,
    "FS_GCS_ENABLE": 5.0,
    "GUID_TIMEOUT": 3.0,
    "FENCE_ENABLE": 0.0,
    "FENCE_ACTION": 1.0,
    "FENCE_TYPE": 7.0,
    "FENCE_RADIUS": 300.0,
    "FENCE_ALT_MAX": 100.0,
    "WPNAV_SPEED": 1000.0,
    "WPNAV_ACCEL": 250.0,
    "SYSID_MYGCS": 245.0,
}
RATIOS = {"horizontal position": 0.1, "height": 0.05, "velocity": 0.02, "compass": 0.3}
SURE = EstimatorReport(RATIOS, relative=True, absolute=True)
HEALTH = (
    HealthItem.GYROMETER,
    HealthItem.LOCAL_POSITION,
    HealthItem.GLOBAL_POSITION,
    HealthItem.HOME_POSITION,
    HealthItem.ARMING,
)


def well(vehicle_id: int, **changes: Any) -> VehicleFacts:
    """A vehicle of case 2 with which all is well."""
    x, y = CASE2.vehicle(vehicle_id).section.start_m
    facts = VehicleFacts(
        vehicle_id=vehicle_id,
        autopilot=px4.AUTOPILOT,
        multicopter=True,
        status=VehicleStatus(connected=True, mode=FlightMode.HOLD, battery=0.9, local_position_ok=True, armable=True),
        health=dict.fromkeys(HEALTH, True),
        origin_m=(x, y, 0.0),
        position_m=(x, y, 0.0),
        gps=GpsFix(3, 14),
        estimator=SURE,
        clock_ratio=1.0,
        telemetry_rate_hz=20.0,
        parameters=PX4,
        system_id=vehicle_id,
        uid=0x3230_3031,
        vendor_id=0x26AC,
        link=LinkReport(round_trip_s=0.02),
    )
    return replace(facts, **changes)


def team(**changes: Any) -> tuple[Finding, ...]:
    """What is found when vehicle 2 differs from what is well."""
    return preflight(CASE2, (well(1), well(2, **changes), well(3)))


def grave(findings: tuple[Finding, ...]) -> list[tuple[str, str, str]]:
    return [(each.grade.value, each.subject, each.check) for each in findings if each.grade is not Grade.PASS]


def changed(**sections: dict[str, Any]) -> Mission:
    """Case 2 with single settings of its sections changed, past what the loader would let through."""
    return replace(CASE2, **{n: getattr(CASE2, n).model_copy(update=u) for n, u in sections.items()})


def noisy(mission: Mission, *noise_m: float) -> Mission:
    """Return a mission whose vehicles' positions are that noisy."""
    return replace(
        mission,
        vehicles=tuple(
            replace(each, own_filter=each.own_filter.model_copy(update={"position_noise_m": each_m}))
            for each, each_m in zip(mission.vehicles, noise_m, strict=True)
        ),
    )


def graded(mission: Mission, check: str) -> Finding:
    (found,) = (each for each in preflight(mission, ()) if each.check == check)
    return found


def test_a_healthy_team_has_no_grave_finding() -> None:
    findings = team()
    assert grave(findings) == []
    assert worst(findings) is Grade.PASS
    assert all(each.found and not each.next_step for each in findings)
    assert exit_code(findings) is Exit.HOLDS


def test_a_start_out_of_the_radio_range_of_all_others_is_warned_of() -> None:
    """Vehicle 3 at (0, y), the next one at (0, 0); 200 m is the default range."""
    for y, warned in ((-199.0, False), (-1000.0, True)):
        mission = load_mission("case2", {"vehicles[2].start_m": [0.0, y]})
        found = [each for each in feasibility(mission) if each.check == "start"]
        assert [(each.about, each.grade) for each in found] == ([(3, Grade.WARNING)] if warned else [])
        assert all("1000 m" in each.found and "200 m" in each.found for each in found)
    enlarged = enlarged_mission(
        load_mission("case2"), {"id": 4, "start_m": (0.0, -1000.0), "url": "udpin://127.0.0.1:14999"}
    )
    assert [each.about for each in feasibility(enlarged) if each.check == "start"] == [4]


def test_a_mission_without_a_fence_is_warned_of() -> None:
    found = graded(OPEN, "mission fence")
    assert found.grade is Grade.WARNING
    assert "safety.fence_m" in found.next_step
    assert graded(CASE2, "mission fence").grade is Grade.PASS


def test_an_estimator_is_graded_by_its_test_ratios() -> None:
    (passed,) = (each for each in team() if (each.subject, each.check) == ("vehicle 2", "estimator"))
    assert "0.30 (compass)" in passed.found
    shaky = replace(SURE, ratios=RATIOS | {"compass": 0.5, "velocity": 0.51, "height": 1.0})
    findings = team(estimator=shaky)
    assert grave(findings) == [("warning", "vehicle 2", "estimator")] * 2
    for finding, facts in zip(findings, (("height", "1.00"), ("velocity", "0.51")), strict=False):
        assert all(fact in finding.found for fact in facts)
    findings = team(estimator=replace(SURE, ratios=RATIOS | {"compass": 1.01}))
    assert grave(findings) == [("refuse", "vehicle 2", "estimator")]
    assert "compass" in findings[0].found
    assert "1.01" in findings[0].found
    assert "calibrate the compass" in findings[0].next_step


def test_an_estimator_that_does_not_know_what_it_should(subtests: pytest.Subtests) -> None:
    for change, grades in (
        ({"absolute": False}, ["refuse"]),
        ({"wrong": ("no attitude", "no height")}, ["refuse", "refuse"]),
        ({"glitch": True}, ["warning"]),
        ({"ratios": {}}, ["warning"]),
        ({"relative": False}, []),
    ):
        with subtests.test(change=change, grades=grades):
            findings = team(estimator=replace(SURE, **change))
            assert grave(findings) == [(grade, "vehicle 2", "estimator") for grade in grades]
    unheard = team(estimator=None, autopilot=ardupilot.AUTOPILOT, parameters=ARDUCOPTER)
    assert grave(unheard) == [("warning", "vehicle 2", "estimator")]
    assert "(EKF_STATUS_REPORT)" in unheard[0].found


def test_an_estimator_in_a_local_frame_needs_no_place_on_earth() -> None:
    indoors = replace(CASE2, frame=CASE2.frame.model_copy(update={"local": True}))

    def found(**change: Any) -> list[str]:
        facts = well(1, estimator=replace(SURE, absolute=False, **change))
        return [each.grade.value for each in preflight(indoors, (facts,)) if each.check == "estimator"]

    assert found() == ["pass"]
    assert found(relative=False) == ["refuse", "pass"]


def test_a_vehicle_without_a_place_is_not_told_so_by_its_estimator_again() -> None:
    lost = replace(SURE, relative=False, absolute=False)
    findings = team(estimator=lost, origin_m=None, position_m=None)
    assert grave(findings) == [("refuse", "vehicle 2", "origin")]


def test_a_vehicle_without_gps_is_refused_in_words_to_act_on() -> None:
    health = {**dict.fromkeys(HEALTH, True), HealthItem.LOCAL_POSITION: False, HealthItem.GLOBAL_POSITION: False}
    findings = team(
        health=health,
        failed_checks=("Preflight Fail: no GPS", "PreArm: Gyros not calibrated"),
        origin_m=None,
        position_m=None,
        lost=("did not know where it is within 5 s (local position, global position)", "wait for GPS, or check it"),
        gps=GpsFix(0, 0),
        telemetry_rate_hz=None,
    )
    gps, place = (each for each in findings if each.grade is Grade.REFUSE)
    assert facts_missing(gps.found, "no fix", "0 satellites") == facts_missing(gps.next_step, "receiver") == []
    assert facts_missing(place.found, "local position, global position", "“Preflight Fail: no GPS”") == []
    assert "Gyros" not in place.found
    assert facts_missing(place.next_step, "GPS", "restart the autopilot") == []
    assert {each.subject for each in findings if each.grade is Grade.REFUSE} == {"vehicle 2"}
    assert exit_code(findings) is Exit.REFUSED


def test_an_item_quotes_the_failed_checks_that_are_about_it() -> None:
    health = {**dict.fromkeys(HEALTH, True), HealthItem.GYROMETER: False}
    checks = ("PreArm: Gyros not calibrated", "PreArm: BatteryReport 1 low voltage failsafe")
    (gyro,) = (each for each in team(health=health, failed_checks=checks) if each.grade is Grade.REFUSE)
    assert gyro.found == "gyrometer calibration: not healthy; it reports “PreArm: Gyros not calibrated”"
    arming = {**dict.fromkeys(HEALTH, True), HealthItem.ARMING: False}
    (refused,) = (each for each in team(health=arming, failed_checks=checks) if each.grade is Grade.REFUSE)
    assert facts_missing(refused.found, *checks) == []


def test_what_waiting_may_resolve(subtests: pytest.Subtests) -> None:
    for changes, temporary in (
        ({"mode_received": False}, True),
        ({"health": {**dict.fromkeys(HEALTH, True), HealthItem.HOME_POSITION: False}}, True),
        ({"health": {**dict.fromkeys(HEALTH, True), HealthItem.ARMING: False}}, True),
        ({"health": {**dict.fromkeys(HEALTH, True), HealthItem.GYROMETER: False}}, False),
        ({"position_m": None, "origin_m": None}, True),
        ({"position_m": None, "origin_m": None, "lost": ("it is far away", "set the origin")}, False),
        ({"gps": GpsFix(0, 0), "health": {HealthItem.GLOBAL_POSITION: False}}, True),
        ({"estimator": replace(SURE, ratios={**RATIOS, "compass": 1.5})}, True),
        ({"telemetry_rate_hz": 7.9}, True),
        ({"parameters": {**PX4, "COM_OF_LOSS_T": 6.0}}, False),
        ({"unreachable": ("no heartbeat", "start it")}, False),
        ({"position_m": (50.0, 0.0, 0.0)}, False),
        ({"position_m": (50.0, 0.0, 0.0), "health": {HealthItem.LOCAL_POSITION: False}}, True),
    ):
        with subtests.test(changes=changes):
            refused = [each for each in team(**changes) if each.grade is Grade.REFUSE]
            assert refused
            assert {each.temporary for each in refused} == {temporary}
    assert not any(each.temporary for each in team() if each.grade is Grade.PASS)


def test_in_a_local_frame_nobody_asks_for_a_place_on_earth() -> None:
    local = changed(frame={"local": True, "latitude_deg": None, "longitude_deg": None, "altitude_m": None})
    far = {"origin_m": (2000.0, 0.0, 0.0), "gps": None}
    assert grave(preflight(local, [well(i, **far) for i in local.ids])) == []
    health = {HealthItem.LOCAL_POSITION: False, HealthItem.ARMING: False}
    (lost,) = (each for each in preflight(local, [well(1, origin_m=None, health=health)]) if each.check == "origin")
    assert "external position" in lost.next_step


def test_a_vehicle_that_is_not_there_is_one_finding() -> None:
    findings = team(unreachable=("udpin://127.0.0.1:14541 carries system id 1, not 2", "correct the vehicle's id"))
    assert grave(findings) == [("refuse", "vehicle 2", "link")]
    assert findings[0].found == "udpin://127.0.0.1:14541 carries system id 1, not 2"
    assert [each.check for each in findings if each.subject == "vehicle 2"] == ["link", "reach", "setpoint lead"]


def test_a_reserve_may_come_later_but_not_another_vehicle_in_its_place() -> None:
    one, two, three = CASE2.vehicles
    mission = replace(
        CASE2, vehicles=(one, two, replace(three, section=three.section.model_copy(update={"reserve": True})))
    )
    for silent, grade in ((True, "warning"), (False, "refuse")):
        there = [well(1), well(2), VehicleFacts(vehicle_id=3, unreachable=("no heartbeat", "start it"), silent=silent)]
        assert grave(preflight(mission, there)) == [(grade, "vehicle 3", "link")]


def test_what_is_not_well_with_one_vehicle(subtests: pytest.Subtests) -> None:
    for changes, expected in (
        ({"autopilot": registry.UNKNOWN}, [("refuse", "autopilot"), ("warning", "kind")]),
        ({"multicopter": False}, [("refuse", "airframe")]),
        ({"health": {}}, [("refuse", "health")]),
        ({"position_m": None, "origin_m": None}, [("refuse", "origin")]),
        ({"origin_m": (900.0, 500.0, 0.0)}, [("warning", "origin")]),
        ({"gps": GpsFix(3, 7)}, [("warning", "gps")]),
        ({"gps": GpsFix(2, 9)}, [("warning", "gps")]),
        ({"gps": GpsFix(3, None)}, []),
        ({"telemetry_rate_hz": 15.9}, [("warning", "telemetry")]),
        ({"telemetry_rate_hz": 16.0}, []),
        ({"telemetry_rate_hz": 7.9}, [("refuse", "telemetry")]),
        ({"link": LinkReport(round_trip_s=0.49)}, []),
        ({"link": LinkReport(round_trip_s=0.51)}, [("warning", "latency")]),
        ({"link": LinkReport()}, [("warning", "latency")]),
        ({"clock_ratio": None}, [("warning", "clock")]),
        ({"clock_ratio": 1.05}, [("warning", "clock")]),
        ({"clock_ratio": 4.0}, [("refuse", "clocks")]),
    ):
        with subtests.test(changes=changes, expected=expected):
            assert [(grade, check) for grade, _, check in grave(team(**changes))] == expected


def test_what_is_not_well_with_its_status(subtests: pytest.Subtests) -> None:
    for status, expected in (
        ({"in_air": True}, [("refuse", "armed")]),
        ({"mode": FlightMode.READY}, []),
        ({"mode": FlightMode.OTHER}, [("warning", "mode")]),
        ({"battery": None}, [("warning", "battery")]),
        ({"battery": 0.5}, []),
        ({"battery": 0.49}, [("warning", "battery")]),
        ({"battery": 0.25}, [("warning", "battery")]),
        ({"battery": 0.24}, [("refuse", "battery")]),
    ):
        with subtests.test(status=status, expected=expected):
            findings = team(status=structs.replace(well(2).status, **status))
            assert [(grade, check) for grade, _, check in grave(findings)] == expected


def test_the_place_of_a_vehicle_in_the_air_is_no_second_fault() -> None:
    flies = structs.replace(well(2).status, in_air=True)
    assert [check for _, _, check in grave(team(status=flies, position_m=(40.0, 25.0, 8.0)))] == ["armed"]


def test_all_batteries_are_listed_and_one_that_is_not_estimated_is_not_empty() -> None:
    def found(charge: float | None, *batteries: BatteryReport) -> tuple[str, str]:
        status = structs.replace(well(2).status, battery=charge)
        findings = team(status=status, batteries=batteries)
        (told,) = (each for each in findings if (each.subject, each.check) == ("vehicle 2", "battery"))
        return told.grade.value, told.found

    payload = BatteryReport(2, 0.05, flies=False)
    assert found(0.9, BatteryReport(0, 0.9)) == ("pass", "its battery is at 90%")
    assert found(0.9, BatteryReport(0, 0.9), payload) == ("pass", "its batteries: 0 at 90%, 2 at 5%, not for flight")
    assert found(0.12, BatteryReport(0, 0.9), BatteryReport(1, 0.12)) == ("refuse", "its batteries: 0 at 90%, 1 at 12%")
    assert found(None, BatteryReport(0, None)) == ("warning", "it reports no charge of its battery")
    assert found(None, BatteryReport(0, None), payload)[1].startswith("its batteries: 0 not estimated, 2 at 5%")
    assert found(None) == ("warning", "it reports no battery")


def test_a_vehicle_beside_its_start(subtests: pytest.Subtests) -> None:
    for off_m, expected in (
        (1.9, []),
        (2.1, [("warning", "mission", "origin agreement"), ("warning", "vehicle 2", "start")]),
        (10.1, [("refuse", "mission", "origin agreement"), ("refuse", "vehicle 2", "start")]),
    ):
        with subtests.test(off_m=off_m, expected=expected):
            assert grave(team(position_m=(-off_m, 0.0, 0.0))) == expected


@pytest.mark.parametrize(("mode", "grade"), [(FlightMode.HOLD, "refuse"), (FlightMode.LAND, "warning")])
def test_arming_checks_depend_on_the_mode(mode: FlightMode, grade: str) -> None:
    health = {**dict.fromkeys(HEALTH, True), HealthItem.ARMING: False}
    findings = team(health=health, status=structs.replace(well(2).status, mode=mode))
    assert (grade, "vehicle 2", "health") in grave(findings)


def test_a_team_in_the_wrong_place_is_one_finding(subtests: pytest.Subtests) -> None:
    """x points east: 5.8 km north are 5800 m along y, 2.6 m lower by the curvature. A degree has 111.18 km."""
    areas = (FenceArea(((-150.0, 5650.0), (150.0, 5650.0), (150.0, 5950.0), (-150.0, 5950.0)), stay_in=True),)
    fence_m = tuple((x, y - 5800.0) for x, y in areas[0].corners_m)
    fenced = replace(CASE2, safety=CASE2.safety.model_copy(update={"fence_m": fence_m}))
    latitude_deg = CASE2.frame.latitude_deg
    assert latitude_deg is not None
    for off_m, says in (
        ((0.0, 5800.0, 43.0), ("5.8 km north of the mission", f"{latitude_deg + 5.8 / 111.18:.4f}", "533.6")),
        ((-30.0, -30.0, 0.0), ("42 m south-west of the mission",)),
    ):
        with subtests.test(off_m=off_m):
            starts_m = {i: CASE2.vehicle(i).section.start_m for i in CASE2.ids}
            places_m = {i: (x + off_m[0], y + off_m[1], off_m[2]) for i, (x, y) in starts_m.items()}
            moved = [well(i, origin_m=place_m, position_m=place_m) for i, place_m in places_m.items()]
            if off_m[1] > 100.0:
                moved = [replace(each, fence_areas=areas) for each in moved]
            (found,) = [each for each in preflight(fenced, moved) if each.grade is not Grade.PASS]
            assert (found.grade, found.subject, found.check) == (Grade.REFUSE, "mission", "place")
            assert facts_missing(f"{found.found}. {found.next_step}", *says) == []


def test_a_vehicle_that_joins_is_told_where_it_stands_and_the_mission_stays() -> None:
    joined = enlarged_mission(CASE2, {"id": 4, "start_m": (0.0, -8.0), "url": "udpin://127.0.0.1:14999"})
    facts = replace(well(1), vehicle_id=4, origin_m=(24.0, -8.0, 0.0), position_m=(24.0, -8.0, 0.0))
    [found] = [each for each in preflight(joined, [facts]) if each.check == "place"]
    assert found.found == "vehicle 4 is 24 m east of its start"
    assert facts_missing(found.next_step, "--start", "24.0,-8.0") == []
    assert "frame" not in found.next_step


def test_where_a_team_is_does_not_follow_from_the_place_of_one_of_three() -> None:
    x, y = CASE2.vehicle(1).section.start_m
    facts = [well(i, position_m=(x, y + 42.0, 0.0) if i == 1 else None) for i in CASE2.ids]
    refused = [(each.subject, each.check) for each in preflight(CASE2, facts) if each.grade is Grade.REFUSE]
    assert ("vehicle 1", "start") in refused
    assert ("mission", "place") not in refused


def test_vehicles_too_near_to_each_other_on_the_ground_are_refused() -> None:
    near = CASE2.safety.separation_m - 0.1
    x, y = CASE2.vehicle(1).section.start_m
    findings = team(position_m=(x, y - near, 0.0))
    assert ("refuse", "mission", "separation on the ground") in grave(findings)
    (apart,) = (each.found for each in findings if each.check == "separation on the ground")
    assert facts_missing(apart, "vehicles 1 and 2", f"{near:.1f} m") == []


def test_the_height_of_the_ground(subtests: pytest.Subtests) -> None:
    for ground_m, expected in ((1.9, []), (-2.1, ["warning"]), (6.9, ["warning"]), (7.1, ["refuse"])):
        with subtests.test(ground_m=ground_m, expected=expected):
            findings = team(position_m=(*CASE2.vehicle(2).section.start_m, ground_m))
            assert [grade for grade, _, check in grave(findings) if check == "height"] == expected


def test_heights_of_the_ground_that_leave_too_little_between_layers(subtests: pytest.Subtests) -> None:
    # Layers of 3 m; vehicles 2 m apart in height do not evade each other.
    layered = changed(choreography={"layer_m": 3.0, "landing": "return"})
    for mission, heights_m, expected in (
        (layered, (0.0, -1.0, 0.0), []),
        (layered, (0.0, -1.1, 0.0), [("3.1 m apart", "1.9 m in truth")]),
        (layered, (1.9, 1.9, 1.9), []),
        (layered, (0.0, 0.0, 3.8), [("5.8 m apart", "0.8 m in truth")]),
        # The first and the last are two layers apart.
        (layered, (0.0, 1.9, 3.8), [("3.9 m apart", "1.1 m in truth")]),
        (changed(choreography={"layer_m": 6.0}), (0.0, 0.0, 3.8), []),
        # At one height they keep their distances.
        (CASE2, (0.0, 0.0, 3.8), []),
    ):
        with subtests.test(heights_m=heights_m, expected=expected):
            facts = [
                well(i, position_m=(*mission.vehicle(i).section.start_m, height_m))
                for i, height_m in zip(mission.ids, heights_m, strict=True)
            ]
            found = [each for each in preflight(mission, facts) if each.check == "standing heights"]
            judged = [each for each in found if each.grade is not Grade.PASS]
            assert [each.grade.value for each in judged] == ["refuse" for _ in expected]
            for each, (step, left) in zip(judged, expected, strict=True):
                assert facts_missing(each.next_step, step) == facts_missing(each.found, left) == []


def test_px4_parameters(subtests: pytest.Subtests) -> None:
    for name, value, grade in (
        ("COM_OBL_RC_ACT", 3.0, "warning"),
        ("COM_OBL_RC_ACT", 5.0, None),
        ("COM_OBL_RC_ACT", 7.0, "refuse"),
        ("COM_OF_LOSS_T", 0.2, "warning"),
        ("COM_OF_LOSS_T", 2.0, None),
        ("COM_OF_LOSS_T", 2.1, "warning"),
        ("COM_OF_LOSS_T", 5.1, "refuse"),
        ("NAV_DLL_ACT", 2.0, "warning"),
        ("NAV_DLL_ACT", 5.0, "refuse"),
        ("GF_MAX_HOR_DIST", 50.0, "warning"),
        ("GF_MAX_VER_DIST", 7.0, "warning"),
        ("GF_MAX_VER_DIST", 8.0, None),
        ("MPC_XY_VEL_MAX", 0.59, "refuse"),
        ("MPC_XY_VEL_MAX", 0.61, "warning"),
        ("MPC_XY_VEL_MAX", 1.0, None),
        ("MPC_ACC_HOR", 0.02, "refuse"),
        ("MPC_ACC_HOR", 0.026, "warning"),
    ):
        with subtests.test(name=name, value=value, grade=grade):
            findings = team(parameters={**PX4, name: value})
            assert [each[0] for each in grave(findings)] == ([] if grade is None else [grade])
            assert any(name in each.found for each in findings)


def test_arducopter_parameters(subtests: pytest.Subtests) -> None:
    for changes, grades in (
        ({"FS_THR_ENABLE": 0.0}, ["warning"]),
        ({"FS_GCS_ENABLE": 0.0}, ["warning"]),
        ({"FS_GCS_ENABLE": 1.0}, ["warning"]),
        ({"GUID_TIMEOUT": 6.0}, ["warning"]),
        ({"FENCE_ENABLE": 1.0, "FENCE_RADIUS": 50.0}, ["warning"]),
        ({"FENCE_ENABLE": 1.0, "FENCE_RADIUS": 50.0, "FENCE_TYPE": 5.0}, []),
        ({"FENCE_ENABLE": 1.0, "FENCE_ALT_MAX": 7.0}, ["warning"]),
        ({"FENCE_ENABLE": 1.0, "FENCE_ALT_MAX": 7.0, "FENCE_ACTION": 0.0}, []),
        ({"WPNAV_SPEED": 59.0}, ["refuse"]),
        ({"WPNAV_SPEED": None, "WP_SPD": 0.59}, ["refuse"]),
        ({"WPNAV_SPEED": None, "WP_SPD": 10.0}, []),
        ({"WPNAV_ACCEL": 2.0}, ["refuse"]),
    ):
        with subtests.test(changes=changes, grades=grades):
            findings = team(autopilot=ardupilot.AUTOPILOT, parameters={**ARDUCOPTER, **changes})
            assert [each[0] for each in grave(findings)] == grades


def test_a_parameter_that_cannot_be_read_is_a_warning_with_its_name() -> None:
    for kind in (px4.AUTOPILOT, ardupilot.AUTOPILOT):
        findings = team(autopilot=kind, parameters={})
        told = " ".join(f"{each.found} {each.next_step}" for each in findings if each.grade is Grade.WARNING)
        assert worst(findings) is Grade.WARNING
        assert [name for names in kind.parameters_wanted for name in names if name not in told] == []


def test_a_fence_that_terminates_is_refused_only_where_it_is_in_force() -> None:
    assert grave(team(parameters={**PX4, "GF_ACTION": 4.0})) == []
    limits = {"GF_ACTION": 4.0, "GF_MAX_HOR_DIST": 500.0}
    assert grave(team(parameters={**PX4, **limits})) == [("refuse", "vehicle 2", "fence")]
    assert grave(team(parameters={**PX4, **limits, "GF_ACTION": 1.0, "GF_MAX_HOR_DIST": 1.0})) == []


def test_the_extent_reaches_around_the_target_at_its_end_or_to_the_end_of_the_line() -> None:
    # The target goes from (35, -5) to (95, -5) in 600 s; vehicle 2 starts at (0, 0).
    assert extent_m(CASE2, CASE2.vehicle(2)) == pytest.approx(120.0)
    still = changed(target={"velocity_m_s": (0.0, 0.0)}, formation={"speed_m_s": 0.01})
    assert extent_m(still, still.vehicle(2)) == pytest.approx((35.0**2 + 5.0**2) ** 0.5 + 10.0)


def test_a_ring_without_room_for_the_error_of_positions_is_refused() -> None:
    chord = 2.0 * 10.0 * sin(pi / 3.0)
    roomy = noisy(changed(safety={"separation_m": 12.0}), 0.1, 0.1, 0.1)
    tight = noisy(changed(safety={"separation_m": 17.0}), 0.1, 0.1, 0.1)
    worse = noisy(changed(safety={"separation_m": 17.0}), 0.2, 0.02, 0.2)
    assert [graded(each, "ring spacing").grade for each in (roomy, tight, worse)] == [
        Grade.PASS,
        Grade.WARNING,
        Grade.REFUSE,
    ]
    found = graded(worse, "ring spacing")
    assert found.subject == "mission"
    assert all(fact in found.found for fact in ("3 vehicles", "10 m", f"{chord:.2f} m", "17 m", "0.57 m"))
    assert all(fact in found.next_step for fact in ("encirclement.radius_m to 12.1 m", "safety.separation_m"))


def test_the_narrowest_wanted_gap_counts_for_the_room_on_the_ring() -> None:
    """Sixteen times the gap of each of the others: theirs are 20 degrees."""
    uneven = CASE2.replace(vehicles={2: {"gap": 16.0}})
    found = graded(uneven, "ring spacing")
    assert found.grade is Grade.WARNING
    assert "the narrowest gap is 20.0 degrees" in found.found
    assert f"{20.0 * sin(pi / 18.0):.2f} m" in found.found


def test_the_room_of_the_ring_is_the_largest_number_that_keeps_the_separation() -> None:
    def gap_m(count: int) -> float:
        return 20.0 * sin(pi / count)

    found = graded(noisy(changed(safety={"separation_m": 4.0}), 0.1, 0.1, 0.1), "ring spacing").found
    room = int(found.split("room for ")[1].split(":")[0])
    assert gap_m(room + 1) < 1.2 * 4.0 + 2.0 * 0.02**0.5 <= gap_m(room)


def test_a_ring_that_will_not_settle_is_a_warning_that_names_its_gain() -> None:
    settles = graded(OPEN, "settling")
    assert settles.grade is Grade.PASS
    assert "3 vehicles that engage together settle after about" in settles.found
    never = graded(changed(encirclement={"spacing_gain_per_s": 0.0}), "settling")
    assert never.grade is Grade.WARNING
    assert "tuning.encirclement.spacing_gain_per_s" in never.next_step


def test_a_sensor_that_does_not_see_as_far_as_the_ring_is_a_warning_that_names_its_vehicle() -> None:
    sensor = OPEN.target.sensor
    for range_m, grade in ((10.0, Grade.PASS), (9.9, Grade.WARNING)):
        short = changed(target={"sensor": sensor.model_copy(update={"range_m": range_m})})
        assert graded(short, "sensor range").grade is grade
    found = graded(parsed(put(content(), ("vehicles", 1, "sensor"), {"range_m": 4.0})), "sensor range")
    assert found.grade is Grade.WARNING
    assert all(fact in found.found for fact in ("4 m", "10 m", "shorter range: 2"))
    assert "target.sensor.range_m" in found.next_step
    external = changed(target={"source": "external", "sensor": sensor.model_copy(update={"range_m": 1.0})})
    assert all(each.check != "sensor range" for each in preflight(external, []))


def reached(**sections: dict[str, Any]) -> list[Finding]:
    return [each for each in preflight(changed(**sections), ()) if each.check == "reach"]


def test_a_vehicle_that_the_mission_never_brings_near_enough_is_warned_of() -> None:
    """Case 2's line gains 0.1 m/s on the target, which is 35 m ahead on the lane of vehicle 3."""
    assert [(each.about, each.grade) for each in reached()] == [(i, Grade.PASS) for i in (1, 2, 3)]
    # After 60 s they are still 6 m nearer only; abreast of the third, vehicles 1 and 2 are 10 and 5 m to its side.
    late = {each.about: each for each in reached(mission={"duration_s": 60.0}, target={"start_m": (13.0, -5.0)})}
    assert [(i, each.grade) for i, each in late.items()] == [(1, Grade.WARNING), (2, Grade.PASS), (3, Grade.PASS)]
    assert f"{hypot(7.0, 10.0):.2f} m, at 60 s; its decision.distance_max_m is 12 m" in late[1].found
    assert late[1].next_step.startswith("raise its decision.distance_max_m above 12.3 m, or bring")


def test_a_target_counts_from_when_a_sensor_first_sees_it() -> None:
    sensor = CASE2.target.sensor.model_copy(update={"range_m": 4.0})
    # It comes the other way, and is 4 m before vehicle 3 after 27.5 s, and farther from the others than before.
    meets = {"start_m": (15.0, -5.0), "velocity_m_s": (-0.2, 0.0), "sensor": sensor}
    found = reached(target=meets, mission={"duration_s": 28.0})
    assert all("the target being seen from 28 s on" in each.found for each in found)
    (unseen,) = reached(target=meets, mission={"duration_s": 27.0})
    assert (unseen.about, unseen.grade) == (MISSION, Grade.WARNING)
    assert "no vehicle comes nearer than 4.20 m; the longest target.sensor.range_m is 4 m" in unseen.found


def test_reach_is_judged_only_of_vehicles_that_would_engage_a_simulated_target() -> None:
    assert reached(target={"importance": 0.1, "start_m": (500.0, 0.0)}) == []
    assert reached(target={"source": "external", "start_m": (500.0, 0.0)}) == []


def test_missions_beyond_their_own_limits(subtests: pytest.Subtests) -> None:
    for sections, check, grade in (
        ({"target": {"velocity_m_s": (2.6, 0.0)}}, "target speed", Grade.REFUSE),
        ({"target": {"velocity_m_s": (0.0, -2.4)}}, "target speed", Grade.WARNING),
        ({"encirclement": {"angular_rate_rad_s": 0.205}}, "waiting speed", Grade.WARNING),  # 0.205 x 14.5 + 0.1 > 3 m/s
        ({"encirclement": {"angular_rate_rad_s": 0.195}}, "waiting speed", Grade.PASS),
        ({"encirclement": {"angular_rate_rad_s": -0.46}}, "ring acceleration", Grade.REFUSE),
        ({"encirclement": {"angular_rate_rad_s": 0.41}}, "ring acceleration", Grade.WARNING),
        ({"formation": {"speed_m_s": 2.1}}, "formation speed", Grade.REFUSE),
        ({"formation": {"speed_m_s": 1.7}}, "formation speed", Grade.WARNING),
        ({"formation": {"spacing_m": 1.0}}, "line spacing", Grade.REFUSE),
    ):
        with subtests.test(sections=sections, check=check, grade=grade):
            assert graded(changed(**sections), check).grade is grade


def test_a_lead_that_is_held_too_short_is_refused_for_the_plant() -> None:
    # 0.6 m/s with a1/a0 = 0.87/0.8, and 0.025 m/s² inwards: 0.653 m.
    assert "0.65 m at 0.60 m/s" in "".join(each.found for each in preflight(CASE2, ()))
    short = preflight(changed(safety={"setpoint_lead_max_m": 0.6}), ())
    assert [each for each in grave(short) if each[2] == "setpoint lead"] == [
        ("refuse", f"vehicle {i}", "setpoint lead") for i in CASE2.ids
    ]


def test_the_gravest_come_first_and_all_is_told_to_people_and_to_scripts() -> None:
    findings = team(multicopter=False, status=structs.replace(well(2).status, battery=0.3))
    assert [each.grade for each in findings[:3]] == [Grade.REFUSE, Grade.WARNING, Grade.PASS]
    told = json.loads(findings_json("case2", findings))
    assert (told["mission"], told["grade"], len(told["findings"])) == ("case2", "refuse", len(findings))
    battery = told["findings"][1]
    assert (list(told), list(battery)) == (OUTPUT_KEYS["check"].split(), OUTPUT_KEYS["findings[] of check"].split())
    assert [battery[key] for key in ("grade", "subject", "check")] == ["warning", "vehicle 2", "battery"]
    assert "30%" in battery["found"]
    assert battery["why"]
    assert "battery" in battery["next_step"]


def rendered(renderable: object) -> str:
    console = Console(width=120, file=StringIO())
    console.print(renderable)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue().strip()


def test_people_read_reason_and_next_step_only_of_what_is_not_well() -> None:
    findings = team(multicopter=False, gps=GpsFix(3, 7))
    text = rendered(findings_view("case2", findings, passes=True))
    assert text.count("why: ") == text.count("next: ") == 2
    lines = text.splitlines()
    grades = [line.split()[0] for line in lines[:-1] if line.split()[0] in {"pass", "warning", "refuse"}]
    assert grades == sorted(grades, key=["pass", "warning", "refuse"].index), "refusals are next to the prompt"
    assert facts_missing(lines[-1], "case2", "1 refuse", "1 warning") == []
    same = [line for line in lines if "it is a multicopter" in line]
    assert ["vehicles 1, 3" in line for line in same] == [True], "what is the same is told once"
    few = rendered(findings_view("case2", findings))
    assert [line.split()[0] for line in few.splitlines() if not line.startswith(" ")] == ["warning", "refuse", "case2:"]
    assert few.splitlines()[-1] == lines[-1], "the passes are still counted"


def test_facts_hold_finite_numbers() -> None:
    with pytest.raises(ValueError, match="vehicle 2"):
        well(2, position_m=(0.0, float("nan"), 0.0))
    with pytest.raises(ValueError, match="vehicle 2"):
        well(2, parameters={"COM_OF_LOSS_T": float("inf")})


# The ground station that a failsafe watches, and the fence's areas


def test_an_arducopter_whose_failsafe_watches_another_station(subtests: pytest.Subtests) -> None:
    for changes, expected in (
        ({"SYSID_MYGCS": None, "MAV_GCS_SYSID": 255.0}, ["MAV_GCS_SYSID = 255"]),
        ({"SYSID_MYGCS": None, "MAV_GCS_SYSID": 245.0}, []),
        ({"SYSID_MYGCS": 255.0, "FS_GCS_ENABLE": 0.0}, []),
    ):
        with subtests.test(changes=changes, expected=expected):
            findings = team(autopilot=ardupilot.AUTOPILOT, parameters={**ARDUCOPTER, **changes})
            told = [each for each in findings if each.check == "ground station id" and each.grade is Grade.WARNING]
            assert len(told) == len(expected)
            for finding, words in zip(told, expected, strict=True):
                assert finding.found.startswith(words)
                assert finding.next_step.endswith(" = 245")


def square(half_m: float, *, stay_in: bool, about: tuple[float, float] = (50.0, 0.0)) -> FenceArea:
    x, y = about
    corners = ((x - half_m, y - half_m), (x + half_m, y - half_m), (x + half_m, y + half_m), (x - half_m, y + half_m))
    return FenceArea(corners, stay_in)


WIDE = square(90.0, stay_in=True)


def test_the_areas_of_the_fence(subtests: pytest.Subtests) -> None:
    for areas, expected in (
        ((WIDE,), ["pass"]),
        ((square(50.5, stay_in=True),), ["warning"]),
        ((square(50.5, stay_in=True), WIDE), ["pass"]),
        ((WIDE, square(3.0, stay_in=False)), ["warning"]),
        ((WIDE, square(3.0, stay_in=False, about=(50.0, 60.0))), ["pass"]),
        ((), []),
        (None, ["warning"]),
    ):
        with subtests.test(areas=areas, expected=expected):
            findings = team(fence_areas=areas)
            assert [each.grade.value for each in findings if each.check == "fence areas"] == expected


def test_the_areas_are_compared_with_the_missions(subtests: pytest.Subtests) -> None:
    """The mission's fence is 200 m wide about the origin; a mast of 8 m and a house of 10 m are closed."""
    zones = (
        NoFlySection(name="mast", center_m=(0.0, 60.0), radius_m=8.0),
        NoFlySection(name="house", polygon_m=((50.0, 50.0), (60.0, 50.0), (60.0, 60.0), (50.0, 60.0))),
    )
    closed = replace(CASE2, safety=CASE2.safety.model_copy(update={"no_fly": zones}))
    fence, house = square(100.0, stay_in=True, about=(0.0, 0.0)), square(5.0, stay_in=False, about=(55.0, 55.0))
    turns = [2.0 * pi * k / 36 for k in range(36)]
    mast = FenceArea(tuple((8.0 * cos(turn), 60.0 + 8.0 * sin(turn)) for turn in turns), stay_in=False)
    moved, wider = square(5.0, stay_in=False, about=(55.0, 62.0)), square(103.0, stay_in=True, about=(0.0, 0.0))
    for mission, areas, grade, words in (
        (closed, (house, fence, mast), "pass", ("fence", "zone 'mast'", "zone 'house'")),
        (closed, (square(101.0, stay_in=True, about=(0.0, 0.0)), mast, house), "pass", ()),
        (closed, (wider, mast, house), "warning", ("fence is up to 4 m off",)),
        (closed, (fence, mast, moved), "warning", ("zone 'house' is up to 7 m off",)),
        (closed, (fence, mast), "warning", ("zone 'house' is missing",)),
        (
            closed,
            (square(100.0, stay_in=False, about=(0.0, 0.0)), mast, house),
            "warning",
            ("fence is missing", "(0, 0)"),
        ),
        (closed, (fence, mast, house, square(2.0, stay_in=False)), "warning", ("keep out of about (50, 0)",)),
        (closed, (), "warning", ("no areas",)),
        (closed, None, None, ()),
        (CASE2, (), "pass", ("no areas",)),
        (CASE2, (fence,), "pass", ("it holds fence",)),
        (OPEN, (fence,), None, ()),
    ):
        with subtests.test(areas=areas, grade=grade, words=words):
            findings = preflight(mission, [well(1, fence_areas=areas)])
            told = [each for each in findings if each.check == "geofence compared"]
            assert [each.grade.value for each in told] == ([] if grade is None else [grade])
            assert facts_missing("".join(each.found for each in told), *words) == []


def test_the_rally_points_are_compared_with_the_missions(subtests: pytest.Subtests) -> None:
    """Vehicle 1 starts 4 m left of the middle of the team."""
    rally = (RallySection(name="hill", place_m=(30.0, 20.0)), RallySection(name="road", place_m=(60.0, 20.0)))
    ready = replace(CASE2, safety=CASE2.safety.model_copy(update={"rally": rally}))
    for mission, points, grade, words in (
        (ready, ((30.0, 24.0), (60.5, 24.5)), "pass", ("2 of the vehicle's 2",)),
        (ready, ((60.0, 24.0),), "pass", ("1 of the vehicle's 2",)),
        (ready, (), "pass", ("0 of the vehicle's 2",)),
        (ready, ((30.0, 20.0), (60.0, 24.0)), "warning", ("1 of the vehicle's 2", "(30, 20)")),
        (ready, None, "warning", ("could not be downloaded",)),
        (CASE2, ((30.0, 20.0),), "warning", ("(30, 20)",)),
        (CASE2, (), None, ()),
        (CASE2, None, None, ()),
    ):
        with subtests.test(points=points, grade=grade, words=words):
            told = [
                each for each in preflight(mission, [well(1, rally_m=points)]) if each.check == "rally points compared"
            ]
            assert [each.grade.value for each in told] == ([] if grade is None else [grade])
            assert facts_missing("".join(each.found for each in told), *words) == []


def test_areas_of_a_fence_that_does_not_act_are_none(subtests: pytest.Subtests) -> None:
    for kind, parameters, acts in (
        (px4.AUTOPILOT, {**PX4, "GF_ACTION": 1.0}, False),
        (ardupilot.AUTOPILOT, {**ARDUCOPTER, "FENCE_ENABLE": 1.0}, True),
        (ardupilot.AUTOPILOT, {**ARDUCOPTER, "FENCE_ENABLE": 1.0, "FENCE_TYPE": 3.0}, False),
    ):
        with subtests.test(kind=kind, parameters=parameters, acts=acts):
            findings = team(autopilot=kind, parameters=parameters, fence_areas=(square(5.0, stay_in=True),))
            assert bool([each for each in findings if each.check == "fence areas"]) is acts


SERIAL = "serial:///dev/ttyUSB0:%d"


def on_one_line(baud: int, received_bytes_s: float | None = None) -> dict[str, Finding]:
    """What is found of the connection, with all vehicles of case 2 on one serial line."""
    vehicles = tuple(
        replace(each, section=each.section.model_copy(update={"url": SERIAL % baud})) for each in CASE2.vehicles
    )
    found = preflight(replace(CASE2, vehicles=vehicles), [well(i, link_bytes_s=received_bytes_s) for i in CASE2.ids])
    return {each.check: each for each in found if each.check.startswith("link ")}


@pytest.mark.parametrize(("baud", "grade"), [(115200, Grade.PASS), (76800, Grade.WARNING), (57600, Grade.REFUSE)])
def test_what_a_line_is_asked_for_is_held_against_its_rate(baud: int, grade: Grade) -> None:
    budget = on_one_line(baud)["link budget"]
    assert budget.grade is grade
    assert f"of its {baud / 10:.0f} bytes/s" in budget.found


def test_rates_that_fit_are_named_and_fit() -> None:
    step = on_one_line(57600)["link budget"].next_step
    rates = [float(number) for number in re.findall(r"_hz = ([0-9.]+)", step)]
    telemetry_hz, status_hz, setpoint_hz = rates
    # Bytes of the messages as MAVLink 2 has them: 40 for motion, 97 and half of 330 for status, 65 for setpoints.
    asked = 3 * (40 * telemetry_hz + (97 + 165) * status_hz + 65 * setpoint_hz + 21) + 21
    assert 0.6 * 5760 < asked <= 0.7 * 5760


LINES = 115200
"""The rate of the line below, of which one vehicle's full rates take a quarter."""


def losses_found(losses: Losses, rates: str = "auto", **facts: Any) -> Finding:
    """What is found of the losses of a serial line of one vehicle."""
    link = CASE2.link.model_copy(update={"rates": rates})
    (first, *_), own = CASE2.vehicles, SERIAL % LINES
    alone = replace(first, section=first.section.model_copy(update={"url": own}))
    mission = replace(CASE2, vehicles=(alone, *CASE2.vehicles[1:]), link=link)
    found = preflight(mission, [well(first.id, losses=losses, **facts)])
    (finding,) = [each for each in found if each.check == "losses"]
    return finding


@pytest.mark.parametrize(
    ("losses", "rates", "grade"),
    [
        (Losses(500.0, 50.0, 45.0), "fixed", Grade.PASS),
        (Losses(500.0, 25.0, 8.0), "auto", Grade.WARNING),  # eight bursts leave it open
        (Losses(600.0, 30.0, 10.0), "auto", Grade.PASS),
        (Losses(500.0, 25.0, 8.0), "fixed", Grade.REFUSE),
        (Losses(500.0, 50.0, 5.0), "auto", Grade.REFUSE),
    ],
)
def test_losses_refuse_a_link_that_would_be_silent_for_too_long(losses: Losses, rates: str, grade: Grade) -> None:
    found = losses_found(losses, rates)
    assert found.grade is grade
    if grade is Grade.REFUSE and rates == "fixed":
        assert "5% of its messages are lost, 3.1 in a row" in found.found
        assert facts_missing(found.next_step, 'rates = "auto"', "COM_OF_LOSS_T to 2 s") == []


def test_few_frames_do_not_show_losses() -> None:
    assert not [each for each in team(losses=Losses(50.0, 10.0, 1.0)) if each.check == "losses"]


@pytest.mark.parametrize(("received_bytes_s", "grade"), [(2500.0, Grade.PASS), (7000.0, Grade.WARNING)])
def test_streams_that_were_not_asked_for_are_noticed(received_bytes_s: float, grade: Grade) -> None:
    traffic = on_one_line(115200, received_bytes_s)["link traffic"]
    assert traffic.grade is grade
    assert f"{received_bytes_s:.0f} bytes/s received" in traffic.found


def test_a_vehicle_whose_id_is_doubled_on_its_line_is_refused() -> None:
    assert grave(team(link=LinkReport("/dev/ttyUSB0:57600", doubled=True, round_trip_s=0.1))) == [
        ("refuse", "vehicle 2", "doubled")
    ]


BOARD = {"uid": 0x31, "link": LinkReport(hil=True, round_trip_s=0.01), "parameters": {**PX4, "SYS_HITL": 2.0}}
SIMULATOR = {"uid": SITL_UID + 1, "vendor_id": 0}
STUB = {"uid": (STUB_UID << 32) + 2, "vendor_id": 0}
UNKNOWN = {"uid": None}


@pytest.mark.parametrize(
    ("second", "bench", "expected"),
    [
        ({}, False, []),
        (BOARD, False, [("refuse", "mission", "kinds"), ("refuse", "vehicle 2", "bench")]),
        (SIMULATOR, False, [("refuse", "mission", "kinds")]),
        (STUB, False, [("refuse", "mission", "kinds")]),
        (UNKNOWN, False, [("warning", "vehicle 2", "kind")]),
        (BOARD, True, [("refuse", "vehicle 1", "bench"), ("refuse", "vehicle 3", "bench")]),
    ],
    ids=["all real", "a board", "a simulator", "a stub", "unknown beside real", "a board among real on the bench"],
)
def test_what_flies_is_not_mixed_with_what_is_simulated(
    second: dict[str, Any], bench: bool, expected: list[tuple[str, str, str]]
) -> None:
    assert grave(preflight(CASE2, (well(1), well(2, **second), well(3)), bench=bench)) == expected


def test_on_the_bench_boards_fly_with_stubs_and_simulators_and_nothing_else() -> None:
    stub = {"uid": (STUB_UID << 32) + 1, "vendor_id": 0}
    simulator = {"uid": SITL_UID + 2, "vendor_id": 0}
    simulated = (well(1, **stub), well(2, **BOARD), well(3, **simulator))
    assert grave(preflight(CASE2, simulated, bench=True)) == []
    assert grave(preflight(CASE2, simulated)) == [("refuse", "vehicle 2", "bench")]
    unknown = (*simulated[:2], well(3, **UNKNOWN))
    assert ("refuse", "vehicle 3", "bench") in grave(preflight(CASE2, unknown, bench=True))
    (mixed,) = [each for each in preflight(CASE2, unknown) if each.check == "kinds"]
    assert (mixed.grade, mixed.temporary) == (Grade.REFUSE, True), "its parameters may have been lost"
    real = (*simulated[:2], well(3))
    (mixed,) = [each for each in preflight(CASE2, real) if each.check == "kinds"]
    assert (mixed.grade, mixed.temporary) == (Grade.REFUSE, False)


def test_keys_have_to_outlast_the_mission(subtests: pytest.Subtests) -> None:
    ends_s = 1e9
    long_s, short_s, past_s = ends_s + 1e5, ends_s + 60.0, ends_s - 1e5
    vehicles = [Holder("vehicle", str(i), long_s) for i in CASE2.ids]
    routed = replace(CASE2, network=CASE2.network.model_copy(update={"router": "tcp/10.0.0.2:7447"}))
    cases: dict[str, tuple[Mission, list[Holder], list[tuple[str, str, str]]]] = {
        "all last": (CASE2, vehicles, []),
        "one certificate for all": (CASE2, [Holder("vehicle", "1", long_s, speaks_for=CASE2.ids[1:])], []),
        "a vehicle's do not": (
            CASE2,
            [*vehicles[:2], Holder("vehicle", "3", short_s)],
            [("refuse", "vehicle 3", "keys")],
        ),
        "a vehicle has none": (CASE2, vehicles[1:], [("refuse", "vehicle 1", "keys")]),
        "an operator's do not": (
            CASE2,
            [*vehicles, Holder("operator", "a", short_s)],
            [("warning", "mission", "keys")],
        ),
        "an operator of the past": (CASE2, [*vehicles, Holder("operator", "a", past_s)], []),
        "no router": (routed, vehicles, [("refuse", "mission", "keys")]),
        "a router's do not": (routed, [*vehicles, Holder("router", "r", short_s)], [("refuse", "mission", "keys")]),
        "a router's last": (routed, [*vehicles, Holder("router", "r", long_s)], []),
    }
    for name, (mission, holders, expected) in cases.items():
        with subtests.test(name=name):
            found = preflight(mission, (well(1), well(2), well(3)), key_facts=KeyFacts(holders, ends_s))
            assert grave(tuple(each for each in found if each.check == "keys")) == expected
            assert {each.check for each in found} >= {"keys"}
    with subtests.test("no newer roster can be kept"):
        facts = KeyFacts(vehicles, ends_s, (Path("keys/vehicle-2"),))
        (found_here,) = [
            each
            for each in preflight(CASE2, (well(1), well(2), well(3)), key_facts=facts)
            if each.check == "keys" and each.grade is Grade.WARNING
        ]
        assert "keys/vehicle-2" in found_here.found
