"""The sections of a mission file that configure an agent, each with its tuning."""

from math import radians, tan
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from agents.settings.shapes import Shape
from agents.settings.tuning import SETPOINTS_FASTER, EncirclementTuning, FailsafeTuning, FormationTuning, SafetyTuning
from estimation.settings import Settings
from estimation.vectors import Pair

CORNERS_MAX = 256
"""Maximum of a fence or a zone: the guard evaluates every edge in every tick."""
ZONES_MAX = 32
ZONE_AREA_LEAST_M2 = 1.0
"""Maximum number of no-fly zones."""
RALLY_MAX = 8
"""Maximum number of rally points."""


def pair(value: object) -> object:
    """Return a list as a tuple: TOML has only lists, which strict validation does not accept for tuples."""
    return tuple(value) if isinstance(value, list) else value


def pairs(value: object) -> object:
    """Return a list of lists as a tuple of tuples."""
    return tuple(map(pair, value)) if isinstance(value, list) else value


NAME_PATTERN = r"^[A-Za-z0-9_-]*$"
"""Letters of the names of targets, rings and zones."""

Fence = Annotated[tuple[tuple[float, float], ...], Field(max_length=CORNERS_MAX), BeforeValidator(pairs)]


class FormationSection(Settings):
    """`[formation]`: the formation. `cordon command formation` changes its shape in flight."""

    spacing_m: float = Field(gt=0.0, le=1000.0, description="distance between neighbours")
    speed_m_s: float = Field(ge=0.0, le=20.0, description="speed along x")
    leader: int = Field(ge=1, le=254, description="id of the vehicle that follows the mission line")
    start_m: Annotated[tuple[float, float], BeforeValidator(pair)] | None = Field(
        None, description="start of the mission line; none: the leader's start"
    )
    shape: Shape | None = Field(
        None, description="shape, behind the leader; none: `free` if vehicles have a `slot_m`, else `line`"
    )
    station: Literal["predecessor", "line"] = Field(
        "predecessor", description="keep station on the next vehicle towards the leader, or on the mission line"
    )
    yaw: Literal["fixed", "path"] = Field("fixed", description="along x, or along the path flown")
    speed_max_m_s: float = Field(2.0, gt=0.0, le=20.0, description="speed of a vehicle that catches up")


class FormationSettings(FormationSection, FormationTuning):
    """All settings of the formation: `[formation]` and `[tuning.formation]`."""


class EncirclementSection(Settings):
    """`[encirclement]`: the ring. `speed_max_m_s` and `acceleration_max_m_s2` take precedence over the limits of
    spacings.
    """

    radius_m: float = Field(gt=0.0, le=1000.0, description="radius of the ring")
    angular_rate_rad_s: float = Field(ge=-2.0, le=2.0, description="rate on the ring; positive is counter-clockwise")
    yaw: Literal["fixed", "target"] = Field("fixed", description="along x, or towards the target")
    altitude: Literal["layers", "target"] = Field(
        "layers", description="`layers`: each at its `altitude_m`; `target`: follow the target's altitude"
    )
    altitude_offset_m: float | None = Field(
        None, ge=-200.0, le=200.0, description="height of the lowest vehicle above the target"
    )
    altitude_m: float | None = Field(
        None, ge=1.0, le=500.0, description="height of the lowest vehicle on the ring; none: its flying height"
    )
    tilt_deg: float = Field(0.0, ge=-60.0, le=60.0, description="inclination: heights on the ring follow bearings")
    tilt_bearing_deg: float = Field(
        0.0, ge=-360.0, le=360.0, description="bearing of an inclined ring's highest point, counter-clockwise from x"
    )
    climb_max_m_s: float = Field(1.0, ge=0.5, le=5.0, description="largest climb rate on the ring and towards it")
    speed_max_m_s: float = Field(3.0, gt=0.0, le=20.0, description="limit of the LMPC")
    acceleration_max_m_s2: float = Field(2.0, gt=0.0, le=20.0, description="limit of the LMPC")
    spacing_speed_max_m_s: float | None = Field(
        None,
        gt=0.0,
        le=20.0,
        description="speed relative to the ring while spacings change; none: from the ring's speed and radius",
    )
    spacing_acceleration_max_m_s2: float | None = Field(
        None,
        gt=0.0,
        le=20.0,
        description="acceleration while spacings change, up to `acceleration_max_m_s2`; none: from the radius",
    )


