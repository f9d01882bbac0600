"""The MAVSDK object of a process: its connections, each behind a relay, and the vehicles on each of them."""

import asyncio
import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

import mavsdk
from mavsdk.component_type import ComponentType
from mavsdk.exceptions import ConnectionError as MavsdkConnectionError

from agents.ports import VehicleRefusedError
from agents.shell.clock import MissionClock
from gcs.autopilots.registry import AUTOPILOTS, advice
from gcs.errors import InputError
from gcs.link.calls import NotReceivedError
from gcs.link.feed import PostedCalls
from gcs.link.ports import require_usable
from gcs.link.rates import RateController, Traffic
from gcs.link.relay.gate import Address, LinkReport, shown
from gcs.link.relay.relay import Relay
from gcs.link.relay.relay_thread import RelayThread
from gcs.link.relay.signing import SAVE_PERIOD_S, SignatureCheck, Signing, SigningTimes

Result = TypeVar("Result")

LOG = logging.getLogger(__name__)
POLL_PERIOD_S = 0.05
OTHERS_GRACE_S = 1.5
"""Wait for the right vehicle after another one was received: heartbeats come once a second."""
CLAIMS_S = 1.2
"""Wait for another sender with the same system id before the first one is taken as the vehicle [s of its clock]: from
when the vehicle is looked for if it sends already by then, as another one does as well, otherwise from its first
heartbeat.
"""
CLAIMS_MIN_S = 0.15
THREADS_MAX = 64
ISSUE = "set up its key with `cordon keys issue mavlink`, over a link that no other computer can receive (USB)"


