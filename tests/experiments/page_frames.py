"""Measure frames and processor time of the operator's page in a browser without a graphics card.

A station sends a team on its ring ten times a second, with full trails, to headless Chromium, which draws as it does
without a graphics card: the page by the processor, the map's WebGL by SwiftShader. The reference of the same run is an
empty page: the frames that this computer has time for. Another page, as of an earlier version, is measured alternately.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count as numbers
from math import cos, sin
from os import getloadavg
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray
from playwright.sync_api import Browser, CDPSession, Page

from gcs.station.live_team import PICTURES_HZ
from tests.experiments.arguments import parser, positive
from tests.support.page.browser import MISSING, launched, program
from tests.support.page.canned_station import PAGE, CannedStation
from tests.support.page.station_pictures import ring_mission, ring_team

SETTLE_S, DRAG_EVERY_S = 3.0, 0.012
TRAIL_S, TRAIL_EVERY_S = 120.0, 0.5
FRAMES_MIN, FRAME_MAX_MS, JUDGED_VEHICLES = 0.9, 3.0, 32
"""Least share of the reference's frames, and most time of the main thread in a frame, of teams up to this size."""
METER = """(() => {
  window.meter = [];
  const tick = (now_ms) => { meter.push(now_ms); requestAnimationFrame(tick); };
  requestAnimationFrame(tick);
})()"""
COLUMNS = (
    "page",
    "vehicles",
    "frames/s, median",
    "mean",
    "frame p99, ms",
    "main thread, ms a frame",
    "ms a picture",
    "renderer, cores",
    "GL, cores",
    "load",
)


@dataclass(frozen=True)
class Measured:
    """The times of a page's frames [s], and processor time in its main thread and by process of the browser [s]."""

    times_s: NDArray[np.float64]
    main_s: float
    processes_s: dict[str, float]
    lasted_s: float

    @property
    def frames_hz(self) -> float:
        """The median of the frames in each second."""
        seconds = np.arange(self.times_s[0], self.times_s[-1], 1.0)
        return float(np.median(np.histogram(self.times_s, bins=seconds)[0]))

    @property
    def frame_ms(self) -> float:
        """The main thread's time in a frame."""
        return 1e3 * self.main_s / len(self.times_s)

    def row(self, name: str, vehicles: int) -> str:
        """Return the row of the table."""
        cells = [
            name,
            f"{vehicles}",
            f"{self.frames_hz:.0f}",
            f"{len(self.times_s) / self.lasted_s:.1f}",
            f"{1e3 * np.percentile(np.diff(self.times_s), 99.0):.0f}",
            f"{self.frame_ms:.2f}",
            f"{1e3 * self.main_s / self.lasted_s / PICTURES_HZ:.1f}",
            *(f"{self.processes_s[kind] / self.lasted_s:.2f}" for kind in ("renderer", "gpu-process")),
            f"{getloadavg()[0]:.1f}",
        ]
        return f"| {' | '.join(cells)} |"


@contextmanager
def flown(browser: Browser, folder: Path, vehicles: int, size: tuple[int, int]) -> Iterator[Page]:
    """Open the page of a folder with a team whose trails are as long as they become."""
    mission = ring_mission(vehicles)
    with CannedStation(mission, lambda _time_s: ring_team(mission, 0.0), page=folder, rate_hz=PICTURES_HZ) as station:
        page = opened(browser, size)
        page.goto(station.url)
        page.locator(".symbol[data-vehicle]").nth(vehicles - 1).wait_for()
        station.is_silent = True
        time.sleep(2.0 / PICTURES_HZ)
        for time_s in np.arange(0.0, TRAIL_S, TRAIL_EVERY_S):
            station.send(ring_team(mission, float(time_s)))
        began_s = time.monotonic()
        station.team = lambda _time_s: ring_team(mission, TRAIL_S + time.monotonic() - began_s)
        station.is_silent = False
        yield page
        page.close()


