"""The audit log as text."""

from datetime import UTC, datetime

from gcs.flightlog.audit.entry import AuditEntry


def audit_line(entry: AuditEntry) -> str:
    """Return an entry as a line: time, vehicle, operator, key, and the vehicle's answer."""
    who = f"operator {entry.operator}" if entry.source == "bus" else f"keyboard of {entry.operator}"
    did = "received" if entry.event == "received" else entry.did
    return f"{_time(entry.time_s)}  vehicle {entry.vehicle}  {who}  {entry.key}  {did}"


def _time(time_s: float) -> str:
    """Return the team's time: UTC, except in simulations that run faster than real time, whose clock is ahead."""
    try:
        return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3]
    except (OverflowError, ValueError, OSError):
        return f"{time_s:.3f} s"
