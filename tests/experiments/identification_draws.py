"""Identify random plants, and compare the results with the truth.

Draws plants within 50 % of the bundled ones and delays of 0 to 0.4 s, flies 150 s of random steps and a swept circle,
adds coloured noise of 0.05 to 0.3 m, logs setpoints at 5 or 20 Hz, and identifies. It fails if the 95 % intervals
contain the truth in less than 90 or more than 99 of 100 cases, or the median error at 0.05 m exceeds 2 %. With
`--feedforward` the setpoints of the circle are sent with their velocities, and plants have feed-forward gains of 0.7 to
1.2.
"""

import sys
from dataclasses import dataclass

import numpy as np

from estimation.identification.identified import Interval, ParameterEstimate
from estimation.identification.identify import identify
from estimation.plant.model import PlantGrade
from estimation.state import Vector
from tests.experiments.arguments import parser
from tests.support.synthetic_flights import Truth, recorded

SHIPPED = ((1.7, 1.8), (0.97, 1.33), (0.80, 0.87))
NOISES_M = (0.05, 0.1, 0.2, 0.3)
SETPOINTS_HZ = (5.0, 20.0)
NAMES = ("a0 x", "a1 x", "a0 y", "a1 y", "delay", "feed-forward")
FED_FROM, FED_TO = 0.7, 1.2


@dataclass(frozen=True)
class Draw:
    """One draw: its noise and rate, relative errors (k,) (the delay's in seconds), and covered truths (k,)."""

    noise_m: float
    setpoints_hz: float
    verdict: PlantGrade
    errors: Vector
    covered: Vector


def truth_of(seed: int, *, fed: bool = False) -> Truth:
    """Return the plant of a draw."""
    random = np.random.default_rng([7, seed])
    a0, a1 = SHIPPED[random.integers(len(SHIPPED))]
    x0, y0 = (a0 * random.uniform(0.5, 1.5, 2)).tolist()
    x1, y1 = (a1 * random.uniform(0.5, 1.5, 2)).tolist()
    delay_s = float(random.uniform(0.0, 0.4))
    return Truth((x0, y0), (x1, y1), delay_s, float(random.uniform(FED_FROM, FED_TO)) if fed else 0.0)


def drawn(seed: int, *, fed: bool = False) -> Draw:
    """Fly and identify one draw."""
    truth, noise_m, rate_hz = truth_of(seed, fed=fed), NOISES_M[seed % 4], SETPOINTS_HZ[seed // 4 % 2]
    memory_s = float(np.random.default_rng([8, seed]).uniform(0.3, 3.0))
    recording = recorded(truth, seed, noise_m=noise_m, memory_s=memory_s, setpoints_hz=rate_hz, fed=fed)
    identified = identify([recording])
    assert identified.found is not None
    intervals = intervals_of(identified.found)
    true = (truth.a0[0], truth.a1[0], truth.a0[1], truth.a1[1], truth.delay_s, *[truth.feedforward] * fed)
    errors = [each.value - value for each, value in zip(intervals, true, strict=True)]
    covered = np.array([each.low <= value <= each.high for each, value in zip(intervals, true, strict=True)])
    return Draw(noise_m, rate_hz, identified.verdict, np.array(errors) / (*true[:4], 1.0, *true[5:]), covered)


def intervals_of(found: ParameterEstimate) -> tuple[Interval, ...]:
    """Return the intervals in the order of NAMES."""
    x, y = found.axes
    fed = () if found.feedforward is None else (found.feedforward,)
    return x.a0_per_s2, x.a1_per_s, y.a0_per_s2, y.a1_per_s, found.delay_s, *fed


def main(count: int, *, fed: bool = False) -> int:
    """Draw, print the results, and return the exit code."""
    draws = []
    for seed in range(count):
        draws.append(draw := drawn(seed, fed=fed))
        print(
            f"{seed:3d} {draw.noise_m:.2f} m {draw.setpoints_hz:2.0f} Hz {draw.verdict.value:16}"
            f" errors {np.round(100 * draw.errors, 1)} covered {draw.covered.astype(int)}",
            flush=True,
        )
    covered = np.array([draw.covered for draw in draws])
    print(f"covered: {100 * covered.mean():.1f} % of all,", end=" ")
    print(", ".join(f"{name} {100 * share:.0f} %" for name, share in zip(NAMES, covered.mean(axis=0), strict=False)))
    for noise_m in NOISES_M:
        for rate_hz in SETPOINTS_HZ:
            some = [draw for draw in draws if (draw.noise_m, draw.setpoints_hz) == (noise_m, rate_hz)]
            if some:
                errors = np.abs([draw.errors for draw in some])
                print(
                    f"{noise_m:.2f} m, {rate_hz:2.0f} Hz: median error of a0 and a1"
                    f" {100 * np.median(errors[:, :4]):.2f} %, of the delay {np.median(errors[:, 4]):.3f} s;"
                    f" covered {100 * np.mean([draw.covered for draw in some]):.0f} %"
                    + (f"; of the feed-forward {100 * np.median(errors[:, 5]):.2f} %" if fed else "")
                )
    quiet = np.abs([draw.errors[:4] for draw in draws if draw.noise_m == NOISES_M[0]])
    median = float(np.median(quiet))
    holds = 0.90 <= covered.mean() <= 0.99 and median <= 0.02
    print(f"median error at 0.05 m: {100 * median:.2f} %; {'holds' if holds else 'DOES NOT HOLD'}")
    return 0 if holds else 1


if __name__ == "__main__":
    reader = parser("identification_draws", __doc__)
    reader.add_argument("count", nargs="?", type=int, default=100, help="number of draws (default: %(default)s)")
    reader.add_argument("--feedforward", action="store_true", help="send the velocities of the circle as well")
    given = reader.parse_args()
    sys.exit(main(given.count, fed=given.feedforward))
