"""Flight modes: tables of which may be selected, which one is flown, and the failsafes of a lost offboard stream.

As in PX4, the user's selection is an *intention* that persists during a failsafe. Offboard therefore resumes when
setpoints return, and a vehicle that a failsafe landed from offboard stays in offboard.
"""

from dataclasses import dataclass
from enum import Enum


class NavMode(Enum):
    """A flight mode; the value is PX4's (main mode, sub mode) pair."""

    MANUAL = (1, 0)
    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    TAKE_OFF = (4, 2)
    HOLD = (4, 3)
    RETURN = (4, 5)
    LAND = (4, 6)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    @property
    def label(self) -> str:
        """PX4's name of the mode in its texts."""
        return self.name.replace("TAKE_OFF", "takeoff").capitalize()

    @property
    def custom_mode(self) -> int:
        """The heartbeat's custom_mode field."""
        main, sub = self.value
        return main << 16 | sub << 24


class ModeEvent(Enum):
    """Events that change the intended mode without the user."""

    TAKE_OFF_COMPLETE = "take-off complete"
    DISARMED = "disarmed"


NEEDS_STICKS = frozenset({NavMode.MANUAL, NavMode.ALTITUDE, NavMode.POSITION, NavMode.STABILIZED})
NEEDS_GLOBAL_POSITION = frozenset({NavMode.HOLD, NavMode.RETURN})
"""Modes that need a global position: PX4's hold is a geodetic position."""
PREVENTS_ARMING = frozenset({NavMode.LAND, NavMode.RETURN})
NOT_RESTED_IN = PREVENTS_ARMING | {NavMode.TAKE_OFF}
"""Modes that a vehicle leaves on disarming, for the last other mode that was selected."""

OFFBOARD_LOSS = {
    0: NavMode.POSITION,
    1: NavMode.ALTITUDE,
    2: NavMode.STABILIZED,
    3: NavMode.RETURN,
    4: NavMode.LAND,
    5: NavMode.HOLD,
}
"""COM_OBL_RC_ACT -> the mode after setpoints stop; other values are flown as Position, PX4's default."""

STICKS_LOSS = {1: NavMode.HOLD, 2: NavMode.RETURN, 3: NavMode.LAND}
"""NAV_RCL_ACT -> the mode in place of one that needs sticks; other values, which stop motors, descend here."""

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


class Intention:
    """The mode that the user has selected, and the mode after disarming."""

    def __init__(self, mode: NavMode = NavMode.HOLD) -> None:
        """Start in a mode, by default as PX4 boots without a remote control: in hold."""
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

    def flown(
        self, *, armed: bool, conditions: Conditions, offboard_loss_action: int, sticks_loss_action: int
    ) -> NavMode:
        """Return the mode to fly: the intended one, or the failsafe of offboard without setpoints.

        There are no sticks: a failsafe that needs them becomes the one for lost sticks (since PX4 1.17; earlier
        versions descend in Position mode). A failsafe that needs a global position lands without one.
        """
        if not (armed and self.mode is NavMode.OFFBOARD and not conditions.setpoints_flow):
            return self.mode
        failsafe = OFFBOARD_LOSS.get(offboard_loss_action, NavMode.POSITION)
        if failsafe in NEEDS_STICKS:
            failsafe = STICKS_LOSS.get(sticks_loss_action, failsafe)
        lost = failsafe in NEEDS_GLOBAL_POSITION and not conditions.global_position
        return NavMode.LAND if lost else failsafe
