"""Metrics against flights whose errors are known in closed form."""

import json
from collections import Counter
from dataclasses import astuple, replace
from math import pi, radians, sqrt, tau

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.notes import RingCommanded
from estimation.state import Vector
from gcs.metrics.metrics import evaluate
from gcs.metrics.record import FlightEvent, FlightRecord, GuardTally, LoopStatistics, VehicleTrack
from gcs.metrics.references import DesiredRing, EarlierRing, FormationReference, ring_reference
from gcs.metrics.result import FlightResult, window_line
from gcs.metrics.reynolds import FlockingResult, ReynoldsResult
from gcs.metrics.ring import SETTLED_FOR_S, RingResult, judged_part, judged_ring, ring_motion
from gcs.mission.file import load_mission
from gcs.report.evidence.lyapunov import lyapunov_rad2
from tests.support.report_evidence import TOLERANCES
from tests.support.result_keys import RESULT_KEYS

pytestmark = pytest.mark.filterwarnings("error")

RING = DesiredRing(radius_m=10.0, angular_rate_rad_s=0.05)
SLOTS = {1: (0.0, 5.0), 2: (0.0, 0.0), 3: (0.0, -5.0)}
FORMATION = FormationReference(speed_m_s=0.2, slots_m=SLOTS)
TIME_S = np.arange(6001) / 10.0
TARGET_M = np.array([35.0, -5.0]) + TIME_S[:, None] * np.array([0.1, -0.03])
TARGET_M_S = np.tile([0.1, -0.03], (TIME_S.size, 1))

KEYS = RESULT_KEYS[""].split()
VEHICLE_KEYS = RESULT_KEYS["vehicles"].split()


def orbit(
    vehicle_id: int,
    phase_rad: float | Vector,
    radius_m: float | Vector = 10.0,
    rate_rad_s: float = 0.05,
    engaged_s: float = 0.0,
) -> VehicleTrack:
    """A circle about the moving target; radius and phase may vary with time (their rates are left out)."""
    angle = phase_rad + rate_rad_s * TIME_S
    outward = np.column_stack((np.cos(angle), np.sin(angle)))
    forward = np.column_stack((-np.sin(angle), np.cos(angle)))
    radius = np.broadcast_to(radius_m, TIME_S.shape)[:, None]
    tactic = np.where(engaged_s - 1e-9 <= TIME_S, "encircle", "formation")
    return VehicleTrack(vehicle_id, TARGET_M + radius * outward, TARGET_M_S + radius * rate_rad_s * forward, tactic)


def line(vehicle_id: int, error_m: float | Vector = 0.0, speed_error_m_s: float | Vector = 0.0) -> VehicleTrack:
    """Flight in formation, `error_m` off the slot in y and `speed_error_m_s` off the speed in x."""
    x, y = SLOTS[vehicle_id]
    position = np.column_stack((x + 0.2 * TIME_S, np.broadcast_to(y + error_m, TIME_S.shape)))
    velocity = np.column_stack((np.broadcast_to(0.2 + speed_error_m_s, TIME_S.shape), np.zeros(TIME_S.size)))
    return VehicleTrack(vehicle_id, position, velocity, np.full(TIME_S.size, "formation"))


def record(*vehicles: VehicleTrack, tick_us: Vector | None = None) -> FlightRecord:
    loop = LoopStatistics(10.0, 18000, 3, np.empty(0) if tick_us is None else tick_us)
    return FlightRecord(
        "case2", 7, "simulation", "truth", TIME_S, TARGET_M, TARGET_M_S, vehicles, loop, wall_time_s=6.0
    )


def judged(*vehicles: VehicleTrack, ring: DesiredRing = RING) -> FlightResult:
    return evaluate(record(*vehicles), ring, FORMATION, TOLERANCES)


def silenced(track: VehicleTrack, start_s: float, end_s: float) -> VehicleTrack:
    """The same track, not heard from `start_s` up to but not at `end_s`."""
    silent = (start_s - 1e-9 <= TIME_S) & (end_s - 1e-9 > TIME_S)
    return replace(
        track,
        position_m=np.where(silent[:, None], np.nan, track.position_m),
        velocity_m_s=np.where(silent[:, None], np.nan, track.velocity_m_s),
        tactic=np.where(silent, "unknown", track.tactic),
    )


def ring_of_three(**kwargs: float) -> list[VehicleTrack]:
    return [orbit(index + 1, index * tau / 3, **kwargs) for index in range(3)]


# --- the ring ---


def test_a_perfect_ring_has_no_errors() -> None:
    result = judged(*ring_of_three())
    assert result.window_s == (0.0, 600.0)
    assert result.ring.settling_time_s == 0.0
    assert result.ring.spacing_error_rms_deg == pytest.approx(0.0, abs=1e-9)
    assert result.ring.spacing_error_max_deg == pytest.approx(0.0, abs=1e-9)
    for vehicle in result.vehicles:
        assert vehicle.radius_error_rms_m == pytest.approx(0.0, abs=1e-9)
        assert vehicle.angular_rate_mean_rad_s == pytest.approx(0.05, abs=1e-12)
        assert vehicle.angular_rate_error_rms_rad_s == pytest.approx(0.0, abs=1e-12)
    assert result.verdicts.named() == {
        "C1": True,
        "C2": True,
        "C3": True,
        "formation": None,
        "separation": True,
        "engaged": None,
        "kept": True,
    }
    assert result.all_hold
    assert (result.ring.judged_s, result.ring.judged_from_s, result.ring.judged_share) == (600.0, 0.0, 1.0)
    assert result.ring.members_min == 3


def test_radius_errors_are_the_closed_form_of_an_offset_and_a_ripple() -> None:
    ripple_m = 0.3 * np.sin(tau * TIME_S / 20.0)  # thirty whole periods: rms 0.3 / sqrt 2
    constant, rippled = judged(orbit(1, 0.0, radius_m=10.25)), judged(orbit(1, 0.0, radius_m=10.0 + ripple_m))
    assert constant.vehicles[0].radius_error_rms_m == pytest.approx(0.25)
    assert constant.vehicles[0].radius_error_max_m == pytest.approx(0.25)
    assert rippled.vehicles[0].radius_error_rms_m == pytest.approx(0.3 / sqrt(2.0), rel=1e-3)
    assert rippled.vehicles[0].radius_error_max_m == pytest.approx(0.3, rel=1e-3)
    assert constant.verdicts.c1 is False
    assert judged(orbit(1, 0.0, radius_m=10.2 - 1e-6)).verdicts.c1 is True


