"""The stub autopilot: its motion against independent closed forms, and PX4's measured manners."""

from collections import Counter
from collections.abc import Callable
from math import hypot, inf, nan, pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from estimation.plant.model import Plant, PlantAxis
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.autopilot import Battery, LandedState, MavResult, Positioning, StubAutopilot
from sitl.autopilot.fence import Zone
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.modes import NavMode
from sitl.autopilot.parameters import Parameters
from sitl.autopilot.px4 import DEFAULTS, Px4
from sitl.mavlink.commands import Schedule

PLANT = Plant(PlantAxis(1.51, 1.90), PlantAxis(1.87, 2.40), delay_s=0.2)


def mode_of(autopilot: StubAutopilot) -> NavMode:
    """Return the mode now; as a function, so that the type checker forgets what it knew before."""
    return autopilot.mode


def ready(**parameters: float) -> StubAutopilot:
    autopilot = Px4(PLANT, parameters=Parameters(Px4.TABLE, **parameters))
    autopilot.step(3.0)
    return autopilot


def until(autopilot: StubAutopilot, condition: Callable[[], bool], limit_s: float = 60.0) -> float:
    """Let time pass until the condition holds; return how long that took."""
    start_s = autopilot.time_s
    while not condition():
        assert autopilot.time_s - start_s < limit_s, "it never happens"
        autopilot.step(autopilot.time_s + STEP_S)
    return autopilot.time_s - start_s


def wait(autopilot: StubAutopilot, seconds: float) -> None:
    autopilot.step(autopilot.time_s + seconds)


def hovering(height_m: float = 5.0, **parameters: float) -> StubAutopilot:
    autopilot = ready(MIS_TAKEOFF_ALT=height_m, **parameters)
    assert autopilot.arm() is MavResult.ACCEPTED
    assert autopilot.take_off() is MavResult.ACCEPTED
    wait(autopilot, 25.0)
    assert mode_of(autopilot) is NavMode.HOLD
    assert autopilot.airframe.position_m[2] == pytest.approx(height_m, abs=0.01)
    return autopilot


def stream(autopilot: StubAutopilot, target: PositionTarget, seconds: float) -> None:
    """Send a setpoint twenty-five times a second."""
    for _ in range(round(seconds * 25)):
        autopilot.receive_setpoint(autopilot.time_s, target)
        wait(autopilot, 0.04)


def offboard(height_m: float = 5.0, **parameters: float) -> StubAutopilot:
    autopilot = hovering(height_m, **parameters)
    autopilot.receive_setpoint(autopilot.time_s, PositionTarget((0.0, 0.0, height_m)))
    assert autopilot.select(NavMode.OFFBOARD) is MavResult.ACCEPTED
    stream(autopilot, PositionTarget((0.0, 0.0, height_m)), 2.0)
    return autopilot


# Motion


def exact(axis: PlantAxis, setpoint: float, wind: float, time_s: float) -> float:
    """Return the position after `time_s` from rest at 0, from a matrix exponential that shares no code."""
    matrix = np.array(
        [[0.0, 1.0, 0.0], [-axis.a0_per_s2, -axis.a1_per_s, axis.a0_per_s2 * setpoint + wind], [0.0, 0.0, 0.0]]
    )
    return float((expm(matrix * time_s) @ np.array([0.0, 0.0, 1.0]))[0])


def test_a_setpoint_step_is_answered_exactly_as_the_plant_does_after_its_delay() -> None:
    autopilot = offboard()
    start_s = autopilot.time_s
    target = PositionTarget((3.0, -2.0, 5.0))
    for tick in range(1, 60):
        autopilot.receive_setpoint(autopilot.time_s, target)
        autopilot.step(start_s + tick * 0.1)
        x, y, _ = autopilot.airframe.position_m
        acted_s = max(0.0, tick * 0.1 - PLANT.delay_s)
        assert x == pytest.approx(exact(PLANT.x, 3.0, 0.0, acted_s), abs=1e-9)
        assert y == pytest.approx(exact(PLANT.y, -2.0, 0.0, acted_s), abs=1e-9)


def test_wind_pushes_as_a_disturbance_acceleration() -> None:
    autopilot = hovering()
    autopilot.step(autopilot.time_s + 1.5, (0.3, -0.2))
    x, y, _ = autopilot.airframe.position_m
    assert (x, y) == pytest.approx((exact(PLANT.x, 0.0, 0.3, 1.5), exact(PLANT.y, 0.0, -0.2, 1.5)), abs=1e-9)


