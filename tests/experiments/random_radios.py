"""Simulate the links of teams over random radios: each is to stay well, or to be refused before take-off.

A seed determines a radio: data rate, delay, jitter, losses and how many in a row, and whether three vehicles share it.
The links are simulated without sockets, in simulated time: rates, queue, losses and silences. Exit code 1 if a link
that is not refused falls silent for so long that a vehicle leaves offboard or holds.
"""

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np

from sitl.radio import RadioSpec
from tests.experiments.arguments import parser
from tests.support.simulated_link import SimulatedLink

VEHICLES = 3
BAUDS = (19200, 38400, 57600, 115200)
FLEW, REFUSED = "flew well", "refused"


def drawn(seed: int) -> RadioSpec:
    """Draw a radio; those of odd seeds are shared."""
    random = np.random.default_rng(seed)
    return RadioSpec(
        baud=int(random.choice(BAUDS)),
        latency_ms=round(float(random.uniform(20.0, 200.0))),
        jitter_ms=round(float(random.uniform(0.0, 60.0))),
        loss=round(float(random.uniform(0.0, 0.1)), 3),
        burst=round(float(random.uniform(1.0, 6.0)), 1),
        shared=seed % 2 == 1,
        seed=100 * seed,
    )


@dataclass(frozen=True)
class Flown:
    """How the flight of a team's links over a radio went; `warnings` counts those of its links."""

    seed: int
    spec: RadioSpec
    outcome: str
    detail: str = ""
    warnings: int = 0

    def __str__(self) -> str:
        radio = self.spec
        line = "shared" if radio.shared else "own"
        return (
            f"| {self.seed} | {radio.baud} | {line} | {radio.latency_ms:.0f} + {radio.jitter_ms:.0f} |"
            f" {radio.loss:.1%} | {radio.burst:g} | {self.outcome} | {self.warnings} | {self.detail} |"
        )


def simulated(seed: int, spec: RadioSpec, duration_s: float) -> Flown:
    """Simulate the links of a team."""
    shares = [(spec, VEHICLES)]
    if not spec.shared:
        shares = [(spec.model_copy(update={"seed": spec.seed + number}), 1) for number in range(VEHICLES)]
    links = [SimulatedLink(*share) for share in shares]
    if refusals := list(filter(None, (link.check() for link in links))):
        return Flown(seed, spec, REFUSED, refusals[0])
    silences = [link.fly(duration_s) for link in links]
    offboard, motion = sum(len(each.offboard_s) for each in silences), sum(len(each.motion_s) for each in silences)
    warnings = sum(len(link.faults) for link in links)
    outcome = "left offboard" if offboard else "stopped" if motion else FLEW
    detail = f"{offboard} silences of setpoints, {motion} of motion" if outcome != FLEW else ""
    return Flown(seed, spec, outcome, detail, warnings=warnings)


def main(count: int, first: int, duration_s: float) -> int:
    """Simulate the links of a number of teams, and print the table."""
    print("| seed | baud | line | delay, ms | lost | in a row | outcome | warnings | |")
    print(f"{'|---' * 9}|", flush=True)
    outcomes = Counter[str]()
    for seed in range(first, first + count):
        team = simulated(seed, drawn(seed), duration_s)
        outcomes[team.outcome] += 1
        print(team, flush=True)
    for outcome, number in outcomes.most_common():
        print(f"{number} of {count}: {outcome}")
    return 0 if set(outcomes) <= {FLEW, REFUSED} else 1


if __name__ == "__main__":
    reader = parser("random_radios", __doc__)
    reader.add_argument("count", nargs="?", type=int, default=100, help="number of radios (default: %(default)s)")
    reader.add_argument("--seed", type=int, default=0, help="first seed (default: %(default)s)")
    reader.add_argument("--duration", type=float, default=90.0, help="mission duration, s (default: %(default)s)")
    given = reader.parse_args()
    sys.exit(main(given.count, given.seed, given.duration))
