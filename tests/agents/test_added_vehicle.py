"""A vehicle that is not in the mission file joins: the others keep their slots and layers, and judge whether it may."""

import asyncio
from collections.abc import Callable
from dataclasses import replace

import pytest
from msgspec import structs

from agents.core import VehicleCore
from agents.inputs import AutopilotStatus, Command, Message, Presence, Rejoined, Start, VehicleJoins
from agents.notes import Note
from agents.ports import VehicleStatus
from agents.refusals import added_refusal
from agents.settings.config import AgentConfig
from agents.settings.sections import ChoreographySettings, ExcitationSettings
from agents.shell.agent import Agent
from agents.team.codec import decode
from agents.team.messages import (
    DID_LIMIT,
    AddedAnswer,
    AddedVehicle,
    MemberState,
    MissionIdentity,
    OperatorCommand,
    RingValues,
    StartProposal,
)
from estimation.state import Telemetry
from estimation.vectors import Pair
from tests.support.fake_flight import PAIR, FakeFlight
from tests.support.simulated_loop import run_simulated

STARTS_M = ((0.0, 4.0), (0.0, 0.0), (0.0, -4.0))
FOURTH = AddedVehicle((0.0, -8.0), 8.0)


def unknown(_target: str | None) -> Pair | None:
    return None


@pytest.fixture
def config(make_config: Callable[..., AgentConfig]) -> AgentConfig:
    """Return vehicle 2 of a team of three with layers."""
    return make_config(
        starts_m=STARTS_M,
        home_m=STARTS_M[1],
        safety={"separation_m": 3.0},
        choreography=ChoreographySettings(layer_m=3.0, landing="return", landing_order=(3, 1)),
    )


def test_the_others_keep_their_slots_and_layers_and_land_before_it(config: AgentConfig) -> None:
    enlarged = config.with_added(4, FOURTH.start_m)
    own = [replace(each, vehicle_id=i) for i in config.slots for each in (config, enlarged)]
    for before, after in zip(own[::2], own[1::2], strict=True):
        i = before.vehicle_id
        assert (after.take_off_altitude_m, after.return_altitude_m) == (
            before.take_off_altitude_m,
            before.return_altitude_m,
        )
        assert after.slot_offset_m(i, 2) == before.slot_offset_m(i, 2)
        assert after.starters == before.starters
    added = replace(enlarged, vehicle_id=4)
    assert enlarged.landing_order == (3, 1, 2, 4)
    assert added.return_altitude_m == max(each.return_altitude_m for each in own) + 3.0
    assert added.take_off_altitude_m == max(each.take_off_altitude_m for each in own) + 3.0
    assert added.slot_offset_m(4, 3) == (0.0, -config.formation.spacing_m)


def test_one_that_comes_back_has_the_same_place_in_line_and_another_start(config: AgentConfig) -> None:
    again = config.with_added(4, FOURTH.start_m).with_added(4, (0.0, -12.0))
    assert again == config.with_added(4, (0.0, -12.0))
    assert again.starts_m[again.slots.index(4)] == (0.0, -12.0)


@pytest.mark.parametrize(
    ("vehicle_id", "vehicle", "change", "said"),
    [
        (4, FOURTH, {}, ""),
        (3, FOURTH, {}, "vehicle 3 is in the mission: rejoin it without --add"),
        (5, FOURTH, {"added": 4}, "vehicle 4 has been added already"),
        (4, AddedVehicle((0.0, -6.0), 8.0), {}, "its start is 2.0 m from that of vehicle 3: 3 m at least"),
        (4, AddedVehicle((0.0, -8.0), 9.0), {}, "9 m is not between the team's altitudes, 8 to 8 m"),
        (4, AddedVehicle((0.0, -8.0), 8.0, (0.0, 9.0)), {}, "a vehicle of a free formation needs a slot"),
        (4, FOURTH, {"slots_m": ((0.0, 0.0), (0.0, 5.0), (0.0, 9.0))}, "a vehicle of a free formation needs a slot"),
        (4, FOURTH, {"excitation": ExcitationSettings()}, "it flies for identification"),
    ],
)
def test_who_may_join(
    config: AgentConfig, vehicle_id: int, vehicle: AddedVehicle, change: dict[str, object], said: str
) -> None:
    refused = added_refusal(vehicle_id, vehicle, replace(config, **change), unknown)  # type: ignore[arg-type]
    assert refused.startswith(said)
    assert bool(refused) is bool(said)


def test_the_ring_as_commanded_has_to_have_room_for_one_more(make_config: Callable[..., AgentConfig]) -> None:
    """Three vehicles 3 m apart fit on a ring of 1.8 m, four need 2.13 m."""
    for radius_m, needed in ((2.0, "a ring of 2 m has no room for the team: more than 2.1 m is needed"), (2.3, "")):
        config = make_config(starts_m=STARTS_M, safety={"separation_m": 3.0}, encirclement={"radius_min_m": 0.5})
        assert added_refusal(4, FOURTH, config.with_ring(radius_m=radius_m), unknown) == needed


