"""The mission file: its sections, as a user writes them in TOML. Unknown keys are errors, numbers are finite."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import dist, radians
from pathlib import Path
from typing import Annotated, Any, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from agents.ring.place import chord_m
from agents.settings.config import AgentConfig, RingConfig
from agents.settings.sections import (
    NAME_PATTERN,
    ChoreographySettings,
    DecisionSettings,
    EncirclementSection,
    EncirclementSettings,
    ExcitationSettings,
    FailsafeSettings,
    Fence,
    FormationSettings,
    GimbalSettings,
    SafetySettings,
    pair,
    pairs,
)
from agents.settings.shapes import gap_m
from agents.team.messages import MissionIdentity
from agents.team.text import printable
from estimation.frames import Geodetic, MissionFrame, Triple
from estimation.plant.model import Plant
from estimation.profile.autopilots import DEFAULT, AutopilotName
from estimation.profile.profile import Profile
from estimation.settings import OwnFilterSettings, Settings, TargetBehaviour, TargetFilterSettings
from estimation.vectors import Pair
from gcs.autopilots.registry import autopilot_of
from gcs.mission.overrides import overridden, places
from sitl.reacting_target import Evasion
from sitl.world import Leg, TargetMotion

BITS_A_BYTE = 10
"""On a serial line: a start bit, eight data bits, a stop bit."""

BytesPerSecond = Annotated[float, Field(ge=100.0, le=1e9)]
RateChoice = Literal["fixed", "auto"]


def connection_url(url: str) -> str:
    """Return the url of a vehicle's connection; raises ValueError for anything else."""
    scheme, _, rest = url.partition("://")
    host, _, port = rest.rpartition(":")
    if scheme == "serial" and host and port.isdecimal() and int(port) > 0:
        return url
    known = ("udpin", "udpout", "tcpin", "tcpout")
    if scheme not in known or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError("a vehicle's url is like udpin://127.0.0.1:14540 or serial:///dev/ttyUSB0:57600")
    return url


class LinkSection(Settings):
    """`[link]`: message rates between cordon and each vehicle (docs/hardware.md)."""

    telemetry_rate_hz: float = Field(20.0, ge=1.0, le=50.0, description="rate of position and velocity")
    attitude_rate_hz: float = Field(
        10.0, ge=5.0, le=50.0, description="rate of the attitude while the vehicle's clock is measured"
    )
    status_rate_hz: float = Field(2.0, ge=0.2, le=10.0, description="rate of status messages")
    setpoint_rate_hz: float | None = Field(None, ge=1.0, le=100.0, description="rate of setpoints; none: every tick")
    bytes_per_s: BytesPerSecond | None = Field(
        None, description="data rate of a connection, both directions; none: that of a serial device, else unlimited"
    )
    rates: RateChoice = Field(
        "fixed", description="`auto`: lowered to what the connection carries, raised for losses in bursts"
    )
    feedforward: bool | None = Field(None, description="refuse profiles without velocities (true) or with them (false)")
    signing_key_file: str | None = Field(
        None,
        min_length=1,
        description="MAVLink 2 signing keys, a file beside the mission (`cordon keys issue mavlink`)",
    )


class SharedLinkSection(Settings):
    """`[links.NAME]`: a connection that several vehicles share, such as a mesh radio; system ids distinguish them."""

    url: Annotated[str, AfterValidator(connection_url)] = Field(description="the connection")
    bytes_per_s: BytesPerSecond | None = Field(None, description="in place of that of `[link]`")
    rates: RateChoice | None = Field(None, description="in place of that of `[link]`")


def capacity_bytes_s(url: str, given: float | None) -> float | None:
    """Return a connection's data rate, both directions together: as given, by its serial rate, or None: unlimited."""
    scheme, _, rest = url.partition("://")
    if given is not None or scheme != "serial":
        return given
    return int(rest.rpartition(":")[2]) / BITS_A_BYTE


def _endpoint(text: str) -> str:
    protocol, _, rest = text.partition("/")
    host, _, port = rest.rpartition(":")
    if protocol not in ("tcp", "udp", "tls", "quic") or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError("a Zenoh endpoint is like tcp/127.0.0.1:7461")
    return text


