"""The start agreement over the bus: one vehicle compares clocks with its peers and agrees with them on the start."""

import asyncio
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from itertools import count
from math import ceil, inf

import msgspec

from agents.ports import PeerBus, VehicleRefusedError
from agents.shell.clock import MissionClock
from agents.team.codec import encode
from agents.team.messages import (
    DID_LIMIT,
    TOPICS,
    AddedAnswer,
    AddedVehicle,
    BusMessage,
    MissionIdentity,
    StartProposal,
)
from agents.team.text import printable

LEAD_TIME_S = 2.0
"""The lead time of a proposed start: longer than a proposal takes to reach all members."""
GRID_S = 1.0
"""Missions start at whole seconds: ticks and samples then come at the same times of the mission in each flight."""
SAMPLES_MIN = 5
CLOCK_OFFSET_LIMIT_S = 0.5
_AGE_MAX_S = TOPICS[StartProposal].age_max_s


def is_possible(message: StartProposal, now_s: float, duration_s: float) -> bool:
    """Return whether a message proposes no start, or one with which the mission is not over at `now_s`.

    A new proposal is one lead time ahead; its time stamp may be wrong by up to `_AGE_MAX_S`.
    """
    start_s = message.start_s
    return start_s is None or now_s - duration_s <= start_s <= now_s + LEAD_TIME_S + GRID_S + _AGE_MAX_S


class PeerClocks:
    """The offsets of the peers' clocks, from the ages of their messages.

    Transmission times are not negative: the smallest age of several messages is nearest to the clocks' offset.
    """

    def __init__(self) -> None:
        self._least_s: dict[int, float] = {}
        self._count: Counter[int] = Counter()

    def receive(self, sender: int, lag_s: float) -> None:
        """Take the age of a peer's message on its arrival [wall s]."""
        self._count[sender] += 1
        self._least_s[sender] = min(lag_s, self._least_s.get(sender, lag_s))

    def lags_s(self) -> dict[int, float]:
        """Return the smallest age by peer, for the peers with enough samples [wall s]."""
        return {sender: lag_s for sender, lag_s in self._least_s.items() if self._count[sender] >= SAMPLES_MIN}

    def unmeasured(self, peers: Iterable[int]) -> list[int]:
        """Return which of `peers` have not sent enough samples yet."""
        return sorted(peer for peer in peers if self._count[peer] < SAMPLES_MIN)

    def require_one_time(self) -> None:
        """Refuse to fly with a peer whose clock differs: its messages would be too old or from the future.

        Raises VehicleRefusedError.
        """
        for peer, lag_s in self.lags_s().items():
            if abs(lag_s) > CLOCK_OFFSET_LIMIT_S:
                side = "ahead of" if lag_s > 0.0 else "behind"
                raise VehicleRefusedError(
                    f"this computer's clock is {abs(lag_s):.2f} s {side} that of vehicle {peer}'s",
                    "let both computers' clocks be set by one time server (chrony, NTP), then fly again",
                )


class TeamReadiness:
    """One vehicle's part in the start agreement: which members are ready, and the earliest start proposed.

    A vehicle that receives the readiness of all others proposes a start one lead time ahead; each vehicle uses the
    earliest proposal. Before there is a proposal a silent member is waited for; afterwards the start is final.
    """

    def __init__(self, vehicle_id: int, members: Collection[int]) -> None:
        self._vehicle_id = vehicle_id
        self.others = frozenset(members) - {vehicle_id}
        self._ready_s: dict[int, float] = {}
        self._start_s: float | None = None

    @property
    def start_s(self) -> float | None:
        """The earliest start proposed so far, None before the first proposal."""
        return self._start_s

    def missing(self, now_s: float) -> list[int]:
        """Return the members that have not reported readiness recently."""
        return sorted(i for i in self.others if now_s - self._ready_s.get(i, -_AGE_MAX_S) >= _AGE_MAX_S)

    def receive(self, message: StartProposal) -> None:
        """Take a peer's readiness and proposal; both are ignored from a peer that is not ready."""
        if message.sender not in self.others or not message.ready:
            return
        self._ready_s[message.sender] = max(message.time_s, self._ready_s.get(message.sender, message.time_s))
        if message.start_s is not None:
            self._start_s = message.start_s if self._start_s is None else min(self._start_s, message.start_s)

    def message(self, now_s: float, *, ready: bool = True) -> StartProposal:
        """Return the message to the peers; the first one after all members are ready proposes a start."""
        if not ready:
            return StartProposal(self._vehicle_id, now_s, None, ready=False)
        if self._start_s is None and not self.missing(now_s):
            self._start_s = GRID_S * ceil((now_s + LEAD_TIME_S) / GRID_S)
        return StartProposal(self._vehicle_id, now_s, self._start_s)


