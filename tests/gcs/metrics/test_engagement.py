"""Who was to engage and who did: lines that pass a target, with thresholds of their own, and missions that are cut."""

from collections.abc import Mapping
from dataclasses import replace
from math import sqrt

import numpy as np
import pytest

from agents.flight_end import FlightEnd
from gcs.metrics.ending import VehicleEnding
from gcs.metrics.record import FlightRecord, LoopStatistics, VehicleTrack
from gcs.metrics.references import (
    GRACE_S,
    EngagementReference,
    EngagementResult,
    engaged_line,
    engagement,
    engagement_reference,
)
from gcs.metrics.vehicles import engagement_times_s
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.support.mission_text import content, parsed, put

SPEED_M_S, TARGET_X_M, DISTANCE_M = 0.5, 50.0, 12.0


def passing(
    offsets_m: Mapping[int, float], *, until_s: float = 300.0, engages: tuple[int, ...] = (), tactic: str = "formation"
) -> FlightRecord:
    """A line along x at these distances beside the target's y; those that engage do so 12 m from the target."""
    time_s = np.arange(round(until_s * 10.0) + 1) / 10.0
    target_m = np.tile([TARGET_X_M, 0.0], (time_s.size, 1))
    tracks = []
    for vehicle_id, y in offsets_m.items():
        position_m = np.column_stack((SPEED_M_S * time_s, np.full(time_s.size, y)))
        near = np.hypot(*(position_m - target_m).T) < DISTANCE_M
        joined = np.maximum.accumulate(near) & (vehicle_id in engages)
        tactics = np.where(joined, "encircle", tactic)
        tracks.append(VehicleTrack(vehicle_id, position_m, np.tile([SPEED_M_S, 0.0], (time_s.size, 1)), tactics))
    still = np.zeros_like(target_m)
    loop = LoopStatistics(10.0, 1, 0)
    return FlightRecord("line", 0, "simulation", "truth", time_s, target_m, still, tuple(tracks), loop, 1.0)


def told(record: FlightRecord, distance_max_m: Mapping[int, float]) -> EngagementResult:
    return engagement(record, EngagementReference(distance_max_m), engagement_times_s(record))


FIVE = {1: 15.0, 2: 10.0, 3: 5.0, 4: 0.0, 5: -5.0}
ALL = dict.fromkeys(FIVE, DISTANCE_M)


def test_one_of_five_that_passes_too_far_away_was_to_engage() -> None:
    result = told(passing(FIVE, engages=(2, 3, 4, 5)), ALL)
    assert result == EngagementResult((1, 2, 3, 4, 5), (2, 3, 4, 5))
    assert result.holds is False
    assert engaged_line(result) == "4 of 5 vehicles engaged; vehicle 1 did not"


def test_one_that_joined_and_fell_silent_before_it_engaged_was_to_engage() -> None:
    """It had no time for it: it was received for ten seconds."""
    flown = passing({each: y for each, y in FIVE.items() if each > 1}, engages=(2, 3, 4))
    *others, last = flown.vehicles
    brief = np.where((flown.time_s > 5.0) & (flown.time_s < 15.0), last.tactic, "unknown")
    record = replace(flown, vehicles=(*others, replace(last, tactic=brief)))
    assert told(record, ALL).to_engage == (2, 3, 4)
    silent = VehicleEnding(5, FlightEnd.LOST, "", joined=True, heard_s=15.0)
    assert told(replace(record, endings=(silent,)), ALL).missing == (5,)
    still = VehicleEnding(5, FlightEnd.FLIES_ON, "", joined=True, heard_s=15.0)
    assert told(replace(record, endings=(still,)), ALL).holds


def test_a_vehicle_that_stood_aside_all_the_time_was_to_engage_and_one_that_went_home_was_not() -> None:
    for tactic, holds in (("aside", False), ("hold", False), ("return and land", None), ("pilot override", None)):
        assert told(passing({1: 5.0}, tactic=tactic), {1: DISTANCE_M}).holds is holds


def test_a_vehicle_whose_thresholds_keep_it_in_the_line_was_not_to_engage() -> None:
    record = passing(FIVE, engages=(3,))
    assert told(record, {3: DISTANCE_M}) == EngagementResult((3,), (3,))
    of_their_own = {**dict.fromkeys(FIVE, 4.0), 3: DISTANCE_M}  # only vehicle 4 comes within its 4 m
    assert told(record, of_their_own).to_engage == (3, 4)


