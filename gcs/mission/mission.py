"""The mission file: its sections, as a user writes them in TOML. Unknown keys are errors, numbers are finite."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import radians
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from agents.settings.config import AgentConfig
from agents.settings.sections import (
    ChoreographySettings,
    DecisionSettings,
    EncirclementSettings,
    ExcitationSettings,
    FailsafeSettings,
    Fence,
    FormationSettings,
    SafetySettings,
    pair,
    pairs,
)
from agents.team.messages import MissionIdentity
from estimation.frames import Geodetic, MissionFrame, Triple
from estimation.plant.model import Plant
from estimation.profile.autopilots import DEFAULT, AutopilotName
from estimation.profile.profile import Profile
from estimation.settings import OwnFilterSettings, Settings, TargetBehaviour, TargetFilterSettings
from gcs.autopilots.registry import known_as
from gcs.mission.links import LinkSection, SharedLinkSection, connection_url
from gcs.mission.overrides import overridden, places
from sitl.world import Leg, TargetMotion


def _endpoint(text: str) -> str:
    protocol, _, rest = text.partition("/")
    host, _, port = rest.rpartition(":")
    if protocol not in ("tcp", "udp", "tls", "quic") or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError("a Zenoh endpoint is like tcp/127.0.0.1:7461")
    return text


PARTS_MAX = 1000
"""Maximum number of legs of the target's path, and of intervals in which it is not seen."""

TARGET_SPEED_MAX_M_S = 20.0
"""Maximum speed of a simulated target along its legs."""

Metre = Annotated[float, Field(ge=-1e5, le=1e5)]
Metres2 = Annotated[tuple[Metre, Metre], BeforeValidator(pair)]
Metres3 = Annotated[tuple[Metre, Metre, Metre], BeforeValidator(pair)]
Velocity = Annotated[float, Field(ge=-20.0, le=20.0)]
Velocity2 = Annotated[tuple[Velocity, Velocity], BeforeValidator(pair)]
Interval = tuple[Annotated[float, Field(ge=0.0, le=86400.0)], Annotated[float, Field(ge=0.0, le=86400.0)]]
Intervals = Annotated[tuple[Interval, ...], Field(max_length=PARTS_MAX), BeforeValidator(pairs)]
Acceleration = Annotated[float, Field(ge=-10.0, le=10.0)]
Acceleration2 = Annotated[tuple[Acceleration, Acceleration], BeforeValidator(pair)]


class MissionSection(Settings):
    """`[mission]`: name, description, duration, control loop rate, seed of random numbers, `format` (1: cordon 0.1)."""

    name: str = Field(min_length=1, max_length=60)
    description: str = ""
    duration_s: float = Field(gt=0.0, le=86400.0)
    rate_hz: float = Field(10.0, ge=2.0, le=100.0)
    seed: int = Field(0, ge=0)
    format: Literal[1, 2] = 2


class FrameSection(Settings):
    """`[frame]`: the mission frame's origin on Earth, and the bearing of its x axis clockwise from north. Latitude,
    longitude and altitude are required unless `local` is true. A local frame has no position on Earth and needs no
    GPS, as indoors; every vehicle's `origin_m` is then the origin of its local NED frame. With `external_positions`
    cordon sends the autopilots their positions, received from motion capture or UWB on the team's bus (docs/indoor.md).
    """

    latitude_deg: float | None = Field(None, ge=-89.0, le=89.0)
    longitude_deg: float | None = Field(None, ge=-180.0, le=180.0)
    altitude_m: float | None = Field(None, ge=-500.0, le=9000.0)
    local: bool = False
    external_positions: bool = False
    x_bearing_deg: float = Field(0.0, ge=-360.0, le=360.0)


