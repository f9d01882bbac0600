"""Flight logs as bags of ROS 2, read back by rosbags: times, frames and axes by a computation of the test's own."""

from collections.abc import Iterator
from math import atan2, cos, pi, remainder, sin, tau
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from estimation.state import Telemetry
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Decision
from gcs.ros2 import bag as bag_module
from gcs.ros2.bag import export
from tests.conftest import RunHere
from tests.support.cdr import pose_of
from tests.support.flight_logs import engaging, record_simulation

BEARING_DEG = 30.0
BEGAN_S = 1.7e9
ENU_FROM_MISSION = np.array(
    [  # columns: the mission's x axis, 30 degrees clockwise from north, its y axis, to the left of it, and up
        [sin(pi / 6), -cos(pi / 6), 0.0],
        [cos(pi / 6), sin(pi / 6), 0.0],
        [0.0, 0.0, 1.0],
    ]
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> FlightLog:
    """Return the log of a flight along a bearing of 30 degrees, until all are on the ring."""
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    record_simulation(engaging("case2-field", (("frame", "x_bearing_deg"), BEARING_DEG)), path, duration_s=30.0)
    return read_log(path)


@pytest.fixture(scope="module")
def bag(log: FlightLog) -> Path:
    """Return the log's bag."""
    path = log.path.with_name("bag")
    export(log, path, lambda _share: None)
    return path


def messages(bag: Path, topic: str) -> Iterator[tuple[int, bytes, Any]]:
    """Return the time, the bytes and the content of the messages on a topic."""
    with AnyReader([bag]) as reader:  # by the definitions in the file
        for connection, time_ns, raw in reader.messages([each for each in reader.connections if each.topic == topic]):
            yield time_ns, raw, reader.deserialize(raw, connection.msgtype)


def seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec / 1e9)


def telemetry(log: FlightLog, vehicle_id: int) -> list[Telemetry]:
    return list(log.of_kind(vehicle_id, Telemetry))


def test_a_bag_has_what_ros_expects(log: FlightLog, bag: Path) -> None:
    """Profile, encodings and topics, also as one file without metadata.yaml."""
    (file,) = bag.glob("*.mcap")
    assert file.read_bytes()[17:25].startswith(b"\x04\x00\x00\x00ros2"), "the profile, behind magic and record head"
    expected = {"/tf": "tf2_msgs/msg/TFMessage", "/markers": "visualization_msgs/msg/MarkerArray"}
    for number in (1, 2, 3):
        expected[f"/vehicle_{number}/pose"] = "geometry_msgs/msg/PoseStamped"
        expected[f"/vehicle_{number}/twist"] = "geometry_msgs/msg/TwistStamped"
    for path in (bag, file):
        with Reader(path) as reader:
            assert {each.topic: each.msgtype for each in reader.connections} == expected
            assert {each.msgdef.format.name for each in reader.connections} == {"MSG"}
            assert reader.message_count == sum(1 for _ in reader.messages(reader.connections))
            assert reader.start_time == pytest.approx(BEGAN_S * 1e9, abs=1e9)
    assert {path.stat().st_mode & 0o077 for path in (bag, *bag.iterdir())} == {0}
    assert sum(1 for _ in messages(bag, "/vehicle_2/pose")) == len(telemetry(log, 2))


def test_poses_are_east_north_up_at_the_time_of_the_flight(log: FlightLog, bag: Path) -> None:
    first_s = min(records[0].time_ns for records in log.vehicles.values()) / 1e9
    moved = 0
    for sample, (time_ns, raw, pose), (_, _, twist) in zip(
        telemetry(log, 2), messages(bag, "/vehicle_2/pose"), messages(bag, "/vehicle_2/twist"), strict=True
    ):
        by_hand = pose_of(raw)
        assert by_hand.frame == pose.header.frame_id == "map"
        stamp_s = by_hand.seconds + by_hand.nanoseconds / 1e9
        assert stamp_s == pytest.approx(BEGAN_S + sample.time_s - first_s, abs=1e-6)
        assert seconds(pose.header.stamp) == stamp_s == pytest.approx(time_ns / 1e9, abs=1e-6)
        assert by_hand.place_m == pytest.approx(ENU_FROM_MISSION @ sample.position_m, abs=1e-9)
        velocity_m_s = ENU_FROM_MISSION @ sample.velocity_m_s
        linear, angular = twist.twist.linear, twist.twist.angular
        assert (linear.x, linear.y, linear.z) == pytest.approx(velocity_m_s, abs=1e-9)
        assert (angular.x, angular.y, angular.z) == (0.0, 0.0, 0.0)
        if np.hypot(*velocity_m_s[:2]) > 0.5:
            moved += 1
            x, y, z, w = by_hand.rotation
            assert (x, y) == (0.0, 0.0)
            assert remainder(2.0 * atan2(z, w) - atan2(velocity_m_s[1], velocity_m_s[0]), tau) == pytest.approx(0.0)
    assert moved > 20, "it has to move, or its yaw shows nothing"


