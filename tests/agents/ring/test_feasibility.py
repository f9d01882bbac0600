"""The ring that can be flown about a target: slower, then wider; by steps, with hysteresis, and agreed on."""

from collections.abc import Callable
from itertools import product
from math import sqrt

import pytest

from agents.ring.feasibility import BROKEN_MAX, RESERVE, RingFeasibility
from agents.settings.config import AgentConfig
from agents.team.messages import MemberState, NeighbourAngle
from agents.team.ring_members import FULL_RING, RingScale
from tests.support.team import a_team

Maker = Callable[..., AgentConfig]
RING = {"radius_m": 10.0, "angular_rate_rad_s": 0.15, "speed_max_m_s": 3.0, "acceleration_max_m_s2": 2.0}


def fly(
    ring_feasibility: RingFeasibility, target_m_s: float, from_s: float, for_s: float, others: RingScale = FULL_RING
) -> list[str]:
    """What is told while the target keeps a speed."""
    told = [ring_feasibility.find(target_m_s, others, from_s + tick * 0.1) for tick in range(round(for_s * 10.0))]
    return [text for text in told if text is not None]


def flown(ring_feasibility: RingFeasibility) -> tuple[float, float]:
    """Return radius and angular rate of the flown ring."""
    return ring_feasibility.orbit.radius_m, ring_feasibility.orbit.angular_rate_rad_s


def test_what_is_flown_keeps_the_limits_and_the_rate_goes_first(subtests: pytest.Subtests, make_config: Maker) -> None:
    for target_m_s, acceleration_m_s2, sign in product([0.1 * k for k in range(31)], (0.5, 1.0, 2.0, 4.0), (-1.0, 1.0)):
        with subtests.test(target_m_s=target_m_s, acceleration_m_s2=acceleration_m_s2, sign=sign):
            ring = RING | {"acceleration_max_m_s2": acceleration_m_s2, "angular_rate_rad_s": sign * 0.15}
            shares = RingFeasibility(make_config(encirclement=ring)).shares(target_m_s)
            rate, radius_m = shares.rate * 0.15, shares.radius * 10.0
            assert 0.0 <= shares.rate <= 1.0 <= shares.radius <= 2.0
            assert rate * radius_m + target_m_s <= RESERVE * 3.0 + 1e-9 or shares.rate == 0.0
            if shares.radius > 1.0:
                assert shares.rate <= 0.3
            if shares.radius < 2.0 and target_m_s > 0.0:
                turning_m_s2 = target_m_s**2 / (BROKEN_MAX * radius_m)
                assert turning_m_s2 + rate**2 * radius_m <= acceleration_m_s2 + 1e-9


def test_what_is_lowered_is_the_most_that_the_speed_allows(make_config: Maker) -> None:
    """By hand: 0.95 * 3 m/s less 2 m/s leaves 0.85 m/s of the 1.5 m/s along the ring, 56 %, so 50 %."""
    ring_feasibility = RingFeasibility(make_config(encirclement=RING | {"acceleration_max_m_s2": 4.0}))
    assert ring_feasibility.shares(2.0) == RingScale(0.5, 1.0)
    assert ring_feasibility.shares(3.0) == RingScale(0.0, 1.0)


def test_a_ring_too_small_for_a_turn_is_widened_as_needed(make_config: Maker) -> None:
    """The smallest R with V²/(0.25 R) + w² R <= A, for V = 2 m/s, w = 0.3 * 0.15 rad/s, A = 1 m/s²: 16.5 m."""
    config = make_config(encirclement=RING | {"acceleration_max_m_s2": 1.0, "speed_max_m_s": 20.0})
    squared = 0.045**2
    smallest_m = (1.0 - sqrt(1.0 - 64.0 * squared)) / (2.0 * squared)
    assert 16.0 < smallest_m < 17.0
    assert RingFeasibility(config).shares(2.0) == RingScale(0.3, 1.7)


def test_a_feasible_ring_is_reported_once_adopted_soon_and_relaxed_late(make_config: Maker) -> None:
    ring_feasibility = RingFeasibility(make_config(encirclement=RING | {"acceleration_max_m_s2": 4.0}))
    assert fly(ring_feasibility, 0.1, -4.0, 4.0) == []
    assert fly(ring_feasibility, 2.0, 0.0, 0.4) == []
    assert fly(ring_feasibility, 2.0, 0.4, 6.0) == ["ring at 50% of its rate: the target moves at 2.0 m/s"]
    assert ring_feasibility.orbit.angular_rate_rad_s == pytest.approx(0.075)
    # Neither noise nor a short stop changes that.
    for tick in range(100):
        assert ring_feasibility.find(2.0 + 0.1 * (-1) ** tick, FULL_RING, 6.4 + tick * 0.1) is None
    assert fly(ring_feasibility, 0.0, 16.4, 5.0) == []
    assert ring_feasibility.needed.rate == 0.5
    assert fly(ring_feasibility, 0.0, 21.4, 60.0)[-1] == ""
    assert ring_feasibility.orbit.angular_rate_rad_s == pytest.approx(0.15)


