"""The roster of keys as text."""

from datetime import datetime
from time import time

from gcs.keys.holder import Holder
from gcs.keys.roster import Roster

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
