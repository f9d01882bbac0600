"""The roles of vehicles in a drill: the fault's subject, the others, and those on the ring."""

from dataclasses import dataclass, field
from math import hypot

from agents.tactics import Tactic
from gcs.flight.faults.injection import last_in_line
from gcs.mission.mission import Mission

REACH_SHARE = 1.2
"""A target farther away is reached late or never."""


@dataclass(slots=True)
class Roles:
    """The roles in one flight; `landed` are the vehicles that have landed for good."""

    mission: Mission
    landed: set[int] = field(default_factory=set)

    @property
    def airborne(self) -> tuple[int, ...]:
        """All vehicles in flight."""
        return tuple(i for i in self.mission.ids if i not in self.landed)

    @property
    def subject(self) -> int:
        """The vehicle that faults are injected into."""
        return last_in_line(self.mission, self.airborne)

    @property
    def others(self) -> tuple[int, ...]:
        """All airborne vehicles but the subject."""
        return tuple(i for i in self.airborne if i != self.subject)

    @property
    def on_ring(self) -> tuple[int, ...]:
        """The vehicles that encircle the target."""
        return tuple(i for i in self.airborne if self.tactic(i) == Tactic.ENCIRCLE.value)

    def tactic(self, vehicle: int) -> str:
        """Return a vehicle's tactic without faults: it encircles a target within its reach."""
        mission, member = self.mission, self.mission.vehicle(vehicle)
        decision = member.decision
        config = mission.agent_config(member)
        (x, y), (dx, dy) = config.line_start_m, config.slot_offset_m(vehicle, mission.formation.leader)
        away_m = hypot(mission.target.start_m[0] - x - dx, mission.target.start_m[1] - y - dy)
        accepted = mission.target.importance > decision.importance_min and mission.target.threat < decision.threat_max
        engages = accepted and away_m < REACH_SHARE * decision.distance_max_m
        return Tactic.ENCIRCLE.value if engages else Tactic.FORMATION.value