def test_a_setpoint_between_two_steps_acts_from_the_nearest_step() -> None:
    for offset_s in (0.004, 0.019):
        autopilot = offboard()
        start_s = autopilot.time_s
        autopilot.receive_setpoint(start_s + offset_s, PositionTarget((1.0, 0.0, 5.0)))
        autopilot.step(start_s + 0.8)
        acted_s = 0.8 - PLANT.delay_s - round(offset_s / STEP_S) * STEP_S
        assert autopilot.airframe.position_m[0] == pytest.approx(exact(PLANT.x, 1.0, 0.0, acted_s), abs=1e-9)


def test_climbs_and_descents_keep_to_their_speed_limits() -> None:
    autopilot = offboard()
    rates = []
    for height in (60.0, 5.0):
        for _ in range(500):
            stream(autopilot, PositionTarget((0.0, 0.0, height)), 0.04)
            rates.append(autopilot.airframe.velocity_m_s[2])
    assert max(rates) == pytest.approx(3.0, abs=1e-3)
    assert min(rates) == pytest.approx(-1.5, abs=1e-3)


def test_heading_turns_the_short_way_at_a_bounded_rate() -> None:
    autopilot = offboard()
    stream(autopilot, PositionTarget((0.0, 0.0, 5.0), heading_rad=-0.75 * pi), 1.2)
    # 1.0 s of effect at 45 degrees a second
    assert autopilot.airframe.heading_rad == pytest.approx(-pi / 4, abs=0.05)
    stream(autopilot, PositionTarget((0.0, 0.0, 5.0), heading_rad=-0.75 * pi), 4.0)
    assert autopilot.airframe.heading_rad == pytest.approx(-0.75 * pi)
    stream(autopilot, PositionTarget((0.0, 0.0, 5.0)), 2.0)
    assert autopilot.airframe.heading_rad == pytest.approx(-0.75 * pi)


# Arming, take-off, landing


def test_arming_waits_for_the_estimator() -> None:
    autopilot = Px4(PLANT)
    autopilot.step(1.9)
    assert autopilot.arm() is MavResult.REJECTED
    assert not autopilot.armed
    autopilot.step(2.1)
    assert autopilot.arm() is MavResult.ACCEPTED


def test_return_rises_flies_home_and_lands() -> None:
    autopilot = offboard(5.0)
    stream(autopilot, PositionTarget((12.0, -9.0, 5.0)), 15.0)
    autopilot.select(NavMode.RETURN)
    heights = []

    def home() -> bool:
        heights.append(autopilot.airframe.height_m)
        return not autopilot.armed

    until(autopilot, home, 120.0)
    x, y, _ = autopilot.airframe.position_m
    assert max(heights) == pytest.approx(15.0, abs=1.0)  # a cone of 45 degrees over 15 m
    assert hypot(x, y) < 0.01


# Offboard


@pytest.mark.parametrize(
    ("action", "sticks_action", "mode"),
    [
        (3, 3, NavMode.RETURN),
        (5, 2, NavMode.HOLD),
        # What would need sticks, and has none, does what is to be done about lost sticks.
        (1, 3, NavMode.LAND),
        (99, 2, NavMode.RETURN),
        (2, 5, NavMode.STABILIZED),
    ],
)
def test_a_stream_that_stops_ends_in_the_chosen_failsafe_after_1_1_s(
    action: int, sticks_action: int, mode: NavMode
) -> None:
    autopilot = offboard(COM_OBL_RC_ACT=action, NAV_RCL_ACT=sticks_action)
    autopilot.receive_setpoint(autopilot.time_s, PositionTarget((0.0, 0.0, 5.0)))
    assert until(autopilot, lambda: autopilot.mode is not NavMode.OFFBOARD) == pytest.approx(1.1, abs=0.05)
    assert autopilot.mode is mode
    assert autopilot.failsafe
    assert "Failsafe activated" in [text for _, text in autopilot.take_texts()]


def test_without_anybody_at_the_sticks_it_sinks_from_five_metres_in_eight_seconds_and_rests_in_offboard() -> None:
    autopilot = offboard(5.0, NAV_RCL_ACT=5)
    until(autopilot, lambda: autopilot.mode is NavMode.POSITION)
    assert until(autopilot, lambda: autopilot.landed) == pytest.approx(8.0, abs=1.0)
    assert until(autopilot, lambda: not autopilot.armed) == pytest.approx(2.0, abs=0.1)
    wait(autopilot, STEP_S)
    assert mode_of(autopilot) is NavMode.OFFBOARD
    assert autopilot.arm() is MavResult.REJECTED


