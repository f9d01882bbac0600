"""MAVLink commands to the stub: their effects and acknowledgements.

The receiving end of MAVLink's mission protocol: missions (type 0), fences (1) and rally points (2).

The stub stores plans and returns them; only the fence affects its flight.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from math import ceil, inf, isfinite
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from estimation.frames import MissionFrame
from sitl.autopilot.autopilot import MavResult, StubAutopilot
from sitl.autopilot.modes import NavMode
from sitl.mavlink.gimbal import GimbalManager
from sitl.mavlink.reports import TelemetryFields
from sitl.mavlink_constants import Fields, MessageId, Outgoing, Result

PLAN_TYPES = frozenset({0, 1, 2})
FENCE_PLAN, ALL_PLANS = 1, 255
ITEMS_MAX = 500
ACCEPTED, ERROR, NO_SPACE, INVALID_SEQUENCE = 0, 1, 4, 13
"""The MAV_MISSION_RESULT values that are used."""

Sender = tuple[int, int]
"""System and component id of the sender."""


@dataclass(slots=True)
class _Upload:
    plan_type: int
    count: int
    items: list[Fields] = field(default_factory=list)


class Plans:
    """Stored plans by type, and at most one upload in progress."""

    def __init__(self) -> None:
        self._stored: dict[int, tuple[Fields, ...]] = {}
        self._upload: _Upload | None = None

    def items(self, plan_type: int) -> tuple[Fields, ...]:
        """Return a stored plan: (frame, command, current, autocontinue, param1..4, x, y, z) per item."""
        return self._stored.get(plan_type, ())

    def clear(self, plan_type: int, sender: Sender) -> list[Outgoing]:
        """Clear one plan, or all."""
        if plan_type == ALL_PLANS:
            self._stored.clear()
        self._stored.pop(plan_type, None)
        return [_ack(sender, ACCEPTED, plan_type)]

    def begin_upload(self, plan_type: int, count: int, sender: Sender) -> list[Outgoing]:
        """Request the first of `count` items; a count of 0 clears the plan."""
        if plan_type not in PLAN_TYPES:
            return [_ack(sender, ERROR, plan_type)]
        if count > ITEMS_MAX:
            return [_ack(sender, NO_SPACE, plan_type)]
        if count == 0:
            return self.clear(plan_type, sender)
        self._upload = _Upload(plan_type, count)
        return [(MessageId.MISSION_REQUEST_INT, (*sender, 0, plan_type))]

    def receive_item(self, plan_type: int, seq: int, item: Fields, sender: Sender) -> list[Outgoing]:
        """Take an item, then request the next one, also after a repeated item, or acknowledge the plan."""
        upload = self._upload
        if upload is None or upload.plan_type != plan_type or seq > len(upload.items):
            return [_ack(sender, INVALID_SEQUENCE, plan_type)]
        if seq == len(upload.items):
            upload.items.append(item)
        if len(upload.items) < upload.count:
            return [(MessageId.MISSION_REQUEST_INT, (*sender, len(upload.items), plan_type))]
        self._stored[plan_type] = tuple(upload.items)
        self._upload = None
        return [_ack(sender, ACCEPTED, plan_type)]

    def count(self, plan_type: int, sender: Sender) -> list[Outgoing]:
        """Answer with the number of items of a plan."""
        return [(MessageId.MISSION_COUNT, (*sender, len(self.items(plan_type)), plan_type))]

    def item(self, plan_type: int, seq: int, sender: Sender) -> list[Outgoing]:
        """Answer with one item."""
        items: tuple[Any, ...] = self.items(plan_type)
        if seq >= len(items):
            return [_ack(sender, INVALID_SEQUENCE, plan_type)]
        return [(MessageId.MISSION_ITEM_INT, (*sender, seq, *items[seq], plan_type))]


def _ack(sender: Sender, result: int, plan_type: int) -> Outgoing:
    return MessageId.MISSION_ACK, (*sender, result, plan_type)


FAST_S = 0.1
"""Messages with at most this interval are fast: motions come at the same time from all vehicles."""
TOLERANCE_S = 1e-6
"""A message is due up to this long before its time, because the sum of physics steps has rounding errors."""


class Schedule:
    """Message ids with an interval each; ids without a default rate are sent on request only.

    Messages come on a grid from the start, so that what a client requests a moment later comes at the same times
    nevertheless. The grid of slow ones is later by a vehicle's own `phase_s`: if all vehicles sent theirs at one time,
    their client's queues would overflow.
    """

    def __init__(self, rates_hz: Mapping[int, float], known: Iterable[int], phase_s: float = 0.0) -> None:
        """Start the messages of `rates_hz`; `known` are the ids with a settable interval."""
        self._default_s = {message: 1.0 / rate for message, rate in rates_hz.items()}
        self._known = frozenset(known)
        self._interval_s = dict(self._default_s)
        self._next_s = 0.0
        self._phase_s = phase_s
        self._due_s = {message: self._due_from_s(0.0, interval) for message, interval in self._interval_s.items()}

    def interval_s(self, message: int) -> float | None:
        """Return a message's interval; None if it is not being sent."""
        return self._interval_s.get(message)

    def set_interval(self, message: int, interval_s: float | None, *, now_s: float) -> bool:
        """Set an interval (0 restores the default, None stops); return whether the message is known."""
        if message not in self._known:
            return False
        interval = self._default_s.get(message) if interval_s == 0.0 else interval_s
        self._interval_s.pop(message, None)
        self._due_s.pop(message, None)
        if interval is not None:
            self._interval_s[message] = interval
            self._due_s[message] = self._due_from_s(now_s, interval)
        self._next_s = now_s
        return True

    def _due_from_s(self, now_s: float, interval_s: float) -> float:
        phase_s = self._phase_s % interval_s if interval_s > FAST_S else 0.0
        return ceil((now_s - phase_s) / interval_s - TOLERANCE_S) * interval_s + phase_s

    def due(self, now_s: float) -> list[int]:
        """Return the messages due at `now_s` and schedule the next ones; missed ones are not made up."""
        if now_s + TOLERANCE_S < self._next_s:
            return []
        latest_s = now_s + TOLERANCE_S
        due = [message for message, due_s in self._due_s.items() if due_s <= latest_s]
        for message in due:
            interval = self._interval_s[message]
            next_s = self._due_s[message] + interval
            self._due_s[message] = next_s if next_s > now_s else now_s + interval
        self._next_s = min(self._due_s.values(), default=inf)
        return due


