"""A simulated sensor on a simulated vehicle: it measures the target from the vehicle's true position."""

from collections import deque
from collections.abc import Callable

from msgspec import structs

from agents.ports import TargetSensor
from estimation.state import Sighting

Place = Callable[[float], tuple[float, float] | None]
"""Returns a horizontal position in the mission frame at a time of the mission clock; None if it is unknown."""
KEPT_S = 10.0
"""How long errors of the estimate are kept: no sighting is delayed by more [s of the mission clock]."""


class TrueSensor:
    """Implements `agents.ports.TargetSensor`: the sighting's position has the error of the vehicle's estimate.

    A camera on board measures the target's position relative to the vehicle; the vehicle adds its estimate of its own
    position at that time. Without the truth, as on real vehicles, the sensor measures from the estimate.
    """

    def __init__(self, sensor: TargetSensor, true_m: Place, estimated_m: Place) -> None:
        self._sensor = sensor
        self._true_m = true_m
        self._estimated_m = estimated_m
        self._errors_m: deque[tuple[float, float, float]] = deque()

    def sight(self, now_s: float, position_m: tuple[float, float]) -> Sighting | None:
        """Return a sighting when one is due and the target is within range of the vehicle; it may be a delayed one."""
        true_m, estimated_m = self._true_m(now_s), self._estimated_m(now_s)
        if true_m is None or estimated_m is None:
            true_m = estimated_m = position_m
        self._errors_m.append((now_s, estimated_m[0] - true_m[0], estimated_m[1] - true_m[1]))
        sighting = self._sensor.sight(now_s, true_m)
        while self._errors_m[0][0] < (now_s - KEPT_S if sighting is None else sighting.time_s):
            self._errors_m.popleft()
        if sighting is None:
            return None
        (x, y), (_, off_x, off_y) = sighting.position_m, self._errors_m[0]
        return structs.replace(sighting, position_m=(x + off_x, y + off_y))
