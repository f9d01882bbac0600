"""Bodies made of messages: where they are, how far to keep away, who counts, and for how long."""

from collections.abc import Callable
from dataclasses import replace
from math import hypot, inf

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec import structs

from agents.core import VehicleCore
from agents.inputs import Message, Presence, TacticEvent
from agents.safety.barriers import Body, Cause, apart
from agents.safety.guard import Guard
from agents.safety.neighbours import A_FEW, GOING_ON_S, UNMODELLED_M_S2, UNPUBLISHED_ACCELERATION_M_S2, Neighbours
from agents.settings.config import AgentConfig, RingConfig
from agents.situation.situation import Situation
from agents.tactics import Event
from agents.team.messages import MemberState, RingChoice
from estimation.plant.model import exact_step
from estimation.state import OwnEstimate, Telemetry
from tests.conftest import CONFIG, STUB
from tests.support.estimates import own_spread
from tests.support.team import a_team

Maker = Callable[..., AgentConfig]
HEIGHT_M = 8.0
STILL = (0.0, 0.0)


def situation(
    now_s: float, acts_after_s: float = 0.05, sigma_m: float = 0.0, moving_m_s: tuple[float, float] = STILL
) -> Situation:
    mean = np.array((0.0, 0.0, *moving_m_s, 0.0, 0.0))
    own = OwnEstimate(now_s, mean, own_spread(sigma_m, sigma_m / 2.0))
    return Situation(now_s, now_s + acts_after_s, own, mean[:4], mean[4:], None, None, None, height_m=HEIGHT_M)


def member(
    time_s: float = 10.0,
    tactic: str = "formation",
    position: tuple[float, float] = (3.0, -4.0),
    velocity: tuple[float, float] = STILL,
    setpoint: tuple[float, float] | None = None,
    altitude_m: float = HEIGHT_M,
    sigma_m: float = 0.0,
) -> MemberState:
    return MemberState(
        1, time_s, tactic, position, velocity, setpoint or position, STILL, altitude_m, position_sigma_m=sigma_m
    )


# Not so fast that the acceleration meets its limit.
speeds = st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))


@given(velocity=speeds, lead=speeds, ahead_s=st.floats(0.01, 0.3))
def test_a_neighbour_is_predicted_by_the_plant_under_its_published_setpoint(
    velocity: tuple[float, float], lead: tuple[float, float], ahead_s: float
) -> None:
    position = 3.0, -4.0
    setpoint = position[0] + lead[0], position[1] + lead[1]
    spoken = member(position=position, velocity=velocity, setpoint=setpoint)
    (body,) = Neighbours(CONFIG).bodies(situation(10.0, ahead_s), [spoken], [])
    start = np.array([*position, *velocity])
    later = exact_step(STUB, ahead_s).advance(start, np.array(setpoint), np.zeros(2))
    # The acceleration is taken for constant: what it changes by is of third order in the position.
    assert hypot(*(later[:2] - body.position_m)) <= 4.0 * ahead_s**3
    assert hypot(*(later[2:] - body.velocity_m_s)) <= 6.0 * ahead_s**2
    soon = exact_step(STUB, 1e-5).advance(start, np.array(setpoint), np.zeros(2))
    assert (soon[2:] - start[2:]) / 1e-5 == pytest.approx(body.acceleration_m_s2, abs=1e-3)


def test_a_neighbours_predicted_acceleration_is_limited() -> None:
    (body,) = Neighbours(CONFIG).bodies(situation(10.0, 0.1), [member(setpoint=(1003.0, -996.0))], [])
    limit = CONFIG.safety.acceleration_max_m_s2
    assert body.acceleration_m_s2 == (limit, -limit)
    assert body.velocity_m_s == pytest.approx((limit * 0.1, -limit * 0.1))


