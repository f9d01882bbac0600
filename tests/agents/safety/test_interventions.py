"""The guard's interventions as news: at the beginning, and once more only after a while without any."""

import numpy as np
import pytest

from agents.notes import GuardAction
from agents.safety.barriers import Cause
from agents.safety.guard import (
    BENT_FOR_S,
    BENT_M,
    QUIET_S,
    STRAIGHT_AFTER_S,
    Guarded,
    GuardStatus,
    Interventions,
)
from agents.tactics import Tactic

AIM_M = np.array([1.0, 2.0])
PASSED = Guarded(AIM_M)
CHANGED = Guarded(AIM_M + np.array([3.0, -4.0]), GuardStatus.CHANGED, (Cause.SPEED, Cause.SEPARATION), None, (1, 3))


def test_an_intervention_is_reported_with_its_causes_and_the_motion_of_the_aim() -> None:
    news = Interventions().news(10.0, AIM_M, CHANGED)
    assert news is not None
    action, because = news
    assert action == GuardAction(("speed", "separation"), (1, 3))
    assert action.text == "slowed to the speed limit, evading 1, 3"
    for number in ("1.00", "2.00", "5.00"):
        assert number in because


@pytest.mark.parametrize(("quiet_s", "news"), [(0.1, False), (QUIET_S, False), (QUIET_S + 0.1, True)])
def test_an_intermittent_intervention_is_reported_once(quiet_s: float, news: bool) -> None:
    interventions = Interventions()
    told = [interventions.news(10.0 + tick / 10.0, AIM_M, CHANGED) for tick in range(100)]
    assert [each is not None for each in told] == [True] + [False] * 99
    assert interventions.news(20.0, AIM_M, PASSED) is None
    assert (interventions.news(19.9 + quiet_s, AIM_M, CHANGED) is not None) is news


def bent(by_m: float, *causes: Cause) -> Guarded:
    return Guarded(AIM_M + np.array([by_m, 0.0]), GuardStatus.CHANGED, causes, None, (2,))


@pytest.mark.parametrize(("tactic", "shown_s"), [(Tactic.HOLD, 0.0), (Tactic.FORMATION, BENT_FOR_S)])
def test_an_aim_that_stays_bent_is_shown_in_each_tactic_until_it_is_straight(tactic: Tactic, shown_s: float) -> None:
    """With gaps, as the guard acts on and off while two vehicles keep apart."""
    interventions = Interventions()
    shown = []
    for tick in range(100):
        now_s = tick / 10.0
        acts = tick < 50 and tick % 10 < 8
        interventions.news(now_s, AIM_M, bent(BENT_M + 0.1, Cause.SPEED, Cause.SEPARATION) if acts else PASSED)
        if interventions.lasting(now_s, tactic) == GuardAction(("separation",), (2,)):
            shown.append(now_s)
    assert shown[0] == pytest.approx(shown_s)
    assert shown[-1] == pytest.approx(4.7 + STRAIGHT_AFTER_S)
    assert len(shown) == round(10.0 * (shown[-1] - shown[0])) + 1, "without gaps"


def test_what_hardly_bends_an_aim_or_only_slows_the_vehicle_down_is_not_shown() -> None:
    interventions = Interventions()
    for guarded in (bent(BENT_M - 0.1, Cause.SEPARATION), bent(2.0, Cause.SPEED), bent(2.0, Cause.REACH)):
        interventions.news(0.0, AIM_M, guarded)
        assert interventions.lasting(0.0, Tactic.HOLD) is None
