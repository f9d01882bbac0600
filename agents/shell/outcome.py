"""The end of a flight: the operator's request to stop, and the outcome of each agent."""

import asyncio
from dataclasses import dataclass
from enum import Enum


class Ending(Enum):
    """How an agent's flight ended."""

    COMPLETED = "completed"
    STOPPED = "stopped"
    REFUSED = "refused"
    KILLED = "killed"
    PILOT_OVERRIDE = "stood down"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How the flight ended, the reason and the next step if something went wrong, and whether the vehicle flew."""

    ending: Ending
    reason: str = ""
    next_step: str = ""
    flew: bool = False


class Stop:
    """The operator's request to stop: vehicles hold, return and land; at the second request they land at once."""

    def __init__(self) -> None:
        self.wanted = asyncio.Event()
        self.hurried = asyncio.Event()

    def ask(self) -> None:
        """Request the stop, or the landing at once if the stop was requested before."""
        (self.hurried if self.wanted.is_set() else self.wanted).set()


@dataclass(frozen=True, slots=True)
class LoopReport:
    """The ticks of the control loop, done and missed."""

    ticks: int
    missed: int
