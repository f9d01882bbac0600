"""Access to the operator's page: by address, by name of the computer, by origin, and by proofs of a secret.

Browsers let every web page open WebSockets to this computer, and resolve any name to it (DNS rebinding). So a request
is accepted only if its `Host` is a name of this computer and its `Origin`, if present, the page itself.

Each start of a station has a secret, which excludes other users and other computers. The printed URL holds it behind
`#`, which is not sent. On each WebSocket both ends prove that they know it, the station first. The secret itself is
never sent: a program that takes the port after the station learns nothing. A proof gives a ticket for requests of
files, valid as long as its WebSocket. On this computer each start has an origin of its own, with a name that cannot be
foreseen: scripts that another program has left in the browser, at an origin that it served, do not run beside it.
"""

import asyncio
import hashlib
import hmac
import re
import secrets
import socket
import ssl
from collections import OrderedDict
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

import msgspec
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketClose, WebSocketDisconnect

from gcs.errors import InputError
from gcs.keys import private_files
from gcs.viewer.connections import Client, ConnectionLimits
from gcs.viewer.origin_gate import Address, is_permitted

TOKEN_CHARACTERS_MIN = 16
DERIVATIONS = 600_000
"""Steps of PBKDF2 from a token to a secret: a proof lets others try tokens, so each try has to be slow."""
FAILED_DELAY_S, FAILED_DELAY_MAX_S = 0.25, 8.0
"""What a host waits after its first wrong proof, twice as long after each further one."""
_HOSTS_KEPT = 1024
_WRONG = 1008
_NUMERIC_LOOPBACK = ("127.0.0.1", "::1")
_LOOPBACK = frozenset({"localhost", *_NUMERIC_LOOPBACK})
_OWN_NAMES = ".localhost"
"""Browsers resolve every name that ends so to this computer, and none can be bound to another (RFC 6761)."""
_STREAM_ORIGIN = re.compile(r"https?://[\w.:\[\]-]+(?=[/?#]|$)", re.ASCII | re.IGNORECASE)
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Hello(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="hello"):
    """The first message of a page: its nonce for this connection."""

    nonce: str


class Challenge(msgspec.Struct, frozen=True, tag_field="kind", tag="challenge"):
    """The station's answer: its nonce and proof, and the salt by which a token gives the secret, empty without one."""

    nonce: str
    proof: str
    salt: str


class Proof(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="proof"):
    """The proof of a page."""

    proof: str


class Entered(msgspec.Struct, frozen=True, tag_field="kind", tag="entered"):
    """The page has entered: its ticket for requests of files."""

    ticket: str


@dataclass(frozen=True, slots=True)
class Access:
    """Where the server listens, by which certificate and key (PEM files), and the secret that opens the page.

    `salt` is that of a secret derived from a token, `name` the host name of the page's own origin; both may be empty.
    `cameras` are the origins whose pictures the page shows beside its own.
    """

    address: Address
    secret: str
    tls: tuple[Path, Path] | None = None
    salt: str = ""
    name: str = ""
    cameras: tuple[str, ...] = ()

    @property
    def content_policy(self) -> str:
        """The Content-Security-Policy of the page."""
        pictures = " ".join(("'self' data: blob:", *self.cameras))
        return (
            f"default-src 'none'; script-src 'self'; style-src 'self'; img-src {pictures}; connect-src 'self';"
            " worker-src 'self'; font-src 'self'; media-src 'self'; base-uri 'none'; form-action 'none';"
            " frame-ancestors 'none'"
        )

    @property
    def origin(self) -> str:
        """The origin of the page at its own address."""
        host = f"[{self.address.host}]" if ":" in self.address.host else self.address.host
        return f"{self.scheme}://{self.name or host}:{self.address.port}"

    @property
    def url(self) -> str:
        """The URL to open in a browser."""
        return f"{self.origin}/#{self.secret}"

    @property
    def scheme(self) -> str:
        """The scheme of its URLs."""
        return "http" if self.tls is None else "https"

    @property
    def hosts(self) -> tuple[str, ...]:
        """The hosts to listen at: browsers look for the own name at both of loopback, where no other may answer."""
        return (self.address.host, *(_NUMERIC_LOOPBACK if self.name else ()))

    def proof(self, prover: str, page_nonce: str, station_nonce: str) -> str:
        """Return the proof of an end of a connection, "station" or "page", for the nonces of both."""
        message = "|".join((prover, page_nonce, station_nonce))
        return hmac.new(self.secret.encode(), message.encode(), hashlib.sha256).hexdigest()

    def is_named(self, hosts: list[str]) -> bool:
        """Return whether there is one `Host` header, which names this computer; the port may be a forwarded one."""
        try:
            name = urlsplit(f"//{hosts[0]}").hostname or "" if len(hosts) == 1 else ""
        except ValueError:
            return False
        own = {self.address.host.lower(), *_LOOPBACK}
        if self.address.is_loopback:
            return name in own or name.endswith(_OWN_NAMES)
        computer = socket.gethostname().lower()
        return name in own | {computer, f"{computer}.local"} or _is_number(name)


