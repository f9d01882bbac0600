"""The security of the bus as Zenoh's settings: mutual TLS and access control, and sockets for programs of one user."""

import base64
import os
import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from agents.team.messages import OPERATOR_TOPIC, REPORT_TOPIC
from agents.team.verbs import VERBS

_TLS, _UNIX = "tls", "unixsock-stream"
_UNIX_PATH_MAX = 100
"""The longest path of a socket [bytes], less than every system permits."""
_RECEIVES = {
    "receives": (("put", "liveliness_token"), ("egress",)),
    "subscribes": (
        ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"),
        ("ingress", "egress"),
    ),
}
"""The rights of every listed certificate: to receive what this peer sends, and to subscribe to it."""


_SIGNED = tuple(f"{OPERATOR_TOPIC}/{row.name}/" for row in VERBS.values() if row.is_dangerous)
"""The keys of commands that are signed, where an approver has to grant them."""


@dataclass(frozen=True, slots=True)
class Grant:
    """The keys, below the team's, on which the certificate with this common name may send, such as `member/3`.

    `presence` holds its liveliness tokens, such as `alive/3`.
    """

    common_name: str
    topics: tuple[str, ...] = ()
    presence: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Admitted:
    """The common names that a roster admits; of two rosters the one with the higher serial counts."""

    serial: int
    common_names: frozenset[str]


class RosterKeeper(Protocol):
    """Takes rosters from the bus."""

    def take(self, payload: bytes) -> Admitted | None:
        """Return what a roster admits, None unless the authority has signed it; keep it for the next session.

        It may block for files.
        """


class CommandSigner(Protocol):
    """Signs commands that an approver has to grant; the key is that on the bus, with the team."""

    def signed(self, key: str, payload: bytes) -> bytes:
        """Return a command's payload with the operator's signature."""

    def verified(self, key: str, payload: bytes) -> bytes | None:
        """Return a command's payload without its signature, None unless it is that of an approved operator."""


@dataclass(frozen=True, slots=True)
class BusSecurity:
    """A peer's certificate and private key, the authority that signs all peers' certificates, and the grants.

    All are PEM. Nothing is received from or sent to a peer whose certificate is in no grant. `serial` is that of the
    roster with the grants, `keeper` takes later ones. With a `signer`, kills count only if they are signed: the
    authority alone, or a router, cannot send them in an operator's name.

    In the folder `sockets`, which only this user may enter, programs of this user reach each other without TLS: they
    can read each other's keys. Other users of the computer, who share its address, can keep new callers of a port out
    (`agents/shell/gate.py`); they do not reach these sockets.
    """

    authority_pem: bytes
    certificate_pem: bytes
    private_key_pem: bytes = field(repr=False)
    grants: tuple[Grant, ...]
    serial: int = 0
    keeper: RosterKeeper | None = field(default=None, repr=False, compare=False)
    sockets: Path | None = None
    signer: CommandSigner | None = None

    def signed(self, team: str, key: str, payload: bytes) -> bytes:
        """Return the payload to send on a key below the team's."""
        return self.signer.signed(f"{team}/{key}", payload) if self.signer and key.startswith(_SIGNED) else payload

    def verified(self, team: str, key: str, payload: bytes) -> bytes | None:
        """Return the payload received on a key below the team's, None if its signature is missing or wrong."""
        return self.signer.verified(f"{team}/{key}", payload) if self.signer and key.startswith(_SIGNED) else payload

    def not_in(self, admitted: Admitted) -> tuple[Grant, ...]:
        """Return the grants that a later roster does not admit any more.

        Those of routers stay: who sends through a router cannot be told from the router.
        """
        gone = (grant for grant in self.grants if grant.common_name not in admitted.common_names)
        return tuple(grant for grant in gone if not any("*" in key for key in grant.topics))

    def settings(self, team: str) -> dict[str, object]:
        """Return Zenoh's settings by path for a peer of a team.

        Certificates are passed by content, not by path: links that are reopened in flight then do not read files that
        were changed or removed since.
        """
        certificate, private_key = _base64(self.certificate_pem), _base64(self.private_key_pem)
        return {
            "transport/link/protocols": [_TLS] if self.sockets is None else [_TLS, _UNIX],
            "transport/link/tls": {
                "root_ca_certificate_base64": _base64(self.authority_pem),
                "enable_mtls": True,
                "listen_certificate_base64": certificate,
                "listen_private_key_base64": private_key,
                "connect_certificate_base64": certificate,
                "connect_private_key_base64": private_key,
                # A peer is identified by its common name; its address may change with every network.
                "verify_name_on_connect": False,
                # Without it a certificate is verified when a link opens only.
                "close_link_on_expiration": True,
            },
            # Addresses to connect to are in the mission only.
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "access_control": _access_control(f"cordon/{team}", self.grants, has_sockets=self.sockets is not None),
        }

    def sockets_at(self, team: str, endpoint: str) -> list[str]:
        """Return Zenoh's endpoint of the socket of a peer that listens at an endpoint, if there is one."""
        path = self._socket(team, endpoint)
        # Without the socket a flight goes on: it can be reached by the port.
        return [] if path is None else [f"{_UNIX}/{path}#exit_on_failure=false"]

    def reaching(self, team: str, endpoint: str) -> str:
        """Return Zenoh's endpoint by which a peer reaches an endpoint: the socket if a program of this user listens."""
        path = self._socket(team, endpoint)
        if path is not None:
            with socket.socket(socket.AF_UNIX) as probe:
                if probe.connect_ex(str(path)) == 0:
                    return f"{_UNIX}/{path}"
        return secured(endpoint)

    def _socket(self, team: str, endpoint: str) -> Path | None:
        """Return the path of the socket beside an endpoint's port, None if it would be too long."""
        if self.sockets is None:
            return None
        path = self.sockets / f"{team}.{endpoint.rpartition(':')[2]}"
        return path if len(os.fsencode(path)) <= _UNIX_PATH_MAX else None


