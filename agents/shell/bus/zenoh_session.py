"""One Zenoh session of a team's bus: the only importer of zenoh.

Keys are `cordon/{team}/{topic}/{name}`, of commands `cordon/{team}/command/{verb}/{name}`; the name is that of the
sender (`agents/team/participant.py`). A vehicle's presence is a liveliness token `cordon/{team}/alive/{vehicle_id}`.
"""

import json
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import zenoh

from agents.ports import VehicleRefusedError
from agents.shell.bus.bus_security import BusSecurity, secured
from agents.shell.bus.mailbox import PAYLOAD_LIMIT_BYTES
from agents.team.messages import REPORT_TOPIC, TOPICS, MemberState, StartProposal, VehicleReport
from agents.team.participant import is_name

_LEASE_MS = 1000
"""A peer that dies is noticed at once, one that freezes after this."""
_MESSAGE_LIMIT_BYTES = 16 * PAYLOAD_LIMIT_BYTES
"""Zenoh drops larger messages before it has put them together."""
_GUEST_SESSIONS = 32
"""How many others than the team's vehicles may be connected to one."""
_KEY_RATE_HZ = 1000.0
"""Zenoh drops what comes faster on one key: it keeps a burst of distinct messages from being delivered in full, so it
is far above what any vehicle sends, and on topics of which the newest message alone counts."""
_NEWEST_COUNTS = (MemberState, StartProposal, VehicleReport)


class Receiver(Protocol):
    """Takes what a session receives, on any thread; it must not raise."""

    def take_message(self, key: str, length: int, read: Callable[[], bytes], *, own: bool) -> None:
        """Take a message of `length` bytes on a key below the team's, `own` when the session has sent it itself."""
        ...

    def take_presence(self, name: str, present: bool) -> None:
        """Take that a vehicle, this session's own as well, is present or has gone."""
        ...


@dataclass(frozen=True, slots=True)
class BusTeam:
    """A team's name, and the ids of its vehicles; raises ValueError for a name that would be a pattern in a key."""

    name: str
    members: Collection[int]

    def __post_init__(self) -> None:
        if not is_name(self.name):
            raise ValueError(f"team = {self.name!r}: letters, digits, '_', '.' and '-' only")

    @property
    def prefix(self) -> str:
        """What all keys of the team begin with."""
        return f"cordon/{self.name}"


