"""Profiles by name: those that come with cordon, files, and texts from a log."""

import tomllib
from collections.abc import Mapping
from pathlib import Path

from estimation.profile.profile import Profile, ProfileError, profile_of

_BUNDLED = Path(__file__).parent / "profiles"


def bundled_profiles() -> list[str]:
    """Return the names of the profiles that come with cordon."""
    return sorted(path.stem for path in _BUNDLED.glob("*.toml"))


class ProfileShelf:
    """Profiles by name: bundled ones, files relative to a folder, or texts that were read before.

    `texts` holds every text that was read, by name: from them alone the same profiles load on any machine.
    """

    def __init__(self, folder: Path, texts: Mapping[str, str] | None = None) -> None:
        self._folder = folder
        self.texts = dict(texts or {})

    def load(self, name: str) -> Profile:
        """Return a profile; raises ProfileError with every fault."""
        try:
            text = self.texts.get(name) or self._read(name)
            content = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise ProfileError([f"'{name}' is not TOML: {error}"]) from error
        self.texts[name] = text
        return profile_of(name, content)

    def _read(self, name: str) -> str:
        path = _BUNDLED / f"{name}.toml" if name in bundled_profiles() else self._folder / name
        try:
            return path.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError:
            raise
        except (OSError, ValueError) as error:  # a name with a zero byte is a ValueError
            reason = error.strerror if isinstance(error, OSError) else error
            known = ", ".join(bundled_profiles())
            raise ProfileError([f"no profile '{name}' ({reason}); bundled profiles: {known}"]) from error
