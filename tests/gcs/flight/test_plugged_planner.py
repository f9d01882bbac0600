"""Simulated flights with a plug-in planner."""

from itertools import combinations

import numpy as np
import pytest

from agents.control.aims import resting
from agents.control.plan import Plan
from agents.situation.task import Task
from gcs.errors import InputError
from gcs.flight.simulated import fly_simulated
from gcs.mission.file import load_mission

MEETING_M = np.array([6.0, 0.0])


class Silent:
    """Never has a plan."""

    def plan(self, task: Task) -> Plan | None:
        return None


class Meeting:
    """Sends every vehicle to one place."""

    def plan(self, task: Task) -> Plan | None:
        return resting(MEETING_M)


class Faulty:
    """Fails after a second."""

    def plan(self, task: Task) -> Plan | None:
        if task.situation.now_s > 1.0:
            raise ZeroDivisionError("no plan")
        return None


def test_a_planner_without_plans_leaves_a_flight_as_it_is_bit_for_bit() -> None:
    mission = load_mission("case2-field", {"target.start_m": [13.0, -5.0]})
    plain = fly_simulated(mission, 3, 25.0, lambda _: None)
    plugged = fly_simulated(mission, 3, 25.0, lambda _: None, planner=lambda _: Silent())
    assert {tactic for track in plain.vehicles for tactic in track.tactic} == {"formation", "encircle"}
    for before, after in zip(plain.vehicles, plugged.vehicles, strict=True):
        assert np.array_equal(before.position_m, after.position_m)


def test_the_guard_keeps_vehicles_apart_whose_planners_send_them_to_one_place() -> None:
    mission = load_mission("case1")
    record = fly_simulated(mission, 0, 40.0, lambda _: None, planner=lambda _: Meeting())
    apart_m = [np.hypot(*(one.position_m - other.position_m).T) for one, other in combinations(record.vehicles, 2)]
    assert min(distances.min() for distances in apart_m) > mission.safety.separation_m - 0.05
    ends_m = [np.hypot(*(track.position_m[-1] - MEETING_M)) for track in record.vehicles]
    assert max(ends_m) < 1.5 * mission.safety.separation_m, "the guard is all that keeps them from the place"


def test_an_exception_of_a_planner_ends_the_simulation() -> None:
    with pytest.raises(InputError, match=r"vehicle 1, 1\.1 s: ZeroDivisionError: no plan"):
        fly_simulated(load_mission("case1"), 0, 5.0, lambda _: None, planner=lambda _: Faulty())