_FAR_M, _FAR_RADII = 60.0, 3.0


class EncirclementSettings(EncirclementSection, EncirclementTuning):
    """All settings of the encirclement: `[encirclement]` and `[tuning.encirclement]`."""

    @property
    def transition_speed_m_s(self) -> float:
        """The speed of a transition, relative to the ring's speed along it, and towards it."""
        given_m_s = self.spacing_speed_max_m_s
        if given_m_s is not None:
            return min(given_m_s, self.speed_max_m_s)
        ring_m_s = abs(self.angular_rate_rad_s) * self.radius_m
        left_m_s = max(0.9 * self.speed_max_m_s - ring_m_s, 0.5 * ring_m_s, 1.0)
        return min(max(1.0, 0.5 * ring_m_s, 0.1 * self.radius_m), left_m_s, self.speed_max_m_s)

    @property
    def far_m(self) -> float:
        """How far out a vehicle flies straight inwards; it does not follow a commanded radius."""
        return max(_FAR_M, _FAR_RADII * self.radius_m) if self.radius_far_m is None else self.radius_far_m

    @property
    def rise_m(self) -> float:
        """How far the highest point of the ring is above its centre, and the lowest below it, `R tan(tilt)`."""
        return self.radius_m * abs(tan(radians(self.tilt_deg)))

    def lowest_m(self, flying_m: float) -> float:
        """Return the height of the lowest vehicle on the ring, whose flying height is `flying_m`."""
        return flying_m if self.altitude_m is None else self.altitude_m

    def band_m(self, flying_m: float, above_m: float) -> Pair:
        """Return the lowest and the highest height of vehicles on the ring.

        `flying_m` is the lowest flying height of the team, and `above_m` how much higher the highest flies.
        """
        lowest_m = self.lowest_m(flying_m)
        return lowest_m - self.rise_m, lowest_m + above_m + self.rise_m

    @property
    def has_heights(self) -> bool:
        """Whether vehicles on the ring change their heights by the ring's altitude or tilt."""
        return self.altitude_m is not None or self.tilt_deg != 0.0


class DecisionSettings(Settings):
    """When a vehicle leaves the formation for the ring (paper, section 5). A vehicle may override each threshold."""

    importance_min: float = Field(0.6, ge=0.0, le=1.0, description="least importance of the target")
    threat_max: float = Field(0.5, ge=0.0, le=1.0, description="largest threat of the target")
    distance_max_m: float = Field(12.0, gt=0.0, le=10000.0, description="largest distance of the target")


_Height = Annotated[float, Field(ge=-500.0, le=9000.0)]
_Metre = Annotated[float, Field(ge=-1e5, le=1e5)]


class NoFlySection(Settings):
    """`[[safety.no_fly]]`: a zone in which no vehicle flies, a polygon or a circle (docs/safety.md). Edges of a polygon
    do not cross each other.
    """

    name: str = Field(min_length=1, max_length=24, pattern=NAME_PATTERN, description="name of the zone")
    polygon_m: Annotated[tuple[tuple[_Metre, _Metre], ...], Field(max_length=CORNERS_MAX), BeforeValidator(pairs)] = (
        Field((), description="corners, x and y each; or use `center_m` and `radius_m`")
    )
    center_m: Annotated[tuple[_Metre, _Metre], BeforeValidator(pair)] | None = Field(
        None, description="centre of a circle, x and y"
    )
    radius_m: float | None = Field(None, gt=0.0, le=10000.0, description="radius of a circle")
    floor_m: _Height | None = Field(
        None, description="height above the origin where the zone begins; none: at the ground"
    )
    ceiling_m: _Height | None = Field(None, description="height above the origin where the zone ends; none: nowhere")

    @model_validator(mode="after")
    def _is_one_zone(self) -> Self:
        if (self.center_m is None) != (self.radius_m is None):
            raise ValueError("a circle needs both center_m and radius_m")
        if bool(self.polygon_m) == (self.center_m is not None):
            raise ValueError("a zone is either polygon_m, or center_m and radius_m")
        if self.floor_m is not None and self.ceiling_m is not None and self.floor_m >= self.ceiling_m:
            raise ValueError(f"floor_m = {self.floor_m} m is not below ceiling_m = {self.ceiling_m} m")
        return self


