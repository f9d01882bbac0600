"""Helpers for tests over sockets: free ports, stubs that count setpoints, and waiting."""

import asyncio
import os
import random
import socket
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from itertools import islice
from typing import Any

import pytest

from agents.shell.clock import WallClock
from sitl.autopilot.px4 import Autopilot
from sitl.mavlink.protocol import MavlinkVehicle
from sitl.mavlink.reports import MavlinkConfig
from sitl.server.server import StubConfig, serve

LOOPBACK = "127.0.0.1"


# Below the range of ephemeral ports, so that other connections do not take them.
_PORTS = iter(random.Random(os.getpid()).sample(range(20_000, 32_000), 12_000))


def free_ports(count: int) -> list[int]:
    """Return ports that are free for UDP and for TCP; no port is returned twice."""
    return list(islice(filter(_is_free, _PORTS), count))


def free_port() -> int:
    """Return one such port."""
    return free_ports(1)[0]


def _is_free(port: int) -> bool:
    for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
        with socket.socket(socket.AF_INET, kind) as attempt:
            try:
                attempt.bind((LOOPBACK, port))
            except OSError:
                return False
    return True


class StubWatch:
    """The stub vehicles of this process by system id, and the times of their setpoints; a restart makes a new one."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.vehicles: dict[int, Autopilot] = {}
        self.received_s: defaultdict[int, list[float]] = defaultdict(list)
        make, take = MavlinkVehicle.__init__, MavlinkVehicle._on_setpoint

        def made(vehicle: MavlinkVehicle, autopilot: Autopilot, config: MavlinkConfig, *rest: Any) -> None:
            self.vehicles[config.system_id] = autopilot
            make(vehicle, autopilot, config, *rest)

        def taken(vehicle: MavlinkVehicle, message: Any, time_s: float) -> Any:
            self.received_s[vehicle._config.system_id].append(asyncio.get_running_loop().time())
            return take(vehicle, message, time_s)

        monkeypatch.setattr(MavlinkVehicle, "__init__", made)
        monkeypatch.setattr(MavlinkVehicle, "_on_setpoint", taken)

    def received_since(self, system_id: int, since_s: float) -> int:
        """Return the number of setpoints that a vehicle has received since a time of the event loop."""
        return sum(at_s > since_s for at_s in self.received_s[system_id])


@asynccontextmanager
async def served(configs: Sequence[StubConfig], speed: float) -> AsyncIterator[None]:
    """Serve stub vehicles in this process."""
    stop = asyncio.Event()
    stubs = asyncio.create_task(serve(configs, WallClock(speed), stop))
    try:
        yield
    finally:
        stop.set()
        await stubs


async def until(condition: Callable[[], bool], timeout_s: float = 20.0, waiting_for: str = "it") -> float:
    """Wait for a condition and return the time when it became true, on the event loop's clock."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + timeout_s
    while not condition():
        assert loop.time() < end_s, f"{waiting_for} never came true"
        await asyncio.sleep(0.005)
    return loop.time()


def until_now(condition: Callable[[], bool], timeout_s: float = 10.0) -> None:
    """Wait for a condition without an event loop."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


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
