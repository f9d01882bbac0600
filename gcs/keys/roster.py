"""The roster file: the holders of a team's keys, what each may do, and what is revoked."""

import hashlib
from datetime import datetime
from pathlib import Path
from time import time

import msgspec

from agents.team.participant import Role
from gcs.errors import InputError
from gcs.keys.holder import Holder

ROSTER_FILE = "roster.json"
_SIZE_MAX_BYTES = 1_000_000


class Roster(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All holders of certificates of one authority; `authority` is the SHA-256 of its certificate, in hex."""

    authority: str
    holders: tuple[Holder, ...] = ()

    def find(self, role: Role, name: str) -> Holder | None:
        """Return the holder of this role and name, None if there is none."""
        return next((each for each in self.holders if (each.role, each.name) == (role, name)), None)

    @property
    def valid(self) -> tuple[Holder, ...]:
        """The holders that are not revoked."""
        return tuple(each for each in self.holders if not each.revoked)

    def put(self, holder: Holder) -> "Roster":
        """Return the roster with a holder added; it replaces one of the same role and name."""
        others = (each for each in self.holders if each.label != holder.label)
        return Roster(self.authority, tuple(sorted((*others, holder), key=_order)))

    def encoded(self) -> bytes:
        """Return the file's content: indented JSON."""
        return msgspec.json.format(msgspec.json.encode(self), indent=1) + b"\n"


def digest(authority_pem: bytes) -> str:
    """Return the SHA-256 by which a roster identifies its authority, in hex."""
    return hashlib.sha256(authority_pem).hexdigest()


def read_roster(path: Path) -> Roster:
    """Read a roster; raises InputError."""
    try:
        with path.open("rb") as file:
            content = file.read(_SIZE_MAX_BYTES)
        return msgspec.json.decode(content, type=Roster)
    except OSError as error:
        raise InputError([f"{path}: {error.strerror or error}"]) from error
    except (msgspec.MsgspecError, RecursionError, ValueError) as error:
        raise InputError([f"{path}: not a roster of keys: {error}"]) from error


def _order(holder: Holder) -> tuple[str, int, str]:
    number = int(holder.name) if holder.name.isdecimal() else 0
    return holder.role, number, holder.name


_SENDS = {
    "vehicle": "sends as this vehicle",
    "sensor": "sends sightings of the target",
    "observer": "sends nothing",
    "router": "forwards the others' messages",
}


def roster_view(roster: Roster) -> str:
    """Return one line for each holder: validity and permissions."""
    if not roster.holders:
        return "no keys issued"
    width = max(len(each.label) for each in roster.holders)
    return "\n".join(f"{each.label:<{width}}  {_state(each):<18}  {grants(each)}" for each in roster.holders)


def grants(holder: Holder) -> str:
    """Return what a holder may do."""
    if holder.role != "operator":
        return _SENDS[holder.role]
    return f"may command {', '.join(holder.may)}" if holder.may else "may command nothing"


def expiry(holder: Holder) -> str:
    """Return the day on which a holder's keys expire."""
    return f"{datetime.fromtimestamp(holder.expires_s):%Y-%m-%d}"


def _state(holder: Holder) -> str:
    if holder.revoked:
        return "revoked"
    return f"{'expired' if holder.expires_s <= time() else 'until'} {expiry(holder)}"
