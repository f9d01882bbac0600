"""ArduCopter's failsafe for a silent ground station: the reaction of FS_GCS_ENABLE to missing heartbeats.

Source: ArduCopter's `failsafe_gcs_check` and `failsafe_gcs_on_event`. Only the system SYSID_MYGCS is monitored, from
its first heartbeat on.
"""

from collections.abc import Mapping
from enum import Enum
from math import inf
from types import MappingProxyType

from sitl.autopilot.modes import NavMode
from sitl.autopilot.parameters import Parameters

CHECK_PERIOD_S = 1.0 / 3.0
"""ArduCopter checks three times a second, so FS_GCS_TIMEOUT is detected up to a third of a second late."""
DISABLED = 0
ACTIONS: Mapping[int, NavMode] = MappingProxyType({4: NavMode.LAND, 5: NavMode.LAND, 7: NavMode.HOLD})
"""FS_GCS_ENABLE -> the mode; all other values return. 7 is BRAKE.

SmartRTL (3, 4), which the stub does not have, falls back to RTL and LAND, as ArduCopter's without a recorded path."""
CONTINUE_LANDING, CONTINUE_PILOT_CONTROL = 1 << 3, 1 << 4
"""Bits of FS_OPTIONS."""
BY_PILOT = frozenset({NavMode.STABILIZED, NavMode.ALTITUDE, NavMode.POSITION, NavMode.HOLD})
"""Modes that ArduCopter does not consider autonomous, including BRAKE."""


class StationEvent(Enum):
    """The changes that a check detects."""

    LOST = "lost"
    REGAINED = "regained"


class StationFailsafe:
    """Detects the loss and the return of the ground station's heartbeats."""

    def __init__(self, parameters: Parameters) -> None:
        """Monitor the station of the parameters, with their values at each check."""
        self._parameters = parameters
        self._heard_s: float | None = None
        self._lost = False
        self._checked_s = -inf

    def receive_heartbeat(self, time_s: float, system_id: int) -> None:
        """Take a heartbeat that arrived at `time_s`."""
        if system_id == self._parameters["SYSID_MYGCS"]:
            self._heard_s = time_s

    def check(self, time_s: float) -> StationEvent | None:
        """Return the change since the last check; None if no check is due or the failsafe is off."""
        if time_s < self._checked_s + CHECK_PERIOD_S or self._parameters["FS_GCS_ENABLE"] == DISABLED:
            return None
        self._checked_s = time_s
        if self._heard_s is None:
            return None
        before, self._lost = self._lost, time_s - self._heard_s > self._parameters["FS_GCS_TIMEOUT"]
        if self._lost is before:
            return None
        return StationEvent.LOST if self._lost else StationEvent.REGAINED

    def reaction(self, mode: NavMode) -> NavMode | None:
        """Return the mode that an armed vehicle in the air changes to from `mode`; None if it flies on."""
        options = int(self._parameters["FS_OPTIONS"])
        if mode is NavMode.LAND and options & CONTINUE_LANDING:
            return None
        if mode in BY_PILOT and options & CONTINUE_PILOT_CONTROL:
            return None
        return ACTIONS.get(int(self._parameters["FS_GCS_ENABLE"]), NavMode.RETURN)