def test_a_team_that_never_comes_near_was_not_to_engage() -> None:
    assert told(passing({1: 20.0, 2: 25.0}), dict.fromkeys((1, 2), DISTANCE_M)) == EngagementResult()
    assert told(passing({1: 5.0}), {}) == EngagementResult()
    assert EngagementResult().holds is None


def test_a_flight_that_ends_before_they_had_time_asks_nothing_of_them() -> None:
    within_s = (TARGET_X_M - sqrt(DISTANCE_M**2 - 5.0**2)) / SPEED_M_S
    for end_s, holds in ((within_s + GRACE_S - 1.0, None), (within_s + GRACE_S + 1.0, False)):
        assert told(passing({1: 5.0}, until_s=end_s), {1: DISTANCE_M}).holds is holds
    # Of one that passes too far away the nearest place counts, abeam of the target.
    abeam_s = TARGET_X_M / SPEED_M_S
    for end_s, missing in ((abeam_s + GRACE_S - 1.0, ()), (abeam_s + GRACE_S + 1.0, (1,))):
        record = passing({1: 15.0, 2: 0.0}, until_s=end_s, engages=(2,))
        assert told(record, dict.fromkeys((1, 2), DISTANCE_M)).missing == missing


def test_those_whom_the_whole_mission_would_bring_near_are_pending_when_it_is_cut() -> None:
    reference = EngagementReference(ALL, planned=tuple(FIVE))

    def cut(until_s: float, engages: tuple[int, ...] = (), tactic: str = "formation") -> EngagementResult:
        flown = passing(FIVE, until_s=until_s, engages=engages, tactic=tactic)
        return engagement(flown, reference, engagement_times_s(flown))

    at_once = cut(5.0)
    assert at_once == EngagementResult(pending=(1, 2, 3, 4, 5))
    assert at_once.holds is None
    # Vehicle 4, whose line leads to the target, is 12 m from it after 76 s; vehicle 1 passes it at 15 m after 100 s.
    assert engaged_line(cut(80.0, engages=(4,))) == (
        "1 of 5 vehicles engaged; the flight ended before vehicles 1, 2, 3 and 5 could"
    )
    assert cut(80.0, engages=(4,)).holds is None
    late = cut(100.0 + GRACE_S + 1.0, engages=(2, 3, 4, 5))
    assert (late.missing, late.pending, late.holds) == ((1,), (), False)


def test_who_went_home_is_not_pending_and_who_was_not_heard_of_is() -> None:
    reference = EngagementReference(dict.fromkeys((1, 2), DISTANCE_M), planned=(1, 2))
    for tactic, pending in (("return and land", (2,)), ("standby", (1, 2)), ("hold", (1, 2))):
        flown = passing({1: 5.0}, until_s=5.0, tactic=tactic)
        assert engagement(flown, reference, engagement_times_s(flown)).pending == pending


def test_the_plan_brings_a_team_near_as_soon_as_one_of_it(subtests: pytest.Subtests) -> None:
    """In case 2 the target drifts off at half the line's speed: straight ahead of vehicle 3, 35 m away, it takes 230 s.

    Vehicle 2 has it 5 m aside, and vehicle 1 10 m.
    """
    case2 = content()
    for duration_s, planned in ((229.0, ()), (231.0, (1, 2, 3))):
        with subtests.test(duration_s=duration_s):
            mission = parsed(put(case2, ("mission", "duration_s"), duration_s))
            assert engagement_reference(mission).planned == planned
    apart = put(case2, ("vehicles", 0, "decision"), {"distance_max_m": 5.0})
    rows: tuple[tuple[Mission, tuple[int, ...]], ...] = (
        (load_mission("crossing"), ()),
        (load_mission("case1"), (1,)),
        (load_mission("case2", {"target.start_m": [300.0, 0.0]}), ()),
        (parsed(apart), (2, 3)),
        (parsed(put(case2, ("vehicles", 2, "reserve"), True)), (1, 2)),
        (load_mission("case2", {"target.source": "external", "target.start_m": [300.0, 0.0]}), (1, 2, 3)),
    )
    for mission, near in rows:
        with subtests.test(near=near):
            assert engagement_reference(mission).planned == near


def test_by_the_mission_those_engage_whose_own_thresholds_let_them() -> None:
    assert set(engagement_reference(load_mission("case1")).distance_max_m) == {1}
    case2 = content()
    by_threat = put(case2, ("vehicles", 1, "decision"), {"threat_max": 0.2})  # the target's is 0.2
    by_distance = put(by_threat, ("vehicles", 2, "decision"), {"distance_max_m": 3.0})
    assert dict(engagement_reference(parsed(by_distance)).distance_max_m) == {1: 12.0, 3: 3.0}
