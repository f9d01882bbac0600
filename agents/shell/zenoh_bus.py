"""The peer bus over Zenoh: the only importer of zenoh.

Keys are `cordon/{team}/{topic}/{name}`, of commands `cordon/{team}/command/{verb}/{name}`; the name is that of the
sender (`agents/team/participant.py`). A vehicle's presence is a liveliness token `cordon/{team}/alive/{vehicle_id}`.
"""

import asyncio
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from time import monotonic

import zenoh

from agents.drops import Drops, Reason
from agents.ports import VehicleRefusedError
from agents.shell.bus_security import BusSecurity, secured
from agents.shell.mailbox import PAYLOAD_LIMIT_BYTES, Mailbox
from agents.team.messages import TOPICS, MemberState, StartProposal
from agents.team.participant import Participant, is_name

LEASE_MS = 1000
RATE_HZ = 100.0
_HAND_OVER_PERIOD_S = 0.002
"""The least time between two hand-overs to the event loop: messages wait that long at most."""
_MESSAGE_LIMIT_BYTES = 16 * PAYLOAD_LIMIT_BYTES
"""Zenoh drops larger messages before it has put them together."""
_GUEST_SESSIONS = 32
"""How many others than the team's vehicles may be connected to one."""
_KEY_RATE_HZ = 1000.0
"""Zenoh drops what comes faster on one key: it keeps a burst of distinct messages from being delivered in full, so it
is far above what any vehicle sends, and on topics of which the newest message alone counts."""
_NEWEST_COUNTS = (MemberState, StartProposal)


