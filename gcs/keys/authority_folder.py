"""The folder of keys on the computer that issues them, with the authority that signs them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import time

import msgspec

from agents.team.participant import Role, is_name
from agents.team.verbs import VERBS, Verb
from gcs.errors import InputError
from gcs.keys.approval import REQUEST_FILE, KillGrant
from gcs.keys.certificates import DAY_S, CertificateAuthority, KeyPair, approvers, fingerprint_of_pem
from gcs.keys.key_folder import CERTIFICATE_FILE, PRIVATE_KEY_FILE, KeyFolder
from gcs.keys.private_files import locked, make_folder, read, read_private, write
from gcs.keys.roster import ROSTER_FILE, Holder, Roster, approved, digest, read_roster, unverified_roster, used_serial

AUTHORITY = "authority"


def no_passphrase() -> bytes:
    """Raise InputError: the passphrase cannot be asked for here."""
    raise InputError(["the authority's private key is encrypted: its passphrase is needed"])


@dataclass(frozen=True, slots=True)
class AuthorityFolder:
    """Issues and revokes the keys in one folder; its folder `authority` stays on this computer.

    `passphrase` is called for an encrypted private key of the authority.
    """

    path: Path
    passphrase: Callable[[], bytes] = no_passphrase

    @property
    def roster(self) -> Roster:
        """All holders; raises InputError if there is no authority."""
        return read_roster(self.path / ROSTER_FILE, self._certificate_pem)

    @property
    def approvers(self) -> Sequence[str]:
        """The fingerprints of those who approve kill, empty if it needs no approval; raises InputError."""
        return approvers(self._certificate_pem)

    @property
    def awaiting(self) -> Sequence[tuple[Holder, Path]]:
        """The operators whose kill is not approved until their keys expire, and the files of their requests."""
        roster = self.roster
        if not self.approvers:
            return []
        until = {
            each.label: max((grant.expires_s for grant in each.approvals), default=0.0)
            for each in approved(roster, self._certificate_pem).valid
        }
        unapproved = (each for each in roster.valid if each.may_kill and until[each.label] < each.expires_s)
        return [(each, self.path / each.label / REQUEST_FILE) for each in unapproved]

    @property
    def roster_to_sign(self) -> Roster:
        """The roster if it is not signed, as those of earlier versions, newer than all before it here.

        Raises InputError for one that was altered after it was signed.
        """
        path = self.path / ROSTER_FILE
        roster = unverified_roster(path, self._certificate_pem)
        if roster.signature:
            return self.roster
        return msgspec.structs.replace(roster, serial=used_serial(path) + 1)

    def sign(self, roster: Roster) -> None:
        """Sign a roster, and write it to this folder and the folders of its holders here; raises InputError."""
        self._put(roster, self._load_authority())

    def init(self, days: float, approver_keys: Sequence[Path] = (), token: str | None = None) -> None:
        """Create the authority of a team, with its approvers' public keys in files; raises InputError.

        There must not be one already. With the URI of a `token` its private key is there; the PIN is the passphrase.
        """
        named = tuple(map(_fingerprint, approver_keys))
        if self._authority.exists():
            raise InputError([f"{self.path}: there is an authority already; next: choose another folder by --keys"])
        try:
            authority = CertificateAuthority.made(days, named, None if token is None else (token, self.passphrase()))
        except ValueError as error:
            raise InputError([f"--token: {error}"]) from error
        make_folder(self.path)
        make_folder(self._authority)
        keys = authority.keys
        write(self._authority / PRIVATE_KEY_FILE, keys.private_key_pem)
        write(self._authority / CERTIFICATE_FILE, keys.certificate_pem)
        self._put(Roster(digest(keys.certificate_pem)).put(), authority)

    def encrypt(self, new_passphrase: Callable[[], bytes]) -> None:
        """Encrypt the authority's private key with a passphrase, or with another one; raises InputError."""
        authority = self._load_authority()
        if authority.keys.is_on_token:
            raise InputError([f"{self._authority}: its private key is on a token, which has a PIN"])
        write(self._authority / PRIVATE_KEY_FILE, authority.encrypted(new_passphrase()))

    def issue(self, role: Role, name: str, days: float, may: tuple[Verb, ...] | None = None) -> Holder:
        """Issue a holder's certificate, valid for `days`; one issued before is no longer valid.

        `may` are the verbs of an operator, None for all but kill. Raises InputError.
        """
        with self._changing() as (roster, authority):
            _require_name(role, name)
            before = roster.find(role, name)
            holder = Holder(
                role,
                name,
                min(time() + days * DAY_S, authority.expires_s),
                _verbs(role, may),
                1 if before is None else before.generation + 1,
            )
            self._certify(holder, authority)
            self._put(roster.put(holder), authority)
        return holder

    def renew(self, label: str | None, days: float) -> Sequence[Holder]:
        """Issue new certificates, valid for `days`, under the names of the present ones, which expire by themselves.

        Of one holder that is not revoked, or of all. Raises InputError.
        """
        with self._changing() as (roster, authority):
            until = min(time() + days * DAY_S, authority.expires_s)
            holders = roster.valid if label is None else [_of(roster.valid, label)]
            renewed = [msgspec.structs.replace(each, expires_s=until) for each in holders]
            for holder in renewed:
                self._certify(holder, authority)
            self._put(roster.put(*renewed), authority)
        return renewed

    def admit(self, path: Path) -> Holder:
        """Put an approval from a file into the roster; return the operator who may kill with it. Raises InputError."""
        approval = KillGrant.read(path)
        with self._changing() as (roster, authority):
            known = [each for each in roster.valid if each.common_name == approval.common_name and each.may_kill]
            if not approval.signature:
                approve = f"cordon keys approve {path} APPROVER"
                raise InputError([f"{path}: no approver has signed this request; next: the approver runs `{approve}`"])
            if not known or approval.authority != roster.authority:
                wanted = f"{approval.common_name} of this authority is granted no kill"
                raise InputError([f"{path}: {wanted}; next: cordon keys issue operator NAME --may VERBS"])
            if approval.is_expired or not approval.is_approved(approvers(authority.keys.certificate_pem)):
                fault = "it has expired" if approval.is_expired else "it was altered, or is of no approver here"
                request = self.path / known[0].label / REQUEST_FILE
                raise InputError([f"{path}: {fault}; next: cordon keys approve {request} APPROVER"])
            kept = [each for each in known[0].approvals if each != approval and not each.is_expired]
            holder = msgspec.structs.replace(known[0], approvals=(*kept, approval))
            self._put(roster.put(holder), authority)
        return holder

    def revoke(self, label: str) -> Holder:
        """Revoke the certificate of a holder such as `operator-anna`; raises InputError if there is none."""
        with self._changing() as (roster, authority):
            holder = _of(roster.holders, label)
            if holder.revoked:
                return holder
            revoked = msgspec.structs.replace(holder, revoked=True)
            self._put(roster.put(revoked), authority)
        return revoked

    @contextmanager
    def _changing(self) -> Iterator[tuple[Roster, CertificateAuthority]]:
        """Return the roster, which no other process changes inside this context, and the authority."""
        authority = self._load_authority()
        with locked(self._authority):
            yield self.roster, authority

    def _certify(self, holder: Holder, authority: CertificateAuthority) -> None:
        keys = authority.issue(holder.common_name, holder.expires_s)
        authority_pem = authority.keys.certificate_pem
        folder = KeyFolder(self.path).put(holder, keys.certificate_pem, keys.private_key_pem, authority_pem)
        if holder.may_kill and approvers(authority_pem):
            KillGrant(digest(authority_pem), holder.common_name, holder.expires_s).write(folder / REQUEST_FILE)

    def _put(self, roster: Roster, authority: CertificateAuthority) -> None:
        KeyFolder(self.path).put_roster(roster.signed(authority.sign))

    @property
    def _authority(self) -> Path:
        return self.path / AUTHORITY

    @property
    def _certificate_pem(self) -> bytes:
        if not self._authority.is_dir():
            raise InputError([f"{self.path}: there is no authority; next: cordon keys init --keys {self.path}"])
        return read(self._authority / CERTIFICATE_FILE)

    def _load_authority(self) -> CertificateAuthority:
        keys = KeyPair(self._certificate_pem, read_private(self._authority / PRIVATE_KEY_FILE))
        is_encrypted = b"-----BEGIN ENCRYPTED PRIVATE KEY-----" in keys.private_key_pem
        try:
            return CertificateAuthority(keys, self.passphrase() if is_encrypted or keys.is_on_token else None)
        except ValueError as error:
            if is_encrypted:
                raise InputError([f"{self._authority}: the passphrase is wrong"]) from error
            raise InputError([f"{self._authority}: the authority's keys cannot be read: {error}"]) from error


def _fingerprint(path: Path) -> str:
    try:
        return fingerprint_of_pem(read(path))
    except ValueError as error:
        raise InputError([f"{path}: not an approver's public key: {error}"]) from error


def _of(holders: Sequence[Holder], label: str) -> Holder:
    holder = next((each for each in holders if each.label == label), None)
    if holder is None:
        known = ", ".join(each.label for each in holders) or "none"
        raise InputError([f"{label}: no keys of this name were issued (issued: {known})"])
    return holder


def _verbs(role: Role, may: tuple[Verb, ...] | None) -> tuple[Verb, ...]:
    if role != "operator":
        return ()
    by_default = (row.name for row in VERBS.values() if not row.is_dangerous)
    return tuple(dict.fromkeys(by_default if may is None else may))


def _require_name(role: Role, name: str) -> None:
    if role == "vehicle" and not (name.isdecimal() and name == str(int(name)) and 1 <= int(name) <= 254):
        raise InputError([f"{name}: a vehicle's keys are issued for its id, 1 to 254"])
    if not is_name(name):
        raise InputError([f"{name}: a name is at most 32 letters, digits, '_', '.' and '-'"])
