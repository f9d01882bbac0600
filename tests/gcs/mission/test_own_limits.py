"""Vehicles with a fence and altitude limits of their own: what is refused, and what they fly with it."""

import numpy as np
import pytest

from agents.safety.guard import Guard
from agents.setpoint import Altitude
from agents.tactics import Tactic
from estimation.state import Sighting
from gcs.flight.simulated import fly_simulated
from gcs.mission.file import MissionError, excitation_mission
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade
from gcs.preflight.mission import highest_m
from gcs.preflight.preflight import preflight
from tests.support.mission_text import changed, faults, parsed

Changes = dict[tuple[str | int, ...], object]

# case2: starts at x = 0, y = 4, 0 and -4, all at 8 m; the target goes from (35, -5) to (95, -5) within a ring of 10 m.
WIDE: list[list[float]] = [[-5.0, -20.0], [110.0, -20.0], [110.0, 10.0], [-5.0, 10.0]]
WALL_X_M = 6.0
NOTCHED = [*WIDE[:3], [WALL_X_M + 1.0, 10.0], [WALL_X_M, 2.5], [WALL_X_M, 10.0], WIDE[3]]
"""A wall down to y = 2.5 in the way of vehicle 1 alone."""
FOLLOWS: Changes = {
    ("encirclement", "altitude"): "target",
    ("encirclement", "altitude_offset_m"): 6.0,
    ("target", "altitude_m"): 3.0,
}


def own(index: int, **limits: object) -> Changes:
    return {("vehicles", index, key): value for key, value in limits.items()}


def team(**limits: object) -> Changes:
    return {("safety", key): value for key, value in limits.items()}


