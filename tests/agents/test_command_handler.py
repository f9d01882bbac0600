"""Operators' commands: each acts once and is answered every time, and whatever is said, an abort ends on the ground."""

from collections.abc import Callable
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.command_handler import COMMANDS_KEPT, IN_FLIGHT, UNCHANGED, Circumstances, CommandHandler, Reshaping
from agents.core import VehicleCore
from agents.inputs import Command, Message, TimeScale
from agents.notes import Notes
from agents.settings.config import AgentConfig
from agents.settings.sections import ExcitationSettings
from agents.settings.shapes import Shape
from agents.tactics import Event, Tactic, next_tactic
from agents.team.codec import decode, encode
from agents.team.messages import (
    DID_LIMIT,
    MISSION_RING,
    RINGS_MAX,
    CommandAnswer,
    CommandedRing,
    Goal,
    MemberState,
    OperatorCommand,
    RingValues,
)
from agents.team.verbs import VERBS, Verb
from estimation.state import Telemetry

HOVER_S = 5.0
CUTTING, CUT = VERBS["kill"].did, VERBS["kill"].done
Maker = Callable[..., AgentConfig]


class Vehicle:
    """CommandHandler, and the tactic machine that they steer."""

    def __init__(self, tactic: Tactic = Tactic.FORMATION) -> None:
        self.notes = Notes()
        self.commands = CommandHandler(2, HOVER_S, ("line", "wedge"), self.notes)
        self.tactic = tactic
        self.now_s = 0.0
        self._number = 0

    def told(self, verb: Verb, vehicle: int | None = None, number: int | None = None) -> str:
        """Take a command, of a new number unless that is given, and return its answer."""
        self._number += number is None
        command = OperatorCommand(self.now_s, verb, vehicle, "pat@here", self._number if number is None else number)
        self._apply(self.commands.take(command, self.tactic, self.now_s).event)
        answers = self.commands.answers(self.now_s)
        assert len(answers) <= 1
        self.outcome = answers[0].outcome if answers else None
        return answers[0].did if answers else ""

    def tick(self, now_s: float) -> None:
        self.now_s = now_s
        self._apply(self.commands.due(self.tactic, now_s))

    def does(self, tactic: Tactic) -> bool:
        return self.tactic is tactic

    def _apply(self, event: Event | None) -> None:
        if event is not None:
            self.tactic = next_tactic(self.tactic, event)


def test_on_the_ground_a_vehicle_that_lacks_nothing_is_started_once() -> None:
    vehicle = Vehicle(Tactic.STANDBY)
    assert vehicle.told("start") == "did not wait for its start"
    assert not vehicle.commands.starts
    vehicle.commands.start_blockers = "GPS: no fix"
    assert vehicle.told("start") == "refused: GPS: no fix"
    vehicle.commands.start_blockers = ""
    for verb in ("hold", "resume", "land", "rtl", "abort"):
        assert vehicle.told(verb) == "refused: it waits on the ground for its start"
    assert (vehicle.tactic, vehicle.commands.starts) == (Tactic.STANDBY, False)
    assert (vehicle.told("start", number=90), vehicle.told("start", number=90)) == ("takes off", "takes off")
    assert vehicle.commands.starts
    assert vehicle.told("start") == "was started already"
    assert vehicle.told("hold") == "holds"


@given(tactic=st.sampled_from(Tactic), verb=st.sampled_from(get_args(Verb)))
def test_whatever_the_tactic_every_command_is_answered_and_obeyed_or_refused(tactic: Tactic, verb: Verb) -> None:
    vehicle = Vehicle(tactic)
    did = vehicle.told(verb)
    assert 0 < len(did) <= DID_LIMIT
    answer = CommandAnswer(2, 0.0, 1, did, verb, "pat", vehicle.outcome)
    assert decode(encode(answer)) == answer
    assert answer.is_obeyed is not did.startswith("refused: ")
    assert answer.is_final is (verb != "kill")
    if not answer.is_obeyed:
        assert vehicle.tactic is tactic


