"""The criteria of a flight: references, tolerances, the gain of the spacing law, and the validation of plants."""

from dataclasses import dataclass, field, replace

import numpy as np

from estimation.plant.model import Plant
from estimation.plant.watch import DELAY_MAX_S, effect_delay_s, others, watch
from estimation.state import POSITION, Vector
from gcs.metrics.references import (
    DesiredRing,
    EngagementReference,
    FormationReference,
    VerdictTolerances,
    engagement_reference,
    formation_reference,
    ring_reference,
    verdict_tolerances,
)
from gcs.mission.mission import Mission, MissionVehicle
from gcs.report.evidence.flight import FlightEvidence, PlantNote, VehicleEvidence

AGAIN_SHARE = 0.7
"""Identify again where another plant leaves less than this share of the residual of the profile's plant (rms):
half of the variance. In closed loop, noise alone favours a softer plant: the drift of PX4's estimate gives 0.9."""


def plant_notes(mission: Mission, evidence: FlightEvidence) -> tuple[PlantNote, ...]:
    """Return the validation of the plant of each recorded vehicle's profile, and its latency."""
    recorded = [each for each in evidence.vehicles if each.loop.time_s.size and each.samples.size]
    return tuple(_note(mission.vehicle(each.vehicle_id), each) for each in recorded)


def _note(vehicle: MissionVehicle, evidence: VehicleEvidence) -> PlantNote:
    validation, is_invalid = _validation(vehicle, evidence)
    return PlantNote(vehicle.id, validation, _latency(vehicle, evidence), is_invalid)


def _validation(vehicle: MissionVehicle, evidence: VehicleEvidence) -> tuple[str, bool]:
    """Return the validation of a plant as text, and whether another plant is better."""
    plant = _over_the_link(vehicle.plant, evidence)
    watched = watch(plant, _setpoints(plant, evidence), evidence.samples)
    name = f"'{vehicle.section.profile}'"
    if watched is None:
        return f"{name}: not enough excitation to validate the plant", False
    left = f"{name}: residual {watched.unexplained_m:.2f} m rms over {watched.windows} windows"
    if watched.best_m >= AGAIN_SHARE * watched.unexplained_m:
        best = f"best of {len(others(plant))} other plants {watched.best_m:.2f} m"
        return f"{left}, {best}: valid for this flight", False
    other = f"other plant {watched.best_m:.2f} m ({_numbers(watched.best, plant)})"
    return f"{left}, {other}: identify again (cordon excite)", True


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


def _numbers(best: Plant, plant: Plant) -> str:
    text = f"a0 {best.x.a0_per_s2:.2f} 1/s², a1 {best.x.a1_per_s:.2f} 1/s, delay {best.delay_s:.2f} s"
    return text if best.feedforward == plant.feedforward else f"{text}, without velocity feed-forward"


@dataclass(frozen=True, slots=True)
class Criteria:
    """The references and tolerances of a mission; `spacing_gain_per_s` is gamma of (22), None if not known.

    `engagement` is which vehicles engage the target.
    """

    ring: DesiredRing
    formation: FormationReference
    tolerances: VerdictTolerances
    spacing_gain_per_s: float | None = None
    engagement: EngagementReference = field(default_factory=EngagementReference)


def criteria_of(mission: Mission) -> Criteria:
    """Return the criteria of a mission."""
    return Criteria(
        ring_reference(mission),
        formation_reference(mission),
        verdict_tolerances(mission),
        mission.encirclement.spacing_gain_per_s,
        engagement_reference(mission),
    )
