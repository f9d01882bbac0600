"""The operator's next step for each alert, and its severity, by the failsafe table (`agents/safety/failsafe.py`)."""

from typing import Literal, Protocol

from agents.notes import AlertChange, CommandOutcome
from agents.safety.failsafe import TABLE, Reaction
from agents.team.verbs import VERBS

Severity = Literal["information", "warning", "alarm"]

LATE_SHARE = 0.01
"""More late ticks than this share are reported."""
_OF_ALERT = {row.condition.value: row.advice for row in TABLE}
_DANGEROUS = frozenset(name for name, row in VERBS.items() if row.is_dangerous)
_OTHER = "watch it; hold or land it if in doubt"
_WARNINGS = frozenset(row.condition.value for row in TABLE if row.reactions == (Reaction.DEGRADE,))


def advice(alert: str) -> str:
    """Return the next step for an alert as vehicles send it; empty for an empty one."""
    return _OF_ALERT.get(alert, _OTHER) if alert else ""


def severity(alert: str) -> Severity:
    """Return an alert's severity: an alarm if the vehicle leaves its mission for it, or if the alert is unknown."""
    if not alert:
        return "information"
    return "warning" if alert in _WARNINGS else "alarm"


class VehicleEvent(Protocol):
    """A note of a vehicle or an event of a flight (`agents.notes.Note`, `gcs.metrics.record.FlightEvent`)."""

    @property
    def kind(self) -> str:
        """Its kind."""

    @property
    def alert(self) -> AlertChange | None:
        """The alert that begins or ends with it."""

    @property
    def command(self) -> CommandOutcome | None:
        """The command whose outcome it is."""


def event_severity(event: VehicleEvent) -> Severity:
    """Return the severity of an event.

    An alert has the severity of its condition. The end of an alert is information, and so are all other events but a
    dangerous command and a refusal, which are warnings.
    """
    if event.command is not None:
        return "warning" if event.command.is_refused or event.command.verb in _DANGEROUS else "information"
    if event.alert is not None:
        return "information" if event.alert.is_over else severity(event.alert.condition)
    return "warning" if event.kind == "failsafe" else "information"


def late_ticks(missed: int, ticks: int, *, below_speed: float | None) -> str:
    """Return how many ticks were late, and what to do; empty for few. `below_speed`: a lower speed is possible."""
    if missed <= LATE_SHARE * ticks:
        return ""
    advised = (
        "close other programs, or fly fewer vehicles" if below_speed is None else f"use a --speed below {below_speed:g}"
    )
    return f"{missed} of {missed + ticks} ticks were late: {advised}"