def test_the_distance_grows_with_both_uncertainties_and_with_the_age_of_the_message(make_config: Maker) -> None:
    neighbours = Neighbours(make_config(safety={"separation_m": 3.0, "uncertainty_sigmas": 2.0}))

    def distance_m(age_s: float, own_sigma_m: float = 0.0, its_sigma_m: float = 0.0, speed_m_s: float = 0.0) -> float:
        # Steady flight: the setpoint is ahead by what drag takes.
        setpoint = 3.0 + speed_m_s * STUB.x.a1_per_s / STUB.x.a0_per_s2, -4.0
        heard = [member(10.0, velocity=(speed_m_s, 0.0), setpoint=setpoint, sigma_m=its_sigma_m)]
        (body,) = neighbours.bodies(situation(10.0 + age_s, sigma_m=own_sigma_m), heard, [])
        return body.distance_m

    assert distance_m(0.0) == 3.0
    assert distance_m(0.0, own_sigma_m=0.3, its_sigma_m=0.4) == pytest.approx(3.0 + 2.0 * 0.5)
    assert distance_m(0.4) == pytest.approx(3.0 + UNPUBLISHED_ACCELERATION_M_S2 / 2.0 * 0.4**2)
    assert distance_m(0.4, 0.3, 0.4) == pytest.approx(4.0 + UNPUBLISHED_ACCELERATION_M_S2 / 2.0 * 0.4**2)
    # Neither makes more of it than one separation: who is lost for a minute does not close the sky.
    assert distance_m(30.0, 50.0, 50.0, speed_m_s=2.0) == pytest.approx(9.0)
    # One that is lost may have changed its mind, and may have flown on until it missed the others, which takes 3 s. It
    # is believed to have gone on for the first of these; the slower it was, the less that is.
    assert distance_m(30.0) == pytest.approx(3.0 + 1.0)
    assert distance_m(2.0, speed_m_s=0.4) == pytest.approx(3.0 + 1.0 + 0.4)
    assert distance_m(30.0, speed_m_s=0.4) == pytest.approx(3.0 + 1.0 + 0.8)


def test_who_is_silent_goes_on_for_a_while_only() -> None:
    spoken = member(velocity=(1.0, 0.0), setpoint=(3.0 + 0.87 / 0.8, -4.0))
    for now_s in (10.0 + GOING_ON_S, 40.0):
        (body,) = Neighbours(CONFIG).bodies(situation(now_s), [], [spoken])
        assert body.position_m == pytest.approx((3.0 + GOING_ON_S, -4.0))
        # There it stands: as one that still moved away it would be come too near to.
        assert (body.velocity_m_s, body.acceleration_m_s2) == (STILL, STILL)


@pytest.mark.parametrize(
    ("tactic", "shares"), [("formation", True), ("standby", False), ("land", False), ("pilot override", False)]
)
def test_who_lands_or_is_flown_by_somebody_else_bears_no_half(tactic: str, shares: bool) -> None:
    (heard,) = Neighbours(CONFIG).bodies(situation(10.0), [member(tactic=tactic)], [])
    (lost,) = Neighbours(CONFIG).bodies(situation(10.0), [], [member(tactic=tactic)])
    assert (heard.shares, lost.shares) == (shares, False)


@pytest.mark.parametrize(
    ("tactic", "more_m"), [("hold", 0.0), ("standby", 1.0), ("land", 1.0), ("pilot override", 1.0)]
)
def test_from_one_that_does_not_evade_the_guard_keeps_what_a_plant_that_is_off_takes(
    tactic: str, more_m: float, make_config: Maker
) -> None:
    """The distance falls short by the unmodelled acceleration over the square of the barrier's rate."""
    config = make_config(safety={"barrier_rate_per_s": 0.6})
    (body,) = Neighbours(config).bodies(situation(10.0, 0.0), [member(tactic=tactic)], [])
    assert body.distance_m - config.safety.separation_m == pytest.approx(more_m * UNMODELLED_M_S2 / 0.36)


