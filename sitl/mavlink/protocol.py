"""The MAVLink interface of a stub vehicle: bytes in, bytes out, without sockets and clock.

It is the only module that sends messages with pymavlink; the readers of flight logs parse with it. Messages that are
malformed, for another system or unknown are counted and dropped; they raise no exception.
"""

import struct
from collections import Counter
from collections.abc import Callable, Iterator
from enum import Enum
from math import isfinite, isnan
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink  # common and EKF_STATUS_REPORT

from estimation.frames import Geodetic
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.autopilot import Severity, StubAutopilot
from sitl.autopilot.fence import zones_of
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.parameters import Value
from sitl.faults import VehicleFaults
from sitl.mavlink.commands import FENCE_PLAN, Commander, Plans, Schedule
from sitl.mavlink.gimbal import GimbalManager
from sitl.mavlink.reports import MavlinkConfig, TelemetryFields
from sitl.mavlink.signing import REFUSED, SigningState
from sitl.mavlink_constants import Fields, MessageId, Outgoing

AUTOPILOT_COMPONENT = 1
INT32, REAL32 = 6, 9
LOCAL_NED = 1
POSITION_IGNORED = 0b111
VELOCITY_IGNORED = 0b111 << 3
YAW_IGNORED = 1 << 10
REACH_MAX_M = 100e3
"""A setpoint farther than this from the vehicle's origin is dropped."""
DEG_E7 = 1e7
TEXT_MAX = 50
"""The longest text of one STATUSTEXT; longer texts are sent in several."""


class Drop(Enum):
    """The reasons for dropping a received message."""

    STRANGER = "not from its client"
    GARBAGE = "garbage"
    SIGNATURE = "signature"
    FOREIGN = "foreign"
    NOT_UNDERSTOOD = "not understood"
    NOT_FINITE = "not finite"
    OUT_OF_REACH = "out of reach"
    POSITION_MASKED = "position masked"
    FRAME = "frame"
    PARAMETER = "parameter"


class _Outbox:
    """Collects the packets that pymavlink writes."""

    def __init__(self) -> None:
        self.packets: list[bytes] = []

    def write(self, packet: bytes) -> None:
        self.packets.append(packet)

    def take(self) -> list[bytes]:
        packets, self.packets = self.packets, []
        return packets


class Observer(Protocol):
    """Takes what a vehicle sends and receives."""

    def on_motion(self, ned: tuple[float, ...]) -> None:
        """Take position and velocity in NED that are about to be sent."""

    def on_setpoint(self, ned: tuple[float, float, float]) -> None:
        """Take the position in NED of a setpoint that has arrived."""


