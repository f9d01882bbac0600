"""The guard's setpoints against a solver that knows nothing of it, its promises for whatever it is given, and two
vehicles in closed loop on plants that are not the model."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import hypot, pi

import numpy as np
import osqp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.safety.barriers import Body, Cause
from agents.safety.guard import Guard, Guarded, GuardStatus
from agents.settings.config import AgentConfig
from agents.settings.sections import NoFlySection
from agents.situation.situation import Situation
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import OwnEstimate, TargetEstimate, Vector
from tests.support.estimates import own_spread, target_spread
from tests.support.solver import UNSOLVED, slsqp

Maker = Callable[..., AgentConfig]
Pair = tuple[float, float]
STILL = (0.0, 0.0)
BOX = ((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0))


def situation(
    place: Pair = STILL,
    velocity: Pair = STILL,
    wind: Pair = STILL,
    target: Pair | None = None,
    target_velocity: Pair = STILL,
    sigma_m: float = 0.0,
    shift_m: float = 0.0,
) -> Situation:
    mean = np.array([*place, *velocity, *wind])
    own = OwnEstimate(10.0, mean, own_spread(sigma_m))
    seen = None if target is None else np.array([*target, *target_velocity])
    estimate = None if seen is None else TargetEstimate(10.0, seen, target_spread(), 10.0, 0.8, 0.2)
    shift_m2 = shift_m**2
    return Situation(10.0, 10.05, own, mean[:4], mean[4:], estimate, None, seen, shift_variance_m2=shift_m2)


def body(place: Pair, velocity: Pair = STILL, distance_m: float = 3.0, shares: bool = True) -> Body:
    return Body(place, velocity, STILL, distance_m, shares)


def checked(
    config: AgentConfig, seen: Situation, aim: Sequence[float], bodies: Sequence[Body] = ()
) -> tuple[Guarded, Vector]:
    guarded = Guard(config).check(seen, np.array(aim, dtype=np.float64), bodies)
    return guarded, guarded.aim_m


# The whole guard against a solver, from the accelerations that follow


ANISOTROPIC = Plant(PlantAxis(0.8, 0.87), PlantAxis(1.1, 0.7))


def demands(
    config: AgentConfig, seen: Situation, bodies: Sequence[Body], box_m: float | None
) -> list[tuple[Vector, float, bool]]:
    """Every `row . u >= least`, derived once more, and whether it is got around."""
    safety, k = config.safety, config.safety.barrier_rate_per_s
    here, velocity = seen.acting_motion[:2], seen.acting_motion[2:]
    gain, drift = config.plant.a0_per_s2, seen.disturbance - config.plant.a1_per_s * velocity
    rows: list[tuple[Vector, float, bool]] = []

    def demand(normal: Vector, least: float, evades: bool = False) -> None:
        rows.append((normal * gain, min(least, safety.acceleration_max_m_s2) - float(normal @ drift), evades))

    for each in bodies:
        apart, closing = here - each.position_m, velocity - each.velocity_m_s
        away = float(np.linalg.norm(apart))
        rest = closing @ closing + 2.0 * k * apart @ closing + k**2 / 2.0 * (away**2 - each.distance_m**2)
        demand(apart / away, -float(rest) / away * (0.5 if each.shares else 1.0), evades=True)
    speed = float(np.linalg.norm(velocity))
    if speed > safety.speed_max_m_s / 2.0:
        demand(-velocity / speed, -k * (safety.speed_max_m_s**2 - speed**2) / speed)
    if box_m is not None:
        for inward in np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]):
            distance = float(inward @ here) + box_m
            demand(inward, -(2.0 * k * float(inward @ velocity) + k**2 * distance))
            rows.append((inward, -distance, False))
    return rows


def expected_setpoint(rows: list[tuple[Vector, float, bool]], seen: Situation, aim: Vector, reach: float) -> Vector:
    here = seen.acting_motion[:2]
    lead = aim - here
    lead = lead * min(1.0, reach / float(np.linalg.norm(lead)))
    normals, least = np.array([row for row, _, _ in rows]), np.array([bound for _, bound, _ in rows])
    wanted = lead.copy()
    for normal, bound, evades in rows:
        missing = (bound - float(normal @ lead)) / float(np.linalg.norm(normal))
        if evades and missing > 0.0:
            forward = -normal / float(np.linalg.norm(normal))
            wanted += missing * np.array([forward[1], -forward[0]])  # a quarter turn to the right
    scale = np.linalg.norm(normals, axis=1)
    found = slsqp(wanted, reach, normals / scale[:, None], least / scale)
    return np.full(2, np.nan) if found is None else here + found


@pytest.mark.parametrize("met", ["fence and speed", "others"])
def test_what_can_be_kept_is_kept_as_a_solver_would(met: str, make_config: Maker) -> None:
    changed = 0
    for seed in range(80):
        random = np.random.default_rng([seed, met == "others"])
        fence = BOX if met == "fence and speed" else ()
        config = make_config(
            plant=ANISOTROPIC, safety={"fence_m": fence, "speed_max_m_s": 3.0, "acceleration_max_m_s2": 3.0}
        )
        place, velocity = random.uniform(-9.0, 9.0, 2), random.uniform(-1.8, 1.8, 2)
        seen = situation(tuple(place), tuple(velocity), tuple(random.uniform(-0.3, 0.3, 2)))
        bodies = (
            []
            if fence
            else [
                Body(
                    tuple(place + random.uniform(3.0, 9.0) * np.array([np.cos(turn), np.sin(turn)])),
                    tuple(random.uniform(-1.5, 1.5, 2)),
                    STILL,
                    3.0,
                    bool(random.random() < 0.7),
                )
                for turn in random.uniform(-pi, pi, 3)
            ]
        )
        aim = place + random.uniform(-8.0, 8.0, 2)
        guarded, setpoint = checked(config, seen, aim.tolist(), bodies)
        rows = demands(config, seen, bodies, 10.0 if fence else None)
        expected = expected_setpoint(rows, seen, aim, config.safety.setpoint_lead_max_m)
        if np.isnan(expected).any():
            assert guarded.status is GuardStatus.YIELDED
            continue
        assert setpoint == pytest.approx(expected, abs=5e-3), seed
        assert guarded.yielded is None
        changed += guarded.status is GuardStatus.CHANGED
    assert changed > 25


# Minimal change


near = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


@given(aim=near)
def test_an_aim_that_meets_all_demands_is_unchanged(aim: Pair, make_config: Maker) -> None:
    config = make_config(safety={"fence_m": BOX, "setpoint_lead_max_m": 8.0})
    wanted = np.array(aim)
    guarded = Guard(config).check(situation(), wanted, [body((0.0, 40.0)), body((-40.0, 0.0))])
    assert guarded.aim_m is wanted
    assert (guarded.status, guarded.causes, guarded.yielded) == (GuardStatus.PASSED, (), None)


# Whatever it is given


anywhere = st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)) | near
fast = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))
bodies_anywhere = st.lists(
    st.builds(Body, near | anywhere, fast, fast, st.floats(0.5, 20.0), st.booleans()), max_size=16
)


@given(place=near, velocity=fast, wind=near, aim=anywhere, bodies=bodies_anywhere, target=near, guard=st.booleans())
def test_the_reach_always_holds_and_every_answer_is_a_number(
    place: Pair,
    velocity: Pair,
    wind: Pair,
    aim: Pair,
    bodies: list[Body],
    target: Pair,
    guard: bool,
    make_config: Maker,
) -> None:
    config = make_config(safety={"fence_m": BOX, "keep_out_m": 2.0, "guard": guard})
    guarded, setpoint = checked(config, situation(place, velocity, wind, target, sigma_m=0.1), aim, bodies)
    assert np.isfinite(setpoint).all()
    assert np.linalg.norm(setpoint - place) <= config.safety.setpoint_lead_max_m + 1e-6
    assert list(guarded.causes) == sorted(set(guarded.causes))
    if guarded.status is GuardStatus.PASSED:
        assert (guarded.causes, guarded.yielded) == ((), None)
        assert np.linalg.norm(setpoint - aim) < 0.01 + 1e-9
    else:
        assert guarded.causes
    assert (guarded.yielded is not None) is (guarded.status in (GuardStatus.YIELDED, GuardStatus.BRAKED))
    again, repeated = checked(config, situation(place, velocity, wind, target, sigma_m=0.1), aim, bodies)
    assert (again.status, repeated.tobytes()) == (guarded.status, setpoint.tobytes())


def test_switched_off_it_only_keeps_the_reach(make_config: Maker) -> None:
    config = make_config(safety={"guard": False, "fence_m": BOX, "setpoint_lead_max_m": 6.0})
    near_by = [body((1.0, 0.0))]
    aim = np.array([5.0, 0.0])
    assert Guard(config).check(situation(), aim, near_by).aim_m is aim
    guarded, setpoint = checked(config, situation(place=(9.0, 0.0)), (29.0, 0.0), near_by)
    assert setpoint == pytest.approx((15.0, 0.0))
    assert (guarded.status, guarded.causes) == (GuardStatus.CHANGED, (Cause.REACH,))


def test_the_solver_is_bounded_and_asked_once_for_the_level_that_yields(
    make_config: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings: dict[str, float] = {}
    solved = 0
    setup, solve = osqp.OSQP.setup, osqp.OSQP.solve

    def noted_setup(self: object, *args: object, **named: float) -> object:
        settings.update(named)
        return setup(self, *args, **named)

    def counted_solve(self: object, *args: object, **named: object) -> object:
        nonlocal solved
        solved += 1
        return solve(self, *args, **named)

    monkeypatch.setattr(osqp.OSQP, "setup", noted_setup)
    monkeypatch.setattr(osqp.OSQP, "solve", counted_solve)
    config = make_config(safety={"fence_m": BOX})
    crowd = [body((x, 0.1 * number), shares=False) for number in range(10) for x in (1.0, -1.0)]
    guarded, _ = checked(config, situation(), (5.0, 0.0), crowd)
    assert guarded.status is GuardStatus.YIELDED
    assert settings["max_iter"] <= 1000
    assert solved == 1


def test_a_solver_that_fails_makes_the_vehicle_stop(make_config: Maker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("osqp.OSQP.solve", lambda *_, **__: UNSOLVED)
    crowd = [body((1.0, 0.0)), body((-1.0, 0.0))]
    guarded, setpoint = checked(make_config(), situation(place=(0.1, 0.2)), (5.0, 0.0), crowd)
    assert guarded.status is GuardStatus.BRAKED
    assert setpoint == pytest.approx((0.1, 0.2))


# What yields first


def acceleration(config: AgentConfig, seen: Situation, setpoint: Vector) -> Vector:
    here, velocity = seen.acting_motion[:2], seen.acting_motion[2:]
    return np.asarray(config.plant.a0_per_s2 * (setpoint - here) - config.plant.a1_per_s * velocity + seen.disturbance)


def test_the_speed_limit_yields_to_separation(make_config: Maker) -> None:
    """Somebody comes from behind, faster than the vehicle may fly."""
    config = make_config(safety={"speed_max_m_s": 2.0, "separation_m": 3.0})
    seen = situation(velocity=(2.0, 0.0))
    chased = [body((-3.0, 0.0), (3.0, 0.0), shares=False)]
    guarded, setpoint = checked(config, seen, (2.0, 0.0), chased)
    assert (guarded.status, guarded.yielded) == (GuardStatus.YIELDED, Cause.SPEED)
    assert Cause.SEPARATION in guarded.causes
    (row, least, _), *_ = demands(config, seen, chased, None)
    assert row @ setpoint >= least - 0.01
    assert acceleration(config, seen, setpoint)[0] > 0.5  # beyond the speed it may have


def test_the_keep_out_disc_yields_to_the_fence(make_config: Maker) -> None:
    config = make_config(safety={"keep_out_m": 4.0, "fence_m": BOX})
    seen = situation(place=(8.5, 0.0), target=(6.0, 0.0))
    guarded, setpoint = checked(config, seen, (8.5, 0.0))
    assert (guarded.status, guarded.yielded) == (GuardStatus.YIELDED, Cause.KEEP_OUT)
    assert 8.5 < setpoint[0] <= 10.0 + 0.01


def test_the_fence_yields_to_separation(make_config: Maker) -> None:
    config = make_config(safety={"fence_m": BOX})
    seen = situation(place=(9.5, 0.0))
    guarded, setpoint = checked(config, seen, (9.5, 0.0), [body((7.0, 0.0), (1.5, 0.0), shares=False)])
    assert (guarded.status, guarded.yielded) == (GuardStatus.YIELDED, Cause.FENCE)
    assert setpoint[0] > 10.0
    (row, least, _), *_ = demands(config, seen, [body((7.0, 0.0), (1.5, 0.0), shares=False)], None)
    assert row @ (setpoint - (9.5, 0.0)) >= least - 0.01


def test_at_the_fence_the_margin_of_one_that_evades_yields_but_not_the_separation(make_config: Maker) -> None:
    config = make_config(safety={"fence_m": BOX, "separation_m": 3.0})
    for away_m, closing_m_s, yielded in ((3.8, 0.0, Cause.MARGIN), (2.5, 1.5, Cause.FENCE)):
        near = body((9.9 - away_m, 0.0), (closing_m_s, 0.0), distance_m=5.0)
        guarded, setpoint = checked(config, situation(place=(9.9, 0.0)), (9.9, 0.0), [near])
        assert (guarded.status, guarded.yielded) == (GuardStatus.YIELDED, yielded)
        assert bool(setpoint[0] <= 10.0 + 0.01) is (yielded is Cause.MARGIN)


def test_separation_gives_way_only_to_itself(make_config: Maker) -> None:
    """Between two that do not evade there is no place to keep: the middle is the best there is."""
    squeezed = [body((1.0, 0.0), shares=False), body((-1.0, 0.0), shares=False)]
    guarded, setpoint = checked(make_config(), situation(), (3.0, 0.0), squeezed)
    assert (guarded.status, guarded.yielded) == (GuardStatus.YIELDED, Cause.SEPARATION)
    assert abs(setpoint[0]) < 0.1


# One cause at a time


@pytest.mark.parametrize(
    ("seen", "aim", "bodies", "cause"),
    [
        (situation(), (5.0, 0.0), [body((3.5, 0.0))], Cause.SEPARATION),
        (situation(place=(8.0, 0.0)), (13.0, 0.0), [], Cause.FENCE),
        (situation(target=(4.5, 0.0)), (5.0, 0.0), [], Cause.KEEP_OUT),
        (situation(velocity=(2.9, 0.0)), (6.0, 0.0), [], Cause.SPEED),
        (situation(), (7.0, 0.0), [], Cause.REACH),
    ],
)
def test_status_and_cause_say_why(
    seen: Situation, aim: Pair, bodies: list[Body], cause: Cause, make_config: Maker
) -> None:
    config = make_config(safety={"fence_m": BOX, "keep_out_m": 3.0, "speed_max_m_s": 3.0})
    guarded, setpoint = checked(config, seen, aim, bodies)
    assert (guarded.status, guarded.causes, guarded.yielded) == (GuardStatus.CHANGED, (cause,), None)
    assert setpoint[0] < aim[0]
    assert bool(setpoint[1] < 0.0) is (cause in (Cause.SEPARATION, Cause.KEEP_OUT))  # around it, on the right


EAST = NoFlySection(name="east", polygon_m=((10.0, -20.0), (30.0, -20.0), (30.0, 20.0), (10.0, 20.0)))
DISC = NoFlySection(name="disc", center_m=(1e4, 0.0), radius_m=1e4 - 10.0)


@given(
    place=st.tuples(st.floats(-9.0, 11.0), st.floats(-9.0, 9.0)),
    velocity=st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
    aim=st.tuples(st.floats(-9.0, 19.0), st.floats(-9.0, 9.0)),
)
def test_a_zone_beyond_an_edge_keeps_a_vehicle_out_as_the_fence_keeps_it_in(
    place: Pair, velocity: Pair, aim: Pair, make_config: Maker
) -> None:
    """The free side of both is the same half-plane; the disc's edge is nearly straight."""
    seen = situation(place=place, velocity=velocity, sigma_m=0.1)
    west = ((-1e3, -1e3), (10.0, -1e3), (10.0, 1e3), (-1e3, 1e3))
    _, fenced = checked(make_config(safety={"fence_m": west}), seen, aim)
    for zone, off_m in ((EAST, 1e-6), (DISC, 0.02)):
        guarded, kept = checked(make_config(safety={"no_fly": (zone,)}), seen, aim)
        assert kept == pytest.approx(fenced, abs=off_m)
        assert Cause.FENCE not in guarded.causes


