"""Exclusive use of a team and of ports by one run of cordon on this computer: a second run is refused before its start.

A run claims the team that it flies, and the UDP ports that its vehicles send to. A claim is a locked file in the user's
runtime directory: the system unlocks it with its process, however that ends. Ports that another user has bound are
found by binding them.
"""

import errno
import fcntl
import ipaddress
import os
import random
import socket
import stat
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from os import getpid
from pathlib import Path
from secrets import token_hex
from typing import Any
from urllib.parse import urlsplit

import psutil
from serial.tools.list_ports import comports

from agents.ports import VehicleRefusedError
from agents.team.text import printable
from gcs.errors import InputError
from gcs.keys.private_files import FILE_MODE, locked_runtime_folder, make_folder
from gcs.mission.mission import Mission, MissionVehicle
from sitl.server.file_lock import is_locked

_COMMAND_LENGTH = 160
_LOOPBACK = "127.0.0.1"
_FREE_FROM, _BLOCKS, _PORTS_A_BLOCK = 20_000, 24, 500
_block_claims: list[socket.socket] = []


def _claimed_ports() -> Iterator[int]:
    """Yield ports of blocks that no other process of cordon has: a bound port claims one while its process lives.

    All are below the range of ephemeral ports, so that other connections do not take them before they are used.
    """
    for block in random.Random(getpid()).sample(range(_BLOCKS), _BLOCKS):
        claim = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            claim.bind((_LOOPBACK, _FREE_FROM - _BLOCKS + block))
        except OSError:
            claim.close()
            continue
        _block_claims.append(claim)
        yield from range(_FREE_FROM + block * _PORTS_A_BLOCK, _FREE_FROM + (block + 1) * _PORTS_A_BLOCK)


_ports = _claimed_ports()


def free_ports(count: int) -> list[int]:
    """Return ports of this computer that are free for UDP and TCP; this process returns none twice."""
    kinds = socket.SOCK_DGRAM, socket.SOCK_STREAM
    free = (port for port in _ports if not any(bind_fault(kind, _LOOPBACK, port) for kind in kinds))
    found = list(islice(free, count))
    if len(found) < count:
        raise VehicleRefusedError(f"fewer than {count} ports are free", "end other runs of cordon on this computer")
    return found


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


_LISTENING = ("udpin", "tcpin")
_ADDED_PORTS = "the vehicle other ports by --url and --endpoint"
STILL_FLIES = (
    "command its vehicles by `cordon command`, such as `cordon command rtl`, or end that flight; --only ID brings home "
    "one that it does not fly"
)


class Claims(ExitStack):
    """The claims of this process, to be used as a context manager: they end with it, or with the process."""

    def take_team(self, mission: Mission, *, alone: bool = False) -> list[str]:
        """Claim the team for the flight of a mission; return the faults: flights of other missions by that team.

        With `alone` flights of this mission are faults as well.

        Raises InputError without a runtime directory, VehicleRefusedError if nothing can be written there.
        """
        team, digest = f"flight.{mission.network.team}.", "" if mission.identity is None else mission.identity.digest
        with _claims_folder() as folder:
            others = [path for path in folder.glob(f"{team}*") if not path.name.startswith(f"{team}{digest}.")]
            holders = [holder for path in others if (holder := _holder(path)) is not None]
            ours = [path for path in folder.glob(f"{team}{digest}.*") if alone]
            flying = [holder for path in ours if (holder := _holder(path)) is not None]
            self._take(folder / f"{team}{digest}.{getpid()}.{token_hex(4)}")
        return [
            f"team {mission.network.team} flies another mission on this computer,{described(holder)}"
            for holder in holders
        ] + [f"a flight of team {mission.network.team} still runs,{described(holder)}" for holder in flying]

    def take_fed(self, ports: Sequence[int]) -> list[str]:
        """Claim UDP ports for the vehicles that will send to them; return the faults: ports that are fed already.

        Raises InputError without a runtime directory, VehicleRefusedError if nothing can be written there.
        """
        with _claims_folder() as folder:
            holders = {port: self._take(folder / f"fed.udp.{port}") for port in ports}
        return [
            f"udp port {port} receives the vehicle of another run,{described(holder)}"
            for port, holder in holders.items()
            if holder is not None
        ]

    def show_added(self, mission: Mission) -> None:
        """Let `added_text` find the mission of a vehicle that joins a flight, while this process flies it.

        Raises InputError without a runtime directory, VehicleRefusedError if nothing can be written there.
        """
        with _claims_folder() as folder:
            path = folder / _added_name(mission)
            if self._take(path) is None:
                path.write_text(mission.text)

    def _take(self, path: Path) -> int | None:
        """Claim a name; return the process that has it, None if it was free."""
        holder = _holder(path)
        if holder is None:
            claim = _opened(path)
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.write(claim, b"%d" % getpid())
            self.callback(_release, path, claim)
        return holder


def _added_name(mission: Mission) -> str:
    return f"added.{mission.network.team}.{'' if mission.identity is None else mission.identity.digest}"


