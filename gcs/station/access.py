"""Access to the operator's page: by address, by name of the computer, by origin, and by token.

Browsers let every web page open WebSockets to this computer, and resolve any name to it (DNS rebinding). So a request
is accepted only if its `Host` is a name of this computer and its `Origin`, if present, the page itself. The token
excludes other users and other computers: the printed URL holds it behind `#`, which is not sent; a first page exchanges
it once for a cookie that scripts cannot read.
"""

import hashlib
import hmac
import secrets
import socket
import ssl
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import quote, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request, cookie_parser
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from gcs.errors import InputError
from gcs.keys import private_files
from gcs.viewer.origin_gate import Address, is_permitted

TOKEN_CHARACTERS_MIN = 16
_TOKEN_MAX_BYTES = 1024
_ENTER_PATH = "/enter"
_ENTER_FILES = Path(__file__).parent / "enter"
_COOKIE_MAX_AGE_S = 30 * 86400
_LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self';"
        " worker-src 'self'; font-src 'self'; media-src 'self'; base-uri 'none'; form-action 'none';"
        " frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


@dataclass(frozen=True, slots=True)
class Access:
    """Where the server listens, by which certificate and key (PEM files), and the token that opens the page."""

    address: Address
    token: str
    tls: tuple[Path, Path] | None = None

    @property
    def origin(self) -> str:
        """The origin of the page at its own address."""
        host = f"[{self.address.host}]" if ":" in self.address.host else self.address.host
        return f"{self.scheme}://{host}:{self.address.port}"

    @property
    def url(self) -> str:
        """The URL to open in a browser."""
        return f"{self.origin}/#{quote(self.token, safe='')}"

    @property
    def cookie(self) -> str:
        """The name of the cookie: browsers share cookies among the ports of a computer."""
        return f"cordon-station-{self.address.port}"

    @property
    def cookie_value(self) -> str:
        """The value of the cookie, which replaces the token."""
        return hashlib.sha256(f"cordon station {self.token}".encode()).hexdigest()

    @property
    def scheme(self) -> str:
        """The scheme of its URLs."""
        return "http" if self.tls is None else "https"

    def is_token(self, given: bytes) -> bool:
        """Return whether this is the token, in constant time."""
        return hmac.compare_digest(given, self.token.encode())

    def is_named(self, hosts: list[str]) -> bool:
        """Return whether there is one `Host` header, which names this computer; the port may be a forwarded one."""
        try:
            name = urlsplit(f"//{hosts[0]}").hostname or "" if len(hosts) == 1 else ""
        except ValueError:
            return False
        own = {self.address.host.lower(), *_LOOPBACK}
        if self.address.is_loopback:
            return name in own
        computer = socket.gethostname().lower()
        return name in own | {computer, f"{computer}.local"} or _is_number(name)

    def has_entered(self, headers: Headers) -> bool:
        """Return whether a request has the cookie."""
        found = cookie_parser(headers.get("cookie", "")).get(self.cookie, "")
        return hmac.compare_digest(found.encode(), self.cookie_value.encode())


def checked_access(address: Address, token: str, tls: tuple[Path, Path] | None, *, is_own_token: bool) -> Access:
    """Return the access to a server; raises InputError for unprotected access by others, and for unusable keys.

    `is_own_token` is whether the token was chosen for this server.
    """
    faults = []
    if not address.is_loopback and tls is None:
        faults.append(f"--tls: other computers can reach {address.host}: it needs a certificate and its key")
    if not address.is_loopback and not is_own_token:
        faults.append(f"--token-file: other computers can reach {address.host}: it needs a token")
    if tls is not None:
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(*tls, password=lambda: "")
        except OSError as error:  # an ssl.SSLError is one
            faults.append(f"--tls: {tls[0]}, {tls[1]}: {error.strerror or error}")
    if faults:
        raise InputError(faults)
    return Access(address, token, tls)


def read_token(path: Path) -> str:
    """Return the token in a file that only its owner may read; raises InputError."""
    try:
        token = private_files.read_private(path).decode("ascii").strip()
    except UnicodeDecodeError:
        token = ""
    if len(token) < TOKEN_CHARACTERS_MIN or not token.isprintable():
        raise InputError([f"--token-file: {path}: it must hold at least {TOKEN_CHARACTERS_MIN} printable characters"])
    return token


def kept_token(path: Path) -> str:
    """Return the token that a user's pages on this computer share, created on first use; raises InputError.

    It stays the same, so that an open page finds the next flight's server.
    """
    if not path.exists():
        private_files.write(path, secrets.token_urlsafe(24).encode())
    return read_token(path)


class AccessGate:
    """Guards the page: refuses requests without access, and adds the headers that block foreign content."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        """Take the application behind the gate."""
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        is_page = scope["type"] == "http"

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.setdefault("Cache-Control", "no-cache")
                headers.update(_HEADERS)
            await send(message)

        headers = Headers(scope=scope)
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        answer: ASGIApp
        if not self._access.is_named(hosts):
            answer = _refusal("wrong address: open the one that `cordon station` printed", is_page)
        elif not is_permitted(origins, {f"{self._access.scheme}://{hosts[0]}"}):
            answer = _refusal("refused: another web page must not read this one", is_page)
        elif is_page and scope["path"].startswith(_ENTER_PATH):
            answer = await self._enter(Request(scope, receive))
        elif self._access.has_entered(headers):
            answer = self._app
        elif is_page and scope["path"] == "/":
            answer = FileResponse(_ENTER_FILES / "index.html", 401, {"Cache-Control": "no-store"})
        else:
            answer = _refusal("open the address that `cordon station` printed", is_page)
        await answer(scope, receive, send_with_headers)

    async def _enter(self, request: Request) -> Response:
        """Serve the first page's script and style, and set the cookie for the token."""
        if request.method == "GET" and request.url.path in ("/enter/enter.js", "/enter/enter.css"):
            return FileResponse(_ENTER_FILES / Path(request.url.path).name)
        if request.method != "POST" or request.url.path != _ENTER_PATH:
            return PlainTextResponse("not found", 404)
        given = b""
        async for piece in request.stream():
            given += piece
            if len(given) > _TOKEN_MAX_BYTES:
                return PlainTextResponse("wrong token", 413)
        if not self._access.is_token(given):
            return PlainTextResponse("wrong token", 403)
        response = Response(status_code=204)
        response.set_cookie(
            self._access.cookie,
            self._access.cookie_value,
            max_age=_COOKIE_MAX_AGE_S,
            httponly=True,
            samesite="strict",
            secure=self._access.tls is not None,
        )
        return response


def _refusal(reason: str, is_page: bool) -> ASGIApp:
    return PlainTextResponse(reason, 403) if is_page else WebSocketClose(1008, reason)


def _is_number(name: str) -> bool:
    """Return whether a name is a numeric address, which no name server can redirect."""
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
