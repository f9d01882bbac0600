"""Calls to one vehicle through MAVSDK on separate threads, with the autopilot's status texts in refusals."""

import asyncio
import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from math import dist
from typing import Any, TypeVar

from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage

from agents.gimbal import POINTINGS_HZ
from agents.ports import VehicleRefusedError
from agents.shell.clock import MissionClock
from estimation.frames import Geodetic, MissionFrame, Triple
from gcs.link.feed import VehicleFeed
from gcs.link.ground_truth import RATE_HZ as TRUTH_RATE_HZ
from gcs.link.rates import (
    ATTITUDE,
    GIMBAL_ATTITUDE,
    GIMBAL_CONTROL,
    GIMBAL_CONTROL_HZ,
    LOCAL_POSITION_NED,
    SLOW_STATUS_BYTES,
    STATUS_BYTES,
    Rates,
)
from gcs.link.status_texts import quoted
from gcs.link.streams import Streams
from gcs.link.traffic import ADSB_VEHICLE, ADSB_VEHICLE_HZ

Result = TypeVar("Result")

POLL_PERIOD_S = 0.02
"""How often a condition is looked at [s of the link]."""
TEXT_DELAY_S = 0.3
"""Wait for the status text that explains a refusal: PX4 sends it beside the acknowledgement."""
EFFECT_DELAY_S = 2.0
"""Wait for the effect of a call that is refused after it may have begun: heartbeats come once a second."""
CALLS_UNANSWERED = 4
"""How often a call is made without an answer. MAVSDK sends a command four times in 2 s and waits for each answer for
0.5 s: together that is 8 s, in which an armed autopilot does not yet disarm for want of a take-off (10 s).
"""
SPEED_SNAP = 0.1
DELAY_CHANGE_MAX_S = 1.0
"""By how much a link's delay may change while a clock is measured: as long as a full buffer of 2 kB takes to empty at
19 200 baud [wall s].
"""
CLOCK_SAMPLES, CLOCK_LONGEST_S = 6, 5.0
ORIGIN_DISTANCE_MAX_M = 20_000.0
SET_MESSAGE_INTERVAL = 511
RATE_ATTEMPTS = 5
"""Until the rates are set, the autopilot's default streams may fill a slow link, and acknowledgements are late."""
TIMEOUT = "TIMEOUT"
"""The name of the result, in each plugin of MAVSDK, of a request that was not answered."""
UNANSWERED = (TIMEOUT, "PARAMETER_ERROR")
"""The results of calls that may not have been answered: MAVSDK's actions tell no unanswered parameter from others."""
DO_SET_MODE, CUSTOM_MODE_ENABLED, AUTOPILOT_COMPONENT = 176, 1, 1


class NotReceivedError(VehicleRefusedError):
    """Nothing is received where the vehicle should be."""


class NotReadyError(VehicleRefusedError):
    """The vehicle is not ready yet; waiting may resolve it."""


