"""The security of the bus: mutual TLS, and who may send what, as Zenoh's settings."""

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from agents.team.messages import REPORT_TOPIC

_TLS = "tls"
_HEARS = {
    "hears": (("put", "liveliness_token"), ("egress",)),
    "subscribes": (
        ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"),
        ("ingress", "egress"),
    ),
}
"""What the holder of every listed certificate may do: receive what this peer sends, and subscribe to it."""


@dataclass(frozen=True, slots=True)
class Grant:
    """What the holder of the certificate with this common name may send: keys below the team's, such as `member/3`.

    `presence` holds its liveliness tokens, such as `alive/3`.
    """

    common_name: str
    topics: tuple[str, ...] = ()
    presence: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class BusSecurity:
    """A peer's certificate and private key, the authority that all peers' certificates must be of, and the grants.

    All are PEM. A peer whose certificate no grant names is neither heard nor sent anything.
    """

    authority_pem: bytes
    certificate_pem: bytes
    private_key_pem: bytes = field(repr=False)
    grants: tuple[Grant, ...]

    def settings(self, team: str) -> dict[str, object]:
        """Return Zenoh's settings by path for a peer of a team.

        Certificates are passed on as they are here, not as paths: links that are opened anew in flight do not read
        files that were changed or removed since.
        """
        certificate, private_key = _base64(self.certificate_pem), _base64(self.private_key_pem)
        return {
            "transport/link/protocols": [_TLS],
            "transport/link/tls": {
                "root_ca_certificate_base64": _base64(self.authority_pem),
                "enable_mtls": True,
                "listen_certificate_base64": certificate,
                "listen_private_key_base64": private_key,
                "connect_certificate_base64": certificate,
                "connect_private_key_base64": private_key,
                # Who a peer is, its common name says; its address may change with every network.
                "verify_name_on_connect": False,
            },
            # Only the mission names addresses to connect to.
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "access_control": _access_control(f"cordon/{team}", self.grants),
        }


def secured(endpoint: str) -> str:
    """Return an endpoint's address under TLS, whatever scheme it is written with."""
    return f"{_TLS}/{endpoint.partition('/')[2]}"


def _access_control(prefix: str, grants: Sequence[Grant]) -> dict[str, object]:
    """Return the access control of a peer: what is not allowed here is denied."""
    names = [grant.common_name for grant in grants]
    everything = (f"{prefix}/**", f"{prefix}/{REPORT_TOPIC}/*")
    rules = [_rule(name, messages, flows, everything) for name, (messages, flows) in _HEARS.items()]
    policies: list[dict[str, object]] = [{"rules": list(_HEARS), "subjects": names}]
    for grant in grants:
        own = list(_sending_rules(prefix, grant))
        rules += own
        if own:
            policies.append({"rules": [rule["id"] for rule in own], "subjects": [grant.common_name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in names],
        # Zenoh refuses empty lists.
        "policies": policies if names else [],
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