def test_a_zone_is_open_above_its_ceiling_and_below_its_floor(make_config: Maker) -> None:
    zone = EAST.model_copy(update={"floor_m": 5.0, "ceiling_m": 12.0})
    guard = Guard(make_config(safety={"no_fly": (zone,)}))
    aim = np.array((14.0, 0.0))
    for height_m, is_closed in ((4.0, False), (4.9, True), (8.0, True), (12.4, True), (12.6, False)):
        there = at_height(situation(place=(9.0, 0.0), velocity=(1.0, 0.0)), height_m)
        assert bool(guard.check(there, aim, []).aim_m[0] < 10.0) is is_closed
    for place, height_m, planned_m, altitude_m in (
        ((20.0, 0.0), 3.0, 8.0, 4.0),  # below: not up into it
        ((20.0, 0.0), 14.0, 8.0, 13.0),  # above: not down into it
        ((20.0, 0.0), 14.0, 20.0, 20.0),
        ((0.0, 0.0), 3.0, 8.0, 8.0),  # beside it
    ):
        assert guard.altitude_m(planned_m, np.array([*place, 0.0, 0.0]), height_m) == altitude_m


def at_height(seen: Situation, height_m: float) -> Situation:
    return Situation(
        seen.now_s, seen.acting_s, seen.own, seen.acting_motion, seen.disturbance, None, None, None, height_m=height_m
    )