PARTS_MAX = 1000
"""Maximum number of legs of the target's path, and of intervals in which it is not seen."""

TARGET_SPEED_MAX_M_S = 20.0
"""Maximum speed of a simulated target that follows legs or reacts."""

_NAME_MAX = 24
"""Maximum length of the name of a target or a ring."""
TEAM_PATTERN = r"^[A-Za-z0-9_-]{1,32}$"

Metre = Annotated[float, Field(ge=-1e5, le=1e5)]
Metres2 = Annotated[tuple[Metre, Metre], BeforeValidator(pair)]
Metres3 = Annotated[tuple[Metre, Metre, Metre], BeforeValidator(pair)]
Velocity = Annotated[float, Field(ge=-20.0, le=20.0)]
Velocity2 = Annotated[tuple[Velocity, Velocity], BeforeValidator(pair)]
Interval = tuple[Annotated[float, Field(ge=0.0, le=86400.0)], Annotated[float, Field(ge=0.0, le=86400.0)]]
Intervals = Annotated[tuple[Interval, ...], Field(max_length=PARTS_MAX), BeforeValidator(pairs)]
Acceleration = Annotated[float, Field(ge=-10.0, le=10.0)]
Acceleration2 = Annotated[tuple[Acceleration, Acceleration], BeforeValidator(pair)]


_Share = Annotated[float, Field(ge=0.0, le=1.0)]
Changes = Annotated[
    tuple[tuple[Annotated[float, Field(ge=0.0, le=86400.0)], _Share, _Share], ...],
    Field(max_length=PARTS_MAX),
    BeforeValidator(pairs),
]


CORDONS_PLANNER = "cordon"


class MissionSection(Settings):
    """`[mission]`: name, duration and control loop."""

    name: str = Field(min_length=1, max_length=60, description="name of the mission, in outputs and logs")
    description: str = Field("", description="one sentence for `cordon missions`")
    duration_s: float = Field(gt=0.0, le=86400.0, description="time from the start to the landing")
    rate_hz: float = Field(10.0, ge=2.0, le=100.0, description="rate of the control loop")
    seed: int = Field(0, ge=0, description="seed of all random numbers")
    planner: str = Field(
        CORDONS_PLANNER,
        min_length=1,
        max_length=200,
        description="a user's planner, `module:Class` or the name of an entry point (docs/planners.md)",
    )
    format: Literal[2] = Field(2, description="version of the keys")


class FrameSection(Settings):
    """`[frame]`: the mission frame. x points along the formation's way, y to its left, z up (docs/indoor.md for
    `local`).
    """

    latitude_deg: float | None = Field(None, ge=-89.0, le=89.0, description="origin; required unless `local`")
    longitude_deg: float | None = Field(None, ge=-180.0, le=180.0, description="origin; required unless `local`")
    altitude_m: float | None = Field(
        None, ge=-500.0, le=9000.0, description="origin above sea level; required unless `local`"
    )
    local: bool = Field(False, description="the frame has no position on Earth, as indoors")
    external_positions: bool = Field(False, description="send the autopilots positions from motion capture or UWB")
    x_bearing_deg: float = Field(0.0, ge=-360.0, le=360.0, description="bearing of the x axis, clockwise from north")


class SensorSection(Settings):
    """`[target.sensor]`: a vehicle's sensor of the simulated target. With another source its rate and noise are those
    of the reports.
    """

    range_m: float = Field(gt=0.0, le=10000.0, description="largest distance of a sighting")
    rate_hz: float = Field(5.0, gt=0.0, le=50.0, description="rate of the sightings")
    noise_m: float = Field(0.0, ge=0.0, le=100.0, description="standard deviation per axis")
    outlier_share: float = Field(0.0, ge=0.0, le=0.5, description="share of the sightings that are outliers")
    outlier_m: float = Field(10.0, gt=0.0, le=1000.0, description="error of an outlier, in a random direction")
    delay_s: float = Field(0.0, ge=0.0, le=5.0, description="delay of the sightings")
    blind_s: Intervals = Field((), description="intervals of mission time without sightings")
    names: bool = Field(True, description="with several targets: sightings name their target")


