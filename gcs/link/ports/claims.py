"""Exclusive use of a team and of ports by one run of cordon on this computer: a second run is refused before its start.

A run claims the team that it flies, and the UDP ports that its vehicles send to. A claim is a Unix socket with an
abstract name (man 7 unix): the system removes it with its process, however that ends, and keeps one list for all users
in each network namespace, as it does for ports. Systems other than Linux have no such names: there only
ports and endpoints are checked.
"""

import errno
import socket
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from os import getpid
from secrets import token_hex
from urllib.parse import urlsplit

from agents.ports import VehicleRefusedError
from gcs.link.ports.holders import abstract_sockets, bind_fault, described, port_holder
from gcs.link.ports.urls import require_usable
from gcs.mission.mission import Mission, MissionVehicle

_FLIGHT = "cordon/flight/"
_FED = "cordon/fed/udp/"
_LISTENING = ("udpin", "tcpin")


class Claims(ExitStack):
    """The claims of this process, to be used as a context manager: they end with it, or with the process."""

    def take(self, name: str) -> bool:
        """Claim a name; return whether it was free, always true on systems without abstract names."""
        if sys.platform != "linux":
            return True
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0{name}")
        except OSError as error:
            claim.close()
            if error.errno == errno.EADDRINUSE:
                return False
            raise
        self.callback(claim.close)
        return True

    def take_team(self, mission: Mission) -> Iterator[str]:
        """Claim the team for the flight of a mission; return the faults: flights of other missions by that team."""
        team, digest = f"{_FLIGHT}{mission.network.team}/", "" if mission.identity is None else mission.identity.digest
        for name in abstract_sockets(team):
            other, _, process = name.removeprefix(team).partition("/")
            if other != digest:
                holder = described(int(process.partition("/")[0]))
                yield f"team {mission.network.team} flies another mission on this computer,{holder}"
        self.take(f"{team}{digest}/{getpid()}/{token_hex(4)}")

    def take_fed(self, ports: Sequence[int]) -> Iterator[str]:
        """Claim UDP ports for the vehicles that will send to them; return the faults: ports that are fed already."""
        for port in ports:
            if not self.take(f"{_FED}{port}"):
                holder = abstract_sockets(f"{_FED}{port}").get(f"{_FED}{port}")
                yield f"udp port {port} receives the vehicle of another run,{described(holder)}"


@contextmanager
def flight_claims(mission: Mission, stubs: Collection[int]) -> Iterator[Claims]:
    """Claim what a flight needs, while it lasts; stubs with the ids `stubs` are about to be started.

    Raises VehicleRefusedError, with the process if the system reports it, when the team, a port, an endpoint or a
    stub's port is in use.
    """
    with Claims() as claims:
        faults = list(claims.take_team(mission))
        # Checked before they start. For other vehicles the links and the bus report it, with their other findings.
        vehicles = [mission.vehicle(each) for each in stubs]
        faults += (fault for vehicle in vehicles for fault in _url_faults(vehicle))
        if mission.network.router is None:
            faults += (fault for vehicle in vehicles for fault in _endpoint_faults(vehicle))
        faults += claims.take_fed(fed_ports(vehicles))
        _require_none(faults, "end the other run, or give this mission other ports and another network.team")
        yield claims


@contextmanager
def stub_claims(ports: Sequence[int]) -> Iterator[None]:
    """Claim the ports that stub vehicles send to; raises VehicleRefusedError when another run's vehicles do already."""
    with Claims() as claims:
        _require_none(list(claims.take_fed(ports)), "end the other run, or give this mission other ports")
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
