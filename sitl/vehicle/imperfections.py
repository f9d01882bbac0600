"""The imperfections of one simulated vehicle besides its plant; a mission or a random draw sets them."""

from dataclasses import dataclass

from sitl.vehicle.estimator_drift import EstimatorDriftModel
from sitl.vehicle.shaping import ShapeLimits
from sitl.vehicle.telemetry_schedule import TelemetryTiming

DRAG_PER_S = 0.05
"""Acceleration per airspeed: a wind of 8 m/s causes 0.4 m/s².

The rotors and body of a quadrotor of 1.5 to 2 kg cause 0.1 to 0.3 1/s. But the plant is the closed position loop of an
autopilot, whose velocity loop has an integrator that the plant does not model: it removes slow disturbances and about
half of the gusts. The remainder is modelled as one share for wind and gusts, the harder case for an observer.
"""


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Limits of the motion's shaping, wind [m/s], gusts, drag, drift of the estimator, timing of the telemetry.

    None is ideal: no limits, no drift, one sample per tick.
    """

    shape: ShapeLimits | None = None
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    gusts: bool = False
    drag_per_s: float = DRAG_PER_S
    estimator_drift: EstimatorDriftModel | None = None
    telemetry_timing: TelemetryTiming | None = None


IDEAL = Imperfections()