def test_no_two_verbs_share_a_key_or_a_place_on_the_page() -> None:
    places = [place for row in VERBS.values() for place in (row.key, row.button) if place]
    assert len(set(places)) == len(places)


def reshaping(shape: Shape | None, told_s: float = 1.0, number: int = 7) -> OperatorCommand:
    return OperatorCommand(told_s, "formation", None, "pat@here", number, shape)


@pytest.mark.parametrize(
    ("shape", "tactic", "did"),
    [
        ("wedge", Tactic.FORMATION, "takes its place in the shape 'wedge'"),
        ("wedge", Tactic.ENCIRCLE, "will take its place, once in formation, in the shape 'wedge'"),
        ("free", Tactic.FORMATION, "refused: the mission's formation cannot be 'free' (shapes: line, wedge)"),
        (None, Tactic.FORMATION, "refused: the mission's formation cannot be 'None' (shapes: line, wedge)"),
    ],
)
def test_a_change_of_formation_is_taken_or_refused(shape: Shape | None, tactic: Tactic, did: str) -> None:
    orders = Vehicle().commands
    assert orders.take(reshaping(shape), tactic, 1.0) == UNCHANGED
    (answer,) = orders.answers(1.0)
    assert answer.did == did
    assert orders.reshaping == (Reshaping(1.0, "wedge") if answer.is_obeyed else None)


RINGS = ("north", "south", "high")


def handler(*rings: str) -> CommandHandler:
    return CommandHandler(2, HOVER_S, ("line", "wedge"), Notes(), rings)


def answer_to(
    commands: CommandHandler,
    command: OperatorCommand,
    tactic: Tactic = Tactic.ENCIRCLE,
    circumstances: Circumstances = IN_FLIGHT,
) -> str:
    assert commands.take(command, tactic, 1.0, circumstances).event is None, "the tactic stays"
    (answer,) = commands.answers(1.0)
    assert answer.is_obeyed is not answer.did.startswith("refused: ")
    return answer.did


def changing(number: int | None, told_s: float = 1.0, number_of_command: int = 7) -> OperatorCommand:
    values = RingValues(15.0, -0.1)
    return OperatorCommand(told_s, "ring", None, "pat@here", number_of_command, ring=values, ring_number=number)


def assigning(number: int | None, told_s: float = 1.0, command: int = 7, vehicle: int | None = 2) -> OperatorCommand:
    return OperatorCommand(told_s, "assign", vehicle, "pat@here", command, ring_number=number)


def test_each_ring_keeps_the_values_that_were_commanded_of_it() -> None:
    commands, wanted = handler(*RINGS), CommandedRing(15.0, 1.0, -0.1, 1.0)
    assert answer_to(commands, changing(1)) == "changes the ring 'south' to 15 m, -0.1 rad/s"
    assert commands.commanded_rings == [MISSION_RING, wanted, MISSION_RING]
    assert answer_to(commands, changing(None, number_of_command=8)) == "changes the ring 'north' to 15 m, -0.1 rad/s"
    assert commands.commanded_rings == [wanted, wanted, MISSION_RING]
    assert "no ring of number 3 (rings: north, south, high)" in answer_to(commands, changing(3, number_of_command=9))
    assert commands.commanded_rings == [wanted, wanted, MISSION_RING]
    only = handler()
    assert answer_to(only, changing(None)) == "changes to a ring of 15 m, -0.1 rad/s"
    assert "no ring of number 1" in answer_to(only, changing(1, 2.0, 8))
    assert only.commanded_rings == [wanted]


def looking(place: Goal | None, told_s: float, number: int, vehicle: int | None = 2) -> OperatorCommand:
    return OperatorCommand(told_s, "look", vehicle, "pat@here", number, place=place)