def test_uncertainty_keeps_a_vehicle_farther_inside_the_fence(make_config: Maker) -> None:
    """By 4 standard deviations, with those of the frame that all vehicles have in common."""
    config = make_config(safety={"fence_m": BOX, "uncertainty_sigmas": 3.0})
    for sigma_m, shift_m in ((0.0, 0.0), (0.15, 0.0), (0.09, 0.12)):
        seen = situation(place=(8.0, 0.0), sigma_m=sigma_m, shift_m=shift_m)
        _, setpoint = checked(config, seen, (12.0, 0.0))
        assert setpoint[0] <= 10.0 - 4.0 * hypot(sigma_m, shift_m) + 1e-6


@pytest.mark.parametrize(
    ("low", "high", "aim", "altitude"),
    [(None, None, 500.0, 500.0), (5.0, 20.0, 8.0, 8.0), (5.0, 20.0, 3.0, 5.0), (5.0, 20.0, 21.0, 20.0)],
)
def test_the_altitude_stays_in_the_band(
    low: float | None, high: float | None, aim: float, altitude: float, make_config: Maker
) -> None:
    guard = Guard(make_config(safety={"altitude_min_m": low, "altitude_max_m": high}))
    assert guard.altitude_m(aim, np.zeros(4), 8.0) == altitude


