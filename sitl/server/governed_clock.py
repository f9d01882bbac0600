"""The governed clock of a flight of stubs, for one event loop, and what is under way on its links.

The simulated time waits until this event loop has nothing more to do at the present time, and until the motions and
setpoints that were sent have arrived. Results then do not depend on how fast the computer is.
"""

import asyncio
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from heapq import heappop, heappush
from itertools import count
from typing import Protocol, Self
from weakref import WeakKeyDictionary

from sitl.server.clock_memory import MOTION, NEVER_US, SETPOINT, VEHICLES
from sitl.server.shared_clock import LATE_MAX_S, LOOK_S, US_PER_S, ClockName, Rank, Seat
from sitl.server.wall_limit import WallLimit

HELD_MAX_S = 1.0
"""Wall time for which work on this computer holds the time, without that for which it lacks the processor. As long as
the work goes on after that, the time passes no faster than the wall's.
"""
TRANSIT_MAX_S = 0.5
"""Wall time after which a message that has not arrived is taken as lost. It passes from thread to thread, behind all
others: the times for which each of them computes, or lacks the processor, do not count.
"""
WAITS_LONGEST_S = 10.0
"""Wall time after which neither is waited for any longer."""
_LOOKING: "WeakKeyDictionary[asyncio.AbstractEventLoop, int]" = WeakKeyDictionary()
"""How many governed clocks are about to look, by event loop."""


class Arriving(Protocol):
    """Messages under way to this participant."""

    def arrived(self) -> bool:
        """Return whether all that were sent have arrived."""

    def forget(self) -> None:
        """Take those under way as lost."""


class Alarm:
    """A call that is due at a time of the clock."""

    __slots__ = ("call", "time_us")

    def __init__(self, time_us: int, call: Callable[[], object]) -> None:
        self.time_us = time_us
        self.call: Callable[[], object] | None = call

    def cancel(self) -> None:
        """Do not make the call."""
        self.call = None

    def ring(self) -> None:
        """Make the call, unless it was cancelled."""
        if self.call is not None:
            self.call()


