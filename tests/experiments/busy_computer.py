"""Fly three PX4 simulators (CORDON_PX4) on a computer that other programs keep busy, with and without raised priority.

The other programs begin once the vehicles fly on their ring: they compute without a pause, at normal priority, each in
a session of its own. The simulators run at raised priority, as real vehicles do not depend on this computer. Without
raised priority, cordon runs without the capabilities for it (CAP_SYS_NICE, CAP_IPC_LOCK). At the end `cordon check`
judges this computer without raised priority: under the highest load, and while programs of real-time priority take all
processors for 0.3 s at a time. Raising the simulators needs root.
"""

import ctypes
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Cost
from gcs.mission.file import load_mission
from tests.experiments.arguments import parser
from tests.support.paths import ROOT, finds_tests
from tests.support.px4 import Px4Missing, Px4Simulator

MISSION, RATE_HZ = "px4-trio", 20.0
METRES_PER_DEGREE = 111_195.0
SETTLES_S = 25.0
ENGAGED_WITHIN_S = 120.0
ENDS_WITHIN_S = 120.0
SIMULATOR_PRIORITY = 3
PR_CAPBSET_DROP, CAP_IPC_LOCK, CAP_SYS_NICE = 24, 14, 23
WAITS_S = 60
SPINS = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000): pass
"""
"""It ends with its parent, also if that is killed."""
BURSTS = """
import os, time
parent = os.getppid()
os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(2))
while os.getppid() == parent:
    end_s = time.monotonic() + 0.3
    while time.monotonic() < end_s: pass
    time.sleep(0.3)
"""


@dataclass(frozen=True)
class Cell:
    """A flight: ticks in control and missed from the begin of the load on, longest period [ms], radius [m], its end."""

    load: int
    raised: bool
    ticks: int
    missed: int
    longest_ms: float
    radius_rms_m: float
    ended: str

    def row(self) -> str:
        """Return the row of the table."""
        priority = "raised" if self.raised else "normal"
        return (
            f"| {self.load} | {priority} | {self.ticks} | {self.missed} | {self.longest_ms:.0f} |"
            f" {self.radius_rms_m:.3f} | {self.ended} |"
        )


@contextmanager
def simulators() -> Iterator[None]:
    """Run the mission's three simulators, at raised priority."""
    with ExitStack() as stack:
        mission = load_mission(MISSION)
        frame = mission.frame
        for instance, vehicle in enumerate(mission.vehicles):
            north_m = vehicle.section.start_m[1]
            assert frame.latitude_deg is not None
            assert frame.longitude_deg is not None
            assert frame.altitude_m is not None
            place = (frame.latitude_deg + north_m / METRES_PER_DEGREE, frame.longitude_deg, frame.altitude_m)
            simulator = Px4Simulator(instance, speed=1.0, place=place, parameters={"COM_OBL_RC_ACT": 4.0})
            stack.callback(simulator.close)
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(SIMULATOR_PRIORITY))  # the simulator inherits it
            try:
                simulator.start()
            finally:
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        time.sleep(SETTLES_S)
        yield


@contextmanager
def busy(programs: int, text: str = SPINS) -> Iterator[None]:
    """Run programs, by default some that compute without a pause."""
    command = [sys.executable, "-c", text]
    running = [subprocess.Popen(command, start_new_session=True) for _ in range(programs)]
    try:
        yield
    finally:
        for each in running:
            each.kill()
            each.wait()


def cordon(*arguments: str, raised: bool) -> list[str]:
    """Return a command of cordon, which without `raised` gives up the capabilities to raise its priority first."""
    if raised:
        return [sys.executable, "-m", "gcs", *arguments]
    return [sys.executable, "-m", "tests.experiments.busy_computer", "--unraised", *arguments]


def environment(*, raised: bool) -> dict[str, str] | None:
    """Return the environment of such a command."""
    return None if raised else finds_tests()


def unraised(*arguments: str) -> None:
    """Become a command of cordon without these capabilities."""
    for capability in (CAP_SYS_NICE, CAP_IPC_LOCK):
        if ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability, 0, 0, 0) != 0:
            raise PermissionError("a capability cannot be dropped: run this as root")
    os.execv(sys.executable, [sys.executable, "-m", "gcs", *arguments])


