"""Missions of several targets and rings: what tables share, what each ring is checked for, and what is refused."""

from dataclasses import replace
from typing import Any

import pytest

from gcs.mission.file import bundled_missions, load_mission, parse_mission
from gcs.mission.mission import Mission
from tests.support.mission_text import Content, Place, content, drop, faults, parsed, places, put, text_of
from tests.support.paths import MISSIONS

SEVERAL: Content = content() | {
    "target": {"importance": 0.9, "threat": 0.1, "sensor": {"range_m": 60.0, "rate_hz": 4.0}, "coast_s": 3.0},
    "targets": [
        {"name": "north", "start_m": [40.0, 20.0], "sensor": {"noise_m": 0.2}},
        {"name": "south", "start_m": [40.0, -20.0], "velocity_m_s": [0.1, 0.0], "threat": 0.3},
    ],
    "encirclement": {"radius_m": 10.0, "angular_rate_rad_s": 0.1},
    "rings": [
        {"target": "south", "places": 2, "radius_m": 8.0},
        {"target": "north", "places": 3, "name": "upper", "angular_rate_rad_s": -0.05},
    ],
    "tuning": {"encirclement": {"spacing_gain_per_s": 0.2}},
}
STACK: Content = drop(SEVERAL, ("targets",)) | {
    "target": content()["target"],
    "rings": [{"name": "low", "places": 2}, {"name": "high", "places": 3, "altitude_m": 12.0}],
}


def several(changes: dict[Place, object]) -> Content:
    mission = SEVERAL
    for path, value in changes.items():
        mission = put(mission, path, value)
    return mission


def test_entries_are_completed_from_what_they_have_in_common() -> None:
    mission = parsed(SEVERAL)
    north, south = mission.targets
    assert [(each.name, each.start_m, each.importance, each.threat) for each in (north, south)] == [
        ("north", (40.0, 20.0), 0.9, 0.1),
        ("south", (40.0, -20.0), 0.9, 0.3),
    ]
    assert (north.sensor.range_m, north.sensor.rate_hz, north.sensor.noise_m) == (60.0, 4.0, 0.2)
    assert (south.sensor.rate_hz, south.sensor.noise_m, south.velocity_m_s) == (4.0, 0.0, (0.1, 0.0))
    assert mission.target_filter.coast_s == 3.0
    first, second = mission.rings
    assert (first.name, first.target, first.places, second.name, second.target, second.places) == (
        ("south", 1, 2, "upper", 0, 3)
    )
    assert (first.encirclement.radius_m, first.encirclement.angular_rate_rad_s) == (8.0, 0.1)
    assert (second.encirclement.radius_m, second.encirclement.angular_rate_rad_s) == (10.0, -0.05)
    assert [each.encirclement.spacing_gain_per_s for each in mission.rings] == [0.2, 0.2]


def test_the_first_ring_and_its_target_are_those_of_the_mission() -> None:
    mission = parsed(SEVERAL)
    assert (mission.target, mission.encirclement) == (mission.targets[1], mission.rings[0].encirclement)
    upper = mission.of_ring(1)
    assert (upper.target, upper.encirclement) == (mission.targets[0], mission.rings[1].encirclement)
    assert (upper.targets, upper.rings, mission.alone) == ((), (), (mission.of_ring(0), upper))
    config = mission.agent_config(mission.vehicles[0])
    assert (config.targets, config.target, config.places) == (("north", "south"), "south", 2)
    assert (config.on_ring(1).target, config.on_ring(1).places) == ("north", 3)


def test_several_rings_may_be_about_one_target() -> None:
    mission = parsed(STACK)
    assert (mission.targets, [(each.name, each.target) for each in mission.rings]) == ((), [("low", 0), ("high", 0)])
    assert mission.agent_config(mission.vehicles[0]).target is None
    assert mission.of_ring(1).encirclement.altitude_m == 12.0


def test_one_target_and_one_ring_in_tables_are_a_mission_of_one() -> None:
    mission = content()
    single = parsed(mission)
    target, ring = mission.pop("target"), mission.pop("encirclement")
    tables = parsed(mission | {"targets": [target | {"name": "it"}], "rings": [ring | {"places": 3}]})
    assert (tables.targets, tables.rings) == ((), ())
    assert (tables.target, tables.encirclement) == (
        single.target.model_copy(update={"name": "it"}),
        single.encirclement,
    )


def test_values_are_set_by_their_paths() -> None:
    mission = parsed(SEVERAL).replace(
        **{"targets[1]": {"start_m": [41.0, -21.0]}, "rings[0]": {"places": 4}}, encirclement={"radius_m": 11.0}
    )
    assert (mission.targets[1].start_m, mission.rings[0].places) == ((41.0, -21.0), 4)
    assert [each.encirclement.radius_m for each in mission.rings] == [8.0, 11.0]


# What is refused


