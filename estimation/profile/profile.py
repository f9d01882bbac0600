"""A profile: the parameters of one type of vehicle, from its TOML file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import Field, ValidationError

from estimation.input_file import TEXT_MAX_LENGTH, read_plain, toml_content
from estimation.plant.model import FEEDFORWARD_MAX, Identification, Plant, PlantAxis
from estimation.profile.autopilots import AutopilotName
from estimation.settings import OwnFilterSettings, Settings


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

    autopilot: AutopilotName | None = Field(None, description="autopilot that the profile is for; none: any")
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
    autopilot: AutopilotName | None = None
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


_BUNDLED = Path(__file__).parent / "profiles"


def bundled_profiles() -> list[str]:
    """Return the names of the bundled profiles."""
    return sorted(path.stem for path in _BUNDLED.glob("*.toml"))


class ProfileLibrary:
    """Profiles by name: bundled ones, files in a folder, or texts that were read before.

    No file outside the folder is opened, and none without a folder. `texts` holds every text that was read, by name:
    they are sufficient to load the same profiles on any computer.
    """

    def __init__(self, folder: Path | None, texts: Mapping[str, str] | None = None) -> None:
        self._folder = folder
        self.texts = dict(texts or {})

    def load(self, name: str) -> Profile:
        """Return a profile; raises ProfileError with every fault."""
        try:
            text = self.texts.get(name) or self._read(name)
            content = toml_content(text)
        except ValueError as error:
            raise ProfileError([f"'{name}' is not TOML: {error}"]) from error
        self.texts[name] = text
        return profile_of(name, content)

    def _read(self, name: str) -> str:
        try:
            return read_plain(self._path(name), 4 * TEXT_MAX_LENGTH).decode("utf-8-sig")
        except UnicodeDecodeError:
            raise
        except (OSError, ValueError) as error:  # a name with a zero byte raises ValueError
            reason = error.strerror if isinstance(error, OSError) else error
            known = ", ".join(bundled_profiles())
            raise ProfileError([f"no profile '{name}' ({reason}); bundled profiles: {known}"]) from error

    def _path(self, name: str) -> Path:
        """Return the path of a profile; raises ValueError for a path outside the folder."""
        if name in bundled_profiles():
            return _BUNDLED / f"{name}.toml"
        if self._folder is None:
            raise ValueError("the log does not hold it")
        path = (self._folder / name).resolve()
        outside = Path(name).is_absolute() or ".." in Path(name).parts
        if outside or not path.is_relative_to(self._folder.resolve()):
            raise ValueError("it is not in the folder of the mission")
        return path
