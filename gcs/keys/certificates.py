"""Certificates of a team: X.509 with keys on the curve P-256, by `cryptography`.

Import it only where certificates are created or signatures verified: the import takes 0.1 s.
"""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

DAY_S = 86400.0
CLOCKS_DIFFER_BY = timedelta(days=1)
"""Certificates are valid from this time before their creation: clocks of other computers may be behind."""


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A certificate and its private key, in PEM."""

    certificate_pem: bytes
    private_key_pem: bytes = field(repr=False)


class CertificateAuthority:
    """Signs the certificates of one team."""

    def __init__(self, keys: KeyPair, passphrase: bytes | None = None) -> None:
        """Take the authority's certificate and private key, and the passphrase of an encrypted one.

        Raises ValueError for anything else.
        """
        self.keys = keys
        self._certificate = x509.load_pem_x509_certificate(keys.certificate_pem)
        private_key = serialization.load_pem_private_key(keys.private_key_pem, passphrase)
        if not isinstance(private_key, ec.EllipticCurvePrivateKey):
            raise ValueError("its private key is not of an elliptic curve")
        self._private_key = private_key

    @classmethod
    def made(cls, days: float) -> "CertificateAuthority":
        """Return a new authority, valid for `days`."""
        private_key = ec.generate_private_key(ec.SECP256R1())
        name = _name("cordon authority")
        builder = (
            _builder(name, name, private_key, _now() + timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs_certificates=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(private_key.public_key()), critical=False)
        )
        return cls(_key_pair(builder.sign(private_key, hashes.SHA256()), private_key))

    @property
    def expires_s(self) -> float:
        """When its certificate expires, and with it all others [Unix s]."""
        return self._certificate.not_valid_after_utc.timestamp()

    def issue(self, common_name: str, expires_s: float) -> KeyPair:
        """Return a new key pair for a peer; the certificate is valid for both ends of a connection."""
        private_key = ec.generate_private_key(ec.SECP256R1())
        until = datetime.fromtimestamp(expires_s, UTC)
        both_ways = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
        issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._private_key.public_key())
        builder = (
            _builder(_name(common_name), self._certificate.subject, private_key, until)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(both_ways), critical=False)
            .add_extension(issuer, critical=False)
        )
        return _key_pair(builder.sign(self._private_key, hashes.SHA256()), private_key)

    def encrypted(self, passphrase: bytes) -> bytes:
        """Return its private key in PEM, encrypted with a passphrase."""
        encryption = serialization.BestAvailableEncryption(passphrase)
        return self._private_key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption
        )

    def sign(self, content: bytes) -> bytes:
        """Return the authority's signature of a content that is no certificate."""
        return self._private_key.sign(content, _SIGNATURE)


class _Signed(msgspec.Struct, frozen=True, array_like=True):
    """A content, the certificate (DER) of who signed it, and the signature."""

    content: bytes
    certificate: bytes
    signature: bytes


def signed(keys: KeyPair, content: bytes) -> bytes:
    """Return a content with its signature by a holder of keys, and the holder's certificate."""
    private_key = serialization.load_pem_private_key(keys.private_key_pem, None)
    assert isinstance(private_key, ec.EllipticCurvePrivateKey)
    certificate = x509.load_pem_x509_certificate(keys.certificate_pem).public_bytes(serialization.Encoding.DER)
    return msgspec.msgpack.encode(_Signed(content, certificate, private_key.sign(content, _SIGNATURE)))


def signer_and_content(authority_pem: bytes, payload: bytes) -> tuple[str, bytes]:
    """Return the common name of a holder of keys, and what it has signed.

    Raises ValueError unless the authority has issued the certificate, and its holder signed the content.
    """
    try:
        message = msgspec.msgpack.decode(payload, type=_Signed)
        certificate = x509.load_der_x509_certificate(message.certificate)
        certificate.verify_directly_issued_by(x509.load_pem_x509_certificate(authority_pem))
    except Exception as error:  # whatever a forged certificate makes its parsers raise
        raise ValueError("not a signed message of a certificate of the authority") from error
    pem = certificate.public_bytes(serialization.Encoding.PEM)
    if not is_signed(pem, message.content, message.signature):
        raise ValueError("its signature is wrong")
    return name_and_expiry(pem)[0], message.content


def name_and_expiry(certificate_pem: bytes) -> tuple[str, float]:
    """Return a certificate's common name, and when it expires [Unix s]; raises ValueError if it cannot be read."""
    certificate = x509.load_pem_x509_certificate(certificate_pem)
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return "".join(str(each.value) for each in names), certificate.not_valid_after_utc.timestamp()


_SIGNATURE = ec.ECDSA(hashes.SHA256())


def is_signed(certificate_pem: bytes, content: bytes, signature: bytes) -> bool:
    """Return whether a certificate's key has signed a content; raises ValueError if the certificate cannot be read."""
    public_key = x509.load_pem_x509_certificate(certificate_pem).public_key()
    if not isinstance(public_key, ec.EllipticCurvePublicKey):
        raise ValueError("its key is not of an elliptic curve")
    try:
        public_key.verify(signature, content, _SIGNATURE)
    except InvalidSignature:
        return False
    return True


def _builder(
    subject: x509.Name, issuer: x509.Name, private_key: ec.EllipticCurvePrivateKey, until: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(private_key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(_now(), until) - CLOCKS_DIFFER_BY)
        .not_valid_after(until)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _key_pair(certificate: x509.Certificate, private_key: ec.EllipticCurvePrivateKey) -> KeyPair:
    pem = serialization.Encoding.PEM
    return KeyPair(
        certificate.public_bytes(pem),
        private_key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()),
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _now() -> datetime:
    return datetime.now(UTC)