def state(sender: int, time_s: float) -> Message:
    here, rest = (5.0, 5.0 * sender), (0.0, 0.0)
    return Message(time_s, MemberState(sender, time_s, "hold", here, rest, here, rest))


def flying(core: VehicleCore, now_s: float) -> tuple[int, ...]:
    """Tick a core in the air; return the peers that it knows."""
    core.take(AutopilotStatus(VehicleStatus(connected=True, armed=True, in_air=True)))
    core.take(Telemetry(now_s, (0.0, 0.0, 8.0), (0.0, 0.0, 0.0)))
    return tuple(each.sender for each in core.tick(now_s).status.peers)


def test_a_core_takes_it_as_a_member_from_then_on_also_in_its_own_next_flight(config: AgentConfig) -> None:
    core = VehicleCore(config)
    core.take(state(4, 1.0))
    assert flying(core, 1.0) == ()
    core.take(VehicleJoins(4, FOURTH))
    core.take(state(4, 1.1))
    assert flying(core, 1.1) == (4,)
    core.take(Rejoined(2.0, ""))
    core.take(state(4, 2.1))
    core.take(Start(0.0))
    assert flying(core, 2.1) == (4,)


def test_one_that_joins_holds_once_those_that_it_received_are_silent_although_another_never_was(
    config: AgentConfig, subtests: pytest.Subtests
) -> None:
    """Vehicle 3 is down and off the bus. On the ground with the others from the beginning, the core waits for it."""
    silent_s = config.failsafe.peers_silent_s
    for joins in (True, False):
        with subtests.test(joins=joins):
            core, notes = VehicleCore(replace(config.with_added(4, FOURTH.start_m), vehicle_id=4)), list[Note]()
            if joins:
                core.take(Rejoined(0.0, ""))
            core.take(Start(0.0))
            for tick in range(round(20.0 * (10.0 + silent_s))):
                now_s = 1.0 + tick / 20.0
                for sender in (1, 2) if now_s < 5.0 else ():
                    core.take(state(sender, now_s))
                core.take(AutopilotStatus(VehicleStatus(connected=True, armed=True, in_air=True)))
                core.take(Telemetry(now_s, (0.0, 0.0, 8.0), (0.0, 0.0, 0.0)))
                notes += core.tick(now_s).status.notes
            assert ("all peers silent" in {each.alert.condition for each in notes if each.alert}) is joins


def test_one_that_did_not_take_off_after_all_answers_again(config: AgentConfig) -> None:
    core = VehicleCore(replace(config.with_added(4, FOURTH.start_m), vehicle_id=4))
    core.take(AutopilotStatus(VehicleStatus(connected=True)))
    core.take(Command(1.0, OperatorCommand(1.0, "rejoin", 4, "pat", 7)))
    said = []
    for refusal in ("", "arming was denied", "arming was denied"):
        core.take(Rejoined(2.0, refusal))
        said.append([(each.did, each.outcome) for each in core.commands.answers(2.0)])
    assert said == [[("takes off and joins the others", "obeyed")], [("refused: arming was denied", "refused")], []]


def test_a_core_on_the_ground_refuses_a_start_beside_it(config: AgentConfig) -> None:
    core = VehicleCore(config)
    flying(core, 1.0)
    core.take(AutopilotStatus(VehicleStatus(connected=True)))
    beside = AddedVehicle((2.0, 0.0), 8.0)
    core.take(VehicleJoins(4, beside))
    assert (core.added, core.added_refusal) == (None, "it stands 2.0 m from this start: 3 m at least")
    core.take(VehicleJoins(4, FOURTH))
    assert (core.added, core.added_refusal) == ((4, FOURTH), "")


def test_one_whose_last_state_is_in_the_air_does_not_join_anew_until_it_has_landed(config: AgentConfig) -> None:
    elsewhere = AddedVehicle((0.0, -12.0), 8.0)
    for tactic, altitude_m, refused in (
        ("encircle", 8.0, True),
        ("land", 6.0, True),
        ("land", 0.2, False),
        ("standby", 0.0, False),
    ):
        for is_silent in (False, True):
            core = VehicleCore(config)
            flying(core, 1.0)
            core.take(VehicleJoins(4, FOURTH))
            assert core.added_aloft == "", "it has not flown yet"
            message = state(4, 1.1).message
            assert isinstance(message, MemberState)
            core.take(Message(1.1, structs.replace(message, tactic=tactic, altitude_m=altitude_m)))
            if is_silent:
                core.take(Presence(4, present=False))
                flying(core, 300.0)
            said = core.added_aloft
            assert ("in the air last, " in said) is refused, (tactic, altitude_m, is_silent)
            assert len(said) <= DID_LIMIT
            core.take(VehicleJoins(4, elsewhere))
            assert core.added_refusal == said, "also from another place"
            assert core.added == (4, FOURTH if refused else elsewhere)


