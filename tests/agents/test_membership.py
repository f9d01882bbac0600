"""Members that come, go and come back, in closed loop.

`python -m tests.experiments.membership 50` flies many more seeds.
"""

from dataclasses import replace

import numpy as np
import pytest

from estimation.state import POSITION
from tests.experiments.membership import formation_settled_s, measured, separation_left_m
from tests.experiments.membership_scenes import SCENES, Scene, flown
from tests.experiments.random_joins import BACKWARDS_M_S, BOUND_SHARE, OVERSHOOT_DEG, drawn, judged, recorded
from tests.support.mission_text import content, parsed

LINE_OF_TWO = 3
"""A seed of one alone in formation, and another one that comes."""
TRUE_SCALES = ((0.92, 1.06), (1.08, 0.95), (0.95, 0.92), (1.04, 1.08), (0.97, 1.03), (1.0, 0.93))
"""By how much true plants differ from their models."""


def test_the_ring_opens_for_one_more() -> None:
    assert_settles_without_overtaking("2 -> 3 on the ring", 0)


def test_the_ring_closes_behind_one_whose_radio_fails_and_who_gets_out_of_the_others_way() -> None:
    assert_settles_without_overtaking("cut off on the ring", 108)


def assert_settles_without_overtaking(name: str, seed: int) -> None:
    build, in_formation, limit_s = SCENES[name]
    draw = measured(build, in_formation, seed)
    assert draw.settled_s <= limit_s
    assert draw.separation_left_m >= 0.0
    assert draw.overtakings == 0
    assert draw.innermost_share >= 0.75  # nobody cuts across


@pytest.mark.parametrize(
    ("count", "apart_m", "away_m", "ring_m", "rate_rad_s", "limit_s"),
    [(4, 8.0, (25.0, 0.0), 12.0, -0.08, 30.0), (6, 6.0, (40.0, 10.0), 14.0, 0.07, 42.0)],
)
def test_vehicles_that_engage_at_once_from_one_side_fly_to_even_places(
    count: int, apart_m: float, away_m: tuple[float, float], ring_m: float, rate_rad_s: float, limit_s: float
) -> None:
    scene = all_from_one_side(count, apart_m, away_m, ring_m, rate_rad_s)
    joined = judged(0, scene, *recorded(scene, 0))
    assert joined.worst.at_s == 0.0
    assert joined.worst.took_s is not None
    assert joined.worst.took_s <= limit_s
    assert joined.overshoot_deg <= OVERSHOOT_DEG
    assert joined.speed_share <= BOUND_SHARE
    assert joined.acceleration_share <= BOUND_SHARE
    assert joined.forwards_m_s >= BACKWARDS_M_S
    assert joined.separation_left_m >= 0.0
    assert joined.never_engaged == ()


@pytest.mark.parametrize(
    ("seed", "until_s"),
    [pytest.param(88041, 30.0, id="one comes in beside one on the ring"), pytest.param(9377, 130.0, id="one was lost")],
)
def test_vehicles_on_the_ring_keep_their_bounds_beside_others(seed: int, until_s: float) -> None:
    """The ring drifts over the place of the lost one, with a target of 0.9 m/s."""
    scene = replace(drawn(seed), duration_s=until_s)
    joined = judged(seed, scene, *recorded(scene, seed))
    assert joined.acceleration_share <= BOUND_SHARE
    assert joined.speed_share <= BOUND_SHARE
    assert joined.forwards_m_s >= BACKWARDS_M_S
    assert joined.separation_left_m >= 0.0


def all_from_one_side(
    count: int, apart_m: float, away_m: tuple[float, float], ring_m: float, rate_rad_s: float
) -> Scene:
    """Vehicles abreast, with plants up to 8 % off their models, which engage at once a target that is far away."""
    mission = content()
    mission["encirclement"] |= {"radius_m": ring_m, "angular_rate_rad_s": rate_rad_s}
    mission["decision"]["distance_max_m"] = mission["target"]["sensor"]["range_m"] = 200.0
    mission["target"] |= {"start_m": list(away_m), "velocity_m_s": [0.1, 0.05]}
    mission["network"] = {"delay_s": 0.05}
    mission["formation"]["spacing_m"] = apart_m
    mission["vehicles"] = [
        {
            "id": slot + 1,
            "url": f"udpin://127.0.0.1:{14540 + slot}",
            "endpoint": f"tcp/127.0.0.1:{7461 + slot}",
            "true_scale": {"a0": a0, "a1": a1},
            "start_m": [0.0, ((count - 1) / 2.0 - slot) * apart_m],
        }
        for slot, (a0, a1) in enumerate(TRUE_SCALES[:count])
    ]
    return Scene(parsed(mission), (), 60.0, 0.0)


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
