"""The demands against numerical derivatives: h is measured along paths of constant acceleration, nothing is derived."""

from collections.abc import Callable
from math import cos, hypot, pi, sin

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agents.safety.barriers import Body, Cause, Demand, apart, demanded_from_m, slow, within
from agents.safety.fence import Fence
from estimation.vectors import Pair

RATE_PER_S = 1.3
STEP_S = 1e-3

places = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
speeds = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
accelerations = st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0))
Path = Callable[[float], Pair]


def path(place: Pair, speed: Pair, acceleration: Pair) -> Path:
    def at(time_s: float) -> Pair:
        x, y = (p + v * time_s + a / 2.0 * time_s**2 for p, v, a in zip(place, speed, acceleration, strict=True))
        return x, y

    return at


def along(demand: Demand, acceleration: Pair) -> float:
    return demand.normal[0] * acceleration[0] + demand.normal[1] * acceleration[1]


def just_meeting(demand: Demand, sideways: float = 0.0, more: float = 0.0) -> Pair:
    """An acceleration that meets the demand exactly, or by `more`, with whatever across it."""
    (x, y), least = demand.normal, demand.least_m_s2 + more
    return least * x - sideways * y, least * y + sideways * x


def condition(h: Callable[[float], float]) -> float:
    """h'' + 2 k h' + k^2 h at time 0, by central differences."""
    before, now, after = h(-STEP_S), h(0.0), h(STEP_S)
    slope, bend = (after - before) / (2.0 * STEP_S), (after - 2.0 * now + before) / STEP_S**2
    return bend + 2.0 * RATE_PER_S * slope + RATE_PER_S**2 * now


def gap_m2(one: Path, other: Path, distance_m: float) -> Callable[[float], float]:
    def h(time_s: float) -> float:
        (x, y), (its_x, its_y) = one(time_s), other(time_s)
        return (x - its_x) ** 2 + (y - its_y) ** 2 - distance_m**2

    return h


@given(place=places, speed=speeds, its=places, its_speed=speeds, its_acceleration=accelerations, aside=speeds)
def test_alone_a_vehicle_that_meets_the_demand_exactly_meets_the_whole_condition_exactly(
    place: Pair, speed: Pair, its: Pair, its_speed: Pair, its_acceleration: Pair, aside: Pair
) -> None:
    away_m = hypot(place[0] - its[0], place[1] - its[1])
    assume(away_m > 0.5)
    demand = apart(place, speed, Body(its, its_speed, its_acceleration, 3.0, shares=False), RATE_PER_S, Cause.KEEP_OUT)
    assert demand.cause is Cause.KEEP_OUT
    assert demand.evades
    assert hypot(*demand.normal) == pytest.approx(1.0)
    other = path(its, its_speed, its_acceleration)
    for more in (0.0, 1.0, -1.0):
        own = path(place, speed, just_meeting(demand, aside[0], more))
        # What is more than demanded counts 2 |dp| times in h''.
        assert condition(gap_m2(own, other, 3.0)) == pytest.approx(2.0 * away_m * more, abs=0.02)


@given(place=places, speed=speeds, its=places, its_speed=speeds, aside=speeds, share=st.floats(-1.0, 1.0))
def test_both_halves_together_make_the_whole_condition(
    place: Pair, speed: Pair, its: Pair, its_speed: Pair, aside: Pair, share: float
) -> None:
    away_m = hypot(place[0] - its[0], place[1] - its[1])
    assume(away_m > 0.5)
    # Each knows the other's place and speed only; what the other's acceleration is does not matter to its half.
    own_demand = apart(place, speed, Body(its, its_speed, (9.0, 9.0), 3.0, shares=True), RATE_PER_S, Cause.SEPARATION)
    its_demand = apart(its, its_speed, Body(place, speed, (-9.0, 9.0), 3.0, shares=True), RATE_PER_S, Cause.SEPARATION)
    own = path(place, speed, just_meeting(own_demand, aside[0]))
    other = path(its, its_speed, just_meeting(its_demand, aside[1]))
    assert condition(gap_m2(own, other, 3.0)) == pytest.approx(0.0, abs=0.02)
    own = path(place, speed, just_meeting(own_demand, aside[0], more=abs(share)))
    assert condition(gap_m2(own, other, 3.0)) >= -0.02