def test_the_mean_rate_counts_whole_turns_and_direction() -> None:
    for rate, holds in ((0.053, False), (0.0515, True), (-0.05, False)):
        result = judged(orbit(1, 3.0, rate_rad_s=rate))  # wraps past pi within seconds, four turns or more in all
        assert result.vehicles[0].angular_rate_mean_rad_s == pytest.approx(rate, rel=1e-9)
        assert result.vehicles[0].angular_rate_error_rms_rad_s == pytest.approx(abs(rate - 0.05), rel=1e-9)
        assert result.verdicts.c2 is holds


def test_mean_rate_is_of_bearings_and_rate_error_of_velocities() -> None:
    track = orbit(1, 0.0)
    hasty = replace(track, velocity_m_s=TARGET_M_S + 1.2 * (track.velocity_m_s - TARGET_M_S))
    vehicle = judged(hasty).vehicles[0]
    assert vehicle.angular_rate_mean_rad_s == pytest.approx(0.05, rel=1e-9)
    assert vehicle.angular_rate_error_rms_rad_s == pytest.approx(0.01, rel=1e-9)


def test_spacing_errors_are_the_closed_form_of_displaced_bearings() -> None:
    """One of three displaced by d: spacings +d, -d, 0."""
    result = judged(orbit(1, radians(3.0)), orbit(2, tau / 3), orbit(3, -tau / 3))
    assert result.ring.spacing_error_rms_deg == pytest.approx(3.0 * sqrt(2.0 / 3.0))
    assert result.ring.spacing_error_max_deg == pytest.approx(3.0)
    assert result.verdicts.c3 is False


def test_lead_angles_wrap_around_and_follow_the_order_of_bearings_not_of_ids() -> None:
    motion = ring_motion(record(orbit(1, radians(170.0)), orbit(2, 0.0), orbit(3, radians(-170.0))))
    assert np.degrees(motion.lead_rad[:, 0]) == pytest.approx([20.0, 170.0, 170.0])
    assert np.degrees(motion.lead_rad).sum(axis=0) == pytest.approx(np.full(TIME_S.size, 360.0))


def test_desired_spacings_are_in_proportion_to_the_gaps_of_those_on_the_ring() -> None:
    """Twice the gap ahead of vehicle 2, counter-clockwise: 120 and 240 degrees, then 90, 180 and 90."""
    flight = record(orbit(1, 0.0), orbit(2, pi / 2), orbit(3, 1.5 * pi, engaged_s=300.0))
    motion = ring_motion(flight, {2: 2.0})
    assert np.degrees(motion.desired_spacing_rad[:, [0, 3000]]).T.ravel() == pytest.approx(
        [120.0, 240.0, np.nan, 90.0, 180.0, 90.0], nan_ok=True
    )
    _, ring = judged_ring(flight.time_s, motion, judged_part(flight.time_s, motion, RING, [0.0, 0.0, 300.0]))
    assert ring.settling_time_s == 0.0
    assert ring.spacing_error_max_deg == pytest.approx(0.0, abs=1e-9)
    assert lyapunov_rad2(motion)[-1] == pytest.approx(0.0, abs=1e-12)


def test_desired_spacing_is_that_of_the_vehicles_on_the_ring_at_the_time() -> None:
    """Two half a turn apart, then a third between them: 180 degrees were right before, 120 are after."""
    third = orbit(3, pi / 2, engaged_s=300.0)
    motion = ring_motion(record(orbit(1, 0.0), orbit(2, pi), third))
    assert np.degrees(motion.desired_spacing_rad[0, [0, 2999, 3000]]) == pytest.approx([180.0, 180.0, 120.0])
    result = judged(orbit(1, 0.0), orbit(2, pi), third)
    # It never settles: the window is the last quarter, with spacings of 90, 90 and 180 degrees.
    assert result.ring.settling_time_s is None
    assert result.window_s == (450.0, 600.0)
    assert result.ring.spacing_error_rms_deg == pytest.approx(sqrt((30.0**2 + 30.0**2 + 60.0**2) / 3.0))


# --- settling ---


def test_settling_runs_from_the_last_engagement_to_the_last_stray_radius() -> None:
    radius_m = np.where(TIME_S < 250.0 - 1e-9, 10.51, 10.49)
    tracks = [orbit(1, 0.0), orbit(2, tau / 3, engaged_s=200.0, radius_m=radius_m), orbit(3, -tau / 3)]
    result = judged(*tracks)
    assert [vehicle.engaged_at_s for vehicle in result.vehicles] == [0.0, 200.0, 0.0]
    assert result.ring.settling_time_s == pytest.approx(50.0)
    assert result.window_s == (250.0, 600.0)
    assert result.vehicles[1].radius_error_max_m == pytest.approx(0.49)


@pytest.mark.parametrize(("degrees", "settles_s"), [(4.9, 200.0), (5.1, 320.0)])
def test_settling_waits_for_spacings_within_five_degrees(degrees: float, settles_s: float) -> None:
    phase_rad = np.where(TIME_S < 320.0 - 1e-9, radians(degrees), 0.0)
    result = judged(orbit(1, phase_rad), orbit(2, tau / 3), orbit(3, -tau / 3, engaged_s=200.0))
    assert result.ring.settling_time_s == pytest.approx(settles_s - 200.0)


# --- one vehicle, nobody, nothing ---


def test_a_vehicle_alone_settles_but_has_no_spacing() -> None:
    result = judged(orbit(1, 0.0, radius_m=np.where(TIME_S < 4.0 - 1e-9, 12.0, 10.0)))
    assert result.ring.settling_time_s == pytest.approx(4.0)
    assert result.ring.spacing_error_rms_deg is None
    assert result.closest_approach_m is None
    assert (result.verdicts.c1, result.verdicts.c3, result.verdicts.separation) == (True, None, None)
    assert result.all_hold


