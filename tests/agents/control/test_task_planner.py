"""The seam for plug-in planners: when they are asked, what becomes of their plans, and who plans else."""

from collections.abc import Callable
from functools import partial
from math import hypot, nan

import numpy as np
import pytest

from agents.control.aims import resting
from agents.control.plan import Plan, PlannerError
from agents.inputs import Message, TacticEvent
from agents.outputs import CoreStatus, TickOutput
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.situation.task import Task
from agents.tactics import Event, Tactic
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Vector
from tests.agents.test_core import PERIOD_S, Pilot, member, sighting

Maker = Callable[..., AgentConfig]

TRUE_PLANT = Plant(PlantAxis(0.9, 0.8), PlantAxis(0.7, 1.0))


class Recorded:
    """Plans what `plan` returns for a task, and keeps the tasks."""

    def __init__(self, plan: Callable[[Task], Plan | None]) -> None:
        self.tasks: list[Task] = []
        self._plan = plan

    def plan(self, task: Task) -> Plan | None:
        self.tasks.append(task)
        return self._plan(task)


class Flight(Pilot):
    """A core with a planner in front, on a plant that is not the one of its configuration."""

    def __init__(self, config: AgentConfig, planner: Recorded, start_m: tuple[float, float] = (0.0, 0.0)) -> None:
        super().__init__(config, motion=(*start_m, 0.0, 0.0), planner=lambda _: planner, plant=TRUE_PLANT)

    def fly_on(self, seconds: float, sees_m: tuple[float, float] | None = None) -> list[TickOutput]:
        outputs, end_s = [], self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            if sees_m is not None:
                self.core.take(sighting(self.now_s, *sees_m))
            outputs += self.fly(self.now_s + PERIOD_S)
        return outputs


def ahead(task: Task) -> Plan:
    """Fly along x: aim two metres ahead of where the vehicle is."""
    return resting(ahead_m(task.situation))


def from_1_s(plan: Plan, task: Task) -> Plan | None:
    return plan if task.situation.now_s > 0.95 else None


def ahead_m(situation: Situation) -> Vector:
    return np.asarray(situation.acting_motion[:2] + np.array([2.0, 0.0]), dtype=np.float64)


def reference_rad(status: CoreStatus) -> float:
    assert status.plan is not None
    assert status.plan.ring is not None
    assert status.plan.ring.reference is not None
    return status.plan.ring.reference.place.value


def test_the_planner_is_asked_for_mission_tactics_only_and_its_aim_is_sent(make_config: Maker) -> None:
    planner = Recorded(ahead)
    flight = Flight(make_config(), planner)
    outputs = flight.fly_on(5.0)
    assert {task.tactic for task in planner.tasks} == {Tactic.FORMATION}
    assert flight.motion[0] > 3.0, "cordon's own planner flies 1 m in that time"
    for output in outputs[-10:]:
        assert output.status.plan is not None
        assert output.status.situation is not None
        assert output.status.plan.aim_m == pytest.approx(ahead_m(output.status.situation))
    asked = len(planner.tasks)
    for event in (Event.HOLD, Event.LAND):
        flight.core.take(TacticEvent(event))
        flight.fly_on(2.0)
    assert flight.core.tactic is Tactic.LAND
    assert len(planner.tasks) == asked


def test_a_planner_knows_its_peers(make_config: Maker) -> None:
    planner = Recorded(ahead)
    flight = Flight(make_config(), planner)
    flight.core.take(Message(0.0, member(1, 0.0, 0.0, 5.0)))
    flight.fly_on(0.5)
    assert [peer.position_m for peer in planner.tasks[-1].peers] == [(0.0, 5.0)]


def test_on_the_ring_a_plan_without_a_report_is_reported_as_a_place_on_it(make_config: Maker) -> None:
    flight = Flight(make_config(), Recorded(lambda _: resting(np.array([10.0, 0.0]))), (10.0, 0.0))
    last = flight.fly_on(8.0, sees_m=(0.0, 0.0))[-1].status
    assert last.tactic is Tactic.ENCIRCLE
    assert last.place is not None
    assert last.place.members == 1
    assert last.ring_rate_rad_s == 0.05
    assert reference_rad(last) == pytest.approx(0.0, abs=0.05)


def test_cordon_takes_over_on_the_ring_from_where_the_planner_has_brought_the_vehicle(make_config: Maker) -> None:
    """The planner stands still for 20 s, while the reference from before goes on around the ring."""
    stood_m = np.array([10.0, 0.0])
    planner = Recorded(lambda task: resting(stood_m) if 8.0 < task.situation.now_s < 28.0 else None)
    flight = Flight(make_config(), planner, (10.0, 0.0))
    flight.fly_on(28.0, sees_m=(0.0, 0.0))
    assert hypot(*(flight.motion[:2] - stood_m)) < 1.0
    after = flight.fly_on(40.0, sees_m=(0.0, 0.0))
    assert reference_rad(after[0].status) == pytest.approx(0.0, abs=0.02)
    motions = [output.status.motion for output in after if output.status.motion is not None]
    assert max(abs(hypot(*motion[:2]) - 10.0) for motion in motions[-100:]) < 0.3
    assert after[-1].status.polar is not None
    assert after[-1].status.polar.angular_rate_rad_s == pytest.approx(0.05, abs=0.005)


def test_a_plan_that_is_not_finite_ends_the_flight_and_names_vehicle_and_time(make_config: Maker) -> None:
    place_m = np.array([1.0, 2.0])
    for name, plan in (
        ("aim_m", resting(np.array([nan, 0.0]))),
        ("aim_m", resting(np.zeros(3))),
        ("undisturbed_aim_m", Plan(place_m, np.array([0.0, nan]), np.zeros(2))),
        ("aim_rate_m_s", Plan(place_m, place_m, np.array([nan, 0.0]))),
        ("velocity_m_s", Plan(place_m, place_m, np.zeros(2), velocity_m_s=(0.0, nan))),
    ):
        flight = Flight(make_config(), Recorded(partial(from_1_s, plan)))
        with pytest.raises(PlannerError, match=rf"vehicle 2, 1\.0 s: {name}"):
            flight.fly_on(2.0)
