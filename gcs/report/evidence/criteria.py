"""The criteria of a flight: references, tolerances, the gain of the spacing law, and the validation of plants."""

from dataclasses import dataclass, field, replace

import numpy as np

from estimation.plant.model import Plant
from estimation.plant.watch import DELAY_MAX_S, effect_delay_s, watch
from estimation.state import POSITION, Vector
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import (
    DesiredRing,
    EngagementReference,
    FormationReference,
    VerdictTolerances,
    engagement_reference,
    formation_reference,
    ring_references,
    verdict_tolerances,
)
from gcs.metrics.result import PlantResult
from gcs.mission.mission import Mission, MissionVehicle
from gcs.report.evidence.flight import FlightEvidence, VehicleEvidence


def plant_results(mission: Mission, evidence: FlightEvidence) -> tuple[PlantResult, ...]:
    """Return the validation of the plant of each recorded vehicle's profile, and its latency."""
    recorded = [each for each in evidence.vehicles if each.loop.time_s.size and each.samples.size]
    return tuple(_result(mission.vehicle(each.vehicle_id), each) for each in recorded)


def _result(vehicle: MissionVehicle, evidence: VehicleEvidence) -> PlantResult:
    plant, profile = _over_the_link(vehicle.plant, evidence), vehicle.section.profile
    watched = watch(plant, _setpoints(plant, evidence), evidence.samples)
    verdict = None if watched is None else watched.difference or "valid"
    text = f"'{profile}': not enough excitation to validate the plant"
    if watched is not None:
        differs = f"{verdict} than its profile '{profile}': identify it (cordon excite, cordon identify)"
        valid = f"'{profile}' is valid for this flight"
        text = f"{differs if watched.difference else valid}: {watched.text}"
    return PlantResult(vehicle.id, profile, verdict, text, _latency(vehicle, evidence))


def _latency(vehicle: MissionVehicle, evidence: VehicleEvidence) -> str:
    effect_s = effect_delay_s(vehicle.plant, _setpoints(vehicle.plant, evidence), evidence.samples)
    effect = "not measured, for want of excitation" if effect_s is None else f"{effect_s:.2f} s"
    trips_s, link = evidence.round_trip_s, "not measured"
    if trips_s.size:
        trip_s = float(np.median(trips_s))
        link = f"{trip_s:.2f} s ({trips_s.min():.2f} to {trips_s.max():.2f})"
        if effect_s is not None and effect_s < trip_s / 2.0:
            # No effect precedes its setpoint's arrival: this flight cannot tell the delay from the plant's own lag.
            effect = "not measured, because the profile's plant is slower than the vehicle in this flight"
    return f"setpoint to effect {effect}; delay of the profile {vehicle.plant.delay_s:.2f} s, link's round trip {link}"


def _over_the_link(plant: Plant, evidence: VehicleEvidence) -> Plant:
    """Return a plant as it appears over the vehicle's link."""
    link_s = float(np.median(evidence.round_trip_s)) if evidence.round_trip_s.size else 0.0
    return replace(plant, delay_s=min(plant.delay_s + link_s, DELAY_MAX_S))


def _setpoints(plant: Plant, evidence: VehicleEvidence) -> Vector:
    loop = evidence.loop
    sent = [loop.time_s, loop.setpoint_m[:, POSITION]] + [loop.velocity_m_s[:, POSITION]] * (plant.feedforward > 0.0)
    return np.column_stack(sent)


@dataclass(frozen=True, slots=True)
class Criteria:
    """The references and tolerances of a mission; `spacing_gain_per_s` is gamma of (22), None if not known.

    `engagement` is which vehicles engage the target. `ring` is the only ring, or the first of several `rings`.
    """

    ring: DesiredRing
    formation: FormationReference
    tolerances: VerdictTolerances
    spacing_gain_per_s: float | None = None
    engagement: EngagementReference = field(default_factory=EngagementReference)
    rings: tuple[DesiredRing, ...] = ()

    @property
    def every_ring(self) -> tuple[DesiredRing, ...]:
        """All rings, also if there is only one."""
        return self.rings or (self.ring,)

    def of_ring(self, number: int) -> "Criteria":
        """Return the criteria of one ring."""
        return replace(self, ring=self.every_ring[number], rings=())


def criteria_of(mission: Mission, record: FlightRecord) -> Criteria:
    """Return the criteria of a flight of a mission."""
    rings = ring_references(mission, record)
    return Criteria(
        rings[0],
        formation_reference(mission),
        verdict_tolerances(mission),
        mission.encirclement.spacing_gain_per_s,  # that of all rings
        engagement_reference(mission),
        rings if len(rings) > 1 else (),
    )
