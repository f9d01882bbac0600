"""A profile: all numbers that describe one kind of vehicle, as its TOML file says them."""

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
    """The plant of one horizontal axis, x'' = a0 (X_d - x) - a1 x'. Both numbers are positive."""

    a0_per_s2: float = Field(le=100.0)
    a1_per_s: float = Field(le=100.0)


class LimitsSection(Settings):
    """`[limits]`: the speed and the acceleration to which the autopilot limits the vehicle, none where unknown. A
    mission whose ring or line takes more is refused.
    """

    speed_max_m_s: float | None = Field(None, gt=0.0, le=100.0)
    acceleration_max_m_s2: float | None = Field(None, gt=0.0, le=100.0)


class ProfileFile(Settings):
    """The autopilot that a profile is for, none for any; the `delay_s` between a setpoint and its
    effect; and the share of a setpoint's velocity that the vehicle follows, 0 for setpoints without velocity.
    """

    autopilot: Autopilot | None = None
    delay_s: float = Field(0.0, ge=0.0, le=1.0)
    feedforward: float = Field(0.0, ge=0.0, le=FEEDFORWARD_MAX)
    x: AxisSection
    y: AxisSection
    own_filter: OwnFilterSettings = OwnFilterSettings()
    limits: LimitsSection = LimitsSection()
    identified: Identification | None = None


@dataclass(frozen=True, slots=True)
class Profile:
    """One kind of vehicle: its plant, the settings of its own-state filter, its autopilot and the limits of that.

    `autopilot` is None for a profile of any autopilot, `identified` where the file does not say how the plant was
    identified.
    """

    plant: Plant
    own_filter: OwnFilterSettings = field(default_factory=OwnFilterSettings)
    autopilot: Autopilot | None = None
    limits: LimitsSection = field(default_factory=LimitsSection)
    identified: Identification | None = None


def profile_of(name: str, content: dict[str, object]) -> Profile:
    """Return the profile that a TOML file of this name holds; raises ProfileError with every fault."""
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
