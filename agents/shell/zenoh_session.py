"""One Zenoh session of a team's bus: the only importer of zenoh beside the bridge to ROS 2.

Keys are `cordon/{team}/{topic}/{name}`, of commands `cordon/{team}/command/{verb}/{name}`; the name is that of the
sender (`agents/team/participant.py`). A vehicle's presence is a liveliness token `cordon/{team}/alive/{vehicle_id}`, an
operator's `cordon/{team}/operator/{name}`.
"""

import json
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

import zenoh

from agents.ports import VehicleRefusedError
from agents.shell.bus_security import BusSecurity, secured
from agents.shell.computer import allow_descriptors
from agents.shell.gate import Gate
from agents.shell.mailbox import KEY_RATE_HZ, PAYLOAD_LIMIT_BYTES
from agents.team.messages import (
    OPERATORS_TOPIC,
    PRESENCE_TOPIC,
    REPORT_TOPIC,
    TOPICS,
    MemberState,
    StartProposal,
)
from agents.team.participant import is_name

_Mode = Literal["peer", "client", "router"]
_LEASE_MS: dict[_Mode, int] = {"peer": 1000, "client": 3000, "router": 3000}
"""A process that ends is detected at once, one that hangs or is cut off after this. Routers are reached over radio:
with 5 % of the packets lost, a link is silent for longer than a second twice a minute.
"""
_ROUTER_TIMEOUT_MS = 10_000
"""The timeout of a connection to a router, without which nothing can be sent."""
_HANDSHAKE_MS: dict[_Mode, int] = {"peer": 2000, "client": 5000, "router": 5000}
"""The longest handshake of a connection, both ways, after which it is attempted again. Closing a session waits for
those under way: another program may accept a connection at a vehicle's endpoint, and stay silent.
"""
_GUEST_CLOSES_S = 0.25
"""How long who listens nowhere waits for its session to close."""
_MESSAGE_LIMIT_BYTES = 16 * PAYLOAD_LIMIT_BYTES
"""Zenoh drops larger messages before it has reassembled them."""
_PENDING = 10_000
"""The largest number of connections on which no handshake has been completed. Zenoh closes every one beyond it, those
of operators as well; the default of 100 is a few strangers'.
"""
_GUEST_SESSIONS = 32
"""The largest number of connections to a vehicle from one computer, beside as many as the team has vehicles."""
_FULL_COMPUTERS = 4
"""How many computers may have that many connections before none is left for others."""
_REPEATED = (MemberState, StartProposal)
"""The messages whose rate Zenoh limits. It drops the newest of those that a busy computer reads at once: no loss where
another one follows, but the last report of a flight would be lost.
"""


class PresenceReceiver(Protocol):
    """Takes changes of presence, on any thread; it must not raise."""

    def take_presence(self, name: str, present: bool) -> None:
        """Take a change of a vehicle's presence, including this session's own."""

    def take_operator(self, name: str, present: bool) -> None:
        """Take a change of an operator's presence."""


class Receiver(PresenceReceiver, Protocol):
    """Takes the messages that a session receives, on any thread; it must not raise."""

    def take_link(self, common_name: str) -> None:
        """Take a new link, with the common name in the certificate at its other end."""

    def take_message(self, key: str, length: int, read: Callable[[], bytes], *, own: bool) -> None:
        """Take a message of `length` bytes on a key below the team's; `own` if this session has sent it."""


@dataclass(frozen=True, slots=True)
class BusTeam:
    """A team's name, the ids of its vehicles, and the endpoint of the router that all connect to (None: to each other).

    Raises ValueError for a name that would be a pattern in a key.
    """

    name: str
    members: Collection[int]
    router: str | None = None

    def __post_init__(self) -> None:
        if not is_name(self.name):
            raise ValueError(f"team = {self.name!r}: letters, digits, '_', '.' and '-' only")

    @property
    def prefix(self) -> str:
        """The prefix of all keys of the team."""
        return f"cordon/{self.name}"


