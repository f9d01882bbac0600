"""A flight as viewers see it: read by plain mcap, and compared with the records beside it and with other arithmetic."""

import json
from collections import defaultdict
from collections.abc import Callable
from math import atan2, cos, hypot, pi, radians, sin
from pathlib import Path
from typing import Any, NamedTuple

import foxglove
import numpy as np
import pytest
from foxglove import Context
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pyproj import Geod
from scipy.stats import chi2

from agents.inputs import Tick
from agents.ports import Setpoint
from agents.settings.config import AgentConfig
from estimation.state import Telemetry
from gcs.cli import log
from gcs.flight.simulated import fly_simulated
from gcs.flightlog.reader import read_log
from gcs.flightlog.recorder import Recorder, SimulationRecording
from gcs.flightlog.records import VEHICLE_TOPICS, Decision, TargetState
from gcs.flightlog.run import run_of
from gcs.flightlog.writer import LogWriter
from gcs.viewer.drawing import DrawnVehicle, newest_target
from gcs.viewer.scene import PERIOD_S, Scene, drawn_rings
from gcs.viewer.shapes import ellipse
from tests.conftest import CONFIG
from tests.support.mission_text import content, parsed, put
from tests.support.paths import MISSIONS
from tests.support.several_rings import HIGH, NORTH, SOUTH, with_rings

VEHICLES = (1, 2, 3)
FENCE_M = [[-20.0, -15.0], [120.0, -15.0], [120.0, 40.0], [-20.0, 40.0]]
OWN_FENCE_M = [[-20.0, -15.0], [100.0, -15.0], [120.0, 40.0], [-20.0, 40.0]]
TICK_NS = 100_000_000
RED = bytes.fromhex("B3200A")


class Seen(NamedTuple):
    """What a log holds by topic: times [ns] and messages."""

    topics: dict[str, list[tuple[int, Any]]]
    path: Path

    def entities(self, name: str) -> list[tuple[int, Any]]:
        """The entity of that id in every scene."""
        return [(at, entity) for at, scene in self.topics["/scene"] for entity in scene.entities if entity.id == name]

    def latest(self, topic: str, at_ns: int) -> Any:
        """The newest message of a topic that may be drawn in a scene of that time: one tick may lie between."""
        return [message for time_ns, message in self.topics[topic] if at_ns - TICK_NS - 1 <= time_ns <= at_ns]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """A flight in which all engage, within a fence, read as anybody would."""
    text = (MISSIONS / "case2-field.toml").read_text(encoding="utf-8")
    near = put(content(text), ("target", "start_m"), [13.0, -5.0])
    fenced = put(near, ("safety", "fence_m"), FENCE_M)
    mission = parsed(put(fenced, ("vehicles", 1, "fence_m"), OWN_FENCE_M))
    path = tmp_path_factory.mktemp("scene") / "flight.mcap"
    run = run_of(mission, mission.ids, seed=3, source="simulation", speed=1.0, began_s=0.0, duration_s=40.0)
    context = Context()
    recording = SimulationRecording(LogWriter(path, context, Scene(context, mission)), run)
    fly_simulated(mission, 3, 40.0, lambda _: None, recording)
    topics = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            topics[channel.topic].append((message.log_time, decoded))
    return Seen(topics, path)


def place(position: Any) -> tuple[float, float, float]:
    return position.x, position.y, position.z


def same(one: Any, other: Any) -> bool:
    """Whether two messages are equal, whichever schema each was read by."""
    return bool(one.SerializeToString() == other.SerializeToString())


