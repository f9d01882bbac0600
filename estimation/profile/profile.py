"""A profile: the parameters of one type of vehicle, from its TOML file."""

from dataclasses import dataclass, field
from typing import Literal

from pydantic import Field, ValidationError

from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis
from estimation.plant.provenance import Identification
from estimation.settings import OwnFilterSettings, Settings

Autopilot = Literal["px4", "ardupilot"]


class ProfileError(Exception):
    """A profile is missing or wrong; `faults` holds one line for each fault, with the file and the key."""

    def __init__(self, faults: list[str]) -> None:
        super().__init__("\n".join(faults))
        self.faults = faults


class AxisSection(Settings):
    """The plant of one horizontal axis, x'' = a0 (X_d - x) - a1 x'. Both parameters are positive."""

    a0_per_s2: float = Field(le=100.0, description="stiffness, positive")
    a1_per_s: float = Field(le=100.0, description="damping, positive")


class LimitsSection(Settings):
    """`[limits]`: the autopilot's limits. A mission whose ring or line needs more is refused."""

    speed_max_m_s: float | None = Field(None, gt=0.0, le=100.0, description="largest speed; none: unknown")
    acceleration_max_m_s2: float | None = Field(
        None, gt=0.0, le=100.0, description="largest acceleration; none: unknown"
    )


class ProfileFile(Settings):
    """The plant x'' = a0 (X_d - x) - a1 x' of a vehicle, with delay and feed-forward."""

    autopilot: Autopilot | None = Field(None, description="autopilot that the profile is for; none: any")
    delay_s: float = Field(0.0, ge=0.0, le=1.0, description="time between a setpoint and its effect")
    feedforward: float = Field(
        0.0,
        ge=0.0,
        le=FEEDFORWARD_MAX,
        description="share of a setpoint's velocity that the vehicle follows; 0: setpoints are positions only",
    )
    x: AxisSection = Field(description="plant along x")
    y: AxisSection = Field(description="plant along y")
    own_filter: OwnFilterSettings = Field(OwnFilterSettings(), description="filter of the vehicle's own state")
    limits: LimitsSection = Field(LimitsSection(), description="limits of the autopilot")
    identified: Identification | None = Field(None, description="how the plant was identified")


@dataclass(frozen=True, slots=True)
class Profile:
    """One type of vehicle: its plant, the settings of its own filter, its autopilot and the autopilot's limits.

    `autopilot` is None for a profile for any autopilot, `identified` is None if the file does not hold how the plant
    was identified.
    """

    plant: Plant
    own_filter: OwnFilterSettings = field(default_factory=OwnFilterSettings)
    autopilot: Autopilot | None = None
    limits: LimitsSection = field(default_factory=LimitsSection)
    identified: Identification | None = None


def profile_of(name: str, content: dict[str, object]) -> Profile:
    """Return the profile in the content of a TOML file of this name; raises ProfileError with every fault."""
    try:
        file = ProfileFile.model_validate(content)
    except ValidationError as error:
        faults = [f"{name}: {'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()]
        raise ProfileError(faults) from error
    faults = []
    axes = {}
    for axis, section in (("x", file.x), ("y", file.y)):
        try:
            axes[axis] = PlantAxis(section.a0_per_s2, section.a1_per_s)
        except ValueError as error:
            faults.append(f"{name}: {axis}: {error}")
    if faults:
        raise ProfileError(faults)
    plant = Plant(axes["x"], axes["y"], file.delay_s, file.feedforward)
    return Profile(plant, file.own_filter, file.autopilot, file.limits, file.identified)
