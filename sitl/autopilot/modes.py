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
    def label(self) -> str:
        """What PX4 calls the mode when it speaks to people."""
        return self.name.replace("TAKE_OFF", "takeoff").capitalize()

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
NEEDS_GLOBAL_POSITION = frozenset({NavMode.HOLD, NavMode.RETURN})
"""Modes that a local position alone does not do for: PX4's hold is a place on the globe."""
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

STICKS_LOSS = {1: NavMode.HOLD, 2: NavMode.RETURN, 3: NavMode.LAND}
"""NAV_RCL_ACT -> the mode flown instead of one that needs sticks; the other values, which stop motors, only sink."""

_NEXT = {(NavMode.TAKE_OFF, ModeEvent.TAKE_OFF_COMPLETE): NavMode.HOLD}


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a mode may need: a local position estimate, a global one, and an offboard stream that flows."""

    estimator_ready: bool
    setpoints_flow: bool
    global_position: bool = True


def can_run(mode: NavMode, conditions: Conditions) -> bool:
    """Say whether a vehicle without a remote control can fly `mode`."""
    if mode in NEEDS_STICKS or (mode in NEEDS_GLOBAL_POSITION and not conditions.global_position):
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

    def flown(
        self, *, armed: bool, conditions: Conditions, offboard_loss_action: int, sticks_loss_action: int
    ) -> NavMode:
        """Return the mode that flies: the intended one, or while offboard has no setpoints its failsafe.

        There are no sticks: a failsafe that would need them is the one for lost sticks (since PX4 1.17; before, it
        sank in Position mode). One that needs to know its place on the globe, and does not, lands.
        """
        if not (armed and self.mode is NavMode.OFFBOARD and not conditions.setpoints_flow):
            return self.mode
        failsafe = OFFBOARD_LOSS.get(offboard_loss_action, NavMode.POSITION)
        if failsafe in NEEDS_STICKS:
            failsafe = STICKS_LOSS.get(sticks_loss_action, failsafe)
        lost = failsafe in NEEDS_GLOBAL_POSITION and not conditions.global_position
        return NavMode.LAND if lost else failsafe