def test_a_camera_looks_where_the_newest_command_says() -> None:
    commands, there = CommandHandler(2, HOVER_S, ("line", "wedge"), Notes(), has_gimbal=True), Goal(30.0, -5.0)
    assert answer_to(commands, looking(there, 5.0, 1), Tactic.LAND) == "looks at x 30.0 m, y -5.0 m"
    assert "newer command" in answer_to(commands, looking(None, 4.0, 2)), "of another operator, received late"
    assert "handed it over" in answer_to(commands, looking(None, 6.0, 3), Tactic.PILOT_OVERRIDE)
    assert commands.looks_at == there
    assert answer_to(commands, looking(None, 7.0, 4)) == "looks at the target"
    assert commands.looks_at is None
    assert answer_to(handler(), looking(there, 5.0, 1)) == "refused: it has no gimbal"
    assert answer_to(handler(), looking(there, 5.0, 1, None)) == "has no gimbal to point", "the others have one"


@pytest.mark.parametrize(
    ("tactic", "follows", "did"),
    [
        (Tactic.ENCIRCLE, True, "goes to the ring 'high'"),
        (Tactic.ENCIRCLE, False, "will go, once on its mission, to the ring 'high'"),
        (Tactic.FORMATION, True, "goes to the ring 'high'"),
        (Tactic.HOLD, True, "will go, once on its mission, to the ring 'high'"),
        (Tactic.PILOT_OVERRIDE, False, "will go, once on its mission, to the ring 'high'"),
        (Tactic.RETURN_AND_LAND, True, "refused: it is on its way to land"),
        (Tactic.LAND, True, "refused: it is landing"),
    ],
)
def test_a_vehicle_is_assigned_to_a_ring_unless_it_lands(tactic: Tactic, follows: bool, did: str) -> None:
    commands = handler(*RINGS)
    assert answer_to(commands, assigning(2), tactic, Circumstances(follows=follows)) == did
    assert commands.assigned == (None if did.startswith("refused") else 2)


def test_a_vehicle_that_is_on_its_assigned_ring_already_says_so() -> None:
    commands, on = handler(*RINGS), Circumstances(ring=1)
    assert (
        answer_to(commands, assigning(1, 5.0, 1), circumstances=on) == "is on the ring 'south' already, and stays there"
    )
    assert commands.assigned == 1, "it would choose another ring later without that"
    assert answer_to(commands, assigning(2, 6.0, 2), circumstances=on).startswith("goes to the ring")


def test_what_assigns_nothing_is_refused_and_the_newest_assignment_applies() -> None:
    commands = handler(*RINGS)
    assert answer_to(commands, assigning(1, 5.0, 1)) == "goes to the ring 'south'"
    assert "each vehicle" in answer_to(commands, assigning(0, 6.0, 2, None))
    assert "no ring of number 3" in answer_to(commands, assigning(3, 6.0, 3))
    assert "no ring of number 7" in answer_to(commands, assigning(RINGS_MAX - 1, 6.0, 4))
    assert "mission is over" in answer_to(commands, assigning(0, 6.0, 5), circumstances=Circumstances(is_over=True))
    assert "newer command" in answer_to(commands, assigning(0, 4.0, 6)), "of another operator, received late"
    assert commands.assigned == 1
    assert answer_to(commands, assigning(None, 7.0, 7)) == "chooses its ring by itself"
    assert commands.assigned is None
    assert "newer command" in answer_to(commands, assigning(0, 6.5, 8)), "the choice was given back later"
    assert commands.assigned is None
    assert "one ring" in answer_to(handler(), assigning(0))
    assert commands.take(assigning(0, 9.0, 9, 3), Tactic.ENCIRCLE, 9.0) == UNCHANGED
    assert (commands.answers(9.0), commands.assigned) == ((), None), "it was for another vehicle"