class SensorSection(Settings):
    """`[target.sensor]`: range, rate and noise of a vehicle's sensor of the simulated target. `outlier_share` of the
    sightings are outliers, off by `outlier_m` in a random direction. Sightings arrive `delay_s` late. `blind_s` holds
    intervals of mission time without sightings.
    """

    range_m: float = Field(gt=0.0, le=10000.0)
    rate_hz: float = Field(5.0, gt=0.0, le=50.0)
    noise_m: float = Field(0.0, ge=0.0, le=100.0)
    outlier_share: float = Field(0.0, ge=0.0, le=0.5)
    outlier_m: float = Field(10.0, gt=0.0, le=1000.0)
    delay_s: float = Field(0.0, ge=0.0, le=5.0)
    blind_s: Intervals = ()


class SensorChange(Settings):
    """`sensor` of a vehicle: values that replace those of `[target.sensor]` for this vehicle."""

    range_m: float | None = Field(None, gt=0.0, le=10000.0)
    rate_hz: float | None = Field(None, gt=0.0, le=50.0)
    noise_m: float | None = Field(None, ge=0.0, le=100.0)
    outlier_share: float | None = Field(None, ge=0.0, le=0.5)
    outlier_m: float | None = Field(None, gt=0.0, le=1000.0)
    delay_s: float | None = Field(None, ge=0.0, le=5.0)
    blind_s: Intervals | None = None


class LegSection(Settings):
    """`[[target.legs]]`: a straight leg of the simulated target's path, and how long the target stays at its end."""

    to_m: Metres2
    speed_m_s: float = Field(gt=0.0, le=TARGET_SPEED_MAX_M_S)
    pause_s: float = Field(0.0, ge=0.0, le=3600.0)


class TargetSection(TargetBehaviour):
    """`[target]`: the target's start, motion, importance and threat. It moves at `velocity_m_s`, or along its `legs`
    one after the other, `rounds` times, and then stays. With source "external" it is not simulated: sightings come over
    the bus (docs/target.md), and the motion given here is used for planning only. With "mavlink" it is the vehicle
    `system_id` on `url`; the sensor's rate and noise are those of its position reports. With `altitude_m`, above the
    mission's origin, simulated sensors report the altitude, too. The last six keys are the target filter's motion
    model: the velocity is constant but for `acceleration_noise_m_s2`, a density per root second. When sightings
    contradict that, the velocity may have changed by `manoeuvre_speed_m_s`, and for some time the target may
    accelerate by `manoeuvre_acceleration_m_s2`. `velocity_prior_m_s` is the standard deviation of the velocity before
    the first sightings. Without sightings the velocity is kept for about `coast_s`; after `stale_after_s` the position
    is unknown, and vehicles on the ring hold.
    """

    source: Literal["simulated", "external", "mavlink"] = "simulated"
    url: Annotated[str, AfterValidator(connection_url)] | None = None
    system_id: int | None = Field(None, ge=1, le=254)
    start_m: Metres2
    velocity_m_s: Velocity2 = (0.0, 0.0)
    legs: Annotated[tuple[LegSection, ...], Field(max_length=PARTS_MAX), BeforeValidator(pair)] = ()
    rounds: int = Field(1, ge=1, le=1000)
    altitude_m: float | None = Field(None, ge=-500.0, le=9000.0)
    importance: float = Field(ge=0.0, le=1.0)
    threat: float = Field(ge=0.0, le=1.0)
    sensor: SensorSection

    @model_validator(mode="after")
    def _is_one_target(self) -> Self:
        if self.legs and self.velocity_m_s != (0.0, 0.0):
            raise ValueError("a target has either legs or velocity_m_s: leave one of them out")
        named = self.url is not None and self.system_id is not None
        if named != (self.source == "mavlink") or (self.url is None) != (self.system_id is None):
            raise ValueError('source = "mavlink" needs a url and a system_id; other sources have neither')
        return self

    @property
    def motion(self) -> TargetMotion:
        """The simulated target's motion."""
        legs = tuple(Leg(leg.to_m, leg.speed_m_s, leg.pause_s) for leg in self.legs)
        return TargetMotion(self.start_m, self.velocity_m_s, legs, self.rounds)


