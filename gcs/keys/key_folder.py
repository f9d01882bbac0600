"""A folder of keys on a computer of the team: one folder for each holder that uses this computer."""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import time

import msgspec

from agents.shell.bus_security import BusSecurity
from agents.team.participant import Role
from gcs.errors import InputError
from gcs.keys.approval import KILL_KEY_FILE, KillSigner
from gcs.keys.identity import FlyingIdentity, Identity
from gcs.keys.private_files import check_folder, make_folder, read, read_private, runtime_folder, write
from gcs.keys.roster import ROSTER_FILE, Holder, KeptRoster, Roster, approved, read_roster, write_roster

AUTHORITY_FILE, CERTIFICATE_FILE, PRIVATE_KEY_FILE = "authority.pem", "certificate.pem", "private-key.pem"


@dataclass(frozen=True, slots=True)
class KeyFolder:
    """The keys in `path`, each holder's in a folder such as `vehicle-3`: with its certificate and private key, the
    authority's certificate, and the roster. A holder's folder is copied to its computer as a whole.
    """

    path: Path

    def identity(self, role: Role, name: str | None = None) -> Identity:
        """Return a holder's identity; without a name that of the only holder of this role. Raises InputError."""
        folder = self._folder(role, name)
        roster = _roster(folder)
        holder = _holder(roster, folder)
        if holder.expires_s <= time():
            renew = f"cordon keys renew {holder.label}"
            raise InputError([f"{folder}: its certificate has expired; next: {renew}, and copy the folder again"])
        authority_pem = read(folder / AUTHORITY_FILE)
        signer = _signer(roster, authority_pem, folder)
        if signer is not None and not signer.is_approved(holder.common_name):
            holder = holder.unapproved
        security = BusSecurity(
            authority_pem,
            read(folder / CERTIFICATE_FILE),
            read_private(folder / PRIVATE_KEY_FILE),
            tuple(each.grant for each in roster.valid),
            roster.serial,
            KeptRoster(folder / ROSTER_FILE, authority_pem),
            _sockets(),
            signer,
        )
        return Identity(holder.participant, security, holder.may)

    def holders(self) -> Sequence[Holder]:
        """Return the holders that are not revoked, by the newest roster here; those here until their own certificate.

        Raises InputError if no folder here counts.
        """
        rosters, here, faults = list[Roster](), dict[str, Holder](), list[InputError]()
        for file in sorted(self.path.glob(f"*/{ROSTER_FILE}")):
            try:
                rosters.append(_roster(file.parent))
                holder = _holder(rosters[-1], file.parent)
            except InputError as error:
                faults.append(error)
            else:
                here[holder.label] = holder
        if rosters:
            newest = max(rosters, key=lambda roster: roster.serial)
            return tuple(here.get(each.label, each) for each in newest.valid)
        raise (
            faults[0]
            if faults
            else InputError([f"{self.path}: no keys here; next: {self._next_step('vehicle', None)}"])
        )

    @property
    def read_only(self) -> Sequence[Path]:
        """The folders here in which neither a newer roster nor its serial can be kept."""
        folders = (file.parent for file in sorted(self.path.glob(f"*/{ROSTER_FILE}")))
        return tuple(folder for folder in folders if not os.access(folder, os.W_OK))

    @property
    def authority_pem(self) -> bytes:
        """The authority's certificate, from the folder of a holder here; raises InputError if there is none."""
        for file in sorted(self.path.glob(f"*/{AUTHORITY_FILE}")):
            return read(file)
        raise InputError([f"{self.path}: no keys here; next: {self._next_step('vehicle', None)}"])

    def flying(self, vehicle_ids: Sequence[int]) -> Sequence[FlyingIdentity]:
        """Return the identities of a process that flies these vehicles, one for each. Raises InputError."""
        return [FlyingIdentity((each,), self.identity("vehicle", str(each)).security) for each in vehicle_ids]

    def put(self, holder: Holder, certificate_pem: bytes, private_key_pem: bytes, authority_pem: bytes) -> Path:
        """Write a holder's folder without the roster; return its path. Raises InputError."""
        folder = self.path / holder.label
        make_folder(folder)
        write(folder / AUTHORITY_FILE, authority_pem)
        write(folder / CERTIFICATE_FILE, certificate_pem)
        write(folder / PRIVATE_KEY_FILE, private_key_pem)
        return folder

    def put_roster(self, roster: Roster) -> None:
        """Write the signed roster to this folder and to the folder of each of its holders; raises InputError."""
        for folder in (self.path, *(self.path / holder.label for holder in roster.holders)):
            if folder.is_dir():
                write_roster(folder / ROSTER_FILE, roster)

    def _folder(self, role: Role, name: str | None) -> Path:
        folder = self.path / f"{role}-{self._only(role) if name is None else name}"
        if not folder.is_dir():
            raise InputError([f"{folder}: no such folder of keys; next: {self._next_step(role, name)}"])
        check_folder(folder)
        return folder

    def _only(self, role: Role) -> str:
        try:
            found = sorted(path.name for path in self.path.glob(f"{role}-*") if path.is_dir())
        except OSError as error:
            raise InputError([f"{self.path}: {error.strerror or error}"]) from error
        if not found:
            raise InputError([f"{self.path}: no {role} keys here; next: {self._next_step(role, None)}"])
        if len(found) > 1:
            raise InputError([f"--key: {self.path} has the keys of several {role}s; choose one ({', '.join(found)})"])
        return found[0].removeprefix(f"{role}-")

    def _next_step(self, role: Role, name: str | None) -> str:
        issue = f"cordon keys issue {role} {name or 'NAME'} --keys {self.path}"
        return f"issue them by `{issue}`, or copy the folder {role}-{name or 'NAME'} from the computer that issued them"


