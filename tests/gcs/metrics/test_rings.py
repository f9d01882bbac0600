"""Flights over several rings, whose errors and times are known in closed form."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agents.flight_end import FlightEnd
from agents.notes import RingCommanded
from agents.ring.commanded_ring import change_s
from gcs.metrics.ending import VehicleEnding
from gcs.metrics.metrics import evaluated
from gcs.metrics.record import FlightEvent, FlightRecord, VehicleTrack
from gcs.metrics.references import EngagementResult, ring_references
from gcs.metrics.result import FlightResult
from gcs.mission.mission import MissionRing
from tests.support.result_keys import RESULT_KEYS, RING_KEYS
from tests.support.ring_flights import (
    CLOSES_S,
    COMES_S,
    DURATION_S,
    ENGAGES_S,
    FROM_M,
    MOVES_S,
    RADII_M,
    RATES_RAD_S,
    TIME_S,
    five_vehicles,
    flown,
    on_ring,
    one_changes,
    target_path,
    two_rings,
)

pytestmark = pytest.mark.filterwarnings("error")
STEP_S = 0.1
MISSION = two_rings()


def judged(record: FlightRecord) -> FlightResult:
    return evaluated(MISSION, record)


def test_each_ring_has_its_own_vehicles_radius_rate_and_verdicts() -> None:
    result = judged(five_vehicles())
    east, north = result.rings
    assert (east.name, east.target, north.name, north.target) == ("east", "car", "north", "boat")
    assert [each.id for each in east.result.vehicles] == [1, 2, 3]
    assert [each.id for each in north.result.vehicles] == [4, 5]
    for ring, rate_rad_s in zip(result.rings, RATES_RAD_S, strict=True):
        assert ring.result.window_s == (ENGAGES_S, DURATION_S)
        assert ring.result.ring.settling_time_s == 0.0
        assert ring.result.ring.spacing_error_rms_deg == pytest.approx(0.0, abs=1e-9)
        for each in ring.result.vehicles:
            assert each.engaged_at_s == ENGAGES_S
            assert each.radius_error_rms_m == pytest.approx(0.02 * each.id)
            assert each.angular_rate_mean_rad_s == pytest.approx(rate_rad_s)
            assert each.angular_rate_error_rms_rad_s == pytest.approx(0.0, abs=1e-12)
        assert [ring.verdict(name) for name in ("C1", "C2", "C3")] == [True, True, True]
    assert [each.radius_error_rms_m for each in result.vehicles] == pytest.approx([0.02, 0.04, 0.06, 0.08, 0.1])
    assert result.window_s == (ENGAGES_S, DURATION_S)
    assert result.all_hold


def test_a_verdict_of_one_ring_that_fails_fails_for_the_team_as_tight_as_with_one_ring() -> None:
    allowed_m = MISSION.verdicts.radius_error_rms_m
    for error_m, holds in ((allowed_m - 1e-6, True), (allowed_m + 1e-6, False)):
        result = judged(five_vehicles((0.0, 0.0, 0.0, 0.0, error_m)))
        assert [each.verdict("C1") for each in result.rings] == [True, holds]
        assert result.verdicts.c1 is holds
        assert (result.verdicts.c2, result.verdicts.c3) == (True, True)


def test_the_worst_of_all_rings_stands_for_the_team() -> None:
    record = five_vehicles()
    late = on_ring(5, 1, np.pi + np.radians(4.0), RADII_M[1], engages_s=ENGAGES_S + 50.0)
    result = judged(replace(record, vehicles=(*record.vehicles[:4], late)))
    assert result.ring.spacing_error_max_deg == pytest.approx(4.0)
    assert result.ring.members_min == 2
    assert result.ring.judged_from_s == ENGAGES_S + 50.0
    assert result.window_s == (ENGAGES_S + 50.0, DURATION_S)
    assert result.rings[0].result.ring.spacing_error_max_deg == pytest.approx(0.0, abs=1e-9)
    assert result.verdicts.c3 is False


def test_a_ring_that_never_settles_is_not_settled_for_the_team() -> None:
    record = five_vehicles()
    off = on_ring(5, 1, np.pi, RADII_M[1] + 1.0)
    result = judged(replace(record, vehicles=(*record.vehicles[:4], off)))
    assert result.rings[0].result.ring.settling_time_s == 0.0
    assert result.ring.settling_time_s is None
    assert result.verdicts.c1 is False


def test_a_ring_that_a_vehicle_leaves_is_judged_with_three_and_then_with_two() -> None:
    east = judged(one_changes()).rings[0].result
    before, after = east.transitions
    assert (before.begins_at_s, before.members, before.settling_time_s) == (ENGAGES_S, 3, 0.0)
    assert (after.begins_at_s, after.members) == (MOVES_S, 2)
    # Two thirds of a turn, 120 degrees, become 180: within 5 degrees after 55 of the 60.
    settles_s = CLOSES_S * 55.0 / 60.0
    assert after.settling_time_s == pytest.approx(settles_s, abs=STEP_S)
    assert east.ring.settling_time_s == after.settling_time_s
    assert east.window_s is not None
    assert east.window_s[0] == pytest.approx(MOVES_S + settles_s, abs=STEP_S)
    assert east.ring.members_min == 2
    # The errors fall from 5 degrees to 0 within CLOSES_S / 12, and are 0 then.
    falling_s, window_s = CLOSES_S / 12.0, DURATION_S - MOVES_S - settles_s
    assert east.ring.spacing_error_rms_deg == pytest.approx(np.sqrt(25.0 / 3.0 * falling_s / window_s), rel=0.05)
    assert [each.radius_error_rms_m for each in east.vehicles] == [pytest.approx(0.0, abs=1e-9)] * 2 + [None]
    assert east.verdicts.c3 is True


def test_a_ring_to_which_a_vehicle_comes_is_judged_with_three_once_it_is_there() -> None:
    result = judged(one_changes())
    north = result.rings[1].result
    before, after = north.transitions
    assert (before.begins_at_s, before.members) == (ENGAGES_S, 2)
    assert (after.begins_at_s, after.members) == (MOVES_S, 3)
    settles_s = COMES_S * (1.0 - 0.05 * RADII_M[1] / FROM_M)
    assert north.ring.settling_time_s == pytest.approx(settles_s, abs=STEP_S)
    assert [each.id for each in north.vehicles] == [3, 4, 5]
    assert north.vehicles[0].engaged_at_s == MOVES_S
    assert result.vehicles[2].engaged_at_s == ENGAGES_S
    assert result.vehicles[2].radius_error_rms_m == north.vehicles[0].radius_error_rms_m
    assert result.vehicles[2].angular_rate_mean_rad_s == pytest.approx(RATES_RAD_S[1])
    assert result.verdicts.kept is True
    assert result.engagement == EngagementResult((1, 2, 3, 4, 5), (1, 2, 3, 4, 5))


def test_a_change_too_late_to_settle_is_not_judged() -> None:
    later = TIME_S >= DURATION_S - 5.0
    record = five_vehicles()
    leaves = on_ring(3, np.where(later, 1, 0), 4.2, np.where(later, 42.0, RADII_M[0]))
    result = judged(replace(record, vehicles=(*record.vehicles[:2], leaves, *record.vehicles[3:])))
    for each in result.rings:
        assert each.result.window_s is not None
        assert each.result.window_s[1] == pytest.approx(DURATION_S - 5.0 - STEP_S)
        assert each.result.ring.members_min == len(each.result.vehicles) - (each.name == "north")


def test_a_ring_that_all_have_left_is_judged_until_then() -> None:
    moved = TIME_S >= MOVES_S - 1e-9
    record = five_vehicles()
    leaving = [
        on_ring(number, np.where(moved, 0, 1), phase_rad, np.where(moved, RADII_M[0], RADII_M[1] + 0.3))
        for number, phase_rad in ((4, np.where(moved, 1.0, 0.0)), (5, np.where(moved, 3.0, np.pi)))
    ]
    result = judged(replace(record, vehicles=(*record.vehicles[:3], *leaving)))
    north = result.rings[1].result
    assert north.window_s is not None
    assert north.window_s == pytest.approx((ENGAGES_S, MOVES_S - STEP_S))
    assert [each.radius_error_rms_m for each in north.vehicles] == pytest.approx([0.3, 0.3])
    assert result.verdicts.c1 is False
    assert result.vehicles[3].radius_error_rms_m == pytest.approx(0.0, abs=1e-9)


def test_a_vehicle_in_formation_between_two_rings_has_left_the_first_and_comes_to_the_second() -> None:
    record = one_changes()
    between = (TIME_S >= MOVES_S - 1e-9) & (TIME_S < MOVES_S + 10.0 - 1e-9)
    mover = record.vehicles[2]
    mover = replace(mover, tactic=np.where(between, "formation", mover.tactic))
    east, north = judged(replace(record, vehicles=(*record.vehicles[:2], mover, *record.vehicles[3:]))).rings
    assert [each.begins_at_s for each in east.result.transitions] == [ENGAGES_S, MOVES_S]
    assert [each.begins_at_s for each in north.result.transitions] == [ENGAGES_S, MOVES_S + 10.0]


def test_the_way_between_two_rings_belongs_to_neither_and_is_no_departure() -> None:
    record = one_changes()
    arrives_s = MOVES_S + COMES_S
    transit = (TIME_S >= MOVES_S - 1e-9) & (arrives_s - 1e-9 > TIME_S)
    mover = record.vehicles[2]
    mover = replace(mover, tactic=np.where(transit, "transit", mover.tactic))
    lost = VehicleEnding(3, FlightEnd.LOST, "link lost")
    result = judged(replace(record, vehicles=(*record.vehicles[:2], mover, *record.vehicles[3:]), endings=(lost,)))
    east, north = result.rings
    assert [(each.begins_at_s, each.members) for each in east.result.transitions] == [(ENGAGES_S, 3), (MOVES_S, 2)]
    assert [(each.begins_at_s, each.members) for each in north.result.transitions] == [(ENGAGES_S, 2), (arrives_s, 3)]
    assert north.result.vehicles[0].engaged_at_s == arrives_s
    assert result.departures is not None
    assert [each.at_s for each in result.departures] == [DURATION_S]  # where the flight ends, with its vehicle lost


def test_a_ring_is_left_when_a_vehicle_sets_out_also_if_it_never_arrives() -> None:
    record = one_changes()
    mover = record.vehicles[2]
    mover = replace(mover, tactic=np.where(TIME_S >= MOVES_S - 1e-9, "transit", mover.tactic))
    result = judged(replace(record, vehicles=(*record.vehicles[:2], mover, *record.vehicles[3:])))
    assert [(each.begins_at_s, each.members) for each in result.rings[0].result.transitions] == [
        (ENGAGES_S, 3),
        (MOVES_S, 2),
    ]
    assert [each.id for each in result.rings[1].result.vehicles] == [4, 5]
    assert result.engagement.holds is True


def test_a_vehicle_on_its_way_to_a_ring_at_the_end_may_yet_engage() -> None:
    record = five_vehicles()
    setting_out = replace(record.vehicles[4], tactic=np.where(TIME_S < 590.0, "formation", "transit"))
    result = judged(replace(record, vehicles=(*record.vehicles[:4], setting_out)))
    assert result.engagement == EngagementResult((1, 2, 3, 4), (1, 2, 3, 4), (5,))
    assert result.verdicts.engaged is None
    # The formation is judged until the first vehicle leaves it, which one in transit has.
    early = replace(record.vehicles[4], tactic=np.where(TIME_S < 32.0, "formation", "transit"))
    result = judged(replace(record, vehicles=(*record.vehicles[:4], early)))
    assert result.verdicts.formation is None


def test_a_commanded_ring_is_that_of_its_number() -> None:
    commanded = RingCommanded(15.0, RATES_RAD_S[1], ring=1)
    wide = TIME_S >= MOVES_S - 1e-9
    record = five_vehicles((0.0,) * 5)
    wider = [
        on_ring(number, 1, phase_rad, np.where(wide, 15.0, RADII_M[1])) for number, phase_rad in ((4, 0.0), (5, np.pi))
    ]
    events = tuple(FlightEvent(MOVES_S, number, "command", "", ring=commanded) for number in (4, 5))
    result = judged(replace(record, vehicles=(*record.vehicles[:3], *wider), events=events))
    assert [each.verdict("C1") for each in result.rings] == [True, True]
    assert [each.begins_at_s for each in result.rings[0].result.transitions] == [ENGAGES_S]
    assert [each.begins_at_s for each in result.rings[1].result.transitions] == [ENGAGES_S, MOVES_S]
    changes_s = change_s(
        MISSION.rings[1].encirclement, MISSION.rings[1].encirclement.model_copy(update={"radius_m": 15.0}), 8.0
    )
    assert result.rings[1].result.ring.settling_time_s == pytest.approx(changes_s, abs=STEP_S)
    assert json.loads(result.to_json())["events"][0]["ring"]["ring"] == 1


def test_a_vehicle_without_a_ring_was_to_engage_only_if_there_was_a_place() -> None:
    record = five_vehicles()
    apart = on_ring(5, 0, 0.0, 0.0, engages_s=np.inf)
    left = replace(record, vehicles=(*record.vehicles[:4], apart))
    assert judged(left).engagement == EngagementResult((1, 2, 3, 4, 5), (1, 2, 3, 4))
    assert judged(left).verdicts.engaged is False
    full = evaluated(two_rings((3, 1)), left)
    assert full.engagement == EngagementResult((1, 2, 3, 4), (1, 2, 3, 4))
    assert full.verdicts.engaged is True


def test_rings_about_one_target_are_told_apart() -> None:
    stacked = tuple(
        MissionRing(name, 0, 3, each.encirclement) for name, each in zip(("low", "high"), MISSION.rings, strict=True)
    )
    mission = replace(MISSION, targets=(), rings=stacked)
    record = five_vehicles()
    shift_m = target_path(0).position_m - target_path(1).position_m
    engaged = TIME_S >= ENGAGES_S - 1e-9

    def about_the_first(track: VehicleTrack) -> VehicleTrack:
        velocity_m_s = target_path(0).velocity_m_s - target_path(1).velocity_m_s
        position_m = np.where(engaged[:, None], track.position_m + shift_m, track.position_m)
        return replace(
            track,
            position_m=position_m,
            velocity_m_s=np.where(engaged[:, None], track.velocity_m_s + velocity_m_s, track.velocity_m_s),
        )

    vehicles = (*record.vehicles[:3], *map(about_the_first, record.vehicles[3:]))
    result = evaluated(mission, replace(record, vehicles=vehicles, targets=record.targets[:1], ring_targets=(0, 0)))
    assert [[each.id for each in ring.result.vehicles] for ring in result.rings] == [[1, 2, 3], [4, 5]]
    assert [each.radius_error_rms_m for each in result.vehicles] == pytest.approx([0.02, 0.04, 0.06, 0.08, 0.1])
    assert [each.target for each in result.rings] == ["car", "car"]


def test_estimates_of_the_target_are_those_of_the_ring_of_the_moment() -> None:
    record, off_m = one_changes(), np.array([0.5, 0.0])
    unknown = np.full((TIME_S.size, 2), np.nan)

    def estimated(track: VehicleTrack) -> VehicleTrack:
        """What the vehicle knows without the truth: its own position and its target's have the same error."""
        target = record.target_of(track)
        seen = np.column_stack((np.add(target.position_m, off_m), target.velocity_m_s))
        return replace(track, position_m=np.add(track.position_m, off_m), target=seen)

    blind = replace(
        record,
        reference="estimate",
        vehicles=tuple(map(estimated, record.vehicles)),
        targets=tuple(replace(each, position_m=unknown, velocity_m_s=unknown) for each in record.targets),
        target_position_m=unknown,
        target_velocity_m_s=unknown,
    )
    for number, path_m in enumerate(blind.target_paths_m):
        np.testing.assert_allclose(path_m, np.add(target_path(number).position_m, off_m))
    np.testing.assert_allclose(blind.of_ring(1).target_path_m, np.add(target_path(1).position_m, off_m))
    by_truth, by_estimate = judged(record), judged(blind)
    for name in ("C1", "C2", "C3"):
        assert [each.verdict(name) for each in by_estimate.rings] == [True, True]
    assert [each.result.window_s for each in by_estimate.rings] == [each.result.window_s for each in by_truth.rings]


