"""Map tiles of an HTTP server, one after the other at a polite rate, and never of one whose terms forbid it."""

import time
from collections.abc import Callable
from http.client import HTTPException
from importlib.metadata import version
from urllib.error import HTTPError, URLError
from urllib.parse import unquote, urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from gcs.errors import InputError
from gcs.station.tile_area import TilePlace
from gcs.station.tiles import TILE_MAX_BYTES, TileImage, image_of

FORBIDDEN = {
    "openstreetmap.org": "its tile usage policy forbids bulk download and download for use offline",
    "osm.org": "its tile usage policy forbids bulk download and download for use offline",
    "openstreetmap.de": "its terms forbid bulk download",
    "openstreetmap.fr": "its terms forbid bulk download",
    "opentopomap.org": "its terms forbid bulk download",
    "google.com": "its terms forbid copies for use offline",
    "googleapis.com": "its terms forbid copies for use offline",
    "virtualearth.net": "its terms forbid copies for use offline",
    "arcgisonline.com": "its terms forbid bulk download",
    "mapbox.com": "its terms forbid bulk download",
}
"""Servers, with their subdomains, that are not asked for areas."""
TIMEOUT_S = 20.0
TRIES = 4
WAIT_MAX_S = 60.0
_BUSY = (429, 500, 502, 503, 504)
_NO_TILE = (204, 404, 410)
_FIRST_WAIT_S = 1.0


class TileServerError(Exception):
    """A server gives no more tiles for now."""


class _SameHost(HTTPRedirectHandler):
    """Follows redirections on one host only: another one may have other terms."""

    def redirect_request(self, req: Request, fp, code, msg, headers, newurl):  # type: ignore[no-untyped-def]
        if urlsplit(newurl).hostname != urlsplit(req.full_url).hostname:
            return None
        return super().redirect_request(req, fp, code, msg, headers, newurl)


class TileServer:
    """A server by the template of its addresses, such as https://tiles.example/{z}/{x}/{y}.png; {-y}: from the south.

    Raises InputError for a template that is none, and for servers of `FORBIDDEN`.
    """

    def __init__(self, template: str, rate_hz: float, sleep: Callable[[float], None] = time.sleep) -> None:
        self._template = template
        self._interval_s = 1.0 / rate_hz
        self._sleep = sleep
        self._next_s = 0.0
        self._opener = build_opener(_SameHost)
        self._agent = f"cordon/{version('cordon-gcs')} (maps for use offline)"
        parts = urlsplit(template)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise InputError([f"--from: {template!r} is neither a file nor an address http://... or https://..."])
        if not all(each in template for each in ("{z}", "{x}")) or not ("{y}" in template or "{-y}" in template):
            raise InputError(
                [f"--from: {template!r} lacks {{z}}, {{x}} or {{y}}, in whose place level, column and row are put"]
            )
        self.host = _host_asked(parts.hostname)
        for host, reason in FORBIDDEN.items():
            if self.host == host or self.host.endswith(f".{host}"):
                step = "next: a server whose licence allows it, or a file"
                raise InputError([f"--from: {self.host} is not asked for areas: {reason}; {step}"])

    def tile(self, place: TilePlace) -> TileImage | None:
        """Return a tile's image, None where the server has none.

        Waits for its turn. Raises InputError if the server refuses or sends something else, TileServerError if it is
        busy or does not answer.
        """
        level, column, row = place
        address = self._template.replace("{z}", f"{level}").replace("{x}", f"{column}").replace("{y}", f"{row}")
        address = address.replace("{-y}", f"{2**level - 1 - row}")
        reason = ""
        for number in range(TRIES):
            self._wait_for_turn()
            try:
                return self._asked(address)
            except HTTPError as error:
                if error.code in _NO_TILE:
                    return None
                if error.code not in _BUSY:
                    raise InputError(
                        [f"--from: {self.host} answers {error.code} {error.reason} to {address}"]
                    ) from error
                reason, wait_s = f"it answers {error.code} {error.reason}", _retry_after_s(error, number)
            except (URLError, HTTPException, OSError) as error:
                reason, wait_s = f"{getattr(error, 'reason', error)}", _FIRST_WAIT_S * 2.0**number
            if number + 1 < TRIES:
                self._sleep(wait_s)
        raise TileServerError(f"{self.host}: {reason}")

    def _wait_for_turn(self) -> None:
        now_s = time.monotonic()
        if self._next_s > now_s:
            self._sleep(self._next_s - now_s)
        self._next_s = max(self._next_s, now_s) + self._interval_s

    def _asked(self, address: str) -> TileImage | None:
        request = Request(address, headers={"User-Agent": self._agent})
        with self._opener.open(request, timeout=TIMEOUT_S) as answer:
            if answer.status in _NO_TILE:
                return None
            data = answer.read(TILE_MAX_BYTES + 1)
        image = image_of(data) if len(data) <= TILE_MAX_BYTES else None
        if image is None:
            raise InputError([f"--from: {self.host} sends no PNG, JPEG or WebP of up to 4 MB for {address}"])
        return image


def _host_asked(given: str) -> str:
    """Return the name of the host that is asked: one name has several spellings; raises InputError for none."""
    try:
        host = unquote(given).encode("idna").decode("ascii").lower().removesuffix(".")
    except UnicodeError as error:
        raise InputError([f"--from: {given!r} is no name of a host: {error}"]) from error
    return host


def _retry_after_s(error: HTTPError, number: int) -> float:
    """Return for how long a busy server asks to wait, at most a minute."""
    asked = error.headers.get("Retry-After", "") if error.headers else ""
    return min(float(asked), WAIT_MAX_S) if asked.isdecimal() else _FIRST_WAIT_S * 2.0**number
