"""Certificates against another implementation of TLS: OpenSSL's, in Python's ssl, over buffers in memory."""

import ssl
import time
from pathlib import Path
from typing import Any

import pytest

from gcs.keys.certificates import CertificateAuthority, KeyPair

HOUR_S = 3600.0


def context(purpose: int, own: KeyPair | None, authority: CertificateAuthority, folder: Path) -> ssl.SSLContext:
    made = ssl.SSLContext(purpose)
    made.check_hostname = False
    made.verify_mode = ssl.CERT_REQUIRED
    made.load_verify_locations(cadata=authority.keys.certificate_pem.decode())
    if own is not None:
        file = folder / f"{purpose}.pem"
        file.write_bytes(own.certificate_pem + own.private_key_pem)
        made.load_cert_chain(file)
    return made


def greeted(server: ssl.SSLContext, client: ssl.SSLContext) -> tuple[str, str]:
    """Return the common names that server and client saw in a handshake; raises ssl.SSLError."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = (
        server.wrap_bio(to_server, to_client, server_side=True),
        client.wrap_bio(to_client, to_server, server_hostname=None),
    )
    for _ in range(4):
        for end in ends:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
    return common_name(ends[0]), common_name(ends[1])


def common_name(end: ssl.SSLObject) -> str:
    certificate: Any = end.getpeercert()
    ((kind, name),) = (part for (part,) in certificate["subject"])
    assert kind == "commonName"
    return str(name)


def test_two_holders_of_one_authority_know_each_other_by_name(tmp_path: Path) -> None:
    authority, later_s = CertificateAuthority.made(1.0), time.time() + HOUR_S
    server = context(ssl.PROTOCOL_TLS_SERVER, authority.issue("vehicle-3", later_s), authority, tmp_path)
    client = context(ssl.PROTOCOL_TLS_CLIENT, authority.issue("operator-anna~2", later_s), authority, tmp_path)
    assert greeted(server, client) == ("operator-anna~2", "vehicle-3")


def test_others_are_refused(subtests: pytest.Subtests, tmp_path: Path) -> None:
    authority, other, later_s = CertificateAuthority.made(1.0), CertificateAuthority.made(1.0), time.time() + HOUR_S
    vehicle = authority.issue("vehicle-3", later_s)
    server = context(ssl.PROTOCOL_TLS_SERVER, vehicle, authority, tmp_path)
    strangers = {
        "of another authority": other.issue("vehicle-3", later_s),
        "expired": authority.issue("vehicle-3", time.time() - 1.0),
        "without a certificate": None,
        "signed by a vehicle": CertificateAuthority(vehicle).issue("vehicle-2", later_s),
    }
    for name, keys in strangers.items():
        with subtests.test(name=name), pytest.raises(ssl.SSLError):
            greeted(server, context(ssl.PROTOCOL_TLS_CLIENT, keys, authority, tmp_path))


def test_private_keys_are_not_shown() -> None:
    keys = CertificateAuthority.made(1.0).issue("vehicle-3", time.time() + HOUR_S)
    assert "PRIVATE" not in repr(keys)
