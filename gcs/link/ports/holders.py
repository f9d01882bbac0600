"""The process of this computer that holds a socket, where the system reports it: Linux, processes of the same user."""

import pwd
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_PROC = Path("/proc")
_LISTENS = "0A"
_COMMAND_LENGTH = 160


def port_holder(kind: socket.SocketKind, port: int) -> str:
    """Return " by process 123 (its command)" for the holder of a UDP or TCP port, or its user; empty if unknown.

    Linux lists sockets in /proc/net/udp and /proc/net/tcp (man 5 proc).
    """
    name = "udp" if kind is socket.SOCK_DGRAM else "tcp"
    for fields in (*_rows(f"net/{name}"), *_rows(f"net/{name}6")):
        listens = name == "udp" or fields[3] == _LISTENS
        if len(fields) > 9 and listens and fields[1].rpartition(":")[2] == f"{port:04X}":
            return process_holding(fields[9]) or f" by a process of user {_user(int(fields[7]))}"
    return ""


def abstract_sockets(prefix: str) -> dict[str, str]:
    """Return the inodes of all users' abstract Unix sockets whose names begin with `prefix`, by name."""
    found = {}
    for fields in _rows("net/unix"):
        if len(fields) == 8 and fields[7].startswith(f"@{prefix}"):
            found[fields[7].removeprefix("@")] = fields[6]
    return found


def process_holding(inode: str) -> str:
    """Return " by process 123 (its command)" for the socket of an inode; empty if unknown."""
    for descriptors in _PROC.glob("[0-9]*/fd"):
        with suppress(OSError):  # the process has ended, or is another user's
            if any(_is_socket(each, inode) for each in descriptors.iterdir()):
                return described(int(descriptors.parent.name))
    return ""


def described(process_id: int) -> str:
    """Return " by process 123 (its command)", with printable characters only."""
    try:
        words = (_PROC / str(process_id) / "cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return f" by process {process_id}"
    words[0] = Path(words[0]).name
    command = "".join(letter if letter.isprintable() else "?" for letter in " ".join(words).strip())
    return f" by process {process_id} ({command[:_COMMAND_LENGTH]})"


def _is_socket(descriptor: Path, inode: str) -> bool:
    with suppress(OSError):
        return str(descriptor.readlink()) == f"socket:[{inode}]"
    return False


def _rows(table: str) -> Iterator[list[str]]:
    """Return the fields of each row of a table of /proc; none on systems without it."""
    with suppress(OSError):
        yield from (line.split() for line in (_PROC / table).read_text(errors="replace").splitlines()[1:])


def _user(user_id: int) -> str:
    try:
        return pwd.getpwuid(user_id).pw_name
    except KeyError:
        return str(user_id)
