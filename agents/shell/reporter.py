"""The reports of a vehicle to operators and observers, in addition to its state for peers."""

import asyncio
from collections.abc import Callable, Mapping
from math import inf

from msgspec.structs import replace

from agents.flight_end import FlightEnd, LastPosition
from agents.outputs import CoreStatus, TickOutput
from agents.ports import GpsThreat, VehicleStatus
from agents.safety.failsafe import RATIO_MAX, RATIO_RESERVE
from agents.shell.clock import link_s
from agents.shell.control_loop import AgentParts
from agents.shell.outcome import Outcome
from agents.tactics import Tactic
from agents.team.codec import encode
from agents.team.messages import (
    ENDED_LIMIT,
    LINK_SILENT_S,
    REPORT_TOPIC,
    TOPICS,
    NextChange,
    Outlook,
    TargetReport,
    VehicleReport,
)
from agents.team.text import printable
from estimation.frames import Triple
from estimation.state import POSITION, VELOCITY

PERIOD_S = 1.0
"""The period of reports without a change [wall s]."""
_LOOK_S = TOPICS[VehicleReport].period_s
_LAST_REPORTS, _LAST_REPORTS_LOST, _LAST_PERIOD_S = 3, 15, 0.1
"""The bus is best effort: on a busy computer a message may be lost, also one that is sent as the bus is left. For a
vehicle that is unaccounted for it is sent longer: nothing else says where it was last.
"""
_CLIMB_SENT_M = 0.5
_WORDS_LIMIT = 32
ANNOUNCED_S = 60.0
"""The mission's end is announced so long before [s of the mission clock]."""
_UNTIL_THE_END = (
    Tactic.FORMATION,
    Tactic.ENCIRCLE,
    Tactic.TRANSIT,
    Tactic.EXCITE,
    Tactic.ASIDE,
    Tactic.HOLD,
)


