"""The exchange of audit heads: whose heads count, and what is noted of refusals."""

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest

from agents.shell.bus_security import BusSecurity
from gcs.flight.audit_exchange import AuditExchange, verified
from gcs.flight.team import FlightTeam
from gcs.flightlog.audit import AuditEntry, AuditHead
from gcs.keys.authority_folder import AuthorityFolder
from gcs.keys.certificates import KeyPair, signed
from gcs.keys.team_keys import NoKeys
from tests.gcs.keys.test_key_folder import security_of


def keys_in(path: Path) -> AuthorityFolder:
    """Return the keys of two vehicles, a router and an operator."""
    folder = AuthorityFolder(path)
    folder.init(10.0)
    folder.issue("vehicle", "1", 1.0)
    folder.issue("vehicle", "2", 1.0)
    folder.issue("router", "hill", 1.0)
    folder.issue("operator", "anna", 1.0)
    return folder


def signed_head(security: BusSecurity, head: AuditHead) -> bytes:
    return signed(KeyPair(security.certificate_pem, security.private_key_pem), msgspec.msgpack.encode(head))


def test_a_head_counts_if_its_vehicle_has_signed_it(tmp_path: Path, subtests: pytest.Subtests) -> None:
    folder, others = keys_in(tmp_path / "keys"), keys_in(tmp_path / "others")
    own, peer = security_of(folder, "vehicle", "1"), security_of(folder, "vehicle", "2")
    head = AuditHead(2, 100.0, 7, "ab" * 32)
    payload = signed_head(peer, head)
    assert verified(own, "2", payload) == ("vehicle-2", head)
    assert len(payload) < 750
    forged = {
        "altered": payload.replace(b"ab", b"cd", 1),
        "by another vehicle": signed_head(own, head),
        "by a router": signed_head(security_of(folder, "router", "hill"), head),
        "by an operator": signed_head(security_of(folder, "operator", "anna"), head),
        "by another authority": signed_head(security_of(others, "vehicle", "2"), head),
        "of another vehicle": signed_head(peer, msgspec.structs.replace(head, vehicle=1)),
        "no head": signed(KeyPair(own.certificate_pem, own.private_key_pem), b"\x01"),
        "no message": b"\xc1",
        "no certificate": msgspec.msgpack.encode((b"", b"", b"")),
        "nothing": b"",
    }
    for name, wrong in forged.items():
        with subtests.test(name=name), pytest.raises(ValueError, match="sign"):
            verified(own, "2", wrong)


class Flight:
    """A flight of one process whose bus refuses what a test says; `entries` are those of the audit log."""

    def __init__(self) -> None:
        self.refusals: Mapping[tuple[str, str], int] = {}
        self.heads: Mapping[str, bytes] = {}
        self.revoked: tuple[str, ...] = ()
        self.entries: list[AuditEntry] = []
        self.lines: list[str] = []
        self.head = None
        vehicle = SimpleNamespace(id=1)
        self.exchange = AuditExchange(
            cast(
                FlightTeam,
                SimpleNamespace(
                    keys=NoKeys(),
                    members=[SimpleNamespace(vehicle=vehicle)],
                    buses={1: self},
                    plan=SimpleNamespace(log=None, mission=SimpleNamespace(vehicles=[vehicle])),
                    clock=SimpleNamespace(now_s=lambda: 100.0, time_scale=1.0),
                    recording=SimpleNamespace(head=None, note_run=self.entries.append),
                    view=SimpleNamespace(print_line=lambda text, _level: self.lines.append(text)),
                ),
            )
        )


async def test_refusals_are_noted_when_they_begin_at_each_tenfold_and_at_the_end() -> None:
    flight, anna = Flight(), ("command/anna", "not a member")
    for count in range(1, 2500):
        flight.refusals = {anna: count}
        flight.exchange.note_refusals()
    stranger = ("address 192.0.2.7", "too many handshakes")
    flight.refusals = {anna: 2499, ("head/2", "malformed"): 1, stranger: 345}
    await flight.exchange.end()
    noted = [(each.event, each.operator, each.did, each.command) for each in flight.entries]
    assert noted == [
        *(("refused", *anna, count) for count in (1, 10, 100, 1000, 2499)),
        ("refused", "head/2", "malformed", 1),
        ("refused", "address 192.0.2.7", "too many handshakes", 345),
    ]
    assert [line.partition(" times")[0] for line in flight.lines] == [
        "bus: command/anna is refused: not a member; 1",
        "bus: head/2 is refused: malformed; 1",
        "bus: address 192.0.2.7 is refused: too many handshakes; 345",
    ]
