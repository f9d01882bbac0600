"""The end of a flight: the operator's request to stop, and the outcome of each agent."""

import asyncio
from dataclasses import dataclass

from agents.flight_end import FlightEnd, LastPosition
from agents.outputs import LandingCause
from agents.safety.failsafe import Condition


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a flight ended, the reason and the next step after a fault, and whether the vehicle flew.

    `unaccounted` is set where the vehicle may be anywhere: no landing was reported and no pilot has it, or it fell.
    """

    how: FlightEnd
    reason: str = ""
    next_step: str = ""
    flew: bool = False
    unaccounted: LastPosition | None = None


BY_OPERATOR = Outcome(FlightEnd.OPERATOR, "the operator ended the flight")
KILLED = Outcome(FlightEnd.KILLED, "an operator had its motors cut", "recover and inspect it")
LOST = Outcome(FlightEnd.LOST, "its link was lost, and no landing was reported", "search at its last position")
UNUSED = Outcome(FlightEnd.LANDED, "stayed on the ground in reserve")
FLIES_AGAIN = Outcome(FlightEnd.IN_FLIGHT, "it flies again")
FAILED = Outcome(FlightEnd.ERROR)
_BATTERY = frozenset(each.value for each in (Condition.BATTERY_LOW, Condition.BATTERY_CRITICAL, Condition.NO_WAY_HOME))


def outcome_of(landing_cause: LandingCause | None) -> Outcome:
    """Return the outcome of a vehicle that landed; None means at the end of its mission."""
    if landing_cause is None:
        return Outcome(FlightEnd.LANDED)
    if landing_cause.verb:
        return Outcome(FlightEnd.ABORTED if landing_cause.verb == "abort" else FlightEnd.OPERATOR, landing_cause.reason)
    return Outcome(
        FlightEnd.BATTERY if landing_cause.condition in _BATTERY else FlightEnd.FAILSAFE, landing_cause.reason
    )


class Stop:
    """The request to stop: vehicles hold, return and land; after a second request they land at once."""

    def __init__(self) -> None:
        self.wanted = asyncio.Event()
        self.hurried = asyncio.Event()
        self.outcome = BY_OPERATOR
        """The outcome of the vehicles that are stopped, from the first request."""

    def request(self, outcome: Outcome = BY_OPERATOR) -> None:
        """Request the stop, or an immediate landing if the stop was requested before."""
        if not self.wanted.is_set():
            self.outcome = outcome
        (self.hurried if self.wanted.is_set() else self.wanted).set()
