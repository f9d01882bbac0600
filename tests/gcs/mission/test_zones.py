"""No-fly zones in a mission: what is read, what is refused."""

from typing import Any

import pytest

from gcs.mission.mission import Mission
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