def test_repeats_act_once_and_are_answered_again() -> None:
    vehicle = Vehicle()
    assert vehicle.told("hold", number=7) == "holds"
    assert vehicle.told("resume", number=8) == "resumes its mission"
    assert vehicle.told("hold", number=7) == "holds"  # a straggler: said before the resume
    assert vehicle.tactic is Tactic.FORMATION
    assert [note.text for note in vehicle.notes.drained()] == [
        "hold by pat@here: holds",
        "resume by pat@here: resumes its mission",
    ]


def test_a_repeated_abort_is_no_second_one() -> None:
    vehicle = Vehicle()
    for tenth in range(20):
        vehicle.tick(tenth / 10.0)
        vehicle.told("abort", number=7)
    assert vehicle.does(Tactic.HOLD)
    assert vehicle.told("abort", number=8) == "lands"
    assert vehicle.does(Tactic.LAND)


def test_a_command_for_another_vehicle_is_not_answered() -> None:
    vehicle = Vehicle()
    assert vehicle.told("land", vehicle=3) == ""
    assert vehicle.tactic is Tactic.FORMATION


@pytest.mark.parametrize(("verb", "after"), [("resume", Tactic.FORMATION), ("rtl", Tactic.RETURN_AND_LAND)])
def test_who_says_where_to_go_on_ends_an_abort(verb: Verb, after: Tactic) -> None:
    vehicle = Vehicle()
    vehicle.told("abort")
    vehicle.told(verb)
    vehicle.tick(100.0)
    assert vehicle.tactic is after
    assert vehicle.told("abort") == "holds, lands in 5 s unless resumed", "the first of a new pair"


def test_a_pilot_who_takes_an_aborted_vehicle_has_it() -> None:
    vehicle = Vehicle()
    vehicle.told("abort")
    vehicle.tactic = Tactic.PILOT_OVERRIDE
    vehicle.tick(100.0)
    assert [note.text.partition(":")[0] for note in vehicle.notes.drained()] == ["abort by pat@here"]
    assert vehicle.told("resume") == "resumes its mission"
    vehicle.tick(200.0)
    assert vehicle.tactic is Tactic.FORMATION, "what came before is over"


_STEPS = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(["hold", "abort", "land"]), st.integers(0, 5)),
        st.tuples(st.just("wait"), st.integers(1, 20)),
    ),
    max_size=20,
)


@given(
    before=st.sampled_from([Tactic.STANDBY, Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.RETURN_AND_LAND]), steps=_STEPS
)
def test_whatever_follows_an_abort_but_a_resume_or_return_it_is_landing_in_time(
    before: Tactic, steps: list[tuple[str, int]]
) -> None:
    vehicle = Vehicle(before)
    vehicle.told("abort", number=1000)
    for verb, number in steps:
        if verb == "wait":
            vehicle.tick(vehicle.now_s + number / 10.0)
        else:
            vehicle.told(verb, number=number)  # type: ignore[arg-type]
        assert vehicle.tactic in (Tactic.HOLD, Tactic.LAND)
    vehicle.tick(max(vehicle.now_s, HOVER_S))
    assert vehicle.does(Tactic.LAND)


def test_a_kill_is_answered_when_it_begins_and_when_it_is_done() -> None:
    vehicle = Vehicle()
    did = vehicle.told("kill", number=7)
    assert (did, vehicle.outcome, vehicle.commands.kills) == (CUTTING, "begun", True)
    vehicle.commands.on_killed("", 0.4)
    assert not vehicle.commands.kills
    assert [(a.number, a.did, a.outcome) for a in vehicle.commands.answers(0.5)] == [(7, CUT, "obeyed")]
    assert vehicle.told("kill", number=7) == CUT, "a repeat kills nobody again"
    assert not vehicle.commands.kills
    assert vehicle.told("kill", number=8) == CUTTING


def test_all_operators_of_a_kill_receive_why_it_failed() -> None:
    vehicle = Vehicle()
    vehicle.told("kill", number=7)
    vehicle.told("kill", number=8)
    vehicle.commands.on_killed("vehicle 2 did not even acknowledge it", 9.0)
    answers = vehicle.commands.answers(9.0)
    assert {a.number: a.did for a in answers} == dict.fromkeys((7, 8), "refused: vehicle 2 did not even acknowledge it")
    assert {a.outcome for a in answers} == {"refused"}


