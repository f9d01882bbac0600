"""Members that come, go and come back, in closed loop.

`python -m tests.experiments.membership 50` flies many more seeds.
"""

import numpy as np
import pytest

from estimation.state import POSITION
from tests.experiments.membership import formation_settled_s, measured, separation_left_m
from tests.experiments.membership_scenes import SCENES, flown

LINE_OF_TWO = 3
"""A seed of one alone in formation, and another one that comes."""


@pytest.mark.parametrize(("name", "seed"), [("3 -> 2 on the ring", 1), ("2 -> 3 on the ring", 0)])
def test_the_ring_closes_and_opens(name: str, seed: int) -> None:
    build, in_formation, limit_s = SCENES[name]
    draw = measured(build, in_formation, seed)
    assert draw.settled_s <= limit_s
    assert draw.separation_left_m >= 0.0
    assert draw.overtakings == 0
    assert draw.innermost_share >= 0.75  # nobody cuts across


def test_one_alone_flies_its_line_and_another_one_joins_it() -> None:
    build, _, limit_s = SCENES["one more in formation"]
    scene = build(LINE_OF_TWO)
    flight = flown(scene, LINE_OF_TWO)
    (comer,) = scene.absences
    (alone,) = (vehicle for vehicle in scene.mission.vehicles if vehicle.id != comer.vehicle_id)
    (x, y), time_s = alone.section.start_m, flight.time_s
    line_m = np.stack([x + scene.mission.formation.speed_m_s * time_s, np.full(time_s.size, y)], axis=1)
    off_m = np.linalg.norm(flight.motion[:, scene.mission.ids.index(alone.id), POSITION] - line_m, axis=1)
    assert off_m[time_s >= 15.0].max() <= 0.2, "nobody who joins disturbs it"
    settled_s, _ = formation_settled_s(scene, flight, np.ones(2, dtype=np.bool_))
    assert settled_s <= limit_s
    assert separation_left_m(scene, flight) >= 0.0


def test_a_returning_leader_does_not_disturb_the_others() -> None:
    build, in_formation, _ = SCENES["leader back in formation"]
    draw = measured(build, in_formation, 2)  # comes from the side, from beyond the end of the line
    assert draw.settled_s <= 25.0
    assert draw.separation_left_m >= 0.0


def test_a_slow_formation_stays_in_line_beside_a_leader_that_is_lost() -> None:
    build, in_formation, _ = SCENES["leader lost in formation"]
    draw = measured(build, in_formation, 31)  # 0.17 m/s: the others are beside the lost one for twenty seconds
    assert draw.settled_s == 0.0
    assert draw.separation_left_m >= 0.0


def test_one_whose_radio_fails_gets_out_of_the_others_way() -> None:
    build, in_formation, limit_s = SCENES["cut off on the ring"]
    draw = measured(build, in_formation, 108)
    assert draw.settled_s <= limit_s
    assert draw.separation_left_m >= 0.0