REFUSED: list[tuple[str, dict[Place, object], list[str], tuple[str, ...]]] = [
    ("a value that targets share", {("target", "importance"): 2.0}, ["target.importance"], ("2.0",)),
    ("a value of one", {("targets", 1, "start_m"): "x"}, ["targets[1].start_m"], ("'x'",)),
    ("a key that no target has", {("targets", 0, "colour"): 1}, ["targets[0].colour"], ("unknown",)),
    ("a shared key that none has", {("target", "start"): 1}, ["target.start"], ("start_m",)),
    ("a key of the filter", {("targets", 0, "coast_s"): 1.0}, ["targets[0].coast_s"], ("[target]",)),
    ("a common name", {("target", "name"): "x"}, ["target.name"], ("[[targets]]",)),
    (
        "one name for two",
        {("targets", 0, "name"): "south"},
        ["targets[1].name"],
        ("'south'", "targets[0]"),
    ),
    ("a value of the filter", {("targets", 0, "coast_s"): "x"}, ["targets[0].coast_s"], ("[target]",)),
    (
        "a shared value that each target replaces",
        {("target", "threat"): 7.0, ("targets", 0, "threat"): 0.1},
        ["target.threat"],
        ("7.0",),
    ),
    (
        "a shared value of the sensor that each target replaces",
        {("target", "sensor", "noise_m"): -1.0, ("targets", 1, "sensor"): {"noise_m": 0.1}},
        ["target.sensor.noise_m"],
        ("-1.0",),
    ),
    (
        "a shared value that each ring replaces",
        {("encirclement", "radius_m"): -1.0, ("rings", 1, "radius_m"): 9.0},
        ["encirclement.radius_m"],
        ("-1.0",),
    ),
    ("an invalid name", {("targets", 0, "name"): "no rth"}, ["targets[0].name"], ("'no rth'", "letters, digits, -")),
    ("a long name", {("targets", 0, "name"): "n" * 25}, ["targets[0].name"], ("it must have at most 24 characters",)),
    ("a ring's invalid name", {("rings", 1, "name"): "up/er"}, ["rings[1].name"], ("'up/er'", "letters, digits, -")),
    ("a team's invalid name", {("network", "team"): "a team"}, ["network.team"], ("'a team'", "1 to 32 letters")),
    ("a ring's key that none has", {("rings", 0, "radius"): 1.0}, ["rings[0].radius"], ("radius_m",)),
    ("places in common", {("encirclement", "places"): 3}, ["encirclement.places"], ("unknown",)),
    ("a target that is not there", {("rings", 1, "target"): "nort"}, ["rings[1].target"], ("'nort'", "'north'")),
    ("one name for two rings", {("rings", 1, "name"): "south"}, ["rings[1].name"], ("'south'", "rings[0]")),
    ("too few places", {("rings", 1, "places"): 0}, ["rings[1].places"], ("0",)),
    ("fewer places than vehicles", {("rings", 0, "places"): 1, ("rings", 1, "places"): 1}, ["rings"], ("2", "3")),
    ("a small ring", {("rings", 1, "radius_m"): 1.6}, ["rings[1].radius_m"], ("3 vehicles", "1.74")),
    ("two that fit where three do not", {("rings", 0, "radius_m"): 1.4}, ["rings[0].radius_m"], ("2 vehicles", "1.5")),
    ("a fast ring", {("rings", 0, "angular_rate_rad_s"): 0.5}, ["rings[0].angular_rate_rad_s"], ("4.10", "3.0")),
    ("a tilt", {("rings", 0, "tilt_deg"): 60.0}, ["rings[0].tilt_deg"], ("60", "1.39")),
    ("a wide ring", {("network", "range_m"): 18.0}, ["rings[1].radius_m"], ("20", "18")),
    ("a keep-out disc", {("safety", "keep_out_m"): 9.0}, ["safety.keep_out_m"], ("rings[0].radius_m",)),
    ("a table", {("rings",): {"places": 3}}, ["rings"], ("[[rings]]",)),
    ("none", {("targets",): []}, ["targets"], ("0",)),
    ("many", {("rings",): 9 * [{"target": "north", "places": 1}]}, ["rings"], ("9", "8")),
    ("no table", {("targets", 0): 3}, ["targets[0]"], ("3",)),
    ("an evader", {("targets", 0, "evades"): {"speed_m_s": 1.0}}, ["targets[0].evades"], ("only",)),
]


def test_what_is_refused_names_its_place_and_value(subtests: pytest.Subtests) -> None:
    for words, changes, at, mentioned in REFUSED:
        with subtests.test(words):
            found = faults(several(changes))
            assert [fault.partition(": ")[0] for fault in found] == at, found
            assert [each for each in mentioned if each not in found[0]] == [], found[0]


def test_the_fence_holds_every_ring() -> None:
    corners = [[-50.0, -50.0], [120.0, -50.0], [120.0, 29.0], [-50.0, 29.0]]
    assert "(40, 20)" in faults(several({("safety", "fence_m"): corners}))[0]
    south = put(several({("safety", "fence_m"): corners}), ("rings", 1, "radius_m"), 8.5)
    assert parsed(south).safety.fence_m