# Two or three in closed loop, on plants that are not the model


PERTURBED = (
    Plant(PlantAxis(0.8 * 1.15, 0.87 * 0.85), PlantAxis(0.8 * 1.15, 0.87 * 0.85)),
    Plant(PlantAxis(0.8 * 0.85, 0.87 * 1.15), PlantAxis(0.8 * 0.85, 0.87 * 1.15)),
)


def meet(
    config: AgentConfig,
    starts: Sequence[Pair],
    goals: Sequence[Pair],
    shares: Sequence[bool],
    plants: Sequence[int] = (0, 1),
    distance_m: float = 3.0,
) -> Vector:
    """Fly V vehicles that know each other's motion for 40 s; who does not share does not look. Paths (T, V, 2)."""
    motions = [np.array([*start, 0.0, 0.0]) for start in starts]
    guard = Guard(config)
    paths = []
    for _ in range(400):
        paths.append([motion[:2].copy() for motion in motions])
        setpoints = []
        for index, motion in enumerate(motions):
            others = [
                Body(tuple(other[:2]), tuple(other[2:]), STILL, distance_m, shares[each], each + 1)
                for each, other in enumerate(motions)
                if each != index
            ]
            own = OwnEstimate(10.0, np.array([*motion, 0.0, 0.0]), own_spread())
            seen = Situation(10.0, 10.05, own, motion, np.zeros(2), None, None, None)
            goal = np.array(goals[index])
            lead = goal - motion[:2]
            aim = motion[:2] + lead * min(1.0, 3.0 / max(float(np.linalg.norm(lead)), 1e-9))
            setpoints.append(guard.check(seen, aim, others if shares[index] else []).aim_m)
        motions = [
            exact_step(PERTURBED[plant], 0.1).advance(motion, setpoint, np.zeros(2))
            for plant, motion, setpoint in zip(plants, motions, setpoints, strict=True)
        ]
    return np.array(paths)


