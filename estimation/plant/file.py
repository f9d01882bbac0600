"""Plant files: the numbers of an identified plant in TOML, bundled or the user's own."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field, ValidationError

from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis
from estimation.plant.provenance import Identification
from estimation.settings import Settings

_BUNDLED = Path(__file__).parent / "plants"


class PlantFileError(Exception):
    """A plant file is missing or wrong; `faults` says where and what, one a line."""

    def __init__(self, faults: list[str]) -> None:
        super().__init__("\n".join(faults))
        self.faults = faults


class _AxisSection(Settings):
    a0_per_s2: float = Field(le=100.0)
    a1_per_s: float = Field(le=100.0)


class _PlantFile(Settings):
    x: _AxisSection
    y: _AxisSection
    delay_s: float = Field(0.0, ge=0.0, le=1.0)
    feedforward: float = Field(0.0, ge=0.0, le=FEEDFORWARD_MAX)
    identified: Identification | None = None


@dataclass(frozen=True, slots=True)
class PlantFile:
    """What a plant file says: the plant, and how it was identified where that is told."""

    plant: Plant
    identified: Identification | None = None


def bundled_plants() -> list[str]:
    """Return the names of the plants that come with cordon."""
    return sorted(path.stem for path in _BUNDLED.glob("*.toml"))


def load_plant(name: str, folder: Path) -> Plant:
    """Load a bundled plant by its bare name, or a file relative to `folder`; raises PlantFileError."""
    return PlantShelf(folder).load(name)


class PlantShelf:
    """Plants by name: bundled ones, files relative to a folder, or texts that are at hand already.

    `texts` holds what has been read so far, by name: with them alone, the same plants can be loaded anywhere.
    """

    def __init__(self, folder: Path, texts: Mapping[str, str] | None = None) -> None:
        self._folder = folder
        self.texts = dict(texts or {})

    def load(self, name: str) -> Plant:
        """Return a plant; raises PlantFileError."""
        return self.open(name).plant

    def open(self, name: str) -> PlantFile:
        """Return all that a plant's file says; raises PlantFileError."""
        try:
            text = self.texts.get(name) or self._read(name)
            content = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise PlantFileError([f"'{name}' is not TOML: {error}"]) from error
        self.texts[name] = text
        return _file_of(name, content)

    def _read(self, name: str) -> str:
        path = _BUNDLED / f"{name}.toml" if name in bundled_plants() else self._folder / name
        try:
            return path.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError:
            raise
        except (OSError, ValueError) as error:  # a name with a zero byte is a ValueError
            reason = error.strerror if isinstance(error, OSError) else error
            known = ", ".join(bundled_plants())
            raise PlantFileError([f"no plant file '{name}' ({reason}); bundled plants: {known}"]) from error


def _file_of(name: str, content: dict[str, object]) -> PlantFile:
    try:
        file = _PlantFile.model_validate(content)
    except ValidationError as error:
        faults = [f"{name}: {'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()]
        raise PlantFileError(faults) from error
    faults = []
    axes = {}
    for axis, section in (("x", file.x), ("y", file.y)):
        try:
            axes[axis] = PlantAxis(section.a0_per_s2, section.a1_per_s)
        except ValueError as error:
            faults.append(f"{name}: {axis}: {error}")
    if faults:
        raise PlantFileError(faults)
    return PlantFile(Plant(axes["x"], axes["y"], file.delay_s, file.feedforward), file.identified)
