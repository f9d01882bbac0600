"""PX4's own log (.ulg), read through pyulog's public interface.

pyulog skips a record that it cannot parse, and reads the rest. pyulog 1.3 limits neither its search in damaged bytes
nor the size of the formats that a log declares; the file object passed to it does.
"""

import re
from collections.abc import Mapping, Sequence
from functools import cache
from io import BufferedReader, FileIO
from typing import Any, NamedTuple

import numpy as np
from pyulog import ULog

from estimation.frames import Geodetic, MissionFrame, euler_from_quaternion_rad, up_from_ned
from estimation.state import Vector
from gcs.autopilots.px4 import AUTOPILOT, state_name
from gcs.flightlog.container import LogError
from gcs.vehicle_logs.log_file import LogFile
from gcs.vehicle_logs.raw_log import US, RawLog, Samples, Stamps, stamps_us, vehicle_log
from gcs.vehicle_logs.vehicle_log import VehicleLog

FORMAT = "PX4 log (.ulg)"
SETPOINT, LOCAL, TRUTH = "trajectory_setpoint", "vehicle_local_position", "vehicle_local_position_groundtruth"
ATTITUDE, BATTERY, STATUS = "vehicle_attitude", "battery_status", "vehicle_status"
TOPICS = (SETPOINT, LOCAL, TRUTH, ATTITUDE, BATTERY, STATUS)
ARMED = 2
HEADER_BYTES, SUBSCRIPTION = 3, b"A"
READ_AGAIN_MAX, READ_BYTES_MIN = 16, 1 << 24
"""Bound of the bytes read: this multiple of the log's size, and this many for a small log."""
BYTES_A_READ_MIN, READS_MIN = 16, 200_000
"""Bound of the number of reads: an undamaged log has more bytes per read than this; pyulog reads zeros one by one."""

FIELDS_MAX = 200_000
"""Bound of the fields of all subscriptions together: a log of PX4 has a tenth of that."""
DEPTH_MAX = 16

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")

Columns = dict[str, Any]


def read_ulog(log: LogFile) -> tuple[VehicleLog, ...]:
    """Return the one vehicle's log; raises LogError when it cannot be read as one."""
    ulog, state = _parsed(log)
    topics: dict[str, Columns] = {}
    for data in ulog.data_list:  # sorted by instance: of several, the first is what the vehicle flies by
        topics.setdefault(data.name, data.data)
    raw = RawLog(
        path=log.name,
        format=FORMAT,
        sha256=log.sha256,
        autopilot=AUTOPILOT.name,
        firmware=_firmware(ulog),
        begin_us=min(int(ulog.start_timestamp), 2**62),
        notes=list(state.notes),
        is_damaged=state.is_damaged,
    )
    _add_motion(raw, topics)
    _add_battery(raw, topics)
    _add_status(raw, topics)
    _add_texts(raw, ulog)
    raw.parameters.update(_parameters(ulog))
    raw.system_id = _system_id(topics, raw)
    if not raw.samples and not raw.modes:
        raise LogError([f"{log.name}: it holds none of the topics {', '.join(TOPICS)}"])
    return (vehicle_log(raw),)


class _BoundedReader(BufferedReader):
    """The log file as pyulog reads it, with bounded work.

    While pyulog searches damaged bytes for the next record it can read them again and again, also beyond the end of the
    file; and a few bytes of formats can claim billions of fields. Beyond `READ_AGAIN_MAX` and the like, `read` returns
    nothing, as at the end of the file. A subscription with too many fields raises LogError.

    ULog has no checksums. pyulog takes a record of an unknown kind for one of a newer version; all kinds are letters,
    and any other is damage.
    """

    def __init__(self, log: LogFile, formats: Mapping[str, Any]) -> None:
        super().__init__(FileIO(str(log.path)))
        self._log = log
        self._formats = formats
        self._counts: dict[str, int] = {}
        self._kind = b""
        self._reached = 0
        self._cut_at: int | None = None
        self._cut_bytes, self._longest_bytes = 0, 0
        self._is_damaged = False
        self._left_bytes = READ_AGAIN_MAX * log.size_bytes + READ_BYTES_MIN
        self._left_reads = log.size_bytes // BYTES_A_READ_MIN + READS_MIN
        self._left_fields = FIELDS_MAX

    def read(self, size: int | None = -1, /) -> bytes:
        begin = self.tell()
        if self._exhausted():
            self._reached = self._reached or begin
            return b""
        data = super().read(size)
        self._left_bytes -= len(data)
        self._left_reads -= 1
        # A record is read in two steps: a header of three bytes, then the body. No bytes at all are a clean end.
        if size and len(data) < size and (data or size != HEADER_BYTES):
            self._cut_at = begin if size == HEADER_BYTES else begin - HEADER_BYTES
            self._cut_bytes = size
        elif data:
            self._cut_at = None
            self._longest_bytes = max(self._longest_bytes, len(data))
        if size == HEADER_BYTES:
            self._kind = data[2:]
            self._is_damaged |= len(data) == HEADER_BYTES and not self._kind.isalpha()
        elif self._kind == SUBSCRIPTION:
            self._count_fields(data[3:].decode(errors="ignore"))
        return data

    def _count_fields(self, topic: str) -> None:
        """Subtract the fields of a subscription, which pyulog expands one by one."""
        if topic not in self._counts:
            self._counts[topic] = _field_count(self._formats, topic)
        self._left_fields -= self._counts[topic]
        if self._left_fields < 0:
            raise LogError([f"{self._log.name}: damaged: its formats declare more fields than a PX4 log can have"])

    def _exhausted(self) -> bool:
        return self._left_bytes < 0 or self._left_reads < 0

    def close(self) -> None:
        """Store the position that pyulog reached."""
        if not self.closed and not self._exhausted():
            self._reached = self.tell()
        super().close()

    def state(self, corrupt: bool) -> "_FileState":
        """Return the file's state. A last record longer than all others is damaged, not cut off."""
        notes, size_bytes, is_damaged = [], self._log.size_bytes, corrupt or self._is_damaged
        if self._exhausted():
            is_damaged = True
            notes.append(f"damaged: not readable beyond byte {self._reached} of {size_bytes}")
        elif self._cut_at is not None and self._reached >= size_bytes:
            if self._cut_bytes > self._longest_bytes:
                is_damaged = True
                notes.append(f"damaged: not readable beyond byte {self._cut_at} of {size_bytes}")
            else:
                notes.append(f"ends in the middle of a record at byte {self._cut_at}")
        elif self._reached < size_bytes:
            is_damaged = True
            notes.append(f"not readable beyond byte {self._reached} of {size_bytes}")
        if corrupt or self._is_damaged:
            notes.append("damaged: unreadable records were skipped")
        return _FileState(tuple(notes), is_damaged)


