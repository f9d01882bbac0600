"""The centre of the ring: the target's estimate, without a jump when it is seen again after a while."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from agents.settings.config import AgentConfig
from agents.situation.estimator import TargetBlend
from estimation.state import TargetEstimate, Vector
from tests.support.estimates import target_spread

Maker = Callable[..., AgentConfig]
PERIOD_S = 0.1
GONE_S, BACK_S = 10.0, 30.0


def estimate(now_s: float, sighted_s: float, motion: Vector) -> TargetEstimate:
    return TargetEstimate(now_s, motion, target_spread(1.0), sighted_s, 0.8, 0.2)


def centres(blend: TargetBlend, until_s: float = 120.0) -> list[tuple[float, Vector]]:
    """The centre about a target at 2 m/s along y that comes back 40 m off where it was left at rest."""
    found = []
    for tick in range(round(until_s / PERIOD_S)):
        now_s = tick * PERIOD_S
        seen = now_s < GONE_S or now_s >= BACK_S
        motion = np.array([0.0, 2.0 * now_s, 0.0, 2.0]) if seen else np.array([0.0, 2.0 * GONE_S, 0.0, 0.0])
        centre = blend.centre(estimate(now_s, now_s if seen else GONE_S - PERIOD_S, motion), now_s)
        assert centre is not None
        found.append((now_s, centre.copy()))
    return found


def test_the_centre_catches_up_without_a_jump_and_is_then_the_target_again(make_config: Maker) -> None:
    found = centres(TargetBlend(make_config(encirclement={"speed_max_m_s": 4.0})))
    after = [(now_s, centre) for now_s, centre in found if now_s >= BACK_S - PERIOD_S]
    moves = [np.linalg.norm(b[:2] - a[:2]) for (_, a), (_, b) in pairwise(after)]
    assert max(moves) <= 0.35
    assert max(np.linalg.norm(b[2:] - a[2:]) for (_, a), (_, b) in pairwise(after)) <= 0.15
    now_s, last = found[-1]
    assert last == pytest.approx([0.0, 2.0 * now_s, 0.0, 2.0], abs=1e-9)


def test_another_gap_on_the_way_goes_on_from_there(make_config: Maker) -> None:
    blend, found = TargetBlend(make_config()), []
    for tick in range(150):
        now_s = tick * PERIOD_S
        sighted_s, x = (0.0, 0.0) if now_s < 2.0 else (2.0, 30.0) if now_s < 6.0 else (now_s, 40.0)
        centre = blend.centre(estimate(now_s, sighted_s, np.array([x, 0.0, 0.0, 0.0])), now_s)
        assert centre is not None
        found.append(centre.copy())
    assert blend.catching_up
    assert max(np.linalg.norm(b[:2] - a[:2]) for a, b in pairwise(found)) <= 0.25
    assert found[-1][0] > 20.0


def test_the_centre_is_handed_over_to_a_target_that_does_not_go_straight_without_a_jump(make_config: Maker) -> None:
    blend, found, caught = TargetBlend(make_config()), [], []
    for tick in range(400):
        now_s = tick * PERIOD_S
        turn_rad, radius_m = 0.4 * now_s, 1.2
        around = np.array([np.cos(turn_rad), np.sin(turn_rad), -0.4 * np.sin(turn_rad), 0.4 * np.cos(turn_rad)])
        sighted_s, motion = (now_s, radius_m * around) if now_s >= 3.0 else (0.0, np.array([6.0, 0.0, 0.0, 0.0]))
        centre = blend.centre(estimate(now_s, sighted_s, motion), now_s)
        assert centre is not None
        found.append(centre.copy())
        caught.append(not blend.catching_up and now_s > 3.0)
    assert any(caught)
    assert found[-1] == pytest.approx(radius_m * around)
    handed = caught.index(True)
    assert max(np.linalg.norm(b[:2] - a[:2]) for a, b in pairwise(found[handed - 20 :])) <= 0.06
