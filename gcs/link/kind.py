"""The kind of vehicle at the other end of a link: a real one, a board with a simulated body, a simulator, or a stub."""

from dataclasses import dataclass
from enum import Enum

STUB_UID = 0x5354_5542
"""The upper half of the unique id that cordon's stubs report, "STUB"."""
PX4_SITL_UID = 0x4954_414C_4449_4E4F
"""The unique id that PX4's simulator builds report for system id 1; each further system id adds one."""
INNER, OUTER = 2.0, 1.0
"""SYS_HITL of a PX4 board that simulates its body itself, and of one with an external simulator."""


class Kind(Enum):
    """The kind of a vehicle."""

    FLIGHT = "real flight"
    BOARD = "board with a simulated body"
    BOARD_OUTER = "board with an outer simulator"
    SIMULATOR = "simulator in software"
    STUB = "stub"
    UNKNOWN = "unknown"

    @property
    def is_simulated(self) -> bool:
        """Whether it is certain that no real vehicle flies; an unknown kind may fly."""
        return self not in (Kind.FLIGHT, Kind.UNKNOWN)

    @property
    def is_board(self) -> bool:
        """Whether it is hardware with a simulated body: its outputs may be live."""
        return self in (Kind.BOARD, Kind.BOARD_OUTER)


@dataclass(frozen=True, slots=True)
class Evidence:
    """The evidence of a vehicle's kind; None for what it did not report.

    `uid` and `vendor_id` are those of its AUTOPILOT_VERSION, `hil` the flag MAV_MODE_FLAG_HIL_ENABLED of its
    heartbeats, `sys_hitl` PX4's parameter SYS_HITL, `simulates` whether ArduPilot has the parameters of a simulator.
    """

    system_id: int
    uid: int | None = None
    vendor_id: int | None = None
    hil: bool = False
    sys_hitl: float | None = None
    simulates: bool | None = None


def px4_kind(evidence: Evidence) -> Kind:
    """Return the kind of a PX4 vehicle; unknown if its evidence is contradictory."""
    if evidence.uid is None or evidence.sys_hitl is None:
        return Kind.UNKNOWN
    if evidence.hil:
        return {INNER: Kind.BOARD, OUTER: Kind.BOARD_OUTER}.get(evidence.sys_hitl, Kind.UNKNOWN)
    if evidence.sys_hitl != 0.0:
        return Kind.UNKNOWN
    if evidence.uid >> 32 == STUB_UID:
        return Kind.STUB
    return Kind.SIMULATOR if evidence.uid == PX4_SITL_UID + evidence.system_id - 1 else Kind.FLIGHT


def ardupilot_kind(evidence: Evidence) -> Kind:
    """Return the kind of an ArduPilot vehicle; a board that simulates has the USB vendor id of its maker."""
    if evidence.uid is not None and evidence.uid >> 32 == STUB_UID:
        return Kind.STUB
    if evidence.simulates is None or evidence.vendor_id is None:
        return Kind.UNKNOWN
    if not evidence.simulates:
        return Kind.FLIGHT
    return Kind.BOARD if evidence.vendor_id else Kind.SIMULATOR