class _FileState(NamedTuple):
    """The faults of a file, and whether it has others than an early end."""

    notes: tuple[str, ...]
    is_damaged: bool


def _field_count(formats: Mapping[str, Any], name: str) -> int:
    """Return how many fields and nested structures a format expands to; more than FIELDS_MAX if nested too deep."""

    @cache
    def count(name: str, depth: int) -> int:
        if name not in formats:
            return 1
        if depth > DEPTH_MAX:
            return FIELDS_MAX + 1
        nested: int = sum(max(1, size) * count(kind, depth + 1) for kind, size, _ in formats[name].fields)
        return 1 + nested

    return count(name, 0)


def _parsed(log: LogFile) -> tuple[Any, _FileState]:
    """Return pyulog's log, and the file's state; raises LogError.

    The formats all precede the first subscription. They are read first, to bound what the subscriptions expand to.
    """
    try:
        with _BoundedReader(log, {}) as file:
            formats = ULog(file, parse_header_only=True).message_formats
        with _BoundedReader(log, formats) as file:
            ulog = ULog(file, list(TOPICS))
    except LogError:
        raise
    except Exception as error:  # pyulog raises exceptions of many types for damaged bytes
        reason = str(error) or type(error).__name__
        raise LogError([f"{log.name}: cannot be read as a {FORMAT}: its beginning is damaged ({reason})"]) from error
    return ulog, file.state(ulog.file_corruption)


def _columns(log: str, topic: str, data: Columns, names: Sequence[str]) -> Vector:
    lacking = [name for name in names if name not in data]
    if lacking:
        raise LogError([f"{log}: {topic} has no {', '.join(lacking)}"])
    return np.column_stack([np.asarray(data[name], dtype=np.float64) for name in names])


def _stamps(log: str, topic: str, data: Columns) -> Stamps:
    try:
        return stamps_us(data["timestamp"])
    except (KeyError, ValueError):
        raise LogError([f"{log}: {topic} has no timestamp"]) from None


def _add_motion(raw: RawLog, topics: dict[str, Columns]) -> None:
    log = raw.path
    if (data := topics.get(SETPOINT)) is not None:
        names = ("x", "y", "z", "vx", "vy", "vz")
        if "position[0]" in data:
            names = ("position[0]", "position[1]", "position[2]", "velocity[0]", "velocity[1]", "velocity[2]")
        places, rates = (up_from_ned(_columns(log, SETPOINT, data, three)) for three in (names[:3], names[3:]))
        raw.add_setpoints(SETPOINT, _stamps(log, SETPOINT, data), places, rates)
    else:
        raw.missing.append(SETPOINT)
    if (data := topics.get(LOCAL)) is not None:
        stamps = _stamps(log, LOCAL, data)
        for name, fields, flags in (
            ("position", ("x", "y", "z"), ("xy_valid", "z_valid")),
            ("velocity", ("vx", "vy", "vz"), ("v_xy_valid", "v_z_valid")),
        ):
            values = up_from_ned(_columns(log, LOCAL, data, fields))
            values[_columns(log, LOCAL, data, flags).min(axis=1) < 1.0] = np.nan
            raw.samples[name] = Samples(LOCAL, stamps, values)
        resets = _columns(log, LOCAL, data, ("xy_reset_counter", "z_reset_counter"))
        raw.resets_us += stamps[1:][(np.diff(resets, axis=0) != 0.0).any(axis=1)].tolist()
    else:
        raw.missing.append(LOCAL)
    if (data := topics.get(TRUTH)) is not None:
        stamps = _stamps(log, TRUTH, data)
        shift_m = _origin_of_truth_m(raw, data, topics.get(LOCAL))
        position = up_from_ned(_columns(log, TRUTH, data, ("x", "y", "z")) + shift_m)
        raw.samples["true_position"] = Samples(TRUTH, stamps, position)
        velocity = up_from_ned(_columns(log, TRUTH, data, ("vx", "vy", "vz")))
        raw.samples["true_velocity"] = Samples(TRUTH, stamps, velocity)
    if (data := topics.get(ATTITUDE)) is not None:
        quaternions = _columns(log, ATTITUDE, data, ("q[0]", "q[1]", "q[2]", "q[3]"))
        values = up_from_ned(euler_from_quaternion_rad(quaternions))
        raw.samples["attitude"] = Samples(ATTITUDE, _stamps(log, ATTITUDE, data), values)


