"""The references of a mission, from which its flights may deviate by the tolerances of the verdicts."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from pydantic import Field

from gcs.metrics.engagement import EngagementReference
from gcs.mission.mission import Mission, VerdictSection


@dataclass(frozen=True, slots=True)
class DesiredRing:
    """The desired ring about the target; a positive angular rate is counter-clockwise seen from above.

    Raises ValueError when the radius is not positive or a number is not finite.
    """

    radius_m: float
    angular_rate_rad_s: float

    def __post_init__(self) -> None:
        """Validate the numbers."""
        if not (isfinite(self.radius_m) and self.radius_m > 0.0):
            raise ValueError(f"ring radius_m = {self.radius_m}: it must be positive")
        if not isfinite(self.angular_rate_rad_s):
            raise ValueError(f"ring angular_rate_rad_s = {self.angular_rate_rad_s} is not finite")


@dataclass(frozen=True, slots=True)
class FormationReference:
    """The desired formation, travelling along +x of the mission frame.

    `slots_m` maps vehicle ids to their slots (x, y) in line order: each spacing is measured to the previous vehicle.
    Raises ValueError when a number is not finite.
    """

    speed_m_s: float
    slots_m: Mapping[int, tuple[float, float]]

    def __post_init__(self) -> None:
        """Validate the numbers."""
        if not isfinite(self.speed_m_s):
            raise ValueError(f"formation speed_m_s = {self.speed_m_s} is not finite")
        for vehicle_id, slot in self.slots_m.items():
            if not all(map(isfinite, slot)):
                raise ValueError(f"formation slot of vehicle {vehicle_id} = {slot} is not finite")


class VerdictTolerances(VerdictSection):
    """The tolerances of the verdicts: the mission's, and the required separation. A metric equal to its own holds."""

    separation_m: float = Field(gt=0.0)


def ring_reference(mission: Mission) -> DesiredRing:
    """Return the ring of the mission."""
    return DesiredRing(mission.encirclement.radius_m, mission.encirclement.angular_rate_rad_s)


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
    return VerdictTolerances(**mission.verdicts.model_dump(), separation_m=mission.safety.separation_m)
