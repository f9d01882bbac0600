"""The simulated parts of a mission: each vehicle's sensor of the targets, and the vehicles' imperfections."""

from math import inf

from gcs.mission.mission import Mission
from sitl.reacting_target import FlownTarget, Reaction
from sitl.vehicle.imperfections import EstimatorDriftModel, Imperfections, TelemetryTiming
from sitl.vehicle.shaping import ShapeLimits
from sitl.world import SensorModel, SimulatedSensor, SimulatedSensors

_SEES_NOTHING_M = -1.0


def flown_target(mission: Mission, reaction: Reaction | None) -> FlownTarget | None:
    """Return the target of one simulated flight if it reacts: by `reaction`, or by the mission's `[target.evades]`."""
    evasion = mission.target.evasion
    if reaction is None and evasion is not None:
        reaction = evasion.reaction(mission.target.start_m, mission.mission.rate_hz)
    return None if reaction is None else FlownTarget(reaction, mission.ids)


def target_sensor(
    mission: Mission, vehicle_id: int, start_s: float, seed: int, flown: FlownTarget | None = None
) -> SimulatedSensor | SimulatedSensors:
    """Return the sensor of one vehicle; the targets start at `start_s`.

    It sees the target that is `flown`, or else those of the mission that are simulated.
    """
    sensors = [
        _sensor_of(mission, vehicle_id, number, start_s, seed, flown) for number in range(len(mission.every_target))
    ]
    return sensors[0] if len(sensors) == 1 else SimulatedSensors(sensors)


def _sensor_of(
    mission: Mission, vehicle_id: int, number: int, start_s: float, seed: int, flown: FlownTarget | None
) -> SimulatedSensor:
    """Return a vehicle's sensor of one of the targets."""
    target = mission.every_target[number]
    sensor = mission.sensor(vehicle_id, target)
    model = SensorModel(
        sensor.range_m if flown is not None or target.source == "simulated" else _SEES_NOTHING_M,
        sensor.rate_hz,
        sensor.noise_m,
        target.importance,
        target.threat,
        sensor.outlier_share,
        sensor.outlier_m,
        sensor.delay_s,
        sensor.blind_s,
        target.altitude_m,
        target.name if sensor.names and mission.targets else None,
        target.changes,
    )
    return SimulatedSensor(vehicle_id, model, flown or target.motion, start_s, seed, (number,) if number else ())


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


def only_simulated(mission: Mission) -> list[str]:
    """Return why only `cordon sim` flies a mission; none if other verbs do, too."""
    if mission.target.evades is None:
        return []
    why = "the target reacts to the true positions of all vehicles, which only `cordon sim` and `cordon sweep` know"
    return [f'target.evades: {why}; give the target legs, or source = "external"']