def test_missing_keys_and_sections_are_named() -> None:
    assert places(drop(SEVERAL, ("targets", 1, "name"))) == ["targets[1].name"]
    assert places(drop(SEVERAL, ("rings", 1, "target"))) == ["rings[1].target"]
    assert places(drop(SEVERAL, ("rings", 1, "places"))) == ["rings[1].places"]
    assert places(drop(SEVERAL, ("target", "threat"))) == ["targets[0].threat"]
    assert places(drop(STACK, ("rings", 0, "name"))) == ["rings[0].name"]
    assert places(put(drop(SEVERAL, ("rings", 1)), ("rings", 0, "places"), 3)) == ["targets[0]"]
    assert places(drop(SEVERAL, ("rings",))) == ["rings"]
    assert places(drop(SEVERAL, ("encirclement",))) == ["rings[0].angular_rate_rad_s", "rings[1].radius_m"]


def test_one_mavlink_vehicle_may_be_among_the_targets() -> None:
    vehicle = {"source": "mavlink", "url": "udpin://127.0.0.1:14560", "system_id": 40}
    one = put(SEVERAL, ("targets", 0), SEVERAL["targets"][0] | vehicle)
    assert [each.source for each in parsed(one).targets] == ["mavlink", "simulated"]
    both = put(one, ("targets", 1), SEVERAL["targets"][1] | vehicle | {"system_id": 41})
    assert places(both) == ["targets[1].source"]


def test_the_widest_gaps_that_a_ring_may_have_fit_it() -> None:
    """Two of three vehicles fly a ring of 8 m: with gaps of 1 and 20 the narrow one is 2 pi / 21, a chord of 2.4 m."""
    wide = several(
        {("vehicles", 0, "gap"): 20.0, ("rings", 1, "radius_m"): 60.0, ("rings", 1, "angular_rate_rad_s"): 0.0}
    )
    wide = put(wide, ("targets", 0, "start_m"), [40.0, 90.0])
    found = faults(wide)
    assert [fault.partition(": ")[0] for fault in found] == ["vehicles[0].gap"]
    assert "2.38 m" in found[0]
    assert "rings[0].radius_m" in found[0]


# The identity


def test_members_agree_on_the_rings_by_the_digest(subtests: pytest.Subtests) -> None:
    def digest(mission: Content) -> str:
        identity = parsed(mission).identity
        assert identity is not None
        return identity.digest

    same = digest(SEVERAL)
    assert digest(put(SEVERAL, ("mission", "description"), "other words")) == same
    swapped: Any = [SEVERAL["rings"][1], SEVERAL["rings"][0]]
    for words, other in (
        ("another order of the rings", put(SEVERAL, ("rings",), swapped)),
        ("another order of the targets", put(SEVERAL, ("targets",), SEVERAL["targets"][::-1])),
        ("a ring's name", put(SEVERAL, ("rings", 1, "name"), "other")),
        ("places", put(SEVERAL, ("rings", 1, "places"), 4)),
        ("a setting of the second ring", put(SEVERAL, ("rings", 1, "altitude_m"), 9.0)),
        ("a place of the other target", put(SEVERAL, ("targets", 0, "start_m"), [40.0, 21.0])),
    ):
        with subtests.test(words):
            assert digest(other) != same


def test_the_digests_of_one_ring_are_those_of_earlier_versions(subtests: pytest.Subtests) -> None:
    """As computed before missions had several rings: a team's computers may have different versions of cordon."""
    for name, digest in (
        ("case1", "7af5884fb7b8b8cd"),
        ("case2", "a76d891e22f59cc8"),
        ("case3-turns", "8928afc6faf1e5ce"),
        ("evader", "fae978618be39dde"),
        ("px4-trio", "17da82879c94db73"),
    ):
        with subtests.test(name):
            identity = load_mission(name).identity
            assert identity is not None
            assert identity.digest == digest


def test_a_mission_is_read_again_from_its_text() -> None:
    for name in bundled_missions():
        mission = load_mission(name)
        again = parse_mission(mission.text, MISSIONS)
        assert _read(again) == _read(mission)
    assert load_mission("stack").rings
    assert load_mission("two-targets").targets


def _read(mission: Mission) -> Mission:
    return replace(mission, text="")


def test_the_text_of_several_is_toml() -> None:
    assert parse_mission(text_of(SEVERAL), None).rings


@pytest.mark.parametrize(
    ("path", "value", "place", "reason"),
    [
        (("rings", 1, "name"), "auto", "rings[1].name", "'auto' stands for no ring in commands"),
        (("rings", 0, "altitude"), "target", "rings[0].altitude", "only the one ring of a mission can follow"),
    ],
)
def test_what_commands_and_vehicles_cannot_fly_is_refused(path: Place, value: object, place: str, reason: str) -> None:
    found = faults(put(SEVERAL, path, value))
    assert any(each.startswith(place) and reason in each for each in found), found


def test_rings_that_are_no_tables_and_missing_vehicles_are_faults() -> None:
    assert any("rings" in each for each in faults(several({("rings",): 3})))
    assert any("at least one [[vehicles]]" in each for each in faults(several({("vehicles",): []})))