def test_the_team_is_shown_five_times_a_second_and_everything_keeps_its_id(flight: Seen) -> None:
    times_s = [at / 1e9 for at, _ in flight.topics["/scene"]]
    assert np.diff(times_s) == pytest.approx(PERIOD_S, abs=1e-6)
    assert times_s[-1] == pytest.approx(40.0, abs=0.3)
    names = [[entity.id for entity in scene.entities] for _, scene in flight.topics["/scene"]]
    assert len(set(names[-1])) == len(names[-1])
    assert all(each == names[-1] for each in names[1:]), "something is there in one scene, and missing in another"
    for topic in ("/tf", "/points", *(f"/vehicle/{i}/{name}" for i in VEHICLES for name in ("pose", "location"))):
        assert len(flight.topics[topic]) >= len(names) - 1, topic


def test_vehicles_are_where_their_telemetry_says_and_look_where_they_fly(flight: Seen) -> None:
    for vehicle_id in VEHICLES:
        for at, entity in flight.entities(f"vehicle {vehicle_id}"):
            told = {tuple(each.position_m): each for each in flight.latest(f"/vehicle/{vehicle_id}/telemetry", at)}
            telemetry = told[place(entity.arrows[0].pose.position)]
            turn = entity.arrows[0].pose.orientation
            x_rate, y_rate, _ = telemetry.velocity_m_s
            if hypot(x_rate, y_rate) > 0.31:
                # A quaternion turns (1, 0, 0) to (w² + x² - y² - z², 2 (x y + w z), 2 (x z - w y)).
                ahead = turn.w**2 + turn.x**2 - turn.y**2 - turn.z**2, 2.0 * (turn.x * turn.y + turn.w * turn.z)
                assert ahead == pytest.approx((x_rate / hypot(x_rate, y_rate), y_rate / hypot(x_rate, y_rate)))
            assert entity.texts[0].text.startswith(f"{vehicle_id} ")


def test_poses_and_transforms_say_what_the_scene_shows(flight: Seen) -> None:
    scenes = dict(flight.topics["/scene"])
    for at, transforms in flight.topics["/tf"]:
        drawn = {entity.id: entity for entity in scenes[at].entities}
        for transform in transforms.transforms:
            assert transform.parent_frame_id == "mission"
            name = transform.child_frame_id.replace("_", " ")
            assert place(transform.translation) == place(drawn[name].arrows[0].pose.position)
            assert same(transform.rotation, drawn[name].arrows[0].pose.orientation)
    for vehicle_id in VEHICLES:
        drawn_at = dict(flight.entities(f"vehicle {vehicle_id}"))
        for at, pose in flight.topics[f"/vehicle/{vehicle_id}/pose"]:
            assert pose.frame_id == "mission"
            assert same(pose.pose, drawn_at[at].arrows[0].pose)
            assert 0 <= at - (pose.timestamp.seconds * 10**9 + pose.timestamp.nanos) <= TICK_NS + 1


def test_places_on_earth_lie_where_geodesics_lead(flight: Seen) -> None:
    wgs84, origin = Geod(ellps="WGS84"), (8.545594, 47.397742)
    for vehicle_id in VEHICLES:
        poses = dict(flight.topics[f"/vehicle/{vehicle_id}/pose"])
        for at, fix in flight.topics[f"/vehicle/{vehicle_id}/location"]:
            east_m, y, z = place(poses[at].pose.position)  # x points east in this mission, so y points north
            azimuth_deg, _, distance_m = wgs84.inv(*origin, fix.longitude, fix.latitude)
            there_m = distance_m * sin(radians(azimuth_deg)), distance_m * cos(radians(azimuth_deg))
            # 496 m above the ellipsoid a metre is a little longer than on it.
            assert there_m == pytest.approx((east_m, y), abs=0.01)
            assert fix.altitude == pytest.approx(488.0 + z, abs=0.01)


