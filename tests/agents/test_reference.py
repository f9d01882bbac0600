"""What the positions of a vehicle refer to changes in flight: what its core sends, answers and notes."""

from collections.abc import Callable
from math import dist

import numpy as np
import pytest
from msgspec.structs import replace

from agents.inputs import AutopilotStatus, Command
from agents.notes import Note, ReferenceChange
from agents.outputs import TickOutput
from agents.ports import Reference, VehicleStatus
from agents.safety.failsafe import Condition
from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from agents.team.messages import OperatorCommand
from tests.agents.test_core import PERIOD_S, Pilot, member, setpoint_of, states_of, telemetry
from tests.support.team import a_team

Maker = Callable[..., AgentConfig]

BEFORE_S = 5.0
JUMP_M = np.array([7.0, -4.0, 0.0, 0.0])
JUMPED = Reference(jumps=1, jumped_m=(7.0, 4.0, 0.0))
READ_AGAIN = "the origin of its positions is being read again"


class Referring(Pilot):
    """Flies in formation; `refers` is what its link reports of its reference."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        self.fly_with(Reference(), BEFORE_S)
        assert self.core.tactic is Tactic.FORMATION

    def fly_with(self, reference: Reference, duration_s: float) -> list[TickOutput]:
        outputs, end_s = [], self.now_s + duration_s
        while self.now_s < end_s - 1e-9:
            self.core.take(telemetry(self.now_s, self.motion.tolist()))  # a link delivers it before it reports a change
            self.core.take(AutopilotStatus(VehicleStatus(connected=True, armed=True, reference=reference)))
            outputs += self.fly(self.now_s + PERIOD_S)
        return outputs

    def resume(self, number: int) -> None:
        self.core.take(Command(self.now_s, OperatorCommand(self.now_s, "resume", None, "pat", number)))


@pytest.fixture
def pilot(make_config: Maker) -> Referring:
    return Referring(make_config())


def notes(outputs: list[TickOutput]) -> list[Note]:
    return [note for output in outputs for note in output.status.notes]


def test_no_aim_leads_from_the_place_before_a_jump_to_the_one_after_it(pilot: Referring) -> None:
    pilot.motion += JUMP_M
    there_m = tuple(pilot.motion[:2].tolist())
    outputs = pilot.fly_with(JUMPED, 3.0)
    # A vehicle at rest at a0 = 0.8 1/s2 moves by a third of the distance to its aim in the first second.
    assert max(dist(setpoint_of(output), there_m) for output in outputs) < 0.5
    assert dist(pilot.motion[:2].tolist(), there_m) < 0.5
    assert {output.status.tactic for output in outputs} == {Tactic.HOLD}
    state = states_of(outputs[0])[0]
    assert (state.alert, state.tactic) == (Condition.ESTIMATOR_JUMPED.value, Tactic.HOLD.value)
    assert dist(state.position_m, there_m) < 0.5
    (note,) = [each for each in notes(outputs) if each.reference is not None]
    assert note.reference == ReferenceChange("position jumped", 7.0, 4.0, 0.0)
    # A vehicle that holds does so where it is, when its position jumps back.
    pilot.motion -= JUMP_M
    back_m = tuple(pilot.motion[:2].tolist())
    outputs = pilot.fly_with(Reference(jumps=2, jumped_m=(-7.0, -4.0, 0.0)), 3.0)
    assert max(dist(setpoint_of(output), back_m) for output in outputs) < 0.5


def test_resume_is_refused_while_the_origin_is_read_again(pilot: Referring) -> None:
    moved = Reference(moves=1, moved_m=(0.0, 8.0, -2.0))
    outputs = pilot.fly_with(moved, 1.0)
    assert {output.status.tactic for output in outputs} == {Tactic.HOLD}
    assert pilot.core.alert == Condition.ORIGIN_MOVED.value
    (note,) = [each for each in notes(outputs) if each.reference is not None]
    assert note.reference == ReferenceChange("origin moved", 0.0, 8.0, -2.0)
    pilot.resume(1)
    (refused,) = [each for each in notes(pilot.fly_with(moved, PERIOD_S)) if each.kind == "command"]
    assert refused.command is not None
    assert refused.command.is_refused
    assert note.reference.by in refused.command.did
    pilot.fly_with(moved, 10.0)
    pilot.fly_with(Reference(is_known=False, moves=1), PERIOD_S)
    pilot.resume(2)
    (refused,) = [each for each in notes(pilot.fly_with(moved, PERIOD_S)) if each.kind == "command"]
    assert refused.command is not None
    assert READ_AGAIN in refused.command.did
    assert {output.status.tactic for output in pilot.fly_with(moved, PERIOD_S)} == {Tactic.HOLD}
    pilot.resume(3)
    pilot.fly_with(moved, PERIOD_S)
    assert pilot.core.tactic is Tactic.FORMATION


def test_what_changed_before_the_flight_is_no_event(make_config: Maker) -> None:
    pilot = Pilot(make_config())
    pilot.core.take(AutopilotStatus(VehicleStatus(reference=Reference(moves=2, jumps=3))))
    assert not [each for each in notes(pilot.fly(2.0)) if each.kind == "failsafe"]
    assert pilot.core.alert == ""


@pytest.mark.parametrize("alert", [Condition.ESTIMATOR_JUMPED, Condition.ORIGIN_MOVED])
def test_peers_keep_clear_of_both_places_of_a_vehicle_whose_position_has_changed(alert: Condition) -> None:
    team = a_team()
    here, there = member(1, 5.0, 0.0, 0.0), member(1, 5.1, 7.0, -4.0)
    team.receive(here)
    team.receive(replace(there, tactic=Tactic.HOLD.value, alert=alert.value))
    assert [each.position_m for each in team.near()] == [there.position_m]
    assert [each.position_m for each in team.lost(5.2, 60.0)] == [here.position_m]
    assert not team.inconsistencies