REFUSED: dict[str, tuple[Changes, list[str]]] = {
    "against the team's": (
        team(altitude_max_m=10.0) | own(2, altitude_min_m=12.0),
        ["vehicles[2].altitude_min_m: 12.0 m is not below safety.altitude_max_m = 10.0 m"],
    ),
    "flies above its own": (
        team(altitude_max_m=20.0) | own(0, altitude_max_m=7.0),
        ["vehicles[0].altitude_m: 8.0 m is above vehicles[0].altitude_max_m = 7.0 m"],
    ),
    # Vehicle 3 lands first, in the lowest layer of 10 m, and takes off to that of 12 m.
    "follows the target out of it": (
        FOLLOWS | team(altitude_min_m=3.0, altitude_max_m=30.0) | own(1, altitude_max_m=8.5),
        [
            "encirclement.altitude_offset_m: 6.0 m above target.altitude_m = 3.0 m vehicles[1] flies at 9 m, not "
            "between safety.altitude_min_m = 3.0 m and vehicles[1].altitude_max_m = 8.5 m"
        ],
    ),
    "one that follows has no limit": (
        FOLLOWS | own(0, altitude_min_m=3.0, altitude_max_m=30.0) | own(1, altitude_min_m=3.0, altitude_max_m=30.0),
        [
            f'safety.{key}: this key is missing; encirclement.altitude = "target" needs it'
            for key in ("altitude_min_m", "altitude_max_m")
        ],
    ),
    "no fence is no fence of its own": (
        team(fence_m=WIDE) | own(1, fence_m=[]),
        ["vehicles[1].fence_m: a fence needs at least 3 corners (given: 0)"],
    ),
    "starts outside of its own": (
        team(fence_m=WIDE) | own(0, fence_m=[[0.5, -20.0], [110.0, -20.0], [110.0, 10.0], [0.5, 10.0]]),
        ["vehicles[0].start_m: (0, 4) is 0.50 m outside of vehicles[0].fence_m"],
    ),
    "the ring leaves its own": (
        own(2, fence_m=[[-5.0, -20.0], [104.0, -20.0], [104.0, 10.0], [-5.0, 10.0]]),
        [
            "vehicles[2].fence_m: the ring of 10.0 m around it is 0.10 m outside, with the target at (94.0955, -5) "
            "after 591 s"
        ],
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_own_limits_that_contradict_are_refused(name: str) -> None:
    changes, expected = REFUSED[name]
    assert faults(changed(changes)) == expected


def test_every_agent_has_its_own_limits_and_the_teams_for_the_others() -> None:
    limits = team(altitude_min_m=2.0, altitude_max_m=20.0, fence_m=WIDE)
    mission = parsed(changed(limits | own(0, fence_m=NOTCHED) | own(1, altitude_max_m=9.0)))
    found = [mission.agent_config(vehicle).safety for vehicle in mission.vehicles]
    assert [each.altitude_max_m for each in found] == [20.0, 9.0, 20.0]
    assert [each.altitude_min_m for each in found] == [2.0] * 3
    assert [len(each.fence_m) for each in found] == [7, 4, 4]
    assert found[2] == mission.safety
    guards = [Guard(mission.agent_config(vehicle)) for vehicle in mission.vehicles]
    assert [guard.altitude_m(50.0, np.zeros(4), 8.0) for guard in guards] == [20.0, 9.0, 20.0]


def test_the_team_stops_where_the_limit_of_one_stops_it() -> None:
    """The heights between vehicles stay: one that alone stopped at its limit would meet the next one's height."""
    changes = FOLLOWS | team(altitude_min_m=3.0, altitude_max_m=30.0) | own(1, altitude_m=11.0, altitude_max_m=15.0)
    mission = parsed(changed(changes | own(2, altitude_m=14.0)))
    heights_m = []
    for vehicle in mission.vehicles:
        altitude = Altitude(mission.agent_config(vehicle))
        altitude.sight(Sighting(1.0, 1, (9.0, 0.0), (0.1, 0.0, 0.1), 0.8, 0.2, 20.0, 0.5))
        heights_m.append([altitude.next(Tactic.ENCIRCLE, vehicle.section.altitude_m)[0] for _ in range(600)][-1])
    assert heights_m == pytest.approx([12.0, 15.0, 18.0])


def passed_m(mission: Mission) -> dict[int, float]:
    record = fly_simulated(mission, 0, 45.0, lambda _: None)
    return {track.vehicle_id: float(track.position_m[:, 0].max()) for track in record.vehicles}


def test_a_vehicle_stops_at_its_own_fence_and_the_others_fly_on() -> None:
    flown_m = passed_m(parsed(changed(team(fence_m=WIDE) | own(0, fence_m=NOTCHED))))
    assert WALL_X_M - 0.5 < flown_m[1] < WALL_X_M
    assert min(flown_m[2], flown_m[3]) > WALL_X_M + 1.0


def test_the_preflight_checks_each_vehicle_against_its_own_limits() -> None:
    def fence(changes: Changes) -> Finding:
        (found,) = (each for each in preflight(parsed(changed(changes)), ()) if each.check == "mission fence")
        return found

    fences = own(0, fence_m=WIDE) | own(2, fence_m=WIDE)
    assert fence(fences).grade is Grade.WARNING
    assert fence(fences).found.endswith(": 2")
    assert fence(fences | own(1, fence_m=WIDE)).grade is Grade.PASS
    high = parsed(changed(FOLLOWS | team(altitude_min_m=3.0, altitude_max_m=30.0) | own(1, altitude_max_m=50.0)))
    assert [highest_m(high, vehicle) for vehicle in high.vehicles] == [30.0, 50.0, 30.0]


def test_a_flight_for_identification_stays_in_the_vehicles_own_fence() -> None:
    # The box ends at y = 9, and 2 m are kept free around the start: the team's fence is at y = 10, its own at y = 5.
    near = [[-5.0, -20.0], [110.0, -20.0], [110.0, 10.0], [60.0, 10.0], [20.0, 5.0], [-5.0, 5.0]]
    own_fence = team(fence_m=WIDE) | own(0, fence_m=near)
    with pytest.raises(MissionError, match=r"vehicles\[0\]\.fence_m"):
        excitation_mission(parsed(changed(own_fence)), 1)
    small: Changes = {("excitation", "half_width_m"): 1.0, ("excitation", "speed_max_m_s"): 1.0}
    alone = excitation_mission(parsed(changed(own_fence | small)), 1)
    assert max(y for _, y in alone.agent_config(alone.vehicles[0]).safety.fence_m) == pytest.approx(5.0)