def camera_origins(addresses: Iterable[str]) -> tuple[str, ...]:
    """Return the origins of cameras' streams that a browser can show as a picture: those by HTTP.

    An empty address is none, and one whose host is no name would change the policy.
    """
    return tuple(sorted({found[0] for each in addresses if (found := _STREAM_ORIGIN.match(each))}))


def checked_access(address: Address, token: str | None, tls: tuple[Path, Path] | None) -> Access:
    """Return the access to a server, with a new secret; raises InputError for unprotected access and unusable keys.

    `token` is that of a user, None without one.
    """
    faults = []
    if not address.is_loopback and tls is None:
        faults.append(f"--tls: other computers can reach {address.host}: it needs a certificate and its key")
    if not address.is_loopback and token is None:
        faults.append(f"--token-file: other computers can reach {address.host}: it needs a token")
    if tls is not None:
        try:
            private_files.read_private(tls[1])
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(*tls, password=lambda: "")
        except OSError as error:  # an ssl.SSLError is one
            faults.append(f"--tls: {tls[0]}, {tls[1]}: {error.strerror or error}")
        except InputError as error:
            faults += [f"--tls: {fault}" for fault in error.faults]
    if faults:
        raise InputError(faults)
    name = f"{secrets.token_hex(8)}{_OWN_NAMES}" if tls is None and address.host in _LOOPBACK else ""
    if token is None:
        return Access(address, secrets.token_urlsafe(24), tls, name=name)
    salt = secrets.token_hex(16)
    return Access(address, derived_secret(token, salt), tls, salt, name)


def derived_secret(token: str, salt: str) -> str:
    """Return the secret of a start from a user's token and the salt of the start."""
    return hashlib.pbkdf2_hmac("sha256", token.encode(), salt.encode(), DERIVATIONS).hex()


def read_token(path: Path) -> str:
    """Return the token in a file that only its owner may read; raises InputError."""
    try:
        token = private_files.read_private(path).decode("ascii").strip()
    except UnicodeDecodeError:
        token = ""
    if len(token) < TOKEN_CHARACTERS_MIN or not token.isprintable():
        raise InputError([f"--token-file: {path}: it must hold at least {TOKEN_CHARACTERS_MIN} printable characters"])
    return token


