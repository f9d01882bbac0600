"""The end of a flight: the operator's request to stop, and the outcome of each agent."""

import asyncio
from dataclasses import dataclass
from enum import Enum

from agents.safety.failsafe import Condition
from agents.safety.landing_cause import LandingCause


class Ending(Enum):
    """How an agent's flight ended."""

    COMPLETED = "completed"
    STOPPED = "stopped"
    """By the operator: the end of the flight, a landing or a return."""
    ABORTED = "aborted"
    BATTERY = "battery"
    FAILSAFE = "failsafe"
    ORPHANED = "orphaned"
    """Its supervisor had ended: it held and landed."""
    REFUSED = "refused"
    KILLED = "killed"
    PILOT_OVERRIDE = "stood down"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a flight ended, the reason and the next step after a fault, and whether the vehicle flew."""

    ending: Ending
    reason: str = ""
    next_step: str = ""
    flew: bool = False


BY_OPERATOR = Outcome(Ending.STOPPED, "the operator ended the flight")
KILLED = Outcome(Ending.KILLED, "an operator had its motors cut", "recover and inspect it")
FAILED = Outcome(Ending.FAILED)
_BATTERY = frozenset(each.value for each in (Condition.BATTERY_LOW, Condition.BATTERY_CRITICAL, Condition.NO_WAY_HOME))


def outcome_of(landing_cause: LandingCause | None) -> Outcome:
    """Return the outcome of a vehicle that landed; None means at the end of its mission."""
    if landing_cause is None:
        return Outcome(Ending.COMPLETED)
    if landing_cause.verb:
        return Outcome(Ending.ABORTED if landing_cause.verb == "abort" else Ending.STOPPED, landing_cause.reason)
    return Outcome(Ending.BATTERY if landing_cause.condition in _BATTERY else Ending.FAILSAFE, landing_cause.reason)


class Stop:
    """The request to stop: vehicles hold, return and land; after a second request they land at once."""

    def __init__(self) -> None:
        self.wanted = asyncio.Event()
        self.hurried = asyncio.Event()
        self.outcome = BY_OPERATOR
        """The outcome of the vehicles that are stopped, from the first request."""

    def ask(self, outcome: Outcome = BY_OPERATOR) -> None:
        """Request the stop, or an immediate landing if the stop was requested before."""
        if not self.wanted.is_set():
            self.outcome = outcome
        (self.hurried if self.wanted.is_set() else self.wanted).set()


@dataclass(frozen=True, slots=True)
class LoopReport:
    """The ticks of the control loop, done and missed."""

    ticks: int
    missed: int
