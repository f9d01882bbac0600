"""Findings on the kinds of vehicles: all real, all simulated, or boards in hardware-in-the-loop simulation."""

from collections.abc import Iterator, Sequence

from gcs.autopilots.kind import VehicleKind
from gcs.autopilots.registry import advice
from gcs.preflight.findings import MISSION, Finding, Grade, VehicleFacts

MIXED = "real vehicles would react to simulated neighbours"
LIVE = "a board with a simulated body may drive real motors"
BENCH = "on the bench, with propellers off, add --bench to `cordon check` and `cordon fly`"


def kinds(team: Sequence[VehicleFacts], *, bench: bool) -> Iterator[Finding]:
    """State the kind of each received vehicle; refuse mixed teams, and teams that need `bench`."""
    received = [facts for facts in team if facts.unreachable is None]
    for facts in received:
        yield _stated(facts)
    real = [facts for facts in received if not facts.kind.is_simulated]
    if bench:
        yield from (_not_simulated(facts) for facts in real)
    elif real and len(real) < len(received):
        yield _mixed(received)
    if not bench:
        yield from (_board(facts) for facts in received if facts.kind.is_board)


def bench_line(team: Sequence[VehicleFacts]) -> str:
    """Return the vehicles of each kind as one line."""
    ids = {kind: [str(facts.vehicle_id) for facts in team if facts.kind is kind] for kind in VehicleKind}
    parts = (f"{kind.value}: {', '.join(each)}" for kind, each in ids.items() if each)
    return "; ".join(parts)


def _stated(facts: VehicleFacts) -> Finding:
    known = facts.kind is not VehicleKind.UNKNOWN
    return Finding.graded(
        Grade.PASS if known else Grade.WARNING,
        facts.vehicle_id,
        "kind",
        f"what it is: {facts.kind.value}",
        "a vehicle of unknown kind is treated as a real one",
        f"check the link: its version and parameters were not received, or do not agree ({advice('simulation')})",
    )


def _mixed(team: Sequence[VehicleFacts]) -> Finding:
    step = "fly the real vehicles apart from simulated ones, with a team name and a mission of their own"
    return Finding(Grade.REFUSE, MISSION, "kinds", f"real and simulated vehicles: {bench_line(team)}", MIXED, step)


def _not_simulated(facts: VehicleFacts) -> Finding:
    found = f"it is not simulated: {facts.kind.value}"
    step = f"take it out of the mission, or set it up with a simulated body ({advice('bench')})"
    return Finding(Grade.REFUSE, facts.vehicle_id, "bench", found, "--bench is for simulated vehicles only", step)


def _board(facts: VehicleFacts) -> Finding:
    return Finding(Grade.REFUSE, facts.vehicle_id, "bench", f"it is a {facts.kind.value}", LIVE, BENCH)
