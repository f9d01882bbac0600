"""The guard's interventions as news: at the beginning, and once more only after a while without any."""

import numpy as np
import pytest

from agents.notes import GuardAction
from agents.safety.barriers import Cause
from agents.safety.guard import QUIET_S, Guarded, GuardStatus, Interventions

AIM_M = np.array([1.0, 2.0])
PASSED = Guarded(AIM_M)
CHANGED = Guarded(AIM_M + np.array([3.0, -4.0]), GuardStatus.CHANGED, (Cause.SPEED, Cause.SEPARATION))


def test_an_intervention_is_reported_with_its_causes_and_the_motion_of_the_aim() -> None:
    news = Interventions().news(10.0, AIM_M, CHANGED)
    assert news is not None
    action, because = news
    assert action == GuardAction(("speed", "separation"))
    for number in ("1.00", "2.00", "5.00"):
        assert number in because


@pytest.mark.parametrize(("quiet_s", "news"), [(0.1, False), (QUIET_S, False), (QUIET_S + 0.1, True)])
def test_an_intermittent_intervention_is_reported_once(quiet_s: float, news: bool) -> None:
    interventions = Interventions()
    told = [interventions.news(10.0 + tick / 10.0, AIM_M, CHANGED) for tick in range(100)]
    assert [each is not None for each in told] == [True] + [False] * 99
    assert interventions.news(20.0, AIM_M, PASSED) is None
    assert (interventions.news(19.9 + quiet_s, AIM_M, CHANGED) is not None) is news
