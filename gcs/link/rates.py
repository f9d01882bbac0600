"""Message rates: of one vehicle, their load on a connection in bytes, and their choice by its capacity."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain, takewhile
from math import ceil, inf, sqrt

from agents.gimbal import POINTINGS_HZ
from agents.safety.failsafe import LINK_LOSS_MAX, SILENCES_PER_HOUR_MAX


@dataclass(frozen=True, slots=True)
class Losses:
    """How many frames of a connection were sent, how many of them were lost, and in how many bursts."""

    frames: float = 0.0
    lost: float = 0.0
    bursts: float = 0.0

    @property
    def share(self) -> float:
        """The share of frames that were lost."""
        return self.lost / self.frames if self.lost else 0.0

    @property
    def burst(self) -> float:
        """The mean number of frames lost in a row, as if another burst of three had been seen: few show no length."""
        return (self.lost + 3.0) / (self.bursts + 1.0)

    def silences_per_hour(self, frames_hz: float, silence_s: float) -> float:
        """Return how many times an hour none of `frames_hz` frames a second arrives for `silence_s`, on average.

        Losses are those of Gilbert's channel (Bell System Technical Journal 39, 1960, p. 1253; in Elliott's, 42, 1963,
        p. 1977, the good state loses frames as well): it is good or bad at each frame, and a bad one loses it. With a
        share p of the frames lost, and L of them in a row on average, bursts begin at p / L of the frames, and last for
        k frames or more with the probability (1 - 1/L)^(k - 1). A silence of T takes k = ceil(f T) - 1 lost frames:

            silences an hour = 3600 f (p / L) (1 - 1/L)^(k - 1)

        Losses are assumed to be the same in both directions, and to go by frames: a fade that lasts for a time instead
        takes more frames of a faster stream.
        """
        if not self.lost or silence_s == inf:
            return 0.0
        in_a_row = max(ceil(frames_hz * silence_s) - 1, 1)
        return 3600.0 * frames_hz * self.share / self.burst * (1.0 - 1.0 / self.burst) ** (in_a_row - 1)

    def longer(self, deviations: float) -> "Losses":
        """Return as many losses in bursts that are longer by standard deviations of what is known of their length.

        After each of the lost frames, and of three more as in `burst`, the burst went on or ended.
        """
        frames = self.lost + 3.0
        goes_on = 1.0 - 1.0 / self.burst
        goes_on += deviations * sqrt(goes_on * (1.0 - goes_on) / frames)
        return replace(self, bursts=frames * min(max(1.0 - goes_on, 1.0 / frames), 1.0) - 1.0)

    def and_then(self, more: "Losses", kept: float = 1.0) -> "Losses":
        """Return these and later ones together, of these the share `kept`."""
        return Losses(kept * self.frames + more.frames, kept * self.lost + more.lost, kept * self.bursts + more.bursts)

    def __str__(self) -> str:
        return f"{self.share:.0%} of its messages are lost, {self.burst:.1f} in a row"


@dataclass(frozen=True, slots=True)
class Traffic:
    """Counts of one connection since it was opened.

    `missed` are frames from its vehicles that never arrived, by the gaps in their sequence numbers, which are `bursts`.
    `buffer_free` is the free share of the radio's transmit buffer by the newest RADIO_STATUS, None where no radio
    reports; `delay_grown_s` is by how much the newest round trips are longer than the shortest [s].
    """

    down_bytes: int = 0
    received: int = 0
    missed: int = 0
    bursts: int = 0
    buffer_free: float | None = None
    delay_grown_s: float = 0.0

    def losses(self, before: "Traffic") -> Losses:
        """Return the losses since an earlier count."""
        missed = self.missed - before.missed
        return Losses(self.received - before.received + missed, missed, self.bursts - before.bursts)


STATUS_MIN_HZ, TELEMETRY_MIN_HZ, SETPOINT_MIN_HZ = 0.5, 5.0, 5.0
"""The least rates on a connection that loses nothing; losses in bursts require more."""
RAISED_MAX_HZ, RAISED_STEP_HZ = 50.0, 5.0
"""Motion and setpoints are raised to this for losses in bursts, in steps: each change is requested again."""
STATUS_STEP, STEP, SMALL_STEP = 0.5, 0.75, 0.9


@dataclass(frozen=True, slots=True)
class Rates:
    """The rates of a vehicle's motion and status, and of the setpoints sent to it [Hz].

    `clock_hz` is the rate of its attitude while its clock is measured.
    """

    telemetry_hz: float
    status_hz: float
    setpoint_hz: float
    clock_hz: float = 10.0

    def changed_from(self, before: "Rates") -> str:
        """Return the changes as text."""
        pairs = (
            ("motion", before.telemetry_hz, self.telemetry_hz),
            ("status", before.status_hz, self.status_hz),
            ("setpoints", before.setpoint_hz, self.setpoint_hz),
        )
        return ", ".join(f"{name} {old:.3g} to {new:.3g} Hz" for name, old, new in pairs if old != new)


LEAST = Rates(TELEMETRY_MIN_HZ, STATUS_MIN_HZ, SETPOINT_MIN_HZ)


def rate_levels(full: Rates, least: Rates = LEAST) -> tuple[Rates, ...]:
    """Return the rates from `full` down to the least, in the order in which control degrades.

    Status comes first, then motion, then setpoints; each stops at its least rate, or where it begins below it.
    """
    status = _steps(full.status_hz, STATUS_STEP, least.status_hz)
    telemetry = _steps(full.telemetry_hz, STEP, least.telemetry_hz)
    setpoint = _steps(full.setpoint_hz, STEP, least.setpoint_hz)
    slow = replace(full, status_hz=status[-1])
    slower = replace(slow, telemetry_hz=telemetry[-1])
    return tuple(
        chain(
            (replace(full, status_hz=rate_hz) for rate_hz in status),
            (replace(slow, telemetry_hz=rate_hz) for rate_hz in telemetry[1:]),
            (replace(slower, setpoint_hz=rate_hz) for rate_hz in setpoint[1:]),
        )
    )


def _steps(full_hz: float, step: float, least_hz: float) -> list[float]:
    powers = (full_hz * step**power for power in range(1, 64))
    lower = list(takewhile(lambda rate_hz: rate_hz > least_hz, powers))
    return [full_hz, *lower, *([least_hz] if full_hz > least_hz else [])]


LOCAL_POSITION_NED, TELEMETRY_BYTES = 32, 40
SYS_STATUS, ATTITUDE, EXTENDED_SYS_STATE = 1, 30, 245
HOME_POSITION, BATTERY_STATUS, GPS_RAW_INT, GLOBAL_POSITION_INT, ALTITUDE = 242, 147, 24, 33, 141
STATUS_BYTES = {SYS_STATUS: 43, ATTITUDE: 40, EXTENDED_SYS_STATE: 14}
"""The size of each message at the status rate; attitudes carry the autopilot's clock, which shows a restart."""
SLOW_STATUS_BYTES = {HOME_POSITION: 67, BATTERY_STATUS: 53, GPS_RAW_INT: 64, GLOBAL_POSITION_INT: 40, ALTITUDE: 44}
ESTIMATOR_BYTES = (54, 52)
"""At half the status rate, beside the former: ESTIMATOR_STATUS and WIND_COV, as PX4 sends them; ArduPilot's
EKF_STATUS_REPORT and WIND are smaller.
"""
SETPOINT_BYTES = 65
"""SET_POSITION_TARGET_LOCAL_NED."""
EXTERNAL_BYTES, EXTERNAL_HZ = 48, 30.0
"""VISION_POSITION_ESTIMATE; external positions above this rate are not passed on."""
POINTING_BYTES, GIMBAL_ATTITUDE, GIMBAL_ATTITUDE_BYTES = 47, 285, 61
"""GIMBAL_MANAGER_SET_ATTITUDE, and GIMBAL_DEVICE_ATTITUDE_STATUS at the same rate."""
GIMBAL_CONTROL, GIMBAL_CONTROL_HZ = 281, 1.0
"""GIMBAL_MANAGER_STATUS, which names who controls the gimbal."""
HEARTBEAT_BYTES, HEARTBEAT_HZ = 21, 1.0
ROUND_TRIP_BYTES, ROUND_TRIP_HZ = 28, 0.5
"""TIMESYNC, each way."""
SIGNATURE_BYTES = 13
LOAD_SHARE = 0.7
"""The share of a connection for planned messages: commands, parameters and repetitions take the rest."""


