"""Findings on the senders with a vehicle's system id, and their addresses."""

from collections.abc import Iterator

from gcs.autopilots.registry import advice
from gcs.link.relay.gate import LinkReport
from gcs.preflight.findings import Finding, Grade, VehicleFacts


def senders(facts: VehicleFacts) -> Iterator[Finding]:
    """Check whether the link is signed, and that no other sender uses the vehicle's system id."""
    if facts.link.signed:
        yield Finding(Grade.PASS, facts.vehicle_id, "signing", "its messages and cordon's are signed")
    if facts.link.doubled:
        yield _doubled(facts)
    if facts.link.impostors:
        yield impostor(facts.vehicle_id, facts.link)


def _doubled(facts: VehicleFacts) -> Finding:
    return Finding(
        Grade.REFUSE,
        facts.vehicle_id,
        "doubled",
        f"several vehicles send with its system id on {facts.link.address}: sequence numbers jump back and forth",
        "each command would go to all of them",
        f"give every vehicle its own system id ({advice('system id')}), one after the other",
    )


def impostor(vehicle_id: int, link: LinkReport) -> Finding:
    """Return the finding that others use a vehicle's system id."""
    who = ", ".join(f"{address} ({frames} messages)" for address, frames in link.impostors.items())
    return Finding(
        Grade.WARNING,
        vehicle_id,
        "impostor",
        f"{who} sends with its system id; ignored: the vehicle is at {link.address}",
        "this may be a misconfigured vehicle or simulator, or an attacker who forges messages",
        "end the other sender, or give its vehicle another system id; link.signing_key_file rejects forged messages",
    )


def moved(vehicle_id: int, link: LinkReport) -> Finding:
    """Return the finding that a vehicle sends from another address than before."""
    return Finding(
        Grade.WARNING,
        vehicle_id,
        "address",
        f"after a silence it sends from {link.moves[-1]}",
        "its link or simulator restarted"
        + ("" if link.signed else "; without signing this cannot be distinguished from an attacker"),
        "check that this is the vehicle",
    )