def test_a_returning_stream_takes_a_landed_vehicle_off_again() -> None:
    autopilot = offboard(5.0)
    until(autopilot, lambda: autopilot.landed)
    stream(autopilot, PositionTarget((0.0, 0.0, 5.0)), 20.0)
    assert autopilot.armed
    assert autopilot.airframe.position_m[2] == pytest.approx(5.0, abs=0.05)


def test_an_old_setpoint_is_not_flown_when_offboard_resumes() -> None:
    autopilot = offboard(5.0, COM_OBL_RC_ACT=5)
    stream(autopilot, PositionTarget((8.0, 0.0, 5.0)), 1.0)
    wait(autopilot, 12.0)
    autopilot.receive_setpoint(autopilot.time_s, PositionTarget((9.0, 0.0, 5.0)))
    held_m = autopilot.airframe.position_m[0]
    wait(autopilot, 0.16)  # the new one has not come through yet
    assert mode_of(autopilot) is NavMode.OFFBOARD
    assert autopilot.airframe.position_m[0] == pytest.approx(held_m, abs=1e-3)


def test_a_setpoint_below_the_ground_lands_and_disarms() -> None:
    autopilot = offboard(3.0)
    stream(autopilot, PositionTarget((0.0, 0.0, -1.0)), 20.0)
    assert not autopilot.armed
    assert autopilot.airframe.position_m[2] == 0.0


# The fence

SQUARE = Zone(True, ((5.0, 5.0), (5.0, -5.0), (-5.0, -5.0), (-5.0, 5.0)))
KEPT_OUT = Zone(False, ((20.0, 0.0),), radius_m=4.0)
TRIANGLE = Zone(True, ((0.0, 0.0), (10.0, 0.0), (0.0, 10.0)))


def test_what_a_zone_allows() -> None:
    for zone, place_m, allowed in (
        (SQUARE, (4.9, -4.9), True),
        (SQUARE, (5.1, 0.0), False),
        (SQUARE, (0.0, -5.1), False),
        (KEPT_OUT, (20.0, 3.9), False),
        (KEPT_OUT, (20.0, 4.1), True),
        (TRIANGLE, (4.9, 4.9), True),
        (TRIANGLE, (5.1, 5.1), False),
    ):
        assert zone.allows(place_m) is allowed, (zone, place_m)


def test_gf_action_selects_the_mode_after_a_breach(subtests: pytest.Subtests) -> None:
    around = "Geofence: approaching or outside geofence"
    breaches: tuple[tuple[int, NavMode, dict[str, float], tuple[Zone, ...], tuple[float, float, float], str], ...] = (
        (2, NavMode.HOLD, {}, (SQUARE,), (9.0, 0.0, 5.0), around),
        (3, NavMode.RETURN, {}, (KEPT_OUT,), (20.0, 0.0, 5.0), around),
        (
            5,
            NavMode.LAND,
            {"GF_MAX_HOR_DIST": 6.0},
            (),
            (6.0, 6.0, 5.0),
            "Geofence: exceeding maximum distance to Home",
        ),
        (
            2,
            NavMode.HOLD,
            {"GF_MAX_VER_DIST": 8.0},
            (),
            (0.0, 0.0, 12.0),
            "Geofence: exceeding maximum altitude above Home",
        ),
    )
    for action, mode, parameters, zones, place_m, says in breaches:
        with subtests.test(action=action, parameters=parameters, zones=zones):
            autopilot = offboard(GF_ACTION=action, **parameters)
            autopilot.zones = zones
            stream(autopilot, PositionTarget((0.0, 0.0, 5.0)), 1.0)
            assert mode_of(autopilot) is NavMode.OFFBOARD
            stream(autopilot, PositionTarget(place_m), 6.0)
            assert mode_of(autopilot) is mode
            assert autopilot.failsafe
            texts = [text for _, text in autopilot.take_texts()]
            assert texts[-2:] == [says, "Failsafe activated"]
            assert texts.count(says) == 1


def test_a_fence_without_action_has_no_effect() -> None:
    for action in (0, 1):
        autopilot = offboard(GF_ACTION=action)
        autopilot.zones = (SQUARE,)
        stream(autopilot, PositionTarget((9.0, 0.0, 5.0)), 6.0)
        assert mode_of(autopilot) is NavMode.OFFBOARD
        assert (action == 1) is ("Geofence: approaching or outside geofence" in [t for _, t in autopilot.take_texts()])