FORCE = 21196
ALTITUDE_MAX_M = 10e3
"""A take-off beyond this is refused."""

Params = tuple[float, float, float, float, float, float, float]


class CommandId(IntEnum):
    """The supported MAV_CMD."""

    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    DO_SET_MODE = 176
    COMPONENT_ARM_DISARM = 400
    GET_HOME_POSITION = 410
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_AUTOPILOT_CAPABILITIES = 520
    DO_GIMBAL_MANAGER_CONFIGURE = 1001


class Commander:
    """Executes commands on one vehicle."""

    def __init__(
        self,
        autopilot: StubAutopilot,
        *,
        frame: MissionFrame,
        reporter: TelemetryFields,
        schedule: Schedule,
        gimbal: GimbalManager | None = None,
    ) -> None:
        """Pass commands to `autopilot` and `gimbal`; answer requests for messages with `reporter` and `schedule`."""
        self._gimbal = gimbal
        self._autopilot = autopilot
        self._dialect = autopilot.DIALECT
        self._frame = frame
        self._reporter = reporter
        self._schedule = schedule
        self._handlers: dict[int, Callable[[Params], tuple[Result, list[Outgoing]]]] = {
            CommandId.NAV_RETURN_TO_LAUNCH: lambda _: self._select(NavMode.RETURN),
            CommandId.NAV_LAND: lambda _: (self._result(self._autopilot.land()), []),
            CommandId.NAV_TAKEOFF: self._take_off,
            CommandId.DO_SET_MODE: self._set_mode,
            CommandId.COMPONENT_ARM_DISARM: self._arm_or_disarm,
            CommandId.GET_HOME_POSITION: lambda _: self._request(MessageId.HOME_POSITION),
            CommandId.GET_MESSAGE_INTERVAL: self._get_interval,
            CommandId.SET_MESSAGE_INTERVAL: self._set_interval,
            CommandId.REQUEST_MESSAGE: lambda params: self._request(params[0]),
            CommandId.REQUEST_AUTOPILOT_CAPABILITIES: lambda _: self._request(MessageId.AUTOPILOT_VERSION),
        }

    def execute(self, command: int, params: Params, sender: Sender) -> list[Outgoing]:
        """Execute a command; return its acknowledgements, then the requested messages.

        DO_SET_MODE may be acknowledged twice: always accepted on arrival, then the actual result.
        """
        if command == CommandId.DO_GIMBAL_MANAGER_CONFIGURE:
            return self._configure_gimbal(params, sender)
        handler = self._handlers.get(command)
        result, answers = handler(params) if handler else (Result.UNSUPPORTED, [])
        twice = command == CommandId.DO_SET_MODE and self._dialect.acknowledges_mode_first
        results = [Result.ACCEPTED, result] if twice else [result]
        acks: list[Outgoing] = [(MessageId.COMMAND_ACK, (command, int(each), 0, 0, *sender)) for each in results]
        return acks + answers

    def _configure_gimbal(self, params: Params, sender: Sender) -> list[Outgoing]:
        """Give or take control of the gimbal, and report who has it."""
        result = Result.UNSUPPORTED if self._gimbal is None else self._gimbal.configure(params, sender)
        command = int(CommandId.DO_GIMBAL_MANAGER_CONFIGURE)
        acknowledgement: Outgoing = (MessageId.COMMAND_ACK, (command, int(result), 0, 0, *sender))
        status = [] if self._gimbal is None else self._reporter.report(MessageId.GIMBAL_MANAGER_STATUS)
        return [acknowledgement, *status]

    def _select(self, mode: NavMode) -> tuple[Result, list[Outgoing]]:
        return self._result(self._autopilot.select(mode)), []

    def _set_mode(self, params: Params) -> tuple[Result, list[Outgoing]]:
        base, main, sub = params[:3]
        mode = self._dialect.mode_of(main, sub)
        if mode is None or not (isfinite(base) and int(base) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
            return self._dialect.refused, []
        return self._select(mode)

    def _take_off(self, params: Params) -> tuple[Result, list[Outgoing]]:
        """Take off to an altitude above the geodetic datum or home; NaN is the vehicle's default, if any."""
        origin = None if self._dialect.take_off_from_home else self._frame.origin
        datum_m = -self._autopilot.home_m[2] if origin is None else origin.altitude_m
        altitude_m = params[6] - datum_m if isfinite(params[6]) else None
        if altitude_m is not None and abs(altitude_m) > ALTITUDE_MAX_M:
            return Result.DENIED, []
        return self._result(self._autopilot.take_off(altitude_m)), []

    def _result(self, result: MavResult) -> Result:
        return Result.ACCEPTED if result is MavResult.ACCEPTED else self._dialect.refused

    def _arm_or_disarm(self, params: Params) -> tuple[Result, list[Outgoing]]:
        if params[0] == 1.0:
            return self._result(self._autopilot.arm()), []
        if params[0] == 0.0:
            return self._result(self._autopilot.disarm(force=params[1] == FORCE)), []
        return Result.DENIED, []

    def _request(self, message: float) -> tuple[Result, list[Outgoing]]:
        if message not in self._reporter.known:
            return Result.DENIED, []
        return Result.ACCEPTED, self._reporter.report(int(message))

    def _get_interval(self, params: Params) -> tuple[Result, list[Outgoing]]:
        message = params[0]
        if message not in self._reporter.known:
            return Result.DENIED, []
        interval = self._schedule.interval_s(int(message))
        interval_us = -1 if interval is None else round(interval * 1e6)
        return Result.ACCEPTED, [(MessageId.MESSAGE_INTERVAL, (int(message), interval_us))]

    def _set_interval(self, params: Params) -> tuple[Result, list[Outgoing]]:
        """Set a message's interval in simulated microseconds; the heartbeat's interval is fixed."""
        message, interval_us = params[:2]
        if message == MessageId.HEARTBEAT or message not in self._reporter.known or not isfinite(interval_us):
            return Result.FAILED, []
        interval_s = None if interval_us < 0.0 else interval_us / 1e6
        self._schedule.set_interval(int(message), interval_s, now_s=self._autopilot.time_s)
        return Result.ACCEPTED, []