class Reporter:
    """Sends the reports of one vehicle: once a second, after a change of mode, link, alert, readiness, start or end,
    once it knows the target or no longer does, and in take-off after each half metre.

    It runs in its own task, so that vehicles are also reported on the ground and after their flight.
    """

    def __init__(
        self,
        parts: AgentParts,
        newest: Callable[[], TickOutput | None],
        clock_lags_s: Callable[[], Mapping[int, float]],
        unaccounted: Callable[[], LastPosition | None] = lambda: None,
    ) -> None:
        """Take the parts, and functions that return the newest output, the lags of the peers' clocks, and the last
        position of a vehicle that is unaccounted for.
        """
        self._parts = parts
        self._newest = newest
        self._clock_lags_s = clock_lags_s
        self._unaccounted = unaccounted
        self._mission: tuple[float | None, float] = (None, 0.0)
        self._end: tuple[float, str] = (-inf, "")
        self._ended, self._is_completed = "", False
        self._start_blockers: str | None = None
        self._in_reserve = False
        self._position_m: Triple | None = None
        self._motion_s: float | None = None
        self._last_report: tuple[object, ...] = ()
        self._reported_target = False
        self._sent_s = 0.0
        self._running: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """Send from now on; the clock's speed must be set."""
        self._running = self._running or asyncio.create_task(self._run())

    @property
    def last_position(self) -> LastPosition | None:
        """The newest position that has been received, None before the first."""
        if self._position_m is None or self._motion_s is None:
            return None
        return LastPosition(self._position_m, link_s(self._parts.clock) - self._motion_s)

    def sense(self, position_m: Triple) -> None:
        """Note that a sample of the vehicle's motion has been received now, with its position."""
        self._position_m, self._motion_s = position_m, link_s(self._parts.clock)

    def start_mission(self, start_s: float, duration_s: float) -> None:
        """Take the mission's begin on the team's clock, and its duration, and report them at once.

        The next tick may send a state on the ring, and onlookers know the time of the mission by reports alone.
        """
        self._mission = (start_s, duration_s)
        self.end_at(start_s + duration_s, "mission's end")
        self._look()

    def note_tick(self) -> None:
        """Take that the core has ticked: that the target is known is reported with the first state that shows it."""
        if self._knows_target != self._reported_target:
            self._look()

    def end_at(self, at_s: float, cause: str) -> None:
        """Take when the vehicle returns or lands as at the mission's end, on the team's clock, and why."""
        self._end = (at_s, cause)

    @property
    def outlook(self) -> Outlook | None:
        """What holds the vehicle and what it does next: by its core, or at the mission's end; None: nothing is due."""
        output, now_s, (end_s, cause) = self._newest(), self._parts.clock.now_s(), self._end
        if output is None:
            return None
        outlook = output.status.outlook
        if output.status.tactic not in _UNTIL_THE_END or not 0.0 < end_s - now_s <= ANNOUNCED_S:
            return outlook
        if outlook is not None and outlook.next is not None and outlook.next.at_s <= end_s:
            return outlook
        returns = self._parts.config.choreography.landing == "return"
        after = Tactic.RETURN_AND_LAND if returns else Tactic.LAND
        return replace(outlook or Outlook(), next=NextChange(after.value, end_s, cause))

    def wait(self, start_blockers: str | None) -> None:
        """Take what forbids the start that the vehicle waits for, None if it waits for none."""
        self._start_blockers = start_blockers

    def stand_by(self) -> None:
        """Take that the vehicle stays on the ground in reserve, until another flight begins."""
        self._start_blockers, self._in_reserve = None, True

    def end(self, outcome: Outcome) -> None:
        """Report the end of the flight, unless it was reported before."""
        if not self._ended:
            self._ended, self._is_completed = ended_words(outcome), outcome.how is FlightEnd.LANDED
        self._look()

    def begin_again(self) -> None:
        """Take that another flight of the vehicle begins, and report it."""
        self._ended, self._is_completed, self._in_reserve = "", False, False
        self._look()

    async def close(self) -> None:
        """Send the last report, which nothing follows, repeatedly; and stop."""
        if self._running is not None:
            self._running.cancel()
            await asyncio.gather(self._running, return_exceptions=True)
            for _ in range(_LAST_REPORTS if self._unaccounted() is None else _LAST_REPORTS_LOST):
                self._send(link_s(self._parts.clock))
                await asyncio.sleep(_LAST_PERIOD_S)

    async def _run(self) -> None:
        while True:
            self._look()
            await self._parts.clock.sleep(_LOOK_S * self._parts.clock.time_scale)

    def _look(self) -> None:
        """Send a report if one is due or something has changed."""
        output, status, now_s, place_m = (
            self._newest(),
            self._parts.link.status,
            link_s(self._parts.clock),
            self._place_m,
        )
        alert = "" if output is None else output.status.alert
        is_silent = self._motion_s is not None and now_s - self._motion_s > LINK_SILENT_S
        self._reported_target = self._knows_target
        report = (
            status.mode,
            status.armed,
            status.in_air,
            status.connected,
            is_silent,
            alert,
            self.outlook,
            self._ended,
            self._start_blockers,
            self._mission,
            self._reported_target,
            place_m and round(place_m[2] / _CLIMB_SENT_M),
        )
        if report != self._last_report or now_s - self._sent_s >= PERIOD_S:
            self._last_report = report
            self._send(now_s)

    def _send(self, now_s: float) -> None:
        self._sent_s = now_s
        self._parts.bus.publish(REPORT_TOPIC, encode(self._report(now_s)))

    def _report(self, now_s: float) -> VehicleReport:
        output, status = self._newest(), self._parts.link.status
        setpoint = None if output is None else output.setpoint
        start_s, duration_s = self._mission
        unaccounted = self._unaccounted()
        return VehicleReport(
            self._parts.config.vehicle_id,
            self._parts.clock.now_s(),
            status.mode.value,
            status.armed,
            status.in_air,
            None if self._motion_s is None else now_s - self._motion_s,
            None if setpoint is None else setpoint.yaw_rad,
            status,
            estimator_words(status),
            start_s,
            duration_s,
            self._ended,
            None if output is None else target_report(output.status),
            self._start_blockers,
            None if self._start_blockers is None else max(map(abs, self._clock_lags_s().values()), default=None),
            self._is_completed if self._ended else None,
            None if self._ended else self.outlook,
            None if unaccounted is None else unaccounted.position_m,
            self._place_m,
            self._in_reserve or None,
        )

    @property
    def _knows_target(self) -> bool:
        output = self._newest()
        return output is not None and output.status.target_estimate is not None

    @property
    def _place_m(self) -> Triple | None:
        """The position of a vehicle whose core has none yet, and so sends no state."""
        output = self._newest()
        return self._position_m if output is None or output.status.own_estimate is None else None


def estimator_words(status: VehicleStatus) -> str:
    """Return the state of an autopilot's estimator as text, empty if not reported."""
    ratio = status.estimator_ratio
    if status.estimator_fault:
        words = status.estimator_fault
    elif status.gps_threat is not GpsThreat.NONE:
        words = f"GPS {status.gps_threat.value}"
    elif ratio is None:
        words = ""
    elif ratio > RATIO_RESERVE:
        words = f"{status.estimator_sensor} {'rejected' if ratio > RATIO_MAX else 'doubtful'}"
    else:
        words = "good"
    return printable(words)[:_WORDS_LIMIT]


def target_report(status: CoreStatus) -> TargetReport | None:
    """Return the report of a vehicle's estimate of the target, None without one."""
    target = status.target_estimate
    if target is None:
        return None
    (x, y), (x_rate, y_rate) = target.mean[POSITION].tolist(), target.mean[VELOCITY].tolist()
    (xx, xy), (_, yy) = target.covariance[POSITION, POSITION].tolist()
    return TargetReport((x, y), (x_rate, y_rate), (xx, xy, yy), max(status.time_s - target.sighted_s, 0.0))


def ended_words(outcome: Outcome) -> str:
    """Return how a vehicle's flight ended, as text."""
    words = f"{outcome.how}: {outcome.reason}" if outcome.reason else outcome.how
    return printable(words)[:ENDED_LIMIT]
