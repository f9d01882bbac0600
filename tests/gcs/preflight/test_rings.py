"""What is checked of each ring of a mission before take-off."""

from math import hypot

import pytest

from agents.team.messages import MISSION_RING, CommandedRing, RingValues
from gcs.mission.file import load_mission
from gcs.preflight.findings import MISSION, Finding, Grade
from gcs.preflight.mission import (
    extent_m,
    feasibility,
    full_ring,
    highest_m,
    ring_acceleration_m_s2,
    ring_change_faults,
    ring_speed_m_s,
)
from gcs.preflight.parameters import route
from tests.gcs.mission.test_rings import SEVERAL, STACK
from tests.support.mission_text import Content, parsed, put

# Near enough for all: the first ring is about the southern target, the second, "upper", about the northern one.
NEAR = put(SEVERAL, ("decision",), {"distance_max_m": 45.0})


def found(content: Content, check: str) -> list[Finding]:
    return [each for each in feasibility(parsed(content)) if each.check == check]


def test_each_ring_has_findings_with_its_name_and_its_keys(subtests: pytest.Subtests) -> None:
    for check in ("ring spacing", "settling", "sensor range", "reach", "target speed", "ring acceleration"):
        with subtests.test(check):
            findings = found(NEAR, check)
            assert [each.found.partition(":")[0] for each in findings] == ["ring south", "ring upper"]
            assert {(each.grade, each.about) for each in findings} == {(Grade.PASS, MISSION)}


def test_a_ring_is_checked_with_as_many_vehicles_as_it_has_places() -> None:
    """Two vehicles on a ring of 1.55 m are 3.1 m apart, and three on one of 10 m 17.3 m."""
    narrow, wide = found(put(NEAR, ("rings", 0, "radius_m"), 1.55), "ring spacing")
    assert (narrow.grade, wide.grade) == (Grade.WARNING, Grade.PASS)
    assert "2 vehicles on a ring of 1.55 m" in narrow.found
    assert "rings[0].radius_m" in narrow.next_step
    assert "3 vehicles on a ring of 10 m" in wide.found
    mission = parsed(NEAR)
    assert mission.formation.leader in full_ring(mission, 0).ids
    assert [len(full_ring(mission, number).vehicles) for number in (0, 1)] == [2, 3]


def test_a_target_that_only_some_sensors_see_from_its_ring() -> None:
    blind = put(NEAR, ("targets", 0, "sensor"), {"range_m": 9.0})
    south, upper = found(blind, "sensor range")
    assert (south.grade, upper.grade) == (Grade.PASS, Grade.WARNING)
    assert "shorter range: 1, 2, 3" in upper.found
    assert "targets[0].sensor.range_m" in upper.next_step


def test_enough_vehicles_have_to_come_near_to_each_target() -> None:
    """The northern target is 20 m left of the leader, 16 m of vehicle 1, and 24 m of vehicle 3."""
    south, upper = found(put(NEAR, ("decision", "distance_max_m"), 21.0), "reach")
    assert (south.grade, upper.grade) == (Grade.PASS, Grade.PASS)  # with five places two vehicles may be elsewhere
    assert "vehicles 1, 2 come near enough" in upper.found
    exact = put(put(NEAR, ("decision", "distance_max_m"), 21.0), ("rings", 0, "places"), 1)
    exact = put(exact, ("rings", 1, "places"), 2)
    assert {each.grade for each in found(exact, "reach")} == {Grade.PASS}
    _, few = found(put(put(exact, ("rings", 1, "places"), 3), ("vehicles",), [*exact["vehicles"], FOURTH]), "reach")
    assert few.grade is Grade.WARNING
    assert "vehicles 1, 2 come near enough to its target in formation; 3 have to" in few.found


FOURTH = {
    "id": 4,
    "url": "udpin://127.0.0.1:14543",
    "endpoint": "tcp/127.0.0.1:7464",
    "start_m": [0.0, -8.0],
}


def test_limits_of_vehicles_are_those_of_the_hardest_ring() -> None:
    mission = parsed(put(NEAR, ("rings", 1, "angular_rate_rad_s"), -0.2))
    assert ring_speed_m_s(mission) == pytest.approx(0.2 * 10.0)
    assert ring_speed_m_s(parsed(NEAR)) == pytest.approx(0.1 * 8.0 + 0.1)
    assert ring_acceleration_m_s2(mission) == pytest.approx(0.2**2 * 10.0)
    vehicle = mission.vehicle(3)
    short = parsed(put(put(NEAR, ("mission", "duration_s"), 60.0), ("targets", 1, "start_m"), [20.0, -20.0]))
    assert extent_m(short, vehicle) == pytest.approx(hypot(40.0, 24.0) + 10.0)
    assert [highest_m(parsed(STACK), each) for each in parsed(STACK).vehicles] == [12.0, 12.0, 12.0]
    assert max(y for _, y in route(mission, vehicle)) == pytest.approx(30.0, abs=0.1)
    assert min(y for _, y in route(mission, vehicle)) == pytest.approx(-28.0, abs=0.1)


def test_a_command_of_one_ring_is_checked_against_the_others_and_its_own_limits() -> None:
    mission = parsed(NEAR)
    assert ring_change_faults(mission, RingValues(radius_m=12.0), ring=1) == []
    (near,) = ring_change_faults(mission, RingValues(radius_m=29.0), ring=1)
    assert near.startswith("rings[1]: 3.00 m from rings[0]")
    (fast,) = ring_change_faults(mission, RingValues(angular_rate_rad_s=0.31), ring=0)
    assert fast.startswith("target speed: ring south: ")
    below = parsed(put(put(STACK, ("decision",), {"distance_max_m": 45.0}), ("target", "sensor", "range_m"), 60.0))
    (low,) = ring_change_faults(below, RingValues(altitude_m=9.0), ring=1)
    assert "1 m in height" in low
    raised = CommandedRing(altitude_m=5.0, altitude_s=1.0)
    rest = [MISSION_RING] * (len(below.rings) - 2)
    assert ring_change_faults(below, RingValues(altitude_m=9.0), [raised, MISSION_RING, *rest], 1) == []
    lowered = CommandedRing(altitude_m=9.0, altitude_s=1.0)
    (away,) = ring_change_faults(below, RingValues(radius_m=11.0), [MISSION_RING, lowered, *rest], 1)
    assert "1.00 m from rings[0] after 0 s, and 1 m in height" in away


def test_a_command_is_checked_with_the_values_that_vehicles_fly() -> None:
    """Messages have millimetres: of a command 0.4 mm too low there is nothing left, and 0.6 mm become a millimetre."""
    mission = parsed(put(put(STACK, ("decision",), {"distance_max_m": 45.0}), ("target", "sensor", "range_m"), 60.0))
    below_m, needed_m = mission.vehicles[0].section.altitude_m, mission.safety.vertical_separation_m
    assert ring_change_faults(mission, RingValues(altitude_m=below_m + needed_m - 4e-4), ring=1) == []
    (low,) = ring_change_faults(mission, RingValues(altitude_m=below_m + needed_m - 6e-4), ring=1)
    assert f"{needed_m - 1e-3:g} m in height" in low


def test_a_commanded_ring_has_to_be_within_the_range_of_the_mission_s_own() -> None:
    """The default of the range follows the mission's ring, not a commanded one: radios stay as they are."""
    mission = load_mission("case1").replace(encirclement={"angular_rate_rad_s": 0.005})
    faults = ring_change_faults(mission, RingValues(radius_m=110.0))
    assert any("network.range_m = 200 m" in each for each in faults), faults