def test_two_in_one_place_get_a_demand_that_is_a_number() -> None:
    body = Body((2.0, 1.0), (0.5, 0.0), (0.0, 0.0), 3.0, shares=True)
    demand = apart((2.0, 1.0), (0.5, 0.0), body, RATE_PER_S, Cause.SEPARATION)
    assert hypot(*demand.normal) == 1.0
    assert demand.least_m_s2 > 10.0


CORNERS = ((0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (14.0, 9.0), (0.0, 20.0))
inside_it = st.tuples(st.floats(0.5, 29.5), st.floats(0.5, 8.0))


@given(place=inside_it, speed=speeds, margin_m=st.floats(0.0, 1.0), aside=st.floats(-4.0, 4.0))
def test_meeting_a_demand_of_the_fence_meets_its_condition(
    place: Pair, speed: Pair, margin_m: float, aside: float
) -> None:
    points = Fence(CORNERS).nearest_points(place)
    demands = list(within(points, speed, margin_m, RATE_PER_S, Cause.FENCE))
    assert len(demands) == len(points) >= 3
    for demand, point in zip(demands, points, strict=True):
        assert (demand.cause, demand.normal, demand.evades) == (Cause.FENCE, point.inward, False)
        flown = path(place, speed, just_meeting(demand, aside))

        # The fence is taken for straight there, as the edge is; about a corner it only falls back.
        def h(time_s: float, flown: Path = flown, inward: Pair = point.inward, left: float = point.distance_m) -> float:
            x, y = flown(time_s)
            return left + inward[0] * (x - place[0]) + inward[1] * (y - place[1]) - margin_m

        assert condition(h) == pytest.approx(0.0, abs=1e-3)


@given(speed_m_s=st.floats(2.6, 8.0), course_rad=st.floats(-pi, pi), aside=st.floats(-4.0, 4.0))
def test_meeting_the_demand_of_the_speed_limit_meets_its_condition_of_first_order(
    speed_m_s: float, course_rad: float, aside: float
) -> None:
    velocity = speed_m_s * cos(course_rad), speed_m_s * sin(course_rad)
    (demand,) = slow(velocity, 5.0, RATE_PER_S)
    assert (demand.cause, demand.evades) == (Cause.SPEED, False)
    acceleration = just_meeting(demand, aside)
    assert along(demand, acceleration) == pytest.approx(demand.least_m_s2)

    def h(time_s: float) -> float:
        x, y = (rate + a * time_s for rate, a in zip(velocity, acceleration, strict=True))
        return 5.0**2 - x**2 - y**2

    slope = (h(STEP_S) - h(-STEP_S)) / (2.0 * STEP_S)
    assert slope + 2.0 * RATE_PER_S * h(0.0) == pytest.approx(0.0, abs=1e-6)


@given(st.floats(0.0, 5.0), st.floats(0.5, 8.0), st.floats(0.3, 3.0))
def test_a_vehicle_that_flies_straight_at_a_body_has_to_brake_from_the_distance_returned_on(
    speed_m_s: float, distance_m: float, rate_per_s: float
) -> None:
    from_m = demanded_from_m(speed_m_s, distance_m, rate_per_s)
    body = Body((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), distance_m, shares=False)
    farther, nearer = (
        apart((from_m * share, 0.0), (-speed_m_s, 0.0), body, rate_per_s, Cause.SEPARATION).least_m_s2
        for share in (1.001, 0.999)
    )
    assert farther < 0.0 < nearer