@dataclass(frozen=True, slots=True)
class Load:
    """The bytes to the vehicles of a connection, and those from them [bytes/s]."""

    up_bytes_s: float
    down_bytes_s: float

    @property
    def bytes_s(self) -> float:
        """Both ways together."""
        return self.up_bytes_s + self.down_bytes_s


def load(rates: Rates, vehicles: int, *, signed: bool = False, positions_hz: float = 0.0, gimbals: int = 0) -> Load:
    """Return the load of this many vehicles on one connection at these rates, with external positions to each.

    One heartbeat and one TIMESYNC go up for all of them. So many of them have `gimbals` that are pointed.
    """
    extra = SIGNATURE_BYTES if signed else 0
    streams = (
        (rates.telemetry_hz, (TELEMETRY_BYTES,)),
        (rates.status_hz, STATUS_BYTES.values()),
        (rates.status_hz / 2.0, (*SLOW_STATUS_BYTES.values(), *ESTIMATOR_BYTES)),
        (HEARTBEAT_HZ, (HEARTBEAT_BYTES,)),
        (ROUND_TRIP_HZ, (ROUND_TRIP_BYTES,)),
    )
    down = sum(rate_hz * (size + extra) for rate_hz, sizes in streams for size in sizes)
    up = rates.setpoint_hz * (SETPOINT_BYTES + extra) + positions_hz * (EXTERNAL_BYTES + extra)
    shared = HEARTBEAT_HZ * (HEARTBEAT_BYTES + extra) + ROUND_TRIP_HZ * (ROUND_TRIP_BYTES + extra)
    pointings, attitudes = (POINTINGS_HZ * (size + extra) for size in (POINTING_BYTES, GIMBAL_ATTITUDE_BYTES))
    return Load(vehicles * up + shared + gimbals * pointings, vehicles * down + gimbals * attitudes)


