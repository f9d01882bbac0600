"""Approvals of kill by a second person, where the authority's certificate names approvers.

An approver creates an operator's *kill key* and signs its public part for one certificate. The operator signs each kill
with the kill key. So a kill needs a certificate of the authority and a kill key of an approver: neither can send one
without the other.
"""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from time import time
from typing import Self

import msgspec

from agents.team.participant import is_name
from gcs.errors import InputError
from gcs.keys.private_files import make_folder, read, read_private, write

REQUEST_FILE, APPROVAL_FILE, KILL_KEY_FILE = "kill-request.json", "kill-approval.json", "kill-key.pem"
_PRIVATE_KEY_FILE, PUBLIC_KEY_FILE = "private-key.pem", "public-key.pem"
EXPIRES_MAX_S = 253_402_128_000.0
_COMMON_NAME = re.compile(r"operator-[^~]+(~[0-9]+)?")
_SHA_256 = re.compile(r"[0-9a-f]{64}")


class KillGrant(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The grant of kill to an operator's certificate until `expires_s` [Unix s].

    `authority` is the SHA-256 of the authority's certificate, in hex. In a request the public keys of the approver and
    of the operator's kill key (DER), and the approver's signature of all other fields, are empty. Raises ValueError for
    an invalid name or time.
    """

    authority: str
    common_name: str
    expires_s: float
    approver: bytes = b""
    kill_key: bytes = b""
    signature: bytes = b""

    def __post_init__(self) -> None:
        if _COMMON_NAME.fullmatch(self.common_name) is None or not is_name(self.operator):
            raise ValueError(f"common_name {self.common_name!r}: not an operator's")
        if _SHA_256.fullmatch(self.authority) is None:
            raise ValueError(f"authority {self.authority!r}: not a SHA-256")
        if not 0.0 <= self.expires_s < EXPIRES_MAX_S:
            raise ValueError(f"expires_s {self.expires_s}: not a time before the year 10000")

    @property
    def operator(self) -> str:
        """The name of the operator."""
        return self.common_name.removeprefix("operator-").partition("~")[0]

    @property
    def until(self) -> str:
        """The minute in which it expires, in this computer's time zone."""
        return f"{datetime.fromtimestamp(self.expires_s):%Y-%m-%d %H:%M}"

    @property
    def is_expired(self) -> bool:
        """Whether it has expired."""
        return self.expires_s <= time()

    @property
    def signed_content(self) -> bytes:
        """What the approver signs."""
        return msgspec.json.encode(msgspec.structs.replace(self, signature=b""))

    def is_approved(self, approvers: Sequence[str]) -> bool:
        """Return whether one of the approvers with these fingerprints has signed it."""
        from gcs.keys.certificates import fingerprint, is_signed_by  # noqa: PLC0415

        is_approver = fingerprint(self.approver) in approvers
        return is_approver and is_signed_by(self.approver, self.signed_content, self.signature)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a request or an approval; raises InputError."""
        try:
            return msgspec.json.decode(read(path), type=cls)
        except (msgspec.MsgspecError, RecursionError) as error:
            raise InputError([f"{path}: neither a request nor an approval of kill: {error}"]) from error

    def write(self, path: Path) -> None:
        """Write it to a file; raises InputError."""
        write(path, msgspec.json.format(msgspec.json.encode(self), indent=1) + b"\n")


@dataclass(frozen=True, slots=True)
class ApproverFolder:
    """An approver's key pair and approvals, in a folder of its own; `passphrase` is called for the private key."""

    path: Path
    passphrase: Callable[[], bytes]

    def make(self) -> Path:
        """Create the key pair; return the path of its public key. Raises InputError if there is one already."""
        from gcs.keys.certificates import ContentKey  # noqa: PLC0415

        if self.path.exists():
            raise InputError([f"{self.path}: it exists already; next: choose another name"])
        passphrase, keys = self.passphrase(), ContentKey.made()
        make_folder(self.path)
        write(self.path / _PRIVATE_KEY_FILE, keys.pem(passphrase))
        write(self.path / PUBLIC_KEY_FILE, keys.public_pem)
        return self.path / PUBLIC_KEY_FILE

    def approve(self, request: KillGrant) -> Path:
        """Create a kill key and approve a request for it; return the folder of both files. Raises InputError."""
        from gcs.keys.certificates import ContentKey  # noqa: PLC0415

        private_key_pem = read_private(self.path / _PRIVATE_KEY_FILE)
        try:
            own = ContentKey(private_key_pem, self.passphrase())
        except (ValueError, TypeError) as error:
            raise InputError([f"{self.path}: the passphrase is wrong"]) from error
        kill_key, folder = ContentKey.made(), self.path / request.common_name
        grant = msgspec.structs.replace(request, approver=own.public_key, kill_key=kill_key.public_key)
        make_folder(folder)
        write(folder / KILL_KEY_FILE, kill_key.pem())
        msgspec.structs.replace(grant, signature=own.sign(grant.signed_content)).write(folder / APPROVAL_FILE)
        return folder


@dataclass(frozen=True, slots=True)
class KillSigner:
    """Signs kills with an operator's kill key, and verifies those of others; implements agents.shell's CommandSigner.

    `approved` are the grants that approvers have signed.
    """

    approved: tuple[KillGrant, ...]
    kill_key_pem: bytes | None = field(default=None, repr=False)

    def is_approved(self, common_name: str) -> bool:
        """Return whether its kill key is approved for a certificate."""
        from gcs.keys.certificates import ContentKey  # noqa: PLC0415

        with suppress(ValueError, TypeError):
            public_key = ContentKey(self.kill_key_pem or b"").public_key
            return any((each.common_name, each.kill_key) == (common_name, public_key) for each in self.approved)
        return False

    def signed(self, key: str, payload: bytes) -> bytes:
        """Return the payload of a kill with its signature; unchanged without a kill key."""
        from gcs.keys.certificates import ContentKey  # noqa: PLC0415

        if self.kill_key_pem is None:
            return payload
        return msgspec.msgpack.encode((payload, ContentKey(self.kill_key_pem).sign(_content(key, payload))))

    def verified(self, key: str, payload: bytes) -> bytes | None:
        """Return the payload that was signed, None unless by the approved kill key of the operator in the key."""
        from gcs.keys.certificates import is_signed_by  # noqa: PLC0415

        try:
            content, signature = msgspec.msgpack.decode(payload, type=tuple[bytes, bytes])
        except msgspec.MsgspecError:
            return None
        name = key.rpartition("/")[2]
        grants = (each for each in self.approved if each.operator == name and not each.is_expired)
        if any(is_signed_by(each.kill_key, _content(key, content), signature) for each in grants):
            return content
        return None


def _content(key: str, payload: bytes) -> bytes:
    """Return what is signed: the key holds the team."""
    return key.encode() + b"\0" + payload
