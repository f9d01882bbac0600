"""MAVLink telemetry logs (.tlog) of ground stations: packets, each after the time stamp of its arrival.

A vehicle's own series are timed by its own clock (`time_boot_ms`), without link delays. Setpoints, modes and texts have
only the ground station's stamp, which is mapped to the vehicle's clock by the messages that have both. They are early
by the delay of the downlink: tens of milliseconds, the link's share of the input delay that a ground station sees. Logs
of simulators faster than real time are mapped correctly, too.

pymavlink parses the messages; this module cuts the packets. `mavutil.mavlogfile` of pymavlink 2.4.50 returns the same
messages in 3 times the time, since it decodes all kinds, has no bound of its work (4.2 s instead of 0.2 s with 2 MB of
zeros at the end), and reports 12 of 100 damaged bytes.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from estimation.frames import up_from_ned
from gcs.autopilots.registry import autopilot_numbered
from gcs.flightlog.container import LogError
from gcs.vehicle_logs.log_file import MAVLINK_MAGICS, STAMP_BYTES, STAMPS_US, LogFile
from gcs.vehicle_logs.raw_log import RawLog, Samples, Stamps, longest_boot, vehicle_log
from gcs.vehicle_logs.vehicle_log import VehicleLog

FORMAT = "MAVLink telemetry log (.tlog)"
SET, ECHO, LOCAL = "SET_POSITION_TARGET_LOCAL_NED", "POSITION_TARGET_LOCAL_NED", "LOCAL_POSITION_NED"
ELSEWHERE = ("SET_POSITION_TARGET_GLOBAL_INT", "COMMAND_INT")
"""They also send a vehicle somewhere: in latitude and longitude."""
FLY_HERE = mavlink.MAV_CMD_DO_REPOSITION
READ = {
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}"): name
    for name in (
        *(SET, ECHO, LOCAL, "HEARTBEAT", "STATUSTEXT", "ATTITUDE", "BATTERY_STATUS", "SYS_STATUS"),
        *("PARAM_VALUE", "AUTOPILOT_VERSION", *ELSEWHERE),
    )
}
_MAGIC = re.compile(b"[%s]" % re.escape(bytes(MAVLINK_MAGICS)))
V2, SIGNED = 0xFD, 0x01
BAD_BYTES_MAX = 1_000_000
REORDERED_MAX_US = 500_000
"""Packets out of order by less than this are sorted; a larger step is a clock that went back."""

AUTOPILOT_COMPONENT = 1
NO_AUTOPILOT = 8
ARMED = 128
LOCAL_NED = 1
VELOCITY_IGNORED = 0b111 << 3
CELL_UNKNOWN = 65535

TIMED = (LOCAL, "ATTITUDE", ECHO)
"""What a vehicle sends with its own time."""
LASTING = ("PARAM_VALUE", "AUTOPILOT_VERSION")
"""What holds beyond a restart of the autopilot."""

Packet = tuple[int, Any]
"""The ground station's stamp [us], and the message."""