class VehicleCalls:
    """Runs MAVSDK's blocking calls for one vehicle, and waits for their effect.

    Every vehicle has its own threads: calls to a dead vehicle block for seconds and must not delay the others.
    Waits are times of the mission's clock. `received` returns how many messages of each number have arrived.
    """

    def __init__(
        self, system_id: int, feed: VehicleFeed, clock: MissionClock, received: Callable[[], Mapping[int, int]]
    ) -> None:
        self._clock = clock
        self._system_id = system_id
        self._subject = f"vehicle {system_id}"
        self._feed = feed
        self._streams = Streams(received, clock.now_s)
        self._executor = ThreadPoolExecutor(2, thread_name_prefix=f"vehicle-{system_id}")
        self._running = set[Future[Any]]()
        self._urgent = ThreadPoolExecutor(1, thread_name_prefix=f"vehicle-{system_id}-urgent")

    async def run(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Run a blocking call and return its result."""
        running = self._executor.submit(function, *arguments)
        self._running.add(running)
        running.add_done_callback(self._running.discard)
        return await asyncio.wrap_future(running)

    async def command_until(
        self, verb: str, function: Callable[..., object], condition: Callable[[], bool], *, attempts: int, each_s: float
    ) -> None:
        """Repeat a call on the urgent thread until its effect is received; one that was there before needs an answer.

        Each attempt waits `each_s` [s of the link] for the effect. Raises VehicleRefusedError when all attempts fail.
        """
        accepted, began_s, is_there = False, time.monotonic(), condition()
        for _ in range(attempts):
            with suppress(MavsdkError, RuntimeError), self._clock.held():
                await asyncio.get_running_loop().run_in_executor(self._urgent, function)
                accepted = True
            counts = accepted or not is_there
            if await self.reached(lambda: counts and condition(), each_s * self._clock.time_scale):  # noqa: B023
                return
        failure = "did not carry it out" if accepted else "did not acknowledge it"
        raise self.refusal(
            f"{failure}: command to {verb}, sent {attempts} times", "take over by remote control", began_s
        )

    async def command(
        self,
        verb: str,
        function: Callable[..., object],
        *arguments: object,
        refusals: int = 1,
        unanswered: int = CALLS_UNANSWERED,
        done: Callable[[], bool] | None = None,
    ) -> None:
        """Run a call that the autopilot may refuse, again while it is not answered: it, or its answer, may be lost.

        `done` returns whether its effect has been received. It counts more than a refusal: an autopilot may refuse to
        begin what it has begun. Raises VehicleRefusedError after `refusals` refusals, or `unanswered` calls.
        """
        began_s = time.monotonic()
        while True:
            try:
                with self._clock.held():
                    await self.run(function, *arguments)
            except (MavsdkError, RuntimeError) as error:
                failure, result = error, getattr(getattr(error, "result", None), "name", str(error))
            else:
                return
            answered = result not in UNANSWERED
            refusals, unanswered = refusals - answered, unanswered - (not answered)
            is_last = not (refusals and unanswered)
            delay_s = TEXT_DELAY_S if done is None else EFFECT_DELAY_S
            delay_s = delay_s * self._clock.time_scale if answered or is_last else 0.0
            if await self.reached(done or (lambda: False), delay_s):
                return
            if is_last:
                said, next_step = f"did not answer the command to {verb}", "check its link"
                if answered:
                    said, next_step = f"refused to {verb} ({result})", "resolve the cause that the autopilot reports"
                raise self.refusal(said, next_step, began_s) from failure

    async def told(self, condition: Callable[[], bool], within_s: float) -> None:
        """Wait for what MAVSDK finds out by itself, at most `within_s` [wall s]; no other time passes meanwhile."""
        end_s = time.monotonic() + within_s
        with self._clock.held():
            while not condition() and time.monotonic() < end_s:
                await asyncio.sleep(POLL_PERIOD_S)

    async def idle(self) -> None:
        """Wait until no call is under way, also of those whose caller was cancelled: MAVSDK repeats their commands."""
        with self._clock.held():
            await asyncio.to_thread(wait, tuple(self._running))

    async def until(
        self, condition: Callable[[], bool], timeout_s: float, failure: Callable[[], str], next_step: str
    ) -> None:
        """Wait for a condition; raises VehicleRefusedError with `failure()` after `timeout_s` of the mission clock."""
        began_s = time.monotonic()
        if not await self.reached(condition, self._clock.allowed_s(timeout_s)):
            raise self.refusal(f"{failure()} within {timeout_s:g} s", next_step, began_s)

    async def reached(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Wait for a condition, at most `within_s`, and return whether it holds."""
        end_s = self._clock.now_s() + within_s
        while not condition():
            if self._clock.now_s() > end_s:
                return False
            await self._clock.sleep(POLL_PERIOD_S * self._clock.time_scale)
        return True

    def refusal(self, reason: str, next_step: str, since_s: float | None = None) -> VehicleRefusedError:
        """Return the refusal with its reason, the state of the link, and the status texts that explain it.

        For a request these are the texts since it was made at `since_s` [s, monotonic].
        """
        texts = () if since_s is None else self._feed.texts.refusing(since_s)
        return VehicleRefusedError(self._explained(reason, texts), next_step, subject=self._subject)

    def unready(self, reason: str, next_step: str) -> "NotReadyError":
        """Return the refusal of a vehicle that is not ready, with the failed checks that it reports."""
        texts = self._feed.texts.failed_checks()
        return NotReadyError(self._explained(reason, texts), next_step, subject=self._subject)

    def _explained(self, reason: str, texts: Sequence[str]) -> str:
        lost = "" if self._feed.status.connected else "; its link is lost"
        reported = f"; the autopilot reports {quoted(texts)}" if texts else ""
        return f"{reason}{lost}{reported}"

    async def request_rates(self, rates: Rates) -> None:
        """Request the vehicle's motion at the telemetry rate, and its status at lower rates.

        ArduPilot sends only requested messages, PX4 more than a radio carries. Raises VehicleRefusedError when the
        motion is refused; a refused status message does not prevent a flight.
        """
        motion = partial(self._set_interval, LOCAL_POSITION_NED, rates.telemetry_hz)
        await self.command("send its local position", motion, refusals=RATE_ATTEMPTS, unanswered=RATE_ATTEMPTS)
        # Without motion the autopilot may have restarted, with another origin: the link requests everything again.
        self._streams.expect(LOCAL_POSITION_NED, rates.telemetry_hz, attempts=0)
        for message in STATUS_BYTES:
            await self._request(message, rates.status_hz)
        estimator = self._feed.autopilot.estimator
        for message in (*SLOW_STATUS_BYTES, estimator.number, estimator.wind_number):
            await self._request(message, rates.status_hz / 2.0)
        if self._feed.truth is not None:
            await self._request(self._feed.autopilot.truth.number, TRUTH_RATE_HZ)
        if self._feed.gimbal is not None:
            await self._request(GIMBAL_ATTITUDE, POINTINGS_HZ)
            await self._request(GIMBAL_CONTROL, GIMBAL_CONTROL_HZ)
        if self._feed.asks_traffic:
            await self._request(ADSB_VEHICLE, ADSB_VEHICLE_HZ)
            self._streams.forget(ADSB_VEHICLE)  # as many arrive as there are aircraft

    async def correct_rates(self) -> bool:
        """Request again what arrives at another rate than requested, and return whether all was right.

        After a request without an answer the others wait for the next time.
        """
        wrong = self._streams.wrong()
        with suppress(MavlinkDirectError):
            for message, rate_hz in wrong.items():
                await self.run(self._set_interval, message, rate_hz)
        return not wrong

    async def _request(self, message: int, rate_hz: float) -> None:
        """Request a message at a rate [Hz], again without an answer: the request, or its answer, may be lost."""
        for _ in range(RATE_ATTEMPTS):
            try:
                await self.run(self._set_interval, message, rate_hz)
            except MavlinkDirectError as error:
                if error.result.name != TIMEOUT:
                    self._streams.forget(message)
                    return
            else:
                break
        self._streams.expect(message, rate_hz)

    def _set_interval(self, message: int, rate_hz: float) -> None:
        """Request a message at a rate [Hz]; blocks until acknowledged, raises MavlinkDirectError otherwise."""
        command = command_long(self._system_id, SET_MESSAGE_INTERVAL, float(message), 1e6 / rate_hz)
        self._feed.reports.direct.send_command(command)

    async def clock_ratio(self, rates: Rates, duration_s: float) -> float | None:
        """Return how many times faster than its link's time the autopilot's clock runs; None without attitudes.

        The attitude rate is set for `duration_s` [s of the link] only, or for as long as some of them take at a low
        rate; for longer while a change of the link's delay may be why the ratio is no whole number. On a governed
        clock, which is the autopilot's as well, nothing is measured.
        """
        duration_s = max(duration_s, min(CLOCK_SAMPLES / rates.clock_hz, CLOCK_LONGEST_S))
        if self._clock.is_governed:
            await self._clock.sleep(duration_s)
            return 1.0
        await self._request(ATTITUDE, rates.clock_hz)
        try:
            times = await self._feed.attitude_clock(duration_s)
            longer_s = DELAY_CHANGE_MAX_S / SPEED_SNAP
            while _delay_explains(ratio := clock_ratio(times, duration_s), times) and longer_s > 0.0:
                times += await self._feed.attitude_clock(duration_s)
                longer_s -= duration_s
            return ratio
        finally:
            await self._request(ATTITUDE, rates.status_hz)

    async def close(self) -> None:
        """Wait for running calls: destroying MAVSDK's objects before would block their threads for ever."""
        for executor in (self._executor, self._urgent):
            await asyncio.to_thread(executor.shutdown, cancel_futures=True)


def choose_guided(system: Any, guided_mode: int) -> None:
    """Switch an autopilot to its guided mode; blocks until acknowledged, raises MavsdkError when it is refused.

    ArduCopter arms neither in LAND nor in BRAKE, which is MAVSDK's hold. MAVSDK itself requests GUIDED only together
    with a setpoint, which it then repeats, and which would interrupt the take-off.
    """
    direct = MavlinkDirect(system)
    try:
        direct.send_command(command_long(system.get_system_id(), DO_SET_MODE, CUSTOM_MODE_ENABLED, guided_mode))
    finally:
        direct.destroy()


def command_long(system_id: int, command: int, *params: float) -> MavlinkMessage:
    """Return a command to the autopilot of a system, for MAVSDK's `send_command`; missing parameters are 0."""
    fields = {"command": command, "confirmation": 0, **{f"param{place}": 0.0 for place in range(1, 8)}}
    fields |= {f"param{place}": value for place, value in enumerate(params, start=1)}
    fields |= {"target_system": system_id, "target_component": AUTOPILOT_COMPONENT}
    return MavlinkMessage("COMMAND_LONG", 0, 0, system_id, AUTOPILOT_COMPONENT, json.dumps(fields))


async def find_origin(
    calls: VehicleCalls, feed: VehicleFeed, frame: MissionFrame, clock: MissionClock, timeout_s: float
) -> Triple:
    """Return the mission position of the vehicle's own NED origin [m].

    Raises VehicleRefusedError when its estimator has none in time, or one that is too far from the mission's.
    """
    end_s = clock.now_s() + clock.allowed_s(timeout_s)
    while (place := await calls.run(_origin, feed.plugin)) is None:
        if clock.now_s() > end_s:
            raise calls.unready(
                f"has no position after {timeout_s:g} s ({feed.failing()})", "wait for GPS, or check it"
            )
    origin_m = frame.mission_from_geodetic(place)
    if (away_m := dist(origin_m, (0.0, 0.0, 0.0))) > ORIGIN_DISTANCE_MAX_M:
        where = f"{place.latitude_deg:.5f}, {place.longitude_deg:.5f}"
        raise calls.refusal(
            f"is at {where}, {away_m / 1000.0:.0f} km from the mission's origin", "set the origin in [frame]"
        )
    return origin_m


def clock_ratio(times: Sequence[tuple[float, float]], duration_s: float) -> float | None:
    """Return how fast the autopilot's clock runs by (wall, autopilot) times [s]; None without half of `duration_s`.

    A ratio within a tenth of a whole number is rounded to it: the times of reception are not exact.
    """
    if len(times) < 2:
        return None
    wall_s, autopilot_s = times[-1][0] - times[0][0], times[-1][1] - times[0][1]
    if wall_s < duration_s / 2.0 or autopilot_s <= 0.0:
        return None
    ratio = autopilot_s / wall_s
    whole = float(max(1, round(ratio)))
    return whole if abs(ratio - whole) <= SPEED_SNAP * whole else ratio


def _delay_explains(ratio: float | None, times: Sequence[tuple[float, float]]) -> bool:
    """Return whether a ratio may be no whole number only because the link's delay has changed."""
    if ratio is None:
        return False
    whole = max(1, round(ratio))
    return 0.0 < abs(ratio / whole - 1.0) * (times[-1][0] - times[0][0]) <= DELAY_CHANGE_MAX_S


def _origin(telemetry: Any) -> Geodetic | None:
    """Request the origin; blocks for up to 5 s when there is none."""
    try:
        origin = telemetry.get_gps_global_origin()
        return Geodetic(origin.latitude_deg, origin.longitude_deg, origin.altitude_m)
    except (MavsdkError, ValueError):
        time.sleep(POLL_PERIOD_S)
        return None
