"""What an operator's client takes in: the clocks of the mission's vehicles, and answers on their own keys."""

from collections.abc import Callable, Mapping
from functools import partial

import pytest
from msgspec.structs import replace

from agents.team.codec import decode, encode
from agents.team.messages import (
    MISSION_RING,
    TIME_MAX_S,
    BusMessage,
    CommandAnswer,
    CommandedRing,
    CommandKey,
    MemberState,
    OperatorCommand,
    RingChoice,
    RingValues,
    StartProposal,
    VehicleReport,
)
from agents.team.participant import Participant
from gcs.console.command_client import CommandClient, TeamClock, _Sent
from gcs.errors import InputError
from gcs.keys.identity import Identity
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.preflight.mission import commanded_ring_bounds, ring_change_faults
from tests.support.mission_text import INSECURE
from tests.support.several_rings import HIGH, NORTH, SOUTH, with_rings


def clock(times_s: dict[int, float], received_s: float = 10.0) -> TeamClock:
    team = TeamClock()
    for vehicle_id, time_s in times_s.items():
        team.receive(vehicle_id, time_s, received_s)
    return team


@pytest.mark.parametrize("wrong_s", [0.0, 9e11])
def test_one_wrong_clock_changes_nothing(wrong_s: float) -> None:
    assert clock({}).now_s(10.0) is None
    assert clock({1: 500.0, 2: wrong_s, 3: 500.1}).now_s(10.25) == pytest.approx(500.25, abs=0.11)


def test_no_vehicle_makes_a_command_malformed_by_its_clock() -> None:
    team = clock({1: TIME_MAX_S, 2: 500.0})
    assert team.times_s(12.0) == ((1, TIME_MAX_S), (2, 502.0))
    for alone in (team, clock({1: TIME_MAX_S})):
        time_s = alone.now_s(12.0)
        assert time_s is not None
        command = OperatorCommand(time_s, "kill", None, "anna", 7, None, alone.times_s(12.0))
        assert decode(encode(command)) == command


def test_clocks_go_on_between_messages_and_those_of_silent_vehicles_do_not_count() -> None:
    team = clock({1: 500.0, 2: 500.0})
    team.receive(3, 620.0, 70.0)  # two fell silent a minute ago, and this one flies at twice the speed
    assert team.now_s(70.5) == 620.5
    assert team.members == {1, 2, 3}


def test_answers_to_its_own_commands_count_and_clocks(mission_file: Callable[..., str]) -> None:
    client = CommandClient(load_mission(mission_file("case2", INSECURE)), Identity(Participant("operator", "pat")))
    here = (0.0, 0.0)
    told: list[tuple[int, str]] = []
    key = CommandKey("pat", "kill", 7)
    sent = client._sent[key] = _Sent(0.0, lambda vehicle, answer: told.append((vehicle, answer.did)))
    for number, verb, origin in ((8, "kill", "pat"), (7, "hold", "pat"), (7, "kill", "eve")):
        client._receive(CommandAnswer(3, 100.0, number, "motors cut", verb, origin))  # type: ignore[arg-type]
    assert sent.answers == {}
    for _ in range(2):  # answers are repeated
        client._receive(CommandAnswer(3, 100.0, 7, "motors cut", "kill", "pat"))
    client._receive(MemberState(3, 100.0, "hold", here, here, here, here))
    assert sent.answers[3].did == "motors cut"
    assert told == [(3, "motors cut")]
    assert client._clocks.members == {3}
    assert client.tactics == {3: "hold"}


class ScriptedBus:
    """Answers each transmission of a command with the next messages of a script."""

    def __init__(self, *script: tuple[BusMessage, ...]) -> None:
        self._script = iter(script)

    async def open(self, on_message: Callable[[BusMessage], None], *_: object) -> None:
        self._on_message = on_message

    async def close(self) -> None:
        """Leave the bus."""

    def publish(self, *_: object) -> None:
        for message in next(self._script, ()):
            self._on_message(message)


