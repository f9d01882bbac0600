"""The keys that a mission's team uses: those that `[network.security]` names, or those of this computer's flights."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ipaddress import ip_address
from typing import Protocol

from agents.team.participant import Participant, Role
from gcs.errors import InputError
from gcs.keys.identity import FlyingIdentity, Identity, user_name
from gcs.keys.key_folder import KeyFolder
from gcs.keys.run_keys import RunKeys
from gcs.mission.mission import Mission

INSECURE = (
    "network.security.insecure: the bus is neither encrypted nor authenticated; any host that reaches it can command"
    " the vehicles"
)

_MAKE_KEYS = "make keys by `cordon keys init`, and name their folder by `keys`, or write `insecure = true`"


class TeamKeys(Protocol):
    """Where the identities on a team's bus come from."""

    def identity(self, role: Role, name: str | None = None) -> Identity:
        """Return a holder's identity; without a name this computer's only one of the role.

        Raises InputError when its keys are not here or do not count, VehicleRefusedError where no flight runs.
        """
        ...

    def flying(self, vehicle_ids: Sequence[int]) -> Sequence[FlyingIdentity]:
        """Return the identities of a process that flies these vehicles; raises the same."""
        ...


class NoKeys:
    """The names on a bus without keys."""

    def identity(self, role: Role, name: str | None = None) -> Identity:
        """Return the identity of a vehicle, or of this user."""
        return Identity(Participant(role, name or user_name()))

    def flying(self, vehicle_ids: Sequence[int]) -> Sequence[FlyingIdentity]:
        """Return the one identity of a process that flies these vehicles."""
        return [FlyingIdentity(tuple(vehicle_ids))]


def team_keys(mission: Mission) -> TeamKeys:
    """Return where a mission's team has its keys; raises InputError where it has none and needs them."""
    if faults := security_faults(mission):
        raise InputError(faults)
    security = mission.network.security
    if security is None:
        return RunKeys(mission.network.team, mission.ids)
    if security.keys is None:
        return NoKeys()
    return KeyFolder(mission.folder / security.keys)


@contextmanager
def flight_keys(mission: Mission) -> Iterator[TeamKeys]:
    """Return the same to a flight, whose keys exist as long as this context; raises InputError."""
    keys = team_keys(mission)
    if isinstance(keys, RunKeys):
        with keys.held():
            yield keys
    else:
        yield keys


def leaves_this_computer(mission: Mission) -> bool:
    """Return whether a mission's bus reaches beyond this computer."""
    endpoints = (vehicle.section.endpoint for vehicle in mission.vehicles)
    return mission.network.router is not None or not all(map(_is_loopback, endpoints))


def security_faults(mission: Mission) -> list[str]:
    """Return what forbids to open the bus of a mission: addresses beyond this computer without keys."""
    if mission.network.security is not None:
        return []
    if mission.network.router is not None:
        return [f"network.router: [network.security] is missing; next: {_MAKE_KEYS}"]
    return [
        f"vehicles[{index}].endpoint: {vehicle.section.endpoint} is beyond this computer, and [network.security] is"
        f" missing; next: {_MAKE_KEYS}"
        for index, vehicle in enumerate(mission.vehicles)
        if not _is_loopback(vehicle.section.endpoint)
    ]


def _is_loopback(endpoint: str) -> bool:
    host = endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
