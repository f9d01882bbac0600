"""How a flight ended, in a word. Imports nothing heavy: the supervisor of a flight uses it."""

from enum import StrEnum


class FlightEnd(StrEnum):
    """How a flight ended, most severe first; the values stand in logs and in the JSON output."""

    KILLED = "killed"
    ERROR = "error"
    WATCHDOG = "watchdog"
    """Its supervisor or its process had ended."""
    IN_FLIGHT = "in flight"
    """The log ends there."""
    PILOT = "pilot"
    REFUSED = "refused"
    BATTERY = "battery"
    FAILSAFE = "failsafe"
    UNKNOWN = "unknown"
    """A value that a newer version wrote."""
    ABORTED = "aborted"
    OPERATOR = "operator"
    """By the end of the flight, a landing or a return."""
    LANDED = "landed"
    SIMULATED = "simulated"

    @classmethod
    def _missing_(cls, _value: object) -> "FlightEnd":
        return cls.UNKNOWN
