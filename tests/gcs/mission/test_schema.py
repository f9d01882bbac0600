"""The JSON Schema of missions, by a validator that knows nothing of cordon."""

import tomllib

import pytest
from jsonschema import Draft202012Validator

from gcs.mission.file import bundled_missions
from gcs.mission.sections import SECTIONS, TUNING, mission_schema
from tests.support.mission_text import Place, content, drop, put
from tests.support.paths import MISSIONS

VALIDATOR = Draft202012Validator(mission_schema())


def test_it_is_a_schema_and_all_bundled_missions_are_valid(subtests: pytest.Subtests) -> None:
    Draft202012Validator.check_schema(mission_schema())
    for name in bundled_missions():
        with subtests.test(name):
            mission = tomllib.loads((MISSIONS / f"{name}.toml").read_text(encoding="utf-8"))
            assert [error.message for error in VALIDATOR.iter_errors(mission)] == []


def test_what_no_mission_may_have_is_refused(subtests: pytest.Subtests) -> None:
    wrong = [
        *(put(content(), (name, "colour"), 1) for name in SECTIONS),
        *(put(content(), ("tuning", name, "colour"), 1) for name in TUNING),
        put(content(), ("links", "radio", "colour"), 1),
        put(content(), ("vehicles", 1, "decision", "colour"), 1),
        put(content(), ("encirclement", "radius_m"), -1.0),
        put(content(), ("vehicles", 0, "start_m"), [1.0]),
        put(content(), ("vehicles",), []),
    ]
    required: tuple[Place, ...] = (("target",), ("vehicles", 0, "start_m"))
    for number, mission in enumerate([*wrong, *(drop(content(), place) for place in required)]):
        with subtests.test(number=number):
            assert not VALIDATOR.is_valid(mission)


SEVERAL = {
    "target": {"importance": 0.9, "sensor": {"range_m": 60.0}},
    "targets": [{"name": name, "start_m": [40.0, y], "threat": 0.1} for name, y in (("north", 20.0), ("south", -20.0))],
    "encirclement": {"radius_m": 10.0},
    "rings": [{"target": name, "places": 2, "angular_rate_rad_s": 0.1} for name in ("north", "south")],
}


def test_tables_of_several_targets_and_rings_share_keys(subtests: pytest.Subtests) -> None:
    several = content() | SEVERAL
    assert VALIDATOR.is_valid(several)
    assert VALIDATOR.is_valid(drop(drop(several, ("target",)), ("encirclement",)))
    for number, wrong in enumerate(
        [
            drop(several, ("targets",)),
            drop(several, ("rings",)),
            drop(several, ("targets", 0, "name")),
            drop(several, ("rings", 1, "places")),
            put(several, ("targets", 0, "coast_s"), 1.0),
            put(several, ("targets", 0, "colour"), 1),
            put(several, ("rings", 0, "colour"), 1),
            put(several, ("rings",), []),
            put(several, ("targets",), 9 * SEVERAL["targets"]),  # type: ignore[operator]  # a list
        ]
    ):
        with subtests.test(number=number):
            assert not VALIDATOR.is_valid(wrong)


def test_addresses_of_vehicles_may_be_left_out() -> None:
    mission = drop(drop(content(), ("vehicles", 0, "url")), ("vehicles", 0, "endpoint"))
    assert VALIDATOR.is_valid(mission)
