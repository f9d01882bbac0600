"""One short flight of the experiment with adversaries, `tests.experiments.adversaries`."""

import os
from typing import get_args

import pytest

from tests.experiments.adversaries import KINDS, Kind, fly, judged, sites, usurped

pytestmark = [pytest.mark.wire, pytest.mark.long]

ROUNDS, SEED = 6, 30006
"""With this seed each kind acts during a hold and a kill, an operator floods, and a vehicle names another mission."""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may become another user")
def test_an_authorised_hold_or_kill_arrives_within_a_second_and_no_other_acts() -> None:
    with sites(apart=False) as site:
        flown = fly(site, 3, SEED, ROUNDS, KINDS)
    assert [(one.kinds, fault) for one, _, fault in judged(flown) if fault] == []
    assert usurped(flown) == []
    assert {(one.verb, kind) for one in flown.rounds for kind in one.kinds} == {
        (verb, kind) for verb in ("hold", "kill") for kind in get_args(Kind)
    }