class SensorChange(SensorSection):
    """`sensor` of a vehicle: values that replace those of `[target.sensor]` for this vehicle."""

    range_m: float = Field(10000.0, gt=0.0, le=10000.0, description="largest distance of a sighting")


class ChecklistItem(Settings):
    """`[[checklist]]`: what people check before take-off. Nothing is armed until all required items are ticked, on the
    operator's page or by `--checklist-done NAME`.
    """

    text: str = Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$", description="what to check")
    required: bool = Field(True, description="whether take-off waits for it")


CHECKLIST_MAX = 50


class LegSection(Settings):
    """`[[target.legs]]`: a straight leg of the simulated target's path."""

    to_m: Metres2 = Field(description="end of the leg, x and y")
    speed_m_s: float = Field(gt=0.0, le=TARGET_SPEED_MAX_M_S, description="speed along the leg")
    pause_s: float = Field(0.0, ge=0.0, le=3600.0, description="time at its end")


class EvadesSection(Settings):
    """`[target.evades]`: a simulated target that flees vehicles, in `cordon sim` only (docs/target.md)."""

    speed_m_s: float = Field(1.5, gt=0.0, le=TARGET_SPEED_MAX_M_S, description="highest speed")
    acceleration_m_s2: float = Field(0.5, gt=0.0, le=10.0, description="highest acceleration")
    distance_m: float = Field(25.0, gt=0.0, le=10000.0, description="distance within which it flees vehicles")


class TargetSection(TargetBehaviour):
    """`[target]`: the target's motion and value, and how the target filter follows it (docs/target.md). `[[targets]]`
    are several, with these keys but the filter's.
    """

    name: str = Field("", max_length=_NAME_MAX, pattern=NAME_PATTERN, description="name, required in `[[targets]]`")
    source: Literal["simulated", "external", "mavlink"] = Field(
        "simulated",
        description="`external`: sightings from the bus; `mavlink`: a vehicle's telemetry. Plans use the motion below",
    )
    url: Annotated[str, AfterValidator(connection_url)] | None = Field(
        None, description="connection to the target, for `mavlink`"
    )
    system_id: int | None = Field(None, ge=1, le=254, description="MAVLink id of the target, for `mavlink`")
    start_m: Metres2 = Field(description="position at the start, x and y")
    velocity_m_s: Velocity2 = Field((0.0, 0.0), description="constant velocity; or use `legs`")
    legs: Annotated[tuple[LegSection, ...], Field(max_length=PARTS_MAX), BeforeValidator(pair)] = Field(
        (), description="path of `[[target.legs]]`, then rest"
    )
    rounds: int = Field(1, ge=1, le=1000, description="how many times the legs are flown")
    evades: EvadesSection | None = Field(None, description="see `[target.evades]`; in place of a path")
    altitude_m: float | None = Field(
        None, ge=-500.0, le=9000.0, description="altitude above the origin, which simulated sensors then report"
    )
    importance: float = Field(ge=0.0, le=1.0, description="importance, for `[decision]`")
    threat: float = Field(ge=0.0, le=1.0, description="threat, for `[decision]`")
    changes: Changes = Field(
        (), description="times, each with the importance and the threat that simulated sensors report from then on"
    )
    sensor: SensorSection = Field(description="the vehicles' sensor of the target")

    @model_validator(mode="after")
    def _is_one_target(self) -> Self:
        if any(later[0] <= before[0] for before, later in pairwise(self.changes)):
            raise ValueError("the times of the changes must rise")
        if self.legs and self.velocity_m_s != (0.0, 0.0):
            raise ValueError("a target has either legs or velocity_m_s: leave one of them out")
        if self.evades is not None and (self.legs or self.velocity_m_s != (0.0, 0.0) or self.source != "simulated"):
            raise ValueError("a target that evades is simulated and has neither legs nor velocity_m_s: leave them out")
        named = self.url is not None and self.system_id is not None
        if named != (self.source == "mavlink") or (self.url is None) != (self.system_id is None):
            raise ValueError('source = "mavlink" needs a url and a system_id; other sources have neither')
        return self

    @property
    def motion(self) -> TargetMotion:
        """The planned motion of the target; for one that evades it is rest at the start."""
        legs = tuple(Leg(leg.to_m, leg.speed_m_s, leg.pause_s) for leg in self.legs)
        return TargetMotion(self.start_m, self.velocity_m_s, legs, self.rounds)

    @property
    def evasion(self) -> Evasion | None:
        """How a target that evades does so, None for any other."""
        evades = self.evades
        return None if evades is None else Evasion(evades.speed_m_s, evades.acceleration_m_s2, evades.distance_m)

    @property
    def has_planned_path(self) -> bool:
        """Whether the target's path is known before the flight: it is simulated and does not react."""
        return self.source == "simulated" and self.evades is None

    @property
    def speed_max_m_s(self) -> float:
        """The highest speed of the planned motion, or of a target that evades."""
        return self.motion.speed_max_m_s if self.evades is None else self.evades.speed_m_s