def fly(load: int, duration_s: float, *, raised: bool) -> Cell:
    """Fly the mission, with other programs from the ring on."""
    with TemporaryDirectory() as folder, simulators():
        log, out, said = Path(folder, "flight.mcap"), Path(folder, "result.json"), Path(folder, "said.txt")
        options = ("fly", MISSION, "--json", "--duration", str(duration_s), "--log", str(log), "--wait", str(WAITS_S))
        with out.open("wb") as result, said.open("wb") as text:
            command = cordon(*options, raised=raised)
            flight = subprocess.Popen(
                command, cwd=ROOT, stdout=result, stderr=text, stdin=subprocess.DEVNULL, env=environment(raised=raised)
            )
            end_s = time.monotonic() + ENGAGED_WITHIN_S
            while said.read_text(encoding="utf-8").count("encircle: engage") < 3:
                if flight.poll() is not None or time.monotonic() > end_s:
                    flight.terminate()
                    raise RuntimeError(f"no ring:\n{said.read_text(encoding='utf-8')}")
                time.sleep(0.2)
            began_s = time.time()
            with busy(load):
                flight.wait(duration_s + ENDS_WITHIN_S)
        found = json.loads(out.read_text(encoding="utf-8"))
        return _cell(load, log, found, began_s, raised=raised)


def _cell(load: int, path: Path, found: dict[str, object], began_s: float, *, raised: bool) -> Cell:
    log = read_log(path)
    periods_s = np.concatenate(
        [
            np.diff([cost.time_s for cost in log.of_kind(vehicle, Cost) if cost.time_s >= began_s])
            for vehicle in log.vehicles
        ]
    )
    vehicles, ended = found.get("vehicles") or [], found["ended"]
    assert isinstance(vehicles, list)
    assert isinstance(ended, dict)
    squares = [each["radius_error_rms_m"] ** 2 for each in vehicles if each["radius_error_rms_m"] is not None]
    return Cell(
        load,
        raised,
        periods_s.size,
        int((np.round(periods_s * RATE_HZ) - 1.0).clip(0.0).sum()),
        float(1e3 * periods_s.max(initial=0.0)),
        float(np.sqrt(np.mean(squares))) if squares else float("nan"),
        str(ended["how"]),
    )


def checked(programs: int, text: str) -> str:
    """Return what `cordon check` says of this computer beside such programs, without raised priority."""
    with simulators(), busy(programs, text):
        done = subprocess.run(
            cordon("check", MISSION, "--json", raised=False),
            check=False,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment(raised=False),
        )
    findings: Sequence[dict[str, str]] = json.loads(done.stdout)["findings"]
    here = [each for each in findings if each["subject"] == "this computer"]
    return f"exit code {done.returncode}\n" + "\n".join(f"{each['grade']}: {each['found']}" for each in here)


def main() -> None:
    """Fly each load with and without raised priority."""
    reader = parser("busy_computer", __doc__ or "")
    reader.add_argument("--loads", nargs="*", type=int, default=[0, 4, 8], help="other programs (default: 0 4 8)")
    reader.add_argument("--duration", type=float, default=90.0, help="mission duration, s (default: %(default)s)")
    chosen = reader.parse_args()
    print(f"load of the computer over a minute before: {os.getloadavg()[0]:.1f}")
    print("| programs | priority | ticks | missed | longest period, ms | radius error rms, m | ended |", flush=True)
    print("|---|---|---|---|---|---|---|", flush=True)
    try:
        for load in chosen.loads:
            for raised in (False, True):
                print(fly(load, chosen.duration, raised=raised).row(), flush=True)
        print(f"check beside {max(chosen.loads)} programs: {checked(max(chosen.loads), SPINS)}", flush=True)
        cores = os.cpu_count() or 1
        print(f"check beside {cores} programs of real-time priority: {checked(cores, BURSTS)}", flush=True)
    except Px4Missing as missing:
        sys.exit(str(missing))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--unraised"]:
        unraised(*sys.argv[2:])
    main()
