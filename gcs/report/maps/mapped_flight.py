"""A flight on the Earth: tracks, rings, fences, starts and events of its log, in degrees and metres above sea level."""

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import cos, isfinite, tau
from typing import NamedTuple

import numpy as np

from agents.inputs import Start
from agents.safety.routes import shapes_of
from agents.team.text import printable
from estimation.frames import Geodetic, MissionFrame, Triple
from estimation.state import Telemetry
from gcs.errors import InputError
from gcs.flightlog.reader import FlightLog
from gcs.flightlog.records import Truth
from gcs.flightlog.run import unix_offset_s
from gcs.metrics.ending import named
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import DesiredRing, ring_references
from gcs.metrics.targets import targets_of
from gcs.mission.mission import Mission
from gcs.report.evidence.reading import read_flight
from gcs.style import COLOURS, FAIL, FAINT
from gcs.viewer.drawing import TARGET

PERIOD_S = 0.2
"""Shortest time between places of a track, that of the scene for viewers."""
RING_POINTS = 72
_EARLY_S = 1e-6
Progress = Callable[[float], None]
"""Called with the share of the work that is done."""


class TimedPlace(NamedTuple):
    """A place at a time [Unix s]; its altitude is above mean sea level."""

    unix_s: float
    place: Geodetic


@dataclass(frozen=True, slots=True)
class MapTrack:
    """The track of a vehicle, or of a target, whose `vehicle` is None. `source` is truth or estimate."""

    name: str
    vehicle: int | None
    source: str
    colour: str
    places: tuple[TimedPlace, ...]


@dataclass(frozen=True, slots=True)
class MapLine:
    """A closed line, whose first place is not repeated: a ring, a fence or a zone. Its colour is `#RRGGBB`."""

    name: str
    colour: str
    places: tuple[Geodetic, ...]


@dataclass(frozen=True, slots=True)
class MapZone:
    """A no-fly zone by its outline on the ground. Heights are above the mission's origin, None without a limit."""

    name: str
    floor_m: float | None
    ceiling_m: float | None
    outline: MapLine


@dataclass(frozen=True, slots=True)
class MapPoint:
    """A start place, which has no time and kind `start`, or an event of a vehicle where the vehicle was."""

    name: str
    vehicle: int
    kind: str
    text: str
    place: Geodetic
    unix_s: float | None = None


@dataclass(frozen=True, slots=True)
class MappedFlight:
    """A flight on the Earth, of the vehicles that its log is of. `began_s` is when its run began [Unix s]."""

    name: str
    began_s: float
    vehicles: tuple[MapTrack, ...]
    targets: tuple[MapTrack, ...]
    rings: tuple[MapLine, ...]
    fences: tuple[MapLine, ...]
    zones: tuple[MapZone, ...]
    starts: tuple[MapPoint, ...]
    events: tuple[MapPoint, ...]

    @property
    def bounds(self) -> tuple[MapLine, ...]:
        """The outlines of fences and no-fly zones."""
        return (*self.fences, *(each.outline for each in self.zones))

    @property
    def tracks(self) -> tuple[MapTrack, ...]:
        """The tracks of vehicles and targets."""
        return (*self.vehicles, *self.targets)


def timestamp(unix_s: float) -> str:
    """Return a time in ISO 8601, in UTC, to the millisecond."""
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def mapped_flight(log: FlightLog, progress: Progress) -> MappedFlight:
    """Return the flight of a log, the mission from its start to its end, and the vehicles from their first position.

    Vehicles have their true tracks if the flight is judged by truth, else those that their autopilots estimated.
    Raises LogError for a log without a flight, InputError for a mission in a local frame.
    """
    flight = read_flight([log])
    mission, record = flight.mission, flight.evidence.record
    frame = mission.mission_frame()
    if frame.is_local:
        raise InputError(
            [f"{log.path}: its mission has a local frame, without latitude and longitude: no map shows it"]
        )
    progress(0.5)
    start_s = min(each.at_s for i in log.run.vehicles for each in log.of_kind(i, Start))
    earth = _Earth(frame, unix_offset_s(log))
    kind, tracks = (Truth if record.reference == "truth" else Telemetry), list[MapTrack]()
    for done, vehicle_id in enumerate(log.run.vehicles, start=1):
        colour = COLOURS[mission.ids.index(vehicle_id) % len(COLOURS)]
        places = tuple(earth.track(_samples(log, vehicle_id, kind)))
        tracks.append(MapTrack(f"vehicle {vehicle_id}", vehicle_id, record.reference, colour, places))
        progress(0.5 + 0.5 * done / len(log.run.vehicles))
    return MappedFlight(
        log.run.mission,
        log.run.began_s,
        tuple(each for each in tracks if len(each.places) > 1),
        tuple(_targets(mission, record, start_s, earth)),
        tuple(_rings(mission, record, earth)),
        tuple(_fences(mission, earth)),
        tuple(_zones(mission, earth)),
        tuple(_starts(mission, log.run.vehicles, earth)),
        tuple(_events(record, start_s, {each.vehicle: each for each in tracks}, earth)),
    )


class _Earth:
    """Leads from the mission frame and the flight's clock to the Earth and Unix time."""

    def __init__(self, frame: MissionFrame, offset_s: float) -> None:
        self._frame, self._offset_s = frame, offset_s

    def place(self, mission_m: Triple) -> Geodetic:
        """Return the place at mission coordinates."""
        return self._frame.geodetic_from_mission(mission_m)

    def unix_s(self, time_s: float) -> float:
        """Return the Unix time of a time on the flight's clock."""
        return time_s + self._offset_s

    def track(self, samples: Iterator[tuple[float, Triple]]) -> Iterator[TimedPlace]:
        """Return the places of finite samples in order of time, `PERIOD_S` apart or more."""
        before_s: float | None = None
        for time_s, position_m in samples:
            due = before_s is None or time_s - before_s >= PERIOD_S - _EARLY_S
            if due and all(map(isfinite, position_m)):
                before_s = time_s
                yield TimedPlace(self.unix_s(time_s), self.place(position_m))


