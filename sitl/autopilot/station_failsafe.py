"""ArduCopter's failsafe for a silent ground station: what FS_GCS_ENABLE makes of heartbeats that no longer come.

Source: ArduCopter's `failsafe_gcs_check` and `failsafe_gcs_on_event`. Only the system SYSID_MYGCS counts, and only
once it has been heard.
"""

from collections.abc import Mapping
from enum import Enum
from math import inf
from types import MappingProxyType

from sitl.autopilot.modes import NavMode
from sitl.autopilot.parameters import Parameters

CHECK_PERIOD_S = 1.0 / 3.0
"""ArduCopter looks three times a second: FS_GCS_TIMEOUT is noticed up to that much later."""
DISABLED = 0
ACTIONS: Mapping[int, NavMode] = MappingProxyType({4: NavMode.LAND, 5: NavMode.LAND, 7: NavMode.HOLD})
"""FS_GCS_ENABLE -> the mode; all others return. 7 is BRAKE.

SmartRTL (3, 4), which the stub has not, falls back as ArduCopter's does without a recorded path: to RTL and LAND."""
CONTINUE_LANDING, CONTINUE_PILOT_CONTROL = 1 << 3, 1 << 4
"""Bits of FS_OPTIONS."""
BY_PILOT = frozenset({NavMode.STABILIZED, NavMode.ALTITUDE, NavMode.POSITION, NavMode.HOLD})
"""Modes that ArduCopter does not count as its own: BRAKE is among them."""


class StationEvent(Enum):
    """What a check found to have changed."""

    LOST = "lost"
    REGAINED = "regained"


class StationFailsafe:
    """Notices that the ground station falls silent, and that it is heard again."""

    def __init__(self, parameters: Parameters) -> None:
        """Watch the station that the parameters name, as they stand at each check."""
        self._parameters = parameters
        self._heard_s: float | None = None
        self._lost = False
        self._checked_s = -inf

    def receive_heartbeat(self, time_s: float, system_id: int) -> None:
        """Take a heartbeat that arrived at `time_s`."""
        if system_id == self._parameters["SYSID_MYGCS"]:
            self._heard_s = time_s

    def check(self, time_s: float) -> StationEvent | None:
        """Return what has changed since the last check; nothing where none is due, or the failsafe is off."""
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
