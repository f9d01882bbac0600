"""The keys of flights on one computer, created automatically: by the first flying process of a team, in the user's
runtime directory. Later processes share them; the last one removes them.
"""

import fcntl
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from time import time

from msgspec.structs import replace

from agents.ports import VehicleRefusedError
from agents.team.participant import Role
from agents.team.verbs import VERBS
from gcs.keys.identity import FlyingIdentity, Identity, user_name
from gcs.keys.key_folder import KeyFolder
from gcs.keys.private_files import locked, locked_runtime_folder, make_folder
from gcs.keys.roster import Holder, Roster, digest
from sitl.server.file_lock import is_locked

_VALID_DAYS = 7.0
"""Longer than any flight: the keys are removed when its last process ends."""


@dataclass(frozen=True, slots=True)
class RunKeys:
    """The keys of a team's vehicles, and of this user as operator, sensor, source of positions and observer.

    The vehicles share one certificate: a user who can read one vehicle's keys can read all of them, and a process needs
    only one session for all its vehicles. They are those of a vehicle that is `added` to the flight as well.
    The keys are in use as long as a process holds a shared lock on their folder. A lock on the folder above serialises
    processes that create, look up and remove keys. Locks end with their processes: keys left by a killed process are
    replaced.
    """

    team: str
    ids: tuple[int, ...]
    added: int | None = None

    def identity(self, role: Role, name: str | None = None) -> Identity:
        """Return the identity of the vehicles, or of this user.

        Raises VehicleRefusedError if no flight of the team runs on this computer, InputError for another user's folder.
        """
        with locked_runtime_folder() as runtime:
            folder = runtime / self.team
            if not _in_use(folder):
                raise VehicleRefusedError(
                    f"no flight of team {self.team} runs on this computer under this user",
                    "start it with `cordon fly`, or check that --mission names its mission; to reach a team that flies"
                    " from other computers, the mission needs [network.security]",
                )
            return KeyFolder(folder).identity(role, name)

    def flying(self, vehicle_ids: Sequence[int]) -> Sequence[FlyingIdentity]:
        """Return the single identity of a process that flies these vehicles; raises as `identity`."""
        return [FlyingIdentity(tuple(vehicle_ids), self.identity("vehicle").security)]

    def holders(self) -> Sequence[Holder] | None:
        """Return who is admitted to the bus of the flight on this computer, None if none runs; raises InputError."""
        with locked_runtime_folder() as runtime:
            folder = runtime / self.team
            holders = KeyFolder(folder).holders() if _in_use(folder) else None
        if holders is None or self.added is None:
            return holders
        return [replace(each, speaks_for=(*each.speaks_for, self.added)) if each.vehicles else each for each in holders]

    @contextmanager
    def held(self, *, joins: bool = False) -> Iterator[None]:
        """Hold the keys inside this context, which makes them for a first process, unless it `joins` a flight.

        Raises InputError if the runtime directory cannot be used, VehicleRefusedError if a flight of other vehicles has
        the team's name, or none runs that could be joined.
        """
        if joins:
            self.identity("vehicle")
        with locked_runtime_folder() as runtime:
            folder = runtime / self.team
            if _in_use(folder):
                self._require_own_vehicles(folder)
            else:
                shutil.rmtree(folder, ignore_errors=True)
                self._make(folder)
            use = os.open(folder, os.O_RDONLY)
            fcntl.flock(use, fcntl.LOCK_SH)
        try:
            yield
        finally:
            with suppress(OSError), locked(runtime):  # the directory may be gone: the user has logged out
                os.close(use)
                if not _in_use(folder):
                    shutil.rmtree(folder, ignore_errors=True)

    def _require_own_vehicles(self, folder: Path) -> None:
        flying = {name for each in KeyFolder(folder).holders() for name in each.vehicles}
        if others := [vehicle_id for vehicle_id in self.ids if str(vehicle_id) not in flying]:
            raise VehicleRefusedError(
                f"a flight of team {self.team} runs on this computer with vehicles {', '.join(sorted(flying))}, without"
                f" {', '.join(map(str, others))}",
                "end that flight, or give this mission another team name in [network]",
            )

    def _make(self, folder: Path) -> None:
        from gcs.keys.certificates import DAY_S, CertificateAuthority  # noqa: PLC0415

        authority = CertificateAuthority.made(_VALID_DAYS)
        authority_pem = authority.keys.certificate_pem
        make_folder(folder)
        keys, holders = KeyFolder(folder), tuple(self._holders(time() + _VALID_DAYS * DAY_S))
        for holder in holders:
            pair = authority.issue(holder.common_name, holder.expires_s)
            keys.put(holder, pair.certificate_pem, pair.private_key_pem, authority_pem)
        keys.put_roster(Roster(digest(authority_pem)).put(*holders).signed(authority.sign))

    def _holders(self, expires_s: float) -> Iterator[Holder]:
        first, *others = self.ids
        yield Holder("vehicle", str(first), expires_s, speaks_for=tuple(others))
        yield Holder("operator", user_name(), expires_s, tuple(VERBS))
        yield Holder("sensor", user_name(), expires_s)
        yield Holder("positions", user_name(), expires_s)
        yield Holder("observer", user_name(), expires_s)


def _in_use(folder: Path) -> bool:
    """Return whether a process holds the keys in a folder."""
    try:
        return is_locked(folder)
    except FileNotFoundError:  # its flight has just ended
        return False