class ZenohSession:
    """A peer at explicit endpoints such as `tcp/127.0.0.1:7447`; `listen` None opens no port.

    Endpoints at which nothing listens yet are tried again. With `security` the endpoints are of TLS, whatever scheme
    they are written with, and only the holders of its certificates are heard, each on its own keys. All methods but
    `publish` block.
    """

    def __init__(self, team: BusTeam, listen: str | None, connect: Sequence[str], security: BusSecurity | None) -> None:
        """Take the settings; nothing is opened before `open`."""
        self._prefix = team.prefix
        self._listen = listen
        if security is not None:
            listen, connect = None if listen is None else secured(listen), [secured(each) for each in connect]
        self._settings = (
            _settings(listen, connect)
            | _limits(self._prefix, team.members)
            | ({} if security is None else security.settings(team.name))
        )
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens: dict[str, zenoh.LivelinessToken] = {}

    @property
    def alive(self) -> bool:
        """Whether it is open; that peers are heard is another matter."""
        return self._session is not None and not self._session.is_closed()

    def open(self, receiver: Receiver | None, *, own: bool, reports: bool) -> None:
        """Join, and let a receiver take what others send, and with `own` also what this session sends itself.

        The reports of the vehicles, which are for those who look on, come only with `reports`.
        Raises VehicleRefusedError when the endpoints cannot be used: a taken port.
        """
        try:
            config = zenoh.Config()
            for path, value in self._settings.items():
                config.insert_json5(path, json.dumps(value))
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise _refusal(self._listen, error) from error
        try:
            if receiver is not None:
                self._subscribe(session, receiver, own=own, reports=reports)
        except zenoh.ZError as error:
            session.close()  # type: ignore[no-untyped-call]
            raise _refusal(self._listen, error) from error
        self._session = session

    def _subscribe(self, session: zenoh.Session, receiver: Receiver, *, own: bool, reports: bool) -> None:
        keys, callback, skipped = f"{self._prefix}/**", zenoh.handlers.Callback, len(self._prefix) + 1

        def take(sample: zenoh.Sample, *, own: bool = False) -> None:
            payload = sample.payload
            receiver.take_message(str(sample.key_expr)[skipped:], len(payload), payload.to_bytes, own=own)

        def take_presence(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr).rsplit("/", 1)[-1]
            receiver.take_presence(name, sample.kind == zenoh.SampleKind.PUT)

        session.declare_subscriber(keys, callback(take), allowed_origin=zenoh.Locality.REMOTE)
        if reports:
            session.declare_subscriber(f"{self._prefix}/{REPORT_TOPIC}/*", callback(take))
        if own:  # not by a thread of its own: what is published here is taken before `publish` returns
            take_own = callback(partial(take, own=True), indirect=False)
            session.declare_subscriber(keys, take_own, allowed_origin=zenoh.Locality.SESSION_LOCAL)
        session.liveliness().declare_subscriber(f"{self._prefix}/alive/*", callback(take_presence), history=True)

    def publish(self, key: str, payload: bytes) -> bool:
        """Send on a key below the team's, best effort; return whether it could be sent.

        Blocks for a millisecond at most, never raises for a lost network.
        """
        session = self._session
        if session is None:
            return True
        try:
            publisher = self._publishers.get(key)
            if publisher is None:
                publisher = self._publishers[key] = session.declare_publisher(
                    f"{self._prefix}/{key}", congestion_control=zenoh.CongestionControl.DROP, express=True
                )
            publisher.put(payload)
        except zenoh.ZError:
            return False
        return True

    def appear(self, name: str) -> None:
        """Show a vehicle's presence from now on."""
        if self._session is not None:
            self._tokens[name] = self._session.liveliness().declare_token(f"{self._prefix}/alive/{name}")

    def disappear(self, name: str) -> None:
        """End a vehicle's presence; the session and the presence of others stay."""
        token = self._tokens.pop(name, None)
        if token is not None:
            with suppress(zenoh.ZError):  # already gone with its session
                token.undeclare()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Leave; peers see it at once. May be called twice, and without `open`."""
        session, self._session = self._session, None
        for name in tuple(self._tokens):
            self.disappear(name)
        if session is not None:
            with suppress(zenoh.ZError):
                # It waits for callbacks that are running, and these wait for nothing: no deadlock.
                session.close()  # type: ignore[no-untyped-call]


def _settings(listen: str | None, connect: Sequence[str]) -> dict[str, object]:
    """Return Zenoh's settings by path for a peer at explicit endpoints."""
    return {
        "mode": "peer",
        "listen/endpoints": [] if listen is None else [listen],
        "listen/exit_on_failure": True,
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "adminspace/enabled": False,
        "transport/link/tx/lease": _LEASE_MS,
        # Room for the messages of one tick. In Zenoh's own two places the third of a burst waits for a
        # millisecond, inside the control loop, or is lost.
        "transport/link/tx/queue/size/data": 16,
        # Messages are a few hundred bytes: all it would bring is what killed processes leave behind.
        "transport/shared_memory/enabled": False,
    }


def _limits(prefix: str, members: Collection[int]) -> dict[str, object]:
    """Return Zenoh's own limits by path: they act before anything comes to Python.

    A rule of downsampling is shared by all keys that match it: there is one for each topic and vehicle.
    """
    keys = [f"{prefix}/{TOPICS[kind].name}/{member}" for kind in _NEWEST_COUNTS for member in members]
    return {
        "scouting/gossip/enabled": False,
        "transport/unicast/max_sessions": len(members) + _GUEST_SESSIONS,
        "transport/link/rx/max_message_size": _MESSAGE_LIMIT_BYTES,
        "downsampling": [
            {
                "id": key.replace("/", "-"),
                "messages": ["put", "delete"],
                "flows": ["ingress"],
                "rules": [{"key_expr": key, "freq": _KEY_RATE_HZ}],
            }
            for key in keys
        ],
    }


def _refusal(listen: str | None, error: Exception) -> VehicleRefusedError:
    """Put Zenoh's long words in short ones."""
    text = str(error)
    if "in use" in text:
        return VehicleRefusedError(
            f"peer endpoint {listen} is taken", "end the other process or choose another port in [network]"
        )
    return VehicleRefusedError(f"peer endpoint {listen} cannot be opened: {text}", "check [network] in the mission")
