"""The plant family: vehicles of one type, drawn from a seed about the nominal plant.

The bounds are the variations of airframe, payload, tuning and weather that a controller with the nominal plant has to
tolerate.
"""

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np

from estimation.plant.model import Plant, PlantAxis
from sitl.vehicle.imperfections import EstimatorDriftModel, Imperfections, TelemetryTiming
from sitl.vehicle.shaping import ShapeLimits

PARAMETER_SHARE = 0.5
DELAY_MAX_S = 0.4
SPEED_M_S = (2.0, 12.0)
ACCELERATION_M_S2 = (1.0, 5.0)
JERK_M_S3 = 5.0
"""As ArduCopter's PSC_JERK_XY. With much less, a stiff plant oscillates permanently after one large step."""
WIND_MAX_M_S = 8.0
WANDER_M = 0.5
"""Two standard deviations per axis, which contain 19 of 20 samples: the estimate of a PX4 at rest drifts by +-0.5 m."""
WANDER_CORRELATION_S = 20.0
JUMP_M = 1.0
JUMPS_EVERY_S = 600.0
CADENCE_HZ = (10.0, 50.0)
JITTER = 0.3
GAPS_EVERY_S, GAP_S = 20.0, 0.4


@dataclass(frozen=True, slots=True)
class Relative:
    """One vehicle of the family: its true plant and its imperfections."""

    plant: Plant
    imperfections: Imperfections


def blowing(random: np.random.Generator) -> tuple[float, float]:
    """Return a steady wind (x, y) of any direction, up to the family's strongest [m/s]."""
    speed_m_s, course_rad = random.uniform(0.0, WIND_MAX_M_S), random.uniform(0.0, 2.0 * pi)
    return float(speed_m_s * cos(course_rad)), float(speed_m_s * sin(course_rad))


def relative(nominal: Plant, wind_m_s: tuple[float, float], random: np.random.Generator) -> Relative:
    """Return any vehicle of the family, in a wind with gusts."""
    plant = _off(nominal, random)
    speed_m_s, acceleration_m_s2 = (float(random.uniform(*span)) for span in (SPEED_M_S, ACCELERATION_M_S2))
    imperfections = Imperfections(
        ShapeLimits(speed_m_s, acceleration_m_s2, JERK_M_S3),
        wind_m_s,
        gusts=True,
        estimator_drift=EstimatorDriftModel(WANDER_M / 2.0, WANDER_CORRELATION_S, JUMPS_EVERY_S, JUMP_M),
        telemetry_timing=TelemetryTiming(float(random.uniform(*CADENCE_HZ)), JITTER, GAPS_EVERY_S, GAP_S),
    )
    return Relative(plant, imperfections)


def linear_relative(nominal: Plant, wind_m_s: tuple[float, float], random: np.random.Generator) -> Relative:
    """Return a vehicle of the family's linear part: only another plant and a constant wind."""
    return Relative(_off(nominal, random), Imperfections(wind_m_s=wind_m_s))


def _off(nominal: Plant, random: np.random.Generator) -> Plant:
    share = (1.0 - PARAMETER_SHARE, 1.0 + PARAMETER_SHARE)

    def axis(known: PlantAxis) -> PlantAxis:
        a0, a1 = random.uniform(*share, 2).tolist()
        return PlantAxis(known.a0_per_s2 * a0, known.a1_per_s * a1)

    return Plant(axis(nominal.x), axis(nominal.y), round(float(random.uniform(0.0, DELAY_MAX_S)), 2))
