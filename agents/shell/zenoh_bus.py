"""The peer bus over Zenoh: the only importer of zenoh.

Keys are `cordon/{team}/{topic}/{vehicle_id}`; presence is a liveliness token
`cordon/{team}/alive/{vehicle_id}`.
"""

import asyncio
import json
import re
from collections.abc import Callable, Mapping, Sequence

import zenoh

from agents.ports import VehicleRefusedError

PAYLOAD_LIMIT_BYTES = 4096
LEASE_MS = 1000
_NAME = re.compile(r"[A-Za-z0-9_.-]+")


class ZenohBus:
    """Joins a team's peers at explicit endpoints; implements `agents.ports.PeerBus`.

    `listen` and `connect` are Zenoh endpoints such as `tcp/127.0.0.1:7447`. Endpoints that nobody listens on
    yet are tried again until somebody does. A peer that dies is noticed at once, one that freezes after
    `lease_ms`. Without a `vehicle_id` it only listens: it shows no presence and publishes nothing.
    `listen` None opens no port. `settings` are further Zenoh settings by path, for instance
    `transport/link/tls/listen_certificate`. A bus is opened and closed once.
    Raises ValueError for names that would be patterns in a key.
    """

    def __init__(
        self,
        vehicle_id: int | None,
        team: str,
        listen: str | None = "tcp/127.0.0.1:0",
        connect: Sequence[str] = (),
        *,
        multicast: bool = False,
        lease_ms: int = LEASE_MS,
        settings: Mapping[str, object] | None = None,
    ) -> None:
        """Take the settings; nothing is opened before `open`."""
        _require_name("team", team)
        self._vehicle_id = vehicle_id
        self._prefix = f"cordon/{team}"
        self._listen = listen
        self._settings = _settings(listen, connect, multicast=multicast, lease_ms=lease_ms) | dict(settings or {})
        self._session: zenoh.Session | None = None
        self._token: zenoh.LivelinessToken | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._present: set[int] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._on_message: Callable[[bytes], None] = _ignore_message
        self._on_presence: Callable[[int, bool], None] = _ignore_presence
        self._closed = False
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """How many messages were dropped so far: foreign ones too long or unreadable, own ones unsendable."""
        return self._dropped

    @property
    def alive(self) -> bool:
        """Whether its session is open; that peers are heard is another matter."""
        return self._session is not None and not self._session.is_closed()

    async def open(self, on_message: Callable[[bytes], None], on_presence: Callable[[int, bool], None]) -> None:
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

        Raises ValueError for a topic that would be a pattern in a key.
        """
        _require_name("topic", topic)
        session = self._session
        if session is None or self._closed or self._vehicle_id is None:
            return
        try:
            if topic not in self._publishers:
                self._publishers[topic] = session.declare_publisher(
                    f"{self._prefix}/{topic}/{self._vehicle_id}",
                    congestion_control=zenoh.CongestionControl.DROP,
                    express=True,
                )
            self._publishers[topic].put(payload)
        except zenoh.ZError:
            self._dropped += 1

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
                f"{self._prefix}/*/*",
                zenoh.handlers.Callback(self._receive),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            liveliness = session.liveliness()
            alive = f"{self._prefix}/alive"
            liveliness.declare_subscriber(f"{alive}/*", zenoh.handlers.Callback(self._receive_presence), history=True)
            # Last: a peer that sees this one may send to it at once.
            if self._vehicle_id is not None:
                self._token = liveliness.declare_token(f"{alive}/{self._vehicle_id}")
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
            if len(payload) > PAYLOAD_LIMIT_BYTES:
                self._hand_over(self._count_dropped)
            else:
                self._hand_over(self._deliver, payload.to_bytes())
        except Exception:  # whatever it is, it must not reach Zenoh's thread
            self._dropped += 1

    def _receive_presence(self, sample: zenoh.Sample) -> None:
        """Take one change of presence, on a thread of Zenoh's."""
        try:
            peer_id = int(str(sample.key_expr).rsplit("/", 1)[-1])
            self._hand_over(self._deliver_presence, peer_id, sample.kind == zenoh.SampleKind.PUT)
        except Exception:
            self._dropped += 1

    def _hand_over(self, function: Callable[..., None], *arguments: object) -> None:
        """Run a function on the event loop, unless that is gone."""
        if not self._closed and self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, *arguments)

    def _count_dropped(self) -> None:
        self._dropped += 1

    def _deliver(self, payload: bytes) -> None:
        if not self._closed:
            self._on_message(payload)

    def _deliver_presence(self, peer_id: int, present: bool) -> None:
        if self._closed or peer_id == self._vehicle_id or present == (peer_id in self._present):
            return
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


def _require_name(what: str, name: str) -> None:
    if not _NAME.fullmatch(name):
        raise ValueError(f"{what} = {name!r}: letters, digits, '_', '.' and '-' only")


def _refusal(listen: str | None, error: Exception) -> VehicleRefusedError:
    """Put Zenoh's long words in short ones."""
    text = str(error)
    if "in use" in text:
        return VehicleRefusedError(
            f"peer endpoint {listen} is taken", "end the other process or choose another port in [network]"
        )
    return VehicleRefusedError(f"peer endpoint {listen} cannot be opened: {text}", "check [network] in the mission")


def _ignore_message(_payload: bytes) -> None:
    pass


def _ignore_presence(_peer_id: int, _present: bool) -> None:
    pass
