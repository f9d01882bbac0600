"""Profile flights of stub vehicles: processor by process, thread and stage, lateness of ticks, memory, start-up.

Each flight is `cordon fly` with default settings, recorded, of stubs on the wall's clock (`cordon sitl`), as of real
vehicles. With `--sitl` it starts its stubs itself, and its clock waits for them: no tick is late, and start-up includes
that of the stubs. With `--speed 0.5` vehicles fly at half the wall's speed: the computer has twice the time for
everything, as one that is twice as fast. Cores and memory are those of its processes: the supervisor, the flying
process and the log's; the process of the stubs has a separate column. The stages are measured in a separate flight,
because the measurement takes time.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import psutil

from agents.inputs import Tick
from gcs.flight.supervisor import is_supervised
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Cost
from gcs.link.ports import free_ports
from tests.experiments.arguments import parser
from tests.support.paths import ROOT, finds_tests
from tests.support.ring_mission import ring_mission

INSIDE = "--inside"
RATE_HZ = 20.0
ROUNDING = 1e-4
"""Of a period: a governed clock counts microseconds."""
SETTLED_S = 5.0
"""The time from the first tick in control to the measurement of the stages."""

CORDON = ("supervisor", "flying", "log")
PROGRAMS = {"sitl.server.program": "stubs", "log_program": "log"}
"""Parts of the command lines of the flying process's children."""
COLUMNS = (
    "vehicles",
    "cores",
    "stubs' cores",
    "missed",
    "late p50, ms",
    "late p99, ms",
    "tick, us",
    "memory, MB",
    "start-up, s",
    "log, MB",
)


@dataclass
class Usage:
    """A process's processor seconds and memory [MB] at the last sample."""

    cpu_s: float = 0.0
    memory_mb: float = 0.0


@dataclass(frozen=True)
class Profile:
    """One flight: cores and memory of all its processes except the stubs'; times are wall seconds."""

    vehicles: int
    cores: float
    stub_cores: float
    memory_mb: float
    missed: int
    ticks: int
    late_p50_ms: float
    late_p99_ms: float
    tick_p50_us: float
    start_up_s: float
    log_mb: float
    inside: Mapping[str, Any]

    def row(self) -> str:
        """Return the row of the table."""
        share = self.missed / max(self.missed + self.ticks, 1)
        return (
            f"| {self.vehicles} | {self.cores:.2f} | {self.stub_cores:.2f} | {share:.2%} | {self.late_p50_ms:.1f} |"
            f" {self.late_p99_ms:.1f} | {self.tick_p50_us:.0f} | {self.memory_mb:.0f} |"
            f" {self.start_up_s:.1f} | {self.log_mb:.1f} |"
        )


def profile(
    vehicles: int, duration_s: float, stages: Path | None = None, *, sitl: bool = False, speed: float = 1.0
) -> Profile:
    """Fly a team and return its profile, with the stages of its event loop if a file for them is given.

    With `sitl` the flight starts its stubs itself, on a governed clock. It lasts `duration_s` of the mission, whose
    clock runs at `speed` times the wall's.
    """
    with TemporaryDirectory() as folder, ExitStack() as stack:
        mission, log = Path(folder, "ring.toml"), Path(folder, "flight.mcap")
        ports = free_ports(2 * vehicles)
        mission.write_text(ring_mission(vehicles, duration_s, ports[:vehicles], ports[vehicles:]), encoding="utf-8")
        options = [
            "fly",
            str(mission),
            "--speed",
            f"{speed:g}",
            "--json",
            "--log",
            str(log),
            *(["--sitl"] if sitl else []),
        ]
        stubs = None if sitl else stack.enter_context(stub_program(mission, speed))
        inside = [] if stages is None else [INSIDE, str(stages), str(duration_s / speed)]
        program = "gcs" if stages is None else "tests.experiments.flight_profile"
        began_s = time.time()
        output, supervisor_log = Path(folder, "result.json"), Path(folder, "messages.txt")
        with output.open("wb") as result, supervisor_log.open("wb") as messages:
            command = [sys.executable, "-m", program, *inside, *options]
            flight = subprocess.Popen(
                command, cwd=ROOT, env=finds_tests() if inside else None, stdout=result, stderr=messages
            )
            usage, cores = followed(flight, stubs)
        if not output.read_bytes():
            raise RuntimeError(f"the flight of {vehicles} vehicles failed:\n{supervisor_log.read_text()}")
        loop = json.loads(output.read_bytes())["loop"]
        flown = read_log(log)
        late_ms = np.concatenate([lateness_ms(flown, each) for each in flown.vehicles]) / speed
        return Profile(
            vehicles,
            sum(cores[name] for name in CORDON),
            cores["stubs"],
            sum(usage[name].memory_mb for name in CORDON),
            loop["missed"],
            loop["ticks"],
            float(np.percentile(late_ms, 50)),
            float(np.percentile(late_ms, 99)),
            loop["tick_p50_us"],
            min(next(flown.of_kind(each, Tick)).now_s for each in flown.vehicles) / speed - began_s,
            log.stat().st_size / 1e6,
            {} if stages is None else json.loads(stages.read_text(encoding="utf-8")),
        )


