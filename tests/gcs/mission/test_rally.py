"""Rally points of a mission: where each vehicle's spots are, and what is refused."""

import pytest

from tests.support.mission_text import Content, changed, faults, parsed

# case2: starts at x = 0, y = 4, 0 and -4.
FENCE = [[-30.0, -30.0], [200.0, -30.0], [200.0, 60.0], [-30.0, 60.0]]
ZONE = {"name": "mast", "center_m": [30.0, 40.0], "radius_m": 5.0}


def rally(*places: list[float], names: tuple[str, ...] = ("a", "b", "c")) -> Content:
    points = [{"name": name, "place_m": place} for name, place in zip(names, places, strict=False)]
    return changed({("safety", "rally"): points, ("safety", "fence_m"): FENCE, ("safety", "no_fly"): [ZONE]})


def test_every_vehicle_has_spots_as_starts_lie_about_their_middle() -> None:
    mission = parsed(rally([10.0, 30.0], [-20.0, -20.0]))
    spots = {each.id: mission.agent_config(each).rally_m for each in mission.vehicles}
    assert spots == {
        1: ((10.0, 34.0), (-20.0, -16.0)),
        2: ((10.0, 30.0), (-20.0, -20.0)),
        3: ((10.0, 26.0), (-20.0, -24.0)),
    }
    config = mission.agent_config(mission.vehicle(1))
    assert config.landing_places_m == ((0.0, 4.0), *spots[1])


def test_the_identity_of_a_mission_without_rally_points_is_that_of_before_there_were_any() -> None:
    points: list[object] = [{"name": "a", "place_m": [-20.0, 0.0]}]
    plain, without, with_one = (
        parsed(changed({("safety", "rally"): each} if each is not None else {})).identity for each in (None, [], points)
    )
    assert plain == without != with_one


@pytest.mark.parametrize(
    ("mission", "place", "words"),
    [
        (rally([10.0, 57.0]), "safety.rally[0].place_m", ("vehicle 1 at 'a'", "(10, 61)", "outside of its fence")),
        (rally([30.0, 30.5]), "safety.rally[0].place_m", ("vehicle 1 at 'a'", "(30, 34.5)", "'mast'")),
        (rally([1.0, 0.0]), "safety.rally[0].place_m", ("vehicle 1 at 'a'", "1.00 m", "start of vehicle 1")),
        (rally([10.0, 20.0], [10.0, 24.5]), "safety.rally[1].place_m", ("at 'b'", "0.50 m", "at 'a'")),
        (rally([10.0, 20.0], [60.0, 20.0], names=("a", "a")), "safety.rally[1].name", ("'a'",)),
        (rally([float("inf"), 20.0]), "safety.rally[0].place_m[0]", ("inf",)),
    ],
)
def test_a_rally_point_where_a_vehicle_cannot_land_is_refused(
    mission: Content, place: str, words: tuple[str, ...]
) -> None:
    fault = faults(mission)[0]
    assert fault.startswith(f"{place}: ")
    assert all(word in fault for word in words), fault