def test_a_resume_that_a_failsafe_refuses_says_why_and_ends_no_abort() -> None:
    vehicle = Vehicle()
    vehicle.told("abort")
    resume = OperatorCommand(0.0, "resume", None, "pat@here", 1000)
    refused = Circumstances(resume_refused="battery low: 20 %")
    assert vehicle.commands.take(resume, vehicle.tactic, 0.0, refused) == UNCHANGED
    assert vehicle.commands.answers(0.0)[0].did == "refused: battery low: 20 %"
    vehicle.tick(HOVER_S)
    assert vehicle.tactic is Tactic.LAND


def test_no_operator_keeps_a_command_of_another_from_the_vehicle() -> None:
    """Another operator sends hold with the numbers that a kill is to have, before it and as often as it may."""
    vehicle = Vehicle()
    for number in range(40):
        vehicle.commands.take(OperatorCommand(0.0, "hold", None, "eve", number), vehicle.tactic, 0.0)
    vehicle.commands.answers(0.0)
    vehicle.commands.take(OperatorCommand(0.0, "kill", None, "anna", 7), vehicle.tactic, 0.0)
    assert vehicle.commands.kills
    assert [(each.origin, each.verb, each.did) for each in vehicle.commands.answers(0.0)] == [("anna", "kill", CUTTING)]


@pytest.mark.parametrize("off_s", [-60.0, 60.0])
@pytest.mark.parametrize("verb", ["hold", "kill"])
def test_a_command_is_dated_by_the_clock_of_its_recipient(make_config: Maker, verb: Verb, off_s: float) -> None:
    """The other vehicle's clock is off, and the team's is the lower of the two."""
    core = VehicleCore(make_config(vehicle_id=2))
    command = OperatorCommand(100.0 + off_s, verb, None, "anna", 7, None, ((1, 100.0 + off_s), (2, 100.0)))
    core.take(Message(100.1, command))
    (answer,) = (decode(each.payload) for each in core.tick(100.1).messages)
    assert isinstance(answer, CommandAnswer)
    assert (answer.is_obeyed, answer.key) == (True, command.key), answer


@pytest.mark.parametrize("off_s", [-60.0, 60.0])
def test_a_kill_that_was_misdated_acts_once_it_is_repeated_with_the_right_date(
    make_config: Maker, off_s: float
) -> None:
    core = VehicleCore(make_config(vehicle_id=2))
    for sent_s, outcome in ((100.0 + off_s, "misdated"), (100.2, "begun")):
        core.take(Message(100.2, OperatorCommand(sent_s, "kill", None, "anna", 7)))
        (answer,) = (decode(each.payload) for each in core.tick(100.2).messages)
        assert isinstance(answer, CommandAnswer)
        assert answer.outcome == outcome
    assert core.commands.kills


def test_what_is_remembered_is_bounded() -> None:
    vehicle = Vehicle()
    for number in range(COMMANDS_KEPT + 50):
        command = OperatorCommand(0.0, "hold", None, "pat@here", number)
        vehicle.commands.take(command, vehicle.tactic, 0.0)
    assert len(vehicle.commands.answers(0.0)) == COMMANDS_KEPT


