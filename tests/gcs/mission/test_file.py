"""Mission files: what is right is read as written, and what is wrong is told, all of it, with its place in the file."""

import re
from collections.abc import Iterator
from itertools import cycle, product
from math import inf, nan, pi
from pathlib import Path
from typing import Any, get_args, get_origin

import pytest
from pydantic import BaseModel

from estimation.frames import Geodetic
from estimation.plant.model import PlantAxis
from gcs.mission.file import MissionError, bundled_missions, load_mission, parse_mission
from gcs.mission.mission import VehicleSection
from gcs.mission.sections import SECTIONS, TUNING
from tests.support.mission_text import CASE2, Content, Place, content, drop, faults, parsed, places, put, shown, text_of
from tests.support.paths import MISSIONS

BUNDLED = [
    "ardupilot-trio",
    "case1",
    "case2",
    "case2-field",
    "case2-wander",
    "case3-turns",
    "crossing",
    "evader",
    "four-targets",
    "mixed-team",
    "px4-trio",
    "shaped-trio",
    "stack",
    "two-targets",
]


# Every key of every section, found in the models


def keys(model: type[BaseModel], path: Place = ()) -> Iterator[tuple[Place, object]]:
    """Yield every key below a section with its type; a pair gives one for each of its two numbers."""
    for name, field in model.model_fields.items():
        yield from _keys((*path, name), field.annotation)


