"""The speed that this computer can keep for a flight of stubs, from a load measured before take-off."""

from collections.abc import Callable
from math import floor
from time import perf_counter

SAMPLE_S = 0.2
"""How long the load is measured [wall s]."""
TICK_WORK = 6.0
"""Load of one vehicle's tick in flight, with its shares of links, bus, log and stub [pieces of work].

By `cordon fly case2 --sitl --speed 10`: 1.75 ms of processor time per tick, 0.29 ms per piece of work."""
LOAD_MAX = 0.7
"""Above this share of a core a flight misses ticks (docs/performance.md: 16 vehicles at 0.6 none, 32 at 1.1 some)."""
_WORK = 10_000


def held_speed(asked: float, ticks_per_s: float, now_s: Callable[[], float] = perf_counter) -> float:
    """Return the speed that a flight can keep now: `asked`, or a lower one, but not below 1.

    The vehicles have `ticks_per_s` together at speed 1. The load is measured by the wall clock, so that the load of
    other programs counts. Takes `SAMPLE_S` if `asked` is above 1.
    """
    if asked <= 1.0:
        return asked
    return speed_for(asked, ticks_per_s, _work_per_s(now_s))


def speed_for(asked: float, ticks_per_s: float, work_per_s: float) -> float:
    """Return the speed for a computer that does so many pieces of work a second, rounded down to a tenth."""
    holds = LOAD_MAX * work_per_s / (TICK_WORK * ticks_per_s)
    return asked if holds >= asked else max(1.0, floor(10.0 * holds) / 10.0)


def _work_per_s(now_s: Callable[[], float]) -> float:
    """Return how many pieces of work one thread of this process does in a second, at present."""
    began_s, done = now_s(), 0
    while (elapsed_s := now_s() - began_s) < SAMPLE_S:
        sum(number * number for number in range(_WORK))
        done += 1
    return done / elapsed_s
