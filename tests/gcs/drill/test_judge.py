"""What a drill makes of what it saw: a reaction in time, one that came late or not at all, and what must not happen."""

from dataclasses import replace
from math import pi

import pytest

from gcs.drill.judge import Expectation, TeamLog, failures, reacted_s, respaced

BEGAN_S, UNTIL_S = 100.0, 105.0
HOLD = Expectation((3,), (1, 2), 1.5, tactic="hold", alert="telemetry stale", separation_m=3.0)
OUT = Expectation((1, 2, 3), (), 2.0, leaves_offboard=True, separation_m=3.0)
BORNE = Expectation((), (1, 2, 3), None, separation_m=3.0, radius_m=10.0)


@pytest.fixture
def log() -> TeamLog:
    """Three vehicles on their ring, and all is well."""
    log = TeamLog()
    for vehicle in (1, 2, 3):
        log.note_mode(90.0, vehicle, "offboard")
        log.note_status(90.0, vehicle, "encircle", "")
        log.note_status(UNTIL_S - 0.1, vehicle, "encircle", "")
        log.radii_m[vehicle].append((102.0, 10.1))
        log.bearings_rad[vehicle] = (102.0, vehicle * 2.0 * pi / 3.0)
    for at_s in (100.0, 102.0, 104.0):
        log.note_places(at_s, {1: (0.0, 0.0, 8.0), 2: (5.0, 0.0, 8.0), 3: (0.0, 5.0, 8.0)})
    return log


def test_undisturbed_is_no_reaction_and_nothing_else_wrong(log: TeamLog) -> None:
    assert reacted_s(HOLD, log, BEGAN_S) is None
    assert failures(HOLD, log, BEGAN_S, UNTIL_S) == ["vehicle 3 did not react: offboard, encircle"]
    assert [fault[:23] for fault in failures(OUT, log, BEGAN_S, UNTIL_S)] == [
        f"vehicle {i} did not react" for i in (1, 2, 3)
    ]
    assert failures(BORNE, log, BEGAN_S, UNTIL_S) == []


def test_a_reaction_is_complete_with_tactic_and_alert(log: TeamLog) -> None:
    log.note_status(101.0, 3, "encircle", "telemetry stale")
    assert reacted_s(HOLD, log, BEGAN_S) is None
    log.note_status(101.2, 3, "hold", "telemetry stale")
    assert reacted_s(HOLD, log, BEGAN_S) == 101.2
    log.received_s[3] = UNTIL_S
    assert failures(HOLD, log, BEGAN_S, UNTIL_S) == []


def test_a_lost_vehicle_has_to_be_reported_as_unaccounted_for_and_not_only_to_leave_offboard(log: TeamLog) -> None:
    lost = Expectation((3,), (1, 2), 90.0, leaves_offboard=True, is_unaccounted=True, separation_m=3.0)
    log.note_mode(101.0, 3, "hold")
    assert reacted_s(lost, log, BEGAN_S) is None
    assert failures(lost, log, BEGAN_S, UNTIL_S) == ["vehicle 3 did not react: hold, encircle"]
    log.unaccounted_s[3] = 104.0
    assert reacted_s(lost, log, BEGAN_S) == 104.0
    assert failures(lost, log, BEGAN_S, UNTIL_S) == []


def test_a_vehicle_with_a_limit_of_its_own_is_held_to_it(log: TeamLog) -> None:
    mixed = replace(OUT, limit_s=6.0, limits_s={1: 2.0, 2: 6.0, 3: 2.0})
    for at_s, vehicle in ((101.5, 1), (104.5, 2), (102.5, 3)):
        log.note_mode(at_s, vehicle, "land")
    assert failures(mixed, log, BEGAN_S, UNTIL_S) == ["vehicle 3 reacted after 2.5 s, not within 2 s"]


def test_what_was_so_before_the_fault_did_not_come_of_it(log: TeamLog) -> None:
    log.note_status(99.0, 3, "hold", "telemetry stale")
    assert reacted_s(HOLD, log, BEGAN_S) is None


def test_coming_back_by_itself_is_wrong(log: TeamLog) -> None:
    for at_s, vehicle in ((101.0, 2), (101.5, 1), (101.25, 3)):
        assert reacted_s(OUT, log, BEGAN_S) is None, "the last of several counts"
        log.note_mode(at_s, vehicle, "land")
    assert reacted_s(OUT, log, BEGAN_S) == 101.5
    assert failures(OUT, log, BEGAN_S, UNTIL_S) == []
    log.note_mode(103.0, 2, "offboard")
    assert failures(OUT, log, BEGAN_S, UNTIL_S) == ["vehicle 2 returned to offboard by itself"]