def fitting(
    levels: Sequence[Rates],
    vehicles: int,
    capacity_bytes_s: float,
    *,
    signed: bool = False,
    share: float = LOAD_SHARE,
) -> int:
    """Return the index of the first rates that a connection carries with its reserve; of the last if none fit."""
    room = share * capacity_bytes_s
    fits = (index for index, rates in enumerate(levels) if load(rates, vehicles, signed=signed).bytes_s <= room)
    return next(fits, len(levels) - 1)


_SLOW_MESSAGES = len(SLOW_STATUS_BYTES) + len(ESTIMATOR_BYTES)
DOWN_HZ = STATUS_MIN_HZ * (len(STATUS_BYTES) + _SLOW_MESSAGES / 2.0) + HEARTBEAT_HZ + ROUND_TRIP_HZ
UP_HZ = HEARTBEAT_HZ + ROUND_TRIP_HZ
"""The frames a second beside motion, at the least status rate, and beside setpoints."""


def least_hz(losses: Losses, beside_hz: float, silence_s: float) -> float:
    """Return the least rate of motion, or of setpoints, with few enough silences; the highest if none has."""
    rates_hz = (step * RAISED_STEP_HZ for step in range(1, round(RAISED_MAX_HZ / RAISED_STEP_HZ)))
    allowed = SILENCES_PER_HOUR / 2.0  # those of motion and of setpoints together
    few = (hz for hz in rates_hz if losses.silences_per_hour(hz + beside_hz, silence_s) <= allowed)
    return next(few, RAISED_MAX_HZ)


DEVIATIONS = 2.0
"""The length of the bursts is known to so many standard deviations."""
SILENCES_PER_HOUR = SILENCES_PER_HOUR_MAX / 10.0
"""How many silences an hour the rates are chosen for: losses are not known exactly."""
LOSSY_SHARE = 0.9
"""The share of a connection for planned messages where losses in bursts require it."""
LOOK_PERIOD_S = 2.0
LOSSES_KEPT = 0.97
"""Of earlier losses, at each look: those of the last minute count."""
ADAPT_PERIOD_S = 10.0
FRAMES_MIN = 100
"""Fewer frames do not show losses."""
LOSS_LOW = 0.7 * LINK_LOSS_MAX
BUFFER_LOW, BUFFER_HIGH = 0.2, 0.6
"""Free shares of the radio's transmit buffer: below the first the rates go down, above the second they may go up."""
DELAY_HIGH_S, DELAY_LOW_S = 0.6, 0.3
"""Growth of the round trip, by messages that wait: likewise."""
UP_AFTER_S = 20.0
"""How long a connection must be well before its rates go up by a step, which may overload it again, and before its
fault is over.
"""