def test_the_ring_wanted_lies_about_the_target_that_was_sighted_last(flight: Seen) -> None:
    drawn = 0
    for (at, ring), (_, target) in zip(flight.entities("ring"), flight.entities("target"), strict=True):
        if not ring.lines:
            continue
        drawn += 1
        (line,) = ring.lines
        assert [hypot(point.x, point.y) for point in line.points] == pytest.approx([10.0] * len(line.points))
        assert line.pose.position.z == 8.0
        centre = place(target.spheres[0].pose.position)[:2]
        assert place(line.pose.position)[:2] == centre
        near = [flight.latest(f"/vehicle/{i}/decision", at) for i in VEHICLES]
        believed = [[decision.target for decision in each if decision.HasField("target")] for each in near]
        told = {tuple(belief.mean[:2]): belief for each in believed for belief in each}
        heard_s = [min(belief.sighted_s for belief in each) for each in believed if each]
        assert told[centre].sighted_s >= max(heard_s), "somebody has seen it since"
    assert drawn > 100


def test_the_ellipse_holds_95_percent_of_what_a_vehicle_believes(flight: Seen) -> None:
    scale = chi2.ppf(0.95, 2)
    drawn = 0
    for vehicle_id in VEHICLES:
        for at, entity in flight.entities(f"vehicle {vehicle_id} target"):
            if not entity.cylinders:
                continue
            drawn += 1
            (area,) = entity.cylinders
            near = flight.latest(f"/vehicle/{vehicle_id}/decision", at)
            told = {tuple(d.target.mean[:2]): d.target for d in near if d.HasField("target")}
            belief = told[place(area.pose.position)[:2]]
            covariance = np.array(belief.covariance).reshape(4, 4)[:2, :2]
            variances, directions = np.linalg.eigh(covariance)
            axes_m = 2.0 * np.sqrt(scale * variances)
            assert (area.size.y, area.size.x) == pytest.approx(tuple(axes_m), rel=1e-9)
            if variances[1] > 1.01 * variances[0]:
                yaw_rad = 2.0 * atan2(area.pose.orientation.z, area.pose.orientation.w)
                along = np.array([cos(yaw_rad), sin(yaw_rad)])
                assert abs(along @ directions[:, 1]) == pytest.approx(1.0, abs=1e-9)
    assert drawn > 100


@given(st.floats(-3.0, 3.0), st.floats(0.01, 30.0), st.floats(1.1, 30.0))
def test_an_ellipse_lies_along_the_larger_variance(yaw_rad: float, variance_m2: float, ratio: float) -> None:
    turn = np.array([[cos(yaw_rad), -sin(yaw_rad)], [sin(yaw_rad), cos(yaw_rad)]])
    covariance = turn @ np.diag([ratio * variance_m2, variance_m2]) @ turn.T
    long_m, short_m, found_rad = ellipse((covariance[0, 0], covariance[0, 1], covariance[1, 1]))
    half_axes_m = np.sqrt(chi2.ppf(0.95, 2) * variance_m2 * np.array([ratio, 1.0]))
    assert (long_m, short_m) == pytest.approx(tuple(half_axes_m), rel=1e-6)
    assert sin(found_rad - yaw_rad) == pytest.approx(0.0, abs=1e-6)


def test_a_vehicle_that_flies_looks_ahead_unless_it_is_told_where_to_look(
    make_config: Callable[..., AgentConfig],
) -> None:
    nothing = (None, None, None, None, None, None, None, "", (), (), (), (), 0)
    told = Decision(9.0, "encircle", 1.0, Setpoint((0.0, 0.0, 8.0), -1.2), *nothing)
    sideways = Telemetry(9.0, (1.0, 2.0, 8.0), (0.0, 1.5, 0.0))
    for config, yaw_rad in ((make_config(), pi / 2.0), (make_config(encirclement={"yaw": "target"}), -1.2)):
        seen = DrawnVehicle(config, "#000000", decision=told)
        seen.move(sideways, 9)
        assert seen.yaw_rad == pytest.approx(yaw_rad)


