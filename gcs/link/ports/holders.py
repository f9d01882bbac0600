"""Whether a port is free, and the process that holds it, where Linux reports it: processes of the same user."""

import ipaddress
import socket
from pathlib import Path
from typing import Any

import psutil

from agents.team.text import printable

_COMMAND_LENGTH = 160


def bind_fault(kind: socket.SocketKind, host: str, port: int) -> OSError | None:
    """Return why this computer cannot receive at a UDP or TCP port; raises ValueError unless the host is numeric."""
    family = socket.AF_INET6 if ipaddress.ip_address(host).version == 6 else socket.AF_INET
    with socket.socket(family, kind) as attempt:
        if kind is socket.SOCK_STREAM:  # ignore connections in TIME_WAIT
            attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            attempt.bind((host, port))
        except OSError as error:
            return error
    return None


def port_holder(kind: socket.SocketKind, port: int) -> str:
    """Return " by process 123 (its command)" for the holder of a UDP or TCP port; empty if unknown."""
    is_udp = kind is socket.SOCK_DGRAM
    for each in _sockets("udp" if is_udp else "tcp"):
        if each.laddr and each.laddr.port == port and (is_udp or each.status == psutil.CONN_LISTEN):
            return described(each.pid)
    return ""


def abstract_sockets(prefix: str) -> dict[str, int | None]:
    """Return the abstract Unix sockets of all users whose names begin with `prefix`, with their processes if known."""
    return {
        each.laddr.removeprefix("@"): each.pid
        for each in _sockets("unix")
        if isinstance(each.laddr, str) and each.laddr.startswith(f"@{prefix}")
    }


def described(process_id: int | None) -> str:
    """Return " by process 123 (its command)", with printable characters only; None is a process of another user."""
    if process_id is None:
        return " by a process of another user"
    try:
        program, *arguments = psutil.Process(process_id).cmdline()
    except (psutil.Error, ValueError):  # another user's, it has ended, or it is a thread of the kernel
        return f" by process {process_id}"
    command = printable(" ".join((Path(program).name, *arguments)).strip())
    return f" by process {process_id} ({command[:_COMMAND_LENGTH]})"


def _sockets(kind: str) -> list[Any]:
    try:
        return psutil.net_connections(kind)
    except (psutil.Error, OSError, ValueError):  # not reported by this system
        return []