def _samples(log: FlightLog, vehicle_id: int, kind: type[Truth] | type[Telemetry]) -> Iterator[tuple[float, Triple]]:
    """Return the times and positions of a vehicle; truth that was known afterwards replaces that received in flight."""
    messages = [each.message() for each in log.vehicles.get(vehicle_id, ()) if each.kind is kind]
    if kind is Truth:
        messages = [each for each in messages if not each.received] or messages
    for each in sorted(messages, key=lambda message: float(message.time_s)):
        x, y, z = each.position_m
        yield each.time_s, (x, y, z)


def _targets(mission: Mission, record: FlightRecord, start_s: float, earth: _Earth) -> Iterator[MapTrack]:
    """Return the tracks of the targets that were known: true ones, or the means of the vehicles' estimates."""
    sections = targets_of(mission) or (mission.target,)
    true_m = [each.position_m for each in record.targets] or [record.target_position_m]
    for section, known_m, path_m in zip(sections, true_m, record.target_paths_m, strict=True):
        height_m = section.altitude_m or 0.0
        samples = (
            (start_s + time_s, (x, y, height_m))
            for time_s, (x, y) in zip(record.time_s.tolist(), path_m.tolist(), strict=True)
        )
        places = tuple(earth.track(samples))
        if len(places) > 1:
            source = "truth" if np.isfinite(known_m).any() else "estimate"
            name = f"target {section.name}" if len(sections) > 1 else "target"
            yield MapTrack(name, None, source, TARGET, places)


def _rings(mission: Mission, record: FlightRecord, earth: _Earth) -> Iterator[MapLine]:
    """Return the rings that were flown, as last desired, about the target where it was when one last encircled it."""
    for number, ring in enumerate(ring_references(mission, record)):
        of_ring = record.of_ring(number)
        path_m = of_ring.target_path_m
        flown = np.any([track.encircles() for track in of_ring.vehicles], axis=0) & np.isfinite(path_m).all(axis=1)
        if not flown.any():
            continue
        x, y = path_m[np.flatnonzero(flown)[-1]].tolist()
        lowest_m = min(vehicle.section.altitude_m for vehicle in mission.vehicles)
        settings = mission.rings[number].encirclement if mission.rings else mission.encirclement
        height_m = min(ring.heights_m.values(), default=settings.lowest_m(lowest_m))
        name = f"ring {mission.rings[number].name}" if len(mission.rings) > 1 else "ring"
        places = tuple(earth.place(each) for each in _circle_m((x, y, height_m), ring))
        yield MapLine(f"{name}, radius {ring.radius_m:g} m", FAINT, places)


def _circle_m(centre_m: Triple, ring: DesiredRing) -> Iterator[Triple]:
    """Return points of a ring, counter-clockwise."""
    x, y, z = centre_m
    for k, (off_x, off_y) in enumerate(ring.outline_m(RING_POINTS).tolist()):
        yield x + off_x, y + off_y, z + ring.rise_m * cos(tau * k / RING_POINTS - ring.highest_rad)


def _fences(mission: Mission, earth: _Earth) -> Iterator[MapLine]:
    """Return the fences on the ground, each with the vehicles that it encloses."""
    inside: dict[tuple[tuple[float, float], ...], list[int]] = {}
    for vehicle in mission.vehicles:
        if corners_m := vehicle.section.limits(mission.safety).fence_m:
            inside.setdefault(tuple(corners_m), []).append(vehicle.id)
    for corners_m, vehicles in inside.items():
        name = "fence" if len(inside) == 1 else f"fence of {named(vehicles)}"
        yield MapLine(name, FAIL, tuple(earth.place((x, y, 0.0)) for x, y in corners_m))


def _zones(mission: Mission, earth: _Earth) -> Iterator[MapZone]:
    zones = mission.safety.no_fly
    for zone, outline_m in zip(zones, shapes_of(zones, 0.0), strict=True):
        places = tuple(earth.place((x, y, 0.0)) for x, y in outline_m.tolist())
        outline = MapLine(f"no-fly zone {zone.name}", FAIL, places)
        yield MapZone(zone.name, zone.floor_m, zone.ceiling_m, outline)


def _starts(mission: Mission, vehicles: Sequence[int], earth: _Earth) -> Iterator[MapPoint]:
    for vehicle_id in vehicles:
        x, y = mission.vehicle(vehicle_id).section.start_m
        name = f"start of vehicle {vehicle_id}"
        yield MapPoint(name, vehicle_id, "start", "place on the ground", earth.place((x, y, 0.0)))


def _events(
    record: FlightRecord, start_s: float, tracks: Mapping[int | None, MapTrack], earth: _Earth
) -> Iterator[MapPoint]:
    """Return the events of the vehicles with a track, each where its vehicle was last known to be then."""
    stamps_s = {vehicle: [each.unix_s for each in track.places] for vehicle, track in tracks.items()}
    for event in record.events:
        if stamps := stamps_s.get(event.vehicle):
            unix_s = earth.unix_s(start_s + event.time_s)
            place = tracks[event.vehicle].places[max(bisect_right(stamps, unix_s + _EARLY_S) - 1, 0)].place
            text = printable(event.text)
            yield MapPoint(f"{event.vehicle}: {text}", event.vehicle, event.kind, text, place, unix_s)