class ZenohSession:
    """A peer at explicit endpoints such as `tcp/127.0.0.1:7447`; `listen` None opens no port.

    Connections to endpoints without a listener are retried. In a team with a router the session that listens at the
    router's endpoint is the router, and all others connect to it only. With `security` the endpoints use TLS, whatever
    their scheme, and only holders of its certificates are received, each on its own keys; programs of one user are
    linked by sockets that no other user reaches. All methods except `publish` block.
    """

    def __init__(
        self,
        team: BusTeam,
        listen: str | None,
        connect: Sequence[str],
        security: BusSecurity | None,
        refuse: Callable[[str, str], None] = lambda _sender, _why: None,
    ) -> None:
        """Take the settings; nothing is opened before `open`. `refuse` counts callers that the gate refuses."""
        self._prefix = team.prefix
        self._router = team.router if listen != team.router else None
        if self._router is not None:
            listen, connect = None, [self._router]
        self._team, self._security = team, security
        self._listen = listen
        self._connect = tuple(connect)
        self._gate: Gate | None = None
        if security is not None and listen is not None:
            self._gate = Gate(secured(listen), _host_max(team.members), refuse)
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens: dict[str, zenoh.LivelinessToken] = {}

    @property
    def alive(self) -> bool:
        """Whether it is open; peers may be unreachable nevertheless."""
        return self._session is not None and not self._session.is_closed()

    def open(self, receiver: Receiver | None, *, own: bool, reports: bool) -> None:
        """Join, and pass to a receiver the messages of others, and with `own` also those of this session.

        Vehicles' reports, for operators and observers, are received only with `reports`.
        Raises VehicleRefusedError if the endpoints cannot be used: a port in use, or a router that does not answer.
        """
        allow_descriptors()
        try:
            config = zenoh.Config()
            for path, value in self._settings().items():
                config.insert_json5(path, json.dumps(value))
            session = zenoh.open(config)
            if self._gate is not None:
                self._gate.keep_others_out()
        except (zenoh.ZError, OSError) as error:
            self._close_gate()
            raise self._refusal(error) from error
        try:
            if receiver is not None:
                self._subscribe(session, receiver, own=own, reports=reports)
        except zenoh.ZError as error:
            session.close()  # type: ignore[no-untyped-call]
            self._close_gate()
            raise self._refusal(error) from error
        self._session = session

    def _settings(self) -> dict[str, object]:
        """Return Zenoh's settings by path; links to programs of this user depend on which run now."""
        name, security = self._team.name, self._security
        mode: _Mode = "peer" if self._team.router is None else "router" if self._router is None else "client"
        listen, connect = [] if self._listen is None else [self._listen], self._connect
        limits = _limits(self._prefix, self._team.members)
        if security is None:
            return _settings(mode, listen, connect) | limits
        if self._gate is not None:
            inner = f"{self._gate.open()}#tls_handshake_timeout_ms={_HANDSHAKE_MS[mode]}"
            listen = [inner, *(each for endpoint in listen for each in security.sockets_at(name, endpoint))]
        connect = tuple(security.reaching(name, each) for each in connect)
        return _settings(mode, listen, connect) | limits | security.settings(name)

    def _subscribe(self, session: zenoh.Session, receiver: Receiver, *, own: bool, reports: bool) -> None:
        keys, callback, skipped = f"{self._prefix}/**", zenoh.handlers.Callback, len(self._prefix) + 1

        def take(sample: zenoh.Sample, *, own: bool = False) -> None:
            payload = sample.payload
            receiver.take_message(str(sample.key_expr)[skipped:], len(payload), payload.to_bytes, own=own)

        session.declare_subscriber(keys, callback(take), allowed_origin=zenoh.Locality.REMOTE)
        if reports:
            session.declare_subscriber(f"{self._prefix}/{REPORT_TOPIC}/*", callback(take))
        if own:  # without a thread of its own: messages published here are taken before `publish` returns
            take_own = callback(partial(take, own=True), indirect=False)
            session.declare_subscriber(keys, take_own, allowed_origin=zenoh.Locality.SESSION_LOCAL)
        self._watch(session, receiver)
        if self._security is not None:
            take_link = callback(partial(_note_link, receiver.take_link))
            session.info.declare_link_events_listener(take_link, history=True)

    def watch(self, receiver: PresenceReceiver) -> None:
        """Pass to a receiver the presence of others, now and on every change."""
        if self._session is not None:
            self._watch(self._session, receiver)

    def _watch(self, session: zenoh.Session, receiver: PresenceReceiver) -> None:
        for topic, take in ((PRESENCE_TOPIC, receiver.take_presence), (OPERATORS_TOPIC, receiver.take_operator)):
            callback = zenoh.handlers.Callback(partial(_show, take))
            session.liveliness().declare_subscriber(f"{self._prefix}/{topic}/*", callback, history=True)

    def publish(self, key: str, payload: bytes) -> bool:
        """Send on a key below the team's, best effort; return whether it could be sent.

        Blocks for a millisecond at most, never raises for a lost network.
        """
        session = self._session
        if session is None:
            return True
        if self._security is not None:
            payload = self._security.signed(self._team.name, key, payload)
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

    def appear(self, name: str, topic: str = PRESENCE_TOPIC) -> None:
        """Declare the presence of a vehicle from now on, or of an operator on the topic of operators."""
        if self._session is not None:
            self._tokens[name] = self._session.liveliness().declare_token(f"{self._prefix}/{topic}/{name}")

    def disappear(self, name: str) -> None:
        """End the presence of a vehicle or an operator; the session and the presence of others stay."""
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
            closing = threading.Thread(target=_close, args=(session,), name="zenoh-close")
            closing.start()
            # Who listens leaves a port that is free. The links of a guest have ended; its process ends when the
            # handshakes under way have, as Zenoh may not be interrupted.
            closing.join(_GUEST_CLOSES_S if self._listen is None else None)
        self._close_gate()

    def _close_gate(self) -> None:
        if self._gate is not None:
            self._gate.close()

    def _refusal(self, error: Exception) -> VehicleRefusedError:
        """Return a short message for an error of Zenoh."""
        if self._router is not None:
            return VehicleRefusedError(
                f"router {self._router} does not answer, or does not know these keys",
                "start `cordon router` there; check network.router in the mission, and the rosters of both computers",
            )
        if "in use" in str(error):  # Zenoh's errors have no code
            return VehicleRefusedError(
                f"peer endpoint {self._listen} is taken",
                "end the other process, or give the vehicle another endpoint (`endpoint` in the mission, --endpoint)",
            )
        return VehicleRefusedError(
            f"peer endpoint {self._listen} cannot be opened: {error}", "check [network] in the mission"
        )


