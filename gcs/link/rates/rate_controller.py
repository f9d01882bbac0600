"""The rates of the vehicles of one connection: those of the mission, or chosen by the connection's capacity."""

from dataclasses import replace
from math import inf

from agents.safety.failsafe import LINK_LOSS_MAX
from gcs.link.rates.budget import LOAD_SHARE, Load, fitting, load
from gcs.link.rates.rates import Rates, Traffic, rate_levels

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
