"""The network of Cursor-on-Target, by pytak, an extra: datagrams, also multicast, streams, and streams over TLS."""

import logging
import os
import ssl
import warnings
from asyncio import LimitOverrunError, Queue
from configparser import RawConfigParser
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from agents.ports import VehicleRefusedError
from gcs.errors import InputError

MISSING = "Cursor-on-Target needs pytak; install it by: pip install 'cordon-gcs[cot]'"
SCHEMES: Final = ("udp", "tcp", "tls")
PASSWORD_VARIABLE = "CORDON_COT_PASSWORD"
"""The environment variable with the password of the certificate's private key."""
_CIPHERS = "DEFAULT:!aNULL"


def require_pytak() -> None:
    """Raise InputError if pytak is not installed."""
    try:
        with warnings.catch_warnings(action="ignore"):  # it warns of its extras, which nothing here uses
            import pytak  # noqa: F401, PLC0415
    except ImportError as error:
        raise InputError([MISSING]) from error


@dataclass(frozen=True, slots=True)
class Certificates:
    """The files for TLS: the own certificate (.p12, or .pem with its `key`), and the authority of the other's."""

    own: Path | None = None
    key: Path | None = None
    authority: Path | None = None

    def check_authority(self) -> None:
        """Raise InputError if the file of the authority holds no certificate."""
        if self.authority is not None:
            try:
                ssl.create_default_context(cafile=self.authority)
            except OSError as error:
                raise InputError([f"--authority: {self.authority}: {error.strerror or 'no certificate'}"]) from error


@dataclass(frozen=True, slots=True)
class CotEndpoint:
    """Where events are sent to or come from."""

    scheme: str
    host: str
    port: int

    @classmethod
    def parsed(cls, option: str, text: str) -> "CotEndpoint":
        """Return the endpoint of an address such as udp://239.2.3.1:6969; raises InputError."""
        try:
            parts = urlsplit(text)
            scheme, host, port = parts.scheme, parts.hostname, parts.port
        except ValueError as error:
            raise InputError([f"{option}: {text!r}: {error}"]) from error
        if scheme not in SCHEMES:
            raise InputError([f"{option}: {text!r} has the scheme {scheme!r}, not {', '.join(SCHEMES)}"])
        if not host or not port or ":" in host or parts.path not in ("", "/") or parts.query or parts.username:
            raise InputError([f"{option}: {text!r} is no address such as udp://239.2.3.1:6969"])
        return cls(scheme, host, port)

    @property
    def url(self) -> str:
        """It as text."""
        return f"{self.scheme}://{self.host}:{self.port}"


class CotConnection:
    """A connection that sends events, or receives them; streams do both."""

    def __init__(self, endpoint: CotEndpoint, certificates: Certificates, *, sends: bool) -> None:
        self._endpoint, self._certificates, self._sends = endpoint, certificates, sends
        self._reader: Any = None
        self._writer: Any = None
        self._sender: Any = None
        self._receiver: Any = None
        self.unsent = 0
        """How many datagrams nobody received, as far as the network says so."""

    async def open(self) -> None:
        """Connect; raises VehicleRefusedError if that fails, and InputError for certificates that cannot be read."""
        import pytak  # noqa: PLC0415

        logging.getLogger("pytak").setLevel(logging.CRITICAL)
        logging.getLogger(pytak.Worker.__module__).setLevel(logging.CRITICAL)
        self._certificates.check_authority()
        config = self._config()
        try:
            self._reader, self._writer = await pytak.protocol_factory(config)
        except ssl.SSLError as error:
            raise self._refused(f"TLS: {error.reason or error}") from error
        except OSError as error:
            raise self._refused(error.strerror or str(error)) from error
        except (SyntaxError, ValueError) as error:  # pytak's errors of certificates
            cause = error.__cause__
            if isinstance(cause, ssl.SSLCertVerificationError):
                raise self._refused(f"its certificate: {cause.verify_message}") from error
            raise InputError([f"--cert: {self._certificates.own}: {cause or error}"]) from error
        if self._writer is not None:
            self._sender = pytak.TXWorker(Queue(), config, self._writer)
        if self._reader is not None:
            self._receiver = pytak.RXWorker(Queue(), config, self._reader)

    @property
    def receives(self) -> bool:
        """Whether something may come, once it is open; of a stream it has to be read."""
        return self._receiver is not None

    async def send(self, event: bytes) -> None:
        """Send an event; raises VehicleRefusedError if a stream is closed."""
        try:
            await self._sender.send_data(event)
        except OSError as error:
            if self._endpoint.scheme != "udp":
                raise self._refused(error.strerror or str(error)) from error
            self.unsent += 1  # nobody listens there, for now

    async def receive(self) -> bytes:
        """Return the next event; raises VehicleRefusedError if a stream has ended."""
        while True:
            try:
                event = await self._receiver.readcot()
            except LimitOverrunError as error:
                await self._reader.readexactly(max(error.consumed, 1))
                return b""  # no event: longer than any
            except OSError as error:
                if self._endpoint.scheme == "udp":
                    continue
                raise self._refused(error.strerror or str(error)) from error
            if event is None:
                raise self._refused("it closed the connection")
            return bytes(event).strip()

    def close(self) -> None:
        """Close it."""
        for each in (self._writer, self._reader):
            if hasattr(each, "close"):
                each.close()

    def _refused(self, reason: str) -> VehicleRefusedError:
        return VehicleRefusedError(f"{self._endpoint.url}: {reason}", "check the address and start the other program")

    def _config(self) -> Any:
        """Return pytak's configuration of the connection."""
        endpoint, certificates = self._endpoint, self._certificates
        scheme = endpoint.scheme
        if scheme == "udp":
            scheme += "+wo" if self._sends else "+ro"
        config = RawConfigParser()
        config.add_section("cot")
        values: dict[str, object] = {
            "COT_URL": f"{scheme}://{endpoint.host}:{endpoint.port}",
            "PYTAK_TLS_CLIENT_CIPHERS": _CIPHERS,
            "PYTAK_TLS_CLIENT_CERT": certificates.own,
            "PYTAK_TLS_CLIENT_KEY": certificates.key or certificates.own,
            "PYTAK_TLS_CLIENT_CAFILE": certificates.authority,
            "PYTAK_TLS_CLIENT_PASSWORD": os.environ.get(PASSWORD_VARIABLE),
        }
        for name, value in values.items():
            if value is not None:
                # pytak reads the options for TLS by a parser that replaces %.
                config.set("cot", name, str(value).replace("%", "%%") if name.startswith("PYTAK_TLS") else str(value))
        return config["cot"]
