"""A flight log as a bag of ROS 2: a folder with an MCAP file of the profile `ros2`, and its metadata.yaml."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from heapq import merge
from pathlib import Path
from typing import Any, Final, NamedTuple

from agents.inputs import Start
from estimation.state import Telemetry
from gcs.errors import InputError
from gcs.flightlog.reader import FlightLog, LogRecord
from gcs.flightlog.records import Decision
from gcs.flightlog.run import mission_of, unix_offset_s
from gcs.keys.private_files import FILE_MODE, FOLDER_MODE, require_absent
from gcs.mission.mission import Mission
from gcs.ros2.enu import MAP, enu_from_mission, yaw_enu_rad
from gcs.ros2.messages import MARKERS, POSE, TRANSFORMS, TWIST, Messages, Shape
from gcs.style import COLOURS
from gcs.viewer.drawing import SETPOINT_M, TARGET, TARGET_M, DrawnVehicle, ground_place, targets_seen
from gcs.viewer.scene import PERIOD_S, drawn_rings, vehicle_frame

_METADATA_VERSION: Final = 8
"""Of the metadata: the rosbag2 of Humble and of all later distributions reads it."""
_LINE_M = 0.1
_PROGRESS_STEP = 1000
_EARLY_S = 1e-6
Progress = Callable[[float], None]
"""Called with the share of the log that has been processed."""


class _Entry(NamedTuple):
    """A record of a vehicle."""

    vehicle_id: int
    record: LogRecord


class _Stamped(NamedTuple):
    """A message of ROS."""

    topic: str
    kind: str
    stamp_ns: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class Exported:
    """The number of messages of a bag, and the time that they span [s]."""

    messages: int
    seconds: float


def bag_path(log: Path) -> Path:
    """Return the default path of a log's bag."""
    return log.with_name(f"{log.stem}-ros2")


def pose_topic(vehicle_id: int) -> str:
    """Return the topic of a vehicle's poses; no part of a topic's name may begin with a digit."""
    return f"/{vehicle_frame(vehicle_id)}/pose"


def export(log: FlightLog, target: Path, progress: Progress) -> Exported:
    """Write a log as a bag: a new folder, which appears once it is complete.

    Raises LogError for a log without a readable mission, InputError if rosbags is missing, nothing can be shown, or the
    folder exists or cannot be written.
    """
    messages, mission = Messages(MAP), mission_of(log)
    flight = _ShownFlight(messages, mission, unix_offset_s(log))
    entries = _entries(log, mission.ids)
    with _new_bag(target, messages) as bag:
        for done, entry in enumerate(entries):
            for message in flight.take(entry):
                bag.write(message)
            if done % _PROGRESS_STEP == 0:
                progress(done / len(entries))
        if not bag.stamps_ns:
            raise InputError([f"{log.path}: it holds no position of a vehicle: there is nothing to export"])
    return Exported(bag.count, (max(bag.stamps_ns) - min(bag.stamps_ns)) / 1e9)


def _entries(log: FlightLog, vehicle_ids: tuple[int, ...]) -> list[_Entry]:
    """Return the records of the mission's vehicles that a bag shows, in the order of their times."""
    shown = (Telemetry, Decision, Start)
    tracks = [
        [_Entry(vehicle_id, each) for each in log.vehicles.get(vehicle_id, ()) if each.kind in shown]
        for vehicle_id in vehicle_ids
    ]
    return list(merge(*tracks, key=lambda entry: entry.record.time_ns))