def test_json_has_the_documented_keys_of_each_ring() -> None:
    told = json.loads(judged(five_vehicles()).to_json())
    assert list(told) == [*RESULT_KEYS[""].split(), "rings"]
    for each, ids in zip(told["rings"], ([1, 2, 3], [4, 5]), strict=True):
        assert list(each) == RING_KEYS["rings[]"].split()
        assert [vehicle["id"] for vehicle in each["vehicles"]] == ids
        assert [list(vehicle) for vehicle in each["vehicles"]] == [RING_KEYS["vehicles of rings[]"].split()] * len(ids)
        assert list(each["verdicts"]) == ["C1", "C2", "C3"]


def test_a_ring_that_was_not_flown_is_without_figures_and_fails_nothing() -> None:
    record = five_vehicles()
    tracks = tuple(on_ring(number, 0, number * 2.0 * np.pi / 5.0, RADII_M[0]) for number in range(1, 6))
    result = evaluated(two_rings((5, 5)), replace(record, vehicles=tracks))
    assert result.rings[1].result.vehicles == ()
    assert result.rings[1].result.window_s is None
    assert [result.rings[1].verdict(name) for name in ("C1", "C2", "C3")] == [None, None, None]
    assert result.rings[1].not_judged == ()
    assert result.all_hold
    assert json.loads(result.to_json())["rings"][1]["ring"]["settling_time_s"] is None