@pytest.mark.parametrize(("repeated", "did"), [(True, "motors cut"), (False, "cuts the motors")])
async def test_the_end_of_a_flight_that_arrives_before_the_answer_to_the_kill_does_not_hide_it(
    mission_file: Callable[..., str], repeated: bool, did: str
) -> None:
    """The two are sent on topics of their own, between which there is no order."""
    client = CommandClient(load_mission(mission_file("case2", INSECURE)), Identity(Participant("operator", "pat")))
    begun = CommandAnswer(3, 100.0, 7, "cuts the motors", "kill", "pat", "begun")
    cut = CommandAnswer(3, 100.1, 7, "motors cut", "kill", "pat", "obeyed")
    ended = VehicleReport(3, 100.1, "hold", ended="killed")
    client._bus = ScriptedBus((begun, ended), (cut, begun) if repeated else ())  # type: ignore[assignment]
    answers = await client.command("kill", (3,), 3, number=7)
    assert answers[3] is not None
    assert answers[3].did == did


async def test_a_vehicle_in_reserve_is_known_as_such_until_it_flies(mission_file: Callable[..., str]) -> None:
    client = CommandClient(load_mission(mission_file("case2", INSECURE)), Identity(Participant("operator", "pat")))
    waits = VehicleReport(3, 100.0, "hold", ended="landed: in reserve", in_reserve=True)
    client._bus = ScriptedBus((CommandAnswer(2, 100.0, 7, "holds", "hold", "pat", "obeyed"), waits))  # type: ignore[assignment]
    await client.command("hold", (2, 3), None, number=7)
    assert client.in_reserve == {3}
    client._receive(VehicleReport(3, 101.0, "offboard"))
    assert client.in_reserve == set()


class RingingBus(ScriptedBus):
    """Sends states of vehicles, each with the commanded ring that it has, and the vehicles' answers to commands."""

    def __init__(self, mission: Mission, rings: Mapping[int, CommandedRing | RingChoice | None]) -> None:
        super().__init__()
        self._mission, self._rings = mission, rings
        self.sent: list[OperatorCommand] = []

    async def open(self, on_message: Callable[[BusMessage], None], *_: object) -> None:
        await super().open(on_message)
        here = (0.0, 0.0)
        for vehicle_id, ring in self._rings.items():
            on_message(StartProposal(vehicle_id, 100.0, 0.0, mission=self._mission.identity))
            state = MemberState(vehicle_id, 100.0, "encircle", here, here, here, here)
            name = "choice" if isinstance(ring, RingChoice) else "ring"
            on_message(replace(state, **{name: ring}))

    def publish(self, *sent: object) -> None:
        _, payload = sent
        assert isinstance(payload, bytes)
        command = decode(payload)
        assert isinstance(command, OperatorCommand)
        self.sent.append(command)
        for each in self._rings:
            self._on_message(CommandAnswer(each, 100.0, command.number, "changes", command.verb, "pat", "obeyed"))


SLOW, FAST = CommandedRing(None, 0.0, 0.05, 90.0), CommandedRing(None, 0.0, 0.2, 95.0)
WIDE, NARROW = CommandedRing(14.0, 90.0), CommandedRing(8.0, 95.0)


@pytest.mark.parametrize(
    ("rings", "values", "is_sent"),
    [
        # 0.8 of 3 m/s less the target's 0.1 m/s leave 2.3 m/s along the ring. The mission's: 10 m at 0.05 rad/s.
        ({1: None, 2: None, 3: None}, RingValues(None, 0.2), True),
        ({1: WIDE, 2: WIDE, 3: WIDE}, RingValues(None, 0.2), False),
        ({1: WIDE, 2: None, 3: None}, RingValues(None, 0.2), False),
        ({1: WIDE, 2: NARROW, 3: WIDE}, RingValues(None, 0.2), True),
        ({1: WIDE, 2: WIDE, 3: WIDE}, RingValues(10.0, 0.2), True),
        ({1: None, 2: None, 3: None}, RingValues(None, 0.25), False),
        ({1: NARROW, 2: NARROW, 3: NARROW}, RingValues(None, 0.25), True),
        ({1: None, 2: None, 3: None}, RingValues(14.0, None), True),
        ({1: FAST, 2: SLOW, 3: SLOW}, RingValues(14.0, None), False),
    ],
)
async def test_a_value_of_the_ring_alone_is_checked_with_the_ring_that_was_commanded_before(
    mission_file: Callable[..., str], rings: dict[int, CommandedRing | None], values: RingValues, is_sent: bool
) -> None:
    mission = load_mission(mission_file("case2", INSECURE))
    client = CommandClient(mission, Identity(Participant("operator", "pat")))
    bus = RingingBus(mission, rings)
    client._bus = bus  # type: ignore[assignment]
    command = client.command(
        "ring", mission.ids, None, values, ring_faults=partial(ring_change_faults, mission, values)
    )
    if is_sent:
        answers = await command
        assert [each is not None and each.did for each in answers.values()] == ["changes"] * 3
        assert {each.ring for each in bus.sent} == {values}
    else:
        with pytest.raises(InputError, match="m/s"):
            await command
        assert bus.sent == []


