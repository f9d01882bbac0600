"""Flights about a target that turns and is out of sight for 20 s.

`python -m tests.experiments.target_turns` flies many.
"""

import pytest

from agents.tactics import Tactic
from tests.experiments.target_turns import Flight, flown

pytestmark = pytest.mark.slow


def test_a_turning_target_is_encircled_and_its_return_to_sight_moves_no_setpoint_far() -> None:
    turns = flown(3, Flight.AWAITED, 135.0)
    assert turns.within_limits, turns
    assert turns.tactics == (Tactic.ENCIRCLE,)


def test_a_target_out_of_sight_for_too_long_is_held_for_and_taken_up_again_without_a_jump() -> None:
    turns = flown(3, Flight.HELD, 140.0)
    assert turns.within_limits, turns
    assert turns.tactics == (Tactic.ENCIRCLE, Tactic.HOLD, Tactic.ENCIRCLE)