def test_a_record_of_one_ring_is_its_own() -> None:
    record = flown(*five_vehicles().vehicles[:3])
    alone = replace(record, targets=(), ring_targets=())
    assert alone.of_ring(0) is alone


def test_a_vehicle_that_comes_back_makes_its_ring_settle_again() -> None:
    record, returns_s = five_vehicles((0.0,) * 5), MOVES_S + 100.0
    away = (TIME_S >= MOVES_S - 1e-9) & (returns_s - 1e-9 > TIME_S)
    mover = replace(record.vehicles[2], tactic=np.where(away, "transit", record.vehicles[2].tactic))
    east = judged(replace(record, vehicles=(*record.vehicles[:2], mover, *record.vehicles[3:]))).rings[0].result
    assert [(each.begins_at_s, each.members) for each in east.transitions] == [
        (ENGAGES_S, 3),
        (MOVES_S, 2),
        (returns_s, 3),
    ]
    assert east.window_s == (returns_s, DURATION_S)


def test_a_command_of_the_present_ring_changes_nothing_and_its_number_is_left_out_where_it_is_0() -> None:
    for number, ring in enumerate(MISSION.rings):
        same = RingCommanded(ring.encirclement.radius_m, ring.encirclement.angular_rate_rad_s, ring=number)
        event = FlightEvent(MOVES_S, 1, "command", "", ring=same)
        record = replace(five_vehicles(), events=(event,))
        assert [each.earlier for each in ring_references(MISSION, record)] == [(), ()]
        values = event.to_dict()["ring"]
        assert isinstance(values, dict)
        assert values.get("ring") == (number or None)


