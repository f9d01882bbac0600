"""The sections of a mission file that an agent obeys."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from agents.settings.shapes import Shape
from estimation.settings import Settings


def pair(value: object) -> object:
    """Return a list as a tuple: TOML knows lists only, and strict validation takes no list for a tuple."""
    return tuple(value) if isinstance(value, list) else value


def pairs(value: object) -> object:
    """Return a list of lists as a tuple of tuples."""
    return tuple(map(pair, value)) if isinstance(value, list) else value


class FormationSettings(Settings):
    """Spacing between neighbours, the leader and its speed along x, and the weights of (13). The `shape` is a "line"
    abreast, a "column" or a "wedge" behind the leader, or "free": every vehicle's `slot_m`, and that unless told
    otherwise where they have one; `cordon command formation` changes it in flight. The line of the mission begins at
    `start_m`, the leader's own start unless told otherwise. A vehicle keeps station on its "predecessor", the next one
    towards the leader, or on the mission's "line" itself. Noses point along x ("fixed"), or along the "path" flown.
    """

    spacing_m: float = Field(gt=0.0, le=1000.0)
    speed_m_s: float = Field(ge=0.0, le=20.0)
    leader: int = Field(ge=1, le=254)
    start_m: Annotated[tuple[float, float], BeforeValidator(pair)] | None = None
    shape: Shape | None = None
    station: Literal["predecessor", "line"] = "predecessor"
    yaw: Literal["fixed", "path"] = "fixed"
    position_weight: float = Field(1.0, gt=0.0, le=1e6)
    velocity_weight: float = Field(1.0, ge=0.0, le=1e6)
    increment_weight: float = Field(0.5, gt=0.0, le=1e6)
    speed_max_m_s: float = Field(2.0, gt=0.0, le=20.0)
    prediction_step_s: float = Field(0.5, gt=0.0, le=5.0)
    horizon: int = Field(8, ge=2, le=50)
    control_horizon: int = Field(2, ge=1, le=10)


class EncirclementSettings(Settings):
    """The ring: radius and angular rate, the spacing gain of (22), the weights of (24), the bounds of the LMPC. On it
    a vehicle's nose points along x ("fixed"), or at the "target". It flies at its `altitude_m` ("layers"), or follows
    the altitude of the "target" at `climb_max_m_s` at most: the lowest vehicle `altitude_offset_m` above it, the others
    as much higher as their `altitude_m` are.
    """

    radius_m: float = Field(gt=0.0, le=1000.0)
    angular_rate_rad_s: float = Field(ge=-2.0, le=2.0)
    yaw: Literal["fixed", "target"] = "fixed"
    altitude: Literal["layers", "target"] = "layers"
    altitude_offset_m: float | None = Field(None, ge=-200.0, le=200.0)
    climb_max_m_s: float = Field(1.0, ge=0.5, le=5.0)
    smoothing_time_s: float = Field(3.5, ge=0.0, le=60.0)
    spacing_gain_per_s: float = Field(0.3, ge=0.0, le=2.0)
    radius_weight: float = Field(1.0, gt=0.0, le=1e6)
    rate_weight: float = Field(10.0, gt=0.0, le=1e6)
    lag_weight: float = Field(12.0, ge=0.0, le=1e6)
    lead_weight: float = Field(12.0, ge=0.0, le=1e6)
    radial_increment_weight: float = Field(0.2, gt=0.0, le=1e6)
    angular_increment_weight: float = Field(2.0, gt=0.0, le=1e6)
    speed_max_m_s: float = Field(3.0, gt=0.0, le=20.0)
    acceleration_max_m_s2: float = Field(2.0, gt=0.0, le=20.0)
    radius_min_m: float = Field(1.0, gt=0.0, le=1000.0)
    radius_far_m: float = Field(60.0, gt=0.0, le=10000.0)
    prediction_step_s: float = Field(0.3, gt=0.0, le=5.0)
    horizon: int = Field(8, ge=2, le=50)
    control_horizon: int = Field(2, ge=1, le=10)


class DecisionSettings(Settings):
    """When a vehicle leaves the formation for the ring (paper, section 5); a vehicle may override each threshold."""

    importance_min: float = Field(0.6, ge=0.0, le=1.0)
    threat_max: float = Field(0.5, ge=0.0, le=1.0)
    distance_max_m: float = Field(12.0, gt=0.0, le=10000.0)


_SETPOINTS_FASTER = 2.0
"""Times the speed limit: a setpoint moves with its vehicle, and before it when the vehicle is to speed up or turn."""


class SafetySettings(Settings):
    """What is never to be exceeded, whatever a tactic wishes: the guard changes setpoints so that vehicles keep
    `separation_m` from each other, unless one flies `vertical_separation_m` above the other, and `keep_out_m` from the
    target (0: none); so that they stay inside `fence_m`, a polygon of corners in the mission frame, and between the two
    altitudes; and below the speed. `uncertainty_sigmas` is how much of the estimates' uncertainty is added,
    `barrier_rate_per_s` how fast a distance may shrink, relative to what is left of it; `lost_avoided_s` is how long
    the last place of a silent vehicle is avoided. `yaw_rate_max_deg_s` is how fast noses are turned, where they are.
    Wishes move the setpoint by `setpoint_speed_max_m_s` at most, twice `speed_max_m_s` unless told otherwise; the guard
    may move it faster. `guard = false` switches the guard off: for simulations.
    """

    guard: bool = True
    separation_m: float = Field(1.0, gt=0.0, le=100.0)
    vertical_separation_m: float = Field(2.0, gt=0.0, le=100.0)
    keep_out_m: float = Field(0.0, ge=0.0, le=1000.0)
    fence_m: Annotated[tuple[tuple[float, float], ...], BeforeValidator(pairs)] = ()
    altitude_min_m: float | None = Field(None, ge=-500.0, le=9000.0)
    altitude_max_m: float | None = Field(None, ge=-500.0, le=9000.0)
    speed_max_m_s: float = Field(5.0, gt=0.0, le=30.0)
    acceleration_max_m_s2: float = Field(4.0, gt=0.0, le=20.0)
    yaw_rate_max_deg_s: float = Field(45.0, gt=0.0, le=360.0)
    barrier_rate_per_s: float = Field(1.3, gt=0.0, le=5.0)
    uncertainty_sigmas: float = Field(3.0, ge=0.0, le=10.0)
    lost_avoided_s: float = Field(60.0, ge=0.0, le=3600.0)
    setpoint_lead_max_m: float = Field(6.0, gt=0.0, le=50.0)
    setpoint_speed_max_m_s: float | None = Field(None, gt=0.0, le=100.0)
    telemetry_timeout_s: float = Field(1.0, gt=0.0, le=30.0)
    abort_hover_s: float = Field(5.0, ge=0.0, le=60.0)

    @property
    def setpoint_speed_bound_m_s(self) -> float:
        """How fast wishes may move the setpoint."""
        told_m_s = self.setpoint_speed_max_m_s
        return _SETPOINTS_FASTER * self.speed_max_m_s if told_m_s is None else told_m_s


class FailsafeSettings(Settings):
    """How long a condition of the failsafe table (safety.md) is borne before a vehicle reacts, and what counts as one.
    What persists for `escalation_s` more is met by a graver reaction; the batteries' are shares of a full one.
    """

    escalation_s: float = Field(30.0, ge=1.0, le=3600.0)
    settle_s: float = Field(5.0, gt=0.0, le=600.0)
    battery_low: float = Field(0.2, ge=0.0, lt=1.0)
    battery_critical: float = Field(0.1, ge=0.0, lt=1.0)
    battery_s: float = Field(5.0, ge=0.0, le=60.0)
    fence_s: float = Field(0.5, ge=0.0, le=60.0)
    separation_share: float = Field(0.8, ge=0.0, le=1.0)
    separation_s: float = Field(0.3, ge=0.0, le=60.0)
    plan_s: float = Field(1.0, ge=0.0, le=60.0)
    bus_lost_s: float = Field(2.0, ge=0.0, le=600.0)
    peers_silent_s: float = Field(3.0, ge=1.0, le=600.0)
    peer_silent_s: float = Field(2.0, ge=1.0, le=600.0)
    late_s: float = Field(2.0, ge=0.0, le=60.0)
    clock_step_s: float = Field(0.5, ge=0.1, le=10.0)
    clock_s: float = Field(1.0, ge=0.0, le=60.0)


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
    landing_order: Annotated[tuple[Annotated[int, Field(ge=1, le=254)], ...], BeforeValidator(_ids)] = ()


class ExcitationSettings(Settings):
    """The flight for identification (`cordon excite`): steps between random levels, then swept sines, on x, on y and on
    both. It stays in a box, `half_width_m` to all four sides of its middle, which is `offset_m` from the vehicle's
    start, and below `speed_max_m_s`, also on a plant whose numbers are `plant_doubt` (a share) off the plant file; with
    the plant file's it stays below the acceleration. A level lasts between its two times; `rest_s` pass before a part.
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