class _Packets:
    """The packets of a file; other bytes are skipped and noted."""

    def __init__(self, log: LogFile) -> None:
        self._data = log.content()
        self._parser = mavlink.MAVLink(None)
        self.notes = log.notes
        self.is_damaged = False

    def __iter__(self) -> Iterator[Packet]:
        data, end, at, bad = self._data, len(self._data), 0, 0
        while at < end:
            length = self._length(at)
            if length and at + length > end:
                if not self._continues(at):
                    break
                length = 0
            message = self._message(at, length) if length else None
            if message is None:
                found = self._next(at + 1)
                bad += found - at
                self.is_damaged = True
                if bad > BAD_BYTES_MAX:
                    self.notes.append(f"damaged: not readable beyond byte {at}")
                    return
                at = found
                continue
            if message is not True:
                yield int.from_bytes(data[at : at + STAMP_BYTES], "big"), message
            at += length
        if at < end:
            self.notes.append(f"ends in the middle of a record at byte {at}")
        if bad:
            self.notes.append(f"damaged: {bad} bytes were skipped")

    def _length(self, at: int) -> int:
        """Return the length of the packet that may begin here, with its stamp; 0 if none can."""
        head = self._data[at : at + STAMP_BYTES + 3]
        if len(head) < STAMP_BYTES + 3:
            return len(head) + 1  # beyond the end
        if head[STAMP_BYTES] not in MAVLINK_MAGICS or int.from_bytes(head[:STAMP_BYTES], "big") not in STAMPS_US:
            return 0
        if head[STAMP_BYTES] != V2:
            return STAMP_BYTES + 6 + head[STAMP_BYTES + 1] + 2
        return STAMP_BYTES + 10 + head[STAMP_BYTES + 1] + 2 + (13 if head[STAMP_BYTES + 2] & SIGNED else 0)

    def _message(self, at: int, length: int) -> Any:
        """Return the message, True for a kind that is not needed, None where the packet is damaged."""
        packet = self._data[at + STAMP_BYTES : at + length]
        kind = int.from_bytes(packet[7:10], "little") if packet[0] == V2 else packet[5]
        if kind not in READ:
            return True
        try:
            return self._parser.decode(bytearray(packet))
        except mavlink.MAVError:
            return None

    def _continues(self, at: int) -> bool:
        """Return whether whole packets follow one that extends beyond the file: then its length is wrong."""
        while (at := self._next(at + 1)) < len(self._data):
            length = self._length(at)
            if length and at + length <= len(self._data) and self._message(at, length) not in (None, True):
                return True
        return False

    def _next(self, start: int) -> int:
        """Return where the next packet may begin, or the end of the file."""
        found = _MAGIC.search(self._data, start + STAMP_BYTES)
        return found.start() - STAMP_BYTES if found else len(self._data)


class _Vehicle:
    """The messages of one system, by kind."""

    def __init__(self) -> None:
        self.packets: defaultdict[str, list[Packet]] = defaultdict(list)
        self.autopilot = NO_AUTOPILOT


def read(log: LogFile) -> tuple[VehicleLog, ...]:
    """Return each vehicle's log, by ascending system id; raises LogError when it cannot be read as one."""
    vehicles: defaultdict[int, _Vehicle] = defaultdict(_Vehicle)
    setpoints_sent: defaultdict[int, list[Packet]] = defaultdict(list)
    packets = _Packets(log)
    for stamp_us, message in packets:
        kind = message.get_type()
        if kind == SET or (kind in ELSEWHERE and getattr(message, "command", FLY_HERE) == FLY_HERE):
            setpoints_sent[message.target_system].append((stamp_us, message))
        elif message.get_srcComponent() == AUTOPILOT_COMPONENT:
            vehicle = vehicles[message.get_srcSystem()]
            vehicle.packets[kind].append((stamp_us, message))
            if kind == "HEARTBEAT" and message.autopilot != NO_AUTOPILOT:
                vehicle.autopilot = message.autopilot
    flown = {system: one for system, one in sorted(vehicles.items()) if one.autopilot != NO_AUTOPILOT}
    if not flown:
        raise LogError(["; ".join((f"{log.name}: it holds no HEARTBEAT of an autopilot", *packets.notes))])
    for system, one in flown.items():
        one.packets[SET] = sorted(setpoints_sent[system] + setpoints_sent[0], key=lambda packet: packet[0])
    return tuple(_read(log, system, one, packets) for system, one in flown.items())


def _read(log: LogFile, system_id: int, vehicle: _Vehicle, packets: _Packets) -> VehicleLog:
    autopilot = autopilot_numbered(vehicle.autopilot)
    raw = RawLog(
        path=log.name,
        format=FORMAT,
        sha256=log.sha256,
        autopilot=autopilot.name or f"autopilot {vehicle.autopilot}",
        system_id=system_id,
        notes=list(packets.notes),
        is_damaged=packets.is_damaged,
    )
    _keep_one_boot(raw, vehicle)
    clock = _clock(raw, vehicle)
    _add_motion(raw, vehicle)
    _add_setpoints(raw, vehicle, clock)
    _add_battery(raw, vehicle, clock)
    _add_status(raw, vehicle, clock)
    for _, message in vehicle.packets["PARAM_VALUE"]:
        if (value := autopilot.parameter(message.param_type, message.param_value)) is not None:
            raw.parameters[message.param_id] = value
    for _, message in vehicle.packets["AUTOPILOT_VERSION"]:
        number = message.flight_sw_version
        raw.firmware = f"v{number >> 24 & 255}.{number >> 16 & 255}.{number >> 8 & 255}"
    return vehicle_log(raw)