def test_two_that_meet_head_on_pass_each_other_on_the_right(make_config: Maker) -> None:
    turn_rad = 0.7
    along = np.array([np.cos(turn_rad), np.sin(turn_rad)])
    ends = tuple((-12.0 * along).tolist()), tuple((12.0 * along).tolist())
    paths = meet(make_config(), ends, ends[::-1], (True, True))
    apart = np.linalg.norm(paths[:, 0] - paths[:, 1], axis=1)
    assert apart.min() >= 3.0 - 0.05
    right_of_first = np.array([along[1], -along[0]])
    middle = int(apart.argmin())
    assert paths[middle, 0] @ right_of_first > 0.5
    assert paths[middle, 1] @ -right_of_first > 0.5
    assert paths[-1] == pytest.approx(np.array(ends[::-1]), abs=0.05)


def test_one_that_does_not_evade_is_got_around_by_the_other_alone(make_config: Maker) -> None:
    paths = meet(make_config(), ((-12.0, 0.0), (6.0, 0.0)), ((12.0, 0.0), (-8.0, 0.0)), (True, False))
    assert np.linalg.norm(paths[:, 0] - paths[:, 1], axis=1).min() >= 3.0 - 0.1
    assert np.abs(paths[:, 1, 1]).max() < 1e-6
    assert paths[-1, 0] == pytest.approx((12.0, 0.0), abs=0.05)


