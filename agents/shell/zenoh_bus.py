"""The peer bus of a process over Zenoh: each message is received and decoded once, and passed to all its participants.

The vehicles that a process flies share one Zenoh session, or one for each certificate where each has its own.
"""

import asyncio
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic

from agents.drops import NO_DROPS, Drops, Reason, Refusals
from agents.ports import VehicleRefusedError
from agents.shell.bus_security import Admitted, BusSecurity
from agents.shell.clock import MissionClock
from agents.shell.handover import Handover
from agents.shell.mailbox import Mailbox
from agents.shell.zenoh_session import BusTeam, ZenohSession
from agents.team.codec import Admission
from agents.team.messages import (
    HEAD_TOPIC,
    OPERATORS_TOPIC,
    PRESENCE_TOPIC,
    REPORT_TOPIC,
    ROSTER_TOPIC,
    TOPICS,
    BusMessage,
    MemberState,
    OperatorCommand,
    StartProposal,
)
from agents.team.participant import SENSOR_TOPICS, Participant, Role, is_name

RATE_HZ = 100.0
_STATES = TOPICS[MemberState].name
_SHOWN: dict[Role, str] = {"vehicle": PRESENCE_TOPIC, "operator": OPERATORS_TOPIC}
"""The topics of the presence of participants."""


@dataclass(frozen=True, slots=True)
class Station:
    """The participants that send through one session, the endpoint where it listens (None: nowhere), and its keys."""

    participants: tuple[Participant, ...]
    listen: str | None = None
    security: BusSecurity | None = None

    @property
    def vehicle_ids(self) -> tuple[int, ...]:
        """The ids of the vehicles among the participants."""
        return tuple(each.vehicle_id for each in self.participants if each.vehicle_id is not None)


