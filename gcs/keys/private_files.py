"""Files and folders that only their owner may read: modes 0600 and 0700. The user's runtime directory is one."""

import errno
import fcntl
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedWriter
from pathlib import Path
from typing import Literal

from estimation.input_file import read_plain
from gcs.errors import InputError

FOLDER_MODE, FILE_MODE = 0o700, 0o600
_OF_OTHERS = 0o077
_BYTES_MAX = 1_000_000


def make_folder(path: Path) -> None:
    """Create a folder if it is missing; raises InputError if it is another user's, or open to others."""
    try:
        path.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError([f"{path}: {error.strerror or error}"]) from error
    check_folder(path)


def is_of_another_user(path: Path) -> bool:
    """Return whether a file, a folder or a link exists and belongs to another user."""
    with suppress(OSError):
        return path.lstat().st_uid != os.geteuid()
    return False


def check_folder(path: Path) -> None:
    """Raise InputError unless a folder is this user's and closed to others."""
    try:
        found = path.lstat()
    except OSError as error:
        raise InputError([f"{path}: {error.strerror or error}"]) from error
    if not path.is_dir() or path.is_symlink():
        raise InputError([f"{path}: not a folder; next: remove it, try again"])
    if found.st_uid != os.geteuid():
        raise InputError([f"{path}: it belongs to another user (user id {found.st_uid}); next: remove it, try again"])
    if found.st_mode & _OF_OTHERS:
        raise InputError([f"{path}: other users may read it; next: chmod 700 {path}"])


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder alone among the processes and threads that lock it, inside this context; raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def write(path: Path, content: bytes) -> None:
    """Write a file atomically, replacing an existing one; raises InputError."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.unlink(missing_ok=True)
        with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, FILE_MODE), "wb") as file:
            file.write(content)
        beside.replace(path)
    except OSError as error:
        raise InputError([f"{path}: {error.strerror or error}"]) from error


def require_absent(target: Path) -> None:
    """Raise InputError if something is where a file or folder is to be written."""
    if os.path.lexists(target):
        raise InputError([f"--output: {str(target)!r} exists already, and is not overwritten; name another"])


def create(path: Path, mode: Literal["wb", "xb", "ab"] = "wb") -> BufferedWriter:
    """Open a file for writing, as `open` does; a new one is readable by its owner only.

    Raises OSError, also for a pipe or a device, without waiting.
    """
    file = open(path, mode, opener=_opener)  # noqa: SIM115 - Path.open takes no opener
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is not a file", str(path))
    return file


def _opener(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK, FILE_MODE)


def read(path: Path) -> bytes:
    """Return a file's content; raises InputError."""
    try:
        return read_plain(path, _BYTES_MAX)
    except OSError as error:
        raise InputError([f"{path}: {error.strerror or error}"]) from error


def read_private(path: Path) -> bytes:
    """Return the content of this user's file, which only its owner may read; raises InputError."""
    content, found = read(path), path.stat()
    if found.st_uid != os.geteuid():
        raise InputError(
            [f"{path}: it belongs to another user (user id {found.st_uid}); next: use a copy that belongs to you"]
        )
    if found.st_mode & _OF_OTHERS:
        raise InputError([f"{path}: other users may read this private key; next: chmod 600 {path}"])
    return content


def runtime_folder() -> Path:
    """Return the user's runtime directory of cordon, made if it is missing.

    Without XDG_RUNTIME_DIR it is in the directory of temporary files; or below the home directory, if another user has
    made a file of its name there. Raises InputError if others can write there.
    """
    if runtime := os.environ.get("XDG_RUNTIME_DIR"):
        folder = Path(runtime) / "cordon"
    else:
        folder = Path(tempfile.gettempdir()) / f"cordon-{os.geteuid()}"
    try:
        make_folder(folder)
    except InputError:
        if runtime or not is_of_another_user(folder):
            raise
        with suppress(RuntimeError):  # there is no home directory
            # Of this computer only: others may share the home directory.
            folder = _state_home() / "cordon" / f"run-{os.uname().nodename}"
        make_folder(folder)
    return folder


def _state_home() -> Path:
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")


@contextmanager
def locked_runtime_folder() -> Iterator[Path]:
    """Return the user's runtime directory of cordon, locked; raises InputError if others can write there."""
    folder = runtime_folder()
    with locked(folder):
        yield folder