class RingKeys(Settings):
    """`[[rings]]`: one of several rings; it has keys of `[encirclement]` where it differs from that
    (docs/missions.md).
    """

    name: str | None = Field(
        None,
        min_length=1,
        max_length=_NAME_MAX,
        pattern=NAME_PATTERN,
        description="name; none: that of its target",
    )
    target: str | None = Field(None, max_length=_NAME_MAX, description="name of its target, if there are several")
    places: int = Field(ge=1, le=254, description="how many vehicles fly on it at most")
    shared: bool = Field(False, description="it may cut other rings: their vehicles evade each other")


class RingSection(EncirclementSection, RingKeys):
    """A `[[rings]]` table, completed from `[encirclement]`."""


class SecuritySection(Settings):
    """`[network.security]`: a team on several computers sets one of these keys. For a team on one computer cordon
    makes keys for each flight (docs/security.md).
    """

    keys: str | None = Field(None, min_length=1, description="folder of this computer's keys, beside the mission")
    insecure: bool = Field(
        False, description="no encryption and no authentication: any host that reaches the bus can command the vehicles"
    )

    @model_validator(mode="after")
    def _is_one_or_the_other(self) -> Self:
        if (self.keys is None) != self.insecure:
            raise ValueError("set either keys, the folder of the keys, or insecure = true")
        return self


_RANGE_M = 200.0


class NetworkSection(Settings):
    """`[network]`: the bus over which the team exchanges messages (docs/onboard.md)."""

    team: str = Field("cordon", pattern=TEAM_PATTERN, description="name of the team on the bus")
    router: Annotated[str, AfterValidator(_endpoint)] | None = Field(
        None, description="endpoint of `cordon router`, if all connect to one"
    )
    range_m: float | None = Field(
        None,
        gt=0.0,
        le=100000.0,
        description="radio range between vehicles; none: 200 m, farther where rings or the formation need it",
    )
    delay_s: float = Field(0.0, ge=0.0, le=5.0, description="delay of messages, in `cordon sim` only")
    loss: float = Field(0.0, ge=0.0, lt=1.0, description="share of lost messages, in `cordon sim` only")
    security: SecuritySection | None = Field(None, description="see `[network.security]`")


class SimulationSection(Settings):
    """`[simulation]`: imperfections of simulated vehicles. Keys that do not name stubs apply to `cordon sim` only."""

    position_noise_m: float = Field(0.0, ge=0.0, le=10.0, description="telemetry noise per axis; also of stubs")
    velocity_noise_m_s: float = Field(0.0, ge=0.0, le=10.0, description="telemetry noise per axis; also of stubs")
    wind_m_s2: Acceleration2 = Field((0.0, 0.0), description="constant acceleration, x and y; also of stubs")
    wind_m_s: Velocity2 = Field((0.0, 0.0), description="wind, which accelerates and drags vehicles")
    gusts: bool = Field(False, description="Dryden gusts about `wind_m_s`")
    speed_max_m_s: float | None = Field(None, gt=0.0, le=30.0, description="limit of every motion")
    acceleration_max_m_s2: float | None = Field(None, gt=0.0, le=30.0, description="limit of every motion")
    jerk_max_m_s3: float | None = Field(None, gt=0.0, le=100.0, description="limit of every motion")
    wander_m: float = Field(0.0, ge=0.0, le=5.0, description="slow drift of the position estimate, per axis")
    telemetry_rate_hz: float | None = Field(None, ge=2.0, le=100.0, description="none: one sample a tick")


