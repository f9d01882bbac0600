"""What the operator's page shows, as it is sent to the page: JSON objects, with the names and units of these types.

A page receives a `MissionPicture` first, then a `TeamPicture` several times a second, and events as they come. A
recorded flight is a `FlightPicture`: the same, in one object. What is not known is null, never 0. Positions are in the
mission frame: x, y, and the height above the mission's origin.
"""

from typing import Literal

import msgspec

from agents.team.messages import Verb
from estimation.frames import Triple
from gcs.console.advice import Severity

FlightSource = Literal["flight", "sitl", "hybrid", "bench", "simulation", "log"]
Pair = tuple[float, float]


class _Picture(msgspec.Struct, frozen=True, tag_field="kind", omit_defaults=False):
    """What is sent to a page on its own."""


class PlannedVehicle(msgspec.Struct, frozen=True):
    """A vehicle of the mission: `colour` is #rrggbb, `fence_m` its geofence (a polygon, empty without one)."""

    vehicle_id: int
    colour: str
    start_m: Triple
    altitude_m: float
    fence_m: tuple[Pair, ...] = ()


class OperatorRights(msgspec.Struct, frozen=True):
    """Who commands from this page, and what: empty verbs for a page that only shows."""

    name: str = ""
    may: tuple[Verb, ...] = ()


class TilesPicture(msgspec.Struct, frozen=True):
    """The map tiles that the station serves at `tiles/Z/X/Y`: their levels, and whose they are, as plain text."""

    level_min: int
    level_max: int
    source: str = ""


class MissionPicture(_Picture, frozen=True, tag="mission"):
    """What does not change in flight. `origin_deg` is latitude and longitude, None for a mission in a local frame.

    `x_bearing_deg` is the bearing of the x axis, clockwise from north. `tiles` is None without map tiles.
    """

    mission: str
    source: FlightSource
    duration_s: float
    rate_hz: float
    origin_deg: Pair | None
    x_bearing_deg: float
    ring_radius_m: float
    ring_rate_rad_s: float
    separation_m: float
    keep_out_m: float
    altitude_min_m: float | None
    altitude_max_m: float | None
    vehicles: tuple[PlannedVehicle, ...]
    operator: OperatorRights = OperatorRights()
    tiles: TilesPicture | None = None


class VehiclePicture(msgspec.Struct, frozen=True):
    """One vehicle at one time. `age_s` is that of its last message on the wall's clock, None before the first.

    `is_stale` is whether it must not be drawn as if it flew there: its messages stopped, or its link is cut.
    `link_age_s` is how long its autopilot has been silent, as its agent reports. `yaw_rad` is that of its setpoint.
    `advice` is what to do about the alert. `nearest_m` is the horizontal distance to the nearest other vehicle that
    flies, and the margin that to the fence (negative: outside). `ending` is how its flight ended, empty while it is on.
    """

    vehicle_id: int
    age_s: float | None = None
    is_stale: bool = True
    has_ended: bool = False
    tactic: str = ""
    mode: str = ""
    position_m: Triple | None = None
    yaw_rad: float | None = None
    velocity_m_s: Pair | None = None
    setpoint_m: Pair | None = None
    battery: float | None = None
    endurance_s: float | None = None
    satellites: int | None = None
    gps_fix: str = ""
    estimator: str = ""
    link_age_s: float | None = None
    nearest_id: int | None = None
    nearest_m: float | None = None
    fence_margin_m: float | None = None
    radius_m: float | None = None
    angular_rate_rad_s: float | None = None
    lead_rad: float | None = None
    alert: str = ""
    advice: str = ""
    severity: Severity = "information"
    ending: str = ""


class TargetPicture(msgspec.Struct, frozen=True):
    """The target by the newest estimate: position, velocity, covariance (xx, xy, yy), and the age of the sighting."""

    position_m: Pair
    velocity_m_s: Pair
    covariance_m2: Triple
    sighting_age_s: float


class TeamPicture(_Picture, frozen=True, tag="team"):
    """The team at one time: `time_s` since the mission's start (None before), `wall_s` in Unix time.

    `ring_members` fly on the ring, of all vehicles. `ending` is how the flight ended, empty while it is on.
    `link` is what keeps the page from the team, empty when nothing does. `remaining_s` is left of the mission, None
    before its start.
    """

    time_s: float | None
    wall_s: float
    vehicles: tuple[VehiclePicture, ...]
    target: TargetPicture | None = None
    ring_members: int = 0
    ending: str = ""
    link: str = ""
    remaining_s: float | None = None


class EventPicture(_Picture, frozen=True, tag="event"):
    """Something that happened; `vehicle_id` None is for the team or the page. Numbers grow by one."""

    number: int
    time_s: float | None
    wall_s: float
    severity: Severity
    text: str
    vehicle_id: int | None = None


class AnswerPicture(_Picture, frozen=True, tag="answer"):
    """What became of a command of this page, `after_s` its first transmission; final for the vehicle if `is_final`.

    A refusal of the server itself has vehicle None.
    """

    request: str
    verb: Verb
    vehicle_id: int | None
    did: str
    after_s: float
    is_obeyed: bool
    is_final: bool


class FlightPicture(_Picture, frozen=True, tag="flight"):
    """A recorded flight: its pictures at an even rate, and all events."""

    mission: MissionPicture
    teams: tuple[TeamPicture, ...]
    events: tuple[EventPicture, ...]


class CommandRequest(msgspec.Struct, frozen=True, tag_field="kind", tag="command", forbid_unknown_fields=True):
    """What a page asks for: a command to these vehicles (None: all). `request` names it, so that none is sent twice.

    `confirmation` is the word that was typed for a kill, and `overrides_pilot` whether a vehicle is to be taken back
    from its pilot.
    """

    request: str
    verb: Verb
    vehicles: tuple[int, ...] | None
    confirmation: str = ""
    overrides_pilot: bool = False