def test_where_nobody_engages_the_ring_metrics_are_null() -> None:
    result = judged(line(1), line(2))
    plain = result.to_dict()
    assert plain["window_s"] is None
    assert plain["ring"] == dict.fromkeys(RESULT_KEYS["ring"].split())
    assert (result.verdicts.c1, result.verdicts.c2, result.verdicts.c3) == (None, None, None)
    assert result.verdicts.formation is True
    assert result.vehicles[0].radius_error_rms_m is None


def test_an_empty_record_has_a_result() -> None:
    empty = np.empty((0, 2))
    track = VehicleTrack(1, empty, empty, np.empty(0, dtype=np.str_))
    nothing = replace(
        record(track), time_s=np.empty(0), target_position_m=empty, target_velocity_m_s=empty, wall_time_s=0.0
    )
    result = evaluate(nothing, RING, FORMATION, TOLERANCES)
    assert (result.duration_s, result.realtime_factor, result.vehicles[0].tactic) == (0.0, None, "unknown")
    assert evaluate(replace(nothing, vehicles=()), RING, FORMATION, TOLERANCES).vehicles == ()


def test_a_ring_commanded_in_flight_is_judged_by_itself_from_its_command_on() -> None:
    """At 300 s another radius and rate, flown from 330 s on: 30 s to settle, and no error before or after."""
    changed_s, settled_s = 300.0, 330.0
    late = settled_s - 1e-9 <= TIME_S
    radius_m = np.where(late, 15.0, 10.0)
    turned_rad = np.where(late, 0.05 * settled_s - 0.02 * (TIME_S - settled_s), 0.05 * TIME_S)
    vehicles = []
    for index in range(3):
        track = orbit(index + 1, index * tau / 3 + turned_rad, radius_m, 0.0)
        rate = np.where(late, -0.02, 0.05)[:, None]
        offset_m = track.position_m - TARGET_M
        forward = np.column_stack((-offset_m[:, 1], offset_m[:, 0]))
        vehicles.append(replace(track, velocity_m_s=TARGET_M_S + rate * forward))
    told = [FlightEvent(changed_s + i / 10.0, i, "command", "", ring=RingCommanded(15.0, -0.02)) for i in (1, 2, 3)]
    mission = load_mission("case2")
    ring = ring_reference(mission, told)
    (earlier,) = ring.earlier
    assert replace(ring, earlier=()) == DesiredRing(
        15.0, -0.02, mission.gaps, above_m=0.8 * mission.safety.vertical_separation_m
    )
    assert earlier[:3] == (300.1, 10.0, 0.05)
    assert 5.0 / 1.0 < earlier.change_s < settled_s - 300.1  # 5 m at 1 m/s at most
    result = judged(*vehicles, ring=ring)
    assert result.ring.settling_time_s == pytest.approx(settled_s - 300.1)
    assert result.window_s == (settled_s, 600.0)
    for vehicle in result.vehicles:
        assert vehicle.radius_error_rms_m == pytest.approx(0.0, abs=1e-9)
        assert vehicle.angular_rate_mean_rad_s == pytest.approx(-0.02)
        assert vehicle.angular_rate_error_rms_rad_s == pytest.approx(0.0, abs=1e-9)
    assert [(each.begins_at_s, each.members) for each in result.transitions] == [(0.0, 3), (300.1, 3)]
    assert result.transitions[0].settling_time_s == 0.0
    # The same flight misses the mission's own ring.
    assert judged(*vehicles).ring.settling_time_s is None


def test_the_height_error_is_the_distance_from_the_plane_of_the_last_ring() -> None:
    """Vehicle 2 flies 2 m above the others; all are off by 0.3 m up and down, and by 5 m before the command."""
    heights = {1: {"altitude_m": 8.0}, 2: {"altitude_m": 10.0}, 3: {"altitude_m": 8.0}}
    mission = load_mission("case2").replace(vehicles=heights, encirclement={"tilt_bearing_deg": 90.0})
    told = FlightEvent(100.0, 1, "command", "", ring=RingCommanded(10.0, 0.05, 12.0, 20.0))
    ring = ring_reference(mission, [told])
    assert ring.earlier[0].change_s >= 4.0 + 10.0 * np.tan(np.radians(20.0))  # up from 8 m at 1 m/s at most
    off_m = np.where(TIME_S < 100.0, 5.0, np.where(np.arange(TIME_S.size) % 2, 0.3, -0.3))
    vehicles = []
    for track in ring_of_three():
        y_m = (track.position_m - TARGET_M)[:, 1]
        own_m = 14.0 if track.vehicle_id == 2 else 12.0
        vehicles.append(replace(track, altitude_m=own_m + np.tan(np.radians(20.0)) * y_m + off_m))
    errors_m = [each.height_error_rms_m for each in judged(*vehicles, ring=ring).vehicles]
    assert errors_m == pytest.approx([0.3] * 3)
    assert [each.height_error_rms_m for each in judged(*vehicles).vehicles] == [None] * 3
    assert [each.height_error_rms_m for each in judged(*ring_of_three(), ring=ring).vehicles] == [None] * 3


def test_a_ring_has_not_settled_while_its_rate_changes() -> None:
    """Radii and spacings are right all the time, and the rate is still another one."""
    ring = DesiredRing(10.0, 0.05, earlier=(EarlierRing(300.0, 10.0, -0.05, 12.0),))
    assert judged(*ring_of_three(), ring=ring).window_s == (312.0, 600.0)


def test_rings_in_quick_succession_count_once_though_vehicles_note_them_late() -> None:
    rings = [RingCommanded(12.0, -0.08), RingCommanded(15.0, 0.1), RingCommanded(15.0, -0.08)]
    told = [
        *(FlightEvent(80.0 + 0.2 * k, 1, "command", "", ring=each) for k, each in enumerate(rings)),
        *(FlightEvent(80.5 + 0.2 * k, 2, "command", "", ring=each) for k, each in enumerate(rings)),
        FlightEvent(81.5, 3, "command", "", ring=rings[-1]),
        FlightEvent(99.0, 3, "command", "", ring=rings[0]),
    ]
    ring = ring_reference(load_mission("case2"), told)
    assert ring.changed_s == pytest.approx([80.0, 80.2, 80.4, 99.0])