class AccessGate:
    """Guards the page: refuses requests without access, and adds the headers that block foreign content."""

    def __init__(self, app: ASGIApp, files: ASGIApp, access: Access, limits: ConnectionLimits) -> None:
        """Take the application behind the gate, and the files that everybody may read, as they hold no secret."""
        self._app = app
        self._files = files
        self._access = access
        self._limits = limits
        self._tickets: set[str] = set()
        self._failures: OrderedDict[str, int] = OrderedDict()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        is_file, client = scope["type"] == "http", _client(scope)

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.setdefault("Cache-Control", "no-cache")
                headers.update(_HEADERS)
                headers["Content-Security-Policy"] = self._access.content_policy
            await send(message)

        headers = Headers(scope=scope)
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        self._limits.ask(client)
        answer: ASGIApp
        if not self._access.is_named(hosts):
            answer = _refusal("wrong address: open the one that `cordon station` printed", is_file)
        elif not is_permitted(origins, {f"{self._access.scheme}://{hosts[0]}"}):
            answer = _refusal("refused: another web page must not read this one", is_file)
        elif not is_file:
            answer = self._enter
        elif headers.get("authorization", "").removeprefix("Bearer ") in self._tickets:
            self._limits.admit(client)
            answer = self._app
        else:
            answer = self._files
        await answer(scope, receive, send_with_headers)

    async def _enter(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a WebSocket once both ends have proved that they know the secret."""
        page, client = WebSocket(scope, receive, send), _client(scope)
        host, _ = client
        with suppress(WebSocketDisconnect, RuntimeError):  # the page has disconnected meanwhile
            await page.accept()
            if not await self._is_proved(page):
                await self._delay(page, host)
                await page.close(_WRONG, "wrong proof")
                return
            self._failures.pop(host, None)
            self._limits.admit(client)
            ticket = secrets.token_urlsafe(24)
            self._tickets.add(ticket)
            try:
                await _send(page, Entered(ticket))
                await self._app(scope, _after_connect(receive), _after_accept(send))
            finally:
                self._tickets.discard(ticket)

    async def _is_proved(self, page: WebSocket) -> bool:
        try:
            hello = msgspec.json.decode(await _text(page), type=Hello)
            nonce = secrets.token_hex(32)
            proof = self._access.proof("station", hello.nonce, nonce)
            await _send(page, Challenge(nonce, proof, self._access.salt))
            given = msgspec.json.decode(await _text(page), type=Proof).proof
        except (msgspec.DecodeError, RecursionError):  # a msgspec.ValidationError is one of the former
            return False
        return hmac.compare_digest(given.encode(), self._access.proof("page", hello.nonce, nonce).encode())

    async def _delay(self, page: WebSocket, host: str) -> None:
        """Let a page wait after a wrong proof, the longer the more its host has given; no right proof ever waits."""
        failed = self._failures[host] = min(self._failures.pop(host, 0) + 1, 16)
        if len(self._failures) > _HOSTS_KEPT:
            self._failures.popitem(last=False)
        with suppress(TimeoutError):
            async with asyncio.timeout(min(FAILED_DELAY_S * 2.0 ** (failed - 1), FAILED_DELAY_MAX_S)):
                while True:
                    await _text(page)


def _client(scope: Scope) -> Client:
    """Return the other end of a connection; one that has ended already has none."""
    host, port = scope["client"] or ("", 0)
    return host, port


async def _send(page: WebSocket, message: Challenge | Entered) -> None:
    await page.send_text(msgspec.json.encode(message).decode())


async def _text(page: WebSocket) -> str:
    """Return the next text of a page; raises WebSocketDisconnect, and DecodeError for bytes."""
    message = await page.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message["code"])
    return message.get("text") or ""


def _after_connect(receive: Receive) -> Receive:
    """Return what an application receives from a WebSocket that is accepted already."""
    first: list[Message] = [{"type": "websocket.connect"}]

    async def received() -> Message:
        return first.pop() if first else await receive()

    return received


def _after_accept(send: Send) -> Send:
    """Return what sends for an application on a WebSocket that is accepted already."""

    async def sent(message: Message) -> None:
        if message["type"] != "websocket.accept":
            await send(message)

    return sent


def _refusal(reason: str, is_file: bool) -> ASGIApp:
    return PlainTextResponse(reason, 403) if is_file else WebSocketClose(1008, reason)


def _is_number(name: str) -> bool:
    """Return whether a name is a numeric address, which no name server can redirect."""
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
