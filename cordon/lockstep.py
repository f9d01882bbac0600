"""A user's program that flies or observes stubs of `cordon sitl --lockstep` on their clock.

The module needs no event loop: MAVSDK and pymavlink may be used from the same thread.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Self

from gcs.errors import InputError
from sitl.server.clock_memory import NEVER_US, SETPOINT, VEHICLES
from sitl.server.shared_clock import US_PER_S, ClockError, Rank, Seat, clock_of

_POLL_S = 0.02


class LockstepClient:
    """A participant in the clock of stubs: the simulated time waits for this program where it asks for that.

    Use it as a context manager and from one thread. After `sleep` the time goes on without this program; after
    `held_after` it stands still until the end of the context, for 2 s of the wall's clock at most, so that what is done
    there happens at one time on every computer.
    """

    def __init__(self, *ports: int, speed: float | None = None) -> None:
        """Join the clock of the stubs that send to these UDP ports. Raises InputError if there is none.

        Until this program leaves, the clock runs at most `speed` times as fast as the wall's; infinity is as fast as
        its participants come on, None the speed of the stubs.
        """
        if speed is not None and not speed > 0.0:
            raise InputError((f"speed = {speed}: it must be positive",))
        name = clock_of(ports) if ports else None
        if name is None:
            given = ", ".join(map(str, ports)) or "none"
            next_step = "start `cordon sitl MISSION --lockstep`, and give UDP ports that its vehicles send to"
            raise InputError((f"ports = {given}: {next_step}",))
        try:
            self._seat = Seat(name, Rank.GUEST)
        except ClockError as error:
            raise InputError((str(error),)) from error
        self._speed_before = self._seat.speed
        if speed is not None:
            self._seat.speed = speed

    @property
    def now_s(self) -> float:
        """The present time [s]; the clock began at the Unix time, in whole seconds, at which the stubs started."""
        return self._seat.epoch_s + self._seat.now_us / US_PER_S

    def sleep(self, duration_s: float) -> None:
        """Wait for a time on this clock."""
        with self.held_after(duration_s):
            pass

    @contextmanager
    def held_after(self, duration_s: float = 0.0) -> Iterator[None]:
        """Wait for a time on this clock, which then stands still until the end of the context.

        Contexts that follow each other at once are `duration_s` apart. Raises InputError for a time that is not finite
        or negative.
        """
        if not (isfinite(duration_s) and duration_s >= 0.0):
            raise InputError((f"duration_s = {duration_s}: it must be a finite time, not negative",))
        self._seat.wait_until(self._seat.now_us + round(duration_s * US_PER_S))
        try:
            yield
        finally:
            self._seat.state(NEVER_US)

    def until(self, condition: Callable[[], bool], what: str, limit_s: float = 60.0) -> None:
        """Wait until a condition holds; raises TimeoutError, which names `what` it is, after a time on this clock."""
        end_s = self.now_s + limit_s
        while not condition():
            if self.now_s >= end_s:
                raise TimeoutError(f"not within {limit_s:g} s: {what}")
            self.sleep(_POLL_S)

    def sends_setpoint(self, system_id: int, north_m: float, east_m: float, down_m: float) -> None:
        """Let a stub's next step wait for a position setpoint in its local NED [m], which is sent next by MAVLink.

        Raises InputError for a system id that no vehicle can have.
        """
        if not 0 < system_id < VEHICLES:
            raise InputError((f"system_id = {system_id}: it must be from 1 to {VEHICLES - 1}",))
        self._seat.memory.send_setpoint(system_id, SETPOINT.pack(north_m, east_m, down_m))

    def close(self) -> None:
        """Leave the clock, which goes on without this program."""
        self._seat.speed = self._speed_before
        self._seat.leave()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
