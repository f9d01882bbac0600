"""No-fly zones in a mission: what is read, what is refused."""

from typing import Any

import pytest

from gcs.mission.mission import Mission
from gcs.preflight.findings import Grade
from gcs.preflight.mission import feasibility
from tests.support.mission_text import changed, faults, parsed

# case2: starts at x = 0, y = 4, 0 and -4, all at 8 m, layers of 2 m; the target starts at (35, -5), the ring has 10 m.
SQUARE = [[20.0, -20.0], [24.0, -20.0], [24.0, -16.0], [20.0, -16.0]]


def zone(**keys: object) -> dict[str, Any]:
    return changed({("safety", "no_fly"): [{"name": "mast", **keys}]})


def test_a_polygon_and_a_circle_are_read() -> None:
    circle = {"name": "tower", "center_m": [20.0, 30.0], "radius_m": 5, "floor_m": 2.0, "ceiling_m": 40.0}
    text = changed({("safety", "no_fly"): [{"name": "mast", "polygon_m": SQUARE}, circle]})
    mast, tower = parsed(text).safety.no_fly
    assert mast.polygon_m == tuple(map(tuple, SQUARE))
    assert (mast.floor_m, mast.ceiling_m, mast.center_m) == (None, None, None)
    assert (tower.center_m, tower.radius_m, tower.floor_m, tower.ceiling_m) == ((20.0, 30.0), 5.0, 2.0, 40.0)


def test_the_identity_of_a_mission_without_zones_is_that_of_before_there_were_any() -> None:
    def digest(mission: Mission) -> str:
        assert mission.identity is not None
        return mission.identity.digest

    plain = digest(parsed(changed({})))
    assert digest(parsed(changed({("safety", "no_fly"): []}))) == plain
    assert digest(parsed(zone(polygon_m=SQUARE))) != plain