def test_of_several_beliefs_the_one_heard_of_last_is_shown() -> None:
    def seen(vehicle_id: int, sighted_s: float | None) -> DrawnVehicle:
        belief = (
            None
            if sighted_s is None
            else TargetState(9.0, (sighted_s, 0.0, 0.0, 0.0), (0.0,) * 16, sighted_s, 0.8, 0.2)
        )
        nothing = (None, None, None, None, None, "", (), (), (), (), 0)
        decision = Decision(9.0, "encircle", 1.0, None, None, belief, *nothing)
        return DrawnVehicle(CONFIG, "#000000", decision=decision)

    team = [seen(1, 3.0), seen(2, None), seen(3, 8.5), seen(4, 7.0)]
    target = newest_target(team)
    assert target is not None
    assert target.mean[0] == 8.5
    assert newest_target([seen(1, None)]) is None


def test_several_rings_lie_about_their_own_targets_by_the_vehicles_on_them(tmp_path: Path) -> None:
    """North, of 10 m, lies about the boat; south, of 14 m and 7 m high, and high, of 8 m at 12 m, about the buoy."""
    mission, context, path = with_rings(parsed(content())), Context(), tmp_path / "rings.mcap"
    with foxglove.open_mcap(path, context=context):
        scene = Scene(context, mission)
        beliefs = ((1, NORTH, 30.0, 3.0), (2, SOUTH, 110.0, 5.0), (3, HIGH, 111.0, 6.0))
        for at_s, (vehicle_id, ring, x_m, sighted_s) in enumerate(beliefs, 1):
            belief = TargetState(9.0, (x_m, 1.0, 0.0, 0.0), (0.1,) + (0.0,) * 15, sighted_s, 0.8, 0.2)
            nothing = (None, None, None, None, None, "", (), (), (), (), 0)
            scene(vehicle_id, at_s, Telemetry(at_s, (0.0, 0.0, 8.0), (0.0, 0.0, 0.0)))
            scene(vehicle_id, at_s, Decision(at_s, "encircle", 1.0, None, None, belief, *nothing, ring=ring))
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        read = [(channel.topic, decoded) for _, channel, _, decoded in reader.iter_decoded_messages()]
    first, _, last = ({each.id: each for each in decoded.entities} for topic, decoded in read if topic == "/scene")
    circles = {"north": (30.0, 10.0, 8.0), "south": (111.0, 14.0, 7.0), "high": (111.0, 8.0, 12.0)}
    for name, (x_m, radius_m, height_m) in circles.items():
        (outline,), (text,) = last[f"ring {name}"].lines, last[f"ring {name}"].texts
        assert place(outline.pose.position) == (x_m, 1.0, height_m)
        assert {round(hypot(each.x, each.y), 9) for each in outline.points} == {radius_m}
        assert text.text == name
    for name, x_m in (("boat", 30.0), ("buoy", 111.0)):
        assert place(last[f"target {name}"].spheres[0].pose.position) == (x_m, 1.0, 0.0)
        assert last[f"target {name}"].texts[0].text == name
    assert [len(first[f"ring {name}"].lines) for name in circles] == [1, 0, 0], "nothing is known of the buoy yet"
    assert not first["target buoy"].spheres
    cloud = [decoded for topic, decoded in read if topic == "/points"][-1]
    points = np.frombuffer(cloud.data, np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)]))
    for planned, (x_m, radius_m, height_m) in zip(drawn_rings(mission), circles.values(), strict=True):
        drawn = points["xyz"][(points["rgba"][:, :3] == list(bytes.fromhex(planned.colour[1:]))).all(axis=1)]
        assert len(drawn) > 8
        assert np.hypot(drawn[:, 0] - x_m, drawn[:, 1] - 1.0) == pytest.approx(radius_m, abs=1e-4)
        assert set(drawn[:, 2]) == {height_m}


