"""What a flight is held against: the references, the tolerances and the gain of the spacing law."""

from dataclasses import dataclass

from gcs.metrics.references import formation_reference, ring_reference, verdict_tolerances
from gcs.metrics.result import FormationReference, RingReference, VerdictTolerances
from gcs.mission.mission import Mission


@dataclass(frozen=True, slots=True)
class Asked:
    """What the mission asks for; `spacing_gain_per_s` is the gamma of (22), None if it is not known."""

    ring: RingReference
    formation: FormationReference
    tolerances: VerdictTolerances
    spacing_gain_per_s: float | None = None


def asked_of(mission: Mission) -> Asked:
    """Return what a mission asks for."""
    return Asked(
        ring_reference(mission),
        formation_reference(mission),
        verdict_tolerances(mission),
        mission.encirclement.spacing_gain_per_s,
    )
