"""Profiles by name: bundled ones, files, and texts from a log."""

from collections.abc import Mapping
from pathlib import Path

from estimation.input_file import TEXT_MAX_LENGTH, read_plain, toml_content
from estimation.profile.profile import Profile, ProfileError, profile_of

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
