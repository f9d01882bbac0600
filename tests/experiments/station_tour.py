"""Execute the drill of docs/practice.md on the operator's page, and check all results that the document states.

The document is executed: its commands are started as written. Numbered lines are the operator's actions, lines with a
dash the expected results: words `like these` in the named part of the screen, with `...` for variable parts. Pictures
are taken where the document shows them. At the end the page's events are compared with those of the flight's log.
"""

import json
import re
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

from PIL import Image
from playwright.sync_api import Browser, Locator, Page, ViewportSize, sync_playwright
from playwright.sync_api import Error as PlaywrightError

from tests.experiments.arguments import parser
from tests.support.page.browser import ARGUMENTS
from tests.support.page.walk_through import Kind, Line, Terminal, lines_of, pattern
from tests.support.paths import DOCS

DOCUMENT = DOCS / "practice.md"
TIMEOUT_S = 120.0
"""The timeout of an expected result: the flight home and the descent take a minute [wall s]."""
POLL_S = 0.2
SETTLED_S = 2.0
"""The map is redrawn within this time after the page's size has changed [wall s]."""
EVENTS_APART_S = 2.0
"""The tolerance of times: the page takes events from received messages, in whole seconds."""
AT_ONCE_S = 0.2
"""Vehicles send their states five times a second or more often [mission s]."""
COLOURS = 256
"""The number of colours of a picture: a palette reduces its file to a third."""
SIZE: ViewportSize = {"width": 1280, "height": 800}
SIZES: dict[str, ViewportSize] = {
    "1920": {"width": 1920, "height": 1080},
    "1024": {"width": 1024, "height": 768},
    "390": {"width": 390, "height": 844},
}
"""Sizes of the page, by suffix of a picture's name: a picture with a suffix is taken in all of them."""
PARTS = {
    "Top bar": "header",
    "Alarm bar": "#alarm-bar",
    "Map": "#map",
    "Events": "#events",
    "Commands": "#commands",
    "Answers": "#answers > li:first-child",
    "Question": "dialog[open]",
    "End": "#ending",
    "Slider": "#seek-time",
    **{f"Card {number}": f'.card[data-vehicle="{number}"]' for number in (1, 2, 3)},
}
"""The parts of the page by their names in the document."""
TERMINAL, EXIT_CODE, GONE = "Terminal", "Exit code", "is gone"

Seen = TypeVar("Seen")


class Row(NamedTuple):
    """An expected result, the text seen, and the time in seconds; None if it did not appear."""

    step: str
    expected: str
    seen: str
    after_s: float | None


def not_understood(lines: Sequence[Line]) -> list[str]:
    """Return the lines that this program cannot execute or check, each with its step."""
    return [f"{line.step}: {line.words}" for line in lines if not _is_understood(line)]


def _is_understood(line: Line) -> bool:
    if line.kind == "action":
        return any(re.fullmatch(form, line.words) for form in _ACTIONS)
    if line.kind != "promise":
        return True
    part = re.search(r"\*\*(.+?)\*\*", line.words)
    return part is not None and part[1] in (*PARTS, TERMINAL, EXIT_CODE) and ("`" in line.words or GONE in line.words)


