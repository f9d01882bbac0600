"""Benchmark: measure the computing time of the control loop, relative to a reference of the same run.

The reference is one predict and update of filterpy's own `KalmanFilter` with six states and four measurements: Python
and numpy like the loop, so that the ratio is comparable between computers. It is measured repeatedly during a mission,
because the speed of a shared computer varies.
"""

from statistics import median
from time import perf_counter, sleep

import numpy as np
from filterpy.kalman import KalmanFilter

from gcs.flight.simulated import fly_simulated
from gcs.metrics.record import FlightRecord
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.experiments.arguments import parser
from tests.experiments.membership_scenes import alone_on_the_ring, sixteen

REFERENCE_EVERY, REFERENCE_RUNS = 100, 100
LARGE_TEAM_S = 120.0
PAUSES_S, PAUSED_FLIGHT_S = (0.0, 0.002, 0.016), 60.0


class Reference:
    """Measures the reference periodically in a flight."""

    def __init__(self) -> None:
        self._kalman = KalmanFilter(dim_x=6, dim_z=4)
        self._kalman.H = np.eye(4, 6)
        self._measured = np.zeros((4, 1))
        self._calls = 0
        self._times_us: list[float] = []

    def __call__(self, _now_s: float) -> None:
        """Take the end of a tick, as a simulation's `progress`."""
        self._calls += 1
        if self._calls % REFERENCE_EVERY == 0:
            self._times_us += [self._run_us() for _ in range(REFERENCE_RUNS)]

    def _run_us(self) -> float:
        began = perf_counter()
        self._kalman.predict()
        self._kalman.update(self._measured)
        return (perf_counter() - began) * 1e6

    @property
    def us(self) -> float:
        """The median time of the reference."""
        return median(self._times_us)


class PausedReference(Reference):
    """Measures the reference once after each tick; it sleeps before that, and before the next tick."""

    def __init__(self, pause_s: float) -> None:
        super().__init__()
        self._pause_s = pause_s

    def __call__(self, _now_s: float) -> None:
        sleep(self._pause_s)
        self._times_us.append(self._run_us())
        sleep(self._pause_s)


def _tick_us(record: FlightRecord) -> float:
    return float(np.median(record.loop.tick_us))


def print_tick(name: str, mission: Mission, duration_s: float) -> None:
    """Fly in simulation, and print the time of a core per period: messages, telemetry and the tick."""
    reference = Reference()
    record = fly_simulated(mission, 0, duration_s, reference)
    tick_us, speed = _tick_us(record), record.time_s[-1] / record.wall_time_s
    print(
        f"{name}: tick {tick_us:.0f} us = {tick_us / reference.us:.2f} references of {reference.us:.1f} us; "
        f"{speed:.0f} times real time"
    )


def print_pauses() -> None:
    """Print the time of a tick after a pause, with cold processor caches, as in flight."""
    mission = alone_on_the_ring(0).mission
    for pause_s in PAUSES_S:
        reference = PausedReference(pause_s)
        took_us = _tick_us(fly_simulated(mission, 0, PAUSED_FLIGHT_S, reference))
        print(
            f"alone on a ring, {pause_s * 1e3:g} ms of sleep before each: tick {took_us:.0f} us = "
            f"{took_us / reference.us:.2f} references of {reference.us:.0f} us"
        )


def main() -> None:
    """Fly each bundled mission in simulation, and print the time of a tick."""
    for name in ("case1", "case2", "case2-field"):
        mission = load_mission(name)
        print_tick(name, mission, mission.mission.duration_s)
    print_tick("16 vehicles on a ring of 40 m", sixteen(0).mission, LARGE_TEAM_S)
    print_pauses()


if __name__ == "__main__":
    parser("benchmark", __doc__).parse_args()
    main()