class ZenohBus:
    """The bus of a team at explicit endpoints, for all participants of this process.

    There is a session for each station; `connect` are the endpoints of other processes. The first session receives for
    all, and connects to the others of this process. Each vehicle may send `rate_hz` messages a second on each topic;
    of vehicles outside the team only what announces that they join is received, until `admit`. The sessions are opened
    with the first participant and closed with the last one, once each.
    """

    def __init__(
        self,
        team: BusTeam,
        stations: Sequence[Station],
        connect: Sequence[str] = (),
        rate_hz: float = RATE_HZ,
        clock: MissionClock | None = None,
    ) -> None:
        """Take the settings; the sessions are opened with the first participant.

        Rates are those of the wall, or of a governed `clock`.
        """
        self._governed = clock is not None and clock.is_governed
        self.transit = None if clock is None else clock.bus_transit()
        self._now_s = clock.now_s if clock is not None and clock.is_governed else monotonic
        self._mailbox = Mailbox(stations[0].vehicle_ids, team.members, rate_hz)
        ends = [*(each.listen for each in stations[1:] if each.listen is not None), *connect]
        self._sessions = [
            ZenohSession(team, station.listen, connect if i else ends, station.security, self._mailbox.refuse)
            for i, station in enumerate(stations)
        ]
        self._stations, self._team = stations, team.name
        self._names = {str(each): each for each in team.members}
        self._admission = Admission()
        self._present: set[int] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._handover: Handover | None = None
        self._opening: asyncio.Future[None] | None = None
        self._joined: list[ParticipantBus] = []
        self._closed = False
        self._serial = 0 if stations[0].security is None else stations[0].security.serial
        self._renewing = asyncio.Lock()
        self._renewals: set[asyncio.Task[None]] = set()
        self.revoked: tuple[str, ...] = ()
        """The common names whose keys were revoked since the sessions were opened."""
        self.rosters: dict[str, int] = {}
        """The serial of the newest signed roster that each participant has sent, by its name."""
        self.heads: dict[str, bytes] = {}
        """The newest head of an audit log that each vehicle of another process has sent, by its name; not verified."""

    def of(self, participant: Participant) -> "ParticipantBus":
        """Return the bus as one participant of a station uses it."""
        session = next(
            session
            for session, station in zip(self._sessions, self._stations, strict=True)
            if participant in station.participants
        )
        return ParticipantBus(self, session, participant)

    @property
    def drops(self) -> Drops:
        """The messages dropped so far before delivery, and own messages that could not be sent."""
        unread, read = self._mailbox.drops, self._admission.drops
        return unread if read is NO_DROPS else unread.plus(read)

    @property
    def refusals(self) -> Refusals:
        """What was refused so far, by sender."""
        return Counter(self._mailbox.refusals) + Counter(self._admission.refusals)

    @property
    def alive(self) -> bool:
        """Whether the session that receives is open."""
        return self._sessions[0].alive

    @property
    def operated(self) -> bool:
        """Whether an operator is on the bus."""
        return self._mailbox.operated

    @property
    def operators_seen(self) -> int:
        """How often an operator has come so far."""
        return self._mailbox.operators_seen

    def admit(self, vehicle_id: int) -> None:
        """Receive from now on a vehicle that joins the team in flight."""
        self._names[str(vehicle_id)] = vehicle_id
        if self._mailbox.admit(vehicle_id):
            self._wake()

    async def join(self, bus: "ParticipantBus") -> None:
        """Open the sessions if necessary, and deliver messages to a participant from now on."""
        self._joined.append(bus)
        for peer_id in self._present - {bus.vehicle_id}:
            bus.on_presence(peer_id, True)
        if self._opening is None:
            self._loop = asyncio.get_running_loop()
            self._handover = Handover(self._loop, self._hand_over, gathers=not self._governed)
            self._opening = asyncio.ensure_future(asyncio.to_thread(self._open_blocking))
            self._opening.add_done_callback(lambda opening: opening.cancelled() or opening.exception())
        await asyncio.shield(self._opening)

    def leave(self, bus: "ParticipantBus") -> "asyncio.Future[None] | None":
        """Stop deliveries to a participant; for the last one, return the future that closes the sessions."""
        if bus not in self._joined:
            return None
        self._joined.remove(bus)
        self._closed = not self._joined
        return asyncio.ensure_future(self._close()) if self._closed else None

    async def _close(self) -> None:
        """Close the sessions; if this is cancelled, a thread that is opening them closes them."""
        if self._opening is not None:
            await asyncio.wait([self._opening, *self._renewals])
        await asyncio.to_thread(self._close_blocking)

    def count(self, reason: Reason, key: str = "") -> None:
        """Count a message that was dropped, by its key also for its sender."""
        self._mailbox.count(reason, key)

    def take_message(self, key: str, length: int, read: Callable[[], bytes], *, own: bool) -> None:
        """Take one message, on a Zenoh thread, or an own one on the publishing thread."""
        topic, _, name = key.partition("/")
        if self.transit is not None and not own and topic == _STATES and name in self._names:
            self.transit.take(self._names[name])
        try:
            if self._mailbox.put(key, length, read, self._now_s(), own=own):
                self._wake()
        except Exception:  # no exception may reach Zenoh's thread
            self._mailbox.count(Reason.MALFORMED)

    def take_presence(self, name: str, present: bool) -> None:
        """Take one change of presence, on a Zenoh thread."""
        try:
            if self._mailbox.put_presence(name, present):
                self._wake()
        except Exception:
            self._mailbox.count(Reason.MALFORMED)

    def take_operator(self, name: str, present: bool) -> None:
        """Take one change of an operator's presence, on a Zenoh thread."""
        self._mailbox.put_operator(name, present)

    def take_link(self, common_name: str) -> None:
        """Take one link, on a Zenoh thread: TLS opens it for any certificate of the authority."""
        security = self._stations[0].security
        admitted = () if security is None else (each.common_name for each in security.grants)
        if common_name in self.revoked or common_name not in admitted:
            self._mailbox.refuse(common_name, "not on the roster")

    def _open_blocking(self) -> None:
        several = sum(len(station.vehicle_ids) for station in self._stations) > 1
        looks_on = any(each.looks_on for station in self._stations for each in station.participants)
        try:
            # The first one last: it finds the others by their sockets.
            for i, session in reversed(list(enumerate(self._sessions))):
                session.open(None if i else self, own=several, reports=looks_on)
        except VehicleRefusedError:
            self._close_blocking()
            raise
        if self._closed:
            self._close_blocking()

    def _close_blocking(self) -> None:
        for session in self._sessions:
            session.close()

    def _wake(self) -> None:
        """Make the event loop take what waits, unless it is closed; the mailbox requests this once until then."""
        if not self._closed and self._handover is not None:
            self._handover.request()

    def _hand_over(self) -> None:
        presence, messages = self._mailbox.take()
        for peer_id, present in presence.items():
            if present != (peer_id in self._present):
                (self._present.add if present else self._present.discard)(peer_id)
                self._give([bus.on_presence for bus in self._others(peer_id)], peer_id, present)
        for key, payload in messages:
            topic, _, _ = key.partition("/")
            if topic in SENSOR_TOPICS:
                self._give([bus.on_sensor for bus in self._joined], topic, payload)
            elif topic == ROSTER_TOPIC:
                renewal = asyncio.ensure_future(self._renew(key.partition("/")[2], payload))
                self._renewals.add(renewal)
                renewal.add_done_callback(self._renewals.discard)
            elif topic == HEAD_TOPIC:
                self._keep_head(key, payload)
            else:
                self._deliver(key, payload)

    def _keep_head(self, key: str, payload: bytes) -> None:
        name = key.partition("/")[2]
        if self._stations[0].security is None:
            self.count(Reason.MALFORMED, key)
        elif all(self._names[name] not in station.vehicle_ids for station in self._stations):
            self.heads[name] = payload

    async def _renew(self, sender: str, payload: bytes) -> None:
        """Take a roster: from now on drop what comes from holders that it does not admit any more.

        Zenoh's access control lasts as long as its sessions, which stay open in flight. A vehicle sends a newer roster
        on, and answers others than vehicles with it.
        """
        async with self._renewing:
            admitted = await asyncio.to_thread(self._verified, payload)
        security = self._stations[0].security
        if admitted is None or security is None:
            self.count(Reason.MALFORMED, f"{ROSTER_TOPIC}/{sender}")
            return
        self.rosters[sender] = max(admitted.serial, self.rosters.get(sender, 0))
        is_newer = admitted.serial > self._serial
        if is_newer:
            self._serial, revoked = admitted.serial, security.not_in(admitted)
            self.revoked = tuple(grant.common_name for grant in revoked)
            keys = frozenset(key for grant in revoked for key in (*grant.topics, *grant.presence))
            if self._mailbox.block(keys):
                self._wake()
        if is_newer or (admitted.serial == self._serial and sender not in self._names):
            for bus in self._joined:
                if bus.vehicle_id is not None:
                    bus.publish(ROSTER_TOPIC, payload)

    def _verified(self, payload: bytes) -> Admitted | None:
        """Let each station keep a roster for its next session; return what it admits. Blocks for files."""
        keepers = [each.security.keeper for each in self._stations if each.security and each.security.keeper]
        return next(iter([keeper.take(payload) for keeper in keepers]), None)

    def _deliver(self, key: str, payload: bytes) -> None:
        """Decode a message and deliver it to all but its sender, unless it came on a wrong key."""
        security = self._stations[0].security
        content = payload if security is None else security.verified(self._team, key, payload)
        if content is None:
            self.count(Reason.WRONG_SENDER)
            return
        message = self._admission.admitted(key, content)
        if message is None:
            return
        sender = None if isinstance(message, OperatorCommand) else message.sender
        if str(sender) not in self._names and isinstance(message, StartProposal) and message.adds is None:
            self.count(Reason.NOT_A_MEMBER, key)
            return
        self._give([bus.on_message for bus in self._others(sender)], message)

    def _others(self, vehicle_id: int | None) -> "list[ParticipantBus]":
        """Return the participants that have joined, except a vehicle itself."""
        return [bus for bus in self._joined if vehicle_id is None or bus.vehicle_id != vehicle_id]

    def _give(self, receivers: Sequence[Callable[..., None]], *received: object) -> None:
        """Call receivers; an exception of one does not affect the others."""
        assert self._loop is not None
        for receive in receivers:
            try:
                receive(*received)
            except Exception as error:
                self._loop.call_exception_handler({"message": "a receiver of the bus failed", "exception": error})