class Tour:
    """The walk-through in its own folder: its terminal and its page."""

    def __init__(self, browser: Browser, folder: Path, pictures: Path | None) -> None:
        self.rows: list[Row] = []
        self.live_events: list[tuple[str, str]] = []
        self._browser = browser
        self._folder = folder
        self._pictures = pictures
        self._terminals: list[Terminal] = []
        self._page: Page | None = None
        self._step = ""
        self._read_before = 0
        self._acted_s = time.monotonic()

    def carry_out(self, lines: Iterable[Line]) -> None:
        """Execute the lines in order, until one cannot be executed."""
        for line in lines:
            if line.step != self._step and self._terminals:
                self._read_before = len(self._terminals[-1].text())
            self._step = line.step
            try:
                _DONE_BY[line.kind](self, line.words)
            except (AssertionError, PlaywrightError) as error:
                self.keep(Row(line.step, line.words, f"not possible: {error}", None))
                return

    def close(self) -> None:
        """End what is still running."""
        for terminal in self._terminals:
            terminal.close()

    @property
    def page(self) -> Page:
        """The page that is open."""
        assert self._page is not None, "no page is open yet"
        return self._page

    def type_command(self, words: str) -> None:
        """Start a command."""
        self._terminals.append(Terminal.of(words, self._folder))
        self._read_before = 0
        self._acted_s = time.monotonic()

    def act(self, words: str) -> None:
        """Execute a numbered line."""
        for form, do in _ACTIONS.items():
            if found := re.fullmatch(form, words):
                do(self, *found.groups())
        self._acted_s = time.monotonic()

    def see(self, words: str) -> None:
        """Wait for an expected result, and add a row."""
        part = words.split("**")[1]
        wanted = [] if GONE in words else re.findall(r"`(.+?)`", words)
        before_s = self._acted_s

        def seen() -> str | None:
            text = self._text(part)
            if not wanted:
                return None if text else "gone"
            found = [re.search(pattern(each), text) for each in wanted]
            return "; ".join(each[0] for each in found if each) if all(found) else None

        got = _until(seen, TIMEOUT_S)
        after_s = None if got is None else time.monotonic() - before_s
        self.keep(Row(self._step, words, got or f"not kept: {self._text(part)[-300:]}", after_s))

    def keep(self, row: Row) -> None:
        """Add and print a row."""
        self.rows.append(row)
        after = "failed" if row.after_s is None else f"{row.after_s:.1f} s"
        cells = (" ".join(each.split()).replace("|", "¦") for each in (*row[:3], after))
        print(f"| {' | '.join(cells)} |", flush=True)

    def _text(self, part: str) -> str:
        if part == TERMINAL:
            return " ".join(self._terminals[-1].text()[self._read_before :].split())
        if part == EXIT_CODE:
            return self._terminals[-1].exit_code()
        place = self.page.locator(PARTS[part])
        return " ".join(place.inner_text().split()) if place.count() and place.is_visible() else ""

    def take_picture(self, name: str) -> None:
        """Save a picture of the page; names with a suffix in all sizes."""
        if self._pictures is None:
            return
        stem, _, end = Path(name).stem.rpartition("-")
        if end not in SIZES:
            self._save(name, SIZE)
            return
        for end, size in SIZES.items():
            self._save(f"{stem}-{end}.png", size)
        self._resize(SIZE)

    def _save(self, name: str, size: ViewportSize) -> None:
        assert self._pictures is not None
        self._resize(size)
        picture = Image.open(BytesIO(self.page.screenshot()))
        picture.convert("RGB").quantize(COLOURS).save(self._pictures / name, optimize=True)

    def _resize(self, size: ViewportSize) -> None:
        if self.page.viewport_size == size:
            return
        self.page.set_viewport_size(size)
        self.page.wait_for_timeout(1000.0 * SETTLED_S)
        self.page.locator("#fit").dispatch_event("click")  # a click without focus on the button
        self.page.wait_for_timeout(1000.0 * SETTLED_S)

    def open_address(self) -> None:
        """Open the address that the terminal prints; the first page light, the others dark."""
        self.note_events()
        address = _until(lambda: re.search(r"http://\S+", self._terminals[-1].text()), TIMEOUT_S)
        assert address, f"the terminal prints no address: {self._terminals[-1].text()}"
        self._page = self._browser.new_page(viewport=SIZE, color_scheme="light" if self._page is None else "dark")
        self._page.set_default_timeout(1000.0 * TIMEOUT_S)
        self._page.goto(address[0])

    def note_events(self) -> None:
        """Read the times and texts of the first page's events, oldest first, before another page is opened."""
        if self._page is None or self.live_events:
            return
        items = self._page.locator("#events li").all()
        texts = [(each.locator(".time").inner_text(), each.locator(".text").inner_text()) for each in items]
        self.live_events = texts[::-1]

    def wait_for_time(self, minutes: str, seconds: str) -> None:
        """Wait until the page shows a mission time."""
        wanted_s = 60 * int(minutes) + int(seconds)

        def reached() -> bool | None:
            shown = re.search(r"(\d+):(\d\d)", self.page.locator("#elapsed").inner_text())
            return True if shown and 60 * int(shown[1]) + int(shown[2]) >= wanted_s else None

        assert _until(reached, 60.0 + wanted_s), f"the page's time never was {minutes}:{seconds}"

    def press(self, name: str) -> None:
        """Press a button."""
        self._button(name).click()

    def press_until(self, name: str, part: str, words: str) -> None:
        """Press a button repeatedly until a part of the page shows some words."""

        def shown() -> bool | None:
            if re.search(pattern(words), self._text(part)):
                return True
            self.press(name)
            return None

        assert _until(shown, TIMEOUT_S), f"pressing {name} never showed {words} in the {part}"

    def hold_down(self, name: str) -> None:
        """Hold a button down until the command is sent."""
        before, button = self.page.locator("#answers > li").count(), self._button(name)
        button.hover()
        self.page.mouse.down()
        sent = _until(
            lambda: self.page.locator("#answers > li").count() > before or not button.is_visible() or None, TIMEOUT_S
        )
        self.page.mouse.up()
        assert sent, f"holding {name} down sent no command"

    def tick(self, name: str) -> None:
        """Tick a box."""
        self.page.get_by_label(name).check()

    def interrupt(self) -> None:
        """Press Ctrl-C in the terminal."""
        self._terminals[-1].interrupt()

    def _button(self, name: str) -> Locator:
        """Return the visible button whose text begins with a name; in the dialog if one is open."""
        scope = "dialog[open] button" if self.page.locator("dialog[open]").count() else "button:visible"
        return self.page.locator(scope).filter(has_text=re.compile(rf"^\s*{re.escape(name)}")).first