@settings(max_examples=25, deadline=None)
@given(
    aside_m=st.floats(-3.0, 3.0),
    speed_m_s=st.floats(0.5, 2.0),
    off=st.tuples(st.floats(0.85, 1.15), st.floats(0.85, 1.15)),
    delay_s=st.sampled_from([0.0, 0.1, 0.2]),
)
def test_a_vehicle_passes_one_that_its_autopilot_holds_until_it_is_taken_with_the_separation(
    make_config: Maker, aside_m: float, speed_m_s: float, off: tuple[float, float], delay_s: float
) -> None:
    """The guard of the one that hovers moves its setpoint away, as it published it before, and it does not follow."""
    config = make_config(safety={"separation_m": 3.0})
    neighbours, guard = Neighbours(config), Guard(config)
    x, y = [
        replace(each, a0_per_s2=each.a0_per_s2 * off[0], a1_per_s=each.a1_per_s * off[1]) for each in (STUB.x, STUB.y)
    ]
    plant = exact_step(replace(STUB, x=x, y=y), 0.1)
    motion, nearest_m = np.array([-12.0, 0.0, 0.0, 0.0]), inf
    for tick in range(round(24.0 / speed_m_s / 0.1)):
        now_s, lead_m = 10.0 + 0.1 * tick, speed_m_s * STUB.x.a1_per_s / STUB.x.a0_per_s2
        hovers = member(now_s - delay_s, "standby", (0.0, aside_m), setpoint=(1.0, aside_m), altitude_m=HEIGHT_M)
        own = OwnEstimate(now_s, np.array((*motion, 0.0, 0.0)), own_spread(0.0, 0.0))
        here = Situation(now_s, now_s, own, motion, np.zeros(2), None, None, None, height_m=HEIGHT_M)
        wanted = np.array([-12.0 + speed_m_s * 0.1 * tick + lead_m, 0.0])
        aim_m = guard.check(here, wanted, neighbours.bodies(here, [hovers], [])).aim_m
        motion = plant.advance(motion, aim_m, np.zeros(2))
        nearest_m = min(nearest_m, hypot(motion[0], motion[1] - aside_m))
    assert nearest_m >= config.safety.separation_m


@pytest.mark.parametrize(("above_m", "counts"), [(1.9, 1), (-1.9, 1), (2.0, 0), (-2.5, 0)])
def test_who_flies_well_above_or_below_is_not_in_the_way(above_m: float, counts: int) -> None:
    bodies = Neighbours(CONFIG).bodies(situation(10.0), [member(altitude_m=HEIGHT_M + above_m)], [])
    assert len(bodies) == counts


# Who is lost


@pytest.mark.parametrize(
    ("own_encircles", "tactic", "counts"), [(True, "formation", 1), (False, "encircle", 1), (False, "formation", 0)]
)
def test_about_a_ring_with_heights_of_its_own_vehicles_keep_apart_at_any_height(
    own_encircles: bool, tactic: str, counts: int, make_config: Maker
) -> None:
    """One that is well below now may be at this height when the two meet."""
    level, inclined = make_config(), make_config(encirclement={"tilt_deg": 10.0})
    neighbours = Neighbours(level)
    below = member(tactic=tactic, altitude_m=HEIGHT_M - 5.0)
    assert not neighbours.bodies(situation(10.0), [below], (), encircles=own_encircles)
    neighbours.change(inclined)
    assert len(neighbours.bodies(situation(10.0), [below], (), encircles=own_encircles)) == counts


def test_who_falls_silent_in_the_air_is_lost_for_as_long_as_the_mission_says() -> None:
    team = a_team()
    team.receive(member(10.0))
    team.expire(11.0)
    assert team.lost(11.0, 60.0) == ()
    team.expire(11.1)
    assert (team.members(), team.near(), team.lost(11.1, 60.0)) == ((member(10.0),), (), (member(10.0),))
    team.expire(12.1)
    assert (team.members(), team.near(), team.lost(12.1, 60.0)) == ((), (), (member(10.0),))
    assert len(team.lost(69.9, 60.0)) == 1
    assert team.lost(70.0, 60.0) == ()


