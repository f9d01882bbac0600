"""Measure the computing time per vehicle in simulation, from 4 to 64 vehicles on one ring: a table, and a figure.

Each team starts a metre outside of its ring, 6 m apart. Teams take turns over several rounds, and the fastest round of
each is used, because the speed of a shared computer varies. The time of a core per period includes messages, telemetry,
sightings and the tick; the rest is the simulation's. All times are processor times, which other work affects least.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from unittest.mock import patch

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gcs.garbage import collect_rarely
from gcs.mission.mission import Mission
from gcs.style import COLOURS, INK, drawing
from sitl.simulation.simulation import NetworkModel
from tests.experiments.arguments import parser
from tests.experiments.benchmark import Reference
from tests.support.mission_text import parsed
from tests.support.observed_flight import observed
from tests.support.ring_mission import ring_mission

COUNTS = (4, 8, 16, 32, 64)
RATE_HZ = 20.0
ROUNDS, DURATION_S, SETTLED_S = 3, 20.0, 10.0
FACTOR_MAX = 1.5
"""The largest ratio of the time per vehicle between team sizes."""


def ring(count: int) -> Mission:
    """Return a mission of vehicles that encircle a target at rest from the start."""
    links, endpoints = (list(range(first, first + count)) for first in (14540, 7461))
    return parsed(tomllib.loads(ring_mission(count, DURATION_S, links, endpoints)))


@dataclass(frozen=True)
class Cost:
    """The time per vehicle and tick of a team of `count` [us], once it has settled."""

    count: int
    core_us: float
    around_us: float
    reference_us: float

    @property
    def whole_us(self) -> float:
        """The core and the simulation."""
        return self.core_us + self.around_us

    @property
    def real_time_factor(self) -> float:
        """The real-time factor of the whole team."""
        return 1e6 / (self.whole_us * self.count * RATE_HZ)


def measured(count: int) -> Cost:
    """Fly a team, and measure."""
    mission, reference, ticks_s = ring(count), Reference(), list[float]()
    began_s = process_time()

    def progress(now_s: float) -> None:
        nonlocal began_s
        ticks_s.append(process_time() - began_s)
        reference(now_s)
        began_s = process_time()

    with patch("sitl.simulation.simulation.perf_counter", process_time):
        flight = observed(mission, 0, duration_s=DURATION_S, network=NetworkModel(mission.range_m), progress=progress)
    settled = flight.time_s > SETTLED_S
    core_us = float(flight.tick_us[settled].mean())
    whole_us = float(np.array(ticks_s)[settled].mean()) * 1e6 / count
    return Cost(count, core_us, whole_us - core_us, reference.us)


def cheapest(counts: Sequence[int], rounds: int) -> list[Cost]:
    """Return the fastest of several rounds for each team, relative to the reference of the same flight."""
    costs = [[measured(count) for count in counts] for _ in range(rounds)]
    return [min(each, key=lambda cost: cost.whole_us / cost.reference_us) for each in zip(*costs, strict=True)]


def table(costs: Sequence[Cost]) -> str:
    """Return the figures as a table for the docs."""
    heads = "vehicles", "core [us]", "around it [us]", "whole, in references", "times real time at 20 Hz"
    rows = [
        (
            f"{cost.count}",
            f"{cost.core_us:.0f}",
            f"{cost.around_us:.1f}",
            f"{cost.whole_us / cost.reference_us:.1f}",
            f"{cost.real_time_factor:.1f}",
        )
        for cost in costs
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows))


def draw(costs: Sequence[Cost], path: Path) -> None:
    """Draw the time per vehicle over the team size."""
    count = [cost.count for cost in costs]
    with drawing():
        figure = Figure(figsize=(6.4, 3.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        axes.plot(count, [cost.whole_us for cost in costs], "o-", color=INK, label="whole")
        axes.plot(count, [cost.core_us for cost in costs], "o-", color=COLOURS[0], label="core")
        axes.plot(count, [cost.around_us for cost in costs], "o-", color=COLOURS[1], label="around it")
        axes.set_xscale("log", base=2)
        axes.set_xticks(count, [str(each) for each in count])
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("vehicles on one ring")
        axes.set_ylabel("cost of a vehicle and tick [µs]")
        axes.legend(frameon=False)
        figure.savefig(path, dpi=160)


def main() -> int:
    """Measure all teams, print the table and draw the figure; return 1 if the time per vehicle grows with the team."""
    reader = parser("scaling", __doc__)
    reader.add_argument("--rounds", type=int, default=ROUNDS, help="flights of each team (default: %(default)s)")
    reader.add_argument(
        "--counts", type=int, nargs="+", default=COUNTS, help="sizes of the teams (default: %(default)s)"
    )
    reader.add_argument("--plot", type=Path, help="figure to draw, such as docs/scaling.png")
    arguments = reader.parse_args()
    collect_rarely()  # as `cordon sim` does
    costs = cheapest(arguments.counts, arguments.rounds)
    print(table(costs))
    if arguments.plot is not None:
        draw(costs, arguments.plot)
    ratios = [cost.whole_us / cost.reference_us for cost in costs]
    print(f"dearest over cheapest: {max(ratios) / min(ratios):.2f} (at most {FACTOR_MAX})")
    return 0 if max(ratios) <= FACTOR_MAX * min(ratios) else 1


if __name__ == "__main__":
    raise SystemExit(main())
