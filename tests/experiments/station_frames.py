"""Measure the operator's page: frame times and memory by team size, and the load of forty pages on a flight.

Frames: the real server publishes a team on its ring, without a flight, to headless Chromium. Without a graphics card
the processor draws: the frame rate then depends on the computer, and the main thread's processor time per frame
measures the page. Pages: a flight of three stubs alone, then one with forty pages on its station, which are killed at
once halfway and reopened.
"""

import subprocess
import sys
import threading
import time
from argparse import ArgumentTypeError
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray
from playwright.sync_api import sync_playwright

from tests.experiments.arguments import count, parser, positive
from tests.experiments.flight_profile import Profile, profile
from tests.support.page.browser import ARGUMENTS, MISSING, program
from tests.support.page.moving_station import moving_station
from tests.support.page.page_meter import SCRIPT, Memory, PageMeter, Spent
from tests.support.paths import ROOT, finds_tests
from tests.support.wire import LOOPBACK, cordon, free_port

SETTLE_S = 5.0
MEMORY_EVERY_S = 60.0
LOOKS_MIN = 3
JUDGED_FROM_LOOKS = 6
"""Memory is checked over the second half if the run has at least this many minutes: the trails are full after two."""
HEAP_GROWTH_MAX_MB_MIN, SERVER_GROWTH_MAX_MB_MIN = 0.2, 0.2
TEAM = 3
TAKE_OFF_S = 12.0
FRAME_COLUMNS = (
    "vehicles",
    "frames/s",
    "with map drawn",
    "frame p50, ms",
    "p99, ms",
    "script, ms a frame",
    "layout and style, ms a frame",
    "main thread, ms a frame",
    "main thread, cores",
    "all of the browser, cores",
    "its GL process, cores",
    "server, cores",
    "heap, MB",
    "DOM nodes",
    "browser, MB",
    "server, MB",
)
PAGE_COLUMNS = (
    "pages",
    "ticks",
    "missed",
    "late p50, ms",
    "late p99, ms",
    "flight, cores",
    "flight, MB",
    "station, cores",
    "station, MB",
    "open at the end",
    "messages/s read",
    "closed by the station",
)