def test_who_fell_silent_while_it_landed_is_lost_until_time_is_up_whatever_is_told_of_it() -> None:
    team = a_team()
    team.receive(member(10.0, "land"))
    team.expire(11.5)
    team.forget(1)
    assert len(team.lost(11.5, 60.0)) == 1


@pytest.mark.parametrize(
    ("tactic", "height_m", "avoided"), [("formation", HEIGHT_M, True), ("land", HEIGHT_M, True), ("land", 0.2, False)]
)
def test_the_core_keeps_away_from_where_a_vehicle_was_lost(
    tactic: str, height_m: float, avoided: bool, make_config: Maker
) -> None:
    core, motion, away_m = VehicleCore(make_config(safety={"lost_avoided_s": 5.0})), np.zeros(4), []
    for tick in range(200):
        now_s = 10.0 + 0.1 * tick
        x, y, x_rate, y_rate = motion.tolist()
        core.take(Telemetry(now_s, (x, y, HEIGHT_M), (x_rate, y_rate, 0.0)))
        if tick == 0:
            core.take(Message(now_s, member(now_s, tactic, position=(0.5, 0.0), altitude_m=height_m)))
        if tick == 5:
            core.take(Presence(1, present=False))
        guarded = core.tick(now_s).status.guarded
        assert guarded is not None
        motion = exact_step(STUB, 0.1).advance(motion, guarded.aim_m, np.zeros(2))
        away_m.append(hypot(motion[0] - 0.5, motion[1]))
    assert (min(away_m[20:49]) > 1.0) is avoided
    assert away_m[-1] == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(("event", "guarded"), [(Event.HOLD, True), (Event.LAND, False), (Event.HANDED_OVER, False)])
def test_a_setpoint_without_effect_is_not_guarded(event: Event, guarded: bool, make_config: Maker) -> None:
    core = VehicleCore(make_config())
    core.take(TacticEvent(event))
    for tick in range(5):
        now_s = 10.0 + 0.1 * tick
        core.take(Telemetry(now_s, (0.0, 0.0, HEIGHT_M), (0.0, 0.0, 0.0)))
        core.take(Message(now_s, member(now_s, position=(0.5, 0.0))))
        status = core.tick(now_s).status
    assert status.guarded is not None
    assert bool(status.guarded.causes) is guarded


@settings(max_examples=150)
@given(
    away_m=st.floats(5.0, 40.0),
    closing=st.tuples(st.floats(2.0, 5.0), st.floats(2.0, 5.0)),
    ahead_m=st.floats(-8.0, 8.0),
    lead_m=st.floats(0.0, 8.0),
    age_s=st.floats(0.0, 1.0),
    tactic=st.sampled_from(["formation", "land"]),
)
def test_who_is_not_near_changes_no_setpoint(
    away_m: float, closing: tuple[float, float], ahead_m: float, lead_m: float, age_s: float, tactic: str
) -> None:
    here = situation(10.0 + age_s, moving_m_s=(closing[0], 0.0))
    spoken = member(10.0, tactic, (away_m, 0.0), (-closing[1], 0.0), (away_m + ahead_m, 0.0))
    neighbours, guard, plan = Neighbours(CONFIG), Guard(CONFIG), np.array([lead_m, 0.0])
    if not neighbours.near(here, [spoken] * (A_FEW + 1)):
        heeded = guard.check(here, plan, neighbours.bodies(here, [spoken], []))
        alone = guard.check(here, plan, [])
        assert heeded.aim_m == pytest.approx(alone.aim_m, abs=0.0)
        assert heeded.causes == alone.causes


def test_who_is_as_far_as_the_other_end_of_a_long_line_is_not_near() -> None:
    heard = [member(position=(0.0, 5.0 * place)) for place in range(1, 16)]
    near = Neighbours(CONFIG).near(situation(10.0), heard)
    assert near == heard[: len(near)]
    assert 1 <= len(near) <= 8


