"""Sixteen that encircle one target at the same time: the crowd in which plans are on their bounds for longest."""

from collections import Counter

from agents.control.lmpc import QpStatus
from agents.outputs import TickOutput
from agents.tactics import Tactic
from tests.experiments.membership_scenes import sixteen
from tests.support.observed_flight import observed

JOINING_S = 25.0


def test_plans_of_a_crowd_are_solved_and_no_vehicle_steps_aside() -> None:
    scene, solved, tactics = sixteen(2), Counter[bool](), set[Tactic]()

    def observe(_tick: int, _vehicle: int, output: TickOutput) -> None:
        solved[output.status.qp is not QpStatus.FALLBACK] += 1
        tactics.add(output.status.tactic)

    observed(scene.mission, 2, observe, duration_s=JOINING_S)
    assert solved[False] < 0.005 * solved[True]
    assert Tactic.ASIDE not in tactics
