"""The differences between the MAVLink dialects of the simulated autopilots."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from estimation.frames import Triple
from sitl.autopilot.modes import NavMode
from sitl.mavlink_constants import Fields, MessageId, Result

LEVEL = (1.0, 0.0, 0.0, 0.0)
"""The attitude of a level vehicle, as a quaternion."""


class EstimatorState(NamedTuple):
    """What the estimator reports: its flags, and its errors relative to the gates of its tests.

    These are the errors of velocity, horizontal position, height and compass; NaN is unknown.
    """

    boot_ms: int
    flags: int
    shares_of_gates: tuple[float, float, float, float]
    accuracy_m: float


class TrueMotion(NamedTuple):
    """The true place in degE7 and millimetres, and the true velocity."""

    place: tuple[int, int, int]
    velocity_ned_m_s: Triple


@dataclass(frozen=True, slots=True)
class Dialect:
    """One autopilot's MAVLink.

    `autopilot` is its MAV_AUTOPILOT, `modes` each mode's number in heartbeats and its two parameters of DO_SET_MODE,
    `rates_hz` the default streams, `streams` the messages of REQUEST_DATA_STREAM by stream, `estimator` the fields
    of the message of the estimator's status, `truth` those of the simulator's message of the true motion. With a
    value in its `hil_parameter` it reports that its body is simulated. If its `origin_may_move` in flight, it is sent
    when it has. If it `corrects_home`, the height of its home follows noisy sensors in the air.
    """

    autopilot: int
    system_id_parameter: str
    firmware_version: int
    capabilities: int
    refused: Result
    modes: Mapping[NavMode, tuple[int, float, float]]
    rates_hz: Mapping[int, float]
    estimator_message: int
    estimator: Callable[[EstimatorState], Fields]
    truth_message: int
    truth: Callable[[TrueMotion], Fields]
    streams: Mapping[int, tuple[MessageId, ...]] = field(default_factory=dict)
    acknowledges_mode_first: bool = False
    tells_checks_in_heartbeat: bool = False
    parameters_bytewise: bool = False
    take_off_from_home: bool = False
    hil_parameter: str = ""
    origin_may_move: bool = False
    corrects_home: bool = False

    def mode_of(self, main: float, sub: float) -> NavMode | None:
        """Return the mode of DO_SET_MODE's second and third parameters, None if there is none."""
        return next((mode for mode, (_, *numbers) in self.modes.items() if tuple(numbers) == (main, sub)), None)


def bounded_i16(value: float) -> int:
    """Return a number as the nearest one of 16 bits."""
    return round(min(max(value, -32768.0), 32767.0))