class RallySection(Settings):
    """`[[safety.rally]]`: a place where the team can land (docs/zones.md#rally-points). Each vehicle has its spot about
    it, as starts lie about their middle.
    """

    name: str = Field(min_length=1, max_length=24, pattern=NAME_PATTERN, description="name of the place")
    place_m: Annotated[tuple[_Metre, _Metre], BeforeValidator(pair)] = Field(
        description="middle of the vehicles' spots, x and y"
    )


class SafetySection(Settings):
    """`[safety]`: limits that the guard keeps in every tactic (docs/safety.md)."""

    guard: bool = Field(True, description="false switches the guard off, for simulations")
    separation_m: float = Field(1.0, gt=0.0, le=100.0, description="least distance between vehicles")
    vertical_separation_m: float = Field(
        2.0, gt=0.0, le=100.0, description="height difference beyond which vehicles do not evade"
    )
    keep_out_m: float = Field(0.0, ge=0.0, le=1000.0, description="least distance to the target; 0: none")
    traffic_distance_m: float = Field(
        0.0, ge=0.0, le=5000.0, description="distance to keep from aircraft outside the team; 0: none"
    )
    traffic_height_m: float = Field(
        100.0, gt=0.0, le=5000.0, description="height difference beyond which such aircraft do not count"
    )
    fence_m: Fence = Field((), description="corners of the fence, x and y each; empty: none")
    no_fly: Annotated[tuple[NoFlySection, ...], Field(max_length=ZONES_MAX), BeforeValidator(pair)] = Field(
        (), description="zones of `[[safety.no_fly]]`"
    )
    rally: Annotated[tuple[RallySection, ...], Field(max_length=RALLY_MAX), BeforeValidator(pair)] = Field(
        (), description="places of `[[safety.rally]]`"
    )
    altitude_min_m: float | None = Field(None, ge=-500.0, le=9000.0, description="least altitude above the origin")
    altitude_max_m: float | None = Field(None, ge=-500.0, le=9000.0, description="largest altitude above the origin")
    elevation: str | None = Field(
        None,
        min_length=1,
        description="SRTM file beside the mission, such as `N47E008.hgt`: heights are checked with it",
    )
    min_height_above_ground_m: float = Field(
        3.0, ge=0.0, le=1000.0, description="with `elevation`: least height above ground"
    )
    speed_max_m_s: float = Field(5.0, gt=0.0, le=30.0, description="largest speed")
    acceleration_max_m_s2: float = Field(4.0, gt=0.0, le=20.0, description="largest acceleration of an evasion")
    yaw_rate_max_deg_s: float = Field(45.0, gt=0.0, le=360.0, description="largest yaw rate")
    lost_avoided_s: float = Field(
        60.0, ge=0.0, le=3600.0, description="how long the place of a silent vehicle is avoided"
    )
    telemetry_timeout_s: float = Field(
        1.0, gt=0.0, le=30.0, description="time without telemetry until the vehicle holds"
    )
    abort_hover_s: float = Field(5.0, ge=0.0, le=60.0, description="time from an abort to the landing")


class SafetySettings(SafetySection, SafetyTuning):
    """All settings of the safety: `[safety]` and `[tuning.safety]`."""

    @property
    def setpoint_speed_bound_m_s(self) -> float:
        """The highest speed at which plans move the setpoint, which leads a vehicle that accelerates or turns."""
        given_m_s = self.setpoint_speed_max_m_s
        return SETPOINTS_FASTER * self.speed_max_m_s if given_m_s is None else given_m_s


