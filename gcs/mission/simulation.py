"""The simulated parts of a mission: each vehicle's sensor of the target, and the vehicles' imperfections."""

from math import inf

from gcs.mission.mission import Mission
from sitl.vehicle.imperfections import EstimatorDriftModel, Imperfections, TelemetryTiming
from sitl.vehicle.shaping import ShapeLimits
from sitl.world import SensorModel, SimulatedSensor

_SEES_NOTHING_M = -1.0


def target_sensor(mission: Mission, vehicle_id: int, start_s: float, seed: int) -> SimulatedSensor:
    """Return the sensor of one vehicle; the target starts at `start_s`. It sees only simulated targets."""
    target, sensor = mission.target, mission.sensor(vehicle_id)
    model = SensorModel(
        sensor.range_m if target.source == "simulated" else _SEES_NOTHING_M,
        sensor.rate_hz,
        sensor.noise_m,
        target.importance,
        target.threat,
        sensor.outlier_share,
        sensor.outlier_m,
        sensor.delay_s,
        sensor.blind_s,
        target.altitude_m,
    )
    return SimulatedSensor(vehicle_id, model, target.motion, start_s, seed)


def simulated_imperfections(mission: Mission) -> Imperfections:
    """Return the imperfections of the mission's simulated vehicles, without their plants and noise."""
    simulation = mission.simulation
    bounds = simulation.speed_max_m_s, simulation.acceleration_max_m_s2, simulation.jerk_max_m_s3
    bounded = any(bound is not None for bound in bounds)
    rate_hz = simulation.telemetry_rate_hz
    return Imperfections(
        ShapeLimits(*(inf if bound is None else bound for bound in bounds)) if bounded else None,
        simulation.wind_m_s,
        simulation.gusts,
        estimator_drift=EstimatorDriftModel(simulation.wander_m) if simulation.wander_m > 0.0 else None,
        telemetry_timing=None if rate_hz is None else TelemetryTiming(rate_hz),
    )
