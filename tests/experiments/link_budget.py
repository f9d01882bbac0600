"""Compare the planned and the actual traffic of a shared radio in flight, at several rates.

Three stubs fly px4-trio's mission behind one emulated line, which counts bytes. In the last row cordon chooses the
rates, on a line of 38400 baud; they may change in flight, and are not checked.
"""

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from agents.shell.clock import WallClock
from gcs.flight.stubs import stub_configs
from gcs.link.config import link_paces
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.radio.emulation import Emulation, run
from gcs.radio.serving import free_ports, mission_radio
from sitl.radio import RadioSpec
from sitl.server.process import StubProcess
from tests.experiments.arguments import parser, positive
from tests.support.mission_text import Content, content, drop, put, text_of
from tests.support.paths import MISSIONS
from tests.support.wire import cordon

RADIO = RadioSpec(latency_ms=60.0, loss=0.02, shared=True)
STARTED = "formation: start"
"""The event of each agent at the begin of the mission."""
APART_S = 5.0
"""The counting begins this long after the mission's begin, and ends this long before its end."""
ROWS: tuple[tuple[int, dict[str, object]], ...] = (
    (115200, {"telemetry_rate_hz": 20.0, "status_rate_hz": 2.0}),
    (115200, {"telemetry_rate_hz": 10.0, "status_rate_hz": 1.0, "setpoint_rate_hz": 10.0}),
    (57600, {"telemetry_rate_hz": 8.0, "status_rate_hz": 0.5, "setpoint_rate_hz": 8.0}),
    (38400, {"rates": "auto"}),
)
OFF_MAX = 0.1
"""The tolerance between counted and planned bytes, as a share, at rates from the mission."""
COLUMNS = ("baud", "motion, status, setpoints", "up: planned", "counted", "down: planned", "counted", "radius errors")


@dataclass(frozen=True, slots=True)
class Counted:
    """The traffic of the line [bytes/s], and the result of the flight."""

    up_bytes_s: float
    down_bytes_s: float
    result: dict[str, Any]


def on_one_line(line: Path, baud: int, link: dict[str, object]) -> Content:
    """Return px4-trio with all vehicles on one line."""
    mission = put(content((MISSIONS / "px4-trio.toml").read_text()), ("link",), link)
    mission = put(mission, ("links", "line"), {"url": f"serial://{line}:{baud}"})
    for index in range(len(mission["vehicles"])):
        mission = put(drop(mission, ("vehicles", index, "url")), ("vehicles", index, "link"), "line")
    return mission


@contextmanager
def radio(mission: Mission, baud: int) -> Iterator[Emulation]:
    """Serve the mission's stubs behind the line."""
    ports, ended = free_ports(mission), threading.Event()
    configs = [replace(each, parameters={"COM_OBL_RC_ACT": 4}) for each in stub_configs(mission, ports)]
    stubs = StubProcess(configs, partial(WallClock, 1.0))
    stubs.start()
    (emulation,) = mission_radio(RADIO.model_copy(update={"baud": baud}), mission, ports)
    thread = threading.Thread(target=run, args=([emulation], ended.is_set, lambda: None))
    thread.start()
    try:
        yield emulation
    finally:
        ended.set()
        thread.join()
        emulation.close()
        stubs.stop()


def counted(path: Path, baud: int, duration_s: float) -> Counted:
    """Fly, and count the bytes on the line in flight."""
    with (
        radio(load_mission(str(path)), baud) as emulation,
        cordon("fly", str(path), "--duration", f"{duration_s:g}", "--json", "--no-log") as flight,
    ):
        _await_start(flight)
        time.sleep(APART_S)
        before, began_s = _bytes(emulation), time.monotonic()
        time.sleep(duration_s - 2.0 * APART_S)
        up, down = (after - earlier for after, earlier in zip(_bytes(emulation), before, strict=True))
        took_s = time.monotonic() - began_s
        out, err = flight.communicate(timeout=600.0)
    if not out:
        raise SystemExit(err)
    return Counted(up / took_s, down / took_s, json.loads(out))


def _await_start(flight: subprocess.Popen[str]) -> None:
    """Read the flight's messages up to the start of its mission."""
    said: list[str] = []
    for line in flight.stderr or ():
        said.append(line)
        if STARTED in line:
            return
    raise SystemExit(f"The flight ended before its mission began:\n{''.join(said)}")


def _bytes(emulation: Emulation) -> tuple[int, int]:
    return sum(each.sent_bytes for each in emulation.up), sum(each.sent_bytes for each in emulation.down)


def main(arguments: Sequence[str] = sys.argv[1:]) -> int:
    """Print the table."""
    reader = parser("link_budget", __doc__ or "")
    reader.add_argument("--duration", type=positive, default=90.0, help="seconds of each flight (default: %(default)s)")
    options, holds = reader.parse_args(arguments), True
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    with tempfile.TemporaryDirectory() as folder:
        for baud, link in ROWS:
            path, line = Path(folder, "mission.toml"), Path(folder, "line")
            path.write_text(text_of(on_one_line(line, baud, link)))
            (pace,) = link_paces(load_mission(str(path)), truth=True).values()
            flown = counted(path, baud, options.duration)
            rates, planned = pace.rates, pace.load
            off = (flown.up_bytes_s / planned.up_bytes_s - 1.0, flown.down_bytes_s / planned.down_bytes_s - 1.0)
            chosen = link.get("rates") == "auto"
            holds = holds and (chosen or max(map(abs, off)) <= OFF_MAX)
            radii = ", ".join(f"{each['radius_error_rms_m'] or 0.0:.3f}" for each in flown.result["vehicles"])
            cells = (
                f"{baud}{' auto' if chosen else ''}",
                f"{rates.telemetry_hz:.3g}, {rates.status_hz:.3g}, {rates.setpoint_hz:.3g} Hz",
                f"{planned.up_bytes_s:.0f}",
                f"{flown.up_bytes_s:.0f} ({off[0]:+.0%})",
                f"{planned.down_bytes_s:.0f}",
                f"{flown.down_bytes_s:.0f} ({off[1]:+.0%})",
                f"{radii} m",
            )
            print(f"| {' | '.join(cells)} |", flush=True)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
