"""How a flight ended, in a word, and where a vehicle was last. Imports nothing heavy: the supervisor uses it."""

from dataclasses import dataclass
from enum import StrEnum


class FlightEnd(StrEnum):
    """How a flight ended, most severe first; the values stand in logs and in the JSON output."""

    LOST = "lost"
    """Its link was lost after its take-off was requested, and no landing was reported."""
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
    FLIES_ON = "flies on"
    """It joined the flight of others and had not landed when theirs had ended; only their report says so."""

    @classmethod
    def _missing_(cls, _value: object) -> "FlightEnd":
        return cls.UNKNOWN


@dataclass(frozen=True, slots=True)
class LastPosition:
    """A newest position in the mission frame, and its age [wall s]."""

    position_m: tuple[float, float, float]
    age_s: float