def test_one_of_several_inclusions_is_enough_and_whoever_chooses_a_mode_flies_on_outside() -> None:
    autopilot = offboard()
    autopilot.zones = (Zone(True, ((10.0, 0.0),), radius_m=3.0), SQUARE)
    stream(autopilot, PositionTarget((0.0, 0.0, 5.0)), 1.0)
    assert [autopilot.mode] == [NavMode.OFFBOARD]
    stream(autopilot, PositionTarget((10.0, 0.0, 5.0)), 8.0)
    assert mode_of(autopilot) is NavMode.HOLD  # between the two
    stream(autopilot, PositionTarget((10.0, 0.0, 5.0)), 3.0)
    assert mode_of(autopilot) is NavMode.HOLD
    assert autopilot.select(NavMode.OFFBOARD) is MavResult.ACCEPTED
    stream(autopilot, PositionTarget((10.0, 0.0, 5.0)), 8.0)
    assert mode_of(autopilot) is NavMode.OFFBOARD
    assert autopilot.airframe.position_m[0] == pytest.approx(10.0, abs=0.1)


def test_of_a_breach_and_a_lost_stream_the_graver_rules_and_landing_is_not_held_back() -> None:
    autopilot = offboard(COM_OBL_RC_ACT=4)
    autopilot.zones = (SQUARE,)
    stream(autopilot, PositionTarget((9.0, 0.0, 5.0)), 6.0)
    assert mode_of(autopilot) is NavMode.HOLD
    wait(autopilot, 1.5)
    assert mode_of(autopilot) is NavMode.LAND
    until(autopilot, lambda: not autopilot.armed)


# Without GPS


def indoors(**parameters: float) -> StubAutopilot:
    autopilot = Px4(PLANT, parameters=Parameters(Px4.TABLE, **parameters), positioning=Positioning(gps=False))
    autopilot.step(3.0)
    return autopilot


def test_without_gps_it_arms_for_take_off_and_offboard_but_not_in_hold() -> None:
    autopilot = indoors()
    assert autopilot.arm() is MavResult.REJECTED
    assert [text for _, text in autopilot.take_texts()] == ["Arming denied: Resolve system health failures first"]
    autopilot.receive_setpoint(autopilot.time_s, PositionTarget((0.0, 0.0, 2.0)))
    for mode, verdict in (
        (NavMode.RETURN, MavResult.REJECTED),
        (NavMode.OFFBOARD, MavResult.ACCEPTED),
        (NavMode.TAKE_OFF, MavResult.ACCEPTED),
    ):
        autopilot.select(mode)
        assert autopilot.arm() is verdict
        autopilot.disarm()


def test_without_gps_it_hovers_on_in_take_off_refuses_hold_and_lands() -> None:
    autopilot = indoors()
    autopilot.take_off()
    autopilot.arm()
    wait(autopilot, 20.0)
    assert mode_of(autopilot) is NavMode.TAKE_OFF
    assert autopilot.airframe.position_m[2] == pytest.approx(2.5, abs=0.01)
    assert autopilot.select(NavMode.HOLD) is MavResult.REJECTED
    assert autopilot.take_texts()[-1][1] == "Switching to Hold is currently not available"
    assert autopilot.land() is MavResult.ACCEPTED
    until(autopilot, lambda: not autopilot.armed)


def test_a_failsafe_that_needs_a_place_on_the_globe_lands_without_one() -> None:
    autopilot = indoors(COM_OBL_RC_ACT=3)
    stream(autopilot, PositionTarget((0.0, 0.0, 2.0)), 0.2)
    autopilot.select(NavMode.OFFBOARD)
    autopilot.arm()
    stream(autopilot, PositionTarget((0.0, 0.0, 2.0)), 8.0)
    until(autopilot, lambda: autopilot.mode is not NavMode.OFFBOARD)
    assert mode_of(autopilot) is NavMode.LAND


# Values


def test_parameters_keep_their_types_and_refuse_nan() -> None:
    parameters = Parameters(Px4.TABLE)
    assert not parameters.set("COM_OBL_RC_ACT", 4.0)
    assert not parameters.set("COM_OF_LOSS_T", 2)
    for bad in (nan, inf, -1.0, 1e30):
        assert not parameters.set("COM_OF_LOSS_T", bad)
    assert parameters.set("COM_OBL_RC_ACT", 4)
    assert parameters["COM_OBL_RC_ACT"] == 4
    assert DEFAULTS["COM_OBL_RC_ACT"] == 0
    with pytest.raises(KeyError):
        Parameters(Px4.TABLE, NO_SUCH=1)
    with pytest.raises(TypeError):
        Parameters(Px4.TABLE, COM_OF_LOSS_T=1)