class MavsdkHub:
    """Owns the Mavsdk object of the process (a ground station to the vehicles) and its connections.

    A relay verifies a vehicle before MAVSDK receives it: MAVSDK silently merges two vehicles with the same
    system id, and commands go to both.
    """

    def __init__(self, clock: MissionClock | None = None) -> None:
        """Take the mission's clock, of which only a governed one makes a difference: round trips are measured on it."""
        governed = clock if clock is not None and clock.is_governed else None
        _redirect_log()
        self._link_s = time.monotonic if governed is None else governed.now_s
        self.posted_calls = PostedCalls(gathers=governed is None)
        """Passes what other threads receive to the event loop, for all vehicles together."""
        self._executor = ThreadPoolExecutor(THREADS_MAX, thread_name_prefix="mavsdk-hub")
        self._mavsdk: Any = None
        self._relays: dict[str, tuple[Relay, Any]] = {}
        self._relay_thread = RelayThread("relays")
        self._vehicles: dict[int, str] = {}
        self._adding: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._making = threading.Lock()
        self._closing = threading.Event()
        self._signing_times = SigningTimes()
        self._saving: threading.Thread | None = None

    async def find(
        self, url: str, system_id: int, timeout_s: float, *, signing_key: bytes | None = None, speed: float = 1.0
    ) -> Any:
        """Return MAVSDK's system `system_id`, received on `url`; times are wall seconds.

        From then on only the address that it was received from counts; with a `signing_key` (32
        bytes), only signed messages count. `speed` is how many times faster than the wall its clock runs.

        Raises VehicleRefusedError when the url is not usable (`require_usable`), when no vehicle or another one is
        received there, when several senders claim the id or none has its key, or when the id is that of a vehicle on
        another url.
        """
        self._claim(system_id, url)
        try:
            signing = None if signing_key is None else await self._run(self._signing, signing_key)
            async with self._adding[url]:  # one vehicle of a shared connection at a time
                if url not in self._relays:
                    await self._run(require_usable, url)
                    await self._keep(url)
                relay, _ = self._relays[url]
                relay.claim(system_id, signing)
                claims_s = max(CLAIMS_S / speed, CLAIMS_MIN_S)
                await self._run(self._verify, relay, url, system_id, timeout_s, claims_s, signing)
            return await self._run(self._wait_for, url, system_id, timeout_s)
        except BaseException:
            await self.release(url, system_id)
            raise

    async def release(self, url: str, system_id: int) -> None:
        """Release a vehicle; its connection is closed with the last vehicle on it."""
        self._vehicles.pop(system_id, None)
        if url not in self._relays:
            return
        relay, connection = self._relays[url]
        relay.release(system_id)
        if url not in self._vehicles.values():
            del self._relays[url]
            await self._run(self._close_one, relay, connection)

    def report(self, system_id: int) -> LinkReport:
        """Return the report of what arrived with the system id of a vehicle."""
        url = self._vehicles.get(system_id)
        return self._relays[url][0].report(system_id) if url in self._relays else LinkReport()

    def messages(self, system_id: int) -> Mapping[int, int]:
        """Return how many messages of each number have arrived from a vehicle."""
        url = self._vehicles.get(system_id)
        return self._relays[url][0].messages(system_id) if url in self._relays else {}

    def listen(self, system_id: int, listeners: Mapping[int, Callable[[bytes], object]]) -> None:
        """Call these functions, by message, with the frames of a vehicle's autopilot, in the thread of its relay."""
        url = self._vehicles.get(system_id)
        if url in self._relays:
            self._relays[url][0].listen(system_id, listeners)

    def set_pace(self, url: str, pace: RateController, speed: float) -> None:
        """Set a connection's pace of sending; the mission clock runs `speed` times as fast as the wall's."""
        if pace.is_bound and url in self._relays:
            self._relays[url][0].pace(pace.up_bytes_s, pace.rates.setpoint_hz * speed, pace.copies)

    def repeat_heartbeat(self, system_id: int) -> None:
        """Let MAVSDK receive the vehicle's newest heartbeat again: what begins to listen now gets its flight mode."""
        url = self._vehicles.get(system_id)
        if url in self._relays:
            self._relays[url][0].repeat_heartbeat(system_id)

    def mute(self, url: str, system_id: int, muted: bool) -> None:
        """Send a vehicle no setpoint from now on, or again."""
        if url in self._relays:
            self._relays[url][0].mute(system_id, muted)

    def send_heartbeats(self, url: str) -> None:
        """Send the vehicles of a connection a heartbeat beside those of MAVSDK."""
        if url in self._relays:
            self._relays[url][0].send_heartbeats()

    def traffic(self, url: str) -> Traffic:
        """Return the counts of a connection."""
        return self._relays[url][0].traffic() if url in self._relays else Traffic()

    async def close(self) -> None:
        """Destroy MAVSDK. Close all links first, or their running calls block their threads for ever."""
        self._closing.set()
        await asyncio.to_thread(self._executor.shutdown)
        if self._saving is not None:
            await asyncio.to_thread(self._saving.join)
        if self._mavsdk is not None:
            await asyncio.to_thread(self._mavsdk.destroy)
        for relay, _ in self._relays.values():
            await asyncio.to_thread(relay.close)
        self._relays.clear()
        await asyncio.to_thread(self._relay_thread.close)

    def _claim(self, system_id: int, url: str) -> None:
        if system_id in self._vehicles:
            raise VehicleRefusedError(
                f"system id {system_id} is used on both {self._vehicles[system_id]} and {url}",
                f"give every vehicle a system id of its own ({advice('system id')})",
            )
        self._vehicles[system_id] = url

    async def _run(self, function: Callable[..., Result], *arguments: object) -> Result:
        return await asyncio.get_running_loop().run_in_executor(self._executor, function, *arguments)

    def _signing(self, key: bytes) -> Signing:
        """Return the signing of a key, whose times are saved until `close`."""
        with self._making:
            if self._saving is None:
                self._saving = threading.Thread(target=self._save_times, name="signing times", daemon=True)
                self._saving.start()
            return self._signing_times.signing(key)

    def _save_times(self) -> None:
        """Save on a thread of its own: a slow disk must not delay messages."""
        closing = False
        while not closing:
            closing = self._closing.wait(SAVE_PERIOD_S)
            try:
                self._signing_times.save()
            except (OSError, InputError) as error:
                LOG.warning("signing: %s", error)  # Python prints it to standard error
                return

    def _verify(
        self, relay: Relay, url: str, system_id: int, timeout_s: float, claims_s: float, signing: Signing | None
    ) -> None:
        """Wait for the vehicle's heartbeats, and verify their sender if it is the only one."""
        began_s = time.monotonic()
        end_s = began_s + timeout_s
        others = False
        while not relay.candidates(system_id):
            if not others and self._other_system_ids(relay, url, system_id):
                others, end_s = True, min(end_s, time.monotonic() + OTHERS_GRACE_S)
            if time.monotonic() > end_s or self._closing.wait(POLL_PERIOD_S):
                others_there = self._other_system_ids(relay, url, system_id)
                raise _not_received(url, system_id, relay, others_there, timeout_s, signing)
        looked_s = time.monotonic() - began_s
        self._closing.wait(claims_s - looked_s if looked_s < claims_s else claims_s)
        candidates = relay.candidates(system_id)
        if len(candidates) > 1:
            raise _claimed_twice(url, system_id, candidates)
        relay.verify(system_id, candidates[0])

    def _other_system_ids(self, relay: Relay, url: str, system_id: int) -> list[int]:
        """Return the system ids on a connection other than those of the vehicles that share it."""
        return [each for each in relay.others(system_id) if self._vehicles.get(each) != url]

    async def _keep(self, url: str) -> None:
        """Open a connection and keep it until `release`, also if this is cancelled meanwhile."""
        opening = asyncio.ensure_future(self._run(self._open, url))
        try:
            await asyncio.shield(opening)
        finally:
            self._relays[url] = await opening

    def _open(self, url: str) -> tuple[Relay, Any]:
        """Open a connection, and connect MAVSDK to its relay."""
        with self._making:
            if self._mavsdk is None:
                self._mavsdk = mavsdk.Mavsdk(
                    mavsdk.Configuration.create_with_component_type(ComponentType.GROUND_STATION)
                )
        try:
            relay = Relay(url, self._relay_thread, self._link_s)
            try:
                connection = self._mavsdk.add_any_connection_with_handle(relay.inner_url)
                relay.start()
            except BaseException:
                relay.close()
                raise
        except (OSError, ValueError, MavsdkConnectionError) as error:
            raise VehicleRefusedError(
                f"{url} cannot be opened: {error}",
                "write a url like udpin://127.0.0.1:14540 or serial:///dev/ttyUSB0:57600, and check the device",
            ) from error
        return relay, connection

    def _close_one(self, relay: Relay, connection: Any) -> None:
        self._mavsdk.remove_connection(connection)
        relay.close()

    def _wait_for(self, url: str, system_id: int, timeout_s: float) -> Any:
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s and not self._closing.wait(POLL_PERIOD_S):
            for system in self._mavsdk.get_systems():
                if system.get_system_id() == system_id and system.has_autopilot() and system.is_connected():
                    return system
        raise _no_heartbeat(url, timeout_s)


