"""The sections of a mission file that configure an agent, each with its tuning."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from agents.settings.shapes import Shape
from agents.settings.tuning import SETPOINTS_FASTER, EncirclementTuning, FailsafeTuning, FormationTuning, SafetyTuning
from estimation.settings import Settings

CORNERS_MAX = 256
"""Maximum of a fence: the guard evaluates every edge in every tick."""


def pair(value: object) -> object:
    """Return a list as a tuple: TOML has only lists, which strict validation does not accept for tuples."""
    return tuple(value) if isinstance(value, list) else value


def pairs(value: object) -> object:
    """Return a list of lists as a tuple of tuples."""
    return tuple(map(pair, value)) if isinstance(value, list) else value


Fence = Annotated[tuple[tuple[float, float], ...], Field(max_length=CORNERS_MAX), BeforeValidator(pairs)]


class FormationSection(Settings):
    """`[formation]`: spacing between neighbours, the leader and its speed along x. The `shape` is a "line" abreast, a
    "column" or a "wedge" behind the leader, or "free": every vehicle's `slot_m`, the default if vehicles have one.
    `cordon command formation` changes it in flight. The mission's line begins at `start_m`, by default the leader's
    start. A vehicle keeps station on its "predecessor", the next one towards the leader, or on the mission's "line"
    itself. The yaw is along x ("fixed"), or along the "path" flown.
    """

    spacing_m: float = Field(gt=0.0, le=1000.0)
    speed_m_s: float = Field(ge=0.0, le=20.0)
    leader: int = Field(ge=1, le=254)
    start_m: Annotated[tuple[float, float], BeforeValidator(pair)] | None = None
    shape: Shape | None = None
    station: Literal["predecessor", "line"] = "predecessor"
    yaw: Literal["fixed", "path"] = "fixed"
    speed_max_m_s: float = Field(2.0, gt=0.0, le=20.0)


class FormationSettings(FormationSection, FormationTuning):
    """All settings of the formation: `[formation]` and `[tuning.formation]`."""


class EncirclementSection(Settings):
    """`[encirclement]`: radius and angular rate of the ring, and the limits of speed and acceleration in its LMPC.
    Vehicles that join the ring or change their spacing fly up to `spacing_speed_max_m_s` faster or slower than the ring
    (none: half its speed, or 1 m/s if that is more), never backwards. If limits conflict, `speed_max_m_s` and
    `acceleration_max_m_s2` take precedence. The yaw on the ring is along x ("fixed"), or towards the "target". Vehicles
    fly at their `altitude_m` ("layers"), or follow the altitude of the "target" at up to `climb_max_m_s`: the lowest
    `altitude_offset_m` above it, the others higher by the differences of their `altitude_m`.
    """

    radius_m: float = Field(gt=0.0, le=1000.0)
    angular_rate_rad_s: float = Field(ge=-2.0, le=2.0)
    yaw: Literal["fixed", "target"] = "fixed"
    altitude: Literal["layers", "target"] = "layers"
    altitude_offset_m: float | None = Field(None, ge=-200.0, le=200.0)
    climb_max_m_s: float = Field(1.0, ge=0.5, le=5.0)
    speed_max_m_s: float = Field(3.0, gt=0.0, le=20.0)
    acceleration_max_m_s2: float = Field(2.0, gt=0.0, le=20.0)
    spacing_speed_max_m_s: float | None = Field(None, gt=0.0, le=20.0)


class EncirclementSettings(EncirclementSection, EncirclementTuning):
    """All settings of the encirclement: `[encirclement]` and `[tuning.encirclement]`."""

    @property
    def transition_speed_m_s(self) -> float:
        """The speed of a transition, relative to the ring's speed along it, and towards it."""
        given_m_s = self.spacing_speed_max_m_s
        half_m_s = abs(self.angular_rate_rad_s) * self.radius_m / 2.0
        return min(max(1.0, half_m_s) if given_m_s is None else given_m_s, self.speed_max_m_s)


class DecisionSettings(Settings):
    """When a vehicle leaves the formation for the ring (paper, section 5). A vehicle may override each threshold."""

    importance_min: float = Field(0.6, ge=0.0, le=1.0)
    threat_max: float = Field(0.5, ge=0.0, le=1.0)
    distance_max_m: float = Field(12.0, gt=0.0, le=10000.0)


class SafetySection(Settings):
    """`[safety]`: limits that apply to every tactic. The guard moves setpoints so that vehicles keep `separation_m`
    from each other, unless one flies `vertical_separation_m` above the other, and `keep_out_m` from the target (0:
    none); stay inside `fence_m`, a polygon of corners in the mission frame, and between the two altitudes (a vehicle
    may have its own); and stay below the speed. For `lost_avoided_s` the guard avoids the last position of a silent
    vehicle. `yaw_rate_max_deg_s` limits the yaw rate. Without telemetry for `telemetry_timeout_s` a vehicle holds.
    After an abort it hovers for `abort_hover_s` before it lands. `guard = false` switches the guard off, for
    simulations.
    """

    guard: bool = True
    separation_m: float = Field(1.0, gt=0.0, le=100.0)
    vertical_separation_m: float = Field(2.0, gt=0.0, le=100.0)
    keep_out_m: float = Field(0.0, ge=0.0, le=1000.0)
    fence_m: Fence = ()
    altitude_min_m: float | None = Field(None, ge=-500.0, le=9000.0)
    altitude_max_m: float | None = Field(None, ge=-500.0, le=9000.0)
    speed_max_m_s: float = Field(5.0, gt=0.0, le=30.0)
    acceleration_max_m_s2: float = Field(4.0, gt=0.0, le=20.0)
    yaw_rate_max_deg_s: float = Field(45.0, gt=0.0, le=360.0)
    lost_avoided_s: float = Field(60.0, ge=0.0, le=3600.0)
    telemetry_timeout_s: float = Field(1.0, gt=0.0, le=30.0)
    abort_hover_s: float = Field(5.0, ge=0.0, le=60.0)


