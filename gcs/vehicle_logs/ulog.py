"""PX4's own log (.ulg), read through pyulog's public interface.

This module cuts the records, and pyulog parses those that are needed: pyulog 1.3 limits neither its search in damaged
bytes nor the size of the formats that a log declares.
"""

import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from io import BytesIO
from itertools import pairwise
from types import MappingProxyType
from typing import Any

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
MAGIC = b"ULog\x01\x12\x35"
FILE_HEADER_BYTES, HEADER = 16, struct.Struct("<HB")
KINDS = b"ABCDFILMOPQRS"
FORMAT_OF, SUBSCRIPTION, DATA, PARAMETER, DROPOUT = b"FADPO"
DEFINITIONS, TEXTS = b"FI", b"LC"
LEAST_BYTES = MappingProxyType({SUBSCRIPTION: 4, DATA: 10, PARAMETER: 5, ord("L"): 9, ord("C"): 11, DROPOUT: 2})
"""pyulog ends at a shorter record."""
PARAMETER_BYTES = 4
FLAGS = struct.Struct("<8sQ3Q")
"""The record of flags: compatible and incompatible ones, and where data begins that was appended after a crash."""
APPENDED = 1
"""The only incompatible flag that is known: data was appended."""
CHAIN_RECORDS = 3
"""After damage, reading goes on where this many records follow one another."""
UNKNOWN_MAX_BYTES = 10_000
"""Most bytes of a record of an unknown kind; a larger one is damage."""
SEARCH_AGAIN_MAX, SEARCH_MIN_BYTES = 16, 1 << 24
"""Bound of the bytes searched for records: this multiple of the log's size, and this many for a small log."""

FIELDS_MAX = 200_000
"""Bound of the fields of all subscriptions together: a log of PX4 has a tenth of that."""
DEPTH_MAX = 16

_KIND = re.compile(b"[%s]" % KINDS)
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")

Columns = dict[str, Any]


def read(log: LogFile) -> tuple[VehicleLog, ...]:
    """Return the one vehicle's log; raises LogError when it cannot be read as one."""
    data = log.content()
    begins = [match.start() for match in re.finditer(re.escape(MAGIC), data)]
    read, faults = list[VehicleLog](), list[str]()
    for begin, end in pairwise([*begins, len(data)]):
        try:
            read.append(_read(log, data[begin:end]))
        except LogError as error:
            faults += error.faults
    if not read:
        raise LogError(faults)
    longest = max(read, key=lambda each: each.duration_s)
    if len(begins) > 1:
        lengths = ", ".join(f"{each.duration_s:.1f}" for each in read)
        which = (
            f"of {len(begins)} logs in the file ({lengths} s) the longest was read, number {read.index(longest) + 1}"
        )
        longest = replace(longest, notes=(which, *longest.notes, *faults))
    return (longest,)


def _read(log: LogFile, data: bytes) -> VehicleLog:
    records = _WholeRecords(log, data)
    ulog = _parsed(log, records)
    topics: dict[str, Columns] = {}
    for each in ulog.data_list:  # sorted by instance: of several, the first is what the vehicle flies by
        topics.setdefault(each.name, each.data)
    if ulog.file_corruption and not records.is_damaged:
        records.notes.append("damaged: unreadable records were skipped")
    raw = RawLog(
        path=log.name,
        format=FORMAT,
        sha256=log.sha256,
        autopilot=AUTOPILOT.name,
        firmware=_firmware(ulog),
        begin_us=min(int(ulog.start_timestamp), 2**62),
        notes=records.notes,
        is_damaged=records.is_damaged or ulog.file_corruption,
    )
    _add_motion(raw, topics)
    _add_battery(raw, topics)
    _add_status(raw, topics)
    _add_texts(raw, ulog)
    raw.parameters.update(_parameters(ulog))
    raw.system_id = _system_id(topics, raw)
    if not raw.samples and not raw.modes:
        raise LogError([f"{log.name}: it holds none of the topics {', '.join(TOPICS)}"])
    return vehicle_log(raw)