_DONE_BY: dict[Kind, Callable[[Tour, str], None]] = {
    "command": Tour.type_command,
    "action": Tour.act,
    "promise": Tour.see,
    "picture": Tour.take_picture,
}
_ACTIONS: dict[str, Callable[..., None]] = {
    r"Open the address that the terminal prints\.": Tour.open_address,
    r"Wait until \*\*Time\*\* is `T\+ (\d+):(\d\d)`\.": Tour.wait_for_time,
    r"Press \*\*Ctrl-C\*\* in the terminal\.": Tour.interrupt,
    r"Press \*\*([^*]+)\*\*\.": Tour.press,
    r"Press \*\*([^*]+)\*\* again and again until the \*\*([^*]+)\*\* shows `([^`]+)`\.": Tour.press_until,
    r"Hold \*\*([^*]+)\*\* down for a second\.": Tour.hold_down,
    r"Tick the box \*\*([^*]+)\*\*.*": Tour.tick,
}


def _until(look: Callable[[], Seen | None], timeout_s: float) -> Seen | None:
    """Wait for a result; None after the timeout."""
    end_s = time.monotonic() + timeout_s
    while (seen := look()) is None and time.monotonic() < end_s:
        time.sleep(POLL_S)
    return seen


class Happened(NamedTuple):
    """An event of a vehicle, at a time of the mission [s]."""

    vehicle: int
    text: str
    time_s: float


def on_page(events: list[tuple[str, str]], form: str) -> list[Happened]:
    """Return the events of the page, (time, text), whose text is of a form."""
    happened = []
    for at, text in events:
        minutes, _, seconds = at.partition(":")
        if (found := re.fullmatch(rf"Vehicle (\d+): {form}", text)) and seconds:
            happened.append(Happened(int(found[1]), found[2], 60.0 * int(minutes) + int(seconds)))
    return sorted(happened)