def secured(endpoint: str) -> str:
    """Return an endpoint with the scheme of TLS, replacing any other."""
    return f"{_TLS}/{endpoint.partition('/')[2]}"


def _access_control(prefix: str, grants: Sequence[Grant], *, has_sockets: bool) -> dict[str, object]:
    """Return the access control of a peer, which denies everything that is not allowed here."""
    names = [grant.common_name for grant in grants]
    subjects: list[dict[str, object]] = [{"id": name, "cert_common_names": [name]} for name in names]
    everything = (f"{prefix}/**", f"{prefix}/{REPORT_TOPIC}/*")
    rules = [_rule(name, messages, flows, everything) for name, (messages, flows) in _RECEIVES.items()]
    # Zenoh refuses empty lists.
    policies: list[dict[str, object]] = [{"rules": list(_RECEIVES), "subjects": names}] if names else []
    for grant in grants:
        own = list(_sending_rules(prefix, grant))
        rules += own
        if own:
            policies.append({"rules": [rule["id"] for rule in own], "subjects": [grant.common_name]})
    if has_sockets:
        messages = tuple(each for kinds, _ in _RECEIVES.values() for each in kinds)
        subjects.append({"id": _UNIX, "link_protocols": [_UNIX]})
        rules.append(_rule(_UNIX, messages, ("ingress", "egress"), everything))
        policies.append({"rules": [_UNIX], "subjects": [_UNIX]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _sending_rules(prefix: str, grant: Grant) -> Iterator[dict[str, object]]:
    for kind, keys in (("put", grant.topics), ("liveliness_token", grant.presence)):
        if keys:
            yield _rule(
                f"{kind} of {grant.common_name}", (kind,), ("ingress",), tuple(f"{prefix}/{key}" for key in keys)
            )


def _rule(name: str, messages: Sequence[str], flows: Sequence[str], keys: Sequence[str]) -> dict[str, object]:
    return {
        "id": name,
        "permission": "allow",
        "messages": list(messages),
        "flows": list(flows),
        "key_exprs": list(keys),
    }


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
