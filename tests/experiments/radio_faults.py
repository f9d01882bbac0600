"""Disturb the serial line of one vehicle on a ring, and check that the others fly on.

Three stubs fly px4-trio's mission, each behind an emulated line of 57600 baud. Once all are on the ring, the line of
vehicle 2 carries half of its traffic, becomes noisy, disappears for some time, or its autopilot restarts. Fails if the
others leave the ring or violate a separation.
"""

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from agents.shell.clock import WallClock
from gcs.flight.stubs import stub_configs
from gcs.link.config import link_paces
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.radio.emulation import Emulation, run
from gcs.radio.serving import free_ports as stub_ports
from gcs.radio.serving import mission_radio
from sitl.radio import BITS_A_BYTE, RadioSpec
from sitl.server.process import StubProcess
from tests.experiments.arguments import parser, positive
from tests.support.mission_text import content, put, text_of
from tests.support.paths import MISSIONS
from tests.support.wire import cordon, free_ports

BAUD, FAULTY = 57600, 2
RADIO = RadioSpec(baud=BAUD, latency_ms=60.0)
NOISE = 0.01
"""The share of bytes with a flipped bit, which damages a third of the frames."""
AWAY_S = 12.0
FAULT_AFTER_S = 75.0
"""Time after the mission's start, when all have settled on the ring."""
RADIUS_ERROR_MAX_M = 0.3


class Lines:
    """A line for each vehicle of a team, with the stubs behind them; lines change between two cycles of the radios."""

    def __init__(self, mission: Mission) -> None:
        self._mission, self._ports = mission, stub_ports(mission)
        configs = [replace(each, parameters={"COM_OBL_RC_ACT": 5}) for each in stub_configs(mission, self._ports)]
        self._stubs = {config.vehicle_id: StubProcess([config], partial(WallClock, 1.0)) for config in configs}
        self._emulations = mission_radio(RADIO, mission, self._ports)
        self._pending: list[Callable[[], object]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=run, args=(self._emulations, self._ended.is_set, self._make_changes))

    @contextmanager
    def served(self) -> Iterator[None]:
        """Serve the stubs behind their lines."""
        for stubs in self._stubs.values():
            stubs.start()
        self._thread.start()
        try:
            yield
        finally:
            self._ended.set()
            self._thread.join()
            for emulation in self._emulations:
                emulation.close()
            for stubs in self._stubs.values():
                stubs.stop()

    def replace_line(self, spec: RadioSpec | None) -> None:
        """Replace the faulty vehicle's radio, None to remove the device."""
        self._pending.append(lambda: self._replace(spec))

    def restart(self) -> None:
        """Restart the faulty vehicle's autopilot."""
        self._stubs[FAULTY].stop()
        (config,) = (each for each in stub_configs(self._mission, self._ports) if each.vehicle_id == FAULTY)
        self._stubs[FAULTY] = StubProcess([config], partial(WallClock, 1.0))
        self._stubs[FAULTY].start()

    def _make_changes(self) -> None:
        while self._pending:
            self._pending.pop()()

    def _replace(self, spec: RadioSpec | None) -> None:
        place = f"udpin://127.0.0.1:{self._ports[FAULTY]}"
        for emulation in [each for each in self._emulations if place in each.places]:
            emulation.close()
            self._emulations.remove(emulation)
        if spec is not None:
            url = self._mission.vehicle(FAULTY).section.url
            line = f"pty:{url.removeprefix('serial://').rpartition(':')[0]}"
            self._emulations.append(Emulation(spec, line, [place]))


def half(lines: Lines, mission: Mission) -> None:
    """Reduce the line's capacity to half of its traffic."""
    asked = link_paces(mission)[mission.vehicle(FAULTY).section.url].load
    most_bytes_s = max(asked.up_bytes_s, asked.down_bytes_s)
    lines.replace_line(RADIO.model_copy(update={"baud": round(BITS_A_BYTE * most_bytes_s / 2.0)}))


def noisy(lines: Lines, mission: Mission) -> None:
    """Flip bits."""
    lines.replace_line(RADIO.model_copy(update={"noise": NOISE}))