def test_what_slows_the_ring_is_told(make_config: Maker, subtests: pytest.Subtests) -> None:
    with subtests.test("a ring at the limit of the speed: 16 m at 0.1 rad/s leave 0.015 m/s of 0.95 * 1.7 m/s"):
        ring = RING | {"radius_m": 16.0, "angular_rate_rad_s": 0.1, "speed_max_m_s": 1.7}
        text = "ring at 90% of its rate: the whole ring of 1.60 m/s leaves 0.01 m/s of the vehicles' 1.61 m/s"
        (told,) = fly(RingFeasibility(make_config(encirclement=ring)), 0.03, -4.0, 10.0)
        assert told == f"{text} for the motion of the target"
    with subtests.test("a ring at the limit of the acceleration: 10 m at 0.15 rad/s need 0.225 m/s²"):
        ring = RING | {"acceleration_max_m_s2": 0.226}
        (told,) = fly(RingFeasibility(make_config(encirclement=ring)), 0.08, -4.0, 10.0)
        assert told.startswith("ring at 90% of its rate: the whole ring needs 0.23 m/s² of the vehicles' 0.23 m/s²")
    with subtests.test("a target that has stopped"):
        ring_feasibility = RingFeasibility(make_config(encirclement=RING | {"acceleration_max_m_s2": 4.0}))
        fly(ring_feasibility, 2.0, -4.0, 10.0)
        told = fly(ring_feasibility, 0.0, 6.0, 10.0)[-1]
        assert told == "ring at 60% of its rate: the target moves at 0.0 m/s now; the rate rises by 10% every 8 s"
    with subtests.test("a target that goes on more slowly"):
        fly(ring_feasibility, 1.9, 16.0, 1.0)  # 0.95 m/s of the 1.5 m/s are left: 60 %
        assert ring_feasibility.words == "ring at 60% of its rate: the target moves at 1.9 m/s"


def test_the_speed_of_a_target_just_found_does_not_change_the_ring(make_config: Maker) -> None:
    ring_feasibility = RingFeasibility(make_config(encirclement=RING))
    assert fly(ring_feasibility, 5.0, 0.0, 2.5) + fly(ring_feasibility, 0.2, 2.5, 10.0) == []
    assert flown(ring_feasibility) == flown(RingFeasibility(make_config(encirclement=RING)))


def test_a_ring_changes_smoothly(make_config: Maker) -> None:
    ring_feasibility = RingFeasibility(make_config(encirclement=RING | {"acceleration_max_m_s2": 1.0}))
    before = ring_feasibility.orbit
    for tick in range(300):
        ring_feasibility.find(2.0, FULL_RING, tick * 0.1)
        assert abs(ring_feasibility.orbit.angular_rate_rad_s - before.angular_rate_rad_s) <= 0.1 * 0.15 * 0.1 + 1e-9
        assert abs(ring_feasibility.orbit.radius_m - before.radius_m) <= 0.05 * 10.0 * 0.1 + 1e-9
        before = ring_feasibility.orbit
    assert before.radius_m > 10.0


def test_who_waits_outside_flies_by_the_ring_of_those_on_it_at_once(make_config: Maker) -> None:
    ring_feasibility, flown = RingFeasibility(make_config(encirclement=RING)), RingScale(0.4, 1.6)
    ring_feasibility.find(0.1, flown, 0.0, joined=False)
    assert ring_feasibility.orbit.radius_m == pytest.approx(16.0)
    assert ring_feasibility.orbit.angular_rate_rad_s == pytest.approx(0.06)
    ring_feasibility.find(0.1, RingScale(0.4, 2.0), 0.1, joined=True)
    assert ring_feasibility.orbit.radius_m == pytest.approx(16.05)


def test_all_fly_the_most_restricted_ring_and_return_from_it(make_config: Maker) -> None:
    config = make_config(encirclement=RING)
    one, other = RingFeasibility(config), RingFeasibility(config)
    for tick in range(100):
        one.find(2.4, other.needed, tick * 0.1)
        other.find(0.1, one.needed, tick * 0.1)
    assert other.needed == FULL_RING
    assert flown(other) == flown(one) != flown(RingFeasibility(config))
    for tick in range(100, 1100):
        one.find(0.1, other.needed, tick * 0.1)
        other.find(0.1, one.needed, tick * 0.1)
    assert flown(one) == flown(other) == flown(RingFeasibility(config))


def test_a_team_has_the_ring_that_its_engaged_members_can_fly() -> None:
    team = a_team()
    for sender, tactic, rate, radius in ((1, "encircle", 0.7, 1.0), (2, "encircle", 1.0, 1.4), (3, "hold", 0.1, 2.0)):
        team.receive(MemberState(sender, 1.0, tactic, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)))
        team.ring.receive(NeighbourAngle(sender, 1.0, 0.0, 0.1, 10.0, rate, radius).numbers)
    assert team.ring.shares() == RingScale(0.7, 1.4)