def in_log(events: Sequence[Mapping[str, Any]], kind: str, form: str) -> list[Happened]:
    """Return the events of a report's JSON that are of a kind and a form."""
    found = ((re.match(form, event["text"]), event) for event in events if event["kind"] == kind)
    return sorted(Happened(event["vehicle"], match[1], event["time_s"]) for match, event in found if match)


def merged(changes: Iterable[Happened]) -> list[Happened]:
    """Return the changes of each vehicle, with those at once as one: `a -> b`, `b -> c` are `a -> c`.

    Vehicles send their states a few times a second, so the page cannot show faster changes.
    """
    whole: list[Happened] = []
    for change in sorted(changes, key=lambda each: (each.vehicle, each.time_s)):
        before, (begin, _, end) = whole[-1] if whole else None, change.text.partition(" -> ")
        is_same = before is not None and before.vehicle == change.vehicle and before.text.endswith(f"-> {begin}")
        if before is not None and is_same and change.time_s - before.time_s <= AT_ONCE_S:
            whole[-1] = before._replace(text=f"{before.text.partition(' -> ')[0]} -> {end}")
        else:
            whole.append(change)
    return whole


def without_counterpart(some: list[Happened], others: list[Happened]) -> list[Happened]:
    """Return the events without an equal one among the others at nearly the same time."""
    return [
        one
        for one in some
        if not any(one[:2] == other[:2] and abs(one.time_s - other.time_s) <= EVENTS_APART_S for other in others)
    ]


def compare_with_log(tour: Tour, command: str, folder: Path) -> None:
    """Compare what the page showed with the log of the flight."""
    words = shlex.split(command)
    log = words[words.index("--log") + 1]
    reporter = Terminal.of(f"cordon report {log} --json", folder)
    reporter.process.wait()
    text = reporter.text()
    result = json.loads(text[text.index("{") : text.rindex("}") + 1])
    given = [value for option, value in pairwise(words) if option == "--fault"]
    page_tactics = on_page(tour.live_events, r"((?!mode )[a-z ]+ -> [a-z ]+)")
    log_tactics = merged(in_log(result["events"], "tactic", r"([a-z ]+ -> [a-z ]+)"))
    page_alerts = on_page(tour.live_events, r"alert: (.+)")
    log_alerts = in_log(result["events"], "failsafe", r"([a-z ]+):")
    for expected, some, others in (
        ("the page's changes of tactic are in the log", page_tactics, log_tactics),
        ("the log's changes of tactic were on the page", log_tactics, page_tactics),
        ("the page's alerts are in the log", page_alerts, log_alerts),
    ):
        missing = without_counterpart(some, others)
        seen = f"not so: {missing}" if missing or not some else f"{len(some)} of {len(some)}"
        tour.keep(Row("The log", expected, seen, None if missing or not some else 0.0))
    is_same = sorted(result["faults"]) == sorted(given)
    tour.keep(Row("The log", "the faults are those of the command", str(result["faults"]), 0.0 if is_same else None))


def main(pictures: Path | None) -> int:
    """Execute the document; return 1 if an expected result did not appear, 2 if a line cannot be executed."""
    lines = list(lines_of(DOCUMENT.read_text(encoding="utf-8")))
    if faults := not_understood(lines):
        print(*faults, sep="\n", file=sys.stderr)
        return 2
    print("| step | expected | seen | after |\n|---|---|---|---|", flush=True)
    with TemporaryDirectory() as name, sync_playwright() as playwright:
        program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
        browser = playwright.chromium.launch(executable_path=program, args=ARGUMENTS)
        tour = Tour(browser, Path(name), pictures)
        try:
            tour.carry_out(lines)
            compare_with_log(tour, next(each.words for each in lines if each.kind == "command"), Path(name))
        finally:
            tour.close()
            browser.close()
    failed = sum(row.after_s is None for row in tour.rows)
    print(f"\n{len(tour.rows) - failed} of {len(tour.rows)} promises kept", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    reader = parser("station_tour", __doc__ or "")
    reader.add_argument("--pictures", type=Path, help="folder for the pictures of the page")
    sys.exit(main(reader.parse_args().pictures))
