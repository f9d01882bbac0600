"""Preflight checks of the keys: whether the certificates of a team outlast its flight."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gcs.keys.roster import ROSTER_FILE, Holder, expiry
from gcs.mission.mission import Mission
from gcs.preflight.findings import MISSION, Finding, Grade, Subject

NOT_KEPT = "no newer roster is kept there: revoked keys count again after a restart, or by an older copy"
MAKE_WRITABLE = "let the user who flies write there; in a container, by a writable volume for the keys"
MARGIN_S = 3600.0
"""How long keys have to outlast a mission: for the wait before it, holds, and the way back."""


@dataclass(frozen=True, slots=True)
class KeyFacts:
    """The holders of keys that the bus admits, and the end of the mission if it began now [Unix s].

    `read_only` are the folders of keys here in which no newer roster can be kept.
    """

    holders: Sequence[Holder]
    ends_s: float
    read_only: Sequence[Path] = ()


def keys(mission: Mission, facts: KeyFacts) -> Iterator[Finding]:
    """Check that vehicles and router have keys that outlast the mission, and operators who have keys now.

    Their folders have to be writable.
    """
    last_s = facts.ends_s + MARGIN_S
    keyed = {name: holder for holder in facts.holders for name in holder.vehicles}
    first: Holder | None = None
    for vehicle_id in mission.ids:
        holder = keyed.get(str(vehicle_id))
        if holder is None or holder.expires_s < last_s:
            yield _short(Grade.REFUSE, vehicle_id, f"vehicle {vehicle_id}", holder)
        elif first is None or holder.expires_s < first.expires_s:
            first = holder
    routers = [each for each in facts.holders if each.role == "router"]
    if mission.network.router is not None and not any(each.expires_s >= last_s for each in routers):
        newest = max(routers, key=lambda each: each.expires_s, default=None)
        yield _short(Grade.REFUSE, MISSION, f"router {newest.name if newest else 'NAME'}", newest)
    began_s = facts.ends_s - mission.mission.duration_s
    for holder in facts.holders:
        if holder.role == "operator" and began_s <= holder.expires_s < last_s:
            yield _short(Grade.WARNING, MISSION, f"operator {holder.name}", holder)
    for folder in facts.read_only:
        yield Finding(Grade.WARNING, MISSION, "keys", f"{folder} cannot be written to", NOT_KEPT, MAKE_WRITABLE)
    if first is not None:
        yield Finding(Grade.PASS, MISSION, "keys", f"the vehicles' keys are valid until {expiry(first)}")


def _short(grade: Grade, about: Subject, whose: str, holder: Holder | None) -> Finding:
    has, step = "no keys", f"issue {whose}"
    if holder is not None:
        has, step = f"keys until {expiry(holder, minutes=True)} only", f"renew {holder.label}"
    return Finding(
        grade,
        about,
        "keys",
        f"{whose} has {has}",
        f"what comes from keys that expire is dropped; they have to outlast the mission by {MARGIN_S / 3600:g} h",
        f"`cordon keys {step}`, then copy its folder, and {ROSTER_FILE} to the others",
    )
