"""What the preflight finds about a vehicle's profile, and about a flight for identification."""

from dataclasses import replace
from datetime import date, timedelta
from typing import Any

import pytest

from agents.control.excitation import preview
from estimation.plant.model import COVARIANCE_OF, Identification
from estimation.profile.autopilots import AutopilotName
from estimation.profile.profile import Profile
from gcs.autopilots import ardupilot, px4
from gcs.autopilots.autopilot import Autopilot
from gcs.autopilots.registry import UNKNOWN
from gcs.mission.file import excitation_mission, load_mission
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade
from gcs.preflight.mission import extent_m
from gcs.preflight.parameters import route
from gcs.preflight.preflight import preflight
from tests.gcs.preflight.test_preflight import well
from tests.support.wording import facts_missing

CASE2 = load_mission("case2")
TODAY = date(2026, 11, 21)


def identified(**changes: Any) -> Identification:
    content: dict[str, Any] = {
        "method": "output error 1",
        "date": date(2026, 11, 1),
        "vehicle": 2,
        "autopilot": "PX4",
        "firmware": "v1.17.0",
        "logs": [{"name": "flight.ulg", "sha256": "0a" * 32}],
        "setpoints": "held",
        "duration_s": 200.0,
        "fit_x_percent": 85.0,
        "fit_y_percent": 80.0,
        "verdict": "good",
        "covariance": [[0.0] * len(COVARIANCE_OF)] * len(COVARIANCE_OF),
    }
    return Identification.model_validate(content | changes)


def flown_with(plant: Identification | None, mission: Mission = CASE2) -> Mission:
    def of_plant(profile: Profile) -> Profile:
        return replace(profile, identified=plant)

    return replace(mission, vehicles=tuple(replace(each, profile=of_plant(each.profile)) for each in mission.vehicles))


def found(mission: Mission, today: date | None = TODAY, **facts: Any) -> list[Finding]:
    about = [well(2, **({"firmware": "1.17.0-alpha+0f1e2d3c"} | facts))]
    return [each for each in preflight(mission, about, today) if each.check == "profile"]


def test_a_good_plant_of_this_firmware_is_well() -> None:
    (finding,) = found(flown_with(identified()))
    assert finding.grade is Grade.PASS
    assert facts_missing(finding.found, "'stub'", "2026-11-01", "good") == []


def test_each_doubt_is_a_warning_with_its_reason(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[dict[str, Any], dict[str, Any], str], ...] = (
        ({"date": TODAY - timedelta(days=181)}, {}, "it is 181 days old"),
        ({"autopilot": "ArduPilot"}, {}, "it was identified with ArduPilot, and the vehicle flies PX4"),
        ({}, {"autopilot": ardupilot.AUTOPILOT}, "it was identified with PX4, and the vehicle flies ArduPilot"),
        ({"firmware": "abc"}, {}, "it was identified with firmware abc, and the vehicle's is 1.17.0-alpha+0f1e2d3c"),
        (
            {"verdict": "do not fly this", "reasons": ["too little excitation"]},
            {},
            "its own verdict is 'do not fly this', too little excitation",
        ),
    )
    for plant, facts, doubt in rows:
        with subtests.test(plant=plant, facts=facts, doubt=doubt):
            (finding,) = found(flown_with(identified(**plant)), **facts)
            assert finding.grade is Grade.WARNING
            assert finding.found.endswith(f": {doubt}")
            assert "cordon excite" in finding.next_step


def test_what_is_near_enough_or_not_known_is_no_doubt(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[dict[str, Any], dict[str, Any]], ...] = (
        ({"date": TODAY - timedelta(days=180)}, {}),
        ({"autopilot": "px4"}, {}),
        ({"firmware": "1.17.3"}, {}),
        ({}, {"firmware": ""}),
        ({"verdict": "usable"}, {}),
    )
    for plant, facts in rows:
        with subtests.test(plant=plant, facts=facts):
            (finding,) = found(flown_with(identified(**plant)), **facts)
            assert finding.grade is Grade.PASS