def vanishing(lines: Lines, mission: Mission) -> None:
    """Remove the serial device, and restore it."""
    lines.replace_line(None)
    time.sleep(AWAY_S)
    lines.replace_line(RADIO)


def restarting(lines: Lines, mission: Mission) -> None:
    """Restart the autopilot: the vehicle falls."""
    lines.restart()


FAULTS = {fault.__name__: fault for fault in (half, noisy, vanishing, restarting)}


def mission_text(folder: Path) -> str:
    """Return px4-trio with each vehicle on its own line."""
    mission = put(content((MISSIONS / "px4-trio.toml").read_text(encoding="utf-8")), ("network",), {"team": "lines"})
    for index, port in enumerate(free_ports(len(mission["vehicles"]))):
        mission = put(mission, ("vehicles", index, "url"), f"serial://{folder}/line{index + 1}:{BAUD}")
        mission = put(mission, ("vehicles", index, "endpoint"), f"tcp/127.0.0.1:{port}")
    return text_of(mission)


def flown(path: Path, fault: Callable[[Lines, Mission], None], duration_s: float) -> tuple[dict[str, Any], list[str]]:
    """Fly with a fault; return the result, and the lines on the terminal since."""
    mission = load_mission(str(path))
    lines, said = Lines(mission), list[str]()
    with (
        lines.served(),
        cordon("fly", str(path), "--duration", f"{duration_s:g}", "--json", "--no-log") as flight,
    ):
        reader = threading.Thread(target=_read, args=(flight, said))
        reader.start()
        _await(lambda: any("formation: start" in each for each in said), 90.0, said)
        time.sleep(FAULT_AFTER_S)
        before = len(said)
        fault(lines, mission)
        out = (flight.stdout.read() if flight.stdout else "") or "{}"
        reader.join()
    result = json.loads(out)
    if "vehicles" not in result:
        raise SystemExit("\n".join(said))
    return result, said[before:]


def _read(flight: "subprocess.Popen[str]", said: list[str]) -> None:
    said.extend(line.rstrip() for line in flight.stderr or ())


def _await(condition: Callable[[], bool], within_s: float, said: Sequence[str]) -> None:
    end_s = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > end_s:
            raise SystemExit("\n".join(said))
        time.sleep(0.2)


def fly_on(result: dict[str, Any], separation_m: float) -> bool:
    """Return whether the other vehicles stayed on the ring, and all kept the separation."""
    others = [each for each in result["vehicles"] if each["id"] != FAULTY]
    errors_m = [each["radius_error_rms_m"] for each in others]
    on_ring = all(error_m is not None and error_m <= RADIUS_ERROR_MAX_M for error_m in errors_m)
    return on_ring and result["closest_approach_m"] >= separation_m


def main(arguments: Sequence[str] = sys.argv[1:]) -> int:
    """Fly once with each fault, and print the reports and the effects."""
    reader = parser("radio_faults", __doc__ or "")
    reader.add_argument("--duration", type=positive, default=150.0, help="seconds of a flight (default: %(default)s)")
    reader.add_argument(
        "faults", nargs="*", choices=[[], *FAULTS], metavar="FAULT", help=f"{', '.join(FAULTS)} (default: all)"
    )
    options, holds = reader.parse_args(arguments), True
    for fault in [FAULTS[name] for name in options.faults or FAULTS]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "mission.toml")
            path.write_text(mission_text(Path(folder)), encoding="utf-8")
            result, said = flown(path, fault, options.duration)
            goes_on = fly_on(result, load_mission(str(path)).safety.separation_m)
        radii = ", ".join(f"{each['id']}: {each['radius_error_rms_m']}" for each in result["vehicles"])
        print(f"## {fault.__name__}", *(f"    {each}" for each in said if not each.startswith("t=")), sep="\n")
        print(
            f"{result['ended']['reason']} Radius errors {radii} m, closest approach {result['closest_approach_m']} m."
        )
        print("the others fly on" if goes_on else "THE OTHERS DO NOT FLY ON", flush=True)
        holds = holds and goes_on
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
