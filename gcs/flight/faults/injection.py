"""The changes that a fault makes, and the team in flight that it is injected into."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from signal import Signals

from estimation.frames import Triple
from gcs.flight.faults.team_faults import TeamFaults
from gcs.mission.mission import Mission
from sitl.faults import VehicleInjection


@dataclass(frozen=True, slots=True)
class TeamInFlight:
    """A team in flight: the fault's subject, the airborne vehicles, and their positions [m]."""

    mission: Mission
    subject: int
    airborne: tuple[int, ...]
    places_m: Mapping[int, Triple]

    @property
    def others(self) -> tuple[int, ...]:
        """All airborne vehicles but the subject."""
        return tuple(i for i in self.airborne if i != self.subject)


@dataclass(frozen=True, slots=True)
class Injection:
    """Faults of the flying process, those of vehicles by id, a signal to the process, and whether a client intrudes."""

    team: TeamFaults = field(default_factory=TeamFaults)
    vehicles: Mapping[int, VehicleInjection] = field(default_factory=dict)
    signal: Signals | None = None
    unauthorised_client: bool = False

    @property
    def ends_flight(self) -> bool:
        """Whether it ends the flying process."""
        return self.signal is not None or bool(self.team.hang)


def last_in_line(mission: Mission, airborne: Sequence[int]) -> int:
    """Return the vehicle that faults are injected into: the last in line, the leader only when no other is airborne."""
    return max(airborne, key=lambda i: (i != mission.formation.leader, mission.ids.index(i)))
