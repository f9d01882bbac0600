"""Flight modes: which may be chosen, which one flies, and what a lost offboard stream does - as tables.

As PX4 does it: a user's choice is an *intention* that outlives a failsafe. That is why offboard resumes by itself
when setpoints come back, and why a vehicle that was landed out of offboard rests in offboard.
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
    def custom_mode(self) -> int:
        """The heartbeat's custom_mode field."""
        main, sub = self.value
        return main << 16 | sub << 24


class ModeEvent(Enum):
    """What changes the intended mode without the user."""

    TAKE_OFF_COMPLETE = "take-off complete"
    DISARMED = "disarmed"


NEEDS_STICKS = frozenset({NavMode.MANUAL, NavMode.ALTITUDE, NavMode.POSITION, NavMode.STABILIZED})
PREVENTS_ARMING = frozenset({NavMode.LAND, NavMode.RETURN})
NOT_RESTED_IN = PREVENTS_ARMING | {NavMode.TAKE_OFF}
"""Modes that a disarmed vehicle leaves for the last other one that was chosen."""

OFFBOARD_LOSS = {
    0: NavMode.POSITION,
    1: NavMode.ALTITUDE,
    2: NavMode.STABILIZED,
    3: NavMode.RETURN,
    4: NavMode.LAND,
    5: NavMode.HOLD,
}
"""COM_OBL_RC_ACT -> the mode flown when setpoints stop; the other values fly as Position, PX4's default."""

_NEXT = {(NavMode.TAKE_OFF, ModeEvent.TAKE_OFF_COMPLETE): NavMode.HOLD}


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a mode may need: a position estimate, and an offboard stream that flows."""

    estimator_ready: bool
    setpoints_flow: bool


def can_run(mode: NavMode, conditions: Conditions) -> bool:
    """Say whether a vehicle without a remote control can fly `mode`."""
    if mode in NEEDS_STICKS:
        return False
    return conditions.estimator_ready and (mode is not NavMode.OFFBOARD or conditions.setpoints_flow)


def can_arm(mode: NavMode, conditions: Conditions) -> bool:
    """Say whether the preflight checks pass in `mode`."""
    return mode not in PREVENTS_ARMING and can_run(mode, conditions)


class Intention:
    """The mode the user wants, and the one to rest in once disarmed."""

    def __init__(self, mode: NavMode = NavMode.HOLD) -> None:
        """Start in a mode, by default as PX4 boots without a remote control: in hold."""
        self.mode = mode
        self._resting = mode

    def request(self, mode: NavMode, *, armed: bool, conditions: Conditions) -> bool:
        """Choose `mode` and say whether that was accepted; disarmed, and for landing, it always is."""
        accepted = not armed or mode is NavMode.LAND or can_run(mode, conditions)
        if accepted:
            self.mode = mode
            if mode not in NOT_RESTED_IN:
                self._resting = mode
        return accepted

    def on_event(self, event: ModeEvent) -> None:
        """Follow what happened."""
        if event is ModeEvent.DISARMED:
            self.mode = self._resting
        else:
            self.mode = _NEXT.get((self.mode, event), self.mode)

    def flown(self, *, armed: bool, conditions: Conditions, offboard_loss_action: int) -> NavMode:
        """Return the mode that flies: the intended one, or while offboard has no setpoints its failsafe."""
        if armed and self.mode is NavMode.OFFBOARD and not conditions.setpoints_flow:
            return OFFBOARD_LOSS.get(offboard_loss_action, NavMode.POSITION)
        return self.mode