def test_bubbles_touch_at_the_separation_and_are_red_while_the_guard_intervenes(flight: Seen) -> None:
    shades = set()
    for vehicle_id in VEHICLES:
        for at, entity in flight.entities(f"vehicle {vehicle_id} separation"):
            (bubble,) = entity.cylinders
            assert (bubble.size.x, bubble.size.y, bubble.size.z) == (3.0, 3.0, 2.0)
            near = flight.latest(f"/vehicle/{vehicle_id}/decision", at)
            red = bytes(round(255.0 * part) for part in (bubble.color.r, bubble.color.g, bubble.color.b)) == RED
            shades.add(red)
            assert red in {bool(decision.guard.causes) for decision in near}
    assert shades == {True, False}, "the guard did nothing in this flight, or nothing else"


def test_slots_stand_abreast_and_move_on_with_the_line_while_they_are_flown(flight: Seen) -> None:
    slots = {
        i: {at: e.lines[0].pose.position for at, e in flight.entities(f"vehicle {i} slot") if e.lines} for i in VEHICLES
    }
    together = sorted(set(slots[1]) & set(slots[2]) & set(slots[3]))
    assert len(together) > 5
    for at in together[1:]:
        one, two, three = (place(slots[i][at]) for i in VEHICLES)
        assert (one[1] - two[1], two[1] - three[1]) == pytest.approx((5.0, 5.0))
        assert two == pytest.approx((0.2 * at / 1e9, 0.0, 8.0), abs=0.021)
    last = flight.entities("vehicle 2 slot")[-1][1]
    assert not last.lines, "it has left the formation, and its slot is still shown"


def test_the_fences_are_the_missions_and_a_vehicles_own(flight: Seen) -> None:
    for _, entity in flight.entities("fence"):
        drawn = [[[point.x, point.y] for point in each.points] for each in entity.lines]
        assert drawn == [FENCE_M, OWN_FENCE_M]


def test_setpoints_and_trails_are_what_was_sent_and_flown(flight: Seen) -> None:
    for vehicle_id in VEHICLES:
        for at, entity in flight.entities(f"vehicle {vehicle_id} setpoint")[1:]:
            sent = [tuple(d.setpoint.position_m) for d in flight.latest(f"/vehicle/{vehicle_id}/decision", at)]
            assert place(entity.spheres[0].pose.position) in sent
        _, trail = flight.entities(f"vehicle {vehicle_id} trail")[-1]
        flown = np.array([each.position_m for _, each in flight.topics[f"/vehicle/{vehicle_id}/telemetry"]])
        points = np.array([place(point) for point in trail.lines[0].points])
        assert 38 <= len(points) <= 41
        nearest_m = np.abs(points[:, None] - flown[None]).max(axis=2).min(axis=1)
        assert nearest_m.max() <= 1.0 / 128.0


def test_notes_are_events_with_a_level(flight: Seen) -> None:
    levels = {"tactic": 2, "command": 2, "guard": 3, "failsafe": 4}
    told = {(log.name, log.level, log.message) for _, log in flight.topics["/log"]}
    notes = {
        (f"vehicle {i}", levels[note.kind], f"{note.text} ({note.because})" if note.because else note.text)
        for i in VEHICLES
        for _, decision in flight.topics[f"/vehicle/{i}/decision"]
        for note in decision.notes
    }
    assert told == notes
    assert {name for name, _, _ in told} == {"vehicle 1", "vehicle 2", "vehicle 3"}


def test_points_show_the_same_to_viewers_without_scenes(flight: Seen) -> None:
    at, cloud = flight.topics["/points"][-1]
    layout = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])
    assert cloud.point_stride == layout.itemsize
    assert [(field.name, field.offset) for field in cloud.fields] == [
        *(("x", 0), ("y", 4), ("z", 8)),
        *(("red", 12), ("green", 13), ("blue", 14), ("alpha", 15)),
    ]
    points = np.frombuffer(cloud.data, layout)
    target = place(dict(flight.entities("target"))[at].spheres[0].pose.position)
    for vehicle_id in VEHICLES:
        here = place(dict(flight.entities(f"vehicle {vehicle_id}"))[at].arrows[0].pose.position)
        assert np.abs(points["xyz"] - np.array(here)).max(axis=1).min() < 1e-5
    grey = points["xyz"][(points["rgba"][:, :3] == 0x8A).all(axis=1)]
    ring = grey[grey[:, 2] == 8.0]
    assert np.hypot(*(ring[:, :2] - np.array(target[:2])).T) == pytest.approx(10.0, abs=1e-4)
    fence = grey[grey[:, 2] == 0.0]
    assert (fence[:, 0].min(), fence[:, 0].max(), fence[:, 1].min(), fence[:, 1].max()) == (-20.0, 120.0, -15.0, 40.0)


