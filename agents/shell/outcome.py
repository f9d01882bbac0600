"""How a flight is ended and how it ended: the operator's wish, and each agent's outcome."""

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
    """How it ended, why and what to do next where something went wrong, and whether the vehicle ever flew."""

    ending: Ending
    reason: str = ""
    next_step: str = ""
    flew: bool = False


class Stop:
    """The operator's wish to end: at first vehicles hold and land, at the second time they land at once."""

    def __init__(self) -> None:
        self.wanted = asyncio.Event()
        self.hurried = asyncio.Event()

    def ask(self) -> None:
        """Ask, or ask again."""
        (self.hurried if self.wanted.is_set() else self.wanted).set()


@dataclass(frozen=True, slots=True)
class LoopReport:
    """How the control loop fared: ticks done and missed."""

    ticks: int
    missed: int