def test_a_ring_commanded_after_the_last_sample_begins_no_transition() -> None:
    ring = DesiredRing(12.0, 0.05, earlier=(EarlierRing(600.05, 10.0, 0.05, 5.0),))
    assert [each.begins_at_s for each in judged(*ring_of_three(), ring=ring).transitions] == [0.0]


def test_a_ring_commanded_before_any_vehicle_engages_begins_no_transition() -> None:
    ring = DesiredRing(10.0, 0.05, earlier=(EarlierRing(50.0, 20.0, 0.1),))
    result = judged(*ring_of_three(engaged_s=100.0), ring=ring)
    assert (result.ring.settling_time_s, [each.begins_at_s for each in result.transitions]) == (0.0, [100.0])


# --- formation ---


def test_formation_errors_are_the_closed_form_of_sinusoids() -> None:
    """Errors a sin and b cos against each other: spacing error rms sqrt((a² + b²) / 2)."""
    wave = tau * TIME_S / 19.0  # 30 whole periods in the 570 s that are judged
    result = judged(line(1, 0.12 * np.sin(wave)), line(2, 0.16 * np.cos(wave), 0.04 * np.sin(wave)), line(3, 0.0))
    first, second, third = result.vehicles
    assert first.formation_spacing_error_rms_m is None
    assert second.formation_spacing_error_rms_m == pytest.approx(0.2 / sqrt(2.0), rel=1e-3)
    assert third.formation_spacing_error_rms_m == pytest.approx(0.16 / sqrt(2.0), rel=1e-3)
    assert first.formation_speed_error_rms_m_s == pytest.approx(0.0, abs=1e-12)
    assert second.formation_speed_error_rms_m_s == pytest.approx(0.04 / sqrt(2.0), rel=1e-3)
    assert result.verdicts.formation is True
    assert result.closest_approach_m == pytest.approx(5.0 - 0.2, rel=1e-3)


def test_speed_across_the_line_of_travel_is_an_error_too() -> None:
    track = line(1)
    drifting = replace(track, velocity_m_s=track.velocity_m_s + np.array([0.03, 0.04]))
    assert judged(drifting).vehicles[0].formation_speed_error_rms_m_s == pytest.approx(0.05)


def test_formation_is_judged_from_30_s_to_the_first_engagement() -> None:
    bad = np.where((TIME_S < 30.0 - 1e-9) | (TIME_S >= 100.0 - 1e-9), 9.0, 0.0)
    leaving = orbit(3, 0.0, engaged_s=100.0)
    result = judged(line(1, bad, bad), line(2), leaving)
    assert result.vehicles[0].formation_speed_error_rms_m_s == pytest.approx(0.0, abs=1e-12)
    assert result.vehicles[1].formation_spacing_error_rms_m == pytest.approx(0.0, abs=1e-12)


def test_without_time_in_formation_before_the_first_engagement_there_is_no_verdict() -> None:
    result = judged(line(1), orbit(2, 0.0, engaged_s=20.0))
    assert result.vehicles[0].formation_speed_error_rms_m_s is None
    assert result.verdicts.formation is None


def test_a_formation_flown_for_less_than_ten_seconds_is_not_judged() -> None:
    """9 m off its slot from 30 s to the first engagement; the vehicle that engages flies there until then."""
    for engaged_s, verdict in ((31.3, None), (40.0, None), (40.2, False)):
        result = judged(line(1, 9.0), line(2), orbit(3, 0.0, engaged_s=engaged_s))
        assert result.verdicts.formation is verdict
        assert (result.vehicles[0].formation_speed_error_rms_m_s is None) is (verdict is None)
        assert "formation" not in result.not_judged, "as without any time in formation"
    held = [replace(each, tactic=np.where(TIME_S > 31.3, "hold", each.tactic)) for each in (line(1, 9.0), line(2))]
    result = evaluate(replace(record(*held), events=()), RING, FORMATION, TOLERANCES)
    assert (result.verdicts.formation, result.passes) == (None, None)
    assert "formation" in result.not_judged


def test_a_follower_is_judged_against_the_nearest_one_ahead_still_in_formation() -> None:
    away = replace(line(2, 3.0), tactic=np.full(TIME_S.size, "hold"))
    result = judged(line(1, 0.1), away, line(3, -0.1))
    assert result.vehicles[1].formation_spacing_error_rms_m is None
    assert result.vehicles[2].formation_spacing_error_rms_m == pytest.approx(0.2)


def test_the_formation_verdict_needs_speed_and_spacing() -> None:
    for error_m, speed_m_s, holds in ((0.3, 0.0, False), (0.0, 0.06, False), (0.2, 0.04, True)):
        assert judged(line(1), line(2, error_m, speed_m_s)).verdicts.formation is holds


# --- separation ---


def test_closest_approach_is_the_smallest_over_pairs_and_time() -> None:
    for closest_m, holds in ((2.9, False), (3.0, True)):
        passing = line(3)
        passing.position_m[1234] = line(2).position_m[1234] - (0.0, closest_m)
        result = judged(line(1), line(2), passing)
        assert result.closest_approach_m == pytest.approx(closest_m)
        assert result.verdicts.separation is holds
        assert result.all_hold is holds


def test_closest_approach_counts_the_moments_in_which_both_were_heard() -> None:
    assert judged(line(1), silenced(line(2), 100.0, 200.0)).closest_approach_m == pytest.approx(5.0)
    assert judged(line(1), silenced(line(2), 0.0, 601.0)).closest_approach_m is None


# --- Reynolds' rules ---


