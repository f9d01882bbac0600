"""Mission files of earlier versions: they load as they did, and every key that moved is a warning."""

from pathlib import Path

import pytest

from estimation.profile.library import ProfileLibrary
from estimation.settings import OwnFilterSettings
from gcs.mission.file import bundled_missions, load_mission
from gcs.mission.sections import TUNED, TUNING
from tests.support.mission_text import Content, content, faults, parsed, places, put
from tests.support.paths import MISSIONS

PX4_FILTER = ProfileLibrary(Path()).load("px4").own_filter


def old(*plants: str, **sections: Content) -> Content:
    """Return case 2 as an earlier version wrote it: with plants, and with these sections."""
    mission = content() | sections
    for index, plant in enumerate(plants):
        mission = put(mission, ("vehicles", index, "plant"), plant)
    return mission


def test_no_bundled_mission_has_a_warning() -> None:
    assert {name: load_mission(name).warnings for name in bundled_missions()} == dict.fromkeys(bundled_missions(), ())


def test_a_file_of_a_later_format_is_refused_and_earlier_ones_are_not() -> None:
    for number in (1, 2):
        assert parsed(put(content(), ("mission", "format"), number)).mission.format == number
    assert places(put(content(), ("mission", "format"), 3)) == ["mission.format"]


def test_a_plant_is_a_profile_today() -> None:
    mission = parsed(old("px4", "stub-delayed"))
    assert [each.section.profile for each in mission.vehicles] == ["px4", "stub-delayed", "stub"]
    assert mission.warnings == (
        "vehicles[0].plant: moved to vehicles[0].profile",
        "vehicles[1].plant: moved to vehicles[1].profile",
    )


@pytest.mark.parametrize(
    ("path", "flown"),
    [
        (("encirclement", "spacing_acceleration_max_m_s2"), 0.3),
        (("encirclement", "spacing_jerk_max_m_s3"), 0.5),
        (("tuning", "failsafe", "clock_step_s"), 0.5),
        (("failsafe", "clock_step_s"), 0.5),
    ],
)
def test_a_key_that_is_a_constant_today_is_accepted_with_its_value_only(path: tuple[str, ...], flown: float) -> None:
    place = ".".join(path)
    (warning,) = parsed(put(content(), path, flown)).warnings
    assert warning.startswith(f"{place}: no longer a key")
    (fault,) = faults(put(content(), path, 0.7))
    assert fault.startswith(f"{place}: no longer a key, its value is always {flown:g}, not 0.7")


def test_a_fault_in_a_key_that_moved_is_where_the_file_has_it() -> None:
    assert places(old("nowhere")) == ["vehicles[0].plant"]
    assert places(put(content(), ("vehicles", 0, "profile"), "nowhere")) == ["vehicles[0].profile"]


def test_a_key_in_both_places_is_a_fault() -> None:
    (fault,) = faults(put(old("px4"), ("vehicles", 0, "profile"), "stub"))
    assert fault.startswith("vehicles[0].plant: ")
    assert "vehicles[0].profile" in fault


def test_an_own_filter_of_the_mission_applies_to_every_vehicle_over_its_profile() -> None:
    mission = parsed(old("px4", "stub-noisy", own_filter={"position_noise_m": 0.3, "gate_sigma": 6}))
    changes = {"position_noise_m": 0.3, "gate_sigma": 6.0}
    assert [each.own_filter for each in mission.vehicles] == [
        PX4_FILTER.model_copy(update=changes),
        OwnFilterSettings(position_noise_m=0.3, velocity_noise_m_s=0.05, gate_sigma=6.0),
        OwnFilterSettings(position_noise_m=0.3, gate_sigma=6.0),
    ]
    assert [mission.agent_config(each).own_filter for each in mission.vehicles] == [
        each.own_filter for each in mission.vehicles
    ]
    told = [warning for warning in mission.warnings if warning.startswith("own_filter.")]
    assert [warning.partition(":")[0] for warning in told] == ["own_filter.position_noise_m", "own_filter.gate_sigma"]
    assert all("profile" in warning for warning in told)