def test_a_core_answers_in_its_next_tick_even_without_telemetry(make_config: Maker) -> None:
    core = VehicleCore(make_config(vehicle_id=2))
    core.take(Message(1.0, OperatorCommand(1.0, "kill", 2, "pat@here", 7)))
    assert core.commands.kills
    output = core.tick(1.1)
    assert [decode(each.payload) for each in output.messages] == [
        CommandAnswer(2, 1.1, 7, CUTTING, "kill", "pat@here", "begun")
    ]
    assert ("command", f"kill by pat@here: {CUTTING}") in [(note.kind, note.text) for note in output.status.notes]
    assert core.tick(1.2).messages == ()


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_a_late_command_is_refused_unless_it_stops_a_flight_or_lands_gently(
    make_config: Maker, verb: Verb, speed: float
) -> None:
    """At a speed of 4 the mission's clock shows 10 s of a delay of 2.5 s."""
    for delay_s, late in ((1.5, False), (2.5, verb not in {"hold", "land", "abort"})):
        core = VehicleCore(make_config(vehicle_id=2))
        core.take(TimeScale(speed))
        core.take(Message(20.0, OperatorCommand(20.0 - speed * delay_s, verb, 2, "pat@here", 7)))
        (answer,) = (decode(each.payload) for each in core.tick(20.1).messages)
        assert isinstance(answer, CommandAnswer)
        assert ("s old" in answer.did) is late
        if late:
            assert (answer.outcome, answer.is_refused, answer.is_final) == ("misdated", True, False)
        elif verb == "hold":
            assert answer.outcome in {"obeyed", "begun"}


def test_a_core_that_hovers_for_an_abort_lands_though_it_lost_its_telemetry(make_config: Maker) -> None:
    core = VehicleCore(make_config(vehicle_id=2, safety={"abort_hover_s": 2.0}))
    core.take(Command(1.0, OperatorCommand(1.0, "abort", None, "pat@here", 7)))
    assert [core.tick(now_s).status.tactic for now_s in (2.9, 3.0)] == [Tactic.HOLD, Tactic.LAND]


def told_shape(core: VehicleCore, now_s: float) -> tuple[str | None, float]:
    """What it tells its peers of the formation's shape."""
    core.take(Telemetry(now_s, (0.0, 0.0, 8.0), (0.0, 0.0, 0.0)))
    (state,) = (m for m in (decode(o.payload) for o in core.tick(now_s).messages) if isinstance(m, MemberState))
    return state.shape, state.shaped_s


def test_the_newest_shape_spreads_from_vehicle_to_vehicle(make_config: Maker) -> None:
    def heard(shape: Shape, told_s: float, now_s: float) -> MemberState:
        place = (0.0, 5.0)
        return MemberState(1, now_s, "formation", place, (0.0, 0.0), place, (0.0, 0.0), 8.0, 0.0, "", shape, told_s)

    core = VehicleCore(make_config(vehicle_id=2))
    assert told_shape(core, 1.0) == (None, 0.0)
    core.take(Message(2.0, reshaping("wedge", 2.0)))
    assert told_shape(core, 2.0) == ("wedge", 2.0)
    core.take(Message(2.1, heard("column", 1.5, 2.1)))  # older: whoever says so has not heard the newer one yet
    assert told_shape(core, 2.1) == ("wedge", 2.0)
    core.take(Message(2.2, heard("column", 2.1, 2.2)))
    assert told_shape(core, 2.2) == ("column", 2.1)
    core.take(Message(2.3, heard("free", 2.2, 2.3)))  # its mission has none
    assert told_shape(core, 2.3) == ("column", 2.1)
    core.take(Message(2.4, reshaping("wedge", 2.0)))  # a straggler of the first command
    assert told_shape(core, 2.4) == ("column", 2.1)


def test_an_identification_flight_has_no_shapes(make_config: Maker) -> None:
    core = VehicleCore(make_config(vehicle_id=2, excitation=ExcitationSettings()))
    core.take(Message(1.0, reshaping("wedge")))
    assert told_shape(core, 1.0) == (None, 0.0)


def test_a_core_shows_what_its_peers_answered(make_config: Maker) -> None:
    core = VehicleCore(make_config(vehicle_id=2))
    answer = CommandAnswer(3, 1.0, 7, "holds")
    core.take(Message(1.0, answer))
    assert core.tick(1.0).status.answers == (answer,)
    assert core.tick(1.1).status.answers == ()