class SecuritySection(Settings):
    """`[network.security]`: `keys` is the folder of this computer's keys (`cordon keys`), beside the mission. A team on
    several computers needs this section; for a team on one computer, cordon creates keys for each flight. With
    `insecure = true` nothing on the bus is encrypted or authenticated: any host that reaches it can command the
    vehicles.
    """

    keys: str | None = Field(None, min_length=1)
    insecure: bool = False

    @model_validator(mode="after")
    def _is_one_or_the_other(self) -> Self:
        if (self.keys is None) != self.insecure:
            raise ValueError("set either keys, the folder of the keys, or insecure = true")
        return self


class NetworkSection(Settings):
    """`[network]`: the team's name on the bus, the radio range between vehicles, and the address of `cordon router`, if
    all connect to a router instead of to each other (docs/onboard.md). Delay and loss apply to the simulation only."""

    team: str = Field("cordon", pattern=r"^[A-Za-z0-9_-]{1,32}$")
    router: Annotated[str, AfterValidator(_endpoint)] | None = None
    range_m: float = Field(200.0, gt=0.0, le=100000.0)
    delay_s: float = Field(0.0, ge=0.0, le=5.0)
    loss: float = Field(0.0, ge=0.0, lt=1.0)
    security: SecuritySection | None = None


class SimulationSection(Settings):
    """`[simulation]`: imperfections of simulated and stub vehicles: telemetry noise, and a constant acceleration
    `wind_m_s2`. All other keys apply to `cordon sim` only: limits that shape every motion; a wind speed, which
    accelerates and drags vehicles, with Dryden `gusts`; a slowly drifting position estimate (standard deviation per
    axis); and a telemetry rate other than one sample for each tick.
    """

    position_noise_m: float = Field(0.0, ge=0.0, le=10.0)
    velocity_noise_m_s: float = Field(0.0, ge=0.0, le=10.0)
    wind_m_s2: Acceleration2 = (0.0, 0.0)
    wind_m_s: Velocity2 = (0.0, 0.0)
    gusts: bool = False
    speed_max_m_s: float | None = Field(None, gt=0.0, le=30.0)
    acceleration_max_m_s2: float | None = Field(None, gt=0.0, le=30.0)
    jerk_max_m_s3: float | None = Field(None, gt=0.0, le=100.0)
    wander_m: float = Field(0.0, ge=0.0, le=5.0)
    telemetry_rate_hz: float | None = Field(None, ge=2.0, le=100.0)


class VerdictSection(Settings):
    """`[verdicts]`: the tolerances of a flight's verdicts."""

    radius_error_rms_m: float = Field(0.15, gt=0.0)
    angular_rate_error_rad_s: float = Field(0.001, gt=0.0)
    spacing_error_rms_deg: float = Field(1.5, gt=0.0)
    formation_speed_error_rms_m_s: float = Field(0.05, gt=0.0)
    formation_spacing_error_rms_m: float = Field(0.1, gt=0.0)


class TrueScale(Settings):
    """Factors from the profile's plant to a simulated vehicle's true plant."""

    a0: float = Field(1.0, ge=0.1, le=10.0)
    a1: float = Field(1.0, ge=0.1, le=10.0)
    feedforward: float = Field(1.0, ge=0.0, le=2.0)


def _by_id(default: Callable[[int], str]) -> Any:
    """Return a field whose default depends on the vehicle's id; an invalid id is reported by its own key."""
    return Field(default_factory=lambda known: default(known.get("id", 1)))


