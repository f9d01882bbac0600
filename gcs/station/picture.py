"""The content of the operator's page as it is sent: JSON objects with the names and units of these types.

A page receives a `MissionPicture` first, then a `TeamPicture` several times a second, and events as they come. A
recorded flight is a `FlightPicture`: the same in one object. Unknown values are null, never 0. Positions are in the
mission frame: x, y, and the height above the mission's origin.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import UNSET, UnsetType

from agents.ring.commanded_ring import RingBounds
from agents.settings.sections import CORNERS_MAX, ZONES_MAX, EncirclementSettings
from agents.team.messages import TARGETS_MAX, Goal, RingNumber, RingValues
from agents.team.verbs import VERBS, Verb, VerbRow
from estimation.frames import Triple
from gcs.console.advice import Severity
from gcs.console.vehicle_view import Pair, VehicleView
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.mission import commanded_ring_bounds
from gcs.style import COLOURS

FlightSource = Literal["flight", "sitl", "hybrid", "bench", "simulation", "log", "plan", "unstated"]
"""The kind of the vehicles; "plan" without any, "unstated" if it is not known whether real ones fly."""
SIGHTING_LASTS_MAX_S = 60.0
"""A page repeats a report of the target for this time at most."""


class _Picture(msgspec.Struct, frozen=True, tag_field="kind", omit_defaults=False):
    """An object that is sent to a page by itself."""


class PlannedVehicle(msgspec.Struct, frozen=True):
    """A vehicle of the mission: `colour` is #rrggbb, `fence_m` its geofence (a polygon, empty without one).

    `camera_url` is the address of its camera's stream, empty without one; with a gimbal the camera can be pointed.
    """

    vehicle_id: int
    colour: str
    start_m: Triple
    altitude_m: float
    fence_m: tuple[Pair, ...] = ()
    camera_url: str = ""
    has_gimbal: bool = False


class OperatorRights(msgspec.Struct, frozen=True):
    """The operator of this page and the permitted verbs; none for a read-only page, with the reason as a clause.

    `sights` is whether this computer has a sensor's keys, with which the page reports where the target is.
    """

    name: str = ""
    may: tuple[Verb, ...] = ()
    read_only: str = ""
    sights: bool = False


class TilesPicture(msgspec.Struct, frozen=True):
    """The map tiles that the station serves at `tiles/Z/X/Y`: their levels, and their attribution as plain text."""

    level_min: int
    level_max: int
    source: str = ""


class RingPicture(msgspec.Struct, frozen=True):
    """One of several rings: its name, colour (#rrggbb), places, and the number of its target among the mission's.

    The rest is as in `MissionPicture`.
    """

    name: str
    target: int
    places: int
    colour: str
    ring: RingValues
    ring_bounds: RingBounds


class ZonePicture(msgspec.Struct, frozen=True):
    """A no-fly zone: a polygon, or a circle (then it has no corners), between two heights, None where it has no end."""

    name: str
    polygon_m: tuple[Pair, ...] = ()
    center_m: Pair | None = None
    radius_m: float | None = None
    floor_m: float | None = None
    ceiling_m: float | None = None


class MissionPicture(_Picture, frozen=True, tag="mission"):
    """The constant part of a flight. `origin_deg` is latitude and longitude, None for a mission in a local frame.

    `x_bearing_deg` is the bearing of the x axis, clockwise from north. The ring's altitude is that of its lowest
    vehicle, None if it follows the target's; `ring_bounds` are those of the rings that can be commanded. `tiles` is
    None without map tiles. A mission of several rings has them in `rings`, where `ring` and `ring_bounds` are those of
    the first, and the names of its targets in `targets`; both are missing with one ring. The page shows `team_count`
    teams, each with a stream of its own, of which this is `team_number`, from 0.
    """

    mission: str
    source: FlightSource
    duration_s: float
    rate_hz: float
    origin_deg: Pair | None
    x_bearing_deg: float
    ring: RingValues
    ring_bounds: RingBounds
    separation_m: float
    keep_out_m: float
    altitude_min_m: float | None
    altitude_max_m: float | None
    vehicles: tuple[PlannedVehicle, ...]
    operator: OperatorRights = OperatorRights()
    tiles: TilesPicture | None = None
    verbs: tuple[VerbRow, ...] = tuple(VERBS.values())
    targets: tuple[str, ...] | UnsetType = UNSET
    rings: tuple[RingPicture, ...] | UnsetType = UNSET
    zones: tuple[ZonePicture, ...] = ()
    team_number: int = 0
    team_count: int = 1


class TargetPicture(msgspec.Struct, frozen=True):
    """The target by the newest estimate: position, velocity, covariance (xx, xy, yy), and the age of the sighting.

    `lost_speed_m_s` is set for a target of which no vehicle has an estimate: the largest speed at which it may have
    moved from its last place, which the others are. None while it is estimated.
    """

    position_m: Pair
    velocity_m_s: Pair
    covariance_m2: Triple
    sighting_age_s: float
    lost_speed_m_s: float | None = None


class TrafficPicture(msgspec.Struct, frozen=True):
    """An aircraft outside the team, as it reported itself `age_s` ago; its altitude is None if it is not known."""

    label: str
    position_m: Pair
    velocity_m_s: Pair
    altitude_m: float | None
    age_s: float


class LostPicture(msgspec.Struct, frozen=True):
    """A flight whose messages have stopped while its vehicles may be in the air.

    `reason` is a clause, `vehicles` are those that are unaccounted for, `since_wall_s` is Unix time. `autopilots` is
    what controls the vehicles now, empty if it is not known, `advice` the operator's action. With `processes_ended`
    no process is left that receives commands.
    """

    reason: str
    vehicles: tuple[int, ...]
    since_wall_s: float
    autopilots: str
    advice: str
    processes_ended: bool = False


class TeamPicture(_Picture, frozen=True, tag="team"):
    """The team at one time: `time_s` since the mission's start (None before), `wall_s` in Unix time.

    `ring_members` is the number of vehicles on the ring, `ring` what was commanded in flight, None for nothing.
    `ending` is how the flight ended, empty before. `link` is the fault of the link to the team, empty without one.
    `remaining_s` is the rest of the mission, None before its start. `lost` is set from the loss of a flight in the air
    until the next messages.

    With several rings `target` and `ring` are None: `targets` and `rings` have those of all, in the mission's order.
    `traffic` are aircraft outside the team that a vehicle has received in flight; it is missing without any.
    """

    time_s: float | None
    wall_s: float
    vehicles: tuple[VehicleView, ...]
    target: TargetPicture | None = None
    ring_members: int = 0
    ending: str = ""
    link: str = ""
    remaining_s: float | None = None
    lost: LostPicture | None = None
    ring: RingValues | None = None
    targets: tuple[TargetPicture | None, ...] | UnsetType = UNSET
    rings: tuple[RingValues | None, ...] | UnsetType = UNSET
    traffic: tuple[TrafficPicture, ...] | UnsetType = UNSET


class EventPicture(_Picture, frozen=True, tag="event"):
    """An event; `vehicle_id` None is for the team or the page. Numbers increase by one."""

    number: int
    time_s: float | None
    wall_s: float
    severity: Severity
    text: str
    vehicle_id: int | None = None


class ChecklistItemPicture(msgspec.Struct, frozen=True):
    """An item of the mission's checklist, who has ticked it (empty if it is open), and when in Unix time.

    A tick that is `used` was for the flight that has begun: the next one needs another.
    """

    text: str
    required: bool
    by: str = ""
    wall_s: float | None = None
    used: bool = False


class ChecklistPicture(_Picture, frozen=True, tag="checklist"):
    """The mission's checklist, whether this page may tick it, and why it cannot be read, empty if it can."""

    items: tuple[ChecklistItemPicture, ...]
    fault: str = ""
    may_tick: bool = False


class AnswerPicture(_Picture, frozen=True, tag="answer"):
    """An answer to a command of this page, `after_s` its first transmission; final for the vehicle if `is_final`.

    A refusal of the server itself has vehicle None, and so have the answers to a report of the target.
    """

    request: str
    verb: Verb | Literal["target"]
    vehicle_id: int | None
    did: str
    after_s: float
    is_obeyed: bool
    is_final: bool


class ReceiptPicture(_Picture, frozen=True, tag="receipt"):
    """The receipt of a page's request: until then the page does not know whether it has arrived."""

    request: str


class FlightPicture(_Picture, frozen=True, tag="flight"):
    """A recorded flight: its pictures at an even rate, and all events."""

    mission: MissionPicture
    teams: tuple[TeamPicture, ...]
    events: tuple[EventPicture, ...]


class CommandRequest(msgspec.Struct, frozen=True, tag_field="kind", tag="command", forbid_unknown_fields=True):
    """A page's command to these vehicles (None: all). `request` identifies it, so that it is not sent twice.

    `confirmation` is the word typed for a kill, `overrides_pilot` whether a vehicle may be taken back
    from its pilot, `ring` what the verb ring takes. With several rings `ring_number` is the one that it changes, or
    that the verb assign sends vehicles to, None to let them choose. `place` is what the verb goto takes, and
    the verb look, None for the target.
    """

    request: str
    verb: Verb
    vehicles: tuple[int, ...] | None
    confirmation: str = ""
    overrides_pilot: bool = False
    ring: RingValues | None = None
    ring_number: RingNumber | None = None
    place: Goal | None = None


class SightingRequest(msgspec.Struct, frozen=True, tag_field="kind", tag="sighting", forbid_unknown_fields=True):
    """An operator's report from a page of where the target is, with the standard deviation of the position.

    It is repeated for `lasting_s`. `target` is the number of one of several targets, None of a mission's only one.
    """

    request: str
    position_m: Pair
    sigma_m: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)]
    lasting_s: Annotated[float, msgspec.Meta(ge=0.0, le=SIGHTING_LASTS_MAX_S)] = 0.0
    target: Annotated[int, msgspec.Meta(ge=0, lt=TARGETS_MAX)] | None = None

    @property
    def verb(self) -> Literal["target"]:
        """What its answers name."""
        return "target"