class VerdictSection(Settings):
    """`[verdicts]`: the tolerances of a flight's verdicts."""

    radius_error_rms_m: float = Field(0.15, gt=0.0, description="C1")
    angular_rate_error_rad_s: float = Field(0.001, gt=0.0, description="C2")
    spacing_error_rms_deg: float = Field(1.5, gt=0.0, description="C3")
    formation_speed_error_rms_m_s: float = Field(0.05, gt=0.0, description="formation")
    formation_spacing_error_rms_m: float = Field(0.1, gt=0.0, description="formation")


class TrueScale(Settings):
    """Factors from the profile's plant to a simulated vehicle's true plant."""

    a0: float = Field(1.0, ge=0.1, le=10.0, description="factor of a0")
    a1: float = Field(1.0, ge=0.1, le=10.0, description="factor of a1")
    feedforward: float = Field(1.0, ge=0.0, le=2.0, description="factor of the feed-forward")


def _by_id(default: Callable[[int], str], description: str) -> Any:
    """Return a field whose default depends on the vehicle's id; an invalid id is reported by its own key."""
    return Field(default_factory=lambda known: default(known.get("id", 1)), description=description)


_STREAMS = ("rtsp", "rtsps", "http", "https")


def _stream_url(url: str) -> str:
    """Return the address of a stream. Logs and pages show it: it must hold no password."""
    try:
        parts = urlsplit(url)
        known = parts.scheme in _STREAMS and bool(parts.hostname) and (parts.port is None or parts.port > 0)
    except ValueError:
        known = False
    if not known or printable(url) != url or " " in url:
        raise ValueError("a stream's address is like rtsp://192.168.1.20:554/main or http://192.168.1.20/video")
    if parts.username is not None:
        raise ValueError("it must not hold a user or a password: logs and pages show it")
    return url


def _gimbal(value: object) -> object:
    """Return the table of a gimbal for `gimbal = true`, and none for false."""
    if value is not None and not isinstance(value, bool | Mapping | GimbalSettings):
        raise ValueError("it must be true, false or a table")
    return value if not isinstance(value, bool) else ({} if value else None)


