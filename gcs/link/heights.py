"""The height of a vehicle, compared with what its barometer, rangefinder and GPS measure."""

from math import copysign, hypot, isfinite

BAROMETER, RANGEFINDER, GPS = "barometer", "rangefinder", "GPS"
HEIGHT_OFF_STEP_M = 0.5
"""Smaller changes of a height's offset from a sensor's are not reported: they are noise."""
SIGMAS = 3.0
"""A sensor explains an offset up to this multiple of its standard deviation: the wander of GPS heights is bounded by a
multiple of the accuracy that receivers state (github.com/ArduPilot/ardupilot, issue 2022). The remainder is that of the
height itself, whose tolerances are those of a barometer's drift.
"""
GPS_SIGMA_M = 3.0
"""Of the height from a GPS that states none. Common receivers state 1 m to 3 m below an open sky."""


class HeightComparison:
    """The offsets of a vehicle's height from those of its sensors, since it stood on the ground.

    Only changes count: sensors differ by many metres in what they call zero, and GPS heights by metres from day to day.
    """

    def __init__(self) -> None:
        self._ground_m: float | None = None
        self._stood: dict[str, tuple[float, float]] = {}
        self._offsets_m: dict[str, float] = {}

    def take(self, sensor: str, height_m: float, sensed_m: float, sigma_m: float = 0.0, *, flies: bool) -> None:
        """Take a vehicle's height above the mission's origin and a sensor's [m], not finite if it measures none.

        A rangefinder's is that above the ground. Less than the height may be a tree or a roof, and more a slope.
        """
        if not flies or self._ground_m is None:
            self._ground_m = height_m
        is_range = sensor == RANGEFINDER
        if not isfinite(sensed_m) or (is_range and sensed_m >= (height_m - self._ground_m) / 2.0):
            self._offsets_m.pop(sensor, None)
            return
        if not flies or is_range or sensor not in self._stood:
            self._stood[sensor] = self._ground_m if is_range else height_m - sensed_m, sigma_m
        stood_m, stood_sigma_m = self._stood[sensor]
        off_m = height_m - sensed_m - stood_m
        steps = round(max(abs(off_m) - SIGMAS * hypot(sigma_m, stood_sigma_m), 0.0) / HEIGHT_OFF_STEP_M)
        self._offsets_m[sensor] = copysign(steps * HEIGHT_OFF_STEP_M, off_m) + 0.0  # no -0.0

    @property
    def worst(self) -> tuple[float | None, str]:
        """The largest offset that its sensor does not explain [m], in steps, and the sensor; None without sensors."""
        sensor = max(self._offsets_m, key=lambda each: abs(self._offsets_m[each]), default="")
        return self._offsets_m.get(sensor), sensor
