"""The holders of keys, and the roster file: the holders of a team, what each may do, and what is revoked."""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from time import time

import msgspec

from agents.shell.bus_security import Admitted, Grant
from agents.team import external_positions, perception
from agents.team.messages import (
    HEAD_TOPIC,
    OPERATOR_TOPIC,
    OPERATORS_TOPIC,
    PEER_TOPICS,
    PRESENCE_TOPIC,
    ROSTER_TOPIC,
)
from agents.team.participant import SENSOR_TOPICS, Participant, Role
from agents.team.verbs import VERBS, Verb
from gcs.errors import InputError
from gcs.keys.approval import EXPIRES_MAX_S, KillGrant
from gcs.keys.private_files import locked, read, write

_OF_VEHICLES = tuple(sorted(PEER_TOPICS | {ROSTER_TOPIC, HEAD_TOPIC}))
_ALL_TOPICS = (*(f"{topic}/*" for topic in sorted({*_OF_VEHICLES} | SENSOR_TOPICS)), f"{OPERATOR_TOPIC}/*/*")
"""What a router forwards: it checks each sender against its certificate."""


class Holder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The holder of a certificate: a vehicle's name is its id. `may` are the verbs that an operator may command.

    `expires_s` is Unix time. A holder's next certificate has the next `generation`, which is part of its common name:
    certificates issued before are no longer valid. `speaks_for` are further vehicles that a vehicle's keys may send
    as, in the keys of a run on one computer. `approvals` are those of an operator who may kill. Raises ValueError for
    an invalid name.
    """

    role: Role
    name: str
    expires_s: float
    may: tuple[Verb, ...] = ()
    generation: int = 1
    revoked: bool = False
    speaks_for: tuple[int, ...] = ()
    approvals: tuple[KillGrant, ...] = ()

    def __post_init__(self) -> None:
        if self.generation < 1:
            raise ValueError(f"{self.label}: generation {self.generation}: they count from 1")
        if not 0.0 <= self.expires_s < EXPIRES_MAX_S:
            raise ValueError(f"{self.label}: expires_s {self.expires_s}: not a time before the year 10000")
        _ = self.participant

    @property
    def participant(self) -> Participant:
        """The holder as a participant of the bus."""
        return Participant(self.role, self.name)

    @property
    def label(self) -> str:
        """Role and name: the name of the holder's folder."""
        return f"{self.role}-{self.name}"

    @property
    def vehicles(self) -> tuple[str, ...]:
        """The names of the vehicles that it may send as."""
        return (self.name, *map(str, self.speaks_for)) if self.role == "vehicle" else ()

    @property
    def common_name(self) -> str:
        """The common name of the valid certificate; names of holders have no tilde."""
        return self.label if self.generation == 1 else f"{self.label}~{self.generation}"

    @property
    def may_kill(self) -> bool:
        """Whether it is granted a verb that needs an approval, where there are approvers."""
        return any(VERBS[verb].is_dangerous for verb in self.may)

    @property
    def unapproved(self) -> "Holder":
        """The holder without the verbs that need an approval."""
        may = tuple(verb for verb in self.may if not VERBS[verb].is_dangerous)
        return msgspec.structs.replace(self, may=may, approvals=())

    @property
    def grant(self) -> Grant:
        """What the holder may send."""
        match self.role:
            case "vehicle":
                topics = tuple(f"{topic}/{name}" for topic in _OF_VEHICLES for name in self.vehicles)
                return Grant(self.common_name, topics, tuple(f"{PRESENCE_TOPIC}/{name}" for name in self.vehicles))
            case "operator":
                verbs = tuple(f"{OPERATOR_TOPIC}/{verb}/{self.name}" for verb in self.may)
                topics = (*verbs, f"{ROSTER_TOPIC}/{self.name}")
                return Grant(self.common_name, topics, (f"{OPERATORS_TOPIC}/{self.name}",))
            case "sensor":
                return Grant(self.common_name, (f"{perception.TOPIC}/{self.name}",))
            case "positions":
                return Grant(self.common_name, (f"{external_positions.TOPIC}/{self.name}",))
            case "observer":
                return Grant(self.common_name)
            case "router":
                return Grant(self.common_name, _ALL_TOPICS, (f"{PRESENCE_TOPIC}/*", f"{OPERATORS_TOPIC}/*"))