def test_reynolds_rules_in_formation_and_on_the_ring_are_what_the_geometry_says() -> None:
    """Side by side at y = 5, 0 and -5 for 300 s, then a ring about a target that stands still at the line's centre.

    In line the nearest is 5 m away; the outer two are 5 m off the centroid, the middle one 0. On the ring each chord
    is 2 R sin 60°, the speeds of R w = 0.5 m/s cancel out, and everybody is R off the centroid.
    """
    engaged_s = 300.0
    flying = engaged_s - 1e-9 <= TIME_S
    rest_m = np.zeros_like(TARGET_M)
    tracks = []
    for abreast, around in zip(map(line, SLOTS), ring_of_three(engaged_s=engaged_s), strict=True):
        orbit_m, orbit_m_s = around.position_m - TARGET_M, around.velocity_m_s - TARGET_M_S
        position_m = np.where(flying[:, None], orbit_m, abreast.position_m)
        velocity_m_s = np.where(flying[:, None], orbit_m_s, abreast.velocity_m_s)
        tracks.append(replace(around, position_m=position_m, velocity_m_s=velocity_m_s))
    flown = replace(record(*tracks), target_position_m=rest_m, target_velocity_m_s=rest_m)
    told = evaluate(flown, RING, FORMATION, TOLERANCES).reynolds
    chord_m, speed_m_s = 10.0 * sqrt(3.0), 0.5
    assert astuple(told.formation) == pytest.approx((5.0, 5.0, 0.0, 1.0, 10.0 / 3.0, 5.0), abs=1e-9)
    assert astuple(told.ring) == pytest.approx((chord_m, chord_m, speed_m_s, 0.0, 10.0, 10.0), abs=1e-9)
    # 3000 of the 6001 samples are in line, from the start on; the others are on the ring.
    line_share, ring_share = 3000 / 6001, 3001 / 6001
    whole = (
        5.0,
        5.0 * line_share + chord_m * ring_share,
        speed_m_s * sqrt(ring_share),
        line_share,
        10.0 / 3.0 * line_share + 10.0 * ring_share,
        10.0,
    )
    assert astuple(told.flight) == pytest.approx(whole)


def test_reynolds_rules_are_null_for_one_alone_and_for_stretches_that_were_not_flown() -> None:
    assert judged(orbit(1, 0.0)).reynolds == ReynoldsResult()
    never_engaged, at_once = judged(line(1), line(2)).reynolds, judged(*ring_of_three()).reynolds
    assert never_engaged.ring == FlockingResult()
    assert never_engaged.formation.separation_mean_m == pytest.approx(5.0)
    assert at_once.formation == FlockingResult()
    assert at_once.ring == at_once.flight


# --- vehicles not heard ---


def test_rows_in_which_a_vehicle_was_not_heard_are_ignored() -> None:
    """A gap of 100 s, most of a turn: no spacing of two vehicles is judged there, and no turn is lost."""
    tracks = ring_of_three()
    result = judged(tracks[0], silenced(tracks[1], 200.0, 300.0), tracks[2])
    assert result.ring.settling_time_s == 0.0
    assert result.ring.spacing_error_max_deg == pytest.approx(0.0, abs=1e-9)
    assert result.closest_approach_m == pytest.approx(10.0 * sqrt(3.0))
    assert result.vehicles[1].angular_rate_mean_rad_s == pytest.approx(0.05, rel=1e-9)
    assert result.vehicles[1].radius_error_max_m == pytest.approx(0.0, abs=1e-9)
    assert result.all_hold


def test_settling_needs_samples_in_which_everybody_was_heard() -> None:
    tracks = ring_of_three()
    result = judged(tracks[0], tracks[1], silenced(orbit(3, 2 * tau / 3, engaged_s=100.0), 100.1, 140.0))
    assert result.ring.settling_time_s == 0.0
    late = judged(tracks[0], silenced(tracks[1], 90.0, 140.0), orbit(3, 2 * tau / 3, engaged_s=100.0))
    assert late.ring.settling_time_s == pytest.approx(40.0)


def test_a_vehicle_silent_to_the_end_has_left_the_ring_unless_the_record_just_ended() -> None:
    """Once it has left, two vehicles 120 degrees apart are no ring."""
    tracks = ring_of_three()
    for silent_from_s, settled in ((596.0, True), (560.0, False)):
        result = judged(tracks[0], tracks[1], silenced(tracks[2], silent_from_s, 601.0))
        assert (result.ring.settling_time_s is not None) is settled
        assert result.vehicles[2].tactic == "encircle"


def test_a_target_not_known_for_a_while_and_a_vehicle_on_top_of_it_leave_no_nan() -> None:
    flown = record(orbit(1, 0.0, radius_m=np.where(TIME_S == 300.0, 0.0, 10.0)), orbit(2, pi))
    target_m = flown.target_position_m.copy()
    target_m[100:200] = np.nan
    result = evaluate(replace(flown, target_position_m=target_m), RING, FORMATION, TOLERANCES)
    assert "NaN" not in result.to_json()
    assert result.vehicles[0].radius_error_max_m is not None


# --- the whole ---


def rigid(track: VehicleTrack, rotation: Vector, shift_m: Vector) -> VehicleTrack:
    return replace(
        track, position_m=track.position_m @ rotation.T + shift_m, velocity_m_s=track.velocity_m_s @ rotation.T
    )


@settings(max_examples=8)
@given(st.floats(-pi, pi), st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-0.3, 0.3))
def test_no_rigid_motion_of_the_world_changes_the_ring_metrics(
    turn_rad: float, x_m: float, y_m: float, skew_rad: float
) -> None:
    wobble_m = 10.0 + 2.0 * np.exp(-TIME_S / 30.0) * np.cos(0.4 * TIME_S)
    flown = record(orbit(1, skew_rad * np.exp(-TIME_S / 50.0)), orbit(2, 2.0, radius_m=wobble_m), orbit(3, -2.0))
    rotation = np.array([[np.cos(turn_rad), -np.sin(turn_rad)], [np.sin(turn_rad), np.cos(turn_rad)]])
    shift_m = np.array([x_m, y_m])
    moved = replace(
        flown,
        target_position_m=flown.target_position_m @ rotation.T + shift_m,
        target_velocity_m_s=flown.target_velocity_m_s @ rotation.T,
        vehicles=tuple(rigid(track, rotation, shift_m) for track in flown.vehicles),
    )
    before, after = (evaluate(world, RING, FORMATION, TOLERANCES) for world in (flown, moved))
    assert after.window_s == before.window_s
    assert after.ring.settling_time_s == before.ring.settling_time_s
    assert after.ring.spacing_error_rms_deg == pytest.approx(before.ring.spacing_error_rms_deg, abs=1e-7)
    assert after.closest_approach_m == pytest.approx(before.closest_approach_m, abs=1e-7)
    for here, there in zip(before.vehicles, after.vehicles, strict=True):
        assert there.radius_error_rms_m == pytest.approx(here.radius_error_rms_m, abs=1e-7)
        assert there.angular_rate_mean_rad_s == pytest.approx(here.angular_rate_mean_rad_s, abs=1e-9)
        assert there.angular_rate_error_rms_rad_s == pytest.approx(here.angular_rate_error_rms_rad_s, abs=1e-9)


