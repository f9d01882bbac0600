"""The table of an agent's life walked through whole, and what has to hold in it whatever the table says."""

import pytest

from agents.ports import FlightMode, VehicleStatus
from agents.shell.life import TRANSITIONS, Action, LifeEvent, Phase, is_taken_over, next_phase, resumed
from agents.tactics import Tactic
from tests.support.diagrams import life_diagram

E, A = LifeEvent, Action

# One line for each phase, one letter for each event in the order below; '.' changes nothing, a space only separates.
EVENTS = (
    *(E.ADOPT, E.ACCOMPANY),
    *(E.FLY, E.STAND_BY, E.FLY_AGAIN, E.REJOIN),
    *(E.CLOCKS_AGREE, E.CLOCKS_DIFFER),
    *(E.TAKE_OFF_DONE, E.TAKE_OFF_REFUSED, E.SETPOINT_SENT),
    *(E.OFFBOARD_CONFIRMED, E.OFFBOARD_REFUSED),
    *(E.START_AGREED, E.START_REFUSED, E.DURATION_OVER),
    *(E.OPERATOR_STOP, E.OPERATOR_HURRY, E.HOLD_OVER),
    *(E.LAND_DECIDED, E.TAKEN_OVER, E.RESUME),
    *(E.ARMED, E.DISARMED),
    *(E.OFFBOARD_LEFT, E.OFFBOARD_KEPT),
    *(E.LANDED, E.LANDING_REFUSED),
    *(E.KILL, E.MOTORS_CUT, E.KILL_REFUSED),
    *(E.FAULT, E.ABORTED, E.SETPOINTS_LOST),
)
TABLE = {
    Phase.GROUND: "AP cg.. .. ... .. ... ... ... .. .. .. K.. ...",
    Phase.COMPARING_CLOCKS: ".. .... tX ... .. ... q.. ... .. .. .. k.. xx.",
    Phase.TAKE_OFF: ".. .... .. vV. .. ... w.. h.. .. .. .. k.. WW.",
    Phase.HOVERING: ".. .... .. ..o .. ... .q. d.. .. .. .. k.. xx.",
    Phase.ENTERING_OFFBOARD: ".. .... .. ... aX ... .q. d.. .. .. .. k.. xx.",
    Phase.AGREEING_START: ".. .... .. ... .. mX. s.. dp. .. .. .. k.. xxO",
    Phase.FLYING: ".. .... .. ... .. mXR sQr dp. .. .. .. k.. xxO",
    Phase.STOPPING: ".. .... .. ... .. M.. .Qr dp. .. .. .. k.. xxO",
    Phase.PILOT_OVERRIDE: ".. ...y .. ... .. MyY HYY y.b .. .. .. k.. yy.",
    Phase.TAKING_BACK: ".. .... .. ... fp MuU HUU u.. .. .. .. k.. uu.",
    Phase.RETURNING: ".. .... .. ... .. ... .x. xue .. .. .. k.. xxO",
    Phase.CHECKING_ARMED: ".. .... .. ... .. ... ... ... lz .. .. k.. .x.",
    Phase.LEAVING_OFFBOARD: ".. .... .. ... .. ... ... ... .. nN .. K.. .g.",
    Phase.LANDING: ".. .... .. ... .. ... ... ... .. .. zZ K.. .g.",
    Phase.KILLING: ".. .... .. ... .. ... ... ... .. .. .. .DL .g.",
    Phase.ENDED: ".. ..c. .. ... .. ... ... ... .. .. .. i.. ...",
}
# The phase after it, None for the same; and what is done.
LETTERS: dict[str, tuple[Phase | None, tuple[Action, ...]]] = {
    ".": (None, ()),
    "A": (Phase.HOVERING, (A.ADOPT, A.START_CONTROL)),
    "P": (Phase.PILOT_OVERRIDE, (A.ADOPT, A.START_CONTROL, A.HAND_OVER)),
    "c": (Phase.COMPARING_CLOCKS, (A.COMPARE_CLOCKS,)),
    "t": (Phase.TAKE_OFF, (A.TAKE_OFF,)),
    "v": (Phase.HOVERING, (A.START_CONTROL,)),
    "o": (Phase.ENTERING_OFFBOARD, (A.START_OFFBOARD,)),
    "O": (None, (A.START_OFFBOARD,)),
    "a": (Phase.AGREEING_START, (A.AGREE_START,)),
    "m": (Phase.FLYING, (A.START_MISSION,)),
    "M": (None, (A.START_MISSION,)),
    "s": (Phase.STOPPING, (A.HOLD,)),
    "H": (None, (A.HOLD,)),
    "R": (Phase.RETURNING, (A.REPORT_COMPLETED, A.END_MISSION)),
    "r": (Phase.RETURNING, (A.REPORT_STOPPED, A.END_MISSION)),
    "e": (None, (A.END_MISSION,)),
    "p": (Phase.PILOT_OVERRIDE, (A.HAND_OVER,)),
    "b": (Phase.TAKING_BACK, (A.TAKE_BACK,)),
    "f": (Phase.FLYING, ()),
    "x": (Phase.CHECKING_ARMED, (A.CHECK_ARMED,)),
    "X": (Phase.CHECKING_ARMED, (A.REPORT_REFUSAL, A.CHECK_ARMED)),
    "d": (Phase.CHECKING_ARMED, (A.REPORT_LAND_DECISION, A.CHECK_ARMED)),
    "h": (Phase.CHECKING_ARMED, (A.REPORT_LAND_DECISION, A.ABANDON_TAKE_OFF)),
    "q": (Phase.CHECKING_ARMED, (A.REPORT_STOPPED, A.CHECK_ARMED)),
    "Q": (Phase.CHECKING_ARMED, (A.REPORT_STOPPED, A.END_MISSION, A.CHECK_ARMED)),
    "V": (Phase.CHECKING_ARMED, (A.REPORT_REFUSAL, A.ABANDON_TAKE_OFF)),
    "w": (Phase.CHECKING_ARMED, (A.REPORT_STOPPED, A.ABANDON_TAKE_OFF)),
    "W": (Phase.CHECKING_ARMED, (A.ABANDON_TAKE_OFF,)),
    "l": (Phase.LEAVING_OFFBOARD, (A.PREPARE_LANDING, A.STOP_OFFBOARD)),
    "L": (Phase.LEAVING_OFFBOARD, (A.REPORT_REFUSAL, A.STOP_OFFBOARD)),
    "n": (Phase.LANDING, (A.LAND,)),
    "N": (Phase.LANDING, (A.REPORT_REFUSAL, A.LAND)),
    "z": (Phase.ENDED, (A.END_SUPERVISION,)),
    "Z": (Phase.ENDED, (A.REPORT_REFUSAL, A.END_SUPERVISION)),
    "y": (Phase.ENDED, (A.REPORT_OVERRIDE, A.END_SUPERVISION)),
    "Y": (Phase.ENDED, (A.END_MISSION, A.REPORT_OVERRIDE, A.END_SUPERVISION)),
    "u": (Phase.ENDED, (A.HAND_OVER, A.REPORT_OVERRIDE, A.END_SUPERVISION)),
    "U": (Phase.ENDED, (A.HAND_OVER, A.END_MISSION, A.REPORT_OVERRIDE, A.END_SUPERVISION)),
    "k": (Phase.KILLING, (A.CUT_MOTORS, A.PREPARE_LANDING)),
    "K": (Phase.KILLING, (A.CUT_MOTORS,)),
    "D": (Phase.ENDED, (A.REPORT_KILLED, A.END_SUPERVISION)),
    "i": (None, (A.CUT_MOTORS,)),
    "g": (Phase.ENDED, ()),
}

