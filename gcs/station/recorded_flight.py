"""A recorded flight for the operator's page: pictures at an even rate and all events, from its logs."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from operator import itemgetter

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agents.flight_end import FlightEnd
from agents.inputs import Start
from agents.safety.fence import Area
from agents.team.messages import RingValues
from gcs.console.rings import ring_names
from gcs.console.vehicle_view import VehicleView, with_surroundings
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog
from gcs.flightlog.records import Decision
from gcs.flightlog.run import mission_of
from gcs.metrics.ending import TeamEnding, VehicleEnding
from gcs.mission.geometry import areas
from gcs.mission.mission import Mission
from gcs.station.picture import (
    EventPicture,
    FlightPicture,
    TargetPicture,
    TeamPicture,
    mission_picture,
)
from gcs.station.recorded_vehicle import RecordedVehicle, Sampled
from gcs.station.seen_target import SeenTarget

PICTURES_HZ = 5.0
_VEHICLE_PICTURES, _STEP_MAX_S = 3900, 1.0
"""A vehicle takes about 600 bytes of JSON per picture: long flights have fewer pictures than `PICTURES_HZ`."""


@dataclass(frozen=True, slots=True)
class _Clock:
    """The times of a flight: of its pictures, on the team's clock, since the mission's start, and in Unix time."""

    began_s: float
    step_s: float
    pictures: int
    start_s: float
    unix_s: float
    speed: float

    @classmethod
    def of(cls, logs: Sequence[FlightLog], vehicle_pictures: int, step_max_s: float) -> "_Clock":
        """Return the clock of the logs of one flight; raises LogError where no tick is recorded."""
        recorded = list(_recorded(logs))
        ticks = [(tick_s, log.run.began_s) for log, i in recorded for tick_s in _first_and_last_s(log, i)]
        if not ticks:
            raise LogError([f"{log.path}: it holds no tick of a vehicle: no flight to show" for log in logs])
        began_s, unix_s = min(ticks)
        ended_s, _ = max(ticks)
        sparse_s = len(recorded) * (ended_s - began_s) / vehicle_pictures
        step_s = min(max(1.0 / PICTURES_HZ, sparse_s), step_max_s)
        starts_s = [each.at_s for log, i in recorded for each in log.of_kind(i, Start)]
        # The last picture comes after the last tick.
        pictures = int((ended_s - began_s) / step_s) + 2
        return cls(began_s, step_s, pictures, min(starts_s, default=inf), unix_s, logs[0].run.speed)

    @property
    def last_s(self) -> float:
        """The time of the last picture."""
        return self.began_s + (self.pictures - 1) * self.step_s

    def times_s(self) -> Iterator[float]:
        """Return the times of the pictures."""
        return (self.began_s + k * self.step_s for k in range(self.pictures))

    def mission_s(self, time_s: float) -> float | None:
        """Return a time since the mission's start, None before it."""
        return round(time_s - self.start_s, 3) if time_s >= self.start_s else None

    def wall_s(self, time_s: float) -> float:
        """Return a time as Unix time."""
        return round(self.unix_s + (time_s - self.began_s) / self.speed, 3)


def recorded_flight(
    *logs: FlightLog, vehicle_pictures: int = _VEHICLE_PICTURES, step_max_s: float = _STEP_MAX_S
) -> FlightPicture:
    """Return the flight in the logs of its processes, one or several, for the page.

    There are `PICTURES_HZ` pictures a second, fewer if these would hold the vehicles more than
    `vehicle_pictures` times altogether, but at least one every `step_max_s`.

    Raises LogError if the logs hold no flight, hold a mission that this version refuses, or are damaged.
    """
    mission, clock = mission_of(logs[0]), _Clock.of(logs, vehicle_pictures, step_max_s)
    duration_s = logs[0].run.duration_s
    recorded = sorted(_recorded(logs), key=lambda each: mission.ids.index(each[1]))
    vehicles = [RecordedVehicle(*each, ring_names(mission)) for each in recorded]
    samples = [each.sampled(clock.times_s()) for each in vehicles]
    area_of = areas([each.section for each in mission.vehicles], mission.safety)
    seen_targets = [SeenTarget(mission, each) for each in mission.every_target]
    teams = [
        _team(clock, time_s, mission, row, area_of, duration_s, seen_targets)
        for time_s, *row in zip(clock.times_s(), *samples, strict=True)
    ]
    teams[-1] = replace(teams[-1], ending=_ending(logs))
    for commanded_s, ring in sorted((ring for each in vehicles for ring in each.rings), key=itemgetter(0)):
        first = sum(time_s < commanded_s for time_s in clock.times_s())
        values = RingValues(ring.radius_m, ring.angular_rate_rad_s, ring.altitude_m, ring.tilt_deg)
        teams[first:] = [_with_ring(team, ring.ring, values) for team in teams[first:]]
    planned = mission_picture(mission, "log", duration_s)
    return FlightPicture(planned, tuple(teams), tuple(_events(clock, vehicles)))