def test_a_file_whose_feed_forward_was_changed_by_hand_is_doubted(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[int, float, str], ...] = (
        (5, 0.0, ""),
        (6, 0.9, ""),
        (6, 0.0, "it was identified with velocities beside setpoints, and with feedforward = 0 none are sent"),
        (5, 0.9, "it was identified with setpoints alone, and with feedforward = 0.9 velocities are sent as well"),
    )
    for size, gain, doubt in rows:
        with subtests.test(size=size, gain=gain, doubt=doubt):
            mission = flown_with(identified(covariance=[[0.0] * size] * size))
            changed = [replace(each, plant=replace(each.plant, feedforward=gain)) for each in mission.vehicles]
            (finding,) = found(replace(mission, vehicles=tuple(changed)))
            assert finding.grade is (Grade.WARNING if doubt else Grade.PASS)
            assert finding.found.endswith(f": {doubt}" if doubt else "is good")


def profiled(autopilot: AutopilotName | None, chosen: AutopilotName | None = None) -> Mission:
    """Case 2 with profiles for one autopilot, and what the mission itself says its vehicles fly as."""
    vehicles = tuple(
        replace(
            each,
            profile=replace(each.profile, autopilot=autopilot),
            section=each.section.model_copy(update={"autopilot": chosen}),
        )
        for each in CASE2.vehicles
    )
    return replace(CASE2, vehicles=vehicles)


@pytest.mark.parametrize(
    ("autopilot", "chosen", "flies", "grades"),
    [
        ("ardupilot", None, ardupilot.AUTOPILOT, []),
        (None, None, ardupilot.AUTOPILOT, []),
        ("px4", None, ardupilot.AUTOPILOT, [Grade.REFUSE]),
        ("ardupilot", "ardupilot", px4.AUTOPILOT, [Grade.REFUSE]),
        ("ardupilot", "px4", px4.AUTOPILOT, [Grade.WARNING]),
        ("px4", None, UNKNOWN, []),  # which is refused for that already
    ],
)
def test_a_profile_of_another_autopilot_is_refused_unless_the_mission_means_it(
    autopilot: AutopilotName | None, chosen: AutopilotName | None, flies: Autopilot, grades: list[Grade]
) -> None:
    findings = found(profiled(autopilot, chosen), autopilot=flies)
    assert [each.grade for each in findings] == grades
    for finding in findings:
        assert finding.subject == "vehicle 2"
        assert f"'stub' is for {'PX4' if autopilot == 'px4' else 'ArduPilot'}" in finding.found
        assert finding.found.endswith(f"reports {flies.label}")


def test_another_autopilot_is_reported_once() -> None:
    mission = flown_with(identified(autopilot="px4"), profiled("px4"))
    refused, rest = found(mission, autopilot=ardupilot.AUTOPILOT)
    assert (refused.grade, rest.grade) == (Grade.REFUSE, Grade.PASS)


EXCITED = excitation_mission(CASE2, 2)


def test_what_is_flown_to_identify_does_not_rest_on_the_plant_file() -> None:
    assert found(flown_with(identified(date=date(2000, 1, 1)), EXCITED)) == []


def test_a_flight_for_identification_is_judged_by_its_own_box_and_speed() -> None:
    findings = preflight(EXCITED, [well(2)])
    assert [each for each in findings if each.grade is not Grade.PASS] == []
    told = {each.check: each.found for each in findings}
    foreseen = preview(EXCITED.agent_config(EXCITED.vehicles[0]))
    assert f" {foreseen.speed_m_s:.2f} m/s;" in told["speed limit"]
    assert f" {foreseen.acceleration_m_s2:.2f} m/s²;" in told["acceleration limit"]
    assert not {"target speed", "ring acceleration", "formation speed"} & set(told)
    assert extent_m(EXCITED, EXCITED.vehicles[0]) == pytest.approx((17.0**2 + 5.0**2) ** 0.5)
    assert max(x for x, _ in route(EXCITED, EXCITED.vehicles[0])) == 17.0
