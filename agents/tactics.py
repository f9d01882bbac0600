"""The tactic machine as a table, and the rule by which a vehicle decides to leave the formation."""

from enum import Enum
from math import hypot

from agents.settings.sections import DecisionSettings
from estimation.state import TargetEstimate, Vector


class Tactic(Enum):
    """The tactic that a vehicle flies."""

    STANDBY = "standby"
    FORMATION = "formation"
    ENCIRCLE = "encircle"
    EXCITE = "excite"
    ASIDE = "aside"
    HOLD = "hold"
    RETURN_AND_LAND = "return and land"
    LAND = "land"
    PILOT_OVERRIDE = "pilot override"


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
    PILOT_TOOK_OVER = "pilot took over"


TRANSITIONS: dict[tuple[Tactic, Event], Tactic] = {
    (Tactic.STANDBY, Event.START): Tactic.FORMATION,
    (Tactic.STANDBY, Event.HOLD): Tactic.HOLD,
    (Tactic.STANDBY, Event.LAND): Tactic.LAND,
    (Tactic.FORMATION, Event.ENGAGE): Tactic.ENCIRCLE,
    (Tactic.FORMATION, Event.HOLD): Tactic.HOLD,
    (Tactic.FORMATION, Event.LAND): Tactic.LAND,
    (Tactic.ENCIRCLE, Event.HOLD): Tactic.HOLD,
    (Tactic.ENCIRCLE, Event.LAND): Tactic.LAND,
    (Tactic.FORMATION, Event.STEP_ASIDE): Tactic.ASIDE,
    (Tactic.ENCIRCLE, Event.STEP_ASIDE): Tactic.ASIDE,
    (Tactic.ASIDE, Event.HOLD): Tactic.HOLD,
    (Tactic.ASIDE, Event.RESUME): Tactic.FORMATION,
    (Tactic.ASIDE, Event.LAND): Tactic.LAND,
    (Tactic.HOLD, Event.RESUME): Tactic.FORMATION,
    (Tactic.HOLD, Event.LAND): Tactic.LAND,
    (Tactic.STANDBY, Event.END): Tactic.RETURN_AND_LAND,
    (Tactic.FORMATION, Event.END): Tactic.RETURN_AND_LAND,
    (Tactic.ENCIRCLE, Event.END): Tactic.RETURN_AND_LAND,
    (Tactic.HOLD, Event.END): Tactic.RETURN_AND_LAND,
    (Tactic.ASIDE, Event.END): Tactic.RETURN_AND_LAND,
    (Tactic.STANDBY, Event.RETURN): Tactic.RETURN_AND_LAND,
    (Tactic.FORMATION, Event.RETURN): Tactic.RETURN_AND_LAND,
    (Tactic.ENCIRCLE, Event.RETURN): Tactic.RETURN_AND_LAND,
    (Tactic.ASIDE, Event.RETURN): Tactic.RETURN_AND_LAND,
    (Tactic.HOLD, Event.RETURN): Tactic.RETURN_AND_LAND,
    (Tactic.RETURN_AND_LAND, Event.HOLD): Tactic.HOLD,
    (Tactic.RETURN_AND_LAND, Event.LAND): Tactic.LAND,
    (Tactic.RETURN_AND_LAND, Event.PILOT_TOOK_OVER): Tactic.PILOT_OVERRIDE,
    (Tactic.STANDBY, Event.PILOT_TOOK_OVER): Tactic.PILOT_OVERRIDE,
    (Tactic.FORMATION, Event.PILOT_TOOK_OVER): Tactic.PILOT_OVERRIDE,
    (Tactic.ENCIRCLE, Event.PILOT_TOOK_OVER): Tactic.PILOT_OVERRIDE,
    (Tactic.ASIDE, Event.PILOT_TOOK_OVER): Tactic.PILOT_OVERRIDE,
    (Tactic.HOLD, Event.PILOT_TOOK_OVER): Tactic.PILOT_OVERRIDE,
    (Tactic.PILOT_OVERRIDE, Event.RESUME): Tactic.FORMATION,
    # An identification flight: this event replaces start and resume.
    (Tactic.STANDBY, Event.EXCITE): Tactic.EXCITE,
    (Tactic.HOLD, Event.EXCITE): Tactic.EXCITE,
    (Tactic.PILOT_OVERRIDE, Event.EXCITE): Tactic.EXCITE,
    (Tactic.EXCITE, Event.HOLD): Tactic.HOLD,
    (Tactic.EXCITE, Event.STEP_ASIDE): Tactic.HOLD,
    (Tactic.EXCITE, Event.LAND): Tactic.LAND,
    (Tactic.EXCITE, Event.END): Tactic.RETURN_AND_LAND,
    (Tactic.EXCITE, Event.RETURN): Tactic.RETURN_AND_LAND,
    (Tactic.EXCITE, Event.PILOT_TOOK_OVER): Tactic.PILOT_OVERRIDE,
}


def next_tactic(tactic: Tactic, event: Event) -> Tactic:
    """Return the tactic after an event; an event that is not listed for a tactic changes nothing."""
    return TRANSITIONS.get((tactic, event), tactic)


def decides_to_encircle(target: TargetEstimate, position_m: Vector, thresholds: DecisionSettings) -> bool:
    """Return whether a vehicle at (2,) engages: important enough, not too dangerous, near enough (paper, section 5)."""
    distance_m = hypot(*(target.mean[:2] - position_m).tolist())
    return (
        target.importance > thresholds.importance_min
        and target.threat < thresholds.threat_max
        and distance_m < thresholds.distance_max_m
    )


def reasons(target: TargetEstimate, position_m: Vector, thresholds: DecisionSettings) -> str:
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
