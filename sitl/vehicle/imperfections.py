"""What is not ideal about one simulated vehicle beside its plant: one bundle, that a mission or a draw fills."""

from dataclasses import dataclass

from sitl.vehicle.cadence import TelemetryTiming
from sitl.vehicle.shaping import ShapeLimits
from sitl.vehicle.wander import WanderModel

DRAG_PER_S = 0.05
"""Acceleration per speed of the air past the vehicle: 8 m/s of wind push by 0.4 m/s².

A quadrotor of 1.5 to 2 kg has 0.1 to 0.3 1/s of its own, rotors and body together. The plant is the closed position
loop of an autopilot, though, whose velocity loop has an integral part that the plant lacks: what is slow it takes out,
and of gusts about half. What is left is put at a steady share of it, the same for wind and gusts, which is the harder
case for who has to find it out.
"""


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Shaping of the motion; wind [m/s], gusts or none, and drag; a wandering estimator; a cadence of telemetry.

    None is the ideal: no bounds, no wander, one sample at every tick.
    """

    shape: ShapeLimits | None = None
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    gusts: bool = False
    drag_per_s: float = DRAG_PER_S
    wander: WanderModel | None = None
    cadence: TelemetryTiming | None = None


IDEAL = Imperfections()