START_TIMEOUT_S = 120.0
CLOCKS_TIMEOUT_S = 1.2
"""The longest wait of a take-off for the clocks of present peers [wall s], which may still be connecting."""
_PERIOD_S = TOPICS[StartProposal].period_s
_IN_FLIGHT_EACH = 5
"""In flight one of so many proposals is sent: each of 64 vehicles would receive 320 a second, as many as states."""
_ANSWERED_MAX = 4
"""The number of vehicles that are not in the mission file and are answered, one with each proposal."""
_OFTEN_FOR_S = 2.0
"""How long all are sent to one that has just come, which compares clocks and missions with them [wall s]."""


class StartAgreement:
    """Sends time and mission to the peers after `announce`, and readiness after `agree`; receives theirs.

    It continues in flight, because operators compare the mission with theirs before they send a command: once a second,
    and more often when an operator or a vehicle has come, or while one has not begun the mission.
    """

    def __init__(
        self,
        bus: PeerBus,
        clock: MissionClock,
        vehicle_id: int,
        members: Collection[int],
        mission: MissionIdentity | None = None,
        *,
        is_added: bool = False,
    ) -> None:
        """Take the team; a vehicle that `is_added` to it sends nothing before it introduces itself."""
        self._bus = bus
        self._clock = clock
        self._vehicle_id = vehicle_id
        self._mission = mission
        self._other_missions: dict[int, MissionIdentity] = {}
        self._readiness = TeamReadiness(vehicle_id, members)
        self._clocks = PeerClocks()
        self._duration_s = 0.0
        self._present: set[int] = set()
        self._announcing: asyncio.Task[None] | None = None
        self._agreeing = False
        self._agreed = False
        self._often_until_s = -inf
        self._operators_seen = 0
        self._is_added = is_added
        self._adds: AddedVehicle | None = None
        self._outgoing: tuple[AddedAnswer, ...] = ()
        self._answers: dict[int, AddedAnswer] = {}

    @property
    def answers(self) -> Mapping[int, AddedAnswer]:
        """What the peers have answered last to this vehicle's introduction, by their ids."""
        return self._answers

    def introduce(self, vehicle: AddedVehicle) -> None:
        """Announce that this vehicle, which is not in the mission file, joins the peers."""
        self._adds = vehicle

    def answer(self, vehicle_id: int, vehicle: AddedVehicle, refusal: str) -> None:
        """Answer a vehicle that is not in the mission file from now on; without a refusal it may join.

        The last few are answered in turn.
        """
        given = AddedAnswer(vehicle_id, vehicle, printable(refusal)[:DID_LIMIT], self._duration_s)
        answers = {each.vehicle: each for each in self._outgoing} | {vehicle_id: given}  # in their turns
        self._outgoing = tuple(answers.values())[-_ANSWERED_MAX:]

    @property
    def start_s(self) -> float | None:
        """The mission's start on the shared clock, None until agreed."""
        return self._readiness.start_s

    @property
    def clock_lags_s(self) -> dict[int, float]:
        """How far the clocks of the peers' computers are behind this one's, as far as measured [wall s]."""
        return self._clocks.lags_s()

    @property
    def refusal(self) -> VehicleRefusedError | None:
        """The refusal to take off with the peers received so far, None if there is no reason."""
        try:
            self._require_one_mission()
            self._clocks.require_one_time()
        except VehicleRefusedError as refusal:
            return refusal
        return None

    def bound(self, duration_s: float) -> None:
        """Take the mission's duration: a mission that began longer ago is over, and is not joined."""
        self._duration_s = duration_s

    def with_only(self, members: Collection[int]) -> None:
        """Agree with these members of the team only: the others do not begin with this vehicle."""
        self._readiness = TeamReadiness(self._vehicle_id, members)

    def announce(self) -> None:
        """Send the time to the peers from now on; the clock's speed must be set."""
        self._announcing = self._announcing or asyncio.create_task(self._announce())

    def receive(self, message: BusMessage) -> None:
        """Take a message from the bus; messages other than those of the start agreement are ignored.

        An impossible start is ignored, with the readiness in the same message. A member that arrives late or returns is
        sent the start of the mission, so that it joins.
        """
        if self._announcing is None:  # the speed of this clock is not set yet
            return
        if isinstance(message, StartProposal) and message.start_s is None:
            self._send_often()
        if isinstance(message, StartProposal) and message.answer is not None:
            self._take_answer(message.sender, message.answer)
        if isinstance(message, StartProposal) and self._agreed:
            if message.start_s is None and message.sender in self._readiness.others:
                self._publish(self._readiness.message(self._clock.now_s()))
        elif isinstance(message, StartProposal) and self._flies_already(message):
            self._clocks.receive(message.sender, (self._clock.now_s() - message.time_s) / self._clock.time_scale)
        elif isinstance(message, StartProposal) and message.sender in self._readiness.others:
            if message.mission is not None and self._mission is not None and message.mission != self._mission:
                self._other_missions[message.sender] = message.mission
                return
            now_s = self._clock.now_s()
            lag_s = now_s - message.time_s
            self._clocks.receive(message.sender, lag_s / self._clock.time_scale)
            if abs(lag_s) < TOPICS[StartProposal].age_max_s and is_possible(message, now_s, self._duration_s):
                self._readiness.receive(message)

    def _flies_already(self, message: StartProposal) -> bool:
        """Return whether a vehicle that joined an earlier flight of this team still flies: it has to have one clock."""
        begins_with_this = message.sender in self._readiness.others  # both are taken in the air and brought home
        joined = message.adds is not None and message.start_s is not None and message.mission == self._mission
        return joined and not begins_with_this

    def _take_answer(self, sender: int, answer: AddedAnswer) -> None:
        if (answer.vehicle, answer.about) == (self._vehicle_id, self._adds):  # not to an earlier attempt
            self._answers[sender] = answer

    def note_presence(self, vehicle_id: int, present: bool) -> None:
        """Take whether a peer is present."""
        (self._present.add if present else self._present.discard)(vehicle_id)
        if present:
            self._send_often()

    async def compare_clocks(self) -> None:
        """Compare clocks with the peers present, while all are on the ground; later ones are compared in `agree`.

        Raises VehicleRefusedError when a clock differs, or a vehicle of this team flies another mission. Before that,
        the vehicle announces long enough for its peers to refuse as well: one that left at once would be unknown to
        them, and they would take off.
        """
        self.announce()
        timeout_s = CLOCKS_TIMEOUT_S * self._clock.time_scale
        end_s = self._clock.now_s() + timeout_s
        try:
            while self._clocks.unmeasured(self._present & self._readiness.others) and self._clock.now_s() < end_s:
                self._require_one_mission()
                await self._pause()
            self._require_one_mission()
            self._clocks.require_one_time()
        except VehicleRefusedError:
            await self._clock.sleep(timeout_s)
            raise

    async def agree(self) -> float:
        """Wait until all members are ready, and return the mission's start at that moment.

        Raises VehicleRefusedError when a member is not received, its clock differs, or it flies another mission.
        """
        self._agreeing = True  # it now reports readiness
        try:
            start_s = await self._agree()
            self._agreed = True
        finally:
            self._agreeing = False
        return start_s

    async def _agree(self) -> float:
        deadline_s = self._clock.now_s() + START_TIMEOUT_S
        while self.start_s is None or self._clock.now_s() < self.start_s:
            self._require_one_mission()
            self._clocks.require_one_time()
            now_s = self._clock.now_s()
            if self.start_s is None and now_s > deadline_s:
                missing = ", ".join(map(str, self._readiness.missing(now_s)))
                raise VehicleRefusedError(
                    f"vehicles not received on the bus within {START_TIMEOUT_S:.0f} s: {missing}",
                    "start their agents, or check the vehicles' endpoints in the mission file",
                )
            self._publish(self._readiness.message(now_s))
            if self.start_s is not None:
                self._clock.begin_mission(self.start_s)
            await self._pause()
        return self.start_s

    def stop_announcing(self) -> None:
        """Stop sending time and mission."""
        if self._announcing is not None:
            self._announcing.cancel()

    async def _announce(self) -> None:
        for turn in count():
            if not self._agreeing and self._is_due(turn):
                self._publish(self._readiness.message(self._clock.now_s(), ready=self._agreed))
            await (self._clock.sleep(_PERIOD_S * self._clock.time_scale) if self._agreed else self._pause())

    def _is_due(self, turn: int) -> bool:
        if self._bus.operators_seen != self._operators_seen:
            self._operators_seen = self._bus.operators_seen
            self._send_often()
        return not self._agreed or turn % _IN_FLIGHT_EACH == 0 or self._clock.now_s() < self._often_until_s

    def _send_often(self) -> None:
        if self._agreed:
            self._often_until_s = self._clock.now_s() + _OFTEN_FOR_S * self._clock.time_scale

    def _require_one_mission(self) -> None:
        """Refuse to fly with a vehicle of the team that flies another mission, or another version of this one."""
        for sender, other in self._other_missions.items():
            ours = self._mission
            if ours is None:
                continue
            if other.name != ours.name:
                raise VehicleRefusedError(
                    f"vehicle {sender} of this team flies the mission {other.name!r}, not {ours.name!r}",
                    "end that flight, or give this mission another network.team",
                )
            raise VehicleRefusedError(
                f"vehicle {sender} flies another version of the mission {ours.name!r}",
                "copy one mission file and its profiles to all computers of the team, and give the same --set; the log "
                "of each flight holds the mission that it flies (mission_text of /run)",
            )

    def _publish(self, message: StartProposal) -> None:
        if self._is_added and self._adds is None:
            return
        first = next(iter(self._outgoing), None)
        self._outgoing = (*self._outgoing[1:], *self._outgoing[:1])
        whole = msgspec.structs.replace(message, mission=self._mission, adds=self._adds, answer=first)
        self._bus.publish(TOPICS[StartProposal].name, encode(whole))

    async def _pause(self) -> None:
        await self._clock.sleep(_PERIOD_S)
