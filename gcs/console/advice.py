"""The operator's next step for each alert, and its severity: one sentence for each condition of the failsafe table.

The vehicle's own reaction is in that table (`agents/safety/failsafe.py`). Sentences name commands by their verbs.
"""

from typing import Literal, Protocol

from agents.notes import AlertChange, CommandOutcome
from agents.safety.failsafe import TABLE, Condition, Reaction
from agents.team.verbs import VERBS

Severity = Literal["information", "warning", "alarm"]

_ADVICE = {
    Condition.TELEMETRY_STALE: "check its link; if it drifts, fly it by remote control",
    Condition.ESTIMATOR_JUMPED: "check where it is; resume once it hovers steadily",
    Condition.REMOTE_CONTROL_LOST: "restore its remote control, then resume",
    Condition.GROUND_STATION_LOST: "check its link, then resume",
    Condition.PILOT_TOOK_OVER: "ask its pilot before you resume",
    Condition.BATTERY_CRITICAL: "it lands where it is: clear the place below it",
    Condition.BATTERY_LOW: "it returns and lands: clear its landing place",
    Condition.NO_WAY_HOME: "it returns and lands: clear its way and landing place",
    Condition.ESTIMATOR_FAILING: "be ready to fly it by remote control; clear the place below it",
    Condition.NOT_FOLLOWING: "check for damage or wind; land it if it does not hover steadily",
    Condition.TILTED: "check for wind or a failing motor; land it",
    Condition.WINDY: "resume in less wind, or land",
    Condition.FENCE_LEFT: "fly it back by remote control, or let it land outside",
    Condition.ALTITUDE_LEFT: "correct its height by remote control, or land it",
    Condition.TOO_CLOSE: "hold all; land one of the two if they stay close",
    Condition.TARGET_STALE: "find the target; resume once a sensor sees it, or return",
    Condition.TARGET_JUMPED: "check the target's sensors; resume once they agree",
    Condition.PLAN_FAILING: "hold it, then land it",
    Condition.BUS_LOST: "check its computer's network; Ctrl-C in its terminal lands it",
    Condition.PEERS_SILENT: "check its computer's network; Ctrl-C in its terminal lands it",
    Condition.LATE_TICKS: "close other programs on its computer; land it if this persists",
    Condition.BUS_FLOODED: "find the sender that floods the bus, and disconnect it",
    Condition.CLOCK_STEPPED: "synchronise the computers' clocks before the next flight",
    Condition.CLOCK_DRIFTED: "synchronise the computers' clocks before the next flight",
    Condition.ESTIMATOR_DEGRADED: "watch its position; return if it gets worse",
    Condition.LINK_DEGRADED: "move the antenna nearer to it; land it if the link gets worse",
    Condition.COMPUTER_SHORT: "free memory or disk on its computer: the log may end early",
    Condition.LEADER_LOST: "look for the silent vehicle; the next in line leads",
    Condition.PEER_SILENT: "look for the silent vehicle; the others keep clear of it",
    Condition.PEER_DOUBTFUL: "count the vehicles in the air; return if one is not in the team",
    Condition.SIGHTINGS_CONTRADICT: "check the sensors: one reports a wrong target position",
    Condition.TARGET_FROM_OUTSIDE: "look for the target: no vehicle sees it",
    Condition.NO_OPERATOR: "join its network with an operator's keys, then resume",
    Condition.OPERATOR_LOST: "the team returns and lands: clear the landing places",
}
LATE_SHARE = 0.01
"""More late ticks than this share are reported."""
_OF_ALERT = {condition.value: sentence for condition, sentence in _ADVICE.items()}
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
