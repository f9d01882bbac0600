"""MAVLink commands to the stub: their effects and acknowledgements."""

from collections.abc import Callable
from enum import IntEnum
from math import isfinite

from estimation.frames import MissionFrame
from sitl.autopilot.autopilot import MavResult, StubAutopilot
from sitl.autopilot.modes import NavMode
from sitl.mavlink.plans import Sender
from sitl.mavlink.reports import TelemetryFields
from sitl.mavlink.schedule import Schedule
from sitl.mavlink_constants import MessageId, ModeFlag, Outgoing, Result

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


class Commander:
    """Executes commands on one vehicle."""

    def __init__(
        self,
        autopilot: StubAutopilot,
        *,
        frame: MissionFrame,
        reporter: TelemetryFields,
        schedule: Schedule,
    ) -> None:
        """Pass commands to `autopilot`; answer requests for messages with `reporter` and `schedule`."""
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
        handler = self._handlers.get(command)
        result, answers = handler(params) if handler else (Result.UNSUPPORTED, [])
        twice = command == CommandId.DO_SET_MODE and self._dialect.acknowledges_mode_first
        results = [Result.ACCEPTED, result] if twice else [result]
        acks: list[Outgoing] = [(MessageId.COMMAND_ACK, (command, int(each), 0, 0, *sender)) for each in results]
        return acks + answers

    def _select(self, mode: NavMode) -> tuple[Result, list[Outgoing]]:
        return self._result(self._autopilot.select(mode)), []

    def _set_mode(self, params: Params) -> tuple[Result, list[Outgoing]]:
        base, main, sub = params[:3]
        mode = self._dialect.mode_of(main, sub)
        if mode is None or not (isfinite(base) and int(base) & ModeFlag.CUSTOM_MODE_ENABLED):
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
