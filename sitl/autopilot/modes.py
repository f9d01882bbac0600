"""Flight modes: tables of which may be selected, and the one that the user has selected.

As in PX4, the user's selection is an *intention* that persists during a failsafe. Offboard therefore resumes when
setpoints return, and a vehicle that a failsafe landed from offboard stays in offboard.
"""

from dataclasses import dataclass
from enum import Enum


class NavMode(Enum):
    """A flight mode, with its name in texts."""

    MANUAL = "Manual"
    ALTITUDE = "Altitude"
    POSITION = "Position"
    TAKE_OFF = "Takeoff"
    HOLD = "Hold"
    RETURN = "Return"
    LAND = "Land"
    OFFBOARD = "Offboard"
    STABILIZED = "Stabilized"


class ModeEvent(Enum):
    """Events that change the intended mode without the user."""

    TAKE_OFF_COMPLETE = "take-off complete"
    DISARMED = "disarmed"


NEEDS_STICKS = frozenset({NavMode.MANUAL, NavMode.ALTITUDE, NavMode.POSITION, NavMode.STABILIZED})
NEEDS_GLOBAL_POSITION = frozenset({NavMode.HOLD, NavMode.RETURN})
"""Modes that need a global position: hold is a geodetic position."""
PREVENTS_ARMING = frozenset({NavMode.LAND, NavMode.RETURN})
NOT_RESTED_IN = PREVENTS_ARMING | {NavMode.TAKE_OFF}
"""Modes that a vehicle leaves on disarming, for the last other mode that was selected."""

_NEXT = {(NavMode.TAKE_OFF, ModeEvent.TAKE_OFF_COMPLETE): NavMode.HOLD}


@dataclass(frozen=True, slots=True)
class Conditions:
    """The requirements of modes: a local position estimate, a global one, and an active offboard stream."""

    estimator_ready: bool
    setpoints_flow: bool
    global_position: bool = True


def can_run(mode: NavMode, conditions: Conditions) -> bool:
    """Return whether a vehicle without a remote control can fly `mode`."""
    if mode in NEEDS_STICKS or (mode in NEEDS_GLOBAL_POSITION and not conditions.global_position):
        return False
    return conditions.estimator_ready and (mode is not NavMode.OFFBOARD or conditions.setpoints_flow)


def can_arm(mode: NavMode, conditions: Conditions) -> bool:
    """Return whether the preflight checks pass in `mode`."""
    return mode not in PREVENTS_ARMING and can_run(mode, conditions)


class SelectedMode:
    """The mode that the user has selected, and the mode after disarming."""

    def __init__(self, mode: NavMode) -> None:
        self.mode = mode
        self._resting = mode

    def request(self, mode: NavMode, *, armed: bool, conditions: Conditions) -> bool:
        """Select `mode` and return whether it was accepted; it always is when disarmed and for landing."""
        accepted = not armed or mode is NavMode.LAND or can_run(mode, conditions)
        if accepted:
            self.mode = mode
            if mode not in NOT_RESTED_IN:
                self._resting = mode
        return accepted

    def on_event(self, event: ModeEvent) -> None:
        """Update the intention after an event."""
        if event is ModeEvent.DISARMED:
            self.mode = self._resting
        else:
            self.mode = _NEXT.get((self.mode, event), self.mode)