class VehicleSection(Settings):
    """`[[vehicles]]`: one vehicle. `system_id` is its MAVLink system id, by default its id. `url` is its MAVLink
    connection, `endpoint` its agent's Zenoh endpoint; by default both are on this computer, at ports that depend on the
    id, `url` at those of PX4's simulator. `profile` is a bundled profile or a file beside the mission. `autopilot` is
    the autopilot that a stub in its place emulates, by default the profile's. `origin_m` is the origin of its local NED
    in a local `[frame]`, by default `start_m` on the ground. `slot_m` is its position in a free formation, relative to
    any common point; all vehicles have one, or none. `fence_m`, `altitude_min_m` and `altitude_max_m` replace those of
    `[safety]` for this vehicle. `link` is one of `[links]`, whose url it then uses.
    """

    id: int = Field(ge=1, le=254)
    system_id: int | None = Field(None, ge=1, le=254)
    link: str | None = None
    url: Annotated[str, AfterValidator(connection_url)] = _by_id(
        lambda i: f"udpin://127.0.0.1:{known_as(DEFAULT).simulator_port - 1 + i}"
    )
    endpoint: Annotated[str, AfterValidator(_endpoint)] = _by_id(lambda i: f"tcp/127.0.0.1:{7460 + i}")
    start_m: Metres2
    origin_m: Metres3 | None = None
    slot_m: Metres2 | None = None
    altitude_m: float = Field(8.0, ge=1.0, le=500.0)
    fence_m: Fence | None = None
    altitude_min_m: float | None = Field(None, ge=-500.0, le=9000.0)
    altitude_max_m: float | None = Field(None, ge=-500.0, le=9000.0)
    profile: str = "stub"
    autopilot: AutopilotName | None = None
    true_scale: TrueScale = TrueScale()
    decision: DecisionSettings | None = None
    sensor: SensorChange | None = None

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
class Mission:
    """A checked mission: every section, the vehicles with their profiles, and the text that it was read from.

    `identity` is compared between the vehicles and operators of one team (gcs/mission/file.py). `folder` is that of
    its file. `warnings` list keys at their places in an earlier version, with their present places. A mission that
    `excites` is the excitation flight of its only vehicle. `parse` makes a mission from text, folder and profile texts.
    """

    mission: MissionSection
    frame: FrameSection
    formation: FormationSettings
    encirclement: EncirclementSettings
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
    warnings: tuple[str, ...] = field(default=(), compare=False)
    excites: bool = False
    folder: Path = field(default=Path(), compare=False)

    @property
    def ids(self) -> tuple[int, ...]:
        """The vehicles' ids in line order."""
        return tuple(vehicle.id for vehicle in self.vehicles)

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

    def sensor(self, vehicle_id: int) -> SensorSection:
        """Return a vehicle's sensor of the simulated target."""
        change = self.vehicle(vehicle_id).section.sensor
        return self.target.sensor.model_copy(update={} if change is None else change.model_dump(exclude_none=True))

    def mission_frame(self) -> MissionFrame:
        """Return the mission frame."""
        frame, origin = self.frame, None
        if not (frame.latitude_deg is None or frame.longitude_deg is None or frame.altitude_m is None):
            origin = Geodetic(frame.latitude_deg, frame.longitude_deg, frame.altitude_m)
        return MissionFrame(origin, radians(frame.x_bearing_deg))

    def agent_config(self, vehicle: MissionVehicle) -> AgentConfig:
        """Return the configuration of one vehicle's agent."""
        return AgentConfig(
            vehicle_id=vehicle.id,
            slots=self.ids,
            line_start_m=self.formation.start_m or self.vehicle(self.formation.leader).section.start_m,
            altitude_m=vehicle.section.altitude_m,
            rate_hz=self.mission.rate_hz,
            communication_radius_m=self.network.range_m,
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
            layers_from_m=max(each.section.altitude_m for each in self.vehicles),
            altitude_lowest_m=min(each.section.altitude_m for each in self.vehicles),
            lowest_between_m=lowest_between_m([each.section for each in self.vehicles], self.safety),
            slots_m=tuple(each.section.slot_m for each in self.vehicles if each.section.slot_m is not None),
            excitation=self.excitation if self.excites else None,
        )
