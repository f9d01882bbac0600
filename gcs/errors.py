"""The exit codes that users and scripts rely on, and the error for bad input."""

from collections.abc import Sequence
from enum import IntEnum


class Exit(IntEnum):
    """How a command ended."""

    HOLDS = 0
    """Success; all verdicts hold."""
    VERDICT_FAILED = 1
    """Flown, but a verdict does not hold; or a log is damaged, and its verdicts are not reliable."""
    BAD_INPUT = 2
    """Bad input; every fault is listed."""
    REFUSED = 3
    """Refused before take-off."""
    ENDED_IN_FLIGHT = 4
    """Ended in flight by a failsafe or the operator."""


class InputError(Exception):
    """The user's input is invalid; `faults` holds one line for each fault."""

    def __init__(self, faults: Sequence[str]) -> None:
        self.faults = tuple(" ".join(fault.splitlines()) for fault in faults)
        super().__init__("\n".join(self.faults))