ROSTER_FILE, SERIAL_FILE = "roster.json", "roster-serial"
_SIZE_MAX_BYTES = 1_000_000


class Roster(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All holders of certificates of one authority; `authority` is the SHA-256 of its certificate, in hex.

    Each change has the next `serial`. The authority signs all other fields; without its signature it counts for
    nothing.
    """

    authority: str
    serial: int = 0
    holders: tuple[Holder, ...] = ()
    signature: bytes = b""

    def find(self, role: Role, name: str) -> Holder | None:
        """Return the holder of this role and name, None if there is none."""
        return next((each for each in self.holders if (each.role, each.name) == (role, name)), None)

    @property
    def valid(self) -> tuple[Holder, ...]:
        """The holders that are not revoked."""
        return tuple(each for each in self.holders if not each.revoked)

    @property
    def signed_content(self) -> bytes:
        """What the authority signs: it is encoded anew, so that what is verified is what was read."""
        return msgspec.structs.replace(self, signature=b"").compact()

    def put(self, *holders: Holder) -> "Roster":
        """Return the roster with holders added, not signed; each replaces one of the same role and name."""
        labels = {each.label for each in holders}
        others = (each for each in self.holders if each.label not in labels)
        return Roster(self.authority, self.serial + 1, tuple(sorted((*others, *holders), key=_order)))

    def signed(self, sign: Callable[[bytes], bytes]) -> "Roster":
        """Return the roster with the signature of its authority."""
        return msgspec.structs.replace(self, signature=sign(self.signed_content))

    def compact(self) -> bytes:
        """Return the payload on the bus."""
        return msgspec.json.encode(self)

    def encoded(self) -> bytes:
        """Return the file's content: indented JSON."""
        return msgspec.json.format(self.compact(), indent=1) + b"\n"


def digest(authority_pem: bytes) -> str:
    """Return the SHA-256 by which a roster identifies its authority, in hex."""
    return hashlib.sha256(authority_pem).hexdigest()


def read_roster(path: Path, authority_pem: bytes) -> Roster:
    """Read a roster of this authority; raises InputError unless it is signed and no older than any read here before."""
    used = used_serial(path)  # first: another process may write both meanwhile
    roster = unverified_roster(path, authority_pem)
    if not roster.signature:
        raise InputError([f"{path}: it is not signed: of an earlier version, or altered; next: {_SIGN}"])
    if not is_signed_roster(roster, authority_pem):
        raise InputError([f"{path}: it was altered: it is not what the authority has signed; next: {_COPY}"])
    if roster.serial < used:
        older = f"it is an older roster (serial {roster.serial}) than the one used here before (serial {used})"
        raise InputError([f"{path}: {older}, and may admit revoked keys; next: {_COPY}"])
    _remember(path, roster.serial)
    return roster


def approved(roster: Roster, authority_pem: bytes) -> Roster:
    """Return what a roster grants: kill only to operators with an approval, where the authority names approvers."""
    from gcs.keys.certificates import approvers  # noqa: PLC0415

    keys = approvers(authority_pem)
    if not keys:
        return roster

    def granted(holder: Holder) -> Holder:
        counts = tuple(
            each
            for each in holder.approvals
            if (each.authority, each.common_name) == (roster.authority, holder.common_name)
            and not each.is_expired
            and each.is_approved(keys)
        )
        if holder.may_kill and counts:
            return msgspec.structs.replace(holder, approvals=counts)
        return holder.unapproved

    return msgspec.structs.replace(roster, holders=tuple(map(granted, roster.holders)))


_COPY = f"copy {ROSTER_FILE} again from the keys folder that has the authority"
_SIGN = f"`cordon keys sign` on the computer that has the authority, then copy {ROSTER_FILE} from there"


def unverified_roster(path: Path, authority_pem: bytes) -> Roster:
    """Read a roster that names this authority, without verifying its signature; raises InputError."""
    try:
        with path.open("rb") as file:
            roster = _decoded(file.read(_SIZE_MAX_BYTES))
    except OSError as error:
        raise InputError([f"{path}: {error.strerror or error}"]) from error
    except ValueError as error:
        raise InputError([f"{path}: not a roster of keys: {error}"]) from error
    if digest(authority_pem) != roster.authority:
        raise InputError([f"{path}: it is of another authority than the keys; next: copy the folder again"])
    return roster


def _decoded(content: bytes) -> Roster:
    try:
        return msgspec.json.decode(content, type=Roster)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ValueError(str(error)) from error


def is_signed_roster(roster: Roster, authority_pem: bytes) -> bool:
    """Return whether this authority has signed a roster."""
    from gcs.keys.certificates import is_signed  # noqa: PLC0415

    try:
        return is_signed(authority_pem, roster.signed_content, roster.signature)
    except ValueError:
        return False


def write_roster(path: Path, roster: Roster) -> None:
    """Write a signed roster, and remember that it is used here; raises InputError."""
    write(path, roster.encoded())
    _remember(path, roster.serial)


@dataclass(frozen=True, slots=True)
class KeptRoster:
    """Keeps a roster file up to date with signed rosters from the bus; implements `agents.shell`'s RosterKeeper."""

    path: Path
    authority_pem: bytes

    def take(self, payload: bytes) -> Admitted | None:
        """Return what a roster admits, None unless the authority has signed it; write it to the file if it is newer."""
        try:
            roster = _decoded(payload)
        except ValueError:
            return None
        if roster.authority != digest(self.authority_pem) or not is_signed_roster(roster, self.authority_pem):
            return None
        with (
            suppress(InputError, OSError),
            locked(self.path.parent),
        ):  # of a folder that cannot be written to: in flight
            if roster.serial > used_serial(self.path):
                write_roster(self.path, roster)
        return Admitted(roster.serial, frozenset(each.common_name for each in roster.valid))


def used_serial(path: Path) -> int:
    """Return the highest serial of the rosters used in this place; raises InputError."""
    memory = path.with_name(SERIAL_FILE)
    if not memory.exists():
        return 0
    try:
        return int(read(memory))
    except ValueError as error:
        raise InputError([f"{memory}: not a number; next: remove it, and {_COPY}"]) from error


def _remember(path: Path, serial: int) -> None:
    if serial > used_serial(path):
        with suppress(InputError):  # a folder that cannot be written to is kept by who can
            write(path.with_name(SERIAL_FILE), b"%d\n" % serial)


def _order(holder: Holder) -> tuple[str, int, str]:
    number = int(holder.name) if holder.name.isdecimal() else 0
    return holder.role, number, holder.name


_SENDS = {
    "vehicle": "sends as this vehicle",
    "sensor": "sends sightings of the target",
    "positions": "sends positions of vehicles",
    "observer": "sends nothing",
    "router": "forwards the others' messages",
}


_WARNED_S = 7 * 86400.0
"""Keys that expire within this time are warned of."""


def expiring(roster: Roster) -> tuple[Holder, ...]:
    """Return the holders whose keys have expired, or will within a week."""
    return tuple(each for each in roster.valid if each.expires_s < time() + _WARNED_S)


def roster_view(roster: Roster) -> str:
    """Return one line for each holder: validity and permissions."""
    if not roster.holders:
        return "no keys issued"
    width = max(len(each.label) for each in roster.holders)
    states = {each.label: _state(each) for each in roster.holders}
    longest = max(map(len, states.values()))
    return "\n".join(
        f"{each.label:<{width}}  {states[each.label]:<{longest}}  {grants(each)}" for each in roster.holders
    )


def grants(holder: Holder) -> str:
    """Return what a holder may do."""
    if holder.role != "operator":
        return _SENDS[holder.role]
    return f"may command {', '.join(holder.may)}" if holder.may else "may command nothing"


def expiry(holder: Holder, *, minutes: bool = False) -> str:
    """Return the day on which a holder's keys expire, or the minute, in this computer's time zone."""
    return f"{datetime.fromtimestamp(holder.expires_s):{'%Y-%m-%d %H:%M' if minutes else '%Y-%m-%d'}}"


def _state(holder: Holder) -> str:
    if holder.revoked:
        return "revoked"
    left_d = (holder.expires_s - time()) / 86400.0
    return f"until {expiry(holder)} ({left_d:.0f} days)" if left_d > 0.0 else f"expired {expiry(holder)}"