def _keys(path: Place, annotation: Any) -> Iterator[tuple[Place, object]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield from keys(annotation, path)
    elif get_origin(annotation) is tuple and Ellipsis in get_args(annotation):
        yield path, tuple
    elif get_origin(annotation) is tuple:
        for index, part in enumerate(get_args(annotation)):
            yield from _keys((*path, index), part)
    elif type(None) in get_args(annotation):
        yield from _keys(path, next(part for part in get_args(annotation) if part is not type(None)))
    else:
        yield path, get_args(annotation)[0] if hasattr(annotation, "__metadata__") else annotation


KEYS = [
    *(key for name, model in SECTIONS.items() for key in keys(model, (name,))),
    *(key for name, model in TUNING.items() for key in keys(model, ("tuning", name))),
    *keys(VehicleSection, ("vehicles", 1)),
]
NUMBERS = [path for path, kind in KEYS if kind is float]
WHOLE_NUMBERS = [path for path, kind in KEYS if kind is int]
TABLES = sorted({path[:at] for path, _ in KEYS for at in range(1, len(path)) if isinstance(path[at], str)}, key=str)


def test_every_key_is_found() -> None:
    assert len(NUMBERS) > 60
    nested = {("tuning", "encirclement", "spacing_weight"), ("vehicles", 1, "true_scale", "a0")}
    assert {("mission", "duration_s"), ("target", "start_m", 0), *nested} <= set(NUMBERS)
    assert {("mission", "seed"), ("vehicles", 1, "system_id")} <= set(WHOLE_NUMBERS)
    assert {("vehicles", 1), ("target", "sensor")} <= set(TABLES)


# What is right


def test_bundled_missions_load() -> None:
    assert bundled_missions() == BUNDLED
    for name in BUNDLED:
        mission = load_mission(name)
        assert mission.mission.name == name
        assert mission.ids == tuple(range(1, len(mission.vehicles) + 1))


def test_case2_is_the_papers() -> None:
    mission = load_mission("case2")
    assert mission.encirclement.radius_m == 10.0
    assert mission.encirclement.angular_rate_rad_s == 0.05
    assert (mission.formation.spacing_m, mission.formation.speed_m_s) == (5.0, 0.2)
    assert (mission.target.start_m, mission.target.velocity_m_s) == ((35.0, -5.0), (0.1, 0.0))
    assert [vehicle.section.start_m for vehicle in mission.vehicles] == [(0.0, 4.0), (0.0, 0.0), (0.0, -4.0)]
    assert all(vehicle.plant == vehicle.true_plant for vehicle in mission.vehicles)


def test_a_file_is_loaded_by_its_path_and_its_plants_from_its_folder(tmp_path: Path) -> None:
    (tmp_path / "plants").mkdir()
    (tmp_path / "plants" / "mine.toml").write_text(
        "delay_s = 0.1\nx = { a0_per_s2 = 1.5, a1_per_s = 1.9 }\ny = { a0_per_s2 = 1.9, a1_per_s = 2.4 }\n"
    )
    mission = put(content(), ("vehicles", 1, "profile"), "plants/mine.toml")
    mission = put(mission, ("vehicles", 1, "true_scale"), {"a0": 0.5, "a1": 2.0})
    path = tmp_path / "my.toml"
    path.write_text(text_of(mission))
    vehicle = load_mission(str(path)).vehicle(2)
    assert (vehicle.plant.x, vehicle.plant.y) == (PlantAxis(1.5, 1.9), PlantAxis(1.9, 2.4))
    assert (vehicle.true_plant.x, vehicle.true_plant.y) == (PlantAxis(0.75, 3.8), PlantAxis(0.95, 4.8))
    assert (vehicle.plant.delay_s, vehicle.true_plant.delay_s) == (0.1, 0.1)


def test_a_vehicle_overrides_single_thresholds_of_the_decision() -> None:
    mission = put(content(), ("decision",), {"importance_min": 0.3, "threat_max": 0.4, "distance_max_m": 20.0})
    mission = put(mission, ("vehicles", 1, "decision"), {"threat_max": 0.9})
    mission = put(mission, ("vehicles", 2, "decision"), {"importance_min": 0.1, "distance_max_m": 5.0})
    decisions = [vehicle.decision for vehicle in parsed(mission).vehicles]
    assert [(d.importance_min, d.threat_max, d.distance_max_m) for d in decisions] == [
        (0.3, 0.4, 20.0),
        (0.3, 0.9, 20.0),
        (0.1, 0.4, 5.0),
    ]


def test_an_agent_is_told_what_the_mission_says() -> None:
    mission = parsed(put(content(), ("formation", "leader"), 3))
    config = mission.agent_config(mission.vehicle(1))
    assert (config.vehicle_id, config.slots, config.line_start_m) == (1, (1, 2, 3), (0.0, -4.0))
    assert (config.rate_hz, config.altitude_m, config.communication_radius_m) == (10.0, 8.0, 200.0)
    assert config.plant == mission.vehicle(1).plant
    assert config.safety.separation_m == 3.0
    assert config.failsafe == mission.failsafe
    assert mission.mission_frame().origin == Geodetic(47.397742, 8.545594, 488.0)
    assert mission.mission_frame().x_bearing_rad == pytest.approx(pi / 2.0)


def test_layers_and_the_order_of_landing_reach_the_agents() -> None:
    mission = put(content(), ("choreography",), {"layer_m": 3.0, "landing": "return", "landing_order": [3]})
    mission = put(mission, ("vehicles", 1, "altitude_m"), 10.0)
    loaded = parsed(mission)
    configs = [loaded.agent_config(vehicle) for vehicle in loaded.vehicles]
    assert {config.landing_order for config in configs} == {(3, 1, 2)}
    assert [config.take_off_altitude_m for config in configs] == [10.0, 13.0, 16.0]
    assert [config.return_altitude_m for config in configs] == [16.0, 19.0, 13.0]
    assert [config.home_m for config in configs] == [(0.0, 4.0), (0.0, 0.0), (0.0, -4.0)]


def test_a_way_home_that_cannot_be_is_refused(subtests: pytest.Subtests) -> None:
    for choreography, place, told in (
        ({"landing": "return"}, "choreography.layer_m", "layers of at least 1.0 m"),
        ({"landing": "home"}, "choreography.landing", "'in_place' or 'return'"),
        ({"landing_order": [1, 7]}, "choreography.landing_order[1]", "no vehicle has the id 7 (ids: 1, 2, 3)"),
        ({"landing_order": [2, 1, 2]}, "choreography.landing_order[2]", "vehicle 2 is listed twice"),
        ({"landing_order": [0]}, "choreography.landing_order[0]", "greater than or equal to 1"),
        ({"landing_order": 2}, "choreography.landing_order", "a list of vehicles' ids"),
    ):
        with subtests.test(choreography=choreography, place=place, told=told):
            (fault,) = faults(put(content(), ("choreography",), choreography))
            assert fault.startswith(f"{place}: ")
            assert told in fault


def test_two_devices_or_two_hosts_are_no_clash(subtests: pytest.Subtests) -> None:
    for urls in (
        ("serial:///dev/ttyUSB0:57600", "serial:///dev/ttyUSB1:57600"),
        ("tcpout://10.0.0.1:5760", "tcpout://10.0.0.2:5760"),
        ("udpout://10.0.0.1:14550", "udpout://10.0.0.2:14550"),
    ):
        with subtests.test(urls=urls):
            mission = put(put(content(), ("vehicles", 0, "url"), urls[0]), ("vehicles", 1, "url"), urls[1])
            assert tuple(vehicle.section.url for vehicle in parsed(mission).vehicles)[:2] == urls


# What is wrong: one key at a time


def test_what_is_no_number_is_refused_wherever_it_stands(subtests: pytest.Subtests) -> None:
    values: tuple[object, ...] = (1.5, True, -1)
    no_numbers: Iterator[object] = cycle((nan, "10 m", inf, -inf))
    for path, value in (*zip(NUMBERS, no_numbers, strict=False), *product(WHOLE_NUMBERS, values)):
        with subtests.test(path=shown(path), value=value):
            (fault,) = faults(put(content(), path, value))
            assert fault.startswith(f"{shown(path)}: ")
            assert value != "10 m" or "'10 m'" in fault


def test_an_unknown_key_is_refused_in_every_table(subtests: pytest.Subtests) -> None:
    for path in TABLES:
        with subtests.test(path=shown(path)):
            (fault,) = faults(put(content(), (*path, "colour"), "red"))
            assert fault.startswith(f"{shown(path)}.colour: unknown key; known keys: ")
            known = set(fault.rpartition("known keys: ")[2].split(", "))
            assert known == {str(key[len(path)]) for key, _ in KEYS if key[: len(path)] == path}


def test_a_value_in_place_of_a_table_is_refused(subtests: pytest.Subtests) -> None:
    for path in TABLES:
        with subtests.test(path=shown(path)):
            found = faults(put(content(), path, 5))
            assert any(fault.startswith(f"{shown(path)}: ") and "table" in fault for fault in found)


def test_a_place_has_two_coordinates(subtests: pytest.Subtests) -> None:
    pairs = [path[:-1] for path in NUMBERS if path[-1] == 0]
    values: tuple[object, ...] = ([1.0], [1.0, 2.0, 3.0], "1, 2")
    for pair, value in zip(pairs, cycle(values), strict=False):
        with subtests.test(pair=shown(pair), value=value):
            found = places(put(content(), pair, value))
            assert found
            assert all(re.fullmatch(re.escape(shown(pair)) + r"(\[\d\])?", fault) for fault in found)


# What is wrong: the table of the issue


def changed(*changes: tuple[Place, object]) -> Content:
    mission = content()
    for path, value in changes:
        mission = put(mission, path, value)
    return mission


RADIUS, RATE = ("encirclement", "radius_m"), ("encirclement", "angular_rate_rad_s")
BAD: dict[str, tuple[Content, list[tuple[str, str]]]] = {
    "an unknown section": (changed((("formaton",), {"spacing_m": 5.0})), [("formaton", "did you mean 'formation'")]),
    "a misspelt key of a table in a table": (
        changed((("target", "sensor", "rang_m"), 10.0)),
        [("target.sensor.rang_m", "did you mean 'range_m'")],
    ),
    "a key in degrees in place of radians": (
        drop(changed((("encirclement", "angular_rate_deg_s"), 2.9)), RATE),
        [("encirclement.angular_rate_rad_s", "missing"), ("encirclement.angular_rate_deg_s", "angular_rate_rad_s")],
    ),
    "latitude and longitude swapped": (
        changed((("frame", "latitude_deg"), 147.0), (("frame", "longitude_deg"), 47.0)),
        [("frame.latitude_deg", "147.0")],
    ),
    "an id twice": (
        changed((("vehicles", 1, "id"), 3)),
        [("vehicles[2].id", "vehicles[1]"), ("formation.leader", "2")],
    ),
    "a system id twice": (changed((("vehicles", 0, "system_id"), 3)), [("vehicles[2].system_id", "vehicles[0]")]),
    "a port twice, once on all interfaces": (
        changed((("vehicles", 1, "url"), "udpin://0.0.0.0:14540")),
        [("vehicles[1].url", "vehicles[0]")],
    ),
    "a Zenoh endpoint twice": (
        changed((("vehicles", 2, "endpoint"), "tcp/127.0.0.1:7461")),
        [("vehicles[2].endpoint", "vehicles[0]")],
    ),
    "a url that MAVSDK does not know": (
        changed((("vehicles", 0, "url"), "udp://:14540"), (("vehicles", 1, "url"), "udpin://127.0.0.1:70000")),
        [("vehicles[0].url", "udpin://127.0.0.1:14540"), ("vehicles[1].url", "70000")],
    ),
    "an endpoint that Zenoh does not know": (
        changed((("vehicles", 0, "endpoint"), "127.0.0.1:7461"), (("vehicles", 1, "endpoint"), "tcp/127.0.0.1:70000")),
        [("vehicles[0].endpoint", "tcp/127.0.0.1:7461"), ("vehicles[1].endpoint", "70000")],
    ),
    "a plant that is not there": (
        changed((("vehicles", 2, "profile"), "stubb")),
        [("vehicles[2].profile", "bundled profiles: ardupilot, px4, stub, stub-delayed")],
    ),
    "velocities told of that a plant does not take": (
        changed((("link",), {"feedforward": True}), (("vehicles", 0, "profile"), "stub-feedforward")),
        [
            ("vehicles[1].profile", "'stub' takes no velocities, and link.feedforward = true"),
            ("vehicles[2].profile", "'stub' takes no velocities, and link.feedforward = true"),
        ],
    ),
    "no velocities told of, and a plant that takes them": (
        changed((("link",), {"feedforward": False}), (("vehicles", 1, "profile"), "stub-feedforward")),
        [("vehicles[1].profile", "(feedforward = 1), and link.feedforward = false: use one identified without")],
    ),
    "a ring within its own smallest radius": (
        changed((("tuning", "encirclement", "radius_min_m"), 12.0)),
        [("tuning.encirclement.radius_min_m", "encirclement.radius_m")],
    ),
    "a ring beyond its own largest radius": (
        changed((("tuning", "encirclement", "radius_far_m"), 9.0)),
        [("tuning.encirclement.radius_far_m", "encirclement.radius_m")],
    ),
    "a formation faster than it may fly": (
        changed((("formation", "speed_m_s"), 2.5)),
        [("formation.speed_m_s", "speed_max_m_s")],
    ),
    "a target with two ways to move": (
        changed(
            (("target", "velocity_m_s"), [0.1, 0.0]), (("target", "legs"), [{"to_m": [0.0, 0.0], "speed_m_s": 1.0}])
        ),
        [("target", "leave one of them out")],
    ),
    "a leg that is none": (
        changed((("target", "legs"), [{"to_m": [0.0, 0.0], "speed": 1.0}])),
        [("target.legs[0].speed_m_s", "missing"), ("target.legs[0].speed", "did you mean 'speed_m_s'")],
    ),
    "a leg too fast to keep up with": (
        changed(
            (("target", "velocity_m_s"), [0.0, 0.0]), (("target", "legs"), [{"to_m": [0.0, 0.0], "speed_m_s": 4.0}])
        ),
        [("encirclement.angular_rate_rad_s", "4.50 m/s")],
    ),
    "a vehicle named for a target that is none": (
        changed((("target", "url"), "udpin://127.0.0.1:14550"), (("target", "system_id"), 9)),
        [("target", "a url and a system_id")],
    ),
    "a battery that is critical before it is low": (
        changed((("failsafe",), {"battery_low": 0.2, "battery_critical": 0.25})),
        [("failsafe.battery_critical", "0.25 must be less than battery_low = 0.2")],
    ),
    "all peers missed sooner than one": (
        changed((("failsafe",), {"peer_silent_s": 5.0})),
        [("failsafe.peers_silent_s", "peer_silent_s = 5.0 s")],
    ),
    "a leader that is not there": (changed((("formation", "leader"), 7)), [("formation.leader", "1, 2, 3")]),
    "a wrong threshold of a vehicle": (
        changed((("vehicles", 1, "decision"), {"threat_max": 6.0})),
        [("vehicles[1].decision.threat_max", "6.0")],
    ),
    "a gimbal that is no table": (changed((("vehicles", 1, "gimbal"), "up")), [("vehicles[1].gimbal", "up")]),
    "a camera that sees all around": (
        changed((("vehicles", 1, "gimbal"), {"view_deg": 360.0}), (("vehicles", 2, "gimbal"), {"fov_deg": 60.0})),
        [("vehicles[1].gimbal.view_deg", "360.0"), ("vehicles[2].gimbal.fov_deg", "")],
    ),
    "a stream that is none, and one with a password": (
        changed(
            (("vehicles", 0, "camera_url"), "javascript:alert(1)"),
            (("vehicles", 1, "camera_url"), "rtsp://admin:secret@192.168.1.20/main"),
            (("vehicles", 2, "camera_url"), "rtsp://192.168.1.20:99999/main"),
        ),
        [
            ("vehicles[0].camera_url", "rtsp://192.168.1.20:554/main"),
            ("vehicles[1].camera_url", "password"),
            ("vehicles[2].camera_url", "rtsp://192.168.1.20:554/main"),
        ],
    ),
    "no vehicles": (changed((("vehicles",), [])), [("vehicles", "[[vehicles]]")]),
    "one vehicle, not a list of them": (changed((("vehicles",), {"id": 1})), [("vehicles", "[[vehicles]]")]),
    "one zone, not a list of them": (
        changed((("safety", "no_fly"), {"name": "mast"})),
        [("safety.no_fly", "list of tables, each under [[safety.no_fly]]")],
    ),
    "a gimbal that is a number": (changed((("vehicles", 0, "gimbal"), 1)), [("vehicles[0].gimbal", "true")]),
    "nothing at all": (
        {},
        [(name, "missing") for name in ("mission", "frame", "formation", "encirclement", "target")]
        + [("vehicles", "")],
    ),
}


def test_bad_input_is_refused_with_its_place_and_reason(subtests: pytest.Subtests) -> None:
    for name, (mission, expected) in BAD.items():
        with subtests.test(name):
            found = faults(mission)
            assert sorted(fault.partition(": ")[0] for fault in found) == sorted(place for place, _ in expected)
            for place, reason in expected:
                told = (fault.startswith(f"{place}: ") and reason in fault for fault in found)
                assert any(told), (place, reason, found)


def test_all_faults_are_told_at_once() -> None:
    mission = drop(
        changed(
            (("colour",), "red"),
            (("encirclement", "radius_mm"), 1.0),
            (("safety", "separation_m"), 4.5),
            (("tuning", "target_filter", "gate_sigma"), 0.5),
            (("simulation", "wind_m_s2"), [0.0, nan]),
            (("vehicles", 0, "url"), "udpin://127.0.0.1:14541"),
            (("vehicles", 2, "profile"), "nowhere"),
        ),
        ("mission", "duration_s"),
    )
    keys = "colour mission.duration_s encirclement.radius_mm tuning.target_filter.gate_sigma simulation.wind_m_s2[1]"
    vehicles = "vehicles[1].start_m vehicles[1].url vehicles[2].profile"
    assert places(mission) == sorted(f"{keys} {vehicles}".split())


LOCAL = changed((("frame",), {"local": True, "x_bearing_deg": 90.0}), (("vehicles", 1, "origin_m"), [1.0, -2.0, 0.5]))


def test_a_local_frame_lies_nowhere_on_earth() -> None:
    mission = parsed(LOCAL)
    frame = mission.mission_frame()
    assert (frame.is_local, frame.origin) == (True, None)
    assert frame.x_bearing_rad == pytest.approx(pi / 2.0)
    origins = [vehicle.origin_m for vehicle in mission.vehicles]
    assert origins == [(0.0, 4.0, 0.0), (1.0, -2.0, 0.5), (0.0, -4.0, 0.0)]


def test_a_frame_is_on_earth_or_local_and_every_fault_is_named() -> None:
    both = put(put(content(), ("frame", "local"), True), ("vehicles", 1, "origin_m"), [1.0, -2.0, 0.5])
    assert places(both) == ["frame.altitude_m", "frame.latitude_deg", "frame.longitude_deg"]
    assert all("leave this key or local out" in fault for fault in faults(both))
    neither = put(put(content(), ("frame",), {"altitude_m": 5.0}), ("vehicles", 1, "origin_m"), [1.0, -2.0, 0.5])
    assert places(neither) == ["frame.latitude_deg", "frame.longitude_deg", "vehicles[1].origin_m"]
    assert sum("indoors, without GPS, write local = true" in fault for fault in faults(neither)) == 2


def test_setpoints_are_not_asked_for_faster_than_the_loop_makes_them() -> None:
    (fault,) = faults(put(content(), ("link",), {"setpoint_rate_hz": 12.5}))
    assert fault.startswith("link.setpoint_rate_hz: 12.5 Hz is more than mission.rate_hz = 10.0 Hz")
    assert parsed(put(content(), ("link",), {"setpoint_rate_hz": 10.0})).link.setpoint_rate_hz == 10.0


# Plant files


GOOD_PLANT = {"delay_s": 0.1, "x": {"a0_per_s2": 0.8, "a1_per_s": 0.9}, "y": {"a0_per_s2": 0.8, "a1_per_s": 0.9}}
BAD_PLANTS: dict[str, tuple[Content | str, list[str]]] = {
    "unstable twice": (put(put(GOOD_PLANT, ("x", "a0_per_s2"), -1.0), ("y", "a1_per_s"), -1.0), ["x", "y"]),
    "NaN": (put(GOOD_PLANT, ("y", "a0_per_s2"), nan), ["y.a0_per_s2"]),
    "too stiff for any number": (put(GOOD_PLANT, ("x", "a0_per_s2"), 1e308), ["x.a0_per_s2"]),
    "no TOML": ("a0 =", [""]),
}


@pytest.mark.parametrize("name", BAD_PLANTS)
def test_a_bad_plant_is_refused_with_its_place_in_both_files(name: str, tmp_path: Path) -> None:
    plant, expected = BAD_PLANTS[name]
    (tmp_path / "mine.toml").write_text(plant if isinstance(plant, str) else text_of(plant))
    mission = changed((("vehicles", 1, "profile"), "mine.toml"), (("vehicles", 1, "true_scale"), {"a0": 10.0}))
    found = faults(mission, tmp_path)
    assert len(found) == len(expected)
    for fault, place in zip(sorted(found), sorted(expected), strict=True):
        assert fault.startswith("vehicles[1].profile: ")
        assert re.search(rf"mine\.toml'?:? {re.escape(place)}", fault), fault


@pytest.mark.parametrize("name", ["", ".", "a\0b", "a" * 5000, "../../..", "~"])
def test_a_plant_name_that_is_no_file_is_a_fault(name: str, tmp_path: Path) -> None:
    assert places(changed((("vehicles", 0, "profile"), name)), tmp_path) == ["vehicles[0].profile"]


# Files that are no missions


def test_a_mission_that_is_not_there_names_those_that_are(subtests: pytest.Subtests) -> None:
    for name in ["nowhere.toml", ""]:
        with subtests.test(name=name), pytest.raises(MissionError, match="bundled missions: " + ", ".join(BUNDLED)):
            load_mission(name)


def test_a_byte_order_mark_is_no_fault(tmp_path: Path) -> None:
    (tmp_path / "windows.toml").write_bytes(CASE2.replace("\n", "\r\n").encode("utf-8-sig"))
    assert load_mission(str(tmp_path / "windows.toml")) == load_mission("case2")


def test_a_folder_or_a_picture_is_no_mission(tmp_path: Path) -> None:
    picture = tmp_path / "picture.png"
    picture.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    for path in (tmp_path, picture):
        with pytest.raises(MissionError) as caught:
            load_mission(str(path))
        assert len(caught.value.faults) == 1
        assert str(path) in caught.value.faults[0]


def test_what_is_no_toml_is_one_fault(subtests: pytest.Subtests) -> None:
    for text in ("[mission", "a = " + "[" * 5000 + "]" * 5000, "a = " + "1" * 5000, "\0"):
        with subtests.test(text=text):
            assert places(text) == ["not TOML"]


def test_odd_values_are_shown_on_one_short_line(subtests: pytest.Subtests) -> None:
    for value in ("0x" + "f" * 5000, "1979-05-27T07:32:00Z", '"""a\nb"""'):
        with subtests.test(value=value):
            (fault,) = faults(CASE2.replace("radius_m = 10.0", f"radius_m = {value}"))
            assert fault.startswith("encirclement.radius_m: ")
            assert len(fault) < 160


def test_odd_keys_are_one_fault_on_one_line(subtests: pytest.Subtests) -> None:
    for key in ['"a\\nb"', '"a.b"', '""', '"[x]"']:
        with subtests.test(key=key):
            with pytest.raises(MissionError) as caught:
                parse_mission(CASE2.replace("radius_m = 10.0", f"radius_m = 10.0\n{key} = 1"), MISSIONS)
            (fault,) = caught.value.faults
            assert fault.startswith("encirclement.")
            assert len(fault.splitlines()) == 1


# Profiles


def test_a_stub_is_of_the_profiles_autopilot_unless_the_mission_says_otherwise() -> None:
    mission = changed(
        (("vehicles", 0, "profile"), "ardupilot"),
        (("vehicles", 1, "profile"), "ardupilot"),
        (("vehicles", 1, "autopilot"), "px4"),
    )
    assert [vehicle.autopilot for vehicle in parsed(mission).vehicles] == ["ardupilot", "px4", "px4"]


@pytest.mark.parametrize(
    ("limits", "key"),
    [
        ({"speed_max_m_s": 0.59}, "limits.speed_max_m_s"),  # the ring takes 0.5 m/s, and the target 0.1 m/s
        ({"acceleration_max_m_s2": 0.024}, "limits.acceleration_max_m_s2"),  # 10 m * (0.05 rad/s)^2
    ],
)
def test_a_mission_beyond_a_profiles_limits_is_refused(limits: dict[str, float], key: str, tmp_path: Path) -> None:
    (tmp_path / "slow.toml").write_text(text_of(GOOD_PLANT | {"limits": limits}))
    mission = changed((("vehicles", 1, "profile"), "slow.toml"))
    (fault,) = faults(mission, tmp_path)
    assert fault.startswith("vehicles[1].profile: ")
    assert key in fault
    assert "'slow.toml'" in fault
    (tmp_path / "slow.toml").write_text(
        text_of(GOOD_PLANT | {"limits": {name: 1.05 * value for name, value in limits.items()}})
    )
    assert parsed(mission, tmp_path).ids == (1, 2, 3)


def test_addresses_follow_the_id_unless_given() -> None:
    bare = content()
    for vehicle in bare["vehicles"]:
        del vehicle["url"], vehicle["endpoint"]
    assert [(each.section.url, each.section.endpoint) for each in parsed(bare).vehicles] == [
        (each.section.url, each.section.endpoint) for each in load_mission("case2").vehicles
    ]
    assert faults(drop(bare, ("vehicles", 1, "id"))) == ["vehicles[1].id: this key is missing"]


def test_a_number_of_thousands_of_digits_is_named_by_its_line() -> None:
    with pytest.raises(MissionError) as caught:
        parse_mission(f"[mission]\nduration_s = {'1' * 5000}\n\n[frame]\nlocal = true\n", None)
    assert "line 2" in str(caught.value)
    assert "set_int_max_str_digits" not in str(caught.value)
