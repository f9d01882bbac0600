"""Findings on who sends with a vehicle's system id: the vehicle itself, others, and from where."""

from collections.abc import Iterator

from gcs.link.relay.gate import LinkReport
from gcs.preflight.findings import Finding, Grade, VehicleFacts


def senders(facts: VehicleFacts) -> Iterator[Finding]:
    """Check whether the link is signed, and that no other sender uses the vehicle's system id."""
    if facts.link.signed:
        yield Finding(Grade.PASS, facts.subject, "signing", "its messages and cordon's are signed")
    if facts.link.doubled:
        yield _doubled(facts)
    if facts.link.impostors:
        yield impostor(facts.subject, facts.link)


def _doubled(facts: VehicleFacts) -> Finding:
    return Finding(
        Grade.REFUSE,
        facts.subject,
        "doubled",
        f"several vehicles send with its system id on {facts.link.address}: the numbers of its messages go forth and "
        "back",
        "each command would go to all of them",
        "give every vehicle a system id of its own (PX4: MAV_SYS_ID, ArduPilot: SYSID_THISMAV), one after the other",
    )


def impostor(subject: str, link: LinkReport) -> Finding:
    """Return the finding that others use a vehicle's system id."""
    who = ", ".join(f"{address} ({frames} messages)" for address, frames in link.impostors.items())
    return Finding(
        Grade.WARNING,
        subject,
        "impostor",
        f"{who} sends with its system id; ignored: the vehicle is at {link.address}",
        "this may be a second vehicle or simulator by mistake, or somebody who forges messages",
        "end the other sender, or give its vehicle a system id of its own; link.signing_key_file keeps forgers out",
    )


def moved(subject: str, link: LinkReport) -> Finding:
    """Return the finding that a vehicle continues from another address."""
    return Finding(
        Grade.WARNING,
        subject,
        "address",
        f"after a silence it sends from {link.moves[-1]}",
        "its link or simulator restarted"
        + ("" if link.signed else "; without signing it cannot be told from a forger"),
        "check that this is the vehicle",
    )
