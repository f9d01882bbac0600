"""From a mission to the parts that fly it: what simulation and flight have in common."""

from math import inf

from gcs.mission import Mission
from gcs.result import FormationReference, RingReference, VerdictTolerances
from sitl.cadence import CadenceModel
from sitl.nature import Nature
from sitl.shaping import ShapeLimits
from sitl.wander import WanderModel
from sitl.world import SensorModel, SimulatedSensor

_SEES_NOTHING_M = -1.0


def target_sensor(mission: Mission, vehicle_id: int, start_s: float, seed: int) -> SimulatedSensor:
    """Return the sensor of one vehicle; the target sets out at `start_s`. One that others see no sensor here sees."""
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


def simulated_nature(mission: Mission) -> Nature:
    """Return what is not ideal about the mission's simulated vehicles, beside their plants and noise."""
    simulation = mission.simulation
    bounds = simulation.speed_max_m_s, simulation.acceleration_max_m_s2, simulation.jerk_max_m_s3
    bounded = any(bound is not None for bound in bounds)
    rate_hz = simulation.telemetry_rate_hz
    return Nature(
        ShapeLimits(*(inf if bound is None else bound for bound in bounds)) if bounded else None,
        simulation.wind_m_s,
        simulation.gusts,
        wander=WanderModel(simulation.wander_m) if simulation.wander_m > 0.0 else None,
        cadence=None if rate_hz is None else CadenceModel(rate_hz),
    )


def ring_reference(mission: Mission) -> RingReference:
    """Return the ring the mission asks for."""
    return RingReference(mission.encirclement.radius_m, mission.encirclement.angular_rate_rad_s)


def formation_reference(mission: Mission) -> FormationReference:
    """Return the formation the mission asks for, vehicles in line order."""
    formation = mission.formation
    offsets = mission.agent_config(mission.vehicles[0]).slot_offset_m
    slots = {vehicle_id: offsets(vehicle_id, formation.leader) for vehicle_id in mission.ids}
    return FormationReference(formation.speed_m_s, slots)


def verdict_tolerances(mission: Mission) -> VerdictTolerances:
    """Return by what the mission's flight is judged."""
    verdicts = mission.verdicts
    return VerdictTolerances(
        radius_error_rms_m=verdicts.radius_error_rms_m,
        angular_rate_error_rad_s=verdicts.angular_rate_error_rad_s,
        spacing_error_rms_deg=verdicts.spacing_error_rms_deg,
        formation_speed_error_rms_m_s=verdicts.formation_speed_error_rms_m_s,
        formation_spacing_error_rms_m=verdicts.formation_spacing_error_rms_m,
        separation_m=mission.safety.separation_m,
    )