class ParticipantBus:
    """The bus of a process for one of its participants; implements `agents.ports.PeerBus`.

    Observers publish nothing; vehicles and operators declare their presence. It is opened and closed once.
    """

    def __init__(self, bus: ZenohBus, session: ZenohSession, participant: Participant) -> None:
        """Take the arguments of `ZenohBus.of`."""
        self.participant = participant
        self.vehicle_id = participant.vehicle_id
        self.on_message: Callable[[BusMessage], None] = _ignore
        self.on_sensor: Callable[[str, bytes], None] = _ignore
        self.on_presence: Callable[[int, bool], None] = _ignore
        self._bus = bus
        self._session = session
        self._closed = False

    @property
    def alive(self) -> bool:
        """Whether the sessions that it sends and receives through are open; peers may be unreachable nevertheless."""
        return not self._closed and self._session.alive and self._bus.alive

    @property
    def drops(self) -> Drops:
        """The messages that the process has dropped so far, and own messages that could not be sent."""
        return self._bus.drops

    @property
    def operated(self) -> bool:
        """Whether an operator is on the bus, including this participant."""
        return self._bus.operated

    @property
    def operators_seen(self) -> int:
        """How often an operator has come so far."""
        return self._bus.operators_seen

    @property
    def revoked(self) -> tuple[str, ...]:
        """The common names whose keys were revoked since the bus was opened: nothing is received from them."""
        return self._bus.revoked

    @property
    def refusals(self) -> Refusals:
        """What the process has refused so far, by sender."""
        return self._bus.refusals

    @property
    def heads(self) -> Mapping[str, bytes]:
        """The newest head of an audit log that each vehicle of another process has sent, by its name; not verified."""
        return self._bus.heads

    @property
    def rosters(self) -> Mapping[str, int]:
        """The serial of the newest signed roster that each other participant has sent, by its name."""
        return self._bus.rosters

    async def open(
        self,
        on_message: Callable[[BusMessage], None],
        on_sensor: Callable[[str, bytes], None],
        on_presence: Callable[[int, bool], None],
    ) -> None:
        """Join the team. Raises VehicleRefusedError if the endpoints cannot be used, such as a port in use."""
        self.on_message, self.on_sensor, self.on_presence = on_message, on_sensor, on_presence
        try:
            await self._bus.join(self)
            await asyncio.to_thread(self._appear)
        except asyncio.CancelledError:
            self._closed = True
            self._bus.leave(self)
            raise

    def _appear(self) -> None:
        """Declare the presence of a vehicle or operator, as the last step: peers may send as soon as they see it."""
        topic = _SHOWN.get(self.participant.role)
        if topic is not None:
            self._session.appear(self.participant.name, topic)
            if self._closed:
                self._session.disappear(self.participant.name)

    def admit(self, vehicle_id: int) -> None:
        """Receive from now on a vehicle that joins the team in flight, for all participants of this process."""
        self._bus.admit(vehicle_id)

    def publish(self, topic: str, payload: bytes) -> None:
        """Send to every other participant, best effort; never raises for a lost network.

        It blocks for a millisecond at most. The topic of a command is `command/{verb}`; the participant's name follows
        it in the key.
        Raises ValueError for a topic that would be a pattern in a key.
        """
        if topic != REPORT_TOPIC and not all(map(is_name, topic.split("/"))):
            raise ValueError(f"topic = {topic!r}: letters, digits, '_', '.' and '-' only")
        if self._closed or self.participant.role == "observer":
            return
        if self._bus.transit is not None and topic == _STATES and self.vehicle_id is not None:
            self._bus.transit.send(self.vehicle_id)  # before it can arrive
        if not self._session.publish(f"{topic}/{self.participant.name}", payload):
            self._bus.count(Reason.NOT_SENT)

    async def close(self) -> None:
        """Leave; peers see it at once. May be called twice, and without `open`."""
        if not self._closed:
            self._closed = True
            await asyncio.to_thread(self._session.disappear, self.participant.name)
            closing = self._bus.leave(self)
            if closing is not None:
                await closing


def single_bus(
    participant: Participant,
    team: BusTeam,
    listen: str | None,
    connect: Sequence[str] = (),
    security: BusSecurity | None = None,
    clock: MissionClock | None = None,
) -> ParticipantBus:
    """Return the bus of a process with one participant, not yet open."""
    return ZenohBus(team, [Station((participant,), listen, security)], connect, clock=clock).of(participant)


def _ignore(*_received: object) -> None:
    pass