@pytest.mark.parametrize(("above_m", "closest_m"), [(3.0, 5.0), (2.0, 0.0), (None, None)])
def test_vehicles_above_each_other_are_separated_by_their_heights(
    above_m: float | None, closest_m: float | None
) -> None:
    """Two on one circle, one above the other; a third 5 m beside them in height of the first."""
    mission = two_rings()
    settings = [each.encirclement.model_copy(update={"altitude_m": 8.0}) for each in mission.rings]
    rings = tuple(replace(each, encirclement=ring) for each, ring in zip(mission.rings, settings, strict=True))
    stacked = replace(mission, rings=rings, safety=mission.safety.model_copy(update={"vertical_separation_m": 3.0}))
    still = np.zeros((TIME_S.size, 2))
    heights_m = (None,) * 3 if above_m is None else (8.0, 8.0 + above_m, 8.0)
    tracks = [
        VehicleTrack(
            number,
            still + np.array((0.0, y)),
            still,
            np.full(TIME_S.size, "formation"),
            altitude_m=None if height_m is None else np.full(TIME_S.size, height_m),
        )
        for number, y, height_m in zip((1, 2, 3), (0.0, 0.0, 5.0), heights_m, strict=True)
    ]
    assert evaluated(stacked, flown(*tracks)).closest_approach_m == closest_m
    assert evaluated(mission, flown(*tracks)).closest_approach_m == 0.0