def test_the_log_is_read_as_if_there_were_no_pictures(flight: Seen) -> None:
    log = read_log(flight.path)
    assert log.faults == []
    kinds = {f"/vehicle/{i}/{VEHICLE_TOPICS[each.kind]}" for i, records in log.vehicles.items() for each in records}
    pictures = {f"/vehicle/{i}/{name}" for i in VEHICLES for name in ("pose", "location")}
    assert set(flight.topics) - kinds == pictures | {"/run", "/end", "/carried", "/scene", "/points", "/tf", "/log"}


def test_a_picture_that_fails_does_not_cost_the_log(tmp_path: Path) -> None:
    asked: list[int] = []

    def fail(vehicle_id: int, _time_ns: int, _record: object) -> None:
        asked.append(vehicle_id)
        raise ValueError("a bug")

    path = tmp_path / "log.mcap"
    recorder = Recorder(LogWriter(path, Context(), fail), lambda: 1.0, lambda: 1.0)
    for number in range(3):
        recorder.note(1, number, Tick(float(number)))
    recorder.close()
    assert asked == [1]
    assert recorder.fault == "the messages for viewers ended: ValueError: a bug"
    with path.open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        assert [decoded.now_s for _, _, _, decoded in messages] == [0.0, 1.0, 2.0]


def test_the_layout_shows_topics_and_fields_that_there_are(flight: Seen, tmp_path: Path) -> None:
    log.layout(options=log.LayoutOptions(output=tmp_path / "layout.json"))
    layout = json.loads((tmp_path / "layout.json").read_text(encoding="utf-8"))
    panels = layout["configById"]
    assert sorted(_panels(layout["layout"])) == sorted(panels)
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    assert len(paths) == 4 * 4
    known = [path for path in paths if not path.startswith("/vehicle/4/")]
    assert len(known) == 4 * len(VEHICLES)
    for path in known:
        topic, _, fields = path.partition(".")
        message = flight.topics[topic][-1][1]
        for name in fields.removesuffix(".@rad2deg").split("."):
            message = getattr(message, name)
        assert isinstance(message, float)
    shown = panels["3D!cordon"]["topics"]
    assert panels["RosOut!cordon"]["topicToRender"] in flight.topics
    assert {topic for topic in shown if "4" not in topic} <= set(flight.topics)
    assert panels["3D!cordon"]["followTf"] == flight.topics["/scene"][0][1].entities[0].frame_id


def _panels(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else _panels(node["first"]) + _panels(node["second"])


def test_a_mission_that_lies_nowhere_on_earth_has_no_places_there(tmp_path: Path) -> None:
    near = content((MISSIONS / "case2.toml").read_text(encoding="utf-8"))
    mission = parsed({**near, "frame": {"local": True}})
    run = run_of(mission, mission.ids, seed=3, source="simulation", speed=1.0, began_s=0.0, duration_s=1.0)
    context = Context()
    recording = SimulationRecording(LogWriter(tmp_path / "log.mcap", context, Scene(context, mission)), run)
    fly_simulated(mission, 3, 1.0, lambda _: None, recording)
    with (tmp_path / "log.mcap").open("rb") as stream:
        topics = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
    assert recording.writer.fault == ""
    assert "/vehicle/1/pose" in topics
    assert "/vehicle/1/location" not in topics
