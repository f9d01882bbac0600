"""Helpers for tests over sockets: free ports, stubs on a governed clock, and waiting."""

import asyncio
import os
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import TypeVar

import pytest

from agents.shell.clock import MissionClock
from gcs.link.ports import free_ports
from sitl.autopilot.autopilot import StubAutopilot
from sitl.server.endpoint import StubClock
from sitl.server.governed_clock import GovernedClock
from sitl.server.process import StubProcess
from sitl.server.server import Stub, StubConfig, serve
from sitl.server.shared_clock import ClockName, Rank, Seat, new_clock

ValueT = TypeVar("ValueT")
LOOPBACK = "127.0.0.1"


def free_port() -> int:
    """Return one such port."""
    return free_ports(1)[0]


@contextmanager
def stub_clock(speed: float, ports: Collection[int] = ()) -> Iterator[GovernedClock]:
    """Make a governed clock for stubs of this event loop and for what flies them, or for those of `stub_process`.

    `cordon fly` joins it by the ports that its stubs send to.
    """
    with new_clock(speed, ports) as name, GovernedClock(name, Rank.STUBS) as clock:
        yield clock


@contextmanager
def stub_process(configs: Sequence[StubConfig], name: ClockName) -> Iterator[StubProcess]:
    """Serve stub vehicles in a process of their own; it may be stopped before the end, for its record."""
    process = StubProcess(configs, partial(GovernedClock, name, Rank.STUBS))
    process.start()
    try:
        yield process
    finally:
        with suppress(OSError):
            process.stop()


@dataclass(frozen=True, slots=True)
class Served:
    """Stub vehicles of this event loop, by system id, and their clock, which a flight joins by its name."""

    clock: GovernedClock
    stubs: dict[int, Stub]

    @property
    def vehicles(self) -> dict[int, StubAutopilot]:
        """Their autopilots."""
        return {i: stub.autopilot for i, stub in self.stubs.items()}


def computers_apart(monkeypatch: pytest.MonkeyPatch, *offsets_s: float) -> None:
    """Give each flight of this process that joins a governed clock a computer's clock of its own: off by a time."""
    offset_s = iter(offsets_s)

    class ComputersSeat(Seat):
        def __init__(self, name: ClockName, rank: Rank) -> None:
            super().__init__(name, rank)
            self._ahead_s = next(offset_s) if rank is Rank.AGENTS else 0.0

        @property
        def epoch_s(self) -> float:
            return super().epoch_s + self._ahead_s

    monkeypatch.setattr("sitl.server.governed_clock.Seat", ComputersSeat)


@asynccontextmanager
async def served_by(clock: StubClock, configs: Sequence[StubConfig]) -> AsyncIterator[dict[int, Stub]]:
    """Serve stub vehicles in this process on a clock that others use as well."""
    stop = asyncio.Event()
    ready: asyncio.Future[Sequence[Stub]] = asyncio.get_running_loop().create_future()
    serving = asyncio.create_task(serve(configs, clock, stop, ready.set_result))
    await asyncio.wait((serving, ready), return_when=asyncio.FIRST_COMPLETED)
    if not ready.done():
        await serving  # raises why they could not be served
    try:
        yield {stub.config.vehicle_id: stub for stub in ready.result()}
    finally:
        stop.set()
        await serving


@asynccontextmanager
async def served(configs: Sequence[StubConfig], speed: float) -> AsyncIterator[Served]:
    """Serve stub vehicles in this process on a governed clock of their own."""
    with stub_clock(speed, {config.client_port for config in configs}) as clock:
        async with served_by(clock, configs) as stubs:
            yield Served(clock, stubs)


@contextmanager
def at_speed(clock: GovernedClock, speed: float) -> Iterator[None]:
    """Limit the clock's speed: at 1 a flight leaves the processor to a program that a test starts."""
    before = clock.speed
    clock.set_speed(speed)
    try:
        yield
    finally:
        clock.set_speed(before)


def hurried(clock: GovernedClock) -> AbstractContextManager[None]:
    """Let the time go on as fast as its participants do, while a test only waits for what it begins with."""
    return at_speed(clock, inf)


PATIENCE_S = 120.0
"""How long a test waits for something that this computer does: no measure of how fast it does it."""


async def until(
    condition: Callable[[], bool],
    timeout_s: float = PATIENCE_S,
    waiting_for: str = "it",
    *,
    clock: MissionClock | None = None,
) -> float:
    """Wait for a condition and return the time when it became true, on a clock, or else on the event loop's."""
    now_s = asyncio.get_running_loop().time if clock is None else clock.now_s
    sleep = asyncio.sleep if clock is None else clock.sleep
    end_s = now_s() + timeout_s
    while not condition():
        assert now_s() < end_s, f"{waiting_for} never came true"
        await sleep(0.005 if clock is None else 0.02)
    return now_s()


def until_now(condition: Callable[[], ValueT], waiting_for: str = "it") -> ValueT:
    """Wait for a condition without an event loop, and return its value."""
    end_s = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        assert time.monotonic() < end_s, f"{waiting_for} never came true"
        time.sleep(0.01)
    return value


async def repeated(attempt: Callable[[], Awaitable[None]]) -> None:
    """Repeat what is measured by the wall's clock until its assertions hold: a busy computer may spoil an attempt."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return await attempt()
        except AssertionError:
            if time.monotonic() > end_s:
                raise


def repeated_now(attempt: Callable[[], None]) -> None:
    """Do the same without an event loop."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return attempt()
        except AssertionError:
            if time.monotonic() > end_s:
                raise


@asynccontextmanager
async def running(*arguments: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """Run a command in the background for tasks of an event loop, without a terminal and without line breaks."""
    pipe, environment = asyncio.subprocess.PIPE, {**os.environ, "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "400"}
    command = [sys.executable, "-m", "gcs", *arguments]
    process = await asyncio.create_subprocess_exec(*command, stdout=pipe, stderr=pipe, env=environment)
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.communicate()


@contextmanager
def cordon(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a command in the background, without a terminal."""
    environment = {**os.environ, "TERM": "dumb", "NO_COLOR": "1"}
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-m", "gcs", *arguments], stdout=pipe, stderr=pipe, text=True, env=environment
    ) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
