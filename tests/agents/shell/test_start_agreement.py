"""The start agreement: three vehicles over an exchange that loses and delays messages."""

import asyncio
import heapq
from collections import defaultdict
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.ports import PeerBus, VehicleRefusedError
from agents.shell.clock import MissionClock
from agents.shell.start_agreement import (
    LEAD_TIME_S,
    SAMPLES_MIN,
    PeerClocks,
    StartAgreement,
    TeamReadiness,
    is_possible,
)
from agents.team.codec import decode
from agents.team.messages import TOPICS, AddedVehicle, MissionIdentity, StartProposal

MEMBERS = (1, 2, 3)
PERIOD_S = TOPICS[StartProposal].period_s
# At most three losses in a row: with the longest delay a proposal is through within a second, half the lead time.
fates = st.lists(st.tuples(st.integers(0, 3), st.floats(0.0, 0.2)), min_size=1, max_size=40)


def exchange(
    up_s: tuple[float, float, float], fates: list[tuple[int, float]]
) -> tuple[list[TeamReadiness], list[float]]:
    """Let everybody speak from the moment it is up until its start, as agents do; return all starts proposed, too."""
    vehicles = [TeamReadiness(member, MEMBERS) for member in MEMBERS]
    flying: list[tuple[float, int, int, StartProposal]] = []
    losses: dict[tuple[int, int], int] = defaultdict(int)
    proposed: list[float] = []
    sent = 0
    for tick in range(200):
        now_s = tick * 0.05
        while flying and flying[0][0] <= now_s:
            _, _, receiver, message = heapq.heappop(flying)
            vehicles[receiver].receive(message)
        for index, readiness in enumerate(vehicles):
            due = now_s >= up_s[index] and (tick + index) % round(PERIOD_S / 0.05) == 0
            if not due or (readiness.start_s is not None and now_s >= readiness.start_s):
                continue
            unheard, before = readiness.missing(now_s), readiness.start_s
            message = readiness.message(now_s)
            if before is None and message.start_s is not None:
                assert unheard == []
                proposed.append(message.start_s)
            for receiver in range(len(MEMBERS)):
                run, delay_s = fates[sent % len(fates)]
                sent += 1
                if receiver != index and losses[index, receiver] < run:
                    losses[index, receiver] += 1
                elif receiver != index:
                    losses[index, receiver] = 0
                    heapq.heappush(flying, (now_s + delay_s, sent, receiver, message))
    return vehicles, proposed


@given(st.tuples(st.floats(0.0, 4.0), st.floats(0.0, 4.0), st.floats(0.0, 4.0)), fates)
def test_all_start_at_the_earliest_proposal(up_s: tuple[float, float, float], fates: list[tuple[int, float]]) -> None:
    vehicles, proposed = exchange(up_s, fates)
    assert proposed
    assert {readiness.start_s for readiness in vehicles} == {min(proposed)}
    assert min(proposed) >= max(up_s) + LEAD_TIME_S


def test_no_start_is_proposed_before_all_members_were_received_recently() -> None:
    readiness = TeamReadiness(1, MEMBERS)
    assert readiness.missing(0.0) == [2, 3]
    assert readiness.message(0.0).start_s is None
    readiness.receive(StartProposal(2, 0.1, None))
    assert readiness.missing(0.2) == [3]
    readiness.receive(StartProposal(3, 1.2, None))
    assert readiness.missing(1.2) == [2]
    assert readiness.message(1.2).start_s is None
    readiness.receive(StartProposal(2, 1.3, None))
    assert readiness.message(1.4) == StartProposal(1, 1.4, 4.0)  # a whole second, 2 s ahead at least


def test_a_late_message_does_not_make_a_peer_older() -> None:
    readiness = TeamReadiness(1, (1, 2))
    readiness.receive(StartProposal(2, 5.0, None))
    readiness.receive(StartProposal(2, 4.0, None))
    assert readiness.missing(5.9) == []


def test_who_is_not_ready_yet_is_not_there_and_starts_nothing() -> None:
    readiness, waiting = TeamReadiness(1, (1, 2)), TeamReadiness(2, (1, 2))
    readiness.receive(waiting.message(0.1, ready=False))
    readiness.receive(StartProposal(2, 0.2, 5.0, ready=False))
    assert readiness.missing(0.3) == [2]
    assert readiness.message(0.3).start_s is None
    waiting.receive(StartProposal(1, 0.4, None))
    assert waiting.message(0.5, ready=False) == StartProposal(2, 0.5, None, ready=False)
    assert waiting.start_s is None
    readiness.receive(waiting.message(0.6))
    assert readiness.start_s == 3.0


def test_the_least_lag_is_the_offset_of_a_peers_clock_after_enough_messages() -> None:
    clocks = PeerClocks()
    for count in range(1, SAMPLES_MIN + 1):
        assert clocks.lags_s() == {}
        clocks.receive(2, 0.3 + 0.1 * count)
    clocks.receive(3, -4.0)
    assert clocks.lags_s() == {2: 0.3 + 0.1}
    assert clocks.unmeasured({2, 3, 4}) == [3, 4]
    clocks.receive(2, -0.5)
    assert clocks.lags_s() == {2: -0.5}


@pytest.mark.parametrize(("lag_s", "told"), [(-0.51, "0.51 s behind"), (0.49, None)])
def test_a_peer_with_another_clock_is_refused(lag_s: float, told: str | None) -> None:
    clocks = PeerClocks()
    for _ in range(SAMPLES_MIN - 1):
        clocks.receive(3, lag_s)
    clocks.require_one_time()
    clocks.receive(3, lag_s)
    if told is None:
        clocks.require_one_time()
        return
    with pytest.raises(VehicleRefusedError) as refused:
        clocks.require_one_time()
    assert refused.value.reason == f"this computer's clock is {told} that of vehicle 3's"
    assert "chrony" in refused.value.next_step


