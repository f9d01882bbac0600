"""Benchmark: measure the computing time of the control loop, relative to a reference of the same run.

The reference is one predict and update of filterpy's own `KalmanFilter` with six states and four measurements: Python
and numpy like the loop, so that the ratio is comparable between computers. It is measured repeatedly during a mission,
because the speed of a shared computer varies.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import cos, pi, sin
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter, sleep
from typing import Any
from unittest.mock import patch

import numpy as np
from filterpy.kalman import KalmanFilter
from foxglove import Context

from agents.core import VehicleCore
from agents.safety.guard import Guard
from agents.safety.neighbours import Neighbours
from gcs.flight.simulated import fly_simulated
from gcs.flightlog.recorder import SimulationRecording
from gcs.flightlog.run import run_of
from gcs.flightlog.writer import LogWriter
from gcs.metrics.record import FlightRecord
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.viewer.scene import Scene
from tests.experiments.arguments import parser
from tests.experiments.membership_scenes import alone_on_the_ring, sixteen
from tests.support.mission_text import content, parsed
from tests.support.paths import MISSIONS

REFERENCE_EVERY, REFERENCE_RUNS = 100, 100
MEETING_S = 40.0
LARGE_TEAM_S = 120.0
PAIRS, PAIR_S = 7, 200.0
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


def meeting(count: int) -> Mission:
    """Return a mission like crossing in which vehicles on a circle swap places with the opposite ones."""
    mission = content((MISSIONS / "crossing.toml").read_text(encoding="utf-8"))
    radius_m = max(12.0, count * 5.0 / (2.0 * pi))
    turns = [2.0 * pi * number / count for number in range(count)]
    pattern = mission["vehicles"][0]
    mission["vehicles"] = [
        pattern
        | {
            "id": number + 1,
            "url": f"udpin://127.0.0.1:{14540 + number}",
            "endpoint": f"tcp/127.0.0.1:{7461 + number}",
            "start_m": [radius_m * cos(turn), radius_m * sin(turn)],
            "slot_m": [-radius_m * cos(turn), -radius_m * sin(turn)],
        }
        for number, turn in enumerate(turns)
    ]
    mission["formation"]["start_m"] = mission["vehicles"][0]["slot_m"]
    return parsed(mission)


class Stopwatch:
    """Sums the time of calls until it is read; nested calls must not both be timed."""

    def __init__(self) -> None:
        self._took_us = 0.0

    def timed(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return the timed call."""

        def timed_call(*arguments: Any) -> Any:
            began = perf_counter()
            made = call(*arguments)
            self._took_us += (perf_counter() - began) * 1e6
            return made

        return timed_call

    def read_us(self) -> float:
        """Return the time of the calls since the last reading [us]."""
        took_us, self._took_us = self._took_us, 0.0
        return took_us


@contextmanager
def guard_watched(told: Callable[[float, bool], None]) -> Iterator[None]:
    """Report the time of bodies and guard in every tick [us], and whether the guard intervened."""
    watch = Stopwatch()
    check = watch.timed(Guard.check)

    def told_check(*arguments: Any) -> Any:
        guarded = check(*arguments)
        told(watch.read_us(), bool(guarded.causes))
        return guarded

    with (
        patch.object(Guard, "check", told_check),
        patch.object(Neighbours, "near", watch.timed(Neighbours.near)),
        patch.object(Neighbours, "bodies", watch.timed(Neighbours.bodies)),
    ):
        yield


@contextmanager
def ticks_watched() -> Iterator[list[float]]:
    """Record the time of every tick [us], with the own sensor's sighting, as a live agent does."""
    watch, took_us = Stopwatch(), list[float]()
    tick = watch.timed(VehicleCore.tick)

    def noted_tick(*arguments: Any) -> Any:
        output = tick(*arguments)
        took_us.append(watch.read_us())
        return output

    with (
        patch.object(VehicleCore, "tick", noted_tick),
        patch.object(VehicleCore, "_take_sighting", watch.timed(VehicleCore._take_sighting)),
    ):
        yield took_us


def print_guard(count: int) -> None:
    """Fly vehicles that meet, and print the guard's time per vehicle and tick."""
    ticks: list[tuple[float, bool]] = []
    reference = Reference()
    with guard_watched(lambda us, intervened: ticks.append((us, intervened))):
        fly_simulated(meeting(count), 0, MEETING_S, reference)
    if not ticks:
        print(f"guard, {count} vehicles: not measured, because methods of compiled classes cannot be watched")
        return
    for what, times in (
        ("all ticks", [us for us, _ in ticks]),
        ("intervening", [us for us, intervened in ticks if intervened]),
    ):
        middle, most = np.percentile(times, [50.0, 99.0]).tolist()
        print(
            f"guard, {count} vehicles, {what} ({len(times)}): median {middle:.0f} us = {middle / reference.us:.2f} "
            f"references, 99 % {most:.0f} us"
        )


def print_recording() -> None:
    """Fly in pairs, one recorded, and print the time that recording adds to a tick and takes between ticks."""
    mission, plain, taped, written = load_mission("case2"), [], [], []
    reference = Reference()
    with TemporaryDirectory() as folder:
        for pair in range(PAIRS):
            plain.append(_tick_us(fly_simulated(mission, 0, PAIR_S, reference)))
            run = run_of(mission, mission.ids, seed=0, source="simulation", speed=1.0, began_s=0.0, duration_s=PAIR_S)
            path = Path(folder) / f"{pair}.mcap"
            context = Context()
            recording = TimedRecording(LogWriter(path, context, Scene(context, mission)), run)
            taped.append(_tick_us(fly_simulated(mission, 0, PAIR_S, lambda _: None, recording)))
            written.append(recording.took_us / (PAIR_S * mission.mission.rate_hz * len(mission.ids)))
        megabytes = path.stat().st_size / 1e6 * 600.0 / PAIR_S
    added = median(with_log - without for with_log, without in zip(taped, plain, strict=True))
    print(
        f"recording: adds {added:.1f} us = {added / reference.us:.2f} references to a tick of {median(plain):.0f} us; "
        f"writing takes {median(written):.0f} us a tick, beside the loop; {megabytes:.1f} MB in ten minutes of three"
    )


class TimedRecording(SimulationRecording):
    """A recording that measures its writing time."""

    took_us = 0.0

    def advance(self, now_s: float) -> None:
        began = perf_counter()
        super().advance(now_s)
        self.took_us += (perf_counter() - began) * 1e6


def _tick_us(record: FlightRecord) -> float:
    return float(np.median(record.loop.tick_us))


def print_tick(name: str, mission: Mission, duration_s: float) -> None:
    """Fly in simulation, and print the time of a core per period, and the tick's share."""
    reference = Reference()
    with ticks_watched() as alone_us:
        record = fly_simulated(mission, 0, duration_s, reference)
    alone, whole, speed = median(alone_us), _tick_us(record), record.time_s[-1] / record.wall_time_s
    print(
        f"{name}: tick {alone:.0f} us = {alone / reference.us:.2f} references of {reference.us:.1f} us, with messages "
        f"and telemetry since the one before {whole:.0f} us = {whole / reference.us:.2f}; {speed:.0f} times real time"
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
    for count in (3, 16):
        print_guard(count)
    print_recording()
    print_pauses()


if __name__ == "__main__":
    parser("benchmark", __doc__).parse_args()
    main()