def test_json_has_the_documented_keys_in_their_order() -> None:
    tally = GuardTally(14, Counter({"separation": 13, "speed": 2}))
    flown = replace(record(*ring_of_three(), tick_us=np.arange(101.0)), guard=tally)
    result = evaluate(flown, RING, FORMATION, TOLERANCES)
    told = json.loads(result.to_json())
    assert list(told) == KEYS
    assert list(told["vehicles"][0]) == VEHICLE_KEYS
    assert list(told["reynolds"]) == ["formation", "ring", "flight"]
    assert list(told["reynolds"]["ring"]) == [
        "separation_min_m",
        "separation_mean_m",
        "alignment_error_rms_m_s",
        "alignment_order_mean",
        "cohesion_mean_m",
        "cohesion_max_m",
    ]
    assert list(told["ring"]) == RESULT_KEYS["ring"].split()
    assert told["loop"] == {"rate_hz": 10.0, "ticks": 18000, "missed": 3, "tick_p50_us": 50.0, "tick_p99_us": 99.0}
    assert list(told["verdicts"]) == ["C1", "C2", "C3", "formation", "separation", "engaged", "kept"]
    assert told["engagement"] == {"to_engage": [], "engaged": [1, 2, 3], "pending": []}
    assert (told["duration_s"], told["window_s"], told["guard_interventions"]) == (600.0, [0.0, 600.0], 14)
    assert told["realtime_factor"] == pytest.approx(100.0)


# --- truth and estimates ---

# Slow wanders of 0.3 m, one for each vehicle: of what it takes for its own position and for the target's alike.
PHASES_RAD = (0.0, 2.0, 4.0)


def wander(phase_rad: float) -> tuple[Vector, Vector]:
    """An error that turns once in 200 s, and its rate, (T, 2) each."""
    turn_rad_s = tau / 200.0
    angle = turn_rad_s * TIME_S + phase_rad
    off_m = 0.3 * np.column_stack((np.cos(angle), np.sin(angle)))
    return off_m, turn_rad_s * 0.3 * np.column_stack((-np.sin(angle), np.cos(angle)))


def wandering(track: VehicleTrack, phase_rad: float) -> VehicleTrack:
    """The track as a vehicle estimates it whose whole frame wanders."""
    off_m, off_m_s = wander(phase_rad)
    return replace(
        track,
        position_m=track.position_m + off_m,
        velocity_m_s=track.velocity_m_s + off_m_s,
        target=np.hstack((TARGET_M + off_m, TARGET_M_S + off_m_s)),
    )


def test_a_frame_that_wanders_is_no_error_of_the_ring_in_either_reference(subtests: pytest.Subtests) -> None:
    true = ring_of_three()
    estimated = [wandering(track, phase) for track, phase in zip(true, PHASES_RAD, strict=True)]
    by_truth = evaluate(replace(record(*true), estimates=tuple(estimated)), RING, FORMATION, TOLERANCES)
    by_estimate = evaluate(replace(record(*estimated), reference="estimate"), RING, FORMATION, TOLERANCES)
    plain = judged(*true)
    assert replace(by_truth, estimate=None) == plain
    assert plain.estimate is None
    assert by_truth.estimate is not None
    for name, result in (("truth", by_truth), ("beside", by_truth.estimate), ("estimate", by_estimate)):
        with subtests.test(reference=name):
            assert result.ring.settling_time_s == 0.0
            assert result.ring.spacing_error_max_deg == pytest.approx(0.0, abs=1e-9)
            for vehicle in result.vehicles:
                assert vehicle.radius_error_max_m == pytest.approx(0.0, abs=1e-9)
                assert vehicle.angular_rate_mean_rad_s == pytest.approx(0.05, abs=1e-12)
    for beside in by_truth.estimate.vehicles:
        assert beside.estimate_error_rms_m == pytest.approx(0.3)
        assert beside.estimate_error_max_m == pytest.approx(0.3)
    assert (by_truth.verdicts, by_truth.transitions) == (plain.verdicts, plain.transitions)
    (transition,), (of_estimates,) = plain.transitions, by_estimate.transitions
    assert of_estimates.speed_max_m_s == pytest.approx(transition.speed_max_m_s)
    assert of_estimates.forwards_min_m_s == pytest.approx(transition.forwards_min_m_s)
    (first, *_) = json.loads(by_truth.to_json())["estimate"]["vehicles"]
    assert first["id"] == 1


def test_verdicts_and_window_are_by_truth_where_both_are_known() -> None:
    """Estimates of a perfect ring do not hide a true one that is 0.4 m too wide, and 6 % too wide until 100 s."""
    radius_m = np.where(TIME_S < 100.0, 10.6, 10.4)
    true = [orbit(index + 1, index * tau / 3, radius_m=radius_m) for index in range(3)]
    seen = [replace(track, target=np.hstack((TARGET_M, TARGET_M_S))) for track in ring_of_three()]
    result = evaluate(replace(record(*true), estimates=tuple(seen)), RING, FORMATION, TOLERANCES)
    assert result.verdicts.c1 is False
    assert result.window_s == (100.0, 600.0)
    assert [vehicle.radius_error_rms_m for vehicle in result.vehicles] == pytest.approx([0.4] * 3)
    assert result.estimate is not None
    assert result.estimate.ring.settling_time_s == 0.0
    for vehicle in result.estimate.vehicles:
        assert vehicle.radius_error_rms_m == pytest.approx(0.0, abs=1e-9)
        assert vehicle.estimate_error_rms_m == pytest.approx(0.4)  # in the window