def _close(session: zenoh.Session) -> None:
    with suppress(zenoh.ZError):
        # It waits for running callbacks, which do not wait for anything: no deadlock.
        session.close()  # type: ignore[no-untyped-call]


def _show(take: Callable[[str, bool], None], sample: zenoh.Sample) -> None:
    """Pass on the name in a liveliness token, and whether its presence begins or ends."""
    take(str(sample.key_expr).rsplit("/", 1)[-1], sample.kind == zenoh.SampleKind.PUT)


def _note_link(take: Callable[[str], None], event: zenoh.LinkEvent) -> None:
    """Pass on the common name of a new link; links by sockets have none."""
    if event.kind == zenoh.SampleKind.PUT and event.link.auth_identifier is not None:
        take(event.link.auth_identifier)


def _settings(mode: _Mode, listen: Sequence[str], connect: Sequence[str]) -> dict[str, object]:
    """Return Zenoh's settings by path for a session at explicit endpoints."""
    return {
        "mode": mode,
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(connect),
        "connect/timeout_ms": {"peer": -1, "router": -1, "client": _ROUTER_TIMEOUT_MS},
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        # By default a session that has not reached every endpoint yet opens half a second later.
        "scouting/delay": 0,
        "adminspace/enabled": False,
        "transport/link/tx/lease": _LEASE_MS[mode],
        "transport/unicast/open_timeout": _HANDSHAKE_MS[mode],
        "transport/unicast/accept_timeout": _HANDSHAKE_MS[mode],
        # Room for the messages of one tick. With Zenoh's default of two, the third message of a burst blocks the
        # control loop for a millisecond, or is lost.
        "transport/link/tx/queue/size/data": 16,
        # Messages are a few hundred bytes, and killed processes leave shared memory behind.
        "transport/shared_memory/enabled": False,
    }


def _host_max(members: Collection[int]) -> int:
    return len(members) + _GUEST_SESSIONS


def _limits(prefix: str, members: Collection[int]) -> dict[str, object]:
    """Return Zenoh's limits by path, which act before messages reach Python.

    All keys that match a downsampling rule share its rate, so there is one rule for each topic and vehicle.
    """
    keys = [f"{prefix}/{TOPICS[kind].name}/{member}" for kind in _REPEATED for member in members]
    return {
        "scouting/gossip/enabled": False,
        "transport/unicast/max_sessions": _FULL_COMPUTERS * _host_max(members),
        "transport/unicast/accept_pending": _PENDING,
        "transport/link/rx/max_message_size": _MESSAGE_LIMIT_BYTES,
        "downsampling": [
            {
                "id": key.replace("/", "-"),
                "messages": ["put", "delete"],
                "flows": ["ingress"],
                "rules": [{"key_expr": key, "freq": KEY_RATE_HZ}],
            }
            for key in keys
        ],
    }