@dataclass(frozen=True)
class Frames:
    """The measurements of a page with a team: times between frames, processor time, and memory by minute."""

    vehicles: int
    renderer: str
    frame_ms: NDArray[np.float64]
    drawn: int
    begun: Spent
    ended: Spent
    memory: Sequence[Memory]
    memory_every_s: float

    def row(self) -> str:
        """Return the row of the table."""
        frames, lasted_s = len(self.frame_ms), float(self.frame_ms.sum()) / 1e3
        spent_s = {kind: self.ended.page_s[kind] - self.begun.page_s[kind] for kind in self.begun.page_s}
        p50_ms, p99_ms = np.percentile(self.frame_ms, (50, 99))
        first, last = self.memory[0], self.memory[-1]
        cores = [
            spent_s["main"] / lasted_s,
            (self.ended.browser_s - self.begun.browser_s) / lasted_s,
            (self.ended.gl_s - self.begun.gl_s) / lasted_s,
            (self.ended.server_s - self.begun.server_s) / lasted_s,
        ]
        cells = [
            f"{self.vehicles}",
            f"{frames / lasted_s:.1f}",
            f"{self.drawn / lasted_s:.1f}",
            f"{p50_ms:.1f}",
            f"{p99_ms:.1f}",
            f"{spent_s['script'] / frames * 1e3:.2f}",
            f"{(spent_s['layout'] + spent_s['style']) / frames * 1e3:.2f}",
            f"{spent_s['main'] / frames * 1e3:.2f}",
            *(f"{each:.3f}" for each in cores),
            f"{first.heap_mb:.1f} - {last.heap_mb:.1f}",
            f"{first.nodes} - {last.nodes}",
            f"{first.browser_mb:.0f} - {last.browser_mb:.0f}",
            f"{first.server_mb:.1f} - {last.server_mb:.1f}",
        ]
        return f"| {' | '.join(cells)} |"

    def growth_mb_min(self) -> tuple[float, float]:
        """Return the growth of the page's heap and the server's memory in the second half [MB/min]."""
        half = self.memory[len(self.memory) // 2 :]
        minutes = np.arange(len(half)) * self.memory_every_s / 60.0
        heap, server = ([each.heap_mb for each in half], [each.server_mb for each in half])
        return float(np.polyfit(minutes, heap, 1)[0]), float(np.polyfit(minutes, server, 1)[0])


def measured(vehicles: int, minutes: float, size: tuple[int, int], browser_path: str) -> Frames:
    """Open the page of a team in a browser, and measure it."""
    looks = max(round(60.0 * minutes / MEMORY_EVERY_S), LOOKS_MIN)
    every_s = 60.0 * minutes / looks
    with moving_station(vehicles) as (url, server_pid), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(60_000.0)
        page.add_init_script(SCRIPT)
        page.goto(url)
        page.locator(".symbol[data-vehicle]").nth(vehicles - 1).wait_for()
        meter = PageMeter(page, server_pid)
        renderer = meter.renderer()
        page.wait_for_timeout(SETTLE_S * 1e3)
        meter.restart()
        begun, memory = meter.spent(), []
        for _ in range(looks):
            page.wait_for_timeout(every_s * 1e3)
            memory.append(meter.memory())
        frame_ms, drawn = meter.frames()
        found = Frames(vehicles, renderer, frame_ms, drawn, begun, meter.spent(), memory, every_s)
        browser.close()
    return found


def measure_frames(sizes: Sequence[int], minutes: float, size: tuple[int, int], browser_path: str) -> bool:
    """Print frames and memory by team size; return whether memory is constant."""
    print(f"| {' | '.join(FRAME_COLUMNS)} |\n{'|---' * len(FRAME_COLUMNS)}|", flush=True)
    found = []
    for vehicles in sizes:
        found.append(measured(vehicles, minutes, size, browser_path))
        print(found[-1].row(), flush=True)
    print(f"\n{minutes:g} min each, {size[0]}x{size[1]}, drawn by {found[0].renderer}\n")
    is_flat = True
    for each in found:
        print(f"{each.vehicles} vehicles, heap by the minute, MB: {' '.join(f'{m.heap_mb:.1f}' for m in each.memory)}")
        if len(each.memory) >= JUDGED_FROM_LOOKS:
            heap, server = each.growth_mb_min()
            print(f"growth in the second half, MB a minute: heap {heap:+.3f}, server {server:+.3f}")
            is_flat &= heap < HEAP_GROWTH_MAX_MB_MIN and server < SERVER_GROWTH_MAX_MB_MIN
    return is_flat


@dataclass
class Visit:
    """A station's usage while pages read it, and the last output of the pages."""

    cores: float = 0.0
    memory_before_mb: float = 0.0
    memory_mb: float = 0.0
    said: str = "- - -"


@contextmanager
def visited(mission: Path, pages: int, killed_after_s: float, visit: Visit) -> Iterator[None]:
    """Run a station of a mission with pages that are killed once and reopened."""
    with cordon("station", "--mission", str(mission), "--address", f"{LOOPBACK}:{free_port()}") as station:
        assert station.stderr is not None
        address, ended = station.stderr.readline(), threading.Event()
        process, began_s = psutil.Process(station.pid), time.monotonic()
        before_s, visit.memory_before_mb = sum(process.cpu_times()[:2]), process.memory_info().rss / 1e6
        visitors = threading.Thread(target=visit_twice, args=(address, pages, killed_after_s, ended, visit))
        visitors.start()
        try:
            yield
        finally:
            visit.cores = (sum(process.cpu_times()[:2]) - before_s) / (time.monotonic() - began_s)
            visit.memory_mb = process.memory_info().rss / 1e6
            ended.set()
            visitors.join()


def visit_twice(address: str, pages: int, killed_after_s: float, ended: threading.Event, visit: Visit) -> None:
    """Open pages, kill them all at once, and reopen them until the end."""
    command = [sys.executable, "-m", "tests.support.page.station_pages", address, str(pages)]
    for lasting_s in (killed_after_s, None):
        with subprocess.Popen(command, cwd=ROOT, env=finds_tests(), stdout=subprocess.PIPE, text=True) as visitors:
            ended.wait(lasting_s)
            visitors.kill()
            lines = visitors.communicate()[0].splitlines()
        visit.said = lines[-1] if lines else visit.said


def measure_pages(pages: int, duration_s: float, turns: int) -> bool:
    """Fly alone and with pages in turn and print both; return whether no tick was missed with pages."""
    print(f"| {' | '.join(PAGE_COLUMNS)} |\n{'|---' * len(PAGE_COLUMNS)}|", flush=True)
    missed = {0: 0, pages: 0}
    for opened in (0, pages) * turns:
        visit = Visit()
        beside = partial(visited, pages=opened, killed_after_s=TAKE_OFF_S + duration_s / 2.0, visit=visit)
        flight = profile(TEAM, duration_s, beside=beside if opened else nullcontext)
        missed[opened] += flight.missed
        print(page_row(opened, flight, visit), flush=True)
    return missed[pages] <= missed[0]


def page_row(pages: int, flight: Profile, visit: Visit) -> str:
    """Return the row of a flight."""
    cells = [
        f"{pages}",
        f"{flight.ticks}",
        f"{flight.missed}",
        f"{flight.late_p50_ms:.1f}",
        f"{flight.late_p99_ms:.1f}",
        f"{flight.cores:.2f}",
        f"{flight.memory_mb:.0f}",
        f"{visit.cores:.2f}",
        f"{visit.memory_before_mb:.0f} - {visit.memory_mb:.0f}",
        *visit.said.split(),
    ]
    return f"| {' | '.join(cells)} |"


def pixels(text: str) -> tuple[int, int]:
    """Return width and height; raises ArgumentTypeError unless the text is WIDTHxHEIGHT."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise ArgumentTypeError(f"it must be WIDTHxHEIGHT in pixels, for example 1280x800 (given: {text!r})")
    return int(width), int(height)


def main() -> int:
    """Measure; return 1 if memory grows or ticks are missed with pages, 2 without a browser."""
    reader = parser("station_frames", __doc__ or "")
    reader.add_argument("part", nargs="?", choices=("frames", "pages", "all"), default="all", help="(default: all)")
    reader.add_argument("--vehicles", type=count, nargs="+", default=[3, 16, 32], help="team sizes (default: 3 16 32)")
    reader.add_argument("--minutes", type=positive, default=10.0, help="minutes of each size (default: %(default)s)")
    reader.add_argument("--size", type=pixels, default=(1280, 800), help="size of the page, pixels (default: 1280x800)")
    reader.add_argument("--pages", type=count, default=40, help="pages beside a flight (default: %(default)s)")
    reader.add_argument("--duration", type=positive, default=60.0, help="flight duration, s (default: %(default)s)")
    reader.add_argument("--turns", type=count, default=1, help="flights alone and with pages (default: %(default)s)")
    chosen = reader.parse_args()
    holds = True
    if chosen.part != "pages":
        if (browser := program()) is None:
            print(MISSING, file=sys.stderr)
            return 2
        holds &= measure_frames(chosen.vehicles, chosen.minutes, chosen.size, browser)
    if chosen.part != "frames":
        holds &= measure_pages(chosen.pages, chosen.duration, chosen.turns)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