class VehicleSection(Settings):
    """`[[vehicles]]`: one vehicle. Default ports depend on the id; urls are those of PX4's simulator."""

    id: int = Field(ge=1, le=254, description="id in the team")
    system_id: int | None = Field(None, ge=1, le=254, description="MAVLink system id; none: the id")
    link: str | None = Field(None, description="a name in `[links]`, in place of a url")
    url: Annotated[str, AfterValidator(connection_url)] = _by_id(
        lambda i: f"udpin://127.0.0.1:{autopilot_of(DEFAULT).simulator_port - 1 + i}",
        description="MAVLink connection, such as `serial:///dev/ttyUSB0:57600`",
    )
    endpoint: Annotated[str, AfterValidator(_endpoint)] = _by_id(
        lambda i: f"tcp/127.0.0.1:{7460 + i}", description="Zenoh endpoint of its agent"
    )
    start_m: Metres2 = Field(description="position on the ground, x and y")
    origin_m: Metres3 | None = Field(
        None, description="origin of its local NED in a local `[frame]`; none: `start_m` on the ground"
    )
    slot_m: Metres2 | None = Field(None, description="position in a free formation, x and y from a common point")
    gap: float = Field(1.0, gt=0.0, le=100.0, description="weight of the gap to the next vehicle counter-clockwise")
    altitude_m: float = Field(8.0, ge=1.0, le=500.0, description="flying height above the mission's origin")
    fence_m: Fence | None = Field(None, description="in place of that of `[safety]`")
    altitude_min_m: float | None = Field(None, ge=-500.0, le=9000.0, description="in place of that of `[safety]`")
    altitude_max_m: float | None = Field(None, ge=-500.0, le=9000.0, description="in place of that of `[safety]`")
    reserve: bool = Field(
        False,
        description="stays on the ground until a vehicle runs low or is lost; then takes over",
    )
    profile: str = Field("stub", description="bundled profile, or a file beside the mission")
    autopilot: AutopilotName | None = Field(None, description="what a stub in its place emulates; none: the profile's")
    true_scale: TrueScale = Field(
        TrueScale(), description="factors `a0`, `a1` (0.1 to 10) and `feedforward` (0 to 2) of the true plant, 1.0 each"
    )
    decision: DecisionSettings | None = Field(None, description="keys in place of those of `[decision]`")
    sensor: SensorChange | None = Field(None, description="keys in place of those of `[target.sensor]`")
    camera_url: Annotated[str, AfterValidator(_stream_url)] | None = Field(
        None, max_length=200, description="address of its camera's stream, such as `rtsp://192.168.1.20:554/main`"
    )
    gimbal: Annotated[GimbalSettings | None, BeforeValidator(_gimbal)] = Field(
        None,
        description="its camera looks at the target: `true`, or a table with `target_height_m` (height above the "
        "origin of what is looked at, 0.0) and `view_deg` (angle of view, 60.0)",
    )

    def limits(self, safety: SafetySettings) -> SafetySettings:
        """Return the safety settings of this vehicle: the team's, with its own fence and altitude limits."""
        keys = ("fence_m", "altitude_min_m", "altitude_max_m")
        own = {key: value for key in keys if (value := getattr(self, key)) is not None}
        return safety.model_copy(update=own) if own else safety


def lowest_between_m(vehicles: Sequence[VehicleSection], safety: SafetySettings) -> tuple[float | None, float | None]:
    """Return the altitude limits of the lowest vehicle that keep all vehicles inside their limits.

    The others fly higher by the differences of their `altitude_m`. None for a limit that no vehicle has.
    """
    lowest_m = min(vehicle.altitude_m for vehicle in vehicles)
    limits = [(vehicle.limits(safety), vehicle.altitude_m - lowest_m) for vehicle in vehicles]
    low = [own.altitude_min_m - above_m for own, above_m in limits if own.altitude_min_m is not None]
    high = [own.altitude_max_m - above_m for own, above_m in limits if own.altitude_max_m is not None]
    return max(low, default=None), min(high, default=None)


def rally_spot_m(start_m: Pair, starts_m: Sequence[Pair], place_m: Pair) -> Pair:
    """Return a vehicle's spot [m] at a rally point: from there as far as its start is from the middle of all starts."""
    x, y = (start_m[axis] - sum(each[axis] for each in starts_m) / len(starts_m) + place_m[axis] for axis in (0, 1))
    return x, y


@dataclass(frozen=True, slots=True)
class MissionVehicle:
    """A vehicle of the mission with its profile: the plant its controller assumes, and the one a simulation flies.

    `own_filter` are the settings of its own-state filter, `autopilot` is its autopilot, or what a stub emulates.
    """

    section: VehicleSection
    plant: Plant
    true_plant: Plant
    decision: DecisionSettings
    own_filter: OwnFilterSettings
    autopilot: AutopilotName
    profile: Profile

    @property
    def id(self) -> int:
        """The vehicle's id in the team."""
        return self.section.id

    @property
    def system_id(self) -> int:
        """Its MAVLink system id."""
        return self.section.system_id or self.section.id

    @property
    def origin_m(self) -> Triple:
        """The origin of its local NED in a local mission frame."""
        return self.section.origin_m or (*self.section.start_m, 0.0)


@dataclass(frozen=True, slots=True)
class MissionRing:
    """One of a mission's rings: its name, the number of its target among the mission's, its places and settings.

    It may cut others if it is `shared`.
    """

    name: str
    target: int
    places: int
    encirclement: EncirclementSettings
    shared: bool = False


