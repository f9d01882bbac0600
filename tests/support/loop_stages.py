"""Profiling inside a flying process: processor time by thread, and by stage of the event loop.

Every callback of the event loop is timed, and the stages within the ticks. Times are the thread's processor time, and
wall time, which includes the waits for the interpreter lock and for a free core.
"""

import asyncio
import ctypes
import json
import threading
import time
from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Any

STAGES: Mapping[str, tuple[str, ...]] = {
    "tick: core": ("agents.core:VehicleCore.tick",),
    "tick: setpoint to MAVSDK": ("gcs.link.mavsdk_link:MavsdkLink.send",),
    "tick: heartbeat to the supervisor": ("agents.shell.control_loop:ControlLoop.send_heartbeat",),
    "tick: status, cost, journal": ("gcs.flight.team:FlightTeam._observe",),
    "tick: publish": ("agents.shell.control_loop:ControlLoop._publish",),
    "messages: core": ("agents.core:VehicleCore._take_message",),
    "live view": ("gcs.flight.watch:Watch._update",),
}
"""Methods by stage. The time of a stage within another is not part of the outer one."""
THREADS = (
    ("relay", "relay"),
    ("flight recorder", "recorder"),
    ("vehicle-", "calls to MAVSDK"),
    ("mavsdk-hub", "MAVSDK"),  # MAVSDK's threads are created there, and inherit the name
    ("asyncio_", "other"),
    ("supervisor", "supervisor link"),
    ("pyo3", "Zenoh callbacks"),
    ("Thread-", "Zenoh callbacks"),
)
_NAME_BYTES = 15
_SET_NAME = 15


class StageClock:
    """Processor and wall time by stage of one thread; a stage that begins within another interrupts it."""

    def __init__(self) -> None:
        self.cpu_s: dict[str, float] = {}
        self.wall_s: dict[str, float] = {}
        self.count: dict[str, int] = {}
        self._thread = threading.get_ident()
        self._inner: list[list[float]] = []

    def run(self, name: str, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Call a function as a stage."""
        if threading.get_ident() != self._thread:
            return function(*arguments, **named)
        self._inner.append([0.0, 0.0])
        cpu_s, wall_s = time.thread_time(), time.perf_counter()
        try:
            return function(*arguments, **named)
        finally:
            cpu_s, wall_s = time.thread_time() - cpu_s, time.perf_counter() - wall_s
            inner_cpu_s, inner_wall_s = self._inner.pop()
            if self._inner:
                self._inner[-1][0] += cpu_s
                self._inner[-1][1] += wall_s
            self.cpu_s[name] = self.cpu_s.get(name, 0.0) + cpu_s - inner_cpu_s
            self.wall_s[name] = self.wall_s.get(name, 0.0) + wall_s - inner_wall_s
            self.count[name] = self.count.get(name, 0) + 1


def methods() -> list[tuple[str, type, str]]:
    """Return stage, class and name of each timed method; raises AttributeError if one does not exist."""
    found = []
    for stage, places in STAGES.items():
        for place in places:
            module, _, path = place.partition(":")
            owner, _, name = path.partition(".")
            kind = getattr(import_module(module), owner)
            getattr(kind, name)
            found.append((stage, kind, name))
    return found


def measure(path: Path, settled_s: float, measured_s: float) -> None:
    """Time this process for `measured_s` from `settled_s` on [wall s], and write the figures to a file."""
    clock = StageClock()
    _name_threads()
    for stage, kind, name in methods():
        _time(clock, stage, kind, name)
    _time_callbacks(clock)

    def write() -> None:
        time.sleep(settled_s)
        before, threads = _snapshot(clock), _threads_s()
        began_s = time.perf_counter()
        time.sleep(measured_s)
        after, lasted_s = _snapshot(clock), time.perf_counter() - began_s
        stages = {
            name: [new - old for new, old in zip(row, before.get(name, (0,) * 3), strict=True)]
            for name, row in after.items()
        }
        spent = {name: cpu_s - threads.get(name, 0.0) for name, cpu_s in _threads_s().items()}
        path.write_text(json.dumps({"lasted_s": lasted_s, "stages": stages, "threads": spent}), encoding="utf-8")

    threading.Thread(target=write, name="measurement", daemon=True).start()


def _snapshot(clock: StageClock) -> dict[str, tuple[float, float, float]]:
    return {name: (clock.cpu_s[name], clock.wall_s[name], clock.count[name]) for name in list(clock.count)}


def _time(clock: StageClock, stage: str, kind: type, name: str) -> None:
    method = getattr(kind, name)

    @wraps(method)
    def timed(*arguments: Any, **named: Any) -> Any:
        return clock.run(stage, method, *arguments, **named)

    setattr(kind, name, timed)


def _time_callbacks(clock: StageClock) -> None:
    run = asyncio.Handle._run

    def timed(handle: asyncio.Handle) -> None:
        clock.run(_stage(handle), run, handle)

    asyncio.Handle._run = timed  # type: ignore[method-assign, assignment]


def _stage(handle: asyncio.Handle) -> str:
    """Return the name of a handle's work: the module of a callback, or the coroutine of a task."""
    callback: Any = handle._callback  # type: ignore[attr-defined]
    task = getattr(callback, "__self__", None)
    if isinstance(task, asyncio.Task):
        code = getattr(task.get_coro(), "cr_code", None)
        return f"task {getattr(code, 'co_qualname', '')}"
    module = getattr(callback, "__module__", None) or type(callback).__module__
    return "telemetry" if module in ("gcs.link.feed", "gcs.link.self_reports") else f"callback {module}"


def _name_threads() -> None:
    """Set the operating system's name of each Python thread."""
    library = ctypes.CDLL(None)
    begin = threading.Thread._bootstrap_inner  # type: ignore[attr-defined]

    def named(thread: threading.Thread) -> None:
        name = next((group for prefix, group in THREADS if thread.name.startswith(prefix)), thread.name)
        library.prctl(_SET_NAME, name[:_NAME_BYTES].encode(), 0, 0, 0)
        begin(thread)

    threading.Thread._bootstrap_inner = named  # type: ignore[attr-defined]


def _threads_s() -> dict[str, float]:
    """Return the processor time by name of thread; the event loop is that of the main thread."""
    process, spent = Path("/proc/self"), dict[str, float]()
    for task in (process / "task").iterdir():
        try:
            nanoseconds = int((task / "schedstat").read_text().split()[0])
            name = (task / "comm").read_text().strip()
        except (OSError, IndexError):
            continue
        group = "event loop" if int(task.name) == threading.main_thread().native_id else name.split("-")[0]
        spent[group] = spent.get(group, 0.0) + nanoseconds * 1e-9
    return spent