class RateController:
    """The rates in force on one connection, for all of its vehicles alike.

    `automatic` rates begin at the first of `rate_levels(full)` that fits `capacity_bytes_s` (None: unknown). `look`
    finds what waits and what is lost. Where messages wait - the radio's buffer is full, or the delay grows - they step
    down along these levels, and up again to their first. Losses do not show that messages wait: for losses in bursts
    motion and setpoints are kept at rates, or raised to rates, at which `telemetry_s` without motion and `offboard_s`
    without setpoints are rare, as far as the connection carries them. Simulators' true motions, `truth_bytes_s`
    together, are requested where there is room for them.
    """

    def __init__(
        self,
        full: Rates,
        vehicles: int = 1,
        capacity_bytes_s: float | None = None,
        *,
        automatic: bool = False,
        signed: bool = False,
        limits_setpoints: bool = False,
        truth_bytes_s: float = 0.0,
        positions_hz: float = 0.0,
        gimbals: int = 0,
        telemetry_s: float = inf,
        offboard_s: float = inf,
    ) -> None:
        self.capacity_bytes_s = capacity_bytes_s
        self.automatic = automatic
        self.is_bound = automatic or limits_setpoints or capacity_bytes_s is not None
        """Whether frames wait in the transmit queue."""
        self.vehicles, self.signed = vehicles, signed
        self.telemetry_s, self.offboard_s = telemetry_s, offboard_s
        self._positions_hz, self._gimbals = positions_hz, gimbals
        self._full = full
        self._levels: Sequence[Rates] = (full,)
        self._first = self._down = 0
        self.losses = Losses()
        """The newest losses."""
        self.adapt(self.losses)
        self.truth_bytes_s = 0.0
        """The load of simulators' true motions; 0 if the connection has no room for them."""
        if self.has_room(truth_bytes_s):
            self.truth_bytes_s = truth_bytes_s
        self.fault = ""
        """The connection's fault, empty without one: it lasts until the connection has been healthy for some time."""
        self._before: Traffic | None = None
        self._look_next_s = self._adapt_next_s = -inf
        self._room_since_s = self._ill_s = -inf
        self._lossy, self._loses_little = "", True

    @property
    def rates(self) -> Rates:
        """The rates in force."""
        return self._levels[min(self._first + self._down, len(self._levels) - 1)]

    @property
    def copies(self) -> int:
        """How many times each setpoint may be sent, so that their rate is reached."""
        return max(ceil(self.rates.setpoint_hz / self._full.setpoint_hz), 1)

    @property
    def load(self) -> Load:
        """The load of the connection at these rates."""
        positions_hz, gimbals = self._positions_hz, self._gimbals
        asked = load(self.rates, self.vehicles, signed=self.signed, positions_hz=positions_hz, gimbals=gimbals)
        return replace(asked, down_bytes_s=asked.down_bytes_s + self.truth_bytes_s)

    def has_room(self, more_bytes_s: float) -> bool:
        """Return whether this much more fits."""
        return self.load.bytes_s + more_bytes_s <= LOAD_SHARE * (self.capacity_bytes_s or inf)

    @property
    def up_bytes_s(self) -> float | None:
        """The bound of what is sent, which leaves room for what the vehicles send; None without a bound."""
        if self.capacity_bytes_s is None:
            return None
        return max(self.capacity_bytes_s - self.load.down_bytes_s, self.load.up_bytes_s)

    @property
    def silences_per_hour(self) -> float:
        """How many silences of motion, or of setpoints, an hour has at these rates and losses for each vehicle."""
        of_motion = self.losses.silences_per_hour(self.rates.telemetry_hz + DOWN_HZ, self.telemetry_s)
        return of_motion + self.losses.silences_per_hour(self.rates.setpoint_hz + UP_HZ, self.offboard_s)

    def silences_of(self, losses: Losses) -> tuple[float, float, float]:
        """Return the least, likely and most silences an hour for losses, each with the rates that are chosen for it.

        95 of 100 connections with losses like these are between the least and the most.
        """
        chosen, likely = copy(self), list[float]()
        for deviations in (-DEVIATIONS, 0.0, DEVIATIONS):
            chosen.adapt(losses.longer(deviations))
            likely.append(chosen.silences_per_hour)
        return min(likely), likely[1], max(likely)

    def adapt(self, losses: Losses) -> None:
        """Take the newest losses, and choose the rates for them."""
        self.losses = losses
        if not self.automatic:
            return
        telemetry_hz = least_hz(losses, DOWN_HZ, self.telemetry_s)
        setpoint_hz = least_hz(losses, UP_HZ, self.offboard_s)
        full = replace(
            self._full,
            telemetry_hz=_raised(self._full.telemetry_hz, telemetry_hz),
            setpoint_hz=_raised(self._full.setpoint_hz, setpoint_hz),
        )
        least = replace(LEAST, telemetry_hz=telemetry_hz, setpoint_hz=setpoint_hz)
        levels, room = rate_levels(full, least), self.capacity_bytes_s or inf
        self._first = fitting(levels, self.vehicles, room, signed=self.signed)
        self._levels = (*levels, *_lower(levels[-1]))
        if self._first == len(levels) - 1:
            share = LOAD_SHARE if least == LEAST else LOSSY_SHARE
            self._first += fitting(self._levels[self._first :], self.vehicles, room, signed=self.signed, share=share)

    def count_anew(self) -> None:
        """Count losses from now on: the gaps of a vehicle that was switched off are none."""
        self._before, self.fault, self._lossy, self._loses_little = None, "", "", True
        self.adapt(Losses())

    def look(self, traffic: Traffic, now_s: float) -> None:
        """Take the counts of a connection at a time [s, wall]; any of its vehicles may bring them."""
        if now_s < self._look_next_s:
            return
        before, self._before = self._before, traffic
        self._look_next_s = now_s + LOOK_PERIOD_S
        if before is None:
            self._room_since_s = now_s
            return
        self.losses = self.losses.and_then(traffic.losses(before), LOSSES_KEPT)
        if now_s >= self._adapt_next_s and self.losses.frames >= FRAMES_MIN:
            self._adapt_next_s = now_s + ADAPT_PERIOD_S
            self.adapt(self.losses)
            self._lossy = self._exceeding(LINK_LOSS_MAX, SILENCES_PER_HOUR_MAX)
            self._loses_little = not self._exceeding(LOSS_LOW, SILENCES_PER_HOUR)
        waits, has_room = self._follow(traffic, now_s)
        if waits or self._lossy:
            self.fault, self._ill_s = ", ".join(filter(None, (self._lossy, waits))), now_s
        elif not (has_room and self._loses_little):
            self._ill_s = now_s
        elif now_s - self._ill_s >= UP_AFTER_S:
            self.fault = ""

    def _follow(self, traffic: Traffic, now_s: float) -> tuple[str, bool]:
        """Step down where messages wait, and up after a time with room; return what waits, and whether it has room."""
        free, grown_s = 1.0 if traffic.buffer_free is None else traffic.buffer_free, traffic.delay_grown_s
        waits = "its radio's buffer is full" if free < BUFFER_LOW else ""
        if grown_s > DELAY_HIGH_S:
            waits = waits or f"messages wait for {grown_s:.1f} s"
        if waits:
            self._down = min(self._down + 1, len(self._levels) - 1 - self._first)
        has_room = free >= BUFFER_HIGH and grown_s <= DELAY_LOW_S
        if not has_room:
            self._room_since_s = now_s
        elif now_s - self._room_since_s >= UP_AFTER_S:
            self._down, self._room_since_s = max(self._down - 1, 0), now_s
        return waits, has_room

    def _exceeding(self, share_max: float, silences_max: float) -> str:
        """Return the losses as text if they exceed one of the limits."""
        silences, text = self.silences_per_hour, str(self.losses)
        if self.losses.share <= share_max and silences <= silences_max:
            return ""
        return text if silences <= silences_max else f"{text}: {silences:.1g} silences an hour are likely"


def _raised(full_hz: float, least_hz: float) -> float:
    return max(full_hz, least_hz) if least_hz > RAISED_STEP_HZ else full_hz


def _lower(rates: Rates) -> tuple[Rates, ...]:
    """Return the rates below those that losses require: motion and setpoints degrade alike."""
    lower = replace(
        rates,
        telemetry_hz=min(rates.telemetry_hz, max(SMALL_STEP * rates.telemetry_hz, TELEMETRY_MIN_HZ)),
        setpoint_hz=min(rates.setpoint_hz, max(SMALL_STEP * rates.setpoint_hz, SETPOINT_MIN_HZ)),
    )
    return () if lower == rates else (lower, *_lower(lower))
