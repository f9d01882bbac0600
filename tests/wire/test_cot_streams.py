"""Streams of Cursor-on-Target: both directions of TCP and TLS, certificates that do not fit, events that are none."""

import asyncio
import ipaddress
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import pkcs12

from agents.ports import VehicleRefusedError
from estimation.frames import Geodetic
from gcs.cot.events import MalformedEventError, read_event, target_event
from gcs.cot.transport import PASSWORD_VARIABLE, Certificates, CotConnection, CotEndpoint
from gcs.errors import InputError
from tests.support.cot import checked, event_bytes
from tests.support.wire import free_port

pytestmark = pytest.mark.wire

EVENT = target_event("cordon-team-target", "team target", Geodetic(47.0, 8.0, 0.0), 1.0, 1.75e9)
FIRST, SECOND = (event_bytes(47.0, 8.0 + number, 1.75e9) for number in (1, 2))
PASSWORD = "100% secret"


class Identity(NamedTuple):
    """A private key and its certificate."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate

    def write(self, folder: Path, name: str) -> tuple[Path, Path]:
        """Write certificate and key, both PEM."""
        certificate, key = folder / f"{name}.pem", folder / f"{name}-key.pem"
        certificate.write_bytes(self.certificate.public_bytes(serialization.Encoding.PEM))
        plain = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        key.write_bytes(self.key.private_bytes(serialization.Encoding.PEM, *plain))
        return certificate, key


def identity(name: str, authority: Identity | None = None) -> Identity:
    """Return an identity for 127.0.0.1, signed by an authority, or an authority itself."""
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if authority is None else authority.certificate.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=authority is None, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), critical=False)
    )
    return Identity(key, builder.sign(key if authority is None else authority.key, hashes.SHA256()))


class Server(NamedTuple):
    """A server: its endpoint, and the events that it has received."""

    endpoint: CotEndpoint
    received: list[bytes]


@asynccontextmanager
async def server(context: ssl.SSLContext | None, *, says: bytes = FIRST + SECOND) -> AsyncIterator[Server]:
    """Serve a stream, which begins with what the server says; it ends with the first event that comes."""
    port, received = free_port(), list[bytes]()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(says)
        await writer.drain()
        received.append(await reader.readuntil(b"</event>"))
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", port, ssl=context):
        yield Server(CotEndpoint("tls" if context else "tcp", "127.0.0.1", port), received)


async def exchange(served: Server, certificates: Certificates) -> None:
    """Receive two events, send one, and see the stream end."""
    connection = CotConnection(served.endpoint, certificates, sends=True)
    await connection.open()
    try:
        assert connection.receives
        assert await connection.receive() == FIRST
        assert await connection.receive() == SECOND
        await connection.send(EVENT)
        with pytest.raises(VehicleRefusedError, match="closed the connection"):
            await connection.receive()
    finally:
        connection.close()
    assert checked(served.received[0]).get("uid") == "cordon-team-target"


async def test_a_stream_carries_events_both_ways_until_it_ends() -> None:
    async with server(None) as served:
        await exchange(served, Certificates())


async def test_an_endless_event_is_none_and_the_next_is_read() -> None:
    async with server(None, says=b"<event " + b"x" * 200_000 + FIRST + SECOND) as served:
        connection = CotConnection(served.endpoint, Certificates(), sends=True)
        await connection.open()
        received = [await connection.receive()]
        while received[-1] != SECOND:
            received.append(await connection.receive())
        for each in received[:-1]:
            with pytest.raises(MalformedEventError):
                read_event(each)
        connection.close()


class Tak(NamedTuple):
    """Identities of a server of TAK and of a client, as files, and the server's context."""

    context: ssl.SSLContext
    authority: Path
    client: tuple[Path, Path]
    p12: Path


@pytest.fixture
def tak(tmp_path: Path) -> Tak:
    authority = identity("authority")
    client = identity("client", authority)
    authority_file, _ = authority.write(tmp_path, "authority")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*identity("server", authority).write(tmp_path, "server"))
    context.load_verify_locations(authority_file)
    context.verify_mode = ssl.CERT_REQUIRED
    p12 = tmp_path / "client.p12"
    encryption = serialization.BestAvailableEncryption(PASSWORD.encode())
    p12.write_bytes(pkcs12.serialize_key_and_certificates(b"client", client.key, client.certificate, None, encryption))
    return Tak(context, authority_file, client.write(tmp_path, "client"), p12)


async def opened(connection: CotConnection) -> None:
    """Open a connection and receive: a server refuses a certificate only after the client's handshake."""
    await connection.open()
    await connection.receive()


async def test_tls_needs_certificates_that_fit(
    tak: Tak, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    async def refused(certificates: Certificates, match: str) -> None:
        async with server(tak.context) as served:
            connection = CotConnection(served.endpoint, certificates, sends=True)
            with pytest.raises((VehicleRefusedError, InputError), match=match):
                await opened(connection)

    with subtests.test("PEM"):
        async with server(tak.context) as served:
            await exchange(served, Certificates(*tak.client, tak.authority))
    with subtests.test("PKCS#12 with a password"):
        monkeypatch.setenv(PASSWORD_VARIABLE, PASSWORD)
        async with server(tak.context) as served:
            await exchange(served, Certificates(tak.p12, None, tak.authority))
        monkeypatch.setenv(PASSWORD_VARIABLE, "wrong")
        await refused(Certificates(tak.p12, None, tak.authority), "client.p12")
        monkeypatch.delenv(PASSWORD_VARIABLE)
    with subtests.test("a server of another authority"):
        other, _ = identity("other").write(tmp_path, "other")
        await refused(Certificates(*tak.client, other), "its certificate")
    with subtests.test("a client of another authority"):
        stranger = identity("stranger", identity("other")).write(tmp_path, "stranger")
        await refused(Certificates(*stranger, tak.authority), r"127\.0\.0\.1")
    with subtests.test("a file that is none"):
        (tmp_path / "none.pem").write_text("none")
        await refused(Certificates(tmp_path / "none.pem", None, tak.authority), "none.pem")
    with subtests.test("an authority that is none"):
        await refused(Certificates(*tak.client, tmp_path / "none.pem"), "none.pem")


async def test_nobody_there_is_a_refusal() -> None:
    connection = CotConnection(CotEndpoint("tcp", "127.0.0.1", free_port()), Certificates(), sends=True)
    with pytest.raises(VehicleRefusedError, match=r"tcp://127\.0\.0\.1"):
        await connection.open()