def _team(
    clock: _Clock,
    time_s: float,
    mission: Mission,
    sampled: Sequence[Sampled],
    area_of: Mapping[int, Area],
    duration_s: float,
    seen_targets: Sequence[SeenTarget],
) -> TeamPicture:
    flying = [each.vehicle for each in sampled if not each.vehicle.has_ended]
    places_m = {each.vehicle_id: each.position_m[:2] for each in flying if each.position_m is not None}
    since_s = clock.mission_s(time_s)
    rings = mission.rings
    vehicles = {each.vehicle.vehicle_id: _surrounded(each.vehicle, places_m, area_of) for each in sampled}
    estimates = [each for each in sampled if not (each.vehicle.has_ended or each.vehicle.is_stale)]
    targets = tuple(
        seen.picture(_target([each.target for each in estimates if not rings or rings[each.ring].target == k]), time_s)
        for k, seen in enumerate(seen_targets)
    )
    return TeamPicture(
        since_s,
        clock.wall_s(time_s),
        tuple(vehicles.get(vehicle_id) or VehicleView(vehicle_id) for vehicle_id in mission.ids),
        None if rings else targets[0],
        sum(each.radius_m is not None and not each.is_stale for each in flying),
        remaining_s=None if since_s is None else round(max(duration_s - since_s, 0.0), 3),
        targets=targets if rings else UNSET,
        rings=(None,) * len(rings) if rings else UNSET,
    )


def _with_ring(team: TeamPicture, number: int, values: RingValues) -> TeamPicture:
    """Return a picture with the commanded values of a ring."""
    if isinstance(team.rings, UnsetType):
        return replace(team, ring=values)
    return replace(team, rings=(*team.rings[:number], values, *team.rings[number + 1 :]))


def _surrounded(
    vehicle: VehicleView, places_m: Mapping[int, tuple[float, float]], area_of: Mapping[int, Area]
) -> VehicleView:
    view = with_surroundings(vehicle, places_m, area_of)
    nearest_m, margin_m = (None if each is None else round(each, 2) for each in (view.nearest_m, view.fence_margin_m))
    return replace(view, nearest_m=nearest_m, fence_margin_m=margin_m)


def _target(known: Sequence[TargetPicture | None]) -> TargetPicture | None:
    """Return the estimate with the newest sighting."""
    return min((each for each in known if each is not None), key=lambda each: each.sighting_age_s, default=None)


def _events(clock: _Clock, vehicles: Iterable[RecordedVehicle]) -> Iterator[EventPicture]:
    happened = sorted(
        ((time_s, each.vehicle_id, text, level) for each in vehicles for time_s, text, level in each.events),
        key=lambda event: event[0],
    )
    for number, (time_s, vehicle_id, text, level) in enumerate(happened, 1):
        at_s = min(time_s, clock.last_s)  # the end of a vehicle is recorded after the last picture
        yield EventPicture(number, clock.mission_s(at_s), clock.wall_s(at_s), level, text, vehicle_id)


def _ending(logs: Sequence[FlightLog]) -> str:
    """Return how the flight ended, in one line."""
    endings = []
    for log, vehicle_id in _recorded(logs):
        end = log.end_of(vehicle_id)
        if end is None:
            endings.append(VehicleEnding(vehicle_id, FlightEnd.IN_FLIGHT, "the log ends in flight"))
        else:
            endings.append(VehicleEnding(vehicle_id, FlightEnd(end.how), end.reason))
    ending = TeamEnding.of(endings)
    return "The log does not record how the flight ended" if ending is None else ending.headline


def _recorded(logs: Sequence[FlightLog]) -> Iterator[tuple[FlightLog, int]]:
    """Return every vehicle that the logs record, with its log."""
    return ((log, vehicle_id) for log in logs for vehicle_id in log.run.vehicles)


def _first_and_last_s(log: FlightLog, vehicle_id: int) -> list[float]:
    """Return the times of a vehicle's first and last tick, empty without ticks."""
    ticks = [each for each in log.vehicles.get(vehicle_id, ()) if each.kind is Decision]
    return [float(each.message().time_s) for each in (*ticks[:1], *ticks[-1:])]
