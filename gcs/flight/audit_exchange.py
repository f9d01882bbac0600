"""The exchange of audit heads between the processes of a flight, and the trace of what the bus refuses.

No single computer can rewrite an audit log unseen: the others hold heads of it, signed by its vehicle.
"""

import asyncio
from base64 import b64encode
from collections import Counter
from collections.abc import Mapping
from time import monotonic

import msgspec

from agents.ports import PeerBus
from agents.shell.bus_security import BusSecurity
from agents.team.messages import HEAD_TOPIC
from gcs.flight.team import FlightTeam
from gcs.flightlog.audit import AuditEntry, AuditHead, Event, signer_and_head
from gcs.keys.certificates import KeyPair, signed

HEAD_EVERY_S = 10.0
"""A head is about 600 bytes."""
_POLL_S = 0.5
_AGE_MAX_S = 10.0
"""A head that is older was sent again by somebody, such as one of an earlier flight; clocks of a team agree."""
_END_MAX_S = 3.0
"""How long the end of a flight waits for the disk."""
_LINGER_S = 1.5
"""How long a process waits at its end for the last heads of those that end with it."""


class AuditExchange:
    """Sends the heads of this process's audit log, and notes in it those of others and what the bus has refused.

    A process that flies the whole team, or has no log, exchanges no heads.
    """

    def __init__(self, team: FlightTeam) -> None:
        """Take a team that is equipped; raises InputError if the keys are missing or not valid."""
        first = team.keys.flying([member.vehicle.id for member in team.members])[0]
        self._team = team
        self._vehicle_id: int = first.vehicle_ids[0]
        self._bus: PeerBus = team.buses[self._vehicle_id]
        log, has_others = team.plan.log, len(team.members) < len(team.plan.mission.vehicles)
        exchanges = has_others and log is not None and log.path is not None
        self._security: BusSecurity | None = first.security if exchanges else None
        self._sent_s = -HEAD_EVERY_S
        self._known: dict[str, bytes] = {}
        self._noted_s: dict[str, float] = {}
        self._refused: Counter[tuple[str, str]] = Counter()
        self._refusals_noted: dict[tuple[str, str], int] = {}

    async def run(self) -> None:
        """Exchange until cancelled."""
        while True:
            self._receive()
            self.note_refusals()
            if monotonic() - self._sent_s >= HEAD_EVERY_S:
                self._send()
            await asyncio.sleep(_POLL_S)

    async def end(self) -> None:
        """Note what is left, and send the last head once the log is flushed up to now, before the bus is left."""
        self._receive(is_end=True)
        self.note_refusals(is_end=True)
        if self._security is None:
            return
        now_s, until_s = self._team.clock.now_s(), monotonic() + _END_MAX_S
        while monotonic() < until_s and ((head := self._team.recording.head) is None or head.time_s <= now_s):
            await asyncio.sleep(_POLL_S / 10.0)
        self._send()
        await asyncio.sleep(_LINGER_S)
        self._receive(is_end=True)

    def _send(self) -> None:
        security, head = self._security, self._team.recording.head
        if security is None or head is None or not head.entries:
            return
        self._sent_s = monotonic()
        content = msgspec.msgpack.encode(msgspec.structs.replace(head, vehicle=self._vehicle_id))
        self._bus.publish(HEAD_TOPIC, signed(KeyPair(security.certificate_pem, security.private_key_pem), content))

    def _receive(self, *, is_end: bool = False) -> None:
        """Note the newest head of each other log, at most twice as often as they are sent."""
        security = self._security
        if security is None:
            return
        now_s = self._team.clock.now_s()
        for name, payload in self._bus.heads.items():
            waits = monotonic() - self._noted_s.get(name, -HEAD_EVERY_S) < HEAD_EVERY_S / 2.0
            if payload == self._known.get(name) or (waits and not is_end):
                continue
            self._known[name], self._noted_s[name] = payload, monotonic()
            try:
                signer, head = verified(security, name, payload)
            except ValueError as error:
                self._refused[f"{HEAD_TOPIC}/{name}", str(error)] += 1
                continue
            is_new = abs(head.time_s - now_s) <= _AGE_MAX_S * self._team.clock.time_scale
            if not is_new or signer in self._bus.revoked:
                self._refused[f"{HEAD_TOPIC}/{name}", "an audit head too old, or of revoked keys"] += 1
            else:
                self._note("head", head.vehicle, signer, head.entries, head.digest, b64encode(payload).decode())

    def note_refusals(self, *, is_end: bool = False) -> None:
        """Note a sender's refusals when they begin, at each tenfold, and at the end: a flood does not fill the disk."""
        refusals: Mapping[tuple[str, str], int] = Counter(self._bus.refusals) + self._refused
        for (sender, why), count in refusals.items():
            noted = self._refusals_noted.get((sender, why), 0)
            if count < 10 * noted and not (is_end and count > noted):
                continue
            self._refusals_noted[sender, why] = count
            self._note("refused", 0, sender, count, why)
            if not noted:
                line = f"bus: {sender} is refused: {why}; {count} times so far, the audit log counts on"
                self._team.view.print_line(line, "warning")

    def _note(self, event: Event, vehicle: int, sender: str, number: int, did: str, proof: str = "") -> None:
        now_s = self._team.clock.now_s()
        key = f"{HEAD_TOPIC}/{vehicle}" if event == "head" else ""
        entry = AuditEntry(now_s, event, vehicle, "bus", sender, key, number, did, "", "", proof)
        self._team.recording.note_run(entry)


def verified(security: BusSecurity, name: str, payload: bytes) -> tuple[str, AuditHead]:
    """Return the common name of who signed a head of a vehicle's log, and the head.

    Raises ValueError unless the roster lets this certificate send for the vehicle.
    """
    signer, head = signer_and_head(security.authority_pem, payload)
    topics = next((grant.topics for grant in security.grants if grant.common_name == signer), ())
    if f"{HEAD_TOPIC}/{name}" not in topics or str(head.vehicle) != name:
        raise ValueError(f"an audit head signed by {signer}")
    return signer, head
