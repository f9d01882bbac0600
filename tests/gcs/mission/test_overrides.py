import tomllib
from pathlib import Path

import numpy as np
import pytest

from gcs.errors import InputError
from gcs.mission.file import MissionError, load_mission, parse_mission
from gcs.mission.overrides import overridden, override
from tests.support.mission_text import CASE2


@pytest.mark.parametrize(
    ("given", "place", "value"),
    [
        ("encirclement.radius_m=12", "encirclement.radius_m", 12),
        ("vehicles[0].start_m = [1.0, 2.5]", "vehicles[0].start_m", [1.0, 2.5]),
        ("formation.shape=wedge", "formation.shape", "wedge"),
        ('mission.name="a=b"', "mission.name", "a=b"),
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


def test_a_mission_is_checked_with_its_values() -> None:
    assert load_mission("case2", {"encirclement.radius_m": 12}).encirclement.radius_m == 12.0
    with pytest.raises(MissionError) as raised:
        load_mission("case2", {"encirclement.radius": 12, "mission.rate_hz": -1})
    assert {fault.partition(":")[0] for fault in raised.value.faults} == {"encirclement.radius", "mission.rate_hz"}


@pytest.mark.parametrize(
    ("place", "names"),
    [
        ("", "not the path"),
        ("encirclement..radius_m", "not the path"),
        ("vehicles[7].id", "[7]"),
        ("vehicles.id", "id"),
        ("nothing[0].id", "nothing"),
        ("mission.name.first", "first"),
        (".".join("a" * 40), "not the path"),
    ],
)
def test_a_place_that_cannot_be_is_named(place: str, names: str) -> None:
    with pytest.raises(InputError) as raised:
        overridden(CASE2, {place: 1})
    (fault,) = raised.value.placed
    assert fault.place == place
    assert names in fault.reason


# Mission.replace


def test_keys_are_replaced_by_section_and_by_vehicle() -> None:
    mission = load_mission("case2")
    changed = mission.replace(
        encirclement={"radius_m": np.float64(12.0)},
        target={"sensor": {"range_m": np.int64(30)}, "start_m": np.array([30.0, 1.0])},
        vehicles={3: {"start_m": (0.0, -6.0)}},
    )
    assert changed.encirclement.radius_m == 12.0
    assert changed.encirclement.angular_rate_rad_s == mission.encirclement.angular_rate_rad_s
    assert (changed.target.sensor.range_m, changed.target.sensor.rate_hz) == (30.0, mission.target.sensor.rate_hz)
    assert changed.target.start_m == (30.0, 1.0)
    assert [vehicle.section.start_m for vehicle in changed.vehicles] == [(0.0, 4.0), (0.0, 0.0), (0.0, -6.0)]
    assert mission.encirclement.radius_m == 10.0
    assert parse_mission(changed.text, None, changed.profile_texts) == changed


def test_profiles_beside_the_mission_are_found_after_it_was_changed(tmp_path: Path) -> None:
    for name, a0 in (("own.toml", 0.6), ("heavy.toml", 0.3)):
        (tmp_path / name).write_text(f"[x]\na0_per_s2 = {a0}\na1_per_s = 0.9\n[y]\na0_per_s2 = {a0}\na1_per_s = 0.9\n")
    text = CASE2.replace("id = 1\n", 'id = 1\nprofile = "own.toml"\n')
    (tmp_path / "mission.toml").write_text(text)
    mission = load_mission(str(tmp_path / "mission.toml"))
    (tmp_path / "own.toml").unlink()
    changed = mission.replace(vehicles={2: {"profile": "heavy.toml"}})
    assert [vehicle.plant.x.a0_per_s2 for vehicle in changed.vehicles[:2]] == [0.6, 0.3]


@pytest.mark.parametrize(
    ("sections", "places"),
    [
        ({"encirclement": {"radius": 12.0}, "mission": {"rate_hz": -1.0}}, ("encirclement.radius", "mission.rate_hz")),
        ({"vehicles": {9: {"altitude_m": 8.0}}}, ("vehicles",)),
        ({"encirclement": 12.0}, ("encirclement",)),
        (
            {"encirclement": {"radius_m": None}, "target": {"legs": [{"to_m": object()}]}},
            ("encirclement.radius_m", "target.legs"),
        ),
    ],
)
def test_what_cannot_be_replaced_is_named(sections: dict[str, object], places: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as raised:
        load_mission("case2").replace(**sections)
    assert tuple(sorted(fault.partition(":")[0] for fault in raised.value.faults)) == places
