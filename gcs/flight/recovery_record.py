"""What a recovery found, and how its vehicles came home: ends, times and distances, as text and as JSON."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, combinations, product
from math import dist, inf
from typing import TYPE_CHECKING

from estimation.frames import Triple
from gcs.metrics.ending import TeamEnding, VehicleEnding
from gcs.metrics.json_output import json_output
from gcs.preflight.findings import VehicleFacts
from gcs.preflight.recovery import Standing

if TYPE_CHECKING:
    from gcs.flight.team import FlightTeam
    from gcs.mission.mission import Mission

_PERIOD_S = 0.1


@dataclass(frozen=True, slots=True)
class RecoveredVehicle:
    """A vehicle of the mission: how it was found, what was done with it, and how that ended.

    Distances are horizontal, from its `start_m`; `landed_at_s` is since the first was taken [s of the mission clock].
    None is what is not known, or does not apply.
    """

    id: int
    grade: str
    found: str
    treatment: str
    from_start_m: float | None
    how: str | None = None
    reason: str | None = None
    landed_at_s: float | None = None
    landed_from_start_m: float | None = None

    @property
    def line(self) -> str:
        """Where and when it landed; empty if it was not seen to land."""
        if self.landed_at_s is None or self.landed_from_start_m is None:
            return ""
        return (
            f"vehicle {self.id}: disarmed after {self.landed_at_s:.0f} s, "
            f"{self.landed_from_start_m:.1f} m from its start"
        )


@dataclass(frozen=True, slots=True)
class RecoveryResult:
    """A recovery: `ended` is None if no vehicle was taken, and so are the figures.

    `duration_s` lasts from the first taken until the end, `distance_min_m` is the least distance of two vehicles in the
    air meanwhile, one of them brought home, by the positions that they reported.
    """

    mission: str
    ended: TeamEnding | None
    duration_s: float | None
    distance_min_m: float | None
    vehicles: tuple[RecoveredVehicle, ...]

    @property
    def lines(self) -> Iterator[str]:
        """It for people, besides how it ended."""
        yield from filter(None, (each.line for each in self.vehicles))
        if self.distance_min_m is not None:
            yield f"least distance of two in the air: {self.distance_min_m:.1f} m, by the positions that they reported"

    def to_json(self) -> str:
        """Return it as one line of JSON."""
        return json_output(asdict(self))


class RecoveryRecord:
    """Collects what is found and what becomes of it, while a team is brought home."""

    def __init__(self) -> None:
        self._standings: Sequence[Standing] = ()
        self._found_m: dict[int, Triple | None] = {}
        self._places_m: dict[int, Triple] = {}
        self._landed_s: dict[int, float] = {}
        self._endings: tuple[VehicleEnding, ...] = ()
        self._began_s = self._ended_s = 0.0
        self._least_m = inf

    def judge(self, standings: Sequence[Standing], team: Sequence[VehicleFacts]) -> None:
        """Take what is to be done with each vehicle, and the facts about it."""
        self._standings = standings
        self._found_m = {facts.vehicle_id: facts.position_m for facts in team}

    async def follow(self, team: "FlightTeam") -> None:
        """Follow the vehicles of a team until cancelled."""
        self._began_s = team.clock.now_s()
        while True:
            self._look(team)
            await team.clock.sleep(_PERIOD_S)

    def end(self, team: "FlightTeam", endings: Sequence[VehicleEnding]) -> None:
        """Take the end of each vehicle's flight."""
        self._look(team)
        self._endings, self._ended_s = tuple(endings), team.clock.now_s()

    def _look(self, team: "FlightTeam") -> None:
        now_s, aloft_m = team.clock.now_s(), []
        for member in team.members:
            vehicle_id, motion = member.vehicle.id, member.link.motion
            if motion is not None:
                self._places_m[vehicle_id] = motion.position_m
            if not member.link.status.connected:
                continue
            if member.link.status.armed:
                self._landed_s.pop(vehicle_id, None)
                if motion is not None and member.link.status.in_air:
                    since_s = now_s - motion.time_s
                    moved_m = zip(motion.position_m, motion.velocity_m_s, strict=True)
                    aloft_m.append([at_m + rate_m_s * since_s for at_m, rate_m_s in moved_m])
            else:
                self._landed_s.setdefault(vehicle_id, now_s - self._began_s)
        pairs = chain(combinations(aloft_m, 2), product(aloft_m, _others_m(team, now_s)))
        self._least_m = min([self._least_m, *(dist(one, other) for one, other in pairs)])

    def result(self, mission: "Mission") -> RecoveryResult:
        """Return the result, also of a recovery that was refused."""
        ended = TeamEnding.of(self._endings)
        return RecoveryResult(
            mission.mission.name,
            ended,
            None if ended is None else self._ended_s - self._began_s,
            None if self._least_m == inf else self._least_m,
            tuple(self._vehicle(each, mission) for each in self._standings),
        )

    def _vehicle(self, standing: Standing, mission: "Mission") -> RecoveredVehicle:
        i, finding = standing.vehicle_id, standing.finding
        start_m = mission.vehicle(i).section.start_m

        def away_m(place_m: Triple | None) -> float | None:
            return None if place_m is None else dist(place_m[:2], start_m)

        found = RecoveredVehicle(
            i, finding.grade.value, finding.found, standing.treatment.value, away_m(self._found_m.get(i))
        )
        ending = next((each for each in self._endings if each.vehicle == i), None)
        if ending is None:
            return found
        landed_s = self._landed_s.get(i)
        landed_m = None if landed_s is None else away_m(self._places_m.get(i))
        return replace(
            found, how=ending.how.value, reason=ending.reason, landed_at_s=landed_s, landed_from_start_m=landed_m
        )


def _others_m(team: "FlightTeam", now_s: float) -> Iterator[list[float]]:
    """Yield where vehicles are now that other processes fly, by their newest states."""
    here = {member.vehicle.id for member in team.members}
    states = {peer.sender: peer for status in team.newest.values() for peer in status.peers}
    for each in (states[i] for i in states.keys() - here):
        since_s = now_s - each.time_s
        moved_m = zip(each.position_m, each.velocity_m_s, strict=True)
        yield [*(at_m + rate_m_s * since_s for at_m, rate_m_s in moved_m), each.altitude_m]