class _WholeRecords:
    """The undamaged records that are needed, one after another in `whole` as pyulog reads them.

    ULog has no checksums: a record is known by its kind, its length and, if it holds data, by its subscription. pyulog
    1.3 goes on after damage only where a log has marks, and ends at a record that is too short.
    """

    def __init__(self, log: LogFile, data: bytes) -> None:
        self._data, self._end = data, len(data)
        self._left_bytes = SEARCH_AGAIN_MAX * len(data) + SEARCH_MIN_BYTES
        self._timed: set[bytes] = set()
        self._is_needed: dict[int, bool] = {}
        self._is_defining = True
        self._skipped_bytes = 0
        self.topics: list[str] = []
        self.notes = log.notes
        pieces = [data[:FILE_HEADER_BYTES]]
        for part, end_of_part in pairwise(self._edges(log.name)):
            self._end = end_of_part
            for begin, end in self._split(part):
                pieces.append(self._needed(begin, end))
        self.whole = b"".join(pieces)
        self.is_damaged = self._skipped_bytes > 0
        if self.is_damaged:
            self.notes.append(f"damaged: {self._skipped_bytes} bytes were skipped")

    def _edges(self, name: str) -> list[int]:
        """Return where the parts of the log begin and end: what was appended after a crash is a part of its own."""
        begin = FILE_HEADER_BYTES + HEADER.size
        flags = self._data[begin : begin + FLAGS.size]
        if self._data[begin - 1 : begin] != b"B" or len(flags) < FLAGS.size:
            return [FILE_HEADER_BYTES, len(self._data)]
        _, incompatible, *places = FLAGS.unpack(flags)
        if incompatible & ~APPENDED:
            raise LogError(
                [f"{name}: cannot be read as a {FORMAT}: it has unknown incompatible flags, {incompatible:#x}"]
            )
        inside = sorted(place for place in places if incompatible and begin < place < len(self._data))
        return [FILE_HEADER_BYTES, *inside, len(self._data)]

    def _split(self, at: int) -> Iterator[tuple[int, int]]:
        """Return where each record begins and ends; other bytes, and data that runs into them, are counted."""
        last, longest = at, 0
        while at < self._end:
            length = self._length(at) or self._unknown_length(at)
            if length and not (self._data[at + 2] == DATA and self._is_damage(at + length, max(longest, length))):
                yield at, at + length
                last, at, longest = at, at + length, max(longest, length)
                continue
            resumed = self._next(last + 1)
            if resumed is None:
                if self._is_damage(at, longest):
                    self._skipped_bytes += self._end - at
                else:
                    self.notes.append(f"ends in the middle of a record at byte {at}")
                return
            # It is before `at` if the length of the last record was wrong, and enclosed others.
            self._skipped_bytes += max(resumed - at, 1)
            last = at = resumed

    def _length(self, at: int) -> int:
        """Return the length of the record that begins here; 0 if none does, or if it extends beyond the end."""
        if at + HEADER.size > self._end:
            return 0
        size, kind = HEADER.unpack_from(self._data, at)
        begin, length = at + HEADER.size, HEADER.size + size
        if kind not in KINDS or size < LEAST_BYTES.get(kind, 0) or at + length > self._end:
            return 0
        return 0 if kind == DATA and self._number(begin) not in self._is_needed else length

    def _unknown_length(self, at: int) -> int:
        """Return the length of a record of a newer kind, or of a topic whose subscription is lost; 0 without one."""
        if at + HEADER.size > self._end:
            return 0
        size, kind = HEADER.unpack_from(self._data, at)
        after = at + HEADER.size + size
        if not (bytes((kind,)).isalpha() and 0 < size <= UNKNOWN_MAX_BYTES and after <= self._end):
            return 0
        return after - at if self._is_chain(after, CHAIN_RECORDS - 1) else 0

    def _number(self, at: int) -> int:
        return int.from_bytes(self._data[at : at + 2], "little")

    def _is_chain(self, at: int, count: int) -> bool:
        """Return whether so many records follow one another, or fewer up to the end."""
        for _ in range(count):
            if at == self._end:
                return True
            if not (length := self._length(at)):
                return False
            at += length
        return True

    def _next(self, start: int) -> int | None:
        """Return where records follow one another again; None if nowhere."""
        if self._left_bytes < 0:
            return None
        for match in _KIND.finditer(self._data, start + HEADER.size - 1, self._end):
            at = match.end() - HEADER.size
            if self._is_chain(at, CHAIN_RECORDS):
                self._left_bytes -= at - start
                return at
        self._left_bytes -= self._end - start
        return None

    def _is_damage(self, at: int, longest: int) -> bool:
        """Return whether no record begins here, nor one in which the log ends: such a one is no longer than others."""
        if at + HEADER.size > self._end or self._length(at) or self._unknown_length(at):
            return False
        size, kind = HEADER.unpack_from(self._data, at)
        return kind not in KINDS or not self._end - at < HEADER.size + size <= longest

    def _needed(self, begin: int, end: int) -> bytes:
        """Return a record; nothing if it is not needed, or if pyulog would end at it."""
        kind, at = self._data[begin + 2], begin + HEADER.size
        if end - at < LEAST_BYTES.get(kind, 0) or (kind == DATA and self._number(at) not in self._is_needed):
            self._skipped_bytes += end - begin
            return b""
        if kind == DATA:
            return self._data[begin:end] if self._is_needed[self._number(at)] else b""
        body = self._data[at:end]
        if kind == SUBSCRIPTION:
            topic = body[3:].decode(errors="replace")
            needed = body[3:] in self._timed and topic in TOPICS
            self._is_needed[self._number(at + 1)] = needed
            self.topics += [topic] * needed
        elif kind == PARAMETER:
            needed = len(body) == 1 + body[0] + PARAMETER_BYTES
        elif kind == DROPOUT:
            needed = len(body) == LEAST_BYTES[DROPOUT]
        elif kind in TEXTS:
            needed = True
        else:
            needed = self._is_defining and kind in DEFINITIONS
        if kind == FORMAT_OF and b":uint64_t timestamp;" in body:
            self._timed.add(body.partition(b":")[0])
        self._is_defining &= not (needed and (kind == SUBSCRIPTION or kind in TEXTS))
        return self._data[begin:end] if needed else b""


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


def _parsed(log: LogFile, records: _WholeRecords) -> Any:
    """Return pyulog's log; raises LogError.

    The formats all precede the first subscription. They are read first, to bound what the subscriptions expand to.
    """
    try:
        formats = ULog(BytesIO(records.whole), parse_header_only=True).message_formats
        if sum(_field_count(formats, topic) for topic in records.topics) > FIELDS_MAX:
            raise LogError([f"{log.name}: damaged: its formats declare more fields than a PX4 log can have"])
        return ULog(BytesIO(records.whole), list(TOPICS))
    except LogError:
        raise
    except Exception as error:  # pyulog raises exceptions of many types for damaged bytes
        reason = str(error) or type(error).__name__
        raise LogError([f"{log.name}: cannot be read as a {FORMAT}: its beginning is damaged ({reason})"]) from error


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
    is_number = isinstance(ulog.msg_info_dict.get("ver_sw_release"), int)
    release = ulog.get_version_info_str() if is_number else ""
    commit = str(ulog.msg_info_dict.get("ver_sw", ""))[:8]
    return " ".join(part for part in (release, commit) if part)
