"""The authority's private key on a PKCS#11 token, such as a smart card; it never leaves the token.

`python-pkcs11` (`pip install 'cordon-gcs[token]'`) calls the module of the token's vendor.
"""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Never
from urllib.parse import parse_qs, unquote

from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

SCHEME = "pkcs11:"
_MISSING = "a token needs python-pkcs11; next: pip install 'cordon-gcs[token]'"
_UNSUPPORTED = "the private key is on a token, which keeps it"


class TokenKey(ec.EllipticCurvePrivateKey):
    """A private key on the curve P-256 on a token, by its URI (RFC 7512).

    Such as `pkcs11:token=cordon;object=authority?module-path=/usr/lib/softhsm/libsofthsm2.so`. Each signature opens a
    session of its own. All methods raise ValueError if the token refuses.
    """

    def __init__(self, uri: str, pin: bytes, *, make: bool = False) -> None:
        """Find the key on the token, or create it there; raises ValueError."""
        path, _, query = uri.removeprefix(SCHEME).partition("?")
        named = dict(part.partition("=")[::2] for part in path.split(";"))
        module = parse_qs(query).get("module-path", [""])[0]
        if not uri.startswith(SCHEME) or not (named.keys() == {"token", "object"} and module):
            raise ValueError(f"{uri}: not of the form {SCHEME}token=LABEL;object=LABEL?module-path=FILE")
        self.uri, self._pin, self._module = uri, pin.decode(errors="surrogateescape"), module
        self._token, self._object = unquote(named["token"]), unquote(named["object"])
        with self._session(make=make) as session:
            self._public_key = self._made(session) if make else self._found(session)

    @contextmanager
    def _session(self, *, make: bool = False) -> Iterator[Any]:
        try:
            import pkcs11  # noqa: PLC0415
        except ImportError as error:
            raise ValueError(_MISSING) from error
        try:
            with (
                pkcs11.lib(self._module).get_token(token_label=self._token).open(user_pin=self._pin, rw=make) as opened
            ):
                yield opened
        except (pkcs11.PKCS11Error, RuntimeError) as error:  # a RuntimeError for a module that cannot be loaded
            raise ValueError(f"{self.uri}: {type(error).__name__} {error}".rstrip()) from error

    def _keys(self, session: Any, kind: str) -> list[Any]:
        from pkcs11 import Attribute, ObjectClass  # noqa: PLC0415

        return list(session.get_objects({Attribute.CLASS: ObjectClass[kind], Attribute.LABEL: self._object}))

    def _made(self, session: Any) -> ec.EllipticCurvePublicKey:
        from pkcs11 import Attribute, KeyType  # noqa: PLC0415
        from pkcs11.util.ec import encode_named_curve_parameters  # noqa: PLC0415

        if self._keys(session, "PRIVATE_KEY"):
            raise ValueError(f"{self.uri}: there is a key of this name already; next: choose another object")
        curve = {Attribute.EC_PARAMS: encode_named_curve_parameters("secp256r1")}
        session.create_domain_parameters(KeyType.EC, curve, local=True).generate_keypair(
            store=True, label=self._object, private_template={Attribute.EXTRACTABLE: False, Attribute.SENSITIVE: True}
        )
        return self._found(session)

    def _found(self, session: Any) -> ec.EllipticCurvePublicKey:
        from pkcs11.util.ec import encode_ec_public_key  # noqa: PLC0415

        for each in self._keys(session, "PUBLIC_KEY"):
            key = serialization.load_der_public_key(encode_ec_public_key(each))
            if isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, ec.SECP256R1):
                return key
        raise ValueError(f"{self.uri}: there is no such key on the curve P-256")

    def public_key(self) -> ec.EllipticCurvePublicKey:
        """Return the public key."""
        return self._public_key

    @property
    def curve(self) -> ec.EllipticCurve:
        """The curve."""
        return self._public_key.curve

    @property
    def key_size(self) -> int:
        """The size [bits]."""
        return self._public_key.key_size

    def sign(self, data: Any, signature_algorithm: ec.EllipticCurveSignatureAlgorithm) -> bytes:
        """Return the token's signature of data: ECDSA with SHA-256."""
        if not isinstance(signature_algorithm.algorithm, hashes.SHA256):
            raise ValueError(f"{self.uri}: signs by SHA-256 only")
        with self._session() as session:
            from pkcs11 import Mechanism  # noqa: PLC0415
            from pkcs11.util.ec import encode_ecdsa_signature  # noqa: PLC0415

            found = self._keys(session, "PRIVATE_KEY")
            if not found:
                raise ValueError(f"{self.uri}: there is no such private key")
            return bytes(
                encode_ecdsa_signature(found[0].sign(hashlib.sha256(data).digest(), mechanism=Mechanism.ECDSA))
            )

    def exchange(self, *_given: Any) -> Never:
        """Raise ValueError."""
        raise ValueError(_UNSUPPORTED)

    def private_numbers(self) -> Never:
        """Raise ValueError."""
        raise ValueError(_UNSUPPORTED)

    def private_bytes(self, *_given: Any) -> Never:
        """Raise ValueError."""
        raise ValueError(_UNSUPPORTED)

    def __copy__(self) -> "TokenKey":
        return self

    def __deepcopy__(self, _memo: object) -> "TokenKey":
        return self
