"""Members that come, go and come back, in closed loop: `python -m tests.membership 50` flies many more seeds."""

import pytest

from tests.membership import SCENES, measured


@pytest.mark.parametrize(("name", "seed"), [("3 -> 2 on the ring", 1), ("2 -> 3 on the ring", 0)])
def test_the_ring_closes_and_opens(name: str, seed: int) -> None:
    build, in_formation, limit_s = SCENES[name]
    draw = measured(build, in_formation, seed)
    assert draw.settled_s <= limit_s
    assert draw.separation_left_m >= 0.0
    assert draw.overtakings == 0
    assert draw.innermost_share >= 0.75  # nobody cuts across


def test_a_leader_that_comes_back_disturbs_nobody() -> None:
    build, in_formation, _ = SCENES["leader back in formation"]
    draw = measured(build, in_formation, 2)  # comes from the side, from beyond the end of the line
    assert draw.settled_s <= 25.0
    assert draw.separation_left_m >= 0.0


def test_a_slow_formation_stays_in_line_beside_a_leader_that_is_lost() -> None:
    build, in_formation, _ = SCENES["leader lost in formation"]
    draw = measured(build, in_formation, 37)  # 0.1 m/s: half a minute passes until the lost one is out of reach
    assert draw.settled_s == 0.0
    assert draw.separation_left_m >= 0.0


@pytest.mark.parametrize(("name", "seed"), [("cut off on the ring", 108), ("leader cut off in formation", 106)])
def test_one_whose_radio_fails_gets_out_of_the_others_way(name: str, seed: int) -> None:
    build, in_formation, limit_s = SCENES[name]
    draw = measured(build, in_formation, seed)
    assert draw.settled_s <= limit_s
    assert draw.separation_left_m >= 0.0