class ZenohBus:
    """Joins a team's bus at explicit endpoints, as one of its participants; implements `agents.ports.PeerBus`.

    `members` are the ids of the team's vehicles; of other vehicles nothing is received. Each may send `rate_hz`
    messages a second on each topic. `listen` and `connect` are Zenoh endpoints such as `tcp/127.0.0.1:7447`. Endpoints
    at which nothing listens yet are tried again. A peer that dies is noticed at once, one that freezes after
    `lease_ms`. An observer publishes nothing, and only a vehicle shows its presence. `listen` None opens no port.
    With `security` the endpoints are of TLS, whatever scheme they are written with, and only the holders of its
    certificates are heard, each on its own keys. `settings` are further Zenoh settings by path, for instance
    `transport/link/tx/lease`. A bus is opened and closed once. Raises ValueError for a team's name that would be a
    pattern in a key.
    """

    def __init__(
        self,
        participant: Participant,
        team: str,
        members: Collection[int],
        listen: str | None = "tcp/127.0.0.1:0",
        connect: Sequence[str] = (),
        *,
        multicast: bool = False,
        lease_ms: int = LEASE_MS,
        rate_hz: float = RATE_HZ,
        settings: Mapping[str, object] | None = None,
        security: BusSecurity | None = None,
    ) -> None:
        """Take the settings; nothing is opened before `open`."""
        if not is_name(team):
            raise ValueError(f"team = {team!r}: letters, digits, '_', '.' and '-' only")
        self.participant = participant
        self._prefix = f"cordon/{team}"
        self._listen = listen
        if security is not None:
            listen, connect = None if listen is None else secured(listen), [secured(each) for each in connect]
        self._settings = (
            _settings(listen, connect, multicast=multicast, lease_ms=lease_ms)
            | _limits(self._prefix, members)
            | dict(settings or {})
            | ({} if security is None else security.settings(team))
        )
        self._session: zenoh.Session | None = None
        self._token: zenoh.LivelinessToken | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._mailbox = Mailbox(participant.vehicle_id, members, rate_hz)
        self._handed_over_s = 0.0
        self._present: set[int] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._on_message: Callable[[str, bytes], None] = _ignore_message
        self._on_presence: Callable[[int, bool], None] = _ignore_presence
        self._closed = False

    @property
    def drops(self) -> Drops:
        """The messages dropped so far before anything decoded them, and own ones that could not be sent."""
        return self._mailbox.drops

    @property
    def alive(self) -> bool:
        """Whether its session is open; that peers are heard is another matter."""
        return self._session is not None and not self._session.is_closed()

    async def open(self, on_message: Callable[[str, bytes], None], on_presence: Callable[[int, bool], None]) -> None:
        """Join the team. Raises VehicleRefusedError when the endpoints cannot be used: a taken port."""
        self._loop = asyncio.get_running_loop()
        self._on_message = on_message
        self._on_presence = on_presence
        try:
            await asyncio.to_thread(self._open_blocking)
        except asyncio.CancelledError:
            self._closed = True  # the thread goes on, sees this, and closes what it opened
            raise

    def publish(self, topic: str, payload: bytes) -> None:
        """Send to every peer, best effort; blocks for a millisecond at most, never raises for a lost network.

        The topic of a command is `command/{verb}`; the participant's name follows it in the key.
        Raises ValueError for a topic that would be a pattern in a key.
        """
        if not all(map(is_name, topic.split("/"))):
            raise ValueError(f"topic = {topic!r}: letters, digits, '_', '.' and '-' only")
        session = self._session
        if session is None or self._closed or self.participant.role == "observer":
            return
        try:
            if topic not in self._publishers:
                self._publishers[topic] = session.declare_publisher(
                    f"{self._prefix}/{topic}/{self.participant.name}",
                    congestion_control=zenoh.CongestionControl.DROP,
                    express=True,
                )
            self._publishers[topic].put(payload)
        except zenoh.ZError:
            self._mailbox.count(Reason.NOT_SENT)

    async def close(self) -> None:
        """Leave; peers see it at once. May be called twice, and without `open`."""
        self._closed = True
        session, self._session = self._session, None
        if session is not None:
            # Undeclaring waits for callbacks that are running, and these wait for nothing: no deadlock.
            await asyncio.to_thread(self._close_blocking, session)

    def _open_blocking(self) -> None:
        try:
            config = zenoh.Config()
            for path, value in self._settings.items():
                config.insert_json5(path, json.dumps(value))
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise _refusal(self._listen, error) from error
        try:
            session.declare_subscriber(
                f"{self._prefix}/**",
                zenoh.handlers.Callback(self._receive),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            liveliness = session.liveliness()
            alive = f"{self._prefix}/alive"
            liveliness.declare_subscriber(f"{alive}/*", zenoh.handlers.Callback(self._receive_presence), history=True)
            # Last: a peer that sees this one may send to it at once.
            if self.participant.role == "vehicle":
                self._token = liveliness.declare_token(f"{alive}/{self.participant.name}")
        except zenoh.ZError as error:
            session.close()  # type: ignore[no-untyped-call]
            raise _refusal(self._listen, error) from error
        self._session = session
        if self._closed:
            self._close_blocking(session)

    def _close_blocking(self, session: zenoh.Session) -> None:
        try:
            if self._token is not None:
                self._token.undeclare()  # type: ignore[no-untyped-call]
            session.close()  # type: ignore[no-untyped-call]
        except zenoh.ZError:
            pass  # already gone: that is what was wanted
        self._publishers.clear()
        self._token = None

    def _receive(self, sample: zenoh.Sample) -> None:
        """Take one message, on a thread of Zenoh's."""
        try:
            payload = sample.payload
            key = str(sample.key_expr)[len(self._prefix) + 1 :]
            if self._mailbox.put(key, len(payload), payload.to_bytes, monotonic()):
                self._wake()
        except Exception:  # whatever it is, it must not reach Zenoh's thread
            self._mailbox.count(Reason.MALFORMED)

    def _receive_presence(self, sample: zenoh.Sample) -> None:
        """Take one change of presence, on a thread of Zenoh's."""
        try:
            name = str(sample.key_expr).rsplit("/", 1)[-1]
            if self._mailbox.put_presence(name, sample.kind == zenoh.SampleKind.PUT):
                self._wake()
        except Exception:
            self._mailbox.count(Reason.MALFORMED)

    def _wake(self) -> None:
        """Have the event loop take what waits, unless that is gone; the mailbox calls once until it has."""
        if not self._closed and self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._hand_over_in_time)

    def _hand_over_in_time(self) -> None:
        assert self._loop is not None
        wait_s = self._handed_over_s + _HAND_OVER_PERIOD_S - monotonic()
        if wait_s > 0.0:
            self._loop.call_later(wait_s, self._hand_over)
        else:
            self._hand_over()

    def _hand_over(self) -> None:
        """Give out what waits; a receiver that raises does not keep the others from it."""
        if self._closed:
            return
        presence, messages = self._mailbox.take()
        for peer_id, present in presence.items():
            self._guarded(self._deliver_presence, peer_id, present)
        for key, payload in messages:
            self._guarded(self._on_message, key, payload)
        self._handed_over_s = monotonic()

    def _guarded(self, function: Callable[..., None], *arguments: object) -> None:
        assert self._loop is not None
        try:
            if not self._closed:
                function(*arguments)
        except Exception as error:
            self._loop.call_exception_handler({"message": "a receiver of the bus failed", "exception": error})

    def _deliver_presence(self, peer_id: int, present: bool) -> None:
        if present != (peer_id in self._present):
            (self._present.add if present else self._present.discard)(peer_id)
            self._on_presence(peer_id, present)


def _settings(listen: str | None, connect: Sequence[str], *, multicast: bool, lease_ms: int) -> dict[str, object]:
    """Return Zenoh's settings by path for a peer at explicit endpoints."""
    return {
        "mode": "peer",
        "listen/endpoints": [] if listen is None else [listen],
        "listen/exit_on_failure": True,
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        "scouting/multicast/enabled": multicast,
        "adminspace/enabled": False,
        "transport/link/tx/lease": lease_ms,
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


def _ignore_message(_key: str, _payload: bytes) -> None:
    pass


def _ignore_presence(_peer_id: int, _present: bool) -> None:
    pass
