"""The clock that all agents of a team share: waits for the flight use it, waits for this computer do not."""

import asyncio
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

_SHORTEST_S = 1e-6
"""A shorter sleep may not change the time of an event loop, which has a limited precision."""
_WALL_WAIT_MIN_S = 3.0
"""Shortest wait for a vehicle at any speed of its simulation: threads and heartbeats take wall time."""


class Timer(Protocol):
    """A call that is due later."""

    def cancel(self) -> None:
        """Do not make the call."""


class LinkTransit(Protocol):
    """What is under way between a vehicle and its link, on a clock that waits until it has arrived."""

    def sent_s(self, north_m: float, east_m: float, down_m: float, velocity_m_s: tuple[float, float, float]) -> float:
        """Take a motion that has arrived, in the vehicle's NED, and return when it was sent."""

    def send(self, north_m: float, east_m: float, down_m: float) -> None:
        """Take a setpoint that is sent now, in the vehicle's NED."""


class BusTransit(Protocol):
    """The states of vehicles under way on the bus, on a clock that waits until they have arrived. From any thread."""

    def send(self, vehicle_id: int) -> None:
        """Take that a vehicle of this process sends its state now."""

    def take(self, vehicle_id: int) -> None:
        """Take that a state of a vehicle of another process has arrived."""


class MissionClock(Protocol):
    """Mission-clock seconds, equal in every process of a computer, and monotonic.

    `speed` is how many times as fast as the wall's it runs, at most. `time_scale` is how many of its seconds pass in a
    second of what carries messages: of the wall, unless that is simulated as well (`is_governed`).
    """

    @property
    def speed(self) -> float:
        """How many times as fast as the wall's it runs, at most."""

    @property
    def time_scale(self) -> float:
        """How many of its seconds pass in a second of links and radios."""

    @property
    def is_governed(self) -> bool:
        """Whether it waits for everybody who uses it."""

    def now_s(self) -> float:
        """Return the present time."""

    def call_at(self, time_s: float, call: Callable[[], object]) -> Timer:
        """Call a function at a time, on the running event loop."""

    async def sleep(self, duration_s: float) -> None:
        """Wait for a time on this clock."""

    async def sleep_until(self, time_s: float) -> float:
        """Wait until a time has come, yielding at least once; return the time."""

    def begin_mission(self, time_s: float, /) -> None:
        """Take when the mission begins."""

    def allowed_s(self, duration_s: float) -> float:
        """Return the time limit of an action of a vehicle that takes `duration_s`."""

    def held(self) -> AbstractContextManager[None]:
        """Return a context of work on this computer that a clock that waits waits for."""

    def transit(self, system_id: int, /) -> LinkTransit | None:
        """Return what is under way to and from a vehicle, None on a clock that does not wait for it."""

    def bus_transit(self) -> BusTransit | None:
        """Return what is under way on the bus, None on a clock that does not wait for it."""


def link_s(clock: MissionClock) -> float:
    """Return the time of what carries messages [s]; it goes on evenly where the speed of the clock is set meanwhile."""
    return clock.now_s() / clock.time_scale


class WallClock:
    """The wall's clock: seconds since 1970, at `speed` times its rate; implements `MissionClock`."""

    is_governed = False

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        # Read once, because the wall clock may be set in flight.
        self._offset_s = time.time() - time.monotonic()

    @property
    def time_scale(self) -> float:
        """Real links and radios take wall time."""
        return self.speed

    def set_speed(self, speed: float) -> None:
        """Set the speed once it has been measured, before any flight uses this clock."""
        self.speed = speed

    def now_s(self) -> float:
        """Return the present time."""
        return (time.monotonic() + self._offset_s) * self.speed

    def call_at(self, time_s: float, call: Callable[[], object]) -> Timer:
        """Call a function at a time, on the running event loop."""
        return asyncio.get_running_loop().call_later(max(time_s - self.now_s(), 0.0) / self.speed, call)

    async def sleep(self, duration_s: float) -> None:
        """Wait for a time on this clock."""
        await asyncio.sleep(max(duration_s, 0.0) / self.speed)

    async def sleep_until(self, time_s: float) -> float:
        """Wait until a time has come, yielding at least once; asyncio wakes up to a millisecond late, or early."""
        await self.sleep(time_s - self.now_s())
        while (now_s := self.now_s()) < time_s:
            await self.sleep(max(time_s - now_s, _SHORTEST_S))
        return now_s

    def begin_mission(self, _time_s: float) -> None:
        """Do nothing: no vehicle of this clock asks for it."""

    def allowed_s(self, duration_s: float) -> float:
        """Return the time limit of an action of a vehicle that takes `duration_s`."""
        return max(duration_s, _WALL_WAIT_MIN_S * self.speed)

    def held(self) -> AbstractContextManager[None]:
        """Return a context without effect: this clock does not wait."""
        return nullcontext()

    def close(self) -> None:
        """Do nothing: this clock has no participants."""

    def transit(self, _system_id: int) -> LinkTransit | None:
        """Return None: messages arrive when they arrive."""
        return None

    def bus_transit(self) -> BusTransit | None:
        """Return None."""
        return None