def test_transforms_lead_from_the_map_to_the_vehicles(log: FlightLog, bag: Path) -> None:
    found = {number: list[Any]() for number in (1, 2, 3)}
    for _, _, message in messages(bag, "/tf"):
        (transform,) = message.transforms
        assert transform.header.frame_id == "map"
        found[int(transform.child_frame_id.removeprefix("vehicle_"))].append(transform)
    for number, transforms in found.items():
        for sample, each in zip(telemetry(log, number), transforms, strict=True):
            moved = each.transform.translation
            assert (moved.x, moved.y, moved.z) == pytest.approx(ENU_FROM_MISSION @ sample.position_m, abs=1e-9)


def test_markers_show_target_ring_and_setpoints(log: FlightLog, bag: Path) -> None:
    """The last ones: the ring is about the target, of the mission's radius, and each setpoint is its vehicle's."""
    *_, (_, _, last) = messages(bag, "/markers")
    shown = {(each.ns, each.id): each for each in last.markers}
    assert set(shown) == {("target", 0), ("ring", 0), *(("setpoint", number) for number in (1, 2, 3))}
    assert {each.header.frame_id for each in last.markers} == {"map"}
    target, ring = shown["target", 0], shown["ring", 0]
    assert (target.type, ring.type) == (2, 4), "a sphere, and a line"
    centre = np.array([ring.pose.position.x, ring.pose.position.y])
    assert centre == pytest.approx([target.pose.position.x, target.pose.position.y])
    radii_m = [np.hypot(each.x, each.y) for each in ring.points]
    assert radii_m == pytest.approx([10.0] * len(radii_m))
    for number in (1, 2, 3):
        place = shown["setpoint", number].pose.position
        newest = [each.setpoint.position_m for each in log.of_kind(number, Decision) if each.setpoint][-4:]
        distances_m = [np.linalg.norm(ENU_FROM_MISSION @ each - (place.x, place.y, place.z)) for each in newest]
        assert min(distances_m) < 1e-9, "markers are due every second tick"


def test_nothing_is_left_of_a_bag_that_is_interrupted(
    log: FlightLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the target appears only when it is whole: a kill leaves a hidden folder."""
    target = tmp_path / "bag"

    def interrupt(_share: float) -> None:
        assert not target.exists()
        (beside,) = tmp_path.iterdir()
        assert beside.name.startswith(".bag.")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(log, target, interrupt)
    assert list(tmp_path.iterdir()) == []


def test_bad_input_ends_in_2_and_names_what_is_wrong(
    log: FlightLog, bag: Path, run_here: RunHere, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    (tmp_path / "none.mcap").write_bytes(b"no log")
    for words, named in (
        ((str(log.path),), "--ros2"),
        (("--ros2", str(log.path), "-o", str(bag)), f"{str(bag)!r} exists already"),
        (("--ros2", str(log.path), "-o", str(tmp_path / "missing" / "bag")), "--output: no folder"),
        (("--ros2", str(tmp_path / "none.mcap")), "it is not an MCAP file"),
        (("--ros2", str(tmp_path / "absent.mcap")), "absent.mcap"),
    ):
        with subtests.test(named):
            ran = run_here("log", "export", *words)
            assert ran.code == 2
            assert named in ran.err


def test_without_rosbags_the_next_step_is_named(
    log: FlightLog, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rosbags.typesys", None)
    ran = run_here("log", "export", "--ros2", str(log.path))
    assert ran.code == 2
    assert "pip install 'cordon-gcs[ros2]'" in ran.err


def test_the_command_writes_a_bag_beside_the_log(log: FlightLog, run_here: RunHere) -> None:
    ran = run_here("log", "export", "--ros2", str(log.path))
    assert ran.code == 0
    with Reader(bag_module.bag_path(log.path)) as reader:
        assert f"{reader.message_count} messages" in ran.err