class Clock:
    """Passes a little at every look, and while somebody sleeps."""

    time_scale = 1.0

    def __init__(self) -> None:
        self.time_s = 0.0
        self.began_s: float | None = None

    async def sleep(self, duration_s: float) -> None:
        end_s = self.time_s + duration_s
        while self.time_s < end_s:
            self.time_s += 0.01
            await asyncio.sleep(0.0)

    def begin_mission(self, time_s: float) -> None:
        self.began_s = time_s

    def now_s(self) -> float:
        self.time_s += 0.02
        return self.time_s


class Air:
    """A bus that keeps what is said; two others, 2 and 3, are up."""

    def __init__(self, clock: Clock, mission: MissionIdentity | None = None) -> None:
        self.said: list[StartProposal] = []
        self.agreement = StartAgreement(cast(PeerBus, self), cast(MissionClock, clock), 1, [1, 2, 3], mission)
        self._clock = clock

    def publish(self, _topic: str, payload: bytes) -> None:
        message = decode(payload)
        assert isinstance(message, StartProposal)
        self.said.append(message)
        if message.start_s is None:
            for sender in (2, 3):
                self.agreement.receive(StartProposal(sender, self._clock.time_s, None))


def test_who_comes_when_the_mission_has_begun_is_told_when_that_was() -> None:
    async def late() -> None:
        air = Air(Clock())
        air.agreement.announce()
        start_s = await air.agreement.agree()
        air.said.clear()
        air.agreement.receive(StartProposal(9, 1.0, None))  # nobody of this team
        air.agreement.receive(StartProposal(2, 1.0, start_s))  # knows it
        assert air.said == []
        air.agreement.receive(StartProposal(2, 1.0, None, ready=False))
        air.agreement.receive(StartProposal(3, 1.0, None))
        assert [(told.sender, told.start_s, told.ready) for told in air.said] == [(1, start_s, True)] * 2

    asyncio.run(late())


@pytest.mark.parametrize(
    ("start_s", "possible"),
    [(None, True), (399.0, False), (401.0, True), (1003.9, True), (1005.0, False)],
)
def test_a_start_is_a_lead_time_ahead_or_of_a_mission_under_way(start_s: float | None, possible: bool) -> None:
    assert is_possible(StartProposal(2, 1000.0, start_s), 1000.0, 600.0) is possible


def test_a_start_that_cannot_be_neither_ends_the_mission_nor_holds_it_up() -> None:
    async def agreed() -> None:
        clock = Clock()
        clock.time_s = 1000.0
        air = Air(clock)
        air.agreement.bound(600.0)
        air.agreement.announce()
        for start_s in (0.0, 1e9):
            air.agreement.receive(StartProposal(2, clock.time_s, start_s))
        assert air.agreement.start_s is None
        start_s = await air.agreement.agree()
        assert 1002.0 < start_s < 1010.0
        assert start_s == clock.began_s == round(start_s)

    asyncio.run(agreed())


def test_who_joins_a_mission_under_way_takes_its_start() -> None:
    async def joined() -> None:
        clock = Clock()
        clock.time_s = 1000.0
        air = Air(clock)
        air.agreement.bound(600.0)
        air.agreement.announce()
        air.agreement.receive(StartProposal(2, clock.time_s, 700.0))
        assert await air.agreement.agree() == 700.0

    asyncio.run(joined())


def test_the_clock_of_a_stranger_keeps_no_vehicle_on_the_ground() -> None:
    async def compared() -> None:
        air = Air(Clock())
        air.agreement.announce()
        for _ in range(SAMPLES_MIN):
            air.agreement.receive(StartProposal(9, 500.0, None))
        await air.agreement.compare_clocks()
        assert air.agreement.clock_lags_s == {}

    asyncio.run(compared())


@pytest.mark.parametrize(("lag_s", "refused"), [(0.0, False), (-69.0, True)])
def test_who_joined_an_earlier_flight_and_still_flies_has_to_have_the_same_clock(lag_s: float, refused: bool) -> None:
    async def compared() -> None:
        clock, ours = Clock(), MissionIdentity("ours", 16 * "1")
        agreement = Air(clock, ours).agreement
        agreement.announce()
        adds = AddedVehicle((0.0, -9.0), 8.0)
        for _ in range(SAMPLES_MIN):
            agreement.receive(StartProposal(4, clock.time_s - lag_s, 1.0, mission=ours, adds=adds))
        refusal = agreement.refusal
        assert (refusal is not None and "that of vehicle 4's" in refusal.reason) is refused

    asyncio.run(compared())


@pytest.mark.parametrize("differs", ["clock", "mission"])
def test_who_refuses_a_peer_announces_until_that_peer_can_refuse_as_well(differs: str) -> None:
    async def compared() -> None:
        clock = Clock()
        air = Air(clock, MissionIdentity("ours", 16 * "1"))
        air.agreement.announce()
        lag_s, theirs = (0.7, None) if differs == "clock" else (0.0, MissionIdentity("theirs", 16 * "2"))
        for _ in range(SAMPLES_MIN):
            air.agreement.receive(StartProposal(2, clock.time_s - lag_s, None, mission=theirs))
        with pytest.raises(VehicleRefusedError):
            await air.agreement.compare_clocks()
        assert len(air.said) >= SAMPLES_MIN
        assert all(said.mission == MissionIdentity("ours", 16 * "1") for said in air.said)

    asyncio.run(compared())
