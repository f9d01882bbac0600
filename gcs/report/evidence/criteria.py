"""The criteria of a flight: references, tolerances, and the gain of the spacing law."""

from dataclasses import dataclass, field

from gcs.metrics.engagement import EngagementReference
from gcs.metrics.references import (
    DesiredRing,
    FormationReference,
    VerdictTolerances,
    engagement_reference,
    formation_reference,
    ring_reference,
    verdict_tolerances,
)
from gcs.mission.mission import Mission


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