@settings(max_examples=250)
@given(
    away_m=st.floats(2.0, 15.0),
    own_m_s=st.floats(-1.0, 3.0),
    its_m_s=st.floats(-1.0, 3.0),
    its_lead_m=st.floats(-3.0, 3.0),
    lead_m=st.floats(-3.0, 5.0),
    sigma_m=st.floats(0.0, 1.0),
    age_s=st.floats(0.0, 1.2),
    tactic=st.sampled_from(["formation", "land"]),
)
@example(3.1, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, "land")
def test_an_aim_that_exposes_no_one_is_not_changed_for_anyone(
    away_m: float,
    own_m_s: float,
    its_m_s: float,
    its_lead_m: float,
    lead_m: float,
    sigma_m: float,
    age_s: float,
    tactic: str,
) -> None:
    """Two vehicles on one line, where they endanger each other most."""
    here = situation(10.0 + age_s, sigma_m=sigma_m, moving_m_s=(own_m_s, 0.0))
    spoken = member(10.0, tactic, (away_m, 0.0), (-its_m_s, 0.0), (away_m - its_lead_m, 0.0), sigma_m=sigma_m)
    neighbours, guard, aim = Neighbours(CONFIG), Guard(CONFIG), np.array([lead_m, 0.0])
    if not neighbours.exposed(here, [spoken], aim):
        assert guard.check(here, aim, neighbours.bodies(here, [spoken], [])).aim_m is aim


def test_neighbours_in_a_line_that_fly_on_are_not_exposed() -> None:
    cruising = 0.2, 0.0
    here = situation(10.0, moving_m_s=cruising)
    lead_m = cruising[0] * CONFIG.plant.x.a1_per_s / CONFIG.plant.x.a0_per_s2
    beside = [member(9.9, "formation", (0.0, y), cruising, (lead_m, y)) for y in (5.0, -5.0)]
    neighbours = Neighbours(CONFIG)
    assert neighbours.exposed(here, beside, np.array([lead_m, 0.0])) == []
    assert neighbours.exposed(here, beside, np.array([lead_m, 3.0])) != []


def test_a_silent_vehicle_that_flew_ahead_may_have_stopped(make_config: Maker) -> None:
    config = make_config(safety={"acceleration_max_m_s2": 0.1})
    here = situation(11.2, moving_m_s=(3.0, 0.0))
    ahead = member(10.0, position=(6.0, 0.0), velocity=(3.0, 0.0), setpoint=(9.0, 0.0))
    assert Neighbours(config).exposed(here, [ahead], np.array([3.0, 0.0])) == [ahead]


STACKED_M = {"low": 8.0, "middle": 11.0, "high": 14.0}


def stacked(config: AgentConfig, ring: int, spread_m: float = 0.0) -> AgentConfig:
    """Return a configuration on one of three rings at these altitudes, whose vehicles' heights differ by a spread."""
    rings = tuple(
        RingConfig(name, "", 2, config.encirclement.model_copy(update={"altitude_m": altitude_m}))
        for name, altitude_m in STACKED_M.items()
    )
    return replace(config, rings=rings, layers_from_m=config.altitude_m + spread_m).on_ring(ring)


def on_a_ring(ring: int | None, altitude_m: float, tactic: str = "encircle") -> MemberState:
    return structs.replace(member(10.0, tactic, altitude_m=altitude_m), choice=RingChoice(ring))