class GovernedClock:
    """Implements `agents.shell.clock.MissionClock` for the running event loop; close it at the end.

    Its seconds are those since 1970, beginning when the clock was made. Raises ClockError if it cannot be joined.
    """

    time_scale = 1.0
    """Links and radios are simulated as well: what carries messages takes the same time."""
    is_governed = True

    def __init__(self, name: ClockName, rank: Rank) -> None:
        self.name = name
        self._loop = asyncio.get_running_loop()
        self._seat = Seat(name, rank)
        self._alarms: list[tuple[int, int, Alarm]] = []
        self._number = count()
        self._arriving: list[Arriving] = []
        self._in_transit: WallLimit | None = None
        self._holds: set[WallLimit] = set()
        self._long_holds: set[WallLimit] = set()
        self._paced_us, self._paced_s = 0, 0.0
        self._asked = False
        self._looks: asyncio.Handle | None = None
        self._looks_later: asyncio.TimerHandle | None = None
        self._loop.add_reader(self._seat.woken, self._on_woken)

    @property
    def speed(self) -> float:
        """How many times as fast as the wall's it runs, at most."""
        return self._seat.speed

    def set_speed(self, speed: float) -> None:
        """Set the highest speed for all participants; infinity for as fast as they come on."""
        self._seat.speed = speed

    def now_s(self) -> float:
        """Return the present time."""
        return self._seat.epoch_s + self._seat.now_us / US_PER_S

    def call_at(self, time_s: float, call: Callable[[], object]) -> Alarm:
        """Call a function at a time, to the nearest microsecond."""
        alarm = Alarm(max(round((time_s - self._seat.epoch_s) * US_PER_S), self._seat.now_us), call)
        heappush(self._alarms, (alarm.time_us, next(self._number), alarm))
        if alarm.time_us < self._seat.waits_us:  # at once: another clock of this event loop may look before
            self._seat.state(alarm.time_us)
        self.look()
        return alarm

    async def sleep(self, duration_s: float) -> None:
        """Wait for a time on this clock."""
        await self.sleep_until(self.now_s() + duration_s)

    async def sleep_until(self, time_s: float) -> float:
        """Wait until a time has come, yielding at least once; return the time."""
        woken = self._loop.create_future()

        def wake() -> None:
            if not woken.done():
                woken.set_result(None)

        alarm = self.call_at(time_s, wake)
        try:
            await woken
        finally:
            alarm.cancel()
        return self.now_s()

    def begin_mission(self, time_s: float) -> None:
        """Take when the mission begins: stubs draw its noise from their seeds then."""
        self._seat.memory.begin_us[0] = round((time_s - self._seat.epoch_s) * US_PER_S)

    @property
    def mission_began_s(self) -> float | None:
        """When the mission began; None before."""
        begin_us = self._seat.memory.begin_us[0]
        return self._seat.epoch_s + begin_us / US_PER_S if 0 < begin_us <= self._seat.now_us else None

    def allowed_s(self, duration_s: float) -> float:
        """Return the time limit of an action: this computer takes no time."""
        return duration_s

    @contextmanager
    def held(self) -> Iterator[None]:
        """Return a context of work on this computer, during which the time stands still, for `HELD_MAX_S` at most.

        A call to a vehicle that does not answer takes longer, and this event loop has other vehicles to fly. From then
        on the time passes no faster than the wall's, by which MAVSDK gives a call up: it takes as much of both.
        """
        hold = WallLimit(HELD_MAX_S, WAITS_LONGEST_S, os.getpid(), time.monotonic())
        self._holds.add(hold)
        self._state(self._seat.now_us)
        self.look()
        try:
            yield
        finally:
            self._holds.discard(hold)
            self._long_holds.discard(hold)
            self.look()

    def transit(self, system_id: int) -> "GovernedLinkTransit":
        """Return what is under way to and from a vehicle: the time waits for its motions."""
        transit = GovernedLinkTransit(self, self._seat, system_id)
        self._arriving.append(transit)
        return transit

    def bus_transit(self) -> "GovernedBusTransit":
        """Return what is under way on the bus: the time waits for the states of vehicles of other processes."""
        transit = GovernedBusTransit(self, self._seat)
        self._arriving.append(transit)
        return transit

    def look_soon(self) -> None:
        """Do as `look` does, from any thread."""
        if self._asked:  # a busy event loop would be asked as often as messages arrive
            return
        self._asked = True
        with suppress(RuntimeError):  # the event loop is closed
            self._loop.call_soon_threadsafe(self._look_as_asked)

    def _look_as_asked(self) -> None:
        self._asked = False  # before the look: what arrives during it may be too late for it
        self.look()

    def expect(self, arriving: Arriving) -> None:
        """Let the time wait for further messages."""
        self._arriving.append(arriving)

    def setpoints(self, system_id: int) -> "SetpointTransit":
        """Return the setpoints under way to a vehicle: the time of a stub waits for them."""
        return SetpointTransit(self, self._seat, system_id)

    def motions(self, system_id: int) -> "MotionTransit":
        """Return where a stub states the motions that it sends."""
        return MotionTransit(self._seat, system_id)

    def close(self) -> None:
        """Leave the clock. Calls that are due later are not made."""
        self._loop.remove_reader(self._seat.woken)
        if self._looks is not None:
            self._looks.cancel()
            _LOOKING[self._loop] -= 1
        if self._looks_later is not None:
            self._looks_later.cancel()
        self._alarms.clear()
        self._seat.leave()

    def look(self) -> None:
        """See whether the next event may happen, once the event loop has nothing else to do."""
        if self._looks is None:
            self._looks = self._loop.call_soon(self._look)
            _LOOKING[self._loop] = _LOOKING.get(self._loop, 0) + 1

    def _look(self) -> None:
        self._looks = None
        _LOOKING[self._loop] -= 1
        # asyncio has no public way to ask whether it is idle; other clocks that look do nothing else.
        if len(getattr(self._loop, "_ready", ())) > _LOOKING[self._loop]:
            self.look()
            return
        wall_s = time.monotonic()
        limit_us = self._limit_us(wall_s)
        next_us = self._state(limit_us)
        if self._holds or next_us > limit_us:
            self._seat.note_wait()
            self._look_later(LOOK_S if self._holds else min(LOOK_S, (next_us - limit_us) / US_PER_S))
            return
        if not self._alarms:
            return
        wait_s = self._arrival_s() or self._seat.turn()
        if wait_s > 0.0:
            self._look_later(wait_s)
            return
        now_us = self._seat.now_us
        while self._alarms and self._alarms[0][0] <= now_us:
            self._loop.call_soon(heappop(self._alarms)[2].ring)  # an exception of one does not affect the others
        self.look()

    def _limit_us(self, wall_s: float) -> int:
        """Return the latest time that may come now: work on this computer holds the time, and then paces it."""
        over = {hold for hold in self._holds if hold.is_over(wall_s)}
        self._holds -= over
        self._long_holds |= over
        now_us = self._seat.now_us
        if self._holds or not self._long_holds:
            self._paced_us, self._paced_s = now_us, wall_s
            return now_us if self._holds else NEVER_US
        # A time that is further behind does not catch up.
        before_us = min(self._paced_us, now_us + round(LATE_MAX_S * US_PER_S))
        self._paced_us, self._paced_s = before_us + round((wall_s - self._paced_s) * US_PER_S), wall_s
        return self._paced_us

    def _state(self, limit_us: int) -> int:
        """State the time of the next event, or the latest that may come now; return that of the next event."""
        while self._alarms and self._alarms[0][2].call is None:
            heappop(self._alarms)
        next_us = self._alarms[0][0] if self._alarms else NEVER_US
        event_us = min(next_us, limit_us)
        if event_us != self._seat.waits_us or limit_us < NEVER_US:
            self._seat.state(event_us)
        return next_us

    def _arrival_s(self) -> float:
        """Return wall seconds after which to look again for messages under way; 0 if all have arrived, or are lost."""
        if all(each.arrived() for each in self._arriving):
            self._in_transit = None
            return 0.0
        wall_s = time.monotonic()
        self._in_transit = self._in_transit or WallLimit(
            TRANSIT_MAX_S, WAITS_LONGEST_S, os.getpid(), wall_s, hand_over=True
        )
        if not self._in_transit.is_over(wall_s):
            self._seat.note_wait()
            return 0.005
        for each in self._arriving:
            each.forget()
        self._in_transit = None
        return 0.0

    def _look_later(self, wait_s: float) -> None:
        if self._looks_later is not None:
            self._looks_later.cancel()
        self._looks_later = self._loop.call_later(wait_s, self.look)

    def _on_woken(self) -> None:
        with suppress(BlockingIOError):
            os.read(self._seat.woken, 4096)
        self.look()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class MotionTransit:
    """The motions that a stub sends, by its system id."""

    def __init__(self, seat: Seat, system_id: int) -> None:
        self._seat, self._system_id = seat, system_id

    def send(self, ned: tuple[float, ...]) -> None:
        """Take position and velocity in NED, as they are sent now."""
        self._seat.memory.send_motion(self._system_id, MOTION.pack(*ned))