def test_a_vehicle_that_sees_no_target_has_no_figure_by_estimate_and_the_ring_is_not_settled() -> None:
    seen = [replace(track, target=np.hstack((TARGET_M, TARGET_M_S))) for track in ring_of_three()]
    blind = np.where((TIME_S < 50.0)[:, None], np.nan, np.hstack((TARGET_M, TARGET_M_S)))
    result = judged(seen[0], replace(seen[1], target=blind), seen[2])
    assert result.ring.settling_time_s == 50.0
    assert result.vehicles[1].radius_error_rms_m == pytest.approx(0.0, abs=1e-9)
    never = judged(seen[0], replace(seen[1], target=np.full_like(blind, np.nan)), seen[2])
    assert never.vehicles[1].radius_error_rms_m is None
    assert never.ring == RingResult(judged_s=0.0, judged_share=0.0, members_min=0)
    assert (never.verdicts.c1, never.not_judged) == (None, ("C1", "C2", "C3"))


def test_a_target_that_nothing_simulates_is_drawn_where_the_vehicles_see_it() -> None:
    unknown = np.full_like(TARGET_M, np.nan)
    off_m = np.array([0.3, -0.1, 0.0, 0.0])
    target = np.hstack((TARGET_M, TARGET_M_S))
    seen = [replace(orbit(1, 0.0), target=target + off_m), replace(orbit(2, pi), target=target - off_m)]
    flown = replace(record(*seen), target_position_m=unknown, target_velocity_m_s=unknown)
    np.testing.assert_allclose(flown.target_path_m, TARGET_M, atol=1e-9)
    np.testing.assert_array_equal(record(*seen).target_path_m, TARGET_M)
    assert evaluate(flown, RING, FORMATION, TOLERANCES).vehicles[0].radius_error_max_m == pytest.approx(0.3, rel=0.1)


# --- the window ---


def off_between(*spans_s: tuple[float, float]) -> list[VehicleTrack]:
    """Three on a ring, of which the first is a metre off its radius during these spans."""
    off = np.any([(begin_s <= TIME_S) & (end_s > TIME_S) for begin_s, end_s in spans_s], axis=0)
    return [orbit(1, 0.0, radius_m=np.where(off, 11.0, 10.0)), *ring_of_three()[1:]]


def test_a_ring_that_unsettled_late_is_told_as_that() -> None:
    """The same flight was: settled after 575 s, judged over the last 25 s."""
    result = judged(*off_between((0.0, 20.0), (560.0, 575.0)))
    assert result.window_s == (575.0, 600.0)
    assert (result.ring.first_settled_at_s, result.ring.unsettled_at_s) == (20.0, 560.0)
    assert window_line(result) == (
        "ring judged over only 25.0 s from 575.0 s on, 4% of its time: "
        "settled at 20.0 s, left its limits at 560.0 s, settled again at 575.0 s"
    )


def test_a_ring_that_unsettled_for_good_is_told_as_that() -> None:
    result = judged(*off_between((0.0, 20.0), (300.0, 305.0), (590.0, 601.0)))
    assert result.ring.settling_time_s is None
    assert (result.ring.first_settled_at_s, result.ring.unsettled_at_s) == (20.0, 590.0)
    unsettled = "settled at 20.0 s, left its limits at 590.0 s, did not settle again: last quarter of the flight"
    assert window_line(result).endswith(unsettled)


def test_a_ring_that_settled_once_or_never_left_nothing() -> None:
    settled, never = judged(*off_between((0.0, 20.0))), judged(*off_between((0.0, 601.0)))
    briefly = judged(*off_between((0.0, 20.0), (20.0 + SETTLED_FOR_S - 1.0, 100.0)))
    for result in (settled, never, briefly):
        assert (result.ring.first_settled_at_s, result.ring.unsettled_at_s) == (None, None)
    assert window_line(settled) == "ring judged over 580.0 s from 20.0 s on, 97% of its time: from settling to the end"
    window = "ring judged over only 150.0 s from 450.0 s on, 25% of its time"
    assert window_line(never) == f"{window}: did not settle: last quarter of the flight"
    assert window_line(judged(line(1), line(2))) == ""
    wide = ring_of_three(radius_m=12.0)
    disbanded = judged(*(replace(each, tactic=np.where(TIME_S > 400.0, "hold", each.tactic)) for each in wide))
    assert window_line(disbanded) == "ring not judged: no vehicle was on the ring at the end"
    assert (disbanded.ring.judged_s, disbanded.not_judged) == (0.0, ("C1", "C2", "C3"))


def test_a_ring_that_begins_within_its_window_is_judged_from_there_and_with_those_who_were_there() -> None:
    """The last quarter of 600 s begins at 450 s; two engage at 580 s and 12 s later leave again, by order."""
    result = judged(*off_for(12.0, 580.0))
    assert result.window_s == (450.0, 600.0)
    assert (result.ring.judged_from_s, result.ring.judged_s, result.ring.judged_share) == (580.0, 12.0, 1.0)
    assert window_line(result) == (
        "ring judged over only 12.0 s from 580.0 s on, 100% of its time, with 2 of 3 vehicles: "
        "did not settle: last quarter of the flight"
    )
    assert (result.verdicts.c1, result.passes) == (False, False)


def off_for(lasting_s: float, engaged_s: float) -> list[VehicleTrack]:
    """Two on a ring, both 2 m off its radius, for a time; the third flies on in formation, far away."""
    third = replace(line(3), position_m=line(3).position_m - (0.0, 50.0))
    late = [orbit(each, each * pi, radius_m=12.0, engaged_s=engaged_s) for each in (1, 2)]
    ends_s = engaged_s + lasting_s + 1e-9
    return [*(replace(each, tactic=np.where(ends_s < TIME_S, "hold", each.tactic)) for each in late), third]


def test_a_ring_that_was_flown_too_briefly_is_not_judged() -> None:
    for lasting_s, c1 in ((2.0, None), (9.9, None), (10.0, False)):
        assert judged(*off_for(lasting_s, 580.0)).verdicts.c1 is c1
    brief = judged(*off_for(2.0, 590.0))
    assert (brief.ring.judged_from_s, brief.ring.judged_s) == (590.0, 2.0)
    assert brief.not_judged == ("C1", "C2", "C3")
    assert window_line(brief) == "ring not judged: only 2.0 s from 590.0 s on, and 10 s are needed"