def _keep_one_boot(raw: RawLog, vehicle: _Vehicle) -> None:
    """Keep the packets of the longest boot, if the autopilot restarted."""
    timed = sorted((packet for kind in TIMED for packet in vehicle.packets[kind]), key=lambda packet: packet[0])
    first, last = longest_boot(_boot_us(timed), raw.notes)
    begin = timed[first][0] if first else 0
    end = timed[last][0] if last < len(timed) else STAMPS_US.stop
    for kind in set(vehicle.packets) - set(LASTING):
        vehicle.packets[kind] = [packet for packet in vehicle.packets[kind] if begin <= packet[0] < end]


Clock = Callable[[Stamps], Stamps]


def _boot_us(packets: Sequence[Packet]) -> Stamps:
    return np.array([1000 * message.time_boot_ms for _, message in packets], dtype=np.int64)


def _clock(raw: RawLog, vehicle: _Vehicle) -> Clock:
    """Return the mapping from the ground station's stamps to the vehicle's time [us]."""
    received = [packet for kind in TIMED for packet in vehicle.packets[kind]]
    if not received:
        raw.notes.append("the vehicle sent no time: all times are those of the packets' arrival")
        return lambda stamps: stamps
    stamps = np.array([stamp_us for stamp_us, _ in received], dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    arrived, boot = stamps[order], np.maximum.accumulate(_boot_us(received)[order])

    def vehicle_us(at: Stamps) -> Stamps:
        # Relative to the first stamp: microseconds since 1970 fill a float to its last bits.
        inside = np.interp((at - arrived[0]).astype(np.float64), (arrived - arrived[0]).astype(np.float64), boot)
        beyond = np.minimum(at - arrived[0], 0) + np.maximum(at - arrived[-1], 0)
        mapped: Stamps = np.rint(inside).astype(np.int64) + beyond
        return mapped

    return vehicle_us


def _stamps(packets: Sequence[Packet]) -> Stamps:
    return np.array([stamp_us for stamp_us, _ in packets], dtype=np.int64)


def _in_order(raw: RawLog, topic: str, stamps: Stamps, values: NDArray[np.float64]) -> Samples:
    """Return samples sorted by time, if they are out of order by less than REORDERED_MAX_US."""
    behind = np.maximum.accumulate(stamps) - stamps
    late = int((behind > 0).sum())
    if late and behind.max() <= REORDERED_MAX_US:
        raw.notes.append(f"{topic}: {late} packets arrived out of order and were sorted")
        order = np.argsort(stamps, kind="stable")
        stamps, values = stamps[order], values[order]
    return Samples(topic, stamps, values)


def _add_motion(raw: RawLog, vehicle: _Vehicle) -> None:
    if packets := vehicle.packets[LOCAL]:
        rows = np.array([(m.x, m.y, m.z, m.vx, m.vy, m.vz) for _, m in packets], dtype=np.float64)
        for name, columns in (("position", slice(0, 3)), ("velocity", slice(3, 6))):
            values = up_from_ned(rows[:, columns])
            raw.samples[name] = _in_order(raw, LOCAL, _boot_us(packets), values)
    else:
        raw.missing.append(LOCAL)
    if packets := vehicle.packets["ATTITUDE"]:
        values = up_from_ned(np.array([(m.roll, m.pitch, m.yaw) for _, m in packets], dtype=np.float64))
        raw.samples["attitude"] = _in_order(raw, "ATTITUDE", _boot_us(packets), values)


def _add_setpoints(raw: RawLog, vehicle: _Vehicle, clock: Clock) -> None:
    """Add the setpoints sent; if none are logged, those that the vehicle reports as its target."""
    topic = SET if any(m.get_type() == SET for _, m in vehicle.packets[SET]) else ECHO
    sent = vehicle.packets[topic]
    # A target in another frame ends the one before it, and is none itself.
    is_local = [getattr(m, "coordinate_frame", None) == LOCAL_NED for _, m in sent]
    if others := is_local.count(False):
        raw.notes.append(f"{topic}: {others} setpoints in other frames than the local NED were left out")
    if not any(is_local):
        raw.missing.append(f"{SET} or {ECHO}")
        return
    rows = [
        [(m.x, m.y, m.z)[axis] if local and not m.type_mask >> axis & 1 else nan for axis in range(3)]
        for local, (_, m) in zip(is_local, sent, strict=True)
    ]
    # The reported target includes the velocity added by the vehicle's position controller: it is not used.
    rates_ned = [
        (m.vx, m.vy, m.vz) if local and topic == SET and not m.type_mask & VELOCITY_IGNORED else (nan,) * 3
        for local, (_, m) in zip(is_local, sent, strict=True)
    ]
    stamps = clock(_stamps(sent)) if topic == SET else _boot_us(sent)
    if topic == ECHO:
        raw.notes.append(f"setpoints are those that the vehicle reports in {ECHO}: its autopilot may shape them")
    values = up_from_ned(np.array(rows, dtype=np.float64))
    rates = up_from_ned(np.array(rates_ned, dtype=np.float64))
    ordered = _in_order(raw, topic, stamps, np.hstack((values, rates)))
    raw.add_setpoints(topic, ordered.stamps_us, ordered.values[:, :3], ordered.values[:, 3:])


def _add_battery(raw: RawLog, vehicle: _Vehicle, clock: Clock) -> None:
    """Add the first battery's report, or that of the system status."""
    first = [packet for packet in vehicle.packets["BATTERY_STATUS"] if packet[1].id == 0]
    topic, packets = ("BATTERY_STATUS", first) if first else ("SYS_STATUS", vehicle.packets["SYS_STATUS"])
    if not packets:
        return
    rows = []
    for _, m in packets:
        cells = [cell for cell in m.voltages if cell != CELL_UNKNOWN] if first else [m.voltage_battery]
        known = cells and cells != [CELL_UNKNOWN]
        ampere = m.current_battery / 100.0 if m.current_battery >= 0 else nan
        left = m.battery_remaining / 100.0 if m.battery_remaining >= 0 else nan
        rows.append((sum(cells) / 1000.0 if known else nan, ampere, left))
    values = np.array(rows, dtype=np.float64)
    raw.samples["battery"] = _in_order(raw, topic, clock(_stamps(packets)), values)


def _add_status(raw: RawLog, vehicle: _Vehicle, clock: Clock) -> None:
    raw.mode_topic = "HEARTBEAT"
    beats = [packet for packet in vehicle.packets["HEARTBEAT"] if packet[1].autopilot != NO_AUTOPILOT]
    for stamp_us, (_, m) in zip(clock(_stamps(beats)).tolist(), beats, strict=True):
        raw.modes.append((stamp_us, autopilot_numbered(vehicle.autopilot).mode(m.custom_mode)))
        raw.armed.append((stamp_us, bool(m.base_mode & ARMED)))
    texts = vehicle.packets["STATUSTEXT"]
    parts: dict[int, int] = {}
    for stamp_us, (_, m) in zip(clock(_stamps(texts)).tolist(), texts, strict=True):
        if m.id and m.chunk_seq and m.id in parts:
            begun = raw.texts[parts[m.id]]
            raw.texts[parts[m.id]] = (*begun[:2], begun[2] + m.text)
            continue
        parts[m.id] = len(raw.texts)
        raw.texts.append((stamp_us, m.severity if 0 <= m.severity <= 7 else None, m.text))