class GovernedLinkTransit:
    """What is under way to and from a vehicle; implements `agents.shell.clock.LinkTransit`.

    Once a motion is lost, as on a link that is cut, none is waited for until one has arrived again.
    """

    def __init__(self, clock: GovernedClock, seat: Seat, system_id: int) -> None:
        self._clock, self._seat, self._system_id = clock, seat, system_id
        self._taken = seat.memory.motions(system_id)
        self._is_cut = False

    def sent_s(self, north_m: float, east_m: float, down_m: float, velocity_m_s: tuple[float, float, float]) -> float:
        """Take a motion in NED that has arrived, and return when it was sent; now, if that is unknown."""
        sent, time_us = self._seat.memory.find_motion(
            self._system_id, self._taken, MOTION.pack(north_m, east_m, down_m, *velocity_m_s)
        )
        if time_us is None:
            return self._clock.now_s()
        self._taken, self._is_cut = sent + 1, False
        self._clock.look()
        return self._seat.epoch_s + time_us / US_PER_S

    def send(self, north_m: float, east_m: float, down_m: float) -> None:
        """Take a setpoint that is sent now, in the vehicle's NED."""
        self._seat.memory.send_setpoint(self._system_id, SETPOINT.pack(north_m, east_m, down_m))

    def arrived(self) -> bool:
        """Return whether all motions have arrived."""
        return self._is_cut or self._taken >= self._seat.memory.motions(self._system_id)

    def forget(self) -> None:
        """Take the motions under way as lost."""
        self._is_cut = self._is_cut or not self.arrived()
        self._taken = self._seat.memory.motions(self._system_id)


class SetpointTransit:
    """The setpoints under way to a stub: the newest has to arrive, each supersedes those before it.

    Once one is lost, as on a link that is cut, none is waited for until one has arrived again.
    """

    def __init__(self, clock: GovernedClock, seat: Seat, system_id: int) -> None:
        self._clock, self._seat, self._system_id = clock, seat, system_id
        self._newest = b""
        self._lost = 0
        self._is_cut = False

    def take(self, north_m: float, east_m: float, down_m: float) -> None:
        """Take a setpoint that has arrived, in the vehicle's NED."""
        self._newest, self._is_cut = SETPOINT.pack(north_m, east_m, down_m), False
        self._clock.look()

    def arrived(self) -> bool:
        """Return whether the newest setpoint has arrived."""
        sent, newest = self._seat.memory.newest_setpoint(self._system_id)
        return self._is_cut or sent == self._lost or newest == self._newest

    def forget(self) -> None:
        """Take the newest setpoint as lost."""
        self._is_cut = self._is_cut or not self.arrived()
        self._lost, _ = self._seat.memory.newest_setpoint(self._system_id)


class GovernedBusTransit:
    """The states of vehicles under way on the bus; implements `agents.shell.clock.BusTransit`.

    The states of a vehicle are waited for once one has arrived, and until one is lost.
    """

    def __init__(self, clock: GovernedClock, seat: Seat) -> None:
        self._clock, self._seat = clock, seat
        self._taken: dict[int, int] = {}

    def send(self, vehicle_id: int) -> None:
        """Take that a vehicle of this process sends its state now."""
        self._seat.memory.states_sent[vehicle_id % VEHICLES] += 1

    def take(self, vehicle_id: int) -> None:
        """Take that a state of a vehicle of another process has arrived."""
        place = vehicle_id % VEHICLES
        self._taken[place] = self._taken.get(place, self._seat.memory.states_sent[place] - 1) + 1
        self._clock.look_soon()

    def arrived(self) -> bool:
        """Return whether all states have arrived."""
        sent = self._seat.memory.states_sent
        return all(taken >= sent[place] for place, taken in list(self._taken.items()))

    def forget(self) -> None:
        """Wait for no state of a vehicle until one has arrived again."""
        sent = self._seat.memory.states_sent
        self._taken = {place: taken for place, taken in self._taken.items() if taken >= sent[place]}