@dataclass(slots=True)
class _ShownFlight:
    """The team as the records so far show it."""

    messages: Messages
    mission: Mission
    offset_s: float
    _shown_s: float | None = None
    _team: dict[int, DrawnVehicle] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for row, vehicle in enumerate(self.mission.vehicles):
            self._team[vehicle.id] = DrawnVehicle(self.mission.agent_config(vehicle), COLOURS[row % len(COLOURS)])

    def take(self, entry: _Entry) -> Iterator[_Stamped]:
        """Take the next record, and return the messages that are due."""
        vehicle, kind = self._team[entry.vehicle_id], entry.record.kind
        if kind is Telemetry:
            telemetry = entry.record.read(Telemetry)
            vehicle.move(telemetry, entry.record.time_ns)
            yield from self._motion(vehicle, telemetry)
        elif kind is Decision:
            decision = vehicle.decision = entry.record.read(Decision)
            if self._shown_s is None or not 0.0 <= decision.time_s - self._shown_s < PERIOD_S - _EARLY_S:
                self._shown_s = decision.time_s
                stamp_ns = self._stamp_ns(decision.time_s)
                yield _Stamped("/markers", MARKERS, stamp_ns, self.messages.markers(stamp_ns, list(self._shapes())))
        else:
            vehicle.start_s = entry.record.read(Start).at_s

    def _stamp_ns(self, time_s: float) -> int:
        return round((time_s + self.offset_s) * 1e9)

    def _motion(self, vehicle: DrawnVehicle, telemetry: Telemetry) -> Iterator[_Stamped]:
        frame, name = self.mission.mission_frame(), vehicle_frame(vehicle.vehicle_id)
        stamp_ns, yaw_rad = self._stamp_ns(telemetry.time_s), yaw_enu_rad(frame, vehicle.yaw_rad)
        place_m = enu_from_mission(frame, telemetry.position_m)
        velocity_m_s = enu_from_mission(frame, telemetry.velocity_m_s)
        transform = self.messages.transform(stamp_ns, name, place_m, yaw_rad)
        yield _Stamped(pose_topic(vehicle.vehicle_id), POSE, stamp_ns, self.messages.pose(stamp_ns, place_m, yaw_rad))
        yield _Stamped(f"/{name}/twist", TWIST, stamp_ns, self.messages.twist(stamp_ns, velocity_m_s))
        yield _Stamped("/tf", TRANSFORMS, stamp_ns, transform)

    def _shapes(self) -> Iterator[Shape]:
        frame, rings = self.mission.mission_frame(), drawn_rings(self.mission)
        team = [each for each in self._team.values() if each.telemetry is not None]
        for number, target in sorted(targets_seen(team, rings).items()):
            x, y, _ = ground_place(target)
            yield Shape("target", number, enu_from_mission(frame, (x, y, 0.0)), TARGET_M, TARGET)
            for row, ring in enumerate(rings):
                if ring.target == number:
                    outline_m = [enu_from_mission(frame, each) for each in (*ring.outline_m, ring.outline_m[0])]
                    place_m = enu_from_mission(frame, (x, y, ring.altitude_m))
                    yield Shape("ring", row, place_m, _LINE_M, ring.colour, outline_m)
        for vehicle in team:
            if vehicle.decision is not None and vehicle.decision.setpoint is not None:
                place_m = enu_from_mission(frame, vehicle.decision.setpoint.position_m)
                yield Shape("setpoint", vehicle.vehicle_id, place_m, SETPOINT_M, vehicle.colour)


class _Bag:
    """A bag that is written: the number of its messages, and the first and last of their stamps."""

    def __init__(self, writer: Any, messages: Messages) -> None:
        self._writer = writer
        self._messages = messages
        self._connections: dict[str, Any] = {}
        self.stamps_ns: tuple[int, ...] = ()
        self.count = 0

    def write(self, message: _Stamped) -> None:
        """Add a message; the first one on a topic opens it."""
        topic, kind, stamp_ns, payload = message
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._messages.store)
        self._writer.write(self._connections[topic], stamp_ns, payload)
        self.stamps_ns = (min((stamp_ns, *self.stamps_ns)), max((stamp_ns, *self.stamps_ns)))
        self.count += 1


@contextmanager
def _new_bag(target: Path, messages: Messages) -> Iterator[_Bag]:
    """Write a bag beside its place, and move it there at the end; nothing is left after an exception.

    Only its owner may read it, as the log. Raises InputError.
    """
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer  # noqa: PLC0415

    beside = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        require_absent(target)
        beside.mkdir(mode=FOLDER_MODE)
        try:
            # The bag's file has the name of its folder.
            writer = Writer(beside / target.name, version=_METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            with writer:
                yield _Bag(writer, messages)
            _make_private(beside / target.name)
            (beside / target.name).rename(target)
        finally:
            shutil.rmtree(beside)
    except OSError as error:
        raise InputError([f"--output: {str(target)!r}: {error.strerror or error}"]) from error


def _make_private(folder: Path) -> None:
    for path in folder.iterdir():
        path.chmod(FILE_MODE)
    folder.chmod(FOLDER_MODE)