def test_an_own_filter_that_is_wrong_is_refused_as_ever() -> None:
    assert places(old(own_filter={"position_noise_m": -1.0, "gate_sigmas": 3.0})) == [
        "own_filter.gate_sigmas",
        "own_filter.position_noise_m",
    ]


@pytest.mark.parametrize("value", [5, [1], "text"])
def test_values_in_place_of_tables_are_faults_and_nothing_else(value: object) -> None:
    assert "own_filter" in places(content() | {"own_filter": value})
    assert "vehicles" in "".join(places(content() | {"vehicles": value}))


# Keys that are in [tuning] or in [target] today. The sections of earlier versions held all of them.


MOVED = {
    (name, key): f"tuning.{name}.{key}" if key in TUNING[name].model_fields else f"target.{key}"
    for name, (_, model) in TUNED.items()
    for key in model.model_fields
    if name == "target_filter" or key in TUNING[name].model_fields
}


def value_of(name: str, key: str) -> int | float:
    """Return a value of a key that is not its default."""
    default = TUNED[name][1].model_fields[key].default
    return default + 1 if isinstance(default, int) else 1.03 * (default or 11.0)


def test_every_key_that_moved_is_read_where_it_was_and_says_where_it_is() -> None:
    assert len(MOVED) > 30
    mission = content()
    for name, key in MOVED:
        mission = put(mission, (name, key), value_of(name, key))
    loaded = parsed(mission)
    assert sorted(loaded.warnings) == sorted(f"{n}.{key}: moved to {there}" for (n, key), there in MOVED.items())
    for name, key in MOVED:
        assert getattr(getattr(loaded, name), key) == value_of(name, key), (name, key)
    today = content()
    for (name, key), there in MOVED.items():
        today = put(today, (*there.rpartition(".")[0].split("."), key), value_of(name, key))
    assert parsed(today).warnings == ()
    assert parsed(today) == loaded


def test_every_key_that_moved_has_its_faults_where_the_file_has_it() -> None:
    mission = content()
    for name, key in MOVED:
        mission = put(mission, (name, key), "wrong")
    assert places(mission) == sorted(f"{name}.{key}" for name, key in MOVED)


def test_a_key_that_moved_is_a_fault_where_both_places_have_it() -> None:
    mission = put(content(), ("encirclement", "lag_weight"), 5.0)
    assert places(put(mission, ("tuning", "encirclement", "lag_weight"), 5.0)) == ["encirclement.lag_weight"]
    mission = put(content(), ("target_filter", "coast_s"), 5.0)
    assert places(put(mission, ("target", "coast_s"), 5.0)) == ["target_filter.coast_s"]


def test_cross_checks_of_a_key_that_moved_name_its_place_in_the_file() -> None:
    assert places(put(content(), ("encirclement", "radius_min_m"), 12.0)) == ["encirclement.radius_min_m"]


@pytest.mark.parametrize("tuning", [5, {"encirclement": 5}, {"encirclment": {"lag_weight": 5.0}}])
def test_old_keys_beside_a_tuning_that_is_none_are_faults_and_nothing_else(tuning: object) -> None:
    mission = put(content(), ("encirclement", "lag_weight"), 5.0) | {"tuning": tuning}
    assert any(place.startswith("tuning") for place in places(mission))


def test_an_unknown_key_of_an_old_section_is_unknown_there() -> None:
    assert places(put(content(), ("target_filter", "coasts"), 5.0)) == ["target_filter.coasts"]


def test_the_old_form_of_a_mission_is_the_same_mission() -> None:
    """case3-turns as it was before its tuning had a place of its own."""
    today = content((MISSIONS / "case3-turns.toml").read_text(encoding="utf-8"))
    before = {key: value for key, value in today.items() if key != "tuning"}
    for name, keys in today["tuning"].items():
        before[name] = before[name] | keys
    assert parsed(before) == parsed(today) == load_mission("case3-turns")
    assert len(parsed(before).warnings) == 5
