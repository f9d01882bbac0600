"""Certificates of a team, and other signatures: X.509 with keys on the curve P-256, by `cryptography`.

Import it only where certificates are created or signatures verified: the import takes 0.1 s.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from gcs.keys.token import SCHEME, TokenKey

DAY_S = 86400.0
CLOCKS_DIFFER_BY = timedelta(days=1)
"""Certificates are valid from this time before their creation: clocks of other computers may be behind."""
_APPROVER = NameOID.ORGANIZATIONAL_UNIT_NAME
"""The attribute of an authority's name that holds an approver's fingerprint."""


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A certificate and its private key, in PEM."""

    certificate_pem: bytes
    private_key_pem: bytes = field(repr=False)

    @property
    def is_on_token(self) -> bool:
        """Whether a token has the private key: its URI is in place of the key."""
        return self.private_key_pem.startswith(SCHEME.encode())


class CertificateAuthority:
    """Signs the certificates of one team."""

    def __init__(self, keys: KeyPair, passphrase: bytes | None = None) -> None:
        """Take the authority's certificate and private key, and the passphrase of an encrypted one.

        In place of the private key it may be a token's URI, with the PIN. Raises ValueError for anything else.
        """
        self.keys = keys
        self._certificate = x509.load_pem_x509_certificate(keys.certificate_pem)
        if keys.is_on_token:
            self._private_key: ec.EllipticCurvePrivateKey = TokenKey(keys.private_key_pem.decode(), passphrase or b"")
        else:
            self._private_key = _loaded(keys.private_key_pem, passphrase)

    @classmethod
    def made(
        cls, days: float, approvers: Sequence[str] = (), token: tuple[str, bytes] | None = None
    ) -> "CertificateAuthority":
        """Return a new authority, valid for `days`, with the fingerprints of those who approve grants of kill.

        They are in its name, which every certificate that it issues repeats: no link opens between peers that trust
        the same key under a name with approvers and under one without. With the URI and the PIN of a `token`, the
        private key is created there; raises ValueError if it refuses.
        """
        private_key = ec.generate_private_key(ec.SECP256R1()) if token is None else TokenKey(*token, make=True)
        name = _name("cordon authority", approvers)
        builder = (
            _builder(name, name, private_key, _now() + timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs_certificates=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(private_key.public_key()), critical=False)
        )
        certificate = builder.sign(private_key, hashes.SHA256())
        if token is None:
            return cls(_key_pair(certificate, private_key))
        uri, pin = token
        return cls(KeyPair(certificate.public_bytes(serialization.Encoding.PEM), uri.encode()), pin)

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
        return _private_pem(self._private_key, passphrase)

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
    certificate = x509.load_pem_x509_certificate(keys.certificate_pem).public_bytes(serialization.Encoding.DER)
    return msgspec.msgpack.encode(_Signed(content, certificate, ContentKey(keys.private_key_pem).sign(content)))


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


class ContentKey:
    """A private key that signs contents other than certificates; its public key is DER (SubjectPublicKeyInfo)."""

    def __init__(self, pem: bytes, passphrase: bytes | None = None) -> None:
        """Take a private key in PEM, and the passphrase of an encrypted one; raises ValueError for anything else."""
        self._private_key = _loaded(pem, passphrase)

    @classmethod
    def made(cls) -> "ContentKey":
        """Return a new key."""
        return cls(_private_pem(ec.generate_private_key(ec.SECP256R1())))

    @property
    def public_key(self) -> bytes:
        """The public key."""
        return _public_der(self._private_key.public_key())

    @property
    def public_pem(self) -> bytes:
        """The public key in PEM."""
        return self._private_key.public_key().public_bytes(
            serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
        )

    def pem(self, passphrase: bytes | None = None) -> bytes:
        """Return the private key in PEM, encrypted if there is a passphrase."""
        return _private_pem(self._private_key, passphrase)

    def sign(self, content: bytes) -> bytes:
        """Return the signature of a content."""
        return self._private_key.sign(content, _SIGNATURE)


def fingerprint(public_key: bytes) -> str:
    """Return the SHA-256 of a public key in DER, in hex."""
    return hashlib.sha256(public_key).hexdigest()


def fingerprint_of_pem(pem: bytes) -> str:
    """Return the fingerprint of a public key in PEM; raises ValueError for anything else."""
    key = serialization.load_pem_public_key(pem)
    if not isinstance(key, ec.EllipticCurvePublicKey):
        raise ValueError("it is not a key of an elliptic curve")
    return fingerprint(_public_der(key))


def approvers(authority_pem: bytes) -> tuple[str, ...]:
    """Return the fingerprints of the approvers that an authority names; raises ValueError if it cannot be read."""
    subject = x509.load_pem_x509_certificate(authority_pem).subject
    return tuple(str(each.value) for each in subject.get_attributes_for_oid(_APPROVER))


def name_and_expiry(certificate_pem: bytes) -> tuple[str, float]:
    """Return a certificate's common name, and when it expires [Unix s]; raises ValueError if it cannot be read."""
    certificate = x509.load_pem_x509_certificate(certificate_pem)
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return "".join(str(each.value) for each in names), certificate.not_valid_after_utc.timestamp()


_SIGNATURE = ec.ECDSA(hashes.SHA256())


def is_signed(certificate_pem: bytes, content: bytes, signature: bytes) -> bool:
    """Return whether a certificate's key has signed a content; raises ValueError if the certificate cannot be read."""
    return _verifies(x509.load_pem_x509_certificate(certificate_pem).public_key(), content, signature)


def is_signed_by(public_key: bytes, content: bytes, signature: bytes) -> bool:
    """Return whether the private key of a public key has signed a content; one that cannot be read has not."""
    try:
        return _verifies(serialization.load_der_public_key(public_key), content, signature)
    except ValueError:
        return False


def _verifies(public_key: object, content: bytes, signature: bytes) -> bool:
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
    return KeyPair(certificate.public_bytes(serialization.Encoding.PEM), _private_pem(private_key))


def _loaded(pem: bytes, passphrase: bytes | None) -> ec.EllipticCurvePrivateKey:
    private_key = serialization.load_pem_private_key(pem, passphrase)
    if not isinstance(private_key, ec.EllipticCurvePrivateKey):
        raise ValueError("its private key is not of an elliptic curve")
    return private_key


def _private_pem(private_key: ec.EllipticCurvePrivateKey, passphrase: bytes | None = None) -> bytes:
    encryption = (
        serialization.NoEncryption() if passphrase is None else serialization.BestAvailableEncryption(passphrase)
    )
    return private_key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption)


def _public_der(public_key: ec.EllipticCurvePublicKey) -> bytes:
    return public_key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)


def _name(common_name: str, approvers: Sequence[str] = ()) -> x509.Name:
    named = [x509.NameAttribute(_APPROVER, each) for each in approvers]
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name), *named])


def _now() -> datetime:
    return datetime.now(UTC)
