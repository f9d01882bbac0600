"""A browser for tests of the operator's page: the system's Chromium, driven by Playwright."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from tests.support.page.browser import launched
from tests.support.page.canned_station import CannedStation
from tests.support.page.station_pictures import ring_mission, ring_team
from tests.support.wire import PATIENCE_S

expect.set_options(timeout=1000.0 * PATIENCE_S)

EXPECTED = (
    "404",
    "ERR_CONNECTION_",
    "ERR_SOCKET_NOT_CONNECTED",
    "WebSocket",
    "Worker failed to load",
    "dynamically imported module",
)
"""A station lacks tiles, and breaks connections when it goes. A map without its worker draws nothing, which other tests
see."""
VIEWPORT: Any = {"width": 1024, "height": 640}

NO_WEBGL = (
    "const get = HTMLCanvasElement.prototype.getContext;"
    "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
    "  return kind.startsWith('webgl') ? null : get.call(this, kind, ...more); };"
)
"""A script for tests that need no map: without a graphics card it takes most of the processor."""

FEW_FRAMES = """
const [frame, cancel, waiting] = [requestAnimationFrame.bind(window), cancelAnimationFrame.bind(window), new Map()];
let last = 0;
window.requestAnimationFrame = (draw) => {
  const id = ++last;
  const drawn = (now_ms) => { waiting.delete(id); draw(now_ms); };
  const timer = setTimeout(() => { const asked = frame(drawn); waiting.set(id, () => cancel(asked)); }, 80);
  waiting.set(id, () => clearTimeout(timer));
  return id;
};
window.cancelAnimationFrame = (id) => { waiting.get(id)?.(); waiting.delete(id); };
"""
"""A script for all tests: ten pictures a second, as each takes much of a core without a graphics card."""

SOCKET = """
window.WebSocket = class extends WebSocket {
  constructor(...address) {
    super(...address);
    window.socket = this;
    window.heard = 0;
    this.addEventListener("message", () => { window.heard += 1; });
  }
};
"""
"""A script for all tests: the newest connection, and how many messages have come on it; see `CannedStation`."""

OpenPage = Callable[..., Page]


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """Return a browser; without one the test is skipped."""
    with launched() as browser:
        yield browser


@pytest.fixture(scope="module")
def context(browser: Browser) -> Iterator[BrowserContext]:
    """Return the context of a module's pages; each has a station, and with it an origin, of its own."""
    context = browser.new_context(viewport=VIEWPORT)
    yield context
    context.close()


@pytest.fixture(scope="module")
def simulated_context(browser: Browser) -> Iterator[BrowserContext]:
    """Return the same for pages whose time is simulated: a context has one clock."""
    context = browser.new_context(viewport=VIEWPORT)
    context.clock.install()
    yield context
    context.close()


@pytest.fixture
def open_page(browser: Browser, context: BrowserContext, simulated_context: BrowserContext) -> Iterator[OpenPage]:
    """Return what opens a page of a station, with settings in a context of its own.

    Errors of its scripts fail the test. Time that is `simulated` passes as always, and at once in `pass_time`.
    """
    errors: list[str] = []
    opened: list[Page | BrowserContext] = []

    def open_at(url: str, *, script: str = "", simulated: bool = False, **settings: Any) -> Page:
        own = browser.new_context(**{"viewport": VIEWPORT, **settings}) if settings else None
        page = _new_page(own or (simulated_context if simulated else context), script, errors)
        opened.append(own or page)
        page.goto(url)
        return page

    yield open_at
    for each in opened:
        each.close()
    assert not errors


def _new_page(context: BrowserContext, script: str, errors: list[str]) -> Page:
    page = context.new_page()
    page.set_default_timeout(1000.0 * PATIENCE_S)
    page.on("pageerror", lambda error: _keep_error(str(error), "error", errors))
    page.on("console", lambda message: _keep_error(message.text, message.type, errors))
    page.add_init_script(FEW_FRAMES + SOCKET + script)
    return page


class KeptPage(NamedTuple):
    """A station and its page, for all tests of a module, and the errors of the page's scripts."""

    station: CannedStation
    page: Page
    errors: list[str]


@pytest.fixture(scope="module")
def kept(request: pytest.FixtureRequest, simulated_context: BrowserContext) -> Iterator[KeptPage]:
    """Return them, with the module's `SCRIPT`: to load a page again takes a quarter of what a new one takes."""
    errors: list[str] = []
    with CannedStation() as station:
        page = _new_page(simulated_context, request.module.SCRIPT, errors)
        page.goto(station.url)
        yield KeptPage(station, page, errors)
        page.close()


@pytest.fixture
def served(kept: KeptPage) -> CannedStation:
    """Return the module's station, which begins anew with a team of three on its ring."""
    mission = ring_mission()
    kept.station.begin(mission, lambda time_s: ring_team(mission, 100.0 + time_s))
    return kept.station


@pytest.fixture
def page(kept: KeptPage, served: CannedStation) -> Iterator[Page]:
    """Return the module's page, loaded anew, without a map and with simulated time."""
    kept.errors.clear()
    kept.page.set_viewport_size(VIEWPORT)
    kept.page.reload()
    expect(kept.page.locator(".card .tactic").first).to_have_text("encircle")
    yield kept.page
    assert not kept.errors


def pass_time(page: Page, time_ms: float) -> None:
    """Let time pass at once on a page whose time is simulated."""
    page.clock.run_for(round(time_ms))


@contextmanager
def stopped(page: Page) -> Iterator[None]:
    """Stop the page's time, which otherwise goes on beside `pass_time`: a busy computer takes long for a key.

    The page goes to a time that has not passed when it is asked to stop there.
    """
    page.clock.pause_at(page.evaluate("(Date.now() + 5000) / 1000"))  # [s]
    yield
    page.clock.resume()


def _keep_error(text: str, kind: str, errors: list[str]) -> None:
    if kind == "error" and not any(expected in text for expected in EXPECTED):
        errors.append(text)
