"""Checks of vehicle urls before MAVSDK uses them: MAVSDK's own errors are unspecific or missing."""

import errno
import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path

from serial.tools.list_ports import comports

from agents.ports import VehicleRefusedError
from gcs.link.ports.holders import bind_fault, port_holder

CONNECT_TIMEOUT_S = 3.0


def require_usable(url: str) -> None:
    """Refuse a url whose port is in use, whose host is unknown or does not answer, or whose device does not exist.

    Blocks during a name lookup or a TCP connection attempt. Unknown schemes pass. Raises VehicleRefusedError.
    """
    scheme, _, rest = url.partition("://")
    check = _CHECKS.get(scheme)
    place, _, number = rest.rpartition(":")
    if check is not None and place and number.isdecimal():
        check(url, place, int(number))


def _require_free_udp(url: str, host: str, port: int) -> None:
    """Refuse a UDP port in use: a second MAVSDK on it raises no error, and the first one receives nothing."""
    _require_free(url, host, port, socket.SOCK_DGRAM)


def _require_free_tcp(url: str, host: str, port: int) -> None:
    _require_free(url, host, port, socket.SOCK_STREAM)


def _require_free(url: str, host: str, port: int, kind: socket.SocketKind) -> None:
    try:
        fault = bind_fault(kind, host, port)
    except ValueError as error:
        raise VehicleRefusedError(
            f"{url}: {host} is not a numeric address of this machine",
            "use 0.0.0.0 to listen on all networks, or 127.0.0.1 for this machine only",
        ) from error
    if fault is not None:
        in_use = fault.errno == errno.EADDRINUSE
        raise VehicleRefusedError(
            f"{'udp' if kind is socket.SOCK_DGRAM else 'tcp'} port {port} of {url} "
            + (f"is in use{port_holder(kind, port)}" if in_use else f"is not available: {fault.strerror}"),
            "end the other ground station or agent on this port" if in_use else "check the url",
        ) from fault


def _require_known_host(url: str, host: str, port: int) -> None:
    try:
        socket.getaddrinfo(host, port)
    except OSError as error:
        raise VehicleRefusedError(
            f"{url}: unknown host {host} ({error.strerror})",
            "check the name and the network of this machine, or use a numeric address",
        ) from error


def _require_answering(url: str, host: str, port: int) -> None:
    """Refuse a TCP server that does not accept connections: MAVSDK would retry for ever without an error."""
    _require_known_host(url, host, port)
    try:
        socket.create_connection((host, port), CONNECT_TIMEOUT_S).close()
    except OSError as error:
        refused = isinstance(error, ConnectionRefusedError)
        reason = "refuses connections" if refused else f"is not reachable: {error.strerror or error}"
        raise VehicleRefusedError(
            f"{url}: tcp port {port} of {host} {reason}",
            "start the vehicle or the bridge on that port, or check host and port",
        ) from error


def _require_device(url: str, name: str, _baud: int) -> None:
    if not name.startswith("/"):
        return  # Windows ports (COM3) cannot be checked without opening them
    device = Path(name)
    if not device.exists():
        there = sorted(port.device for port in comports())
        known = f"available: {', '.join(there)}" if there else "no serial device is connected"
        raise VehicleRefusedError(
            f"{url}: the serial device {name} does not exist; {known}",
            "connect the autopilot or radio, then use its name under /dev",
        )
    if not stat.S_ISCHR(device.stat().st_mode):
        raise VehicleRefusedError(
            f"{url}: {name} is not a serial device",
            "use the device of the autopilot or radio, for example /dev/ttyUSB0",
        )
    if not os.access(device, os.R_OK | os.W_OK):
        raise VehicleRefusedError(
            f"{url}: no permission to open {name}",
            "join the group that owns it (`sudo usermod -aG dialout $USER`), then log in again",
        )


_CHECKS: dict[str, Callable[[str, str, int], None]] = {
    "udp": _require_free_udp,
    "udpin": _require_free_udp,
    "udpout": _require_known_host,
    "tcpin": _require_free_tcp,
    "tcpout": _require_answering,
    "serial": _require_device,
}