def test_going_on_with_the_mission_by_itself_is_wrong(log: TeamLog) -> None:
    log.note_status(101.0, 3, "hold", "telemetry stale")
    log.note_status(104.8, 3, "formation", "")
    assert failures(HOLD, log, BEGAN_S, UNTIL_S) == ["vehicle 3 returned to 'formation' by itself"]


def test_others_that_react_are_told(log: TeamLog) -> None:
    log.note_status(101.0, 3, "hold", "telemetry stale")
    log.note_status(102.0, 1, "aside", "all peers silent")
    log.note_mode(103.0, 2, "hold")
    log.received_s |= {1: UNTIL_S, 3: UNTIL_S}
    assert failures(HOLD, log, BEGAN_S, UNTIL_S) == [
        "vehicle 1 went from 'encircle' to 'aside' (all peers silent)",
        "vehicle 2 left offboard for hold",
    ]


def test_who_has_landed_for_good_is_no_longer_looked_at(log: TeamLog) -> None:
    log.note_status(101.0, 3, "land", "battery low")
    log.note_mode(101.0, 3, "land")
    assert failures(Expectation((), (1, 2), None, separation_m=3.0), log, BEGAN_S, UNTIL_S) == []


def test_in_offboard_with_nobody_behind_it(log: TeamLog) -> None:
    log.received_s[2] = UNTIL_S - 2.0
    assert failures(BORNE, log, BEGAN_S, UNTIL_S) == ["vehicle 2 is in offboard without an agent"]


def test_too_near_at_one_height_only(log: TeamLog) -> None:
    log.note_places(104.5, {1: (0.0, 0.0, 8.0), 2: (0.0, 2.0, 9.5)})
    assert failures(BORNE, log, BEGAN_S, UNTIL_S) == []
    log.note_places(104.6, {1: (0.0, 0.0, 8.0), 2: (0.0, 2.71, 8.5)})
    assert failures(BORNE, log, BEGAN_S, UNTIL_S) == []
    log.note_places(104.7, {1: (0.0, 0.0, 8.0), 2: (0.0, 2.69, 8.5)})
    assert failures(BORNE, log, BEGAN_S, UNTIL_S) == ["vehicles 1 and 2 came within 2.69 m of each other"]


def test_what_should_be_borne_is_not_when_somebody_stops_or_leaves_the_ring(log: TeamLog) -> None:
    log.radii_m[1].append((103.0, 12.5))
    log.note_status(104.9, 3, "hold", "estimator jumped")
    assert failures(BORNE, log, BEGAN_S, UNTIL_S) == [
        "vehicle 3 went from 'encircle' to 'hold' (estimator jumped)",
        "vehicle 1 was 2.5 m off the ring",
    ]


def test_who_stood_down_is_sent_nothing(log: TeamLog) -> None:
    stood_down = Expectation((3,), (1, 2), 1.5, tactic="pilot override", stands_back=True, separation_m=3.0)
    log.note_status(101.0, 3, "pilot override", "pilot took over")
    log.received_s[3] = UNTIL_S
    log.setpoint_s[3] = 101.2
    assert failures(stood_down, log, BEGAN_S, UNTIL_S) == []
    log.setpoint_s[3] = 101.5
    assert failures(stood_down, log, BEGAN_S, UNTIL_S) == [
        "vehicle 3 was sent a setpoint 0.5 s after the pilot override"
    ]


def test_uneven_gaps_on_the_ring_are_as_wanted_or_not(log: TeamLog) -> None:
    assert respaced((1, 2, 3), log)
    log.gaps = {1: 2.0}
    assert not respaced((1, 2, 3), log)
    log.bearings_rad |= {1: (104.0, 0.1), 2: (104.0, pi + 0.1), 3: (104.0, 1.5 * pi + 0.1)}
    assert log.uneven_deg((1, 2, 3)) == pytest.approx(0.0, abs=1e-9)
    assert respaced((1, 2, 3), log)


def test_a_gap_on_the_ring_is_closed_or_not(log: TeamLog) -> None:
    two = Expectation(
        (3,), (1, 2), 2.0, leaves_offboard=True, respacing=(1, 2), at_last="pilot override", separation_m=3.0
    )
    log.note_mode(101.0, 3, "land")
    log.note_status(102.0, 3, "pilot override", "pilot took over")
    assert not respaced(two.respacing, log)
    assert failures(two, log, BEGAN_S, UNTIL_S) == ["the others did not close the gap on the ring"]
    log.bearings_rad |= {1: (104.0, -0.1), 2: (104.0, pi + 0.2)}
    assert respaced(two.respacing, log)
    assert failures(two, log, BEGAN_S, UNTIL_S) == []
    log.note_status(103.0, 3, "hold", "")
    assert "vehicle 3 ended at 'hold', not at 'pilot override'" in failures(two, log, BEGAN_S, UNTIL_S)