REFUSED: dict[str, tuple[dict[str, object], str, tuple[str, ...]]] = {
    "crosses itself": (
        {"polygon_m": [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]]},
        "safety.no_fly[0].polygon_m",
        ("meet",),
    ),
    "two corners": ({"polygon_m": SQUARE[:2]}, "safety.no_fly[0].polygon_m", ("3", "2")),
    "equal corners": ({"polygon_m": [SQUARE[0], SQUARE[0], SQUARE[1]]}, "safety.no_fly[0].polygon_m", ("the same",)),
    "not a number": ({"center_m": [float("nan"), 0.0], "radius_m": 1.0}, "safety.no_fly[0].center_m[0]", ("nan",)),
    "no area": (
        {"polygon_m": [SQUARE[0], [22.0, -20.0], SQUARE[1], [22.0, -19.9]]},
        "safety.no_fly[0].polygon_m",
        ("'mast'", "less than 1 m²"),
    ),
    "no shape": ({}, "safety.no_fly[0]", ("polygon_m", "center_m")),
    "both shapes": (
        {"polygon_m": SQUARE, "center_m": [0.0, 60.0], "radius_m": 1.0},
        "safety.no_fly[0]",
        ("polygon_m", "center_m"),
    ),
    "half a circle": ({"center_m": [0.0, 60.0]}, "safety.no_fly[0]", ("radius_m",)),
    "upside down": ({"polygon_m": SQUARE, "floor_m": 9.0, "ceiling_m": 8.0}, "safety.no_fly[0]", ("9.0", "8.0")),
    "unknown key": ({"polygon_m": SQUARE, "height_m": 9.0}, "safety.no_fly[0].height_m", ("ceiling_m",)),
    "over a start": ({"center_m": [0.0, -6.0], "radius_m": 3.0}, "vehicles[2].start_m", ("mast", "in")),
    "at a start": ({"center_m": [0.0, -7.5], "radius_m": 3.0}, "vehicles[2].start_m", ("mast", "0.50 m")),
    "over the target": (
        {"center_m": [35.0, -6.0], "radius_m": 3.0},
        "safety.no_fly[0].center_m",
        ("mast", "target", "(35, -5)"),
    ),
    "over the whole ring": (
        {"center_m": [35.0, -6.0], "radius_m": 11.5},
        "safety.no_fly[0].center_m",
        ("mast", "whole ring"),
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_zone_that_cannot_be_is_refused(case: str) -> None:
    keys, place, words = REFUSED[case]
    (fault,) = faults(zone(**keys))
    assert fault.startswith(f"{place}: ")
    assert all(word in fault for word in words), fault


def test_two_zones_of_one_name_are_refused() -> None:
    far = {"name": "mast", "center_m": [0.0, 60.0], "radius_m": 1.0}
    (fault,) = faults(changed({("safety", "no_fly"): [far, far]}))
    assert "safety.no_fly[1].name" in fault
    assert "mast" in fault


def test_a_zone_above_or_below_all_heights_is_over_nobody() -> None:
    assert len(parsed(zone(center_m=[0.0, -4.0], radius_m=3.0, floor_m=60.0)).safety.no_fly) == 1
    assert len(parsed(zone(center_m=[35.0, -5.0], radius_m=30.0, floor_m=60.0)).safety.no_fly) == 1


AT_REST: dict[tuple[str | int, ...], Any] = {
    ("target", "velocity_m_s"): [0.0, 0.0],
    ("encirclement", "angular_rate_rad_s"): 0.1,
}


def at_rest(**safety: object) -> dict[str, Any]:
    return changed(AT_REST | {("safety", key): value for key, value in safety.items()})


def test_a_ring_that_cannot_bend_is_refused_unless_its_target_moves() -> None:
    """Inside of the wall is the keep-out disc, outside the ring would be 47 m away, at 4.7 m/s."""
    wall = {"name": "wall", "polygon_m": [[40.0, -6.0], [80.0, -6.0], [80.0, -4.0], [40.0, -4.0]]}
    (fault,) = faults(at_rest(no_fly=[wall], keep_out_m=6.0))
    assert fault.startswith("safety.no_fly: the ring of 10.0 m")
    assert "'wall'" in fault
    assert len(parsed(changed({("safety", "no_fly"): [wall], ("safety", "keep_out_m"): 6.0})).safety.no_fly) == 1
    assert len(parsed(at_rest(no_fly=[wall | {"floor_m": 60.0}], keep_out_m=6.0)).safety.no_fly) == 1


def test_a_ring_to_which_no_way_leads_is_refused() -> None:
    fence = [[-5.0, -30.0], [60.0, -30.0], [60.0, 20.0], [-5.0, 20.0]]
    across = {"name": "across", "polygon_m": [[14.0, -40.0], [16.0, -40.0], [16.0, 19.5], [14.0, 19.5]]}
    found = faults(at_rest(no_fly=[across], fence_m=fence))
    assert [each.partition(":")[0] for each in found] == [f"vehicles[{i}].start_m" for i in range(3)]
    assert all("no way" in each and "'across'" in each for each in found)
    # With more room in the fence there is one.
    wider = [[-5.0, -30.0], [60.0, -30.0], [60.0, 24.0], [-5.0, 24.0]]
    assert len(parsed(at_rest(no_fly=[across], fence_m=wider)).safety.no_fly) == 1


def test_check_warns_where_no_ring_can_be_flown_about_a_target_that_moves() -> None:
    """It moves along x at 0.1 m/s from (35, -5): the wall across the fence lies between it and all starts."""
    fence = [[-20.0, -20.0], [120.0, -20.0], [120.0, 20.0], [-20.0, 20.0]]
    across = {"name": "across", "polygon_m": [[14.0, -30.0], [18.0, -30.0], [18.0, 30.0], [14.0, 30.0]]}
    aside = {"name": "aside", "polygon_m": [[30.0, 18.0], [60.0, 18.0], [60.0, 19.0], [30.0, 19.0]]}

    def warned(zone: dict[str, Any]) -> str:
        mission = parsed(changed({("safety", "no_fly"): [zone], ("safety", "fence_m"): fence}))
        (found,) = (each for each in feasibility(mission) if each.check == "target's path")
        return found.found if found.grade is Grade.WARNING else ""

    assert "the first at 0 s" in warned(across)
    assert warned(aside) == ""


def test_check_warns_of_zones_on_the_autopilots_straight_way_home() -> None:
    house = {"name": "house", "polygon_m": SQUARE}
    between = {"name": "between", "center_m": [16.0, -4.0], "radius_m": 1.0}
    low = {"name": "low", "center_m": [16.0, 4.0], "radius_m": 1.0, "ceiling_m": 3.0}

    def warned(*zones: dict[str, Any]) -> list[bool]:
        found = [each for each in feasibility(parsed(at_rest(no_fly=list(zones)))) if each.check == "return by itself"]
        assert [each.about for each in found] == ([1, 2, 3] if zones else [])
        assert all("between" in each.found for each in found if each.grade is Grade.WARNING)
        return [each.grade is Grade.WARNING for each in found]

    assert warned() == []
    assert warned(house | {"polygon_m": [[x, y - 60.0] for x, y in SQUARE]}, low) == [False] * 3
    assert warned(between) == [True] * 3
