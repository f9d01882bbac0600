"""Fly stubs of one mission at several speeds, with and without other programs, and compare what happens at which tick.

The missions are case2, case2-field and some drawn at random, seed by seed. Each flies with `cordon fly --sitl`. Its
events, of the first flight of its mission, are to come at the same ticks in all its others. Exit code 1 if one differs,
if a tick is missed, or if a verdict of the bundled missions does not hold.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.experiments.arguments import seeded_parser
from tests.experiments.random_missions import random_mission
from tests.support.paths import ROOT

BUNDLED = ("case2", "case2-field")
SPEEDS = ("10", "max")
SPINS = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000): pass
"""
"""It ends with its parent, also if that is killed."""


@dataclass(frozen=True)
class Flown:
    """The result of a flight: its JSON output, and the events by vehicle, tick and text."""

    code: int
    result: dict[str, Any]

    @property
    def events(self) -> list[tuple[int, int, str]]:
        """The events in the order of their ticks."""
        rate_hz = self.result["loop"]["rate_hz"]
        rows = [(row["vehicle"], round(row["time_s"] * rate_hz), row["text"]) for row in self.result["events"]]
        return sorted(rows, key=lambda row: (row[1], row[0], row[2]))

    @property
    def failing(self) -> list[str]:
        """The verdicts that do not hold."""
        return [name for name, holds in self.result["verdicts"].items() if not holds]


def missions(count: int, first: int, folder: Path) -> Iterator[str]:
    """Yield the names of the bundled missions and the files of those drawn."""
    yield from BUNDLED
    for seed in range(first, first + count):
        path = folder / f"random-{seed}.toml"
        path.write_text(random_mission(seed).text, encoding="utf-8")
        yield str(path)


@contextmanager
def busy(programs: int) -> Iterator[None]:
    """Run programs that compute without a pause."""
    running = [subprocess.Popen([sys.executable, "-c", SPINS], start_new_session=True) for _ in range(programs)]
    try:
        yield
    finally:
        for each in running:
            each.kill()
            each.wait()


def fly(mission: str, speed: str, load: int) -> Flown:
    """Fly a mission beside `load` programs that compute without a pause."""
    command = [sys.executable, "-m", "gcs", "fly", mission, "--sitl", "--speed", speed, "--json", "--no-log"]
    with busy(load):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if not done.stdout or "loop" not in (result := json.loads(done.stdout)):
        raise RuntimeError(f"{mission} did not fly:\n{done.stderr}")
    return Flown(done.returncode, result)


def main(count: int, first: int, loads: list[int]) -> int:
    """Fly all, print a table, and return the exit code."""
    well = True
    print(f"load of the computer over a minute before: {os.getloadavg()[0]:.1f}")
    print("| mission | speed | programs | reached | ticks | missed | verdicts | events | at other ticks |")
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    with TemporaryDirectory() as folder:
        for mission in missions(count, first, Path(folder)):
            reference: list[tuple[int, int, str]] | None = None
            for load in loads:
                for speed in SPEEDS:
                    flown = fly(mission, speed, load)
                    reference = flown.events if reference is None else reference
                    differing = sorted(set(reference) ^ set(flown.events))
                    loop, failing = flown.result["loop"], flown.failing
                    well &= not (differing or loop["missed"] or (failing and mission in BUNDLED))
                    row = (
                        Path(mission).stem,
                        speed,
                        load,
                        f"{flown.result['realtime_factor']:.1f}",
                        loop["ticks"],
                        loop["missed"],
                        ", ".join(failing) or "hold",
                        len(flown.events),
                        "; ".join(f"vehicle {i}, tick {tick}: {text}" for i, tick, text in differing) or "none",
                    )
                    print(f"| {' | '.join(map(str, row))} |", flush=True)
    return 0 if well else 1


if __name__ == "__main__":
    reader = seeded_parser("governed_flights", __doc__ or "", 3)
    reader.add_argument("--loads", type=int, nargs="*", default=[0, 4], help="other programs (default: 0 4)")
    chosen = reader.parse_args()
    sys.exit(main(chosen.count, chosen.first, chosen.loads))
