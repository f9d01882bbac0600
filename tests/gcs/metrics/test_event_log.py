"""What happened to a team: told once, by whoever knows it best, and on the mission's clock."""

from collections.abc import Iterable

from agents.notes import Note
from agents.outputs import CoreStatus
from agents.tactics import Tactic
from agents.team.messages import CommandAnswer, MemberState
from gcs.metrics.journal import EventLog, event_line
from gcs.metrics.record import FlightEvent, in_order

START_S = 1_700_000_000.0


def status(
    vehicle_id: int,
    notes: Iterable[Note] = (),
    answers: Iterable[CommandAnswer] = (),
) -> CoreStatus:
    return CoreStatus(
        vehicle_id=vehicle_id,
        time_s=START_S,
        tactic=Tactic.FORMATION,
        notes=tuple(notes),
        answers=tuple(answers),
    )


def peer(sender: int, time_s: float, tactic: str, alert: str = "") -> MemberState:
    here = (0.0, 0.0)
    return MemberState(sender, START_S + time_s, tactic, here, here, here, here, 8.0, 0.1, alert)


def test_the_vehicles_of_this_process_speak_for_themselves() -> None:
    event_log = EventLog()
    note = Note(START_S + 1.0, "command", "hold by keys: holds")
    event_log.note(status(1, [note]), [])
    event_log.note(status(2), [])
    for tactic in ("formation", "hold"):  # what the one hears of the other is known already
        event_log.note(status(2, (), [CommandAnswer(1, START_S, 7, "holds")]), [peer(1, 1.0, tactic)])
    assert event_log.new_events() == [FlightEvent(START_S + 1.0, 1, "command", "hold by keys: holds")]
    assert event_log.new_events() == []


def test_those_elsewhere_are_known_by_what_they_show_and_answer() -> None:
    event_log = EventLog()
    answer = CommandAnswer(3, START_S + 1.5, 7, "holds")
    for heard in (
        peer(3, 1.0, "formation"),
        peer(3, 2.0, "hold", "battery low"),
        peer(3, 1.5, "formation"),  # late
        peer(3, 3.0, "hold"),
    ):
        event_log.note(status(1, (), [answer]), [heard])
    assert [(e.time_s - START_S, e.vehicle, e.kind, e.text) for e in event_log.new_events()] == [
        (1.5, 3, "command", "answers: holds"),
        (2.0, 3, "tactic", "formation -> hold"),
        (2.0, 3, "failsafe", "alert: battery low"),
        (3.0, 3, "failsafe", "alert cleared: battery low"),
    ]
    event_log.note(status(1), [peer(2, 1.0, "hold", "battery low")])
    assert [event.text for event in event_log.new_events()] == ["alert: battery low"], (
        "also of one heard for the first time"
    )


def test_events_are_in_order_by_the_missions_clock() -> None:
    events = [
        FlightEvent(START_S + 2.00049, 1, "tactic", "b"),
        FlightEvent(START_S + 1.0, 2, "tactic", "a"),
        FlightEvent(START_S + 2.0, 1, "tactic", "c"),
        FlightEvent(START_S - 3.0, 1, "tactic", "on the way up"),
        FlightEvent(START_S + 1.0, 1, "tactic", "d"),
    ]
    assert [(e.time_s, e.text) for e in in_order(events, START_S)] == [
        (-3.0, "on the way up"),
        (1.0, "d"),
        (1.0, "a"),
        (2.0, "b"),
        (2.0, "c"),
    ]


def test_an_event_in_one_line() -> None:
    lands = FlightEvent(START_S + 12.34, 2, "command", "lands")
    assert event_line(lands, START_S) == "12.3 s: vehicle 2: lands"
    assert event_line(lands, None) == event_line(lands, START_S + 20.0) == "before the start: vehicle 2: lands"