def lateness_ms(log: FlightLog, vehicle_id: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the lateness of a vehicle's ticks in control [ms]; each vehicle has its own grid of deadlines."""
    in_control = {cost.time_s for cost in log.of_kind(vehicle_id, Cost)}
    times_s = np.array([tick.now_s for tick in log.of_kind(vehicle_id, Tick) if tick.now_s in in_control])
    phase = sorted(log.vehicles).index(vehicle_id) / len(log.vehicles)
    return ((times_s * RATE_HZ - phase + ROUNDING) % 1.0 - ROUNDING) / RATE_HZ * 1e3


@contextmanager
def stub_program(mission: Path, speed: float) -> Iterator[psutil.Process]:
    """Serve the stubs of a mission on the wall's clock in a process of their own, until the context ends."""
    command = [sys.executable, "-m", "gcs", "sitl", str(mission), "--speed", f"{speed:g}"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as program:
        try:
            assert program.stdout is not None
            program.stdout.readline()  # they are about to be reached
            yield psutil.Process(program.pid)
        finally:
            program.terminate()
            program.communicate()


def followed(
    flight: "subprocess.Popen[bytes]", stubs: psutil.Process | None
) -> tuple[dict[str, Usage], dict[str, float]]:
    """Monitor the processes of a flight to its end; return usage and processor time per second in flight of each.

    `stubs` is the process of stubs that it did not start.
    """
    beside = [] if stubs is None else [("stubs", stubs)]
    usage = {name: Usage() for name in (*CORDON, "stubs")}
    looks: list[tuple[float, dict[str, float]]] = []
    while flight.poll() is None:
        for name, process in (*beside, *processes(flight.pid)):
            try:
                with process.oneshot():
                    times, memory = process.cpu_times(), process.memory_info().rss / 1e6
                    usage[name] = Usage(times.user + times.system, max(memory, usage[name].memory_mb))
            except psutil.Error:
                continue
        looks.append((time.monotonic(), {name: each.cpu_s for name, each in usage.items()}))
        time.sleep(0.5)
    # The middle of the flight, without start-up and computation of the result.
    first, last = looks[len(looks) // 2], looks[len(looks) * 4 // 5]
    lasted_s = max(last[0] - first[0], 1e-3)
    return usage, {name: (last[1][name] - first[1][name]) / lasted_s for name in usage}


def processes(root: int) -> Iterator[tuple[str, psutil.Process]]:
    """Yield the processes of a flight by name."""
    try:
        supervisor = psutil.Process(root)
        yield "supervisor", supervisor
        for flying in supervisor.children():
            yield "flying", flying
            for child in flying.children():
                command = " ".join(child.cmdline())
                yield from ((name, child) for program, name in PROGRAMS.items() if program in command)
    except psutil.Error:
        return


def stage_table(inside: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of the tables of threads and stages."""
    lasted_s = inside["lasted_s"]
    yield "\n| thread | cores |\n|---|---|"
    for name, cpu_s in sorted(inside["threads"].items(), key=lambda each: -each[1]):
        if cpu_s / lasted_s >= 0.001:
            yield f"| {name} | {cpu_s / lasted_s:.3f} |"
    yield "\n| in the event loop | a second | cores | us each | waits, us each |\n|---|---|---|---|---|"
    for name, (cpu_s, wall_s, count) in sorted(inside["stages"].items(), key=lambda each: -each[1][0]):
        if count and cpu_s / lasted_s >= 0.0005:
            waits_us = max(wall_s - cpu_s, 0.0) / count * 1e6
            yield (
                f"| {name} | {count / lasted_s:.0f} | {cpu_s / lasted_s:.3f} | {cpu_s / count * 1e6:.0f} |"
                f" {waits_us:.0f} |"
            )


def inside(path: str, duration_s: str, *arguments: str) -> None:
    """Run `cordon`, with measurement in the flying process."""
    from gcs.cli import main as cordon

    if is_supervised():
        from tests.support.loop_stages import measure

        measure(Path(path), 12.0 + SETTLED_S, max(float(duration_s) - 2.0 * SETTLED_S, SETTLED_S))
    sys.argv = ["cordon", *arguments]
    cordon()


def main() -> None:
    """Fly teams of the given sizes and print their profiles."""
    reader = parser("flight_profile", __doc__ or "")
    sizes = [3, 8, 16, 32, 64]
    reader.add_argument("vehicles", nargs="*", type=int, default=sizes, help=f"team sizes (default: {sizes})")
    reader.add_argument("--duration", type=float, default=60.0, help="mission duration, s (default: %(default)s)")
    reader.add_argument("--sitl", action="store_true", help="let each flight start its stubs, on a clock that waits")
    reader.add_argument("--speed", type=float, default=1.0, help="of the wall's speed (default: %(default)g)")
    reader.add_argument("--stages", action="store_true", help="fly each once more and print its threads and stages")
    chosen = reader.parse_args()
    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|", flush=True)
    for count in chosen.vehicles:
        print(profile(count, chosen.duration, sitl=chosen.sitl, speed=chosen.speed).row(), flush=True)
    for count in chosen.vehicles if chosen.stages else ():
        with TemporaryDirectory() as folder:
            stages = Path(folder, "stages.json")
            measured = profile(count, chosen.duration, stages, sitl=chosen.sitl, speed=chosen.speed).inside
        print(f"\n{count} vehicles", *stage_table(measured), sep="\n", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == [INSIDE]:
        inside(*sys.argv[2:])
    else:
        main()
