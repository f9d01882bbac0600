"""The identified plant: the response of one horizontal axis of a vehicle to a position setpoint.

`x'' = a0 (X_d - x) - a1 x' + w` per axis (section 2 of the paper). Filters, controllers, simulation and stub use the
same discretisation.

With feed-forward g it has a velocity V_d as a second input: `x'' = a0 (X_d - x) + a1 (g V_d - x') + w`. This is the
same plant with one input, the aim `X_d + (g a1 / a0) V_d`, the position where it would come to rest. Filters, planners
and guard use aims only; an aim becomes a setpoint and a velocity just before it is sent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from math import cos, exp, isfinite, sin, sqrt
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from estimation.settings import Settings
from estimation.state import Vector

COVARIANCE_OF = ("x.a0_per_s2", "x.a1_per_s", "y.a0_per_s2", "y.a1_per_s", "delay_s")
FEEDFORWARD = "feedforward"
_DATE = r"^\d{4}-((0[13578]|1[02])-(0[1-9]|[12]\d|3[01])|(0[469]|11)-(0[1-9]|[12]\d|30)|02-(0[1-9]|[12]\d))$"


def covariance_of(*, feedforward: bool) -> tuple[str, ...]:
    """Return the parameters in the order of an identification's covariance; `feedforward`, if any, is the last."""
    return (*COVARIANCE_OF, FEEDFORWARD) if feedforward else COVARIANCE_OF


class PlantGrade(Enum):
    """Whether a controller may use the identified plant."""

    GOOD = "good"
    USABLE = "usable"
    DO_NOT_FLY = "do not fly this"