class MavlinkVehicle:
    """One autopilot behind its MAVLink interface, with its system id and local NED origin."""

    def __init__(
        self,
        autopilot: StubAutopilot,
        config: MavlinkConfig,
        faults: VehicleFaults | None = None,
        observer: Observer | None = None,
    ) -> None:
        """Serve `autopilot`; `faults` may change while it is served."""
        self._observer = observer
        self._faults = faults or VehicleFaults()
        self.autopilot = autopilot
        self._dialect = autopilot.DIALECT
        autopilot.parameters.set(self._dialect.system_id_parameter, config.system_id)
        self.dropped: Counter[Drop] = Counter()
        self.plans = Plans()
        self._config = config
        self.gimbal = None if autopilot.mount is None else GimbalManager(autopilot.mount, self._boot_ms)
        self._reporter = TelemetryFields(autopilot, config, self._faults, self.gimbal)
        self._origin_m = self._reporter.origin_m
        self._schedule = Schedule(self._dialect.rates_hz, self._reporter.known, STEP_S * config.system_id)
        self._commander = Commander(
            autopilot, frame=config.frame, reporter=self._reporter, schedule=self._schedule, gimbal=self.gimbal
        )
        self._listing: list[int] = []
        self._texts_chunked = 0
        self._fence: tuple[Fields, ...] = ()
        self._outbox = _Outbox()
        self._signing = SigningState(config.signing_key)
        self._writer = self._signing.writer(self._outbox, config.system_id, AUTOPILOT_COMPONENT)
        self._parser = self._signing.parser()
        self._handlers = self._message_handlers()

    def _message_handlers(self) -> dict[str, Callable[[Any, float], list[Outgoing]]]:
        return {
            "COMMAND_INT": self._on_command_int,
            "COMMAND_LONG": self._on_command_long,
            "GIMBAL_MANAGER_SET_ATTITUDE": self._on_gimbal_attitude,
            "HEARTBEAT": self._on_heartbeat,
            "MISSION_ACK": lambda _message, _time_s: [],
            "MISSION_CLEAR_ALL": self._on_mission_clear,
            "MISSION_COUNT": self._on_mission_count,
            "MISSION_ITEM_INT": self._on_mission_item,
            "MISSION_REQUEST_INT": lambda m, _: self.plans.item(m.mission_type, m.seq, _sender(m)),
            "MISSION_REQUEST_LIST": lambda m, _: self.plans.count(m.mission_type, _sender(m)),
            "PARAM_REQUEST_LIST": self._on_param_request_list,
            "PARAM_REQUEST_READ": self._on_param_request_read,
            "PARAM_SET": self._on_param_set,
            "PING": lambda m, _: [(MessageId.PING, (m.time_usec, m.seq, *_sender(m)))],
            "REQUEST_DATA_STREAM": self._on_request_data_stream,
            "SETUP_SIGNING": self._on_setup_signing,
            "SET_GPS_GLOBAL_ORIGIN": self._on_set_origin,
            "SET_POSITION_TARGET_LOCAL_NED": self._on_setpoint,
            "TIMESYNC": _timesync,
            "VISION_POSITION_ESTIMATE": self._on_external_position,
        }

    def receive(self, data: bytes, time_s: float) -> list[bytes]:
        """Process a datagram that arrived at `time_s` (simulated, since boot); return the packets of its answer."""
        for message in self._parse(data):
            for answer in self._handle(message, time_s):
                self._send(answer)
        return self._outbox.take()

    def count_stranger(self) -> None:
        """Count a datagram that came from another address than the client's."""
        self.dropped[Drop.STRANGER] += 1

    def emit(self, time_s: float) -> list[bytes]:
        """Return the packets due at `time_s`: telemetry, texts, and parameters being listed."""
        # The motion last: a client that has received it has received the rest as well.
        for message in sorted(self._schedule.due(time_s), key=MessageId.LOCAL_POSITION_NED.__eq__):
            for report in self._reporter.report(message):
                self._send(report)
                if message == MessageId.LOCAL_POSITION_NED and self._observer is not None:
                    self._observer.on_motion(report[1][1:])
        if self._dialect.origin_may_move and self._origin_m != self._reporter.origin_m:
            self._origin_m = self._reporter.origin_m
            for report in self._reporter.report(MessageId.GPS_GLOBAL_ORIGIN):
                self._send(report)
        for severity, text in self.autopilot.take_texts():
            for chunk in self._chunked(text):
                self._send((MessageId.STATUSTEXT, (int(severity), *chunk)))
        if self._listing:
            self._send(self._param_value(self._listing.pop()))
        return self._outbox.take()

    def pass_on(self, report: Outgoing) -> list[bytes]:
        """Return the packets of a message that a receiver on board heard, such as ADSB_VEHICLE."""
        self._send(report)
        return self._outbox.take()

    def begin_mission(self) -> None:
        """Draw the noise of the mission from its seed."""
        self._reporter.begin_mission()

    def heartbeat(self) -> list[bytes]:
        """Return the packets of a heartbeat beside those that are due."""
        for report in self._reporter.report(MessageId.HEARTBEAT):
            self._send(report)
        return self._outbox.take()

    def _chunked(self, text: str) -> Iterator[tuple[bytes, int, int]]:
        """Yield a text's parts, each with the text's id and its index; texts that fit one message have no id."""
        whole = text.encode()
        starts = range(0, len(whole), TEXT_MAX)
        if len(starts) > 1:
            self._texts_chunked = self._texts_chunked % 65535 + 1
        text_id = self._texts_chunked if len(starts) > 1 else 0
        yield from ((whole[start : start + TEXT_MAX], text_id, place) for place, start in enumerate(starts))

    def _send(self, outgoing: Outgoing) -> None:
        message, fields = outgoing
        self._writer.send(mavlink.mavlink_map[message](*fields))

    def _parse(self, data: bytes) -> list[Any]:
        """Return the messages of one datagram; a damaged one does not affect the next."""
        messages = self._parser.parse_buffer(data) or []
        if self._parser.buf_len() > 0:
            self.dropped[Drop.GARBAGE] += 1
            self._parser = self._signing.parser()
        return messages

    def _handle(self, message: Any, time_s: float) -> list[Outgoing]:
        kind = message.get_type()
        if kind == "BAD_DATA":
            return self._drop(Drop.SIGNATURE if message.reason == REFUSED else Drop.GARBAGE)
        target = getattr(message, "target_system", 0)
        if target not in (0, self._config.system_id) or message.get_srcSystem() == self._config.system_id:
            return self._drop(Drop.FOREIGN)
        handler = self._handlers.get(kind)
        return handler(message, time_s) if handler else self._drop(Drop.NOT_UNDERSTOOD)

    def _drop(self, why: Drop) -> list[Outgoing]:
        self.dropped[why] += 1
        return []

    def _on_command_long(self, m: Any, _time_s: float) -> list[Outgoing]:
        params = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        return self._commander.execute(m.command, params, _sender(m))

    def _on_command_int(self, m: Any, _time_s: float) -> list[Outgoing]:
        params = (m.param1, m.param2, m.param3, m.param4, m.x / DEG_E7, m.y / DEG_E7, m.z)
        return self._commander.execute(m.command, params, _sender(m))

    def _on_mission_item(self, m: Any, _time_s: float) -> list[Outgoing]:
        params = (m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z)
        item = (m.frame, m.command, m.current, m.autocontinue, *params)
        answers = self.plans.receive_item(m.mission_type, m.seq, item, _sender(m))
        self._raise_fence()
        return answers

    def _on_mission_count(self, m: Any, _time_s: float) -> list[Outgoing]:
        answers = self.plans.begin_upload(m.mission_type, m.count, _sender(m))
        self._raise_fence()
        return answers

    def _on_mission_clear(self, m: Any, _time_s: float) -> list[Outgoing]:
        answers = self.plans.clear(m.mission_type, _sender(m))
        self._raise_fence()
        return answers

    def _raise_fence(self) -> None:
        """Pass the stored fence to the autopilot if it has changed."""
        items = self.plans.items(FENCE_PLAN)
        if items != self._fence:
            self._fence = items
            self.autopilot.zones = zones_of(items, self._config.frame)

    def _boot_ms(self) -> int:
        return round(self.autopilot.time_s * 1e3) % 2**32

    def _on_gimbal_attitude(self, m: Any, _time_s: float) -> list[Outgoing]:
        taken = self.gimbal is not None and self.gimbal.point(m, _sender(m))
        return [] if taken else self._drop(Drop.NOT_UNDERSTOOD)

    def _on_heartbeat(self, m: Any, time_s: float) -> list[Outgoing]:
        self.autopilot.receive_heartbeat(time_s, m.get_srcSystem())
        return []

    def _on_setpoint(self, m: Any, time_s: float) -> list[Outgoing]:
        """Process a local position setpoint, with its velocity if it has one; its acceleration is ignored."""
        if self._observer is not None:
            self._observer.on_setpoint((m.x, m.y, m.z))
        if m.coordinate_frame != LOCAL_NED:
            return self._drop(Drop.FRAME)
        if m.type_mask & POSITION_IGNORED:
            return self._on_stop(m, time_s)
        # A yaw that is NaN keeps the present one.
        heading = m.yaw if isfinite(m.yaw) and not m.type_mask & YAW_IGNORED else None
        # A masked velocity is not used, nor is NaN.
        fed = not m.type_mask & VELOCITY_IGNORED and not any(map(isnan, (m.vx, m.vy, m.vz)))
        numbers = (m.x, m.y, m.z, m.vx, m.vy, m.vz) if fed else (m.x, m.y, m.z)
        if not all(map(isfinite, numbers)):
            return self._drop(Drop.NOT_FINITE)
        if max(map(abs, numbers)) > REACH_MAX_M:
            return self._drop(Drop.OUT_OF_REACH)
        x, y, z = self._config.frame.mission_from_ned((m.x, m.y, m.z))
        x0, y0, z0 = self._reporter.origin_m
        # The vehicle flies to the setpoint in its own estimate, which may be shifted.
        dx, dy, dz = self._faults.offset_m
        velocity = self._config.frame.mission_from_ned((m.vx, m.vy, m.vz)) if fed else ()
        target = PositionTarget((x0 + x - dx, y0 + y - dy, z0 + z - dz), heading, velocity)
        self.autopilot.receive_setpoint(time_s, target)
        return []

    def _on_stop(self, m: Any, time_s: float) -> list[Outgoing]:
        """Process a setpoint without a position: the vehicle stops where it is; another velocity is not simulated."""
        if m.type_mask & VELOCITY_IGNORED or any((m.vx, m.vy, m.vz)):
            return self._drop(Drop.POSITION_MASKED)
        heading = m.yaw if isfinite(m.yaw) and not m.type_mask & YAW_IGNORED else None
        self.autopilot.receive_setpoint(time_s, PositionTarget(self.autopilot.airframe.position_m, heading))
        return []

    def _on_set_origin(self, m: Any, _time_s: float) -> list[Outgoing]:
        """Move the origin of the local NED, if the autopilot allows that in flight."""
        if self._dialect.origin_may_move and not self._config.frame.is_local:
            try:
                place = Geodetic(m.latitude / DEG_E7, m.longitude / DEG_E7, m.altitude / 1e3)
            except ValueError:
                return self._drop(Drop.NOT_FINITE)
            x, y, z = self._config.frame.mission_from_geodetic(place)
            x0, y0, z0 = self._config.origin_m
            self._faults.origin_moved_m = (x - x0, y - y0, z - z0)
        return []

    def _on_external_position(self, m: Any, time_s: float) -> list[Outgoing]:
        """Take an external position; the stub's estimate still uses its own motion."""
        if not all(map(isfinite, (m.x, m.y, m.z))):
            return self._drop(Drop.NOT_FINITE)
        self.autopilot.receive_external_position(time_s)
        return []

    def _on_request_data_stream(self, m: Any, time_s: float) -> list[Outgoing]:
        """Start or stop a group of messages, if the autopilot has that group."""
        messages = self._dialect.streams.get(m.req_stream_id)
        if messages is None:
            return self._drop(Drop.NOT_UNDERSTOOD)
        flows = m.start_stop == 1 and m.req_message_rate > 0
        for message in messages:
            self._schedule.set_interval(message, 1.0 / m.req_message_rate if flows else None, now_s=time_s)
        return []

    def _on_setup_signing(self, m: Any, _time_s: float) -> list[Outgoing]:
        """Take a signing key, unless armed; there is no acknowledgement, but messages are signed from now on."""
        if self.autopilot.armed:
            return [(MessageId.STATUSTEXT, (int(Severity.WARNING), b"Signing is not set up while armed", 0, 0))]
        self._signing.set_up(bytes(m.secret_key), m.initial_timestamp)
        return []

    def _on_param_request_list(self, _message: Any, _time_s: float) -> list[Outgoing]:
        self._listing = list(reversed(range(len(self.autopilot.parameters.names))))
        return []

    def _on_param_request_read(self, m: Any, _time_s: float) -> list[Outgoing]:
        names = self.autopilot.parameters.names
        index = m.param_index if m.param_index >= 0 else self._index(m.param_id)
        return [self._param_value(index)] if 0 <= index < len(names) else self._drop(Drop.PARAMETER)

    def _on_param_set(self, m: Any, _time_s: float) -> list[Outgoing]:
        """Set a parameter and answer with its value; no answer to an unknown name or, bytewise, a wrong type."""
        index = self._index(m.param_id)
        if index < 0:
            return self._drop(Drop.PARAMETER)
        name = self.autopilot.parameters.names[index]
        present = self.autopilot.parameters[name]
        if self._dialect.parameters_bytewise:
            value = _decoded(m.param_value, m.param_type)
            if type(value) is not type(present):
                return self._drop(Drop.PARAMETER)
        else:
            value = _cast(m.param_value, like=present)
        if value is None or not self.autopilot.parameters.set(name, value):
            self.dropped[Drop.PARAMETER] += 1
        return [self._param_value(index)]

    def _index(self, param_id: str) -> int:
        names = self.autopilot.parameters.names
        return names.index(param_id) if param_id in names else -1

    def _param_value(self, index: int) -> Outgoing:
        parameters = self.autopilot.parameters
        name = parameters.names[index]
        value, kind = _encoded(parameters[name], bytewise=self._dialect.parameters_bytewise)
        return MessageId.PARAM_VALUE, (name.encode(), value, kind, len(parameters.names), index)


def _sender(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _timesync(message: Any, time_s: float) -> list[Outgoing]:
    """Answer a request for the autopilot's time; answers to its own requests are ignored."""
    return [] if message.tc1 else [(MessageId.TIMESYNC, (round(time_s * 1e9), message.ts1))]


def _encoded(value: Value, *, bytewise: bool) -> tuple[float, int]:
    """Return an encoded parameter: in the float field integers keep their bytes, or their value."""
    if not isinstance(value, int):
        return value, REAL32
    return struct.unpack("<f", struct.pack("<i", value))[0] if bytewise else float(value), INT32


def _decoded(field: float, kind: int) -> Value | None:
    """Return the parameter in a float field; None for a type that no parameter has."""
    if kind == INT32:
        return int(struct.unpack("<i", struct.pack("<f", field))[0])
    return field if kind == REAL32 else None


def _cast(field: float, *, like: Value) -> Value | None:
    """Return the parameter in a float field that holds its value: the number, converted to the parameter's type."""
    if not isfinite(field) or abs(field) >= 2**31:
        return None
    return round(field) if isinstance(like, int) else field