def test_a_ring_too_small_for_four_is_refused_once_the_fourth_has_joined(config: AgentConfig) -> None:
    command = OperatorCommand(1.0, "ring", None, "anna", 1, ring=RingValues(radius_m=2.0))
    config = replace(config, encirclement=config.encirclement.model_copy(update={"radius_min_m": 0.5}))
    for added, refused in ((False, False), (True, True)):
        core = VehicleCore(config)
        flying(core, 1.0)
        if added:
            core.take(VehicleJoins(4, FOURTH))
        core.take(Message(1.0, command))
        answer = core.commands.answer(command.key, 1.0)
        assert answer is not None
        assert ("no room for the team" in answer.did) is refused, answer.did


MISSION = MissionIdentity("ours", "0" * 16)


async def all_answered(flight: FakeFlight, *messages: StartProposal) -> dict[int, str]:
    """Return what an agent answers to announcements, by their senders: why not, empty if it may join.

    They are repeated as often as vehicles do.
    """
    await asyncio.sleep(0.5)
    sent = len(flight.bus.payloads("start"))
    for _ in range(5):
        for each in messages:
            flight.bus.deliver(each)
        await asyncio.sleep(0.2)
    proposals = [each for each in map(decode, flight.bus.payloads("start")[sent:]) if isinstance(each, StartProposal)]
    return {each.answer.vehicle: each.answer.refusal for each in proposals if each.answer is not None}


async def answered(flight: FakeFlight, message: StartProposal) -> str | None:
    """Return what an agent answers to one announcement, None for no answer."""
    return (await all_answered(flight, message)).get(message.sender)


def test_an_agent_takes_one_that_has_its_own_mission_and_admits_it_to_the_bus() -> None:
    async def main() -> None:
        flight = FakeFlight(PAIR)
        flight.agent = Agent(replace(flight.parts, mission=MISSION))
        await flight.begin(100.0)
        plain = StartProposal(4, flight.clock.now_s(), None, ready=False, adds=FOURTH)
        ours = structs.replace(plain, mission=MISSION)
        other = MissionIdentity("ours", "1" * 16)
        assert await answered(flight, plain) is None
        assert await answered(flight, structs.replace(plain, mission=other)) is None
        assert flight.bus.admitted == []
        assert await answered(flight, ours) == ""
        assert await answered(flight, ours) == ""
        aloft = state(4, flight.clock.now_s()).message
        assert isinstance(aloft, MemberState)
        flight.bus.deliver(structs.replace(aloft, altitude_m=8.0))
        assert await answered(flight, structs.replace(ours, ready=True, start_s=0.0)) == "", "it flies"
        assert "in the air last, 8.0 m high" in str(await answered(flight, ours)), "it is about to take off"
        both = await all_answered(flight, structs.replace(ours, sender=5), ours)
        assert ("in the air last" in both[4], "vehicle 4 has been added already" in both[5]) == (True, True)
        assert flight.bus.admitted == [4]
        judged = [item for _, item in flight.inputs if isinstance(item, VehicleJoins)]
        assert judged[0] == VehicleJoins(4, FOURTH)
        assert {item.vehicle_id for item in judged[1:]} == {5}, "again now and then: the ring may change"
        received = [item.message for _, item in flight.inputs if isinstance(item, Message)]
        assert {each.sender for each in received if isinstance(each, StartProposal)} == {4}, "no stranger's is counted"
        for _ in range(2):
            flight.stop.request()
        await flight.outcome()

    run_simulated(main())


def test_an_added_vehicle_sends_nothing_before_it_introduces_itself_and_hears_answers_to_that_only() -> None:
    async def main() -> None:
        added = replace(PAIR.with_added(4, FOURTH.start_m), vehicle_id=4)
        flight = FakeFlight(added)
        flight.agent = Agent(replace(flight.parts, mission=MISSION))
        await flight.agent.connect()
        flight.agent.announce()
        await asyncio.sleep(1.0)
        assert flight.bus.payloads("start") == []
        answers = flight.agent.introduce(FOURTH)
        await asyncio.sleep(1.0)
        assert {decode(each).adds for each in flight.bus.payloads("start")} == {FOURTH}  # type: ignore[union-attr]
        for about in (AddedVehicle((9.0, 9.0), 8.0), FOURTH):
            assert answers == {}
            answer = AddedAnswer(4, about, "", 60.0)
            flight.bus.deliver(StartProposal(2, flight.clock.now_s(), None, ready=False, answer=answer))
        assert answers == {2: AddedAnswer(4, FOURTH, "", 60.0)}
        await flight.agent.close()

    run_simulated(main())
