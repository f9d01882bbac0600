"""The default path of a flight's log."""

import os
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

FOLDER_VARIABLE = "CORDON_LOGS"
"""The environment variable that names the folder of logs, in place of the default."""


def log_folder() -> Path:
    """Return the default folder of logs; raises OSError without a home folder."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if folder:
        return Path(folder)
    shared = os.environ.get("XDG_DATA_HOME")
    try:
        return Path(shared or Path.home() / ".local" / "share") / "cordon" / "logs"
    except RuntimeError as error:
        raise OSError(f"there is no home folder; set {FOLDER_VARIABLE} to a folder for logs") from error


def default_path(mission: str, only: int | None, now: datetime) -> Path:
    """Return the path of a log that begins now, by date and mission; raises OSError without a home folder."""
    folder = log_folder()
    folder.mkdir(parents=True, exist_ok=True)
    name = "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in mission)
    vehicle = "" if only is None else f"-vehicle{only}"
    return next(path for path in _numbered(folder, f"{now:%Y-%m-%d_%H-%M-%S}-{name}{vehicle}") if not path.exists())


def _numbered(folder: Path, stem: str) -> Iterator[Path]:
    yield folder / f"{stem}.mcap"
    number = 2
    while True:
        yield folder / f"{stem}-{number}.mcap"
        number += 1
