"""An entry of the audit log, and the chain of its entries."""

import hashlib
from collections.abc import Iterable
from typing import Literal

import msgspec

Event = Literal["received", "answered", "closed"]
Source = Literal["bus", "keyboard", ""]


class AuditEntry(msgspec.Struct, frozen=True):
    """A command received by a vehicle, its answer, or the closing of the log after all entries.

    `operator` is the name in its key, and on a bus with keys that of the certificate. `did` is the vehicle's answer.
    `previous` is the digest of the entry before, empty in the first; `digest` is the SHA-256 of all other fields.
    """

    time_s: float
    event: Event
    vehicle: int
    source: Source
    operator: str
    key: str
    command: int
    did: str
    previous: str
    digest: str


def sealed(entry: AuditEntry, previous: str) -> AuditEntry:
    """Return an entry chained to the one before."""
    chained = msgspec.structs.replace(entry, previous=previous, digest="")
    digest = hashlib.sha256(msgspec.json.encode(chained)).hexdigest()
    return msgspec.structs.replace(chained, digest=digest)


def chain_fault(entries: Iterable[AuditEntry]) -> str:
    """Return the fault of a chain of entries, empty if it is intact."""
    previous, last = "", None
    for number, entry in enumerate(entries, start=1):
        if last is not None and last.event == "closed":
            return f"entry {number}: it follows the closing entry"
        if entry.previous != previous:
            return f"entry {number}: entries before it are missing or were changed"
        if sealed(entry, previous) != entry:
            return f"entry {number}: it was changed"
        previous, last = entry.digest, entry
    if last is None or last.event != "closed":
        return "its closing entry is missing: the log was not closed, or entries were removed from its end"
    return ""
