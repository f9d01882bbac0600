"""The references of a mission, and the tolerances of its verdicts; a flight of the mission judged by them."""

from gcs.metrics.engagement import EngagementReference
from gcs.metrics.metrics import evaluate
from gcs.metrics.record import FlightRecord
from gcs.metrics.result import FlightResult, FormationReference, RingReference, VerdictTolerances
from gcs.mission.mission import Mission


def evaluated(mission: Mission, record: FlightRecord) -> FlightResult:
    """Return the metrics and verdicts of a flight of the mission."""
    references = ring_reference(mission), formation_reference(mission), verdict_tolerances(mission)
    return evaluate(record, *references, engagement_reference(mission))


def ring_reference(mission: Mission) -> RingReference:
    """Return the ring of the mission."""
    return RingReference(mission.encirclement.radius_m, mission.encirclement.angular_rate_rad_s)


def formation_reference(mission: Mission) -> FormationReference:
    """Return the formation of the mission, vehicles in line order."""
    formation = mission.formation
    offsets = mission.agent_config(mission.vehicles[0]).slot_offset_m
    slots = {vehicle_id: offsets(vehicle_id, formation.leader) for vehicle_id in mission.ids}
    return FormationReference(formation.speed_m_s, slots)


def engagement_reference(mission: Mission) -> EngagementReference:
    """Return which vehicles engage the mission's target by their thresholds; a flight for identification has none."""
    target = mission.target
    if mission.excites:
        return EngagementReference()
    return EngagementReference(
        {
            vehicle.id: vehicle.decision.distance_max_m
            for vehicle in mission.vehicles
            if target.importance > vehicle.decision.importance_min and target.threat < vehicle.decision.threat_max
        }
    )


def verdict_tolerances(mission: Mission) -> VerdictTolerances:
    """Return the tolerances of the mission's verdicts."""
    verdicts = mission.verdicts
    return VerdictTolerances(
        radius_error_rms_m=verdicts.radius_error_rms_m,
        angular_rate_error_rad_s=verdicts.angular_rate_error_rad_s,
        spacing_error_rms_deg=verdicts.spacing_error_rms_deg,
        formation_speed_error_rms_m_s=verdicts.formation_speed_error_rms_m_s,
        formation_spacing_error_rms_m=verdicts.formation_spacing_error_rms_m,
        separation_m=mission.safety.separation_m,
    )
