"""The MAVSDK object of a process: its connections, and the vehicles on each of them."""

import asyncio
import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

import mavsdk
from mavsdk.component_type import ComponentType
from mavsdk.exceptions import ConnectionError as MavsdkConnectionError

from agents.ports import VehicleRefusedError
from gcs.link.urls import require_usable

Result = TypeVar("Result")

LOG = logging.getLogger(__name__)
POLL_PERIOD_S = 0.05
OTHERS_GRACE_S = 1.5
"""Wait for the right vehicle after another one was received: heartbeats come once a second."""
THREADS_MAX = 64


class MavsdkHub:
    """Owns the Mavsdk object of the process (a ground station to the vehicles) and its connections.

    Before a connection is added, a temporary Mavsdk listens on it alone: a shared one silently merges two vehicles with
    the same system id, and commands go to both.
    """

    def __init__(self) -> None:
        _redirect_log()
        self._executor = ThreadPoolExecutor(THREADS_MAX, thread_name_prefix="mavsdk-hub")
        self._mavsdk: Any = None
        self._connections: dict[str, Any] = {}
        self._vehicles: dict[int, str] = {}
        self._adding: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._making = threading.Lock()
        self._closing = threading.Event()

    async def find(self, url: str, system_id: int, timeout_s: float) -> Any:
        """Return MAVSDK's system `system_id`, received on `url`; times are wall seconds.

        Raises VehicleRefusedError when the url is not usable (`require_usable`), when no vehicle or another one is
        received there, or when the id is that of a vehicle on another url.
        """
        self._claim(system_id, url)
        try:
            async with self._adding[url]:  # vehicles that share a connection come one by one
                if url not in self._connections:
                    await self._run(require_usable, url)
                    received = await self._run(self._listen, url, system_id, timeout_s)
                    _require_received(url, system_id, received, timeout_s)
                    await self._run(self._add, url)
            return await self._run(self._wait_for, url, system_id, timeout_s)
        except BaseException:
            await self.release(url, system_id)
            raise

    async def release(self, url: str, system_id: int) -> None:
        """Release a vehicle; its connection is removed with the last vehicle on it."""
        self._vehicles.pop(system_id, None)
        if url not in self._vehicles.values() and (handle := self._connections.pop(url, None)) is not None:
            await self._run(self._mavsdk.remove_connection, handle)

    async def close(self) -> None:
        """Destroy MAVSDK. Close all links before, or their running calls block their threads for ever."""
        self._closing.set()
        await asyncio.to_thread(self._executor.shutdown)
        if self._mavsdk is not None:
            await asyncio.to_thread(self._mavsdk.destroy)

    def _claim(self, system_id: int, url: str) -> None:
        if system_id in self._vehicles:
            raise VehicleRefusedError(
                f"system id {system_id} is used on both {self._vehicles[system_id]} and {url}",
                "give every vehicle a system id of its own (PX4: MAV_SYS_ID, ArduPilot: SYSID_THISMAV)",
            )
        self._vehicles[system_id] = url

    async def _run(self, function: Callable[..., Result], *arguments: object) -> Result:
        return await asyncio.get_running_loop().run_in_executor(self._executor, function, *arguments)

    def _listen(self, url: str, system_id: int, timeout_s: float) -> list[int]:
        """Return the ids of the autopilots that a separate Mavsdk receives on a url, until it receives `system_id`."""
        listener = _ground_station()
        try:
            _add_connection(listener, url)
            received: set[int] = set()
            end_s = time.monotonic() + timeout_s
            while time.monotonic() < end_s and system_id not in received and not self._closing.wait(POLL_PERIOD_S):
                known, received = received, {each.get_system_id() for each in _autopilots(listener)}
                if received and not known:
                    end_s = min(end_s, time.monotonic() + OTHERS_GRACE_S)
            return sorted(received)
        finally:
            listener.destroy()

    def _add(self, url: str) -> None:
        with self._making:
            if self._mavsdk is None:
                self._mavsdk = _ground_station()
        self._connections[url] = _add_connection(self._mavsdk, url)

    def _wait_for(self, url: str, system_id: int, timeout_s: float) -> Any:
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s and not self._closing.wait(POLL_PERIOD_S):
            for system in _autopilots(self._mavsdk):
                if system.get_system_id() == system_id:
                    return system
        raise _no_heartbeat(url, timeout_s)


@cache
def _redirect_log() -> None:
    """Redirect MAVSDK's log away from standard output, which is reserved for `--json`.

    Once per process and from one thread: a second subscription frees the callback while MAVSDK may be calling it.
    """
    mavsdk.log_subscribe(_log)


def _ground_station() -> Any:
    return mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(ComponentType.GROUND_STATION))


def _log(_level: object, message: str, _file: str | None, _line: int) -> bool:
    LOG.debug("%s", message)
    return True


def _autopilots(of: Any) -> list[Any]:
    return [each for each in of.get_systems() if each.has_autopilot() and each.is_connected()]


def _add_connection(to: Any, url: str) -> Any:
    try:
        return to.add_any_connection_with_handle(url)
    except MavsdkConnectionError as error:
        raise VehicleRefusedError(
            f"{url} cannot be opened: {error}",
            "write a url like udpin://127.0.0.1:14540 or serial:///dev/ttyUSB0:57600, and check the device",
        ) from error


def _require_received(url: str, system_id: int, received: list[int], timeout_s: float) -> None:
    if not received:
        raise _no_heartbeat(url, timeout_s)
    if system_id not in received:
        raise VehicleRefusedError(
            f"{url} carries system id {', '.join(map(str, received))}, not {system_id}",
            "correct the vehicle's id or url in the mission, or the autopilot's system id",
        )


def _no_heartbeat(url: str, timeout_s: float) -> VehicleRefusedError:
    return VehicleRefusedError(
        f"no heartbeat on {url} within {timeout_s:g} s",
        "start a vehicle there (`cordon sitl`, PX4, ArduPilot) or check the url",
    )