@dataclass(frozen=True, slots=True)
class Mission:
    """A checked mission, with the text that it was read from.

    `identity` is compared between vehicles and operators (gcs/mission/file.py). `folder` is that of its file. A mission
    that `excites` is the excitation flight of its only vehicle. The last vehicle is `added` if it is not in the mission
    file and joins the flight; `identity` is that of the file. `parse` makes a mission from text, folder and profile
    texts.

    A mission of several targets has them all in `targets`, one of several rings those in `rings`; else these are empty.
    `target` and `encirclement` are the only ones, or those of the first ring: `of_ring` returns the mission of another.
    `decision` is the team's; a vehicle's own thresholds are in `vehicle(id).decision`.
    """

    mission: MissionSection
    frame: FrameSection
    formation: FormationSettings
    encirclement: EncirclementSettings
    decision: DecisionSettings
    safety: SafetySettings
    failsafe: FailsafeSettings
    target_filter: TargetFilterSettings
    target: TargetSection
    network: NetworkSection
    link: LinkSection
    links: Mapping[str, SharedLinkSection]
    choreography: ChoreographySettings
    excitation: ExcitationSettings
    simulation: SimulationSection
    verdicts: VerdictSection
    vehicles: tuple[MissionVehicle, ...]
    text: str = field(compare=False, repr=False)
    profile_texts: Mapping[str, str] = field(compare=False, repr=False)
    parse: "Callable[[str, Path | None, Mapping[str, str] | None], Mission]" = field(compare=False, repr=False)
    identity: MissionIdentity | None = field(default=None, compare=False)
    excites: bool = False
    added: int | None = None
    folder: Path = field(default=Path(), compare=False)
    targets: tuple[TargetSection, ...] = ()
    rings: tuple[MissionRing, ...] = ()
    checklist: tuple[ChecklistItem, ...] = field(default=(), compare=False)

    def of_ring(self, number: int) -> "Mission":
        """Return the mission as one of a single ring and its target; raises IndexError if there is no such ring."""
        if not self.rings:
            return self
        ring = self.rings[number]
        target = self.targets[ring.target] if self.targets else self.target
        return replace(self, target=target, encirclement=ring.encirclement, targets=(), rings=())

    @property
    def alone(self) -> "tuple[Mission, ...]":
        """The mission of each ring, itself if it has one."""
        return tuple(map(self.of_ring, range(max(len(self.rings), 1))))

    @property
    def every_target(self) -> tuple[TargetSection, ...]:
        """All targets, also if there is only one."""
        return self.targets or (self.target,)

    @property
    def ids(self) -> tuple[int, ...]:
        """The vehicles' ids in line order."""
        return tuple(vehicle.id for vehicle in self.vehicles)

    @property
    def gaps(self) -> dict[int, float]:
        """The weights of the ring's gaps."""
        return {vehicle.id: vehicle.section.gap for vehicle in self.vehicles}

    def vehicle(self, vehicle_id: int) -> MissionVehicle:
        """Return the vehicle of an id; raises KeyError if there is none."""
        for vehicle in self.vehicles:
            if vehicle.id == vehicle_id:
                return vehicle
        raise KeyError(vehicle_id)

    def replace(self, **sections: object) -> "Mission":
        """Return a copy of the mission with other values of some keys, checked as a file is.

        Sections are mappings of keys: `replace(encirclement={"radius_m": 12.0})`. `vehicles` are by id:
        `replace(vehicles={2: {"profile": "heavy.toml"}})`. Any other value, also an array of tables, replaces the whole
        key. Profiles are looked up where the mission's are. Raises InputError with every fault.
        """
        return self.parse(overridden(self.text, places(sections, self.ids)), self.folder, self.profile_texts)

    def sensor(self, vehicle_id: int, target: TargetSection | None = None) -> SensorSection:
        """Return a vehicle's sensor of a simulated target; None: that of the first ring."""
        change = self.vehicle(vehicle_id).section.sensor
        return (target or self.target).sensor.model_copy(update=change.model_dump(exclude_unset=True) if change else {})

    @property
    def range_m(self) -> float:
        """The radio range between vehicles; the default suffices for neighbours on the rings and in the formation."""
        if self.network.range_m is not None:
            return self.network.range_m
        rings = [each.encirclement for each in self.rings] or [self.encirclement]
        return max(_RANGE_M, *(chord_m(each.radius_m, 2) for each in rings), self._neighbours_m)

    @property
    def _neighbours_m(self) -> float:
        """The largest distance in the formation of a vehicle and the one on which it keeps station."""
        formation, slots_m = self.formation, [each.section.slot_m for each in self.vehicles]
        if formation.station != "predecessor":
            return 0.0
        placed = [each for each in slots_m if each is not None]
        shape = formation.shape or ("free" if placed else "line")
        if shape == "free":
            return max((dist(*each) for each in pairwise(placed)), default=0.0)
        return gap_m(shape, len(self.ids), self.ids.index(formation.leader), formation.spacing_m)

    def mission_frame(self) -> MissionFrame:
        """Return the mission frame."""
        frame, origin = self.frame, None
        if not (frame.latitude_deg is None or frame.longitude_deg is None or frame.altitude_m is None):
            origin = Geodetic(frame.latitude_deg, frame.longitude_deg, frame.altitude_m)
        return MissionFrame(origin, radians(frame.x_bearing_deg))

    def rally_m(self, vehicle: MissionVehicle) -> tuple[Pair, ...]:
        """Return a vehicle's spots at the rally points [m]."""
        starts_m = [each.section.start_m for each in self.vehicles]
        return tuple(rally_spot_m(vehicle.section.start_m, starts_m, each.place_m) for each in self.safety.rally)

    @property
    def reserves(self) -> tuple[int, ...]:
        """The ids of the vehicles that stay on the ground until one is needed."""
        return tuple(each.id for each in self.vehicles if each.section.reserve)

    @property
    def without_reserves(self) -> "Mission":
        """The mission of the vehicles that take off at its start."""
        flown = tuple(each for each in self.vehicles if not each.section.reserve)
        return self if len(flown) == len(self.vehicles) else replace(self, vehicles=flown)

    def agent_config(self, vehicle: MissionVehicle) -> AgentConfig:
        """Return the configuration of one vehicle's agent."""
        return AgentConfig(
            vehicle_id=vehicle.id,
            slots=self.ids,
            line_start_m=self.formation.start_m or self.vehicle(self.formation.leader).section.start_m,
            altitude_m=vehicle.section.altitude_m,
            rate_hz=self.mission.rate_hz,
            communication_radius_m=self.range_m,
            plant=vehicle.plant,
            formation=self.formation,
            encirclement=self.encirclement,
            decision=vehicle.decision,
            safety=vehicle.section.limits(self.safety),
            failsafe=self.failsafe,
            own_filter=vehicle.own_filter,
            target_filter=self.target_filter,
            choreography=self.choreography,
            home_m=vehicle.section.start_m,
            rally_m=() if self.excites else self.rally_m(vehicle),
            starts_m=tuple(each.section.start_m for each in self.vehicles),
            layers_from_m=max(each.section.altitude_m for each in self.vehicles),
            altitude_lowest_m=min(each.section.altitude_m for each in self.vehicles),
            lowest_between_m=lowest_between_m([each.section for each in self.vehicles], self.safety),
            slots_m=tuple(each.section.slot_m for each in self.vehicles if each.section.slot_m is not None),
            gaps=self.gaps,
            excitation=self.excitation if self.excites else None,
            gimbal=vehicle.section.gimbal,
            profile=vehicle.section.profile,
            targets=tuple(each.name for each in self.targets),
            reserves=self.reserves,
            added=self.added,
            rings=tuple(
                RingConfig(
                    each.name,
                    self.targets[each.target].name if self.targets else "",
                    each.places,
                    each.encirclement,
                    each.shared,
                )
                for each in self.rings
            ),
        )