class FailsafeSection(Settings):
    """`[failsafe]`: thresholds and times of the failsafe table (docs/safety.md)."""

    escalation_s: float = Field(
        30.0, ge=1.0, le=3600.0, description="time until the next reaction, while the condition lasts"
    )
    battery_low: float = Field(0.2, ge=0.0, lt=1.0, description="share of the battery left: return and land")
    battery_critical: float = Field(0.1, ge=0.0, lt=1.0, description="share of the battery left: land")
    reserve_s: float = Field(30.0, ge=0.0, le=3600.0, description="flight time left after the way home")
    bus_lost_s: float = Field(2.0, ge=0.0, le=600.0, description="grace time of *bus lost*")
    peers_silent_s: float = Field(3.0, ge=1.0, le=600.0, description="grace time of *all peers silent*")
    peer_silent_s: float = Field(2.0, ge=1.0, le=600.0, description="grace time of *peer silent* and *leader lost*")
    no_operator: Literal["go_on", "hold", "return"] = Field(
        "go_on", description="reaction when the last operator has left the bus"
    )
    no_operator_s: float = Field(10.0, ge=1.0, le=3600.0, description="grace time of *no operator on the bus*")
    resume: Literal["operator", "auto"] = Field(
        "operator",
        description="who resumes a vehicle that stopped by itself; `auto`: itself, where the table allows it",
    )
    resume_s: float = Field(
        5.0, ge=1.0, le=600.0, description="with `auto`: time from the condition's end to the resume"
    )


class FailsafeSettings(FailsafeSection, FailsafeTuning):
    """All settings of the failsafe: `[failsafe]` and `[tuning.failsafe]`."""


def _ids(value: object) -> object:
    # TOML has only lists, which strict validation does not accept for tuples.
    if not isinstance(value, list | tuple):
        raise ValueError("it must be a list of vehicles' ids")
    return tuple(value)


class ChoreographySettings(Settings):
    """Take-off and landing (docs/flying.md)."""

    layer_m: float = Field(
        0.0, ge=0.0, le=50.0, description="height between the layers of take-off and landing; 0: no layers"
    )
    landing: Literal["in_place", "return"] = Field("in_place", description="land in place, or at `start_m`")
    landing_order: Annotated[
        tuple[Annotated[int, Field(ge=1, le=254)], ...], Field(max_length=254), BeforeValidator(_ids)
    ] = Field((), description="ids; others land last, in line order")

    def in_landing_order(self, ids: tuple[int, ...]) -> tuple[int, ...]:
        """Return the vehicles, given in line order, in the order in which they land."""
        first = tuple(i for i in self.landing_order if i in ids)
        return (*first, *(i for i in ids if i not in first))


class GimbalSettings(Settings):
    """`gimbal` of a vehicle: its camera looks at the target, whatever the vehicle's yaw (docs/missions.md)."""

    target_height_m: float = Field(
        0.0,
        ge=-500.0,
        le=9000.0,
        description="height above the origin of what is looked at, unless the ring follows the target's altitude",
    )
    view_deg: float = Field(60.0, ge=1.0, le=170.0, description="the camera's angle of view")


class ExcitationSettings(Settings):
    """The excitation flight of `cordon excite`: steps, then swept sines, on x, on y and on both
    (docs/identification.md).
    """

    offset_m: Annotated[tuple[float, float], BeforeValidator(pair)] = Field(
        (12.0, 0.0), description="centre of the box from the start, x and y"
    )
    half_width_m: float = Field(5.0, ge=1.0, le=100.0, description="from the centre to each side of the box")
    speed_max_m_s: float = Field(
        2.0, ge=0.1, le=20.0, description="largest speed, also of a plant that is off by `plant_doubt`"
    )
    acceleration_max_m_s2: float = Field(
        2.3, ge=0.1, le=20.0, description="largest acceleration, with the profile's plant"
    )
    plant_doubt: float = Field(0.3, ge=0.0, le=0.6, description="assumed error of a0 and a1, as a share")
    steps_s: float = Field(30.0, ge=5.0, le=600.0, description="duration of each part with steps")
    level_shortest_s: float = Field(1.5, ge=0.5, le=60.0, description="shortest level of the steps")
    level_longest_s: float = Field(6.0, ge=0.5, le=60.0, description="longest level of the steps")
    sweep_s: float = Field(30.0, ge=5.0, le=600.0, description="duration of each swept sine")
    sweep_from_hz: float = Field(0.05, ge=0.01, le=5.0, description="first frequency of the sweep")
    sweep_to_hz: float = Field(0.5, ge=0.01, le=5.0, description="last frequency of the sweep")
    rest_s: float = Field(4.0, ge=1.0, le=60.0, description="rest before each part")
    seed: int = Field(0, ge=0, description="seed of the levels")
