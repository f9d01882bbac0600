"""The numbers that cordon reads from an autopilot's messages, and which of their values stand for "unknown".

MAVLink marks an unknown value by a number: -1, 0, 255, 65535 or NaN. MAVSDK 4.1 passes most of these marks on. What
reads such a field asks its row here. Positions and motions have no row: `Telemetry` and `Geodetic` refuse numbers that
are not finite, and the sample is dropped.
"""

from dataclasses import dataclass
from math import inf, isfinite, nan

from gcs.autopilots.registry import AUTOPILOTS


@dataclass(frozen=True, slots=True)
class ReceivedField:
    """A field of one or several messages: its mark for "unknown", and the range of its known values.

    `least` and `most` are in the unit in which cordon receives the field, which is also that of the mark.
    """

    messages: tuple[str, ...]
    name: str
    unknown: float
    least: float = -inf
    most: float = inf

    def known(self, value: object) -> float | None:
        """Return a received value, None if it is unknown: the mark, out of range, or no finite number."""
        if not isinstance(value, int | float) or not isfinite(value):
            return None
        return value if self.least <= value <= self.most and value != self.unknown else None

    def number(self, value: object) -> float:
        """Return a received value, NaN if it is unknown."""
        known = self.known(value)
        return nan if known is None else known


CHARGE = ReceivedField(("BATTERY_STATUS", "SYS_STATUS"), "battery_remaining", -1, 0.0, 100.0)
"""The charge of a battery [%]. MAVSDK takes it from SYS_STATUS until the first BATTERY_STATUS."""
FLIGHT_TIME = ReceivedField(("BATTERY_STATUS",), "time_remaining", 0, 0.0)
"""The time until a battery is empty [s]."""
SATELLITES = ReceivedField(("GPS_RAW_INT",), "satellites_visible", 255, 0)
GPS_HEIGHT_SIGMA = ReceivedField(("GPS_RAW_INT",), "v_acc", 0, 0.0)
"""The standard deviation of a GPS's height [m]."""
BAROMETER_HEIGHT = ReceivedField(("ALTITUDE",), "altitude_monotonic", nan)
CLEARANCE = ReceivedField(("ALTITUDE",), "bottom_clearance", -1, 0.0)
"""The height above the ground [m], negative where nothing measures it."""
ROLL = ReceivedField(("ATTITUDE",), "roll", nan)
PITCH = ReceivedField(("ATTITUDE",), "pitch", nan)
BUFFER_FREE = ReceivedField(("RADIO_STATUS",), "txbuf", 255, 0, 100)
"""The free part of a radio's transmit buffer [%]."""
RATIOS = {
    name: ReceivedField((each.estimator.message,), name, nan, 0.0)
    for each in AUTOPILOTS
    for name in each.estimator.ratios
}
"""The test ratios of each autopilot's estimator, by their fields."""
WINDS = {
    name: ReceivedField((each.estimator.wind,), name, nan)
    for each in AUTOPILOTS
    for name in each.estimator.wind_components
}
"""The components of the wind by each autopilot's estimator."""
PARAMETER = ReceivedField(("PARAM_VALUE",), "param_value", nan)
UNIQUE_ID = ReceivedField(("AUTOPILOT_VERSION",), "uid", 0, 0)
RECEIVED_FIELDS = (
    CHARGE,
    FLIGHT_TIME,
    SATELLITES,
    GPS_HEIGHT_SIGMA,
    BAROMETER_HEIGHT,
    CLEARANCE,
    ROLL,
    PITCH,
    BUFFER_FREE,
    *RATIOS.values(),
    *WINDS.values(),
    PARAMETER,
    UNIQUE_ID,
)
