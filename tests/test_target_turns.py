"""One flight about a target that turns, and is out of sight for 20 s; `python -m tests.target_turns` flies many."""

from tests.target_turns import BLIND_FROM_S, BLIND_S, flown


def test_a_turning_target_is_encircled_and_its_return_to_sight_moves_no_setpoint_far() -> None:
    turns = flown(3, blind=True, duration_s=BLIND_FROM_S + BLIND_S + 16.0)
    assert turns.within_limits(blind=False), turns
    assert turns.within_limits(blind=True), turns
