"""What an operator is advised about each alert, and how grave the alert is."""

import pytest

from agents.notes import (
    AlertChange,
    CommandOutcome,
    GuardAction,
    NotedEvent,
    Notes,
    ResumeRefusal,
)
from agents.safety.failsafe import Condition
from gcs.console.advice import advice, event_severity, severity

FLIES_ON = {
    "bus flooded",
    "peer's clock stepped",
    "peer's clock drifted",
    "estimator degraded",
    "computer short of memory or disk",
    "leader lost",
    "peer silent",
    "peer doubtful",
    "link degraded",
    "battery warning",
    "gimbal failed",
    "traffic near",
    "status stale",
    "sightings contradict",
    "target from outside only",
    "stiffer than its profile",
    "softer than its profile",
}
"""Those of docs/safety.md about which a vehicle flies on and reports, and does nothing more."""


def test_every_alert_has_a_sentence_of_its_own_severity(subtests: pytest.Subtests) -> None:
    for condition in Condition:
        with subtests.test(alert=condition.value):
            sentence = advice(condition.value)
            assert 10 < len(sentence) <= 65, "it has to fit beside the alert in a line of 80"
            assert sentence != advice("an alert of another version")
            assert severity(condition.value) == ("warning" if condition.value in FLIES_ON else "alarm")


def test_without_an_alert_there_is_nothing_to_do_and_an_unknown_one_is_grave() -> None:
    assert (advice(""), severity("")) == ("", "information")
    assert severity("an alert of another version") == "alarm"
    assert "hold" in advice("an alert of another version")


def test_an_event_is_as_grave_as_what_happened(subtests: pytest.Subtests) -> None:
    low, silent = "battery low", "peer silent"
    rows: tuple[tuple[NotedEvent, str], ...] = (
        (AlertChange(low, "18 %", "return and land"), "alarm"),
        (AlertChange(low, is_over=True), "information"),
        (AlertChange("fence left", is_over=True, waits_for_resume=True), "information"),
        (AlertChange(silent, "vehicle 2", "fly on and report"), "warning"),
        (AlertChange("an alert of another version"), "alarm"),
        (ResumeRefusal("fence left: 1 m outside"), "warning"),
        (CommandOutcome("hold", "pat.here", "holds"), "information"),
        (CommandOutcome("resume", "pat.here", "refused: battery low", is_refused=True), "warning"),
        (CommandOutcome("kill", "pat.here", "cuts the motors"), "warning"),
        (GuardAction(("separation",)), "information"),
    )
    notes = Notes()
    for event, grave in rows:
        with subtests.test(text=event.text):
            notes.add(0.0, event)
            (note,) = notes.drained()
            assert event_severity(note) == grave
            assert note.text == event.text