def _tuples(value: object) -> object:
    """Return lists as tuples: TOML has lists only, and strict validation does not accept a list for a tuple."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _verdict(value: object) -> object:
    return next((verdict for verdict in PlantGrade if verdict.value == value), value)


def _iso(value: object) -> object:
    """Return a TOML date as text."""
    return value.isoformat() if hasattr(value, "isoformat") else value


class IdentifiedLog(Settings):
    """A log used for identification: the name of its file, and the SHA-256 of its bytes."""

    name: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


class Identification(Settings):
    """`[identified]`: how the plant of a profile was identified, as written by `cordon identify`."""

    method: str = Field(description="method and its version")
    date: Annotated[str, BeforeValidator(_iso), Field(pattern=_DATE)] = Field(description="ISO date")
    vehicle: int = Field(ge=0, le=255, description="MAVLink system id")
    autopilot: str = Field(description="autopilot of the log")
    firmware: str = Field(description="its version")
    logs: Annotated[tuple[IdentifiedLog, ...], BeforeValidator(_tuples), Field(min_length=1)] = Field(
        description="name and SHA-256 of each log"
    )
    setpoints: str = Field(description="assumed input between two logged setpoints")
    duration_s: float = Field(gt=0.0, description="data used")
    fit_x_percent: float = Field(le=100.0, description="validation fit: 100 (1 - rms error / rms motion)")
    fit_y_percent: float = Field(le=100.0, description="the same along y")
    delay_spread_s: float | None = Field(None, ge=0.0, le=10.0, description="variation of the delay, rms")
    verdict: Annotated[PlantGrade, BeforeValidator(_verdict)] = Field(description="whether to fly with the plant")
    reasons: Annotated[tuple[str, ...], BeforeValidator(_tuples)] = Field((), description="reasons for the verdict")
    covariance: Annotated[tuple[tuple[float, ...], ...], BeforeValidator(_tuples)] = Field(
        description="covariance of a0 and a1 of x, a0 and a1 of y, the delay, and the feed-forward if there is one"
    )

    @property
    def feeds(self) -> bool:
        """Whether velocities were sent with the setpoints."""
        return len(self.covariance) > len(COVARIANCE_OF)

    @model_validator(mode="after")
    def _is_square(self) -> "Identification":
        names = covariance_of(feedforward=self.feeds)
        size = len(names)
        if len(self.covariance) != size or any(len(row) != size for row in self.covariance):
            raise ValueError(f"covariance must have {size} rows of {size} numbers, for {', '.join(names)}")
        if any(self.covariance[at][at] < 0.0 for at in range(size)):
            raise ValueError("covariance has a negative variance on its diagonal")
        return self


FEEDFORWARD_MAX = 2.0
"""The largest g: PX4's and ArduCopter's is 1, and correctly identified plants are near that."""


@dataclass(frozen=True, slots=True)
class PlantAxis:
    """One axis of the plant; `a0` is the stiffness [1/s²] and `a1` the damping [1/s], both positive.

    Raises ValueError when the axis is not asymptotically stable.
    """

    a0_per_s2: float
    a1_per_s: float

    def __post_init__(self) -> None:
        for name, value in (("a0_per_s2", self.a0_per_s2), ("a1_per_s", self.a1_per_s)):
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value} makes the plant unstable: it must be positive")


@dataclass(frozen=True, slots=True)
class Plant:
    """Both horizontal axes of the mission frame, and the delay between a setpoint and its effect [s].

    `feedforward` is the gain g of the velocity sent with the setpoint; 0 is a plant without feed-forward. Raises
    ValueError for values that no plant has.
    """

    x: PlantAxis
    y: PlantAxis
    delay_s: float = 0.0
    feedforward: float = 0.0

    def __post_init__(self) -> None:
        for name, axis in (("x", self.x), ("y", self.y)):
            if not isinstance(axis, PlantAxis):
                raise ValueError(f"{name} = {axis!r}: it must be a PlantAxis(a0_per_s2, a1_per_s)")
        if not (isfinite(self.delay_s) and 0.0 <= self.delay_s <= 1.0):
            raise ValueError(f"delay_s = {self.delay_s}: it must lie between 0 and 1 s")
        if not (isfinite(self.feedforward) and 0.0 <= self.feedforward <= FEEDFORWARD_MAX):
            raise ValueError(f"feedforward = {self.feedforward}: it must lie between 0 and {FEEDFORWARD_MAX:g}")

    @property
    def a0_per_s2(self) -> Vector:
        """Stiffness of both axes, shape (2,)."""
        return np.array([self.x.a0_per_s2, self.y.a0_per_s2])

    @property
    def a1_per_s(self) -> Vector:
        """Damping of both axes, shape (2,)."""
        return np.array([self.x.a1_per_s, self.y.a1_per_s])

    @property
    def lead_s(self) -> tuple[float, float]:
        """The lead time of the aim by a velocity, g a1 / a0 along both axes [s]."""
        x, y, gain = self.x, self.y, self.feedforward
        return gain * x.a1_per_s / x.a0_per_s2, gain * y.a1_per_s / y.a0_per_s2

    def aim_m(self, setpoint_m: Sequence[float], velocity_m_s: Sequence[float]) -> Vector:
        """Return the aim (2,) of a setpoint and its velocity, which is empty if none is sent."""
        x, y = setpoint_m[0], setpoint_m[1]
        if velocity_m_s and self.feedforward:
            lead_x, lead_y = self.lead_s
            x, y = x + lead_x * velocity_m_s[0], y + lead_y * velocity_m_s[1]
        return np.array([x, y])


@dataclass(frozen=True, slots=True)
class PlantStep:
    """The plant over one time step: `next = transition @ state + input_gain @ aim + disturbance_gain @ w`.

    Shapes (4, 4), (4, 2) and (4, 2); the state is [x y x' y'], aim and `w` are held over the step. Without feed-forward
    the aim is the setpoint.
    """

    transition: Vector
    input_gain: Vector
    disturbance_gain: Vector

    def advance(self, state: Vector, aim_m: Vector, disturbance_m_s2: Vector) -> Vector:
        """Return the state (4,) one step later."""
        forced = self.input_gain.dot(aim_m) + self.disturbance_gain.dot(disturbance_m_s2)
        return np.asarray(self.transition.dot(state) + forced, dtype=np.float64)


@lru_cache(maxsize=1024)
def exact_step(plant: Plant, step_s: float) -> PlantStep:
    """Discretise the plant exactly for inputs held over `step_s` (the matrix exponential in closed form)."""
    transition = np.zeros((4, 4))
    input_gain = np.zeros((4, 2))
    for index, axis in enumerate((plant.x, plant.y)):
        position, velocity = index, index + 2
        free, decay, slope, rate = _axis_response(axis, step_s)
        transition[position, position] = free
        transition[position, velocity] = decay
        transition[velocity, position] = slope
        transition[velocity, velocity] = rate
        input_gain[position, index] = 1.0 - free
        input_gain[velocity, index] = -slope
    disturbance_gain = input_gain / plant.a0_per_s2
    for matrix in (transition, input_gain, disturbance_gain):
        matrix.setflags(write=False)
    return PlantStep(transition, input_gain, disturbance_gain)


def _axis_response(axis: PlantAxis, step_s: float) -> tuple[float, float, float, float]:
    """Return the four entries of exp([[0, 1], [-a0, -a1]] step) of one axis, row by row."""
    half = axis.a1_per_s / 2.0
    discriminant = half**2 - axis.a0_per_s2
    root = sqrt(abs(discriminant))
    if root * step_s < 1e-6:  # critically damped: the limit of both branches below
        even, odd = exp(-half * step_s), exp(-half * step_s) * step_s
    elif discriminant > 0.0:
        slow, fast = exp((root - half) * step_s), exp(-(root + half) * step_s)
        even, odd = (slow + fast) / 2.0, (slow - fast) / (2.0 * root)
    else:
        envelope = exp(-half * step_s)
        even, odd = envelope * cos(root * step_s), envelope * sin(root * step_s) / root
    return even + half * odd, odd, -axis.a0_per_s2 * odd, even - half * odd