def opened(browser: Browser, size: tuple[int, int]) -> Page:
    """Return an empty page that keeps the times of its frames."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    page.add_init_script(METER)
    page.goto("about:blank")
    return page


def measured(page: Page, lasting_s: float, *, drags: bool) -> Measured:
    """Measure a page, while its map is dragged if that is asked for."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.wait_for_timeout(1e3 * SETTLE_S)
    page.evaluate("meter.length = 0")
    main_s, processes_s, began_s = _main_s(session), _processes_s(), time.monotonic()
    if drags:
        drag(page, lasting_s)
    else:
        page.wait_for_timeout(1e3 * lasting_s)
    times_s = np.array(page.evaluate("meter")) / 1e3
    used_s = {kind: spent_s - processes_s.get(kind, 0.0) for kind, spent_s in _processes_s().items()}
    return Measured(times_s, _main_s(session) - main_s, used_s, time.monotonic() - began_s)


def drag(page: Page, lasting_s: float) -> None:
    """Drag the map around."""
    box = page.locator("#map").bounding_box()
    assert box is not None
    x, y = box["x"] + 0.4 * box["width"], box["y"] + 0.4 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    end_s = time.monotonic() + lasting_s
    for step in numbers():
        page.mouse.move(x + 60.0 * sin(step / 15.0), y + 40.0 * cos(step / 15.0))
        time.sleep(DRAG_EVERY_S)
        if time.monotonic() > end_s:
            break
    page.mouse.up()


def _main_s(session: CDPSession) -> float:
    metrics = session.send("Performance.getMetrics")["metrics"]
    return float(next(each["value"] for each in metrics if each["name"] == "TaskDuration"))


def _processes_s() -> dict[str, float]:
    """Return the processor time by the kind of process of the browser that this process has started."""
    spent_s = {"renderer": 0.0, "gpu-process": 0.0}
    for process in psutil.Process().children(recursive=True):
        for kind in spent_s:
            if f"--type={kind}" in process.cmdline():
                spent_s[kind] += sum(process.cpu_times()[:2])
    return spent_s


def main() -> int:
    """Measure; return 1 where this page is too slow, 2 without a browser."""
    reader = parser("page_frames", __doc__ or "")
    reader.add_argument("--vehicles", type=int, nargs="+", default=[3, 32, 64], help="team sizes (default: 3 32 64)")
    reader.add_argument("--seconds", type=positive, default=15.0, help="of each measurement (default: %(default)s)")
    reader.add_argument("--size", type=int, nargs=2, default=[1280, 800], help="pixels (default: 1280 800)")
    reader.add_argument("--beside", type=Path, help="folder of another page, as of gcs/station/page")
    reader.add_argument("--drag", action="store_true", help="drag the map meanwhile")
    chosen = reader.parse_args()
    if min(*chosen.vehicles, *chosen.size) < 1:
        reader.error("vehicles and pixels are whole numbers above 0")
    if program() is None:
        print(MISSING, file=sys.stderr)
        return 2
    size, holds = (chosen.size[0], chosen.size[1]), True
    pages = {"other": chosen.beside, "this": PAGE} if chosen.beside else {"this": PAGE}
    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|", flush=True)
    with launched() as browser:
        empty = opened(browser, size)
        reference = measured(empty, chosen.seconds, drags=False)
        empty.close()
        print(reference.row("empty", 0), flush=True)
        for vehicles in chosen.vehicles:
            for name, folder in pages.items():
                with flown(browser, folder, vehicles, size) as page:
                    found = measured(page, chosen.seconds, drags=chosen.drag)
                print(found.row(name, vehicles), flush=True)
                if name == "this" and vehicles <= JUDGED_VEHICLES:
                    holds &= found.frames_hz >= FRAMES_MIN * reference.frames_hz and found.frame_ms <= FRAME_MAX_MS
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
