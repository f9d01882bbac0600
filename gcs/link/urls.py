"""Vehicle urls that cannot work, told by name before MAVSDK is asked: it says little of some, and of others nothing."""

import errno
import ipaddress
import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path

from agents.ports import VehicleRefusedError

CONNECT_TIMEOUT_S = 3.0
SERIAL_NAMES = ("ttyACM*", "ttyUSB*", "ttyAMA*", "tty.usb*")


def require_usable(url: str) -> None:
    """Refuse a url whose port is taken, whose host is unknown, where nobody answers, or whose device is not there.

    Blocks while a name is looked up or a TCP connection is tried. What it does not understand it lets pass. Raises
    VehicleRefusedError.
    """
    scheme, _, rest = url.partition("://")
    check = _CHECKS.get(scheme)
    place, _, number = rest.rpartition(":")
    if check is not None and place and number.isdecimal():
        check(url, place, int(number))


def _require_free_udp(url: str, host: str, port: int) -> None:
    """Refuse a UDP port that is taken: a second MAVSDK on it raises no error, and the first goes silent."""
    _require_free(url, host, port, socket.SOCK_DGRAM)


def _require_free_tcp(url: str, host: str, port: int) -> None:
    _require_free(url, host, port, socket.SOCK_STREAM)


def _require_free(url: str, host: str, port: int, kind: socket.SocketKind) -> None:
    try:
        family = socket.AF_INET6 if ipaddress.ip_address(host).version == 6 else socket.AF_INET
    except ValueError as error:
        raise VehicleRefusedError(
            f"{url}: {host} is not an address of this machine in numbers",
            "write 0.0.0.0 to listen on all its networks, or 127.0.0.1 for this machine alone",
        ) from error
    protocol = "udp" if kind is socket.SOCK_DGRAM else "tcp"
    with socket.socket(family, kind) as attempt:
        if protocol == "tcp":  # a connection that has just been closed does not count
            attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            attempt.bind((host, port))
        except OSError as error:
            taken = error.errno == errno.EADDRINUSE
            raise VehicleRefusedError(
                f"{protocol} port {port} of {url} " + ("is taken" if taken else f"cannot be had: {error.strerror}"),
                "end the other ground station or agent that listens there" if taken else "check the url",
            ) from error


def _require_known_host(url: str, host: str, port: int) -> None:
    try:
        socket.getaddrinfo(host, port)
    except OSError as error:
        raise VehicleRefusedError(
            f"{url}: the host {host} is not known ({error.strerror})",
            "check its name and this machine's network, or write its address in numbers",
        ) from error


def _require_answering(url: str, host: str, port: int) -> None:
    """Refuse a TCP server that does not take connections: MAVSDK would try for ever, and say nothing."""
    _require_known_host(url, host, port)
    try:
        socket.create_connection((host, port), CONNECT_TIMEOUT_S).close()
    except OSError as error:
        refused = isinstance(error, ConnectionRefusedError)
        reason = "refuses connections" if refused else f"cannot be reached: {error.strerror or error}"
        raise VehicleRefusedError(
            f"{url}: tcp port {port} of {host} {reason}",
            "start the vehicle or the bridge that serves it, or check host and port",
        ) from error


def _require_device(url: str, name: str, _baud: int) -> None:
    if not name.startswith("/"):
        return  # Windows calls its ports COM3: only opening them tells
    device = Path(name)
    if not device.exists():
        there = [str(path) for pattern in SERIAL_NAMES for path in sorted(Path("/dev").glob(pattern))]
        known = f"there are {', '.join(there)}" if there else "this machine has none at present"
        raise VehicleRefusedError(
            f"{url}: the serial device {name} does not exist; {known}",
            "plug the autopilot or radio in, then write the name that appears under /dev",
        )
    if not stat.S_ISCHR(device.stat().st_mode):
        raise VehicleRefusedError(
            f"{url}: {name} is not a serial device", "write the device of the autopilot or radio, like /dev/ttyUSB0"
        )
    if not os.access(device, os.R_OK | os.W_OK):
        raise VehicleRefusedError(
            f"{url}: this user may not open {name}",
            "join the group that owns it (`sudo usermod -aG dialout $USER`), then log in anew",
        )


_CHECKS: dict[str, Callable[[str, str, int], None]] = {
    "udp": _require_free_udp,
    "udpin": _require_free_udp,
    "udpout": _require_known_host,
    "tcpin": _require_free_tcp,
    "tcpout": _require_answering,
    "serial": _require_device,
}
