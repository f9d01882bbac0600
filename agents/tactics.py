"""The tactic machine as a table, and the rule by which a vehicle decides to leave the formation."""

from enum import Enum
from math import hypot
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # they import what the command line, which lists verbs, would wait for
    from agents.settings.sections import DecisionSettings
    from estimation.state import TargetEstimate, Vector


class Tactic(Enum):
    """The tactic that a vehicle flies; `value` is its name in messages, logs and tables.

    `FORMATION` and `ENCIRCLE`, the ring, are planned by a user's planner if there is one, the others by cordon.
    `STANDBY` is before the start, `TRANSIT` the way from one ring to another, `EXCITE` an identification flight.
    `ASIDE` holds out of the others' way, `HOLD` in place. `RETURN_AND_LAND` and `LAND` end the flight; in
    `PILOT_OVERRIDE` a pilot flies.
    """

    STANDBY = "standby"
    FORMATION = "formation"
    ENCIRCLE = "encircle"
    EXCITE = "excite"
    ASIDE = "aside"
    HOLD = "hold"
    RETURN_AND_LAND = "return and land"
    LAND = "land"
    PILOT_OVERRIDE = "pilot override"
    TRANSIT = "transit"


DOES_NOT_EVADE = frozenset(each.value for each in (Tactic.STANDBY, Tactic.LAND, Tactic.PILOT_OVERRIDE))
"""A vehicle evades no other: its autopilot or a pilot flies it. In standby that takes off, or hovers until it is taken.
"""
OFF_THE_RING = DOES_NOT_EVADE | {each.value for each in (Tactic.HOLD, Tactic.ASIDE, Tactic.RETURN_AND_LAND)}
"""A vehicle stays where it is, or crosses the ring on its way home."""
NO_TACTIC = "unknown"
"""Stands for the tactic's name where no data of a vehicle is known."""


class Event(Enum):
    """The events that may change a vehicle's tactic."""

    START = "start"
    ENGAGE = "engage"
    EXCITE = "excite"
    STEP_ASIDE = "step aside"
    HOLD = "hold"
    RESUME = "resume"
    END = "end"
    RETURN = "return"
    LAND = "land"
    HANDED_OVER = "handed over"
    CHANGE_RING = "change ring"
    ADOPT = "adopt"
    """It is in the air already: it holds where it is, and comes home."""
    TAKE_OVER = "take over"
    """It is in the air already: it holds where it is, and flies its mission once it is resumed."""

    @classmethod
    def _missing_(cls, value: object) -> "Event | None":
        """Return the event that earlier logs name otherwise."""
        return cls.HANDED_OVER if value == "pilot took over" else None


_ON_PLAN = (Tactic.STANDBY, Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT, Tactic.EXCITE, Tactic.ASIDE)
_ROWS: tuple[tuple[Event, Tactic, tuple[Tactic, ...]], ...] = (
    (Event.START, Tactic.FORMATION, (Tactic.STANDBY,)),
    (Event.ENGAGE, Tactic.ENCIRCLE, (Tactic.FORMATION, Tactic.TRANSIT)),
    # In a mission of several rings: from one to another, or to one that an operator has assigned.
    (Event.CHANGE_RING, Tactic.TRANSIT, (Tactic.FORMATION, Tactic.ENCIRCLE)),
    (Event.STEP_ASIDE, Tactic.ASIDE, (Tactic.FORMATION, Tactic.ENCIRCLE)),
    (Event.STEP_ASIDE, Tactic.HOLD, (Tactic.EXCITE, Tactic.TRANSIT)),
    (Event.HOLD, Tactic.HOLD, (*_ON_PLAN, Tactic.RETURN_AND_LAND)),
    (Event.ADOPT, Tactic.HOLD, (Tactic.STANDBY,)),
    (Event.TAKE_OVER, Tactic.HOLD, (Tactic.STANDBY,)),
    (Event.RESUME, Tactic.FORMATION, (Tactic.ASIDE, Tactic.HOLD, Tactic.PILOT_OVERRIDE)),
    # An identification flight: this event replaces start and resume.
    (Event.EXCITE, Tactic.EXCITE, (Tactic.STANDBY, Tactic.HOLD, Tactic.PILOT_OVERRIDE)),
    (Event.END, Tactic.RETURN_AND_LAND, (*_ON_PLAN, Tactic.HOLD)),
    (Event.RETURN, Tactic.RETURN_AND_LAND, (*_ON_PLAN, Tactic.HOLD)),
    (Event.LAND, Tactic.LAND, (*_ON_PLAN, Tactic.HOLD, Tactic.RETURN_AND_LAND)),
    (Event.HANDED_OVER, Tactic.PILOT_OVERRIDE, (*_ON_PLAN, Tactic.HOLD, Tactic.RETURN_AND_LAND)),
)
"""What each event changes: the tactic after it, and the tactics in which it has this effect."""
TRANSITIONS = {(before, event): after for event, after, tactics in _ROWS for before in tactics}


def next_tactic(tactic: Tactic, event: Event) -> Tactic:
    """Return the tactic after an event; an event that is not listed for a tactic changes nothing."""
    return TRANSITIONS.get((tactic, event), tactic)


def decides_to_encircle(target: "TargetEstimate", position_m: "Vector", thresholds: "DecisionSettings") -> bool:
    """Return whether a vehicle at (2,) engages: important enough, not too dangerous, near enough (paper, section 5)."""
    distance_m = hypot(*(target.mean[:2] - position_m).tolist())
    return (
        target.importance > thresholds.importance_min
        and target.threat < thresholds.threat_max
        and distance_m < thresholds.distance_max_m
    )


def reasons(target: "TargetEstimate", position_m: "Vector", thresholds: "DecisionSettings") -> str:
    """Return the values of that decision with their thresholds, as text."""
    distance_m = hypot(*(target.mean[:2] - position_m).tolist())
    return (
        f"importance {target.importance:.3f} (more than {thresholds.importance_min:g}), "
        f"threat {target.threat:.3f} (less than {thresholds.threat_max:g}), "
        f"target {distance_m:.3f} m away (less than {thresholds.distance_max_m:g} m)"
    )


def mixing_share(since_engaged_s: float, smoothing_time_s: float) -> float:
    """Return the share s of the encirclement setpoint, rising smoothly from 0 to 1 over the smoothing time t_sm."""
    if since_engaged_s >= smoothing_time_s:
        return 1.0
    progress = max(since_engaged_s, 0.0) / smoothing_time_s
    return progress**2 * (3.0 - 2.0 * progress)