class SafetySettings(SafetySection, SafetyTuning):
    """All settings of the safety: `[safety]` and `[tuning.safety]`."""

    @property
    def setpoint_speed_bound_m_s(self) -> float:
        """The highest speed at which plans move the setpoint, which leads a vehicle that accelerates or turns."""
        given_m_s = self.setpoint_speed_max_m_s
        return SETPOINTS_FASTER * self.speed_max_m_s if given_m_s is None else given_m_s


class FailsafeSection(Settings):
    """`[failsafe]`: thresholds and times of the failsafe table (safety.md). A condition that lasts for `escalation_s`
    after a reaction leads to the next one. `battery_low` and `battery_critical` are fractions of a full battery.
    `bus_lost_s`, `peers_silent_s` and `peer_silent_s` are how long the bus, all peers or one of them may be silent. A
    vehicle returns while it can still land at its start with `reserve_s` of flight time left. `no_operator` is the
    reaction once the last operator has left the bus for `no_operator_s`, for example with the laptop: "go_on", "hold"
    or "return" (docs/onboard.md).
    """

    escalation_s: float = Field(30.0, ge=1.0, le=3600.0)
    battery_low: float = Field(0.2, ge=0.0, lt=1.0)
    battery_critical: float = Field(0.1, ge=0.0, lt=1.0)
    reserve_s: float = Field(30.0, ge=0.0, le=3600.0)
    bus_lost_s: float = Field(2.0, ge=0.0, le=600.0)
    peers_silent_s: float = Field(3.0, ge=1.0, le=600.0)
    peer_silent_s: float = Field(2.0, ge=1.0, le=600.0)
    no_operator: Literal["go_on", "hold", "return"] = "go_on"
    no_operator_s: float = Field(10.0, ge=1.0, le=3600.0)


class FailsafeSettings(FailsafeSection, FailsafeTuning):
    """All settings of the failsafe: `[failsafe]` and `[tuning.failsafe]`."""


def _ids(value: object) -> object:
    # TOML has only lists, which strict validation does not accept for tuples.
    if not isinstance(value, list | tuple):
        raise ValueError("it must be a list of vehicles' ids")
    return tuple(value)


class ChoreographySettings(Settings):
    """Take-off and landing. Each vehicle has its own layer of height, `layer_m` apart (0: no layers): above the highest
    `altitude_m`, in line order from take-off until all are in their slots, in landing order on the way home. `landing`
    is "in_place" or "return", to `start_m`. Vehicles that are not in `landing_order` land last, in line order.
    """

    layer_m: float = Field(0.0, ge=0.0, le=50.0)
    landing: Literal["in_place", "return"] = "in_place"
    landing_order: Annotated[
        tuple[Annotated[int, Field(ge=1, le=254)], ...], Field(max_length=254), BeforeValidator(_ids)
    ] = ()

    def in_landing_order(self, ids: tuple[int, ...]) -> tuple[int, ...]:
        """Return the vehicles, given in line order, in the order in which they land."""
        first = tuple(i for i in self.landing_order if i in ids)
        return (*first, *(i for i in ids if i not in first))


class ExcitationSettings(Settings):
    """The excitation flight of `cordon excite`: steps between random levels, then swept sines, on x, on y and on both.
    It stays in a box of `half_width_m` to all four sides of its centre, which is `offset_m` from the vehicle's start,
    and below `speed_max_m_s`, also if the plant's parameters differ by the fraction `plant_doubt` from the profile's.
    With the profile's plant it stays below `acceleration_max_m_s2`. A level lasts from `level_shortest_s` to
    `level_longest_s`. The vehicle rests for `rest_s` before each part.
    """

    offset_m: Annotated[tuple[float, float], BeforeValidator(pair)] = (12.0, 0.0)
    half_width_m: float = Field(5.0, ge=1.0, le=100.0)
    speed_max_m_s: float = Field(2.0, ge=0.1, le=20.0)
    acceleration_max_m_s2: float = Field(2.3, ge=0.1, le=20.0)
    plant_doubt: float = Field(0.3, ge=0.0, le=0.6)
    steps_s: float = Field(30.0, ge=5.0, le=600.0)
    level_shortest_s: float = Field(1.5, ge=0.5, le=60.0)
    level_longest_s: float = Field(6.0, ge=0.5, le=60.0)
    sweep_s: float = Field(30.0, ge=5.0, le=600.0)
    sweep_from_hz: float = Field(0.05, ge=0.01, le=5.0)
    sweep_to_hz: float = Field(0.5, ge=0.01, le=5.0)
    rest_s: float = Field(4.0, ge=1.0, le=60.0)
    seed: int = Field(0, ge=0)