def added_text(mission: Mission, *, abandoned: bool = False) -> str | None:
    """Return the text of a mission with the vehicle that has joined its flight from this computer, None if none has.

    With `abandoned` it is that of a vehicle whose process was killed, None if none was.

    Raises InputError without a runtime directory, VehicleRefusedError if nothing can be written there.
    """
    with _claims_folder() as folder:
        path = folder / _added_name(mission)
        return path.read_text() if path.exists() and is_locked(path) is not abandoned else None


def _opened(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT, FILE_MODE)


def _holder(path: Path) -> int | None:
    """Return the process that holds a claim; None for one that a killed process has left, which is removed."""
    claim = _opened(path)
    try:
        fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.unlink()
    except BlockingIOError:
        holder = os.read(claim, 32)
        return int(holder) if holder.isdigit() else 0
    finally:
        os.close(claim)
    return None


def _release(path: Path, claim: int) -> None:
    # The directory may be gone: the user has logged out.
    with suppress(InputError, VehicleRefusedError), _claims_folder():
        path.unlink()
    os.close(claim)


@contextmanager
def _claims_folder() -> Iterator[Path]:
    """Return the folder of claims on this computer's ports, locked; a container may have ports of its own."""
    network = Path("/proc/self/ns/net")
    with locked_runtime_folder() as runtime:
        folder = runtime / f".claims-{network.stat().st_ino if network.exists() else 0}"
        make_folder(folder)
        try:
            yield folder
        except OSError as error:
            raise VehicleRefusedError(
                f"{folder}: {error.strerror or error}",
                "runs claim their team and ports in this folder; make it writable",
            ) from error


@contextmanager
def flight_claims(mission: Mission, stubs: Collection[int]) -> Iterator[Claims]:
    """Claim what a flight needs, while it lasts; stubs with the ids `stubs` are about to be started.

    Raises VehicleRefusedError, with the process if the system reports it, when the team, a port, an endpoint or a
    stub's port is in use; InputError without a runtime directory.
    """
    with Claims() as claims:
        faults = claims.take_team(mission)
        if mission.added is not None:
            _require_none(faults, "give the mission file and each --set as the command of that flight has them")
        # Checked before they start. For other vehicles the links and the bus report it, with their other findings.
        vehicles = [mission.vehicle(each) for each in stubs]
        faults += (fault for vehicle in vehicles for fault in _url_faults(vehicle))
        if mission.network.router is None:
            faults += (fault for vehicle in vehicles for fault in _endpoint_faults(vehicle))
        faults += claims.take_fed(fed_ports(vehicles))
        ports = "this mission other ports and another network.team"
        _require_none(faults, f"end the other run, or give {ports if mission.added is None else _ADDED_PORTS}")
        yield claims


@contextmanager
def recovery_claims(mission: Mission, *, beside: bool) -> Iterator[Claims]:
    """Claim a team whose vehicles are in the air, while that lasts.

    Raises as `flight_claims`, also when another flight of the team runs on this computer, unless `beside` is true.
    """
    with Claims() as claims:
        _require_none(claims.take_team(mission, alone=not beside), STILL_FLIES)
        yield claims


@contextmanager
def stub_claims(ports: Sequence[int]) -> Iterator[None]:
    """Claim the ports that stub vehicles send to; raises VehicleRefusedError when another run's vehicles do already.

    Raises InputError without a runtime directory.
    """
    with Claims() as claims:
        _require_none(claims.take_fed(ports), "end the other run, or give this mission other ports")
        yield


def fed_ports(vehicles: Sequence[MissionVehicle]) -> list[int]:
    """Return the UDP ports on which vehicles are received."""
    urls = [urlsplit(vehicle.section.url) for vehicle in vehicles]
    return sorted({url.port for url in urls if url.scheme == "udpin" and url.port})


def _require_none(faults: Sequence[str], next_step: str) -> None:
    if faults:
        raise VehicleRefusedError("; ".join(faults), next_step)


def _url_faults(vehicle: MissionVehicle) -> Iterator[str]:
    """Return whether a vehicle's port is in use."""
    if urlsplit(vehicle.section.url).scheme in _LISTENING:
        try:
            require_usable(vehicle.section.url)
        except VehicleRefusedError as refusal:
            yield refusal.reason


def _endpoint_faults(vehicle: MissionVehicle) -> Iterator[str]:
    """Return whether a vehicle's endpoint on the bus is in use."""
    protocol, _, place = vehicle.section.endpoint.partition("/")
    host, _, port = place.rpartition(":")
    kind = socket.SOCK_STREAM if protocol in ("tcp", "tls") else socket.SOCK_DGRAM
    with suppress(ValueError):  # Zenoh itself checks names and other addresses
        fault = bind_fault(kind, host.strip("[]"), int(port))
        if fault is not None and fault.errno == errno.EADDRINUSE:
            yield f"endpoint {vehicle.section.endpoint} is in use{port_holder(kind, int(port))}"


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
