"""Measurement of the operator's page in a browser: frames, main thread, memory, and processor time of its processes."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import psutil
from numpy.typing import NDArray
from playwright.sync_api import Page

_FRAMES_MAX = 300_000
"""20 minutes at 240 frames a second."""

SCRIPT = f"""(() => {{
  const meter = {{ times_ms: new Float64Array({_FRAMES_MAX}), frames: 0, drawn: 0, isDrawn: false }};
  const draw = WebGL2RenderingContext.prototype.drawElements;
  WebGL2RenderingContext.prototype.drawElements = function (mode, count, type, offset) {{
    meter.isDrawn = true;
    draw.call(this, mode, count, type, offset);
  }};
  const tick = (now_ms) => {{
    meter.times_ms[meter.frames++] = now_ms;
    meter.drawn += meter.isDrawn;
    meter.isDrawn = false;
    requestAnimationFrame(tick);
  }};
  requestAnimationFrame(tick);
  window.meter = meter;
}})()"""
"""Keeps the time of every frame that the browser requested, and the number in which the map was drawn."""

_RENDERER = """() => {
  const context = document.createElement("canvas").getContext("webgl2");
  const names = context?.getExtension("WEBGL_debug_renderer_info");
  return names ? context.getParameter(names.UNMASKED_RENDERER_WEBGL) : "no WebGL";
}"""
_SPENT = {
    "script": "ScriptDuration",
    "layout": "LayoutDuration",
    "style": "RecalcStyleDuration",
    "main": "TaskDuration",
}


@dataclass(frozen=True)
class Memory:
    """Memory [MB] of the page's heap after a collection, of the browser's processes, and of the server; DOM nodes."""

    heap_mb: float
    browser_mb: float
    server_mb: float
    nodes: int


@dataclass(frozen=True)
class Spent:
    """Processor seconds: of the page's main thread by kind, of the browser, of its GL process, and of the server."""

    page_s: dict[str, float]
    browser_s: float
    gl_s: float
    server_s: float


class PageMeter:
    """Measures a page that was opened with `SCRIPT`, and the process of its server."""

    def __init__(self, page: Page, server_pid: int) -> None:
        self._page = page
        self._server = psutil.Process(server_pid)
        self._cdp = page.context.new_cdp_session(page)
        # Processor time: without a graphics card the main thread often waits for a core.
        self._cdp.send("Performance.enable", {"timeDomain": "threadTicks"})

    def renderer(self) -> str:
        """Return the WebGL renderer."""
        return str(self._page.evaluate(_RENDERER))

    def restart(self) -> None:
        """Restart the recording of frames."""
        self._page.evaluate("() => { meter.frames = meter.drawn = 0; }")

    def frames(self) -> tuple[NDArray[np.float64], int]:
        """Return the times between frames since the restart [ms], and the number of frames with the map drawn."""
        times_ms, drawn = self._page.evaluate("() => [[...meter.times_ms.subarray(0, meter.frames)], meter.drawn]")
        return np.diff(np.array(times_ms)), drawn

    def spent(self) -> Spent:
        """Return the processor time until now."""
        metrics = self._metrics()
        by_process = [(process, sum(process.cpu_times()[:2])) for process in _browser_processes()]
        return Spent(
            {kind: metrics[name] for kind, name in _SPENT.items()},
            sum(cpu_s for _, cpu_s in by_process),
            sum(cpu_s for process, cpu_s in by_process if "--type=gpu-process" in process.cmdline()),
            sum(self._server.cpu_times()[:2]),
        )

    def memory(self) -> Memory:
        """Collect the page's garbage, and return the memory used."""
        self._cdp.send("HeapProfiler.collectGarbage")
        heap_bytes = self._cdp.send("Runtime.getHeapUsage")["usedSize"]
        browser_bytes = sum(process.memory_info().rss for process in _browser_processes())
        nodes = round(self._metrics()["Nodes"])
        return Memory(heap_bytes / 1e6, browser_bytes / 1e6, self._server.memory_info().rss / 1e6, nodes)

    def _metrics(self) -> dict[str, float]:
        return {each["name"]: each["value"] for each in self._cdp.send("Performance.getMetrics")["metrics"]}


def _browser_processes() -> Iterator[psutil.Process]:
    """Yield the processes of the browser that this process has started."""
    return (process for process in psutil.Process().children(recursive=True) if "chrom" in process.name())