@pytest.mark.parametrize(
    ("starts", "goals"),
    [
        (((-0.4, 0.0), (-2.5, 5.0), (-1.5, -3.9)), ((3.0, 0.0), (3.5, -3.9), (3.5, 4.6))),
        (((0.4, 0.0), (-0.5, 4.1), (-2.4, -4.6)), ((3.0, 0.0), (4.2, -4.8), (1.6, 2.4))),
        (((-0.5, 0.0), (-0.7, 4.1), (-0.5, -3.9)), ((3.0, 0.0), (4.3, -0.8), (2.5, 1.6))),
    ],
)
@pytest.mark.parametrize("plants", [(0, 1, 1), (1, 0, 0)])
def test_a_vehicle_that_two_press_against_a_zone_does_not_enter_it(
    starts: Sequence[Pair], goals: Sequence[Pair], plants: Sequence[int], make_config: Maker
) -> None:
    """It cannot do its half of both evasions: the two others do more, and all keep more than the separation of 3 m."""
    mast = NoFlySection(name="mast", center_m=(7.0, 0.0), radius_m=3.5)
    config = make_config(safety={"no_fly": (mast,)})
    paths = meet(config, starts, goals, (True, True, True), plants, distance_m=3.6)
    assert np.linalg.norm(paths - (7.0, 0.0), axis=2).min() >= 3.5 - 0.02
    assert min(np.linalg.norm(paths[:, i] - paths[:, k], axis=1).min() for i, k in ((0, 1), (0, 2), (1, 2))) >= 3.2


def test_a_vehicle_flies_to_the_fence_without_crossing_it(make_config: Maker) -> None:
    config = make_config(safety={"fence_m": BOX})
    for plant, (one, other) in zip(PERTURBED, pairwise([(0.0, 0.0), (3.0, -9.0), (9.5, 9.5)]), strict=True):
        motion, guard = np.array([*one, 2.0, 1.0]), Guard(config)
        for _ in range(300):
            own = OwnEstimate(10.0, np.array([*motion, 0.0, 0.0]), own_spread())
            seen = Situation(10.0, 10.05, own, motion, np.zeros(2), None, None, None)
            aim = motion[:2] + np.array(other) / hypot(*other) * 6.0
            motion = exact_step(plant, 0.1).advance(motion, guard.check(seen, aim, []).aim_m, np.zeros(2))
            assert np.abs(motion[:2]).max() <= 10.0 + 0.02
        assert np.abs(motion[:2]).max() == pytest.approx(10.0, abs=0.1)
