"""Message rates: of one vehicle, their load on a connection in bytes, and their choice by its capacity."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, takewhile
from math import inf

from agents.safety.failsafe import LINK_LOSS_MAX


@dataclass(frozen=True, slots=True)
class Traffic:
    """Counts of one connection since it was opened.

    `missed` are frames from its vehicles that never arrived, by the gaps in their sequence numbers. `buffer_free` is
    the free share of the radio's transmit buffer by the newest RADIO_STATUS, None where no radio reports.
    """

    up_bytes: int = 0
    down_bytes: int = 0
    received: int = 0
    missed: int = 0
    buffer_free: float | None = None

    def lost_share(self, before: "Traffic") -> float:
        """Return the share of frames that were lost since an earlier count."""
        received, missed = self.received - before.received, self.missed - before.missed
        return missed / (received + missed) if missed > 0 else 0.0


STATUS_MIN_HZ, TELEMETRY_MIN_HZ = 0.5, 5.0
SETPOINT_MIN_HZ = 5.0
"""PX4 leaves offboard below 2 Hz: two setpoints in a row may be lost."""
STATUS_STEP, STEP = 0.5, 0.75


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


def rate_levels(full: Rates) -> tuple[Rates, ...]:
    """Return the rates from `full` down to the least, in the order in which control degrades.

    Status comes first, then motion, then setpoints; each stops at its least rate, or where it begins below it.
    """
    status = _steps(full.status_hz, STATUS_STEP, STATUS_MIN_HZ)
    telemetry = _steps(full.telemetry_hz, STEP, TELEMETRY_MIN_HZ)
    setpoint = _steps(full.setpoint_hz, STEP, SETPOINT_MIN_HZ)
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


TELEMETRY_BYTES = 40
"""LOCAL_POSITION_NED."""
STATUS_BYTES = (43, 40, 14)
"""SYS_STATUS, ATTITUDE, EXTENDED_SYS_STATE."""
SLOW_STATUS_BYTES = (67, 53, 64, 40, 54, 52)
"""At half the status rate: HOME_POSITION, BATTERY_STATUS, GPS_RAW_INT, GLOBAL_POSITION_INT, ESTIMATOR_STATUS and
WIND_COV, as PX4 sends them; ArduPilot's EKF_STATUS_REPORT and WIND are smaller.
"""
SETPOINT_BYTES = 65
"""SET_POSITION_TARGET_LOCAL_NED."""
EXTERNAL_BYTES, EXTERNAL_HZ = 48, 30.0
"""VISION_POSITION_ESTIMATE; external positions above this rate are not passed on."""
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


def load(rates: Rates, vehicles: int, *, signed: bool = False, positions_hz: float = 0.0) -> Load:
    """Return the load of this many vehicles on one connection at these rates, with external positions to each.

    One heartbeat and one TIMESYNC go up for all of them.
    """
    extra = SIGNATURE_BYTES if signed else 0
    streams = (
        (rates.telemetry_hz, (TELEMETRY_BYTES,)),
        (rates.status_hz, STATUS_BYTES),
        (rates.status_hz / 2.0, SLOW_STATUS_BYTES),
        (HEARTBEAT_HZ, (HEARTBEAT_BYTES,)),
        (ROUND_TRIP_HZ, (ROUND_TRIP_BYTES,)),
    )
    down = sum(rate_hz * (size + extra) for rate_hz, sizes in streams for size in sizes)
    up = rates.setpoint_hz * (SETPOINT_BYTES + extra) + positions_hz * (EXTERNAL_BYTES + extra)
    shared = HEARTBEAT_HZ * (HEARTBEAT_BYTES + extra) + ROUND_TRIP_HZ * (ROUND_TRIP_BYTES + extra)
    return Load(vehicles * up + shared, vehicles * down)


def fitting(levels: Sequence[Rates], vehicles: int, capacity_bytes_s: float, *, signed: bool = False) -> int:
    """Return the index of the first rates that a connection carries with its reserve; of the last if none fit."""
    room = LOAD_SHARE * capacity_bytes_s
    fits = (index for index, rates in enumerate(levels) if load(rates, vehicles, signed=signed).bytes_s <= room)
    return next(fits, len(levels) - 1)


LOOK_PERIOD_S = 2.0
LOSS_LOW = 0.03
"""Share of lost frames between two looks below which the rates may go up; above `LINK_LOSS_MAX` they go down."""
BUFFER_LOW, BUFFER_HIGH = 0.2, 0.6
"""Free shares of the radio's transmit buffer: below the first the rates go down, above the second they may go up."""
UP_AFTER_S = 20.0
"""How long a connection must be healthy before its rates go up by a step: a step up may overload it again."""
FRAMES_MIN = 20
"""Fewer frames do not show a share of losses."""


class RateController:
    """The rates in force on one connection, for all of its vehicles alike.

    `look` finds what is lost and what the radio reports. `automatic` rates begin at the first of `rate_levels(full)`
    that fits `capacity_bytes_s` (None: unknown), and step along these levels by it. They never rise above their first.
    Simulators' true motions, `truth_bytes_s` together, are requested where there is room for them.
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
    ) -> None:
        self.capacity_bytes_s = capacity_bytes_s
        self.is_bound = automatic or limits_setpoints or capacity_bytes_s is not None
        """Whether frames wait in the transmit queue."""
        self.vehicles, self.signed = vehicles, signed
        self._positions_hz = positions_hz
        self._levels = rate_levels(full) if automatic else (full,)
        self._first = fitting(self._levels, vehicles, capacity_bytes_s or inf, signed=signed)
        self._at = self._first
        self.truth_bytes_s = 0.0
        """The load of simulators' true motions; 0 if the connection has no room for them."""
        if self.has_room(truth_bytes_s):
            self.truth_bytes_s = truth_bytes_s
        self.fault = ""
        """The connection's fault in the newest looks, empty without one."""
        self._before: Traffic | None = None
        self._look_next_s = -inf
        self._well_since_s = -inf

    @property
    def rates(self) -> Rates:
        """The rates in force."""
        return self._levels[self._at]

    @property
    def load(self) -> Load:
        """The load of the connection at these rates."""
        asked = load(self.rates, self.vehicles, signed=self.signed, positions_hz=self._positions_hz)
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

    def look(self, traffic: Traffic, now_s: float) -> None:
        """Take the counts of a connection at a time [s, wall]; any of its vehicles may bring them."""
        if now_s < self._look_next_s:
            return
        before, self._before = self._before, traffic
        self._look_next_s = now_s + LOOK_PERIOD_S
        if before is None or traffic.received - before.received + traffic.missed - before.missed < FRAMES_MIN:
            self._well_since_s = now_s
            return
        lost, free = traffic.lost_share(before), 1.0 if traffic.buffer_free is None else traffic.buffer_free
        if lost > LINK_LOSS_MAX or free < BUFFER_LOW:
            is_lossy = lost > LINK_LOSS_MAX
            self.fault = f"{lost:.0%} of its messages are lost" if is_lossy else "its radio's buffer is full"
            self._at = min(self._at + 1, len(self._levels) - 1)
            self._well_since_s = now_s
        elif lost > LOSS_LOW or free < BUFFER_HIGH:
            self._well_since_s = now_s
        else:
            self.fault = ""
            if now_s - self._well_since_s >= UP_AFTER_S:
                self._at = max(self._at - 1, self._first)
                self._well_since_s = now_s
