"""The criteria of a flight: references, tolerances, and the gain of the spacing law."""

from dataclasses import dataclass

from gcs.metrics.references import formation_reference, ring_reference, verdict_tolerances
from gcs.metrics.result import FormationReference, RingReference, VerdictTolerances
from gcs.mission.mission import Mission


@dataclass(frozen=True, slots=True)
class Criteria:
    """The references and tolerances of a mission; `spacing_gain_per_s` is gamma of (22), None if not known."""

    ring: RingReference
    formation: FormationReference
    tolerances: VerdictTolerances
    spacing_gain_per_s: float | None = None


def criteria_of(mission: Mission) -> Criteria:
    """Return the criteria of a mission."""
    return Criteria(
        ring_reference(mission),
        formation_reference(mission),
        verdict_tolerances(mission),
        mission.encirclement.spacing_gain_per_s,
    )
