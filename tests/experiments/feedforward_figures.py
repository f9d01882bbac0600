"""Measure the contribution of velocity feed-forward on plants that differ from their files.

Flies case2 with vehicles whose true a0 and a1 are up to 30 % off their plant file, without and with velocities, each
with and without the disturbance estimate; and with vehicles whose feed-forward gain is lower than their file's, or 0.
Prints the ring's true errors over the last minute, and fails if with velocities a mean radius error exceeds 5 mm, or
the rate differs from the file's by more than 0.1 %.
"""

import sys
from itertools import product

import numpy as np

from gcs.flight.simulated import fly_simulated
from tests.experiments.arguments import parser
from tests.support.mission_text import content, parsed, put

PLANTS = ((1.0, 1.0), *product((0.7, 1.3), repeat=2))
"""Shares of a0 and a1."""
LAST_S = 60.0
BIAS_MAX_M, RATE_MAX = 0.005, 0.001


def flown(plant: str, a0: float, a1: float, gain: float = 1.0, *, estimates: bool = True) -> tuple[float, float, float]:
    """Fly case2; return the rms and mean error of the radius [m], and the relative error of the rate."""
    told: dict[str, object] = {"profile": plant, "true_scale": {"a0": a0, "a1": a1, "feedforward": gain}}
    mission = content()
    for index, (key, value) in product(range(3), told.items()):
        mission = put(mission, ("vehicles", index, key), value)
    if not estimates:
        mission = put(mission, ("own_filter",), {"disturbance_max_m_s2": 0.0})
    ready = parsed(mission)
    record = fly_simulated(ready, 0, ready.mission.duration_s, lambda _: None)
    late, ring = record.time_s >= record.time_s[-1] - LAST_S, ready.encirclement
    errors_m, turned_rad = [], []
    for track in record.vehicles:
        x, y = (track.position_m - record.target_position_m)[late].T
        errors_m.append(np.hypot(x, y) - ring.radius_m)
        angle = np.unwrap(np.arctan2(y, x))
        turned_rad.append(angle[-1] - angle[0])
    error_m = np.concatenate(errors_m)
    rate = float(np.mean(turned_rad)) / LAST_S / ring.angular_rate_rad_s - 1.0
    return float(np.sqrt(np.mean(error_m**2))), float(np.mean(error_m)), rate


def main() -> int:
    """Fly, print, and return the exit code."""
    holds = True
    for estimates in (True, False):
        print(f"{'with' if estimates else 'without'} the disturbance estimate: radius rms, mean [mm], rate [%]")
        usual = 0.0
        for a0, a1 in PLANTS:
            line = f"a0 x {a0:.1f}, a1 x {a1:.1f}:"
            for plant, kind in (("stub", "setpoints"), ("stub-feedforward", "with velocities")):
                rms_m, bias_m, rate = flown(plant, a0, a1, estimates=estimates)
                line += f"  {kind} {1000 * rms_m:6.1f} {1000 * bias_m:+6.1f} {100 * rate:+6.2f}"
                usual = rate if (a0, a1) == PLANTS[0] else usual
                if plant == "stub-feedforward" and estimates:
                    holds = holds and abs(bias_m) < BIAS_MAX_M and abs(rate - usual) < RATE_MAX
            print(line, flush=True)
    for gain in (0.7, 0.0):
        rms_m, bias_m, rate = flown("stub-feedforward", 1.0, 1.0, gain)
        print(f"feeds {gain:.1f} of what its file says: {1000 * rms_m:.1f} {1000 * bias_m:+.1f} {100 * rate:+.2f}")
    print("holds" if holds else "DOES NOT HOLD")
    return 0 if holds else 1


if __name__ == "__main__":
    parser("feedforward_figures", __doc__).parse_args()
    sys.exit(main())