def test_no_parameter_breaks_a_flight(subtests: pytest.Subtests) -> None:
    for extreme in [0.0, 1e4]:
        for name in [name for name, value in DEFAULTS.items() if isinstance(value, float)]:
            with subtests.test(extreme=extreme, name=name):
                autopilot = ready(**{name: extreme})
                autopilot.arm()
                autopilot.take_off()
                wait(autopilot, 4.0)
                stream(autopilot, PositionTarget((5.0, 5.0, 5.0)), 0.2)
                autopilot.select(NavMode.OFFBOARD)
                stream(autopilot, PositionTarget((5.0, 5.0, 5.0)), 2.0)
                autopilot.select(NavMode.RETURN)
                wait(autopilot, 3.0)
                assert np.isfinite(autopilot.airframe.position_m).all()
                assert max(map(abs, autopilot.airframe.position_m)) < 1e3


def test_the_battery_drains_while_armed() -> None:
    autopilot = Px4(PLANT, battery=Battery(0.5, endurance_s=100.0))
    autopilot.step(3.0)
    autopilot.arm()
    autopilot.take_off()
    wait(autopilot, 20.0)
    assert autopilot.battery_fraction == pytest.approx(0.3)


def test_slow_messages_of_several_vehicles_come_at_different_times_and_fast_ones_together() -> None:
    times = {message: Counter[int]() for message in (1, 2, 3)}
    for vehicle in range(1, 33):
        schedule = Schedule({1: 1.0, 2: 20.0}, known=(1, 2, 3), phase_s=STEP_S * vehicle)
        assert schedule.set_interval(3, 0.5, now_s=0.0)
        due: dict[int, list[float]] = {message: [] for message in times}
        for step in range(round(4.0 / STEP_S)):
            for message in schedule.due(step * STEP_S):
                times[message][step] += 1
                due[message].append(step * STEP_S)
        assert np.diff(due[1]) == pytest.approx(1.0)
        assert np.diff(due[3]) == pytest.approx(0.5)
    assert max(times[2].values()) == 32
    assert max(times[1].values()) == 1
    assert max(times[3].values()) == 2


def test_rates_are_kept_on_average_and_missed_messages_not_made_up() -> None:
    schedule = Schedule({1: 30.0, 2: 50.0, 3: 1.0}, known=(1, 2, 3, 4))
    sent = [message for step in range(1, 501) for message in schedule.due(step * STEP_S)]
    assert sent.count(1) == pytest.approx(300, abs=1)
    assert sent.count(2) == 500
    assert sent.count(3) == pytest.approx(10, abs=1)
    assert sorted(schedule.due(100.0)) == [1, 2, 3]
    assert schedule.due(100.0) == []
    assert schedule.set_interval(4, 0.1, now_s=100.0)
    assert schedule.set_interval(2, None, now_s=100.0)
    sent = [message for step in range(1, 501) for message in schedule.due(100.0 + step * STEP_S)]
    assert sent.count(4) == pytest.approx(100, abs=1)
    assert sent.count(2) == 0
    assert schedule.set_interval(2, 0.0, now_s=110.0)
    assert schedule.interval_s(2) == pytest.approx(0.02)
    assert not schedule.set_interval(99, 0.1, now_s=110.0)


COMMANDS = st.one_of(
    st.sampled_from(NavMode).map(lambda mode: lambda vehicle: vehicle.select(mode)),
    st.just(lambda vehicle: vehicle.arm()),
    st.booleans().map(lambda force: lambda vehicle: vehicle.disarm(force=force)),
    st.just(lambda vehicle: vehicle.take_off()),
    st.tuples(*[st.floats(-1e4, 1e4)] * 3).map(
        lambda place: lambda vehicle: vehicle.receive_setpoint(vehicle.time_s, PositionTarget(place))
    ),
)


@settings(max_examples=30)
@given(st.lists(st.tuples(COMMANDS, st.floats(0.02, 4.0)), max_size=25))
def test_no_sequence_of_commands_breaks_the_vehicle(
    script: list[tuple[Callable[[StubAutopilot], object], float]],
) -> None:
    autopilot = ready()
    for command, pause_s in script:
        command(autopilot)
        wait(autopilot, pause_s)
        numbers = (*autopilot.airframe.position_m, *autopilot.airframe.velocity_m_s)
        assert np.isfinite(numbers).all()
        assert autopilot.airframe.height_m >= 0.0
        assert autopilot.landed or autopilot.landed_state is not LandedState.ON_GROUND
        if autopilot.landed:
            assert autopilot.airframe.velocity_m_s[:2] == (0.0, 0.0)
        if autopilot.armed:
            assert autopilot.mode is not NavMode.OFFBOARD or autopilot.conditions.setpoints_flow