ALL_MISSION, SOUTH_FAST = (MISSION_RING,) * 3, (MISSION_RING, FAST, MISSION_RING)
SOUTH_NARROW, HIGH_WIDE = (MISSION_RING, NARROW, MISSION_RING), (MISSION_RING, MISSION_RING, WIDE)


@pytest.mark.parametrize(
    ("rings", "number", "values", "is_sent"),
    [
        # 2.4 m/s about the target at rest, 2.3 m/s about the other. South: 14 m at 0.06 rad/s; high: 8 m at -0.1 rad/s.
        ((), SOUTH, RingValues(None, 0.17), True),
        ((), SOUTH, RingValues(None, 0.18), False),
        (SOUTH_NARROW, SOUTH, RingValues(None, 0.18), True),
        (HIGH_WIDE, SOUTH, RingValues(None, 0.17), True),
        (HIGH_WIDE, HIGH, RingValues(None, -0.18), False),
        (ALL_MISSION, HIGH, RingValues(None, -0.29), True),
        (SOUTH_FAST, SOUTH, RingValues(13.0), False),
        (SOUTH_FAST, SOUTH, RingValues(11.0), True),
        (SOUTH_FAST, HIGH, RingValues(13.0), True),
        ((FAST,), HIGH, RingValues(13.0), True),
        (ALL_MISSION, NORTH, RingValues(10.0, 0.235), False),
        (ALL_MISSION, SOUTH, RingValues(10.0, 0.235), True),
    ],
)
async def test_a_value_of_one_of_several_rings_is_checked_with_that_ring(
    mission_file: Callable[..., str],
    rings: tuple[CommandedRing, ...],
    number: int,
    values: RingValues,
    is_sent: bool,
) -> None:
    mission = with_rings(load_mission(mission_file("case2", INSECURE)))
    client = CommandClient(mission, Identity(Participant("operator", "pat")))
    bus = RingingBus(mission, {1: RingChoice(0, b"", rings), 2: RingChoice(None), 3: None})
    client._bus = bus  # type: ignore[assignment]
    faults = partial(ring_change_faults, mission, values, ring=number)
    command = client.command("ring", mission.ids, None, values, ring_faults=faults, ring_number=number)
    if is_sent:
        await command
        assert {(each.ring, each.ring_number, each.vehicle) for each in bus.sent} == {(values, number, None)}
    else:
        with pytest.raises(InputError, match=rf"rings\[{number}\].* rad/s|ring {mission.rings[number].name}: .* m/s"):
            await command
        assert bus.sent == []


def test_a_ring_has_room_for_the_vehicles_that_it_has_places_for(mission_file: Callable[..., str]) -> None:
    mission = with_rings(load_mission(mission_file("case2")))
    assert commanded_ring_bounds(mission, SOUTH).radius_min_m == pytest.approx(3.0 / 2.0), "two are opposite each other"


@pytest.mark.parametrize("number", [HIGH, None])
async def test_one_vehicle_is_assigned_to_a_ring_by_its_number(
    mission_file: Callable[..., str], number: int | None
) -> None:
    mission = with_rings(load_mission(mission_file("case2", INSECURE)))
    client = CommandClient(mission, Identity(Participant("operator", "pat")))
    bus = RingingBus(mission, dict.fromkeys(mission.ids))
    client._bus = bus  # type: ignore[assignment]
    answers = await client.command("assign", (3,), 3, ring_number=number)
    assert {(each.verb, each.vehicle, each.ring_number, each.ring) for each in bus.sent} == {
        ("assign", 3, number, None)
    }
    assert [each is not None and each.did for each in answers.values()] == ["changes"]
