"""What an operator is advised about each alert, and how grave the alert is."""

import pytest

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
    "sightings contradict",
    "target from outside only",
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


def test_an_event_is_as_grave_as_what_it_says(subtests: pytest.Subtests) -> None:
    rows = (
        ("failsafe", "battery low: 18 %: return and land", "alarm"),
        ("failsafe", "battery low: cleared", "information"),
        ("failsafe", "fence left: cleared; resume continues the mission", "information"),
        ("failsafe", "peer silent: vehicle 2: fly on and report", "warning"),
        ("failsafe", "resume refused: fence left: 1 m outside", "warning"),
        ("failsafe", "alert: battery low", "alarm"),
        ("failsafe", "alert: peer silent", "warning"),
        ("failsafe", "alert cleared: battery low", "information"),
        ("command", "hold by pat.here: holds", "information"),
        ("command", "resume by pat.here: refused: battery low", "warning"),
        ("command", "answers: refused: it is landing", "warning"),
        ("command", "kill by pat.here: cuts the motors", "warning"),
        ("tactic", "formation -> hold: hold", "information"),
        ("guard", "separation", "information"),
    )
    for kind, text, grave in rows:
        with subtests.test(kind=kind, text=text):
            assert event_severity(kind, text) == grave