class TickRequest(msgspec.Struct, frozen=True, tag_field="kind", tag="tick", forbid_unknown_fields=True):
    """A tick of an item of the checklist by its number, or the removal of its tick."""

    item: Annotated[int, msgspec.Meta(ge=0)]
    ticked: bool


class PlanPicture(_Picture, frozen=True, tag="plan"):
    """The fence and the no-fly zones of a mission file, to be edited on the page; without a fence no corners."""

    file: str
    fence_m: tuple[Pair, ...]
    zones: tuple[ZonePicture, ...]


class PlanRequest(msgspec.Struct, frozen=True, tag_field="kind", tag="plan", forbid_unknown_fields=True):
    """A fence and no-fly zones from a page, to be checked, and with `save` to be written into the mission file."""

    request: int
    fence_m: Annotated[tuple[Pair, ...], msgspec.Meta(max_length=CORNERS_MAX)]
    zones: Annotated[tuple[ZonePicture, ...], msgspec.Meta(max_length=ZONES_MAX)]
    save: bool = False


class PlanAnswer(_Picture, frozen=True, tag="planned"):
    """The faults of a mission with the fence and the zones of a request, and whether they were saved."""

    request: int
    faults: tuple[str, ...]
    is_saved: bool


class RecoveredRequest(msgspec.Struct, frozen=True, tag_field="kind", tag="recovered", forbid_unknown_fields=True):
    """An operator's confirmation on a page that a vehicle, which was unaccounted for, was recovered."""

    vehicle_id: int


