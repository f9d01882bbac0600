import tomllib

import pytest

from gcs.errors import InputError
from gcs.mission.file import MissionError, load_mission
from gcs.mission.overrides import overridden, override
from tests.support.mission_text import CASE2


@pytest.mark.parametrize(
    ("given", "place", "value"),
    [
        ("encirclement.radius_m=12", "encirclement.radius_m", 12),
        ("vehicles[0].start_m = [1.0, 2.5]", "vehicles[0].start_m", [1.0, 2.5]),
        ("formation.shape=wedge", "formation.shape", "wedge"),
        ('mission.name="a=b"', "mission.name", "a=b"),
        ("frame.local=true", "frame.local", True),
        ("mission.name=", "mission.name", ""),
    ],
)
def test_a_value_is_toml_or_a_string(given: str, place: str, value: object) -> None:
    assert override(given) == (place, value)


def test_a_value_stands_in_place_of_the_files() -> None:
    text = overridden(CASE2, {"encirclement.radius_m": 12, "vehicles[1].start_m": [3.0, 4.0], "safety.separation_m": 2})
    before, after = tomllib.loads(CASE2), tomllib.loads(text)
    before["encirclement"]["radius_m"] = 12
    before["vehicles"][1]["start_m"] = [3.0, 4.0]
    before.setdefault("safety", {})["separation_m"] = 2
    assert after == before


def test_without_values_the_text_stays_as_it_is() -> None:
    assert overridden(CASE2, {}) == CASE2


def test_a_mission_is_checked_with_its_values() -> None:
    assert load_mission("case2", {"encirclement.radius_m": 12}).encirclement.radius_m == 12.0
    with pytest.raises(MissionError) as raised:
        load_mission("case2", {"encirclement.radius": 12, "mission.rate_hz": -1})
    assert {fault.partition(":")[0] for fault in raised.value.faults} == {"encirclement.radius", "mission.rate_hz"}


@pytest.mark.parametrize(
    ("place", "names"),
    [
        ("", "not the place"),
        ("encirclement..radius_m", "not the place"),
        ("vehicles[7].id", "[7]"),
        ("vehicles.id", "id"),
        ("encirclement[0]", "[0]"),
        ("nothing[0].id", "nothing"),
        ("mission.name.first", "first"),
        (".".join("a" * 40), "not the place"),
    ],
)
def test_a_place_that_cannot_be_is_named(place: str, names: str) -> None:
    with pytest.raises(InputError) as raised:
        overridden(CASE2, {place: 1})
    (fault,) = raised.value.faults
    assert fault.startswith(f"{place}: ")
    assert names in fault


def test_a_setting_without_a_value_is_refused() -> None:
    with pytest.raises(InputError, match="radius_m"):
        override("encirclement.radius_m")