MAY_BE_IN_THE_AIR = set(Phase) - {Phase.GROUND, Phase.COMPARING_CLOCKS, Phase.ENDED}
SENDS = {A.TAKE_OFF, A.START_OFFBOARD, A.TAKE_BACK, A.STOP_OFFBOARD, A.LAND, A.HAND_OVER}


def walks(phase: Phase, *without: LifeEvent) -> tuple[set[Phase], set[Action]]:
    """Return all phases that can follow one, and all that can be done on the way, if some events never come."""
    seen, actions, open_ends = {phase}, set[Action](), [phase]
    while open_ends:
        before = open_ends.pop()
        for event in set(LifeEvent) - set(without):
            after, done = next_phase(before, event)
            actions.update(done)
            if after not in seen:
                seen.add(after)
                open_ends.append(after)
    return seen, actions


def test_the_table_here_knows_every_phase_and_every_event() -> None:
    assert set(TABLE) == set(Phase)
    assert len(EVENTS) == len(set(EVENTS)) == len(LifeEvent)


def test_every_event_in_every_phase() -> None:
    for phase, letters in TABLE.items():
        for event, letter in zip(EVENTS, letters.replace(" ", ""), strict=True):
            after, actions = LETTERS[letter]
            assert next_phase(phase, event) == (after or phase, actions), (phase, event)


