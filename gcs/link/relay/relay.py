"""The relay of one connection: it hands the frames of verified vehicles to MAVSDK, and MAVSDK's frames to them.

MAVSDK itself accepts any sender, and sends setpoints to each. So it has no socket of its own here: frames pass through
its `raw://` connection.
"""

import socket
import threading
import time
from contextlib import suppress
from typing import Any

import mavsdk
from mavsdk.component_type import ComponentType

from gcs.link.relay.carriers import open_carrier, wait_readable
from gcs.link.relay.frames import HEARTBEAT, MAGIC_V2, FrameStream, header
from gcs.link.relay.gate import Address, Claim, Gate, LinkReport
from gcs.link.relay.signing import Signing, Verdict

WAKE_PERIOD_S = 0.25
"""Longest time without a look at what waits: bytes of a slow stream, a connection that has ended."""

WAKES_MAX = 64


class Relay:
    """One connection, by its url, and the Mavsdk object behind it. Use it from any thread.

    Raises OSError when the connection cannot be opened, ValueError for a url that is not understood.
    """

    def __init__(self, url: str) -> None:
        self._carrier = open_carrier(url)
        self._gate = Gate()
        self._lock = threading.Lock()
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._closing = False
        self._first: list[bytes] = []
        # Collected by another thread while MAVSDK is being destroyed, a system aborts the process.
        self._systems: list[Any] = []
        self._mavsdk: Any = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        self._mavsdk.add_any_connection_with_handle("raw://")
        self._sent = self._mavsdk.subscribe_raw_bytes_to_be_sent(self._send)
        self._outgoing = FrameStream()
        self._thread = threading.Thread(target=self._receive, name=f"relay {url}", daemon=True)
        self._thread.start()

    def claim(self, system_id: int, signing: Signing | None) -> None:
        """Wait for the heartbeats of a vehicle."""
        with self._lock:
            self._gate.claims[system_id] = Claim(signing)
            self._gate.others.discard(system_id)

    def release(self, system_id: int) -> None:
        """Forget a vehicle."""
        with self._lock:
            self._gate.claims.pop(system_id, None)

    def candidates(self, system_id: int) -> list[Address]:
        """Return the addresses whose heartbeats claim a system id; with signing, those with its key only."""
        with self._lock:
            return list(self._gate.claims[system_id].candidates)

    def rejected(self, system_id: int) -> dict[Address, Verdict]:
        """Return the addresses whose heartbeats claim a system id without being authentic."""
        with self._lock:
            return dict(self._gate.claims[system_id].rejected)

    def others(self, system_id: int) -> list[int]:
        """Return the system ids of other autopilots than this on the connection."""
        with self._lock:
            verified = {each for each, claim in self._gate.claims.items() if claim.address is not None}
            return sorted((verified | self._gate.others) - {system_id})

    def verify(self, system_id: int, address: Address) -> None:
        """Listen and talk to this address alone from now on, and hand its last heartbeat to MAVSDK."""
        with self._lock:
            claim = self._gate.claims[system_id]
            claim.verify(address, time.monotonic())
            self._first.append(claim.candidates.pop(address))
        self._wake.send(b"\0")

    def system(self, system_id: int) -> Any:
        """Return MAVSDK's system once it is connected, None before."""
        found = None
        for system in self._mavsdk.get_systems():
            if system.get_system_id() == system_id and system.has_autopilot() and system.is_connected():
                found = system
                self._systems.append(system)
            else:
                system.destroy()
        return found

    def report(self, system_id: int) -> LinkReport:
        """Return what arrived with the system id of a vehicle."""
        with self._lock:
            claim = self._gate.claims.get(system_id)
            return LinkReport() if claim is None else claim.report()

    def close(self) -> None:
        """Destroy MAVSDK and free the port. Destroy its plugins before, or their running calls block for ever."""
        self._closing = True
        self._wake.send(b"\0")
        self._thread.join()
        self._mavsdk.unsubscribe_raw_bytes_to_be_sent(self._sent)
        self._mavsdk.destroy()
        with self._lock:
            self._carrier.close()
        self._wake.close()
        self._woken.close()

    def _receive(self) -> None:
        """Pass on what arrives, until closed. MAVSDK takes bytes from one thread only."""
        while not self._closing:
            wait_readable((self._woken.fileno(), *self._carrier.watched()), WAKE_PERIOD_S)
            self._carrier.call_again()
            with self._lock, suppress(BlockingIOError):
                passed, self._first = self._first, []
                passed += [self._admitted(data, address) for data, address in self._carrier.receive()]
                self._woken.recv(WAKES_MAX)
            for frames in passed:
                if frames:
                    self._mavsdk.pass_received_raw_bytes(frames)

    def _admitted(self, data: bytes, address: Address) -> bytes:
        if not data:
            self._gate.gone(address)
            return b""
        return self._gate.admit(data, address, time.monotonic())

    def _send(self, data: bytes) -> None:
        """Send MAVSDK's frames to the verified vehicles; runs on MAVSDK's thread."""
        with self._lock:
            for frame in self._outgoing.feed(data):
                for address, claims in self._gate.peers().items():
                    self._send_to(frame, address, claims)
                if header(frame).message == HEARTBEAT:
                    self._call(frame)

    def _send_to(self, frame: bytes, address: Address, claims: list[Claim]) -> None:
        """Send a frame to an address, once for each key of the vehicles there."""
        signings = {claim.signing for claim in claims}
        for signing in signings:
            if signing is None:
                self._carrier.send(frame, address)
            elif frame[0] == MAGIC_V2:
                self._carrier.send(signing.sign(frame), address)

    def _call(self, heartbeat: bytes) -> None:
        """Send a heartbeat to those that are not verified: whom this end calls, and who is behind in time."""
        for claim in self._gate.claims.values():
            called = claim.address is None and self._carrier.known is not None
            for address in {*([self._carrier.known] if called else ()), *claim.to_set_in_time()}:
                self._send_to(heartbeat, address, [claim])
