"""What the control loop costs, against a reference measured in the same run: `python -m tests.benchmark`.

The reference is one predict and update of filterpy's own `KalmanFilter` with six states and four measurements: pure
Python and numpy like the loop itself, so that the ratio says more than microseconds on an unknown machine.
"""

from statistics import median
from time import perf_counter

import numpy as np
from filterpy.kalman import KalmanFilter

from gcs.mission_file import load_mission
from gcs.simulated import fly_simulated

REFERENCE_RUNS = 5000


def reference_us() -> float:
    """Return the median time of the reference."""
    kalman = KalmanFilter(dim_x=6, dim_z=4)
    kalman.H = np.eye(4, 6)
    measured = np.zeros((4, 1))
    times = []
    for _ in range(REFERENCE_RUNS):
        began = perf_counter()
        kalman.predict()
        kalman.update(measured)
        times.append((perf_counter() - began) * 1e6)
    return median(times)


def main() -> None:
    """Fly each bundled mission in simulation, and print what a tick costs: telemetry, estimates, decision, plan."""
    reference = reference_us()
    print(f"reference: {reference:.1f} us")
    for name in ("case1", "case2", "case2-field"):
        mission = load_mission(name)
        record = fly_simulated(mission, 0, mission.mission.duration_s, lambda _: None)
        tick = float(np.median(record.loop.tick_us))
        speed = record.time_s[-1] / record.wall_time_s
        print(f"{name}: tick {tick:.0f} us = {tick / reference:.2f} references; {speed:.0f} times real time")


if __name__ == "__main__":
    main()