@cache
def _redirect_log() -> None:
    """Redirect MAVSDK's log away from standard output, which is reserved for `--json`.

    Once per process and from one thread: a second subscription frees the callback while MAVSDK may be calling it.
    """
    mavsdk.log_subscribe(_log)


def _log(_level: object, message: str, _file: str | None, _line: int) -> bool:
    LOG.debug("%s", message)
    return True


def _not_received(
    url: str, system_id: int, relay: Relay, other_system_ids: list[int], timeout_s: float, signing: Signing | None
) -> VehicleRefusedError:
    """Return why no heartbeat of the vehicle was accepted."""
    if signing is not None and signing.ahead_s > 0.0 and SignatureCheck.OLD in relay.rejected(system_id).values():
        return VehicleRefusedError(
            f"the messages of vehicle {system_id} on {url} are not later than those of an earlier run, which are signed"
            f" {signing.ahead_s:.0f} s ahead of this computer's clock",
            f"set the computer's clock; if it was ahead in that run, remove {SigningTimes.path(signing.key)}",
        )
    if rejected := relay.rejected(system_id):
        verdicts = "; ".join(f"{verdict.value} (from {shown(address)})" for address, verdict in rejected.items())
        unsigned = SignatureCheck.UNSIGNED in rejected.values()
        return VehicleRefusedError(
            f"the messages of vehicle {system_id} on {url} are {verdicts}; link.signing_key_file requires its key",
            ISSUE if unsigned else "compare its key with link.signing_key_file, and the clocks of computer and vehicle",
        )
    if other_system_ids:
        return VehicleRefusedError(
            f"{url} carries system id {', '.join(map(str, other_system_ids))}, not {system_id}",
            "correct the vehicle's id or url in the mission, or the autopilot's system id",
        )
    return _no_heartbeat(url, timeout_s)


def _claimed_twice(url: str, system_id: int, addresses: Iterable[Address]) -> VehicleRefusedError:
    return VehicleRefusedError(
        f"{url} receives system id {system_id} from several senders: {', '.join(map(shown, addresses))}",
        "end all senders but the vehicle, or set up signing (link.signing_key_file), which identifies the vehicle",
    )


def _no_heartbeat(url: str, timeout_s: float) -> VehicleRefusedError:
    return NotReceivedError(
        f"no heartbeat on {url} within {timeout_s:g} s",
        f"start a vehicle there (`cordon sitl`, {', '.join(each.label for each in AUTOPILOTS)}) or check the url",
    )