@pytest.mark.parametrize(
    ("own_ring", "its_ring", "its_altitude_m", "tactic", "encircles", "counts"),
    [
        (0, 0, 8.0, "encircle", True, True),  # on one ring
        (0, 1, 11.0, "encircle", True, False),  # on the ring above
        (0, 2, 9.0, "encircle", True, True),  # still below its ring, on its way up
        (0, 1, 12.0, "transit", True, False),
        (0, 0, 14.0, "transit", True, True),  # it comes down to this ring
        (2, 0, 8.0, "encircle", True, True),  # this vehicle, at 8 m, is still below its ring: it climbs through
        (2, 1, 11.0, "encircle", True, True),
        (2, 1, 11.0, "encircle", False, False),  # it does not climb: it holds at 8 m
        (0, 2, 14.0, "hold", True, False),
    ],
)
def test_vehicles_of_rings_above_each_other_keep_apart_only_where_their_heights_may_meet(
    make_config: Maker, own_ring: int, its_ring: int, its_altitude_m: float, tactic: str, encircles: bool, counts: bool
) -> None:
    """This vehicle is at 8 m; 2 m of vertical separation are enough."""
    neighbours = Neighbours(stacked(make_config(altitude_m=HEIGHT_M), own_ring))
    assert make_config().safety.vertical_separation_m == 2.0
    peer = on_a_ring(its_ring, its_altitude_m, tactic)
    assert bool(neighbours.bodies(situation(10.0), [peer], (), encircles=encircles)) == counts


def test_the_heights_of_a_ring_include_its_tilt_and_the_differences_of_the_vehicles_heights(make_config: Maker) -> None:
    flat = stacked(make_config(altitude_m=HEIGHT_M), 0)
    tilted = flat.with_flown(1, flat.rings[1].encirclement.model_copy(update={"tilt_deg": 10.0}))
    for config, counts in ((flat, False), (stacked(make_config(altitude_m=HEIGHT_M), 0, 1.5), True), (tilted, True)):
        assert bool(Neighbours(config).bodies(situation(10.0), [on_a_ring(1, 11.0)], ())) == counts


@pytest.mark.parametrize(
    ("own_ring", "its_ring", "tactic", "encircles", "passes"),
    [
        (0, 1, "encircle", True, True),  # on its way to another ring, or on it
        (0, 0, "encircle", True, False),  # on one ring, whose plans keep a headway
        (0, 0, "transit", True, True),
        (0, None, "formation", True, True),
        (0, 0, "encircle", False, True),  # seen from the line that it leaves
        (0, None, "formation", False, False),  # in one line
    ],
)
def test_vehicles_that_pass_keep_the_separation_though_their_accelerations_are_not_as_predicted(
    make_config: Maker, own_ring: int, its_ring: int | None, tactic: str, encircles: bool, passes: bool
) -> None:
    """This vehicle accelerates away from a peer at rest as `apart` demands it, less an error that lasts: the distance
    settles where h'' + 2 k h' + k^2 h = 0 with the error in h''.
    """
    config = stacked(make_config(altitude_m=HEIGHT_M), own_ring)
    peer = structs.replace(on_a_ring(its_ring, HEIGHT_M, tactic), position_m=(0.0, 0.0), aim_m=(0.0, 0.0))
    (body,) = Neighbours(config).bodies(situation(10.0, 0.0), [peer], (), encircles=encircles)
    away_m, opening_m_s, step_s = 4.0, 0.0, 0.01
    for _ in range(2000):
        alone = Body(body.position_m, STILL, STILL, body.distance_m, shares=False)
        demand = apart((away_m, 0.0), (opening_m_s, 0.0), alone, config.safety.barrier_rate_per_s, Cause.SEPARATION)
        opening_m_s += step_s * (demand.least_m_s2 - UNMODELLED_M_S2)
        away_m += step_s * opening_m_s
    left_m = away_m - config.safety.separation_m
    short_m = UNMODELLED_M_S2 / config.safety.barrier_rate_per_s**2
    assert left_m == pytest.approx(0.0 if passes else -short_m, abs=0.02)


def test_in_a_mission_of_one_ring_the_distance_is_the_separation(make_config: Maker) -> None:
    for tactic in ("formation", "encircle"):
        (body,) = Neighbours(make_config()).bodies(situation(10.0, 0.0), [member(10.0, tactic)], [])
        assert body.distance_m == make_config().safety.separation_m