def test_a_ring_that_settled_just_before_the_end_is_not_judged() -> None:
    """Its spacing keeps 5 degrees, within which it has settled; 3 degrees are tolerated."""
    assert TOLERANCES.spacing_error_rms_deg < 4.9
    for settled_s, c3 in ((598.7, None), (590.0, False)):
        radius_m = np.where(settled_s - 1e-9 > TIME_S, 11.0, 10.0)
        result = judged(orbit(1, radians(4.9), radius_m), *ring_of_three()[1:])
        assert result.window_s == (settled_s, 600.0)
        assert result.verdicts.c3 is c3
        assert ("C3" in result.not_judged) is (c3 is None)


def test_a_ring_that_was_off_for_long_fails_though_it_was_disbanded_early_in_its_window() -> None:
    wide = ring_of_three(radius_m=12.0)
    result = judged(*(replace(each, tactic=np.where(TIME_S > 455.0, "hold", each.tactic)) for each in wide))
    assert (result.ring.judged_from_s, result.verdicts.c1) == (450.0, False)


LATE_S, CHANGE_S = 570.0, 25.0
LATE = DesiredRing(15.0, -0.05, earlier=(EarlierRing(LATE_S, 10.0, 0.05, CHANGE_S),))


def test_a_ring_commanded_too_late_to_be_reached_is_not_judged_and_what_was_flown_before_is() -> None:
    """All fly the first ring to the end: the second needs 25 s, and 10 s to settle, of which 30 s are left."""
    result = judged(*ring_of_three(), ring=LATE)
    assert result.window_s == (0.0, 569.9)
    assert (result.verdicts.c1, result.verdicts.c2, result.verdicts.c3, result.passes) == (True, True, True, True)
    for vehicle in result.vehicles:
        assert vehicle.radius_error_rms_m == pytest.approx(0.0, abs=1e-9)
        assert vehicle.angular_rate_mean_rad_s == pytest.approx(0.05)
    assert result.ring.judged_share == pytest.approx(569.9 / 600.0)
    until = "95% of its time, until 569.9 s, as what began then had no time to settle: from settling to the end"
    assert window_line(result) == f"ring judged over 569.9 s from 0.0 s on, {until}"
    assert [each.begins_at_s for each in result.transitions] == [0.0, LATE_S]
    assert not judged(*ring_of_three(radius_m=10.5), ring=LATE).verdicts.c1
    assert not judged(*ring_of_three(rate_rad_s=0.06), ring=LATE).verdicts.c2


def test_a_ring_commanded_soon_enough_is_judged_to_the_end() -> None:
    earlier = EarlierRing(565.0, 10.0, 0.05, CHANGE_S)
    result = judged(*ring_of_three(), ring=replace(LATE, earlier=(earlier,)))
    assert result.window_s == (450.0, 600.0)
    assert (result.verdicts.c1, result.verdicts.c2) == (False, False)


def test_rings_commanded_one_after_the_other_at_the_end_are_all_left_out() -> None:
    first = EarlierRing(560.0, 10.0, 0.05, CHANGE_S)
    ring = replace(LATE, earlier=(first, EarlierRing(590.0, 12.0, 0.08, CHANGE_S)))
    result = judged(*ring_of_three(), ring=ring)
    assert (result.window_s, result.passes) == ((0.0, 559.9), True)


def test_a_ring_commanded_shortly_before_all_leave_it_is_not_judged() -> None:
    """It ends at 500 s by a hold; the ring of 490 s was not flown for long enough, though the flight goes on."""
    earlier = EarlierRing(490.0, 10.0, 0.05, CHANGE_S)
    tracks = [replace(each, tactic=np.where(TIME_S > 500.0, "hold", each.tactic)) for each in ring_of_three()]
    result = judged(*tracks, ring=replace(LATE, earlier=(earlier,)))
    assert (result.window_s, result.verdicts.c1, result.verdicts.c2) == ((0.0, 489.9), True, True)


def test_a_ring_commanded_while_all_hold_begins_no_transition_unless_one_encircles_again() -> None:
    """All hold from 500 s on, and again encircle from 540 s on in the second flight; the ring is of 520 s."""
    ring = DesiredRing(15.0, 0.05, earlier=(EarlierRing(520.0, 10.0, 0.05, 12.0),))
    for back_s, begins_s in ((np.inf, [0.0]), (540.0, [0.0, 520.0])):
        held = (TIME_S > 500.0) & (back_s > TIME_S)
        radius_m = np.where(TIME_S < 520.0, 10.0, 15.0)
        tracks = ring_of_three()
        if back_s < np.inf:
            tracks = [orbit(index + 1, index * tau / 3, radius_m) for index in range(3)]
        result = judged(*(replace(each, tactic=np.where(held, "hold", each.tactic)) for each in tracks), ring=ring)
        assert [each.begins_at_s for each in result.transitions] == begins_s
        assert all(each.members == 3 for each in result.transitions)
        assert (result.verdicts.c1, result.verdicts.c2, result.verdicts.c3) == (True, True, True)


def test_a_vehicle_that_engages_just_before_the_end_leaves_the_ring_before_it_judged() -> None:
    """The third engages far off its radius, 1.3 s before the end; with 10 s left it counts."""
    for engaged_s, c1 in ((598.7, True), (590.0, False)):
        result = judged(*(orbit(i, i * pi) for i in (1, 2)), orbit(3, 1.0, radius_m=20.0, engaged_s=engaged_s))
        assert result.verdicts.c1 is c1
    assert judged(orbit(1, 0.0), orbit(2, pi), orbit(3, 1.0, 20.0, engaged_s=598.7)).window_s == (0.0, 598.6)


def test_a_gap_in_the_data_settles_nothing() -> None:
    tracks = off_between((0.0, 20.0), (40.0, 60.0))
    assert judged(*tracks).ring.unsettled_at_s == 40.0
    assert judged(tracks[0], silenced(tracks[1], 15.0, 40.0), tracks[2]).ring.unsettled_at_s is None
