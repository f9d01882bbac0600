"""Files and folders that only their owner may read: modes 0600 and 0700."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gcs.errors import InputError

FOLDER_MODE, FILE_MODE = 0o700, 0o600
_OF_OTHERS = 0o077


def make_folder(path: Path) -> None:
    """Create a folder if it is missing; raises InputError if it is another user's, or open to others."""
    try:
        path.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError([f"{path}: {error.strerror or error}"]) from error
    check_folder(path)


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


def read(path: Path) -> bytes:
    """Return a file's content; raises InputError."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError([f"{path}: {error.strerror or error}"]) from error


def read_private(path: Path) -> bytes:
    """Return the content of a file that only its owner may read; raises InputError."""
    content = read(path)
    if path.stat().st_mode & _OF_OTHERS:
        raise InputError([f"{path}: other users may read this private key; next: chmod 600 {path}"])
    return content
