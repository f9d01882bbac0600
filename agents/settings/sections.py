"""The sections of a mission file that configure an agent: what a user decides, with how it is tuned."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from agents.settings.shapes import Shape
from agents.settings.tuning import SETPOINTS_FASTER, EncirclementTuning, FailsafeTuning, FormationTuning, SafetyTuning
from estimation.settings import Settings

CORNERS_MAX = 256
"""Of a fence: the guard looks at every edge in every tick."""


def pair(value: object) -> object:
    """Return a list as a tuple: TOML knows lists only, and strict validation takes no list for a tuple."""
    return tuple(value) if isinstance(value, list) else value


def pairs(value: object) -> object:
    """Return a list of lists as a tuple of tuples."""
    return tuple(map(pair, value)) if isinstance(value, list) else value


Fence = Annotated[tuple[tuple[float, float], ...], Field(max_length=CORNERS_MAX), BeforeValidator(pairs)]


class FormationSection(Settings):
    """`[formation]`: spacing between neighbours, the leader and its speed along x. The `shape` is a "line" abreast, a
    "column" or a "wedge" behind the leader, or "free": every vehicle's `slot_m`, and the default where they have one;
    `cordon command formation` changes it in flight. The line of the mission begins at `start_m`, the leader's own start
    unless given. A vehicle keeps station on its "predecessor", the next one towards the leader, or on the mission's
    "line" itself. Noses point along x ("fixed"), or along the "path" flown.
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
    """`[encirclement]`: radius and angular rate of the ring, and the speed and acceleration that its LMPC may plan.
    Vehicles that come to the ring or change places on it fly up to `spacing_speed_max_m_s` faster or slower than the
    ring (none: half its speed, or 1 m/s if that is more), never backwards, within an acceleration and a jerk of their
    own. Where bounds contradict, `speed_max_m_s` and `acceleration_max_m_s2` come first. On it a vehicle's nose points
    along x ("fixed"), or at the "target". It flies at its `altitude_m` ("layers"), or follows the altitude of the
    "target" at `climb_max_m_s` at most: the lowest vehicle `altitude_offset_m` above it, the others as much higher as
    their `altitude_m` are.
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
    spacing_acceleration_max_m_s2: float = Field(0.3, gt=0.0, le=20.0)
    spacing_jerk_max_m_s3: float = Field(0.5, gt=0.0, le=100.0)


class EncirclementSettings(EncirclementSection, EncirclementTuning):
    """All settings of the encirclement: `[encirclement]` and `[tuning.encirclement]`."""

    @property
    def transition_acceleration_m_s2(self) -> float:
        """The acceleration of a transition."""
        return min(self.spacing_acceleration_max_m_s2, self.acceleration_max_m_s2)

    @property
    def transition_speed_m_s(self) -> float:
        """How much faster or slower than the ring a vehicle flies in a transition, and how fast towards it."""
        given_m_s = self.spacing_speed_max_m_s
        half_m_s = abs(self.angular_rate_rad_s) * self.radius_m / 2.0
        return min(max(1.0, half_m_s) if given_m_s is None else given_m_s, self.speed_max_m_s)


class DecisionSettings(Settings):
    """When a vehicle leaves the formation for the ring (paper, section 5); a vehicle may override each threshold."""

    importance_min: float = Field(0.6, ge=0.0, le=1.0)
    threat_max: float = Field(0.5, ge=0.0, le=1.0)
    distance_max_m: float = Field(12.0, gt=0.0, le=10000.0)


class SafetySection(Settings):
    """`[safety]`: limits that hold for every tactic. The guard changes setpoints so that vehicles keep `separation_m`
    from each other, unless one flies `vertical_separation_m` above the other, and `keep_out_m` from the target (0:
    none); so that they stay inside `fence_m`, a polygon of corners in the mission frame, and between the two altitudes
    (a vehicle may have its own); and below the speed. `lost_avoided_s` is how long the last place of a silent vehicle
    is avoided.
    `yaw_rate_max_deg_s` is how fast noses turn. Without telemetry for `telemetry_timeout_s` a vehicle holds.
    `abort_hover_s` is how long it hovers after an abort before it lands. `guard = false` switches the guard off: for
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
        """How fast plans may move the setpoint: ahead of the vehicle as well when that speeds up or turns."""
        given_m_s = self.setpoint_speed_max_m_s
        return SETPOINTS_FASTER * self.speed_max_m_s if given_m_s is None else given_m_s


class FailsafeSection(Settings):
    """`[failsafe]`: when a condition of the failsafe table (safety.md) counts, and how long until a graver reaction. A
    condition that lasts `escalation_s` longer leads to the next reaction; the batteries' are shares of a full one; the
    others are how long the bus, all peers or one of them may be silent. A vehicle returns while it can still land at
    its start with a `reserve_s` of flight time left. `no_operator` is what vehicles do when operators were on the bus
    and none is any more, as when the laptop is lost: "go_on", "hold" or "return" (docs/onboard.md).
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
    # TOML knows lists only, and strict validation takes no list for a tuple.
    if not isinstance(value, list | tuple):
        raise ValueError("it must be a list of vehicles' ids")
    return tuple(value)


class ChoreographySettings(Settings):
    """The way up and down. Layers are heights that vehicles have to themselves: in line order above the highest
    `altitude_m` from take-off until all are in their places, in landing order on the way home; 0 is none. `landing` is
    "in_place" or "return", to `start_m`; who is not in `landing_order` comes last, in line order.
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
    """The flight for identification (`cordon excite`): steps between random levels, then swept sines, on x, on y and on
    both. It stays in a box, `half_width_m` to all four sides of its middle, which is `offset_m` from the vehicle's
    start, and below `speed_max_m_s`, also on a plant whose numbers are `plant_doubt` (a share) off the profile's; with
    the profile's it stays below the acceleration. A level lasts between its two times; `rest_s` pass before a part.
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
