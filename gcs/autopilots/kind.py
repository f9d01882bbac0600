"""The kind of vehicle at the other end of a link: a real one, a board with a simulated body, a simulator, or a stub."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

STUB_UID = 0x5354_5542
"""The upper half of the unique id that cordon's stubs report, "STUB"."""


class VehicleKind(Enum):
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
        return self not in (VehicleKind.FLIGHT, VehicleKind.UNKNOWN)

    @property
    def is_board(self) -> bool:
        """Whether it is hardware with a simulated body: its outputs may be live."""
        return self in (VehicleKind.BOARD, VehicleKind.BOARD_OUTER)


@dataclass(frozen=True, slots=True)
class Evidence:
    """The evidence of a vehicle's kind; None for what it did not report.

    `uid` and `vendor_id` are those of its AUTOPILOT_VERSION, `hil` the flag MAV_MODE_FLAG_HIL_ENABLED of its
    heartbeats, `parameters` those that were asked for.
    """

    system_id: int
    uid: int | None = None
    vendor_id: int | None = None
    hil: bool = False
    parameters: Mapping[str, float | None] = field(default_factory=dict)