def test_every_phase_can_be_reached_and_every_action_is_done_somewhere() -> None:
    phases, actions = walks(Phase.GROUND)
    assert (phases, actions) == (set(Phase), set(Action))


@pytest.mark.parametrize("event", [E.LAND_DECIDED, E.KILL, E.OPERATOR_HURRY, E.FAULT, E.ABORTED])
def test_no_way_to_the_end_leaves_a_vehicle_in_the_air_to_itself(event: LifeEvent) -> None:
    # Where the landing or the kill itself is broken off, the supervisor must not be told that it is over.
    for phase in MAY_BE_IN_THE_AIR:
        after, actions = next_phase(phase, event)
        if after is not Phase.ENDED:
            continue
        handed_over = A.REPORT_OVERRIDE in actions and (phase is Phase.PILOT_OVERRIDE or A.HAND_OVER in actions)
        assert handed_over or A.END_SUPERVISION not in actions, (phase, event)


def test_only_a_command_leads_from_pilot_override_towards_offboard() -> None:
    _, actions = walks(Phase.PILOT_OVERRIDE, E.RESUME, E.FLY_AGAIN)
    assert not actions & {A.TAKE_BACK, A.START_OFFBOARD, A.TAKE_OFF}
    phases, actions = walks(Phase.PILOT_OVERRIDE, E.RESUME, E.KILL, E.FLY_AGAIN)
    assert phases == {Phase.PILOT_OVERRIDE, Phase.ENDED}
    assert not actions & {A.LAND, A.STOP_OFFBOARD}
    assert [phase for phase in Phase if next_phase(phase, E.FLY_AGAIN)[0] is not phase] == [Phase.ENDED]
    assert next_phase(Phase.PILOT_OVERRIDE, E.RESUME) == (Phase.TAKING_BACK, (A.TAKE_BACK,))


def test_nothing_is_sent_after_a_kill_but_where_the_vehicle_refuses_it() -> None:
    for phase in set(Phase) - {Phase.KILLING}:
        after, actions = next_phase(phase, E.KILL)
        assert actions[0] is A.CUT_MOTORS
        assert not set(actions) & SENDS
        assert after in (Phase.KILLING, Phase.ENDED)
    _, done = walks(Phase.KILLING, E.KILL_REFUSED, E.FLY_AGAIN)
    assert not done & SENDS


def test_the_diagram_shows_every_transition_and_no_other() -> None:
    shown: set[tuple[str, str, str]] = set()
    for line in life_diagram().splitlines()[1:]:
        before, arrow, rest = line.strip().partition(" --> ")
        if arrow and "[*]" not in line:
            after, _, events = rest.partition(": ")
            shown |= {(before, event, after) for event in events.split(", ")}
    assert shown == {
        (before.name.lower(), event.value, after.name.lower()) for (before, event), (after, _) in TRANSITIONS.items()
    }


@pytest.mark.parametrize(
    ("connected", "armed", "mode", "taken"),
    [
        (True, True, FlightMode.OFFBOARD, False),
        (True, True, FlightMode.UNKNOWN, False),
        (True, True, FlightMode.HOLD, True),
        (True, True, FlightMode.OTHER, True),
        (True, False, FlightMode.OFFBOARD, True),
        (False, True, FlightMode.HOLD, False),
    ],
)
def test_when_a_pilot_has_taken_over(connected: bool, armed: bool, mode: FlightMode, taken: bool) -> None:
    assert is_taken_over(VehicleStatus(connected=connected, armed=armed, mode=mode)) is taken


def test_a_core_has_resumed_only_where_the_agent_is_out_of_its_mission() -> None:
    back = {phase: {tactic for tactic in Tactic if resumed(phase, tactic)} for phase in Phase}
    assert back.pop(Phase.PILOT_OVERRIDE) == set(Tactic) - {Tactic.PILOT_OVERRIDE, Tactic.LAND}
    assert back.pop(Phase.RETURNING) == {Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT, Tactic.EXCITE}
    assert not any(back.values())