def _origin_of_truth_m(raw: RawLog, truth: Columns, local: Columns | None) -> Vector:
    """Return the simulator's local origin in the estimator's local NED [m]; the two origins differ."""
    simulator = _origin(raw.path, TRUTH, truth)
    estimator = _origin(raw.path, LOCAL, local) if local is not None else None
    if simulator is None or estimator is None:
        raw.notes.append(f"{TRUTH} refers to the simulator's own origin, whose position is not in the log")
        return np.zeros(3)
    place = np.array([(simulator.latitude_deg, simulator.longitude_deg, simulator.altitude_m)])
    return MissionFrame(estimator).ned_from_geodetics(*place.T).reshape(3)


def _origin(log: str, topic: str, data: Columns) -> Geodetic | None:
    """Return the last origin of a local frame in a topic."""
    references = _columns(log, topic, data, ("ref_lat", "ref_lon", "ref_alt"))
    references = references[np.isfinite(references).all(axis=1)]
    at_s = float(data["timestamp"][-1]) / US if "timestamp" in data else 0.0
    try:
        return Geodetic(*references[-1].tolist()) if references.size else None
    except ValueError as error:
        raise LogError([f"{log}: {topic} at {at_s:.3f} s since boot: its origin, {error}: wrong units"]) from None


def _add_battery(raw: RawLog, topics: dict[str, Columns]) -> None:
    if (data := topics.get(BATTERY)) is None:
        return
    values = _columns(raw.path, BATTERY, data, ("voltage_v", "current_a", "remaining"))
    values[:, 1:][values[:, 1:] < 0.0] = np.nan  # PX4's value for unknown
    raw.samples["battery"] = Samples(BATTERY, _stamps(raw.path, BATTERY, data), values)


def _add_status(raw: RawLog, topics: dict[str, Columns]) -> None:
    raw.mode_topic = STATUS
    if (data := topics.get(STATUS)) is None:
        raw.missing.append(STATUS)
        return
    stamps = _stamps(raw.path, STATUS, data).tolist()
    states = _columns(raw.path, STATUS, data, ("nav_state", "arming_state")).tolist()
    raw.modes += [(stamp, state_name(int(state))) for stamp, (state, _) in zip(stamps, states, strict=True)]
    raw.armed += [(stamp, arming == ARMED) for stamp, (_, arming) in zip(stamps, states, strict=True)]


def _add_texts(raw: RawLog, ulog: Any) -> None:
    tagged = [message for messages in ulog.logged_messages_tagged.values() for message in messages]
    for message in sorted([*ulog.logged_messages, *tagged], key=lambda message: int(message.timestamp)):
        severity = message.log_level - ord("0")
        text = _COLOURS.sub("", message.message).strip()
        raw.texts.append((int(message.timestamp), severity if 0 <= severity <= 7 else None, text))
    dropouts = ulog.dropouts
    if dropouts:
        lost_s = sum(dropout.duration for dropout in dropouts) / 1e3
        raw.notes.append(f"the logger had {len(dropouts)} dropouts, {lost_s:.2f} s in total")


def _parameters(ulog: Any) -> dict[str, int | float]:
    changed = {name: value for _, name, value in ulog.changed_parameters}
    named = {**ulog.initial_parameters, **changed}
    return {name: value for name, value in named.items() if isinstance(value, int | float)}


def _system_id(topics: dict[str, Columns], raw: RawLog) -> int:
    system_ids = topics.get(STATUS, {}).get("system_id")
    return int(system_ids[-1]) if system_ids is not None else int(raw.parameters.get("MAV_SYS_ID", 0))


def _firmware(ulog: Any) -> str:
    release, commit = ulog.get_version_info_str(), str(ulog.msg_info_dict.get("ver_sw", ""))[:8]
    return " ".join(part for part in (release, commit) if part)
