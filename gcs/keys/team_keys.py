"""The keys that a mission's team uses: those that `[network.security]` names, or those of this computer's flights."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path
from typing import Protocol

from agents.team.participant import Participant, Role
from gcs.errors import InputError
from gcs.keys.identity import FlyingIdentity, Identity, user_name
from gcs.keys.key_folder import KeyFolder
from gcs.keys.roster import Holder
from gcs.keys.run_keys import RunKeys
from gcs.mission.mission import Mission

INSECURE = (
    "network.security.insecure: the bus is neither encrypted nor authenticated; any host that reaches it can command"
    " the vehicles"
)

_MAKE_KEYS = "create keys by `cordon keys init` and set `keys` to their folder, or set `insecure = true`"


class TeamKeys(Protocol):
    """The source of the identities on a team's bus."""

    def identity(self, role: Role, name: str | None = None) -> Identity:
        """Return a holder's identity; without a name that of this computer's only holder of the role.

        Raises InputError if its keys are missing or invalid, VehicleRefusedError if no flight runs.
        """
        ...

    def flying(self, vehicle_ids: Sequence[int]) -> Sequence[FlyingIdentity]:
        """Return the identities of a process that flies these vehicles; raises as `identity`."""
        ...

    def holders(self) -> Sequence[Holder] | None:
        """Return who is admitted to the bus, None before keys are made; raises InputError if keys are missing."""
        ...


def read_only_folders(mission: Mission) -> Sequence[Path]:
    """Return the folders of the mission's keys here in which no newer roster can be kept."""
    keys = team_keys(mission)
    return keys.read_only if isinstance(keys, KeyFolder) else ()


class NoKeys:
    """The identities on a bus without keys."""

    def identity(self, role: Role, name: str | None = None) -> Identity:
        """Return the identity of a vehicle, or of this user."""
        return Identity(Participant(role, name or user_name()))

    def flying(self, vehicle_ids: Sequence[int]) -> Sequence[FlyingIdentity]:
        """Return the single identity of a process that flies these vehicles."""
        return [FlyingIdentity(tuple(vehicle_ids))]

    def holders(self) -> None:
        """Return None."""


def team_keys(mission: Mission) -> TeamKeys:
    """Return the keys of a mission's team; raises InputError if it needs keys and has none."""
    if faults := security_faults(mission):
        raise InputError(faults)
    security = mission.network.security
    if security is None:
        # The process of an added vehicle uses those of the flight that it joins.
        ids = tuple(each for each in mission.ids if each != mission.added)
        return RunKeys(mission.network.team, ids, mission.added)
    if security.keys is None:
        return NoKeys()
    return KeyFolder(mission.folder / security.keys)


@contextmanager
def flight_keys(mission: Mission, *, joins: bool = False) -> Iterator[TeamKeys]:
    """Return the keys for a flight; keys of a run exist as long as this context.

    Raises InputError, and VehicleRefusedError if it `joins` one that does not run.
    """
    keys = team_keys(mission)
    if isinstance(keys, RunKeys):
        with keys.held(joins=joins):
            yield keys
    else:
        yield keys


def leaves_this_computer(mission: Mission) -> bool:
    """Return whether a mission's bus reaches beyond this computer."""
    endpoints = (vehicle.section.endpoint for vehicle in mission.vehicles)
    return mission.network.router is not None or not all(map(_is_loopback, endpoints))


def security_faults(mission: Mission) -> list[str]:
    """Return why the bus of a mission must not be opened: addresses beyond this computer without keys."""
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