def _sockets() -> Path | None:
    """Return the folder of sockets between programs of this user, None if there is none that is closed to others."""
    with suppress(InputError):
        return runtime_folder()
    return None


def _roster(folder: Path) -> Roster:
    authority_pem = read(folder / AUTHORITY_FILE)
    return approved(read_roster(folder / ROSTER_FILE, authority_pem), authority_pem)


def _signer(roster: Roster, authority_pem: bytes, folder: Path) -> KillSigner | None:
    """Return what signs and verifies kills by the approvals in a roster, None if they need none; raises InputError."""
    from gcs.keys.certificates import approvers  # noqa: PLC0415

    if not approvers(authority_pem):
        return None
    file = folder / KILL_KEY_FILE
    grants = tuple(grant for each in roster.valid for grant in each.approvals)
    return KillSigner(grants, read_private(file) if file.exists() else None)


def _holder(roster: Roster, folder: Path) -> Holder:
    """Return the holder of a folder, until when its own certificate is valid; raises InputError unless it counts."""
    from gcs.keys.certificates import name_and_expiry  # noqa: PLC0415

    holder = next((each for each in roster.holders if each.label == folder.name), None)
    if holder is None:
        raise InputError([f"{folder / ROSTER_FILE}: it has no entry for {folder.name}; next: copy the folder again"])
    if holder.revoked:
        raise InputError([f"{folder}: these keys are revoked; next: cordon keys issue {holder.role} {holder.name}"])
    file = folder / CERTIFICATE_FILE
    try:
        common_name, expires_s = name_and_expiry(read(file))
    except ValueError as error:
        raise InputError([f"{file}: not a certificate: {error}; next: copy the folder again"]) from error
    if common_name != holder.common_name:
        found = f"it is the certificate {common_name}; the roster admits {holder.common_name}"
        raise InputError([f"{file}: {found}; next: copy the folder again"])
    return msgspec.structs.replace(holder, expires_s=min(holder.expires_s, expires_s))