def mission_picture(
    mission: Mission, source: FlightSource, duration_s: float, operator: OperatorRights | None = None
) -> MissionPicture:
    """Return a mission as the page shows it, flown for `duration_s`; without an operator the page is read-only."""
    frame, safety, rings = mission.frame, mission.safety, _rings(mission)
    return MissionPicture(
        mission=mission.mission.name,
        source=source,
        duration_s=duration_s,
        rate_hz=mission.mission.rate_hz,
        origin_deg=origin_deg(mission),
        x_bearing_deg=frame.x_bearing_deg,
        ring=rings[0].ring if rings else _ring_values(mission, mission.encirclement),
        ring_bounds=rings[0].ring_bounds if rings else commanded_ring_bounds(mission),
        separation_m=safety.separation_m,
        keep_out_m=safety.keep_out_m,
        altitude_min_m=safety.altitude_min_m,
        altitude_max_m=safety.altitude_max_m,
        vehicles=tuple(_planned(mission, row, vehicle) for row, vehicle in enumerate(mission.vehicles)),
        operator=operator or OperatorRights(),
        targets=tuple(each.name for each in mission.every_target) if rings else UNSET,
        rings=rings or UNSET,
        zones=tuple(
            ZonePicture(each.name, each.polygon_m, each.center_m, each.radius_m, each.floor_m, each.ceiling_m)
            for each in safety.no_fly
        ),
    )


def _rings(mission: Mission) -> tuple[RingPicture, ...]:
    """Return the rings of a mission of several."""
    return tuple(
        RingPicture(
            each.name,
            each.target,
            each.places,
            COLOURS[-1 - number % len(COLOURS)],
            _ring_values(mission, each.encirclement),
            commanded_ring_bounds(mission, number),
        )
        for number, each in enumerate(mission.rings)
    )


def _ring_values(mission: Mission, ring: EncirclementSettings) -> RingValues:
    lowest_m = min(vehicle.section.altitude_m for vehicle in mission.vehicles)
    altitude_m = None if ring.altitude == "target" else ring.lowest_m(lowest_m)
    return RingValues(ring.radius_m, ring.angular_rate_rad_s, altitude_m, ring.tilt_deg)


def origin_deg(mission: Mission) -> Pair | None:
    """Return latitude and longitude of a mission's origin; None in a local frame."""
    origin = mission.mission_frame().origin
    return None if origin is None else (origin.latitude_deg, origin.longitude_deg)


def _planned(mission: Mission, row: int, vehicle: MissionVehicle) -> PlannedVehicle:
    section = vehicle.section
    return PlannedVehicle(
        vehicle.id,
        COLOURS[row % len(COLOURS)],
        (*section.start_m, 0.0),
        section.altitude_m,
        tuple(section.limits(mission.safety).fence_m or ()),
        section.camera_url or "",
        section.gimbal is not None,
    )
