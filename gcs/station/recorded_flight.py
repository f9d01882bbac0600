"""What the operator's page shows of a recorded flight: its log, in pictures at an even rate, and all its events."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf

from msgspec.structs import replace

from agents.tape import Start
from gcs.flightlog.log_error import LogError
from gcs.flightlog.reader import FlightLog
from gcs.flightlog.records import Decision, VehicleEnd
from gcs.flightlog.run import mission_of
from gcs.metrics.ending import FlightEnding, How, VehicleEnding
from gcs.mission.geometry import fences
from gcs.station.mission_picture import mission_picture
from gcs.station.picture import EventPicture, FlightPicture, TargetPicture, TeamPicture, VehiclePicture
from gcs.station.recorded_vehicle import RecordedVehicle, Sampled
from gcs.station.vehicle_picture import Surroundings

PICTURES_HZ, PICTURES_HZ_MIN = 5.0, 1.0
_VEHICLE_PICTURES_MAX = 4200
"""A vehicle at one time takes about 600 bytes of JSON: long flights are shown less often than `PICTURES_HZ`."""


@dataclass(frozen=True, slots=True)
class _Clock:
    """The times of a log: of its pictures, on the team's clock, since the mission's start, and in Unix time."""

    began_s: float
    step_s: float
    pictures: int
    start_s: float
    unix_s: float
    speed: float

    @classmethod
    def of(cls, log: FlightLog) -> "_Clock":
        """Return the clock of a log; raises LogError where no tick is recorded."""
        ticks_s = [tick_s for i in log.run.vehicles for tick_s in _first_and_last_s(log, i)]
        if not ticks_s:
            raise LogError([f"{log.path}: it holds no tick of a vehicle: there is nothing to show"])
        began_s, ended_s = min(ticks_s), max(ticks_s)
        sparse_s = len(log.run.vehicles) * (ended_s - began_s) / _VEHICLE_PICTURES_MAX
        step_s = min(max(1.0 / PICTURES_HZ, sparse_s), 1.0 / PICTURES_HZ_MIN)
        starts_s = [each.at_s for i in log.run.vehicles for each in log.of_kind(i, Start)]
        # The last picture comes after the last tick.
        pictures = int((ended_s - began_s) / step_s) + 2
        return cls(began_s, step_s, pictures, min(starts_s, default=inf), log.run.began_s, log.run.speed)

    def times_s(self) -> Iterator[float]:
        """Return the times of the pictures."""
        return (self.began_s + k * self.step_s for k in range(self.pictures))

    def mission_s(self, time_s: float) -> float | None:
        """Return a time since the mission's start, None before it."""
        return round(time_s - self.start_s, 3) if time_s >= self.start_s else None

    def wall_s(self, time_s: float) -> float:
        """Return a time as Unix time."""
        return round(self.unix_s + (time_s - self.began_s) / self.speed, 3)


def recorded_flight(log: FlightLog) -> FlightPicture:
    """Return a log as the page replays it.

    Raises LogError where the log holds no flight, or a mission that this version refuses, or is damaged.
    """
    mission, clock = mission_of(log), _Clock.of(log)
    vehicles = {i: RecordedVehicle(log, i) for i in log.run.vehicles}
    samples = [each.sampled(clock.times_s()) for each in vehicles.values()]
    surroundings = Surroundings(fences([each.section for each in mission.vehicles], mission.safety))
    teams = [
        _team(clock, time_s, mission.ids, row, surroundings, log.run.duration_s)
        for time_s, *row in zip(clock.times_s(), *samples, strict=True)
    ]
    teams[-1] = replace(teams[-1], ending=_ending(log))
    planned = mission_picture(mission, "log", log.run.duration_s)
    return FlightPicture(planned, tuple(teams), tuple(_events(clock, vehicles.values())))


def _team(
    clock: _Clock,
    time_s: float,
    ids: Sequence[int],
    sampled: Sequence[Sampled],
    surroundings: Surroundings,
    duration_s: float,
) -> TeamPicture:
    flying = [each.vehicle for each in sampled if not each.vehicle.has_ended]
    places_m = {each.vehicle_id: each.position_m[:2] for each in flying if each.position_m is not None}
    since_s = clock.mission_s(time_s)
    vehicles = {each.vehicle.vehicle_id: _surrounded(each.vehicle, surroundings, places_m) for each in sampled}
    return TeamPicture(
        since_s,
        clock.wall_s(time_s),
        tuple(vehicles.get(vehicle_id) or VehiclePicture(vehicle_id) for vehicle_id in ids),
        _target([each.target for each in sampled if not (each.vehicle.has_ended or each.vehicle.is_stale)]),
        sum(each.radius_m is not None and not each.is_stale for each in flying),
        remaining_s=None if since_s is None else round(max(duration_s - since_s, 0.0), 3),
    )


def _surrounded(
    vehicle: VehiclePicture, surroundings: Surroundings, places_m: dict[int, tuple[float, float]]
) -> VehiclePicture:
    nearest_id, nearest_m = surroundings.nearest(vehicle.vehicle_id, places_m)
    margin_m = surroundings.fence_margin_m(vehicle.vehicle_id, places_m)
    return replace(
        vehicle,
        nearest_id=nearest_id,
        nearest_m=None if nearest_m is None else round(nearest_m, 2),
        fence_margin_m=None if margin_m is None else round(margin_m, 2),
    )


def _target(known: Sequence[TargetPicture | None]) -> TargetPicture | None:
    """Return the estimate with the newest sighting."""
    return min((each for each in known if each is not None), key=lambda each: each.sighting_age_s, default=None)


def _events(clock: _Clock, vehicles: Iterable[RecordedVehicle]) -> Iterator[EventPicture]:
    happened = sorted(
        ((time_s, each.vehicle_id, text, how_grave) for each in vehicles for time_s, text, how_grave in each.events),
        key=lambda event: event[0],
    )
    for number, (time_s, vehicle_id, text, how_grave) in enumerate(happened, 1):
        yield EventPicture(number, clock.mission_s(time_s), clock.wall_s(time_s), how_grave, text, vehicle_id)


def _ending(log: FlightLog) -> str:
    """Return how the flight ended, in a line; older logs do not say."""
    endings = []
    for vehicle_id in log.run.vehicles:
        end = next(log.of_kind(vehicle_id, VehicleEnd), None)
        if end is None:
            endings.append(VehicleEnding(vehicle_id, How.IN_FLIGHT, "its log ends in flight"))
        elif end.how:
            endings.append(VehicleEnding(vehicle_id, How(end.how), end.reason))
    ending = FlightEnding.of(endings)
    return "The log does not say how the flight ended" if ending is None else ending.headline


def _first_and_last_s(log: FlightLog, vehicle_id: int) -> list[float]:
    """Return the times of a vehicle's first and last tick, as far as there are some."""
    ticks = [each for each in log.vehicles.get(vehicle_id, ()) if each.kind is Decision]
    return [float(each.message().time_s) for each in (*ticks[:1], *ticks[-1:])]
