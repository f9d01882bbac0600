"""The flights of both planners, and their measurements."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from time import process_time
from unittest.mock import patch

import numpy as np

from agents.control.lmpc import QpStatus
from agents.control.plan import Plan, TaskPlanner
from agents.control.planner import Planner
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.situation.task import Task
from agents.tactics import Tactic
from estimation.state import Vector
from gcs.flight.simulated import fly_simulated
from gcs.metrics.metrics import evaluate
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import formation_reference, ring_reference, verdict_tolerances
from gcs.metrics.result import FlightResult
from gcs.metrics.ring_motion import RingMotion, ring_motion
from gcs.metrics.vehicles import engagement_times_s
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from sitl.vehicle.imperfections import Imperfections
from tests.experiments.controllers.nmpc import Nmpc
from tests.experiments.plant_family import drawn

LMPC, NMPC = "LMPC + FL", "NMPC"
FAMILY = "plant family"


@dataclass(frozen=True)
class Course:
    """The duration of a scene, the begin of its evaluation, and its seeds."""

    duration_s: float
    from_s: float
    seeds: Sequence[int]


COURSES = {
    "case1": Course(240.0, 160.0, (0,)),
    "case2": Course(400.0, 315.0, (0,)),
    "case2-field": Course(400.0, 315.0, (0, 1, 2)),
    "case3-turns": Course(160.0, 40.0, (0, 1, 2)),
}
"""The bundled missions, evaluated from 30 s after the last engagement; missions without noise have one seed."""
FAMILY_S, FAMILY_FROM_S = 120.0, 60.0


def family(count: int, first: int) -> Course:
    """Return the course of a number of draws of the plant family."""
    return Course(FAMILY_S, FAMILY_FROM_S, range(first, first + count))


@dataclass(frozen=True)
class Job:
    """One flight by one planner: of a bundled mission, or of a draw of the plant family."""

    scene: str
    seed: int
    planner: str
    duration_s: float
    from_s: float


@dataclass
class Stopwatch:
    """The processor time of each plan on the ring, in all threads [s], and the number of unsolved plans."""

    took_s: list[float] = field(default_factory=list)
    unsolved: int = 0

    def time(self, plan: Callable[[], Plan | None]) -> Plan | None:
        """Return a plan, timed."""
        began = process_time()
        found = plan()
        self.took_s.append(process_time() - began)
        self.unsolved += found is not None and found.qp is QpStatus.FALLBACK
        return found


class TimedNmpc:
    """The NMPC, timed on the ring."""

    def __init__(self, config: AgentConfig, watch: Stopwatch) -> None:
        self._nmpc, self._watch = Nmpc(config), watch

    def plan(self, task: Task) -> Plan | None:
        """See `TaskPlanner`."""
        if task.tactic is not Tactic.ENCIRCLE:
            return self._nmpc.plan(task)
        return self._watch.time(lambda: self._nmpc.plan(task))


@dataclass(frozen=True)
class Outcome:
    """The measurements of one flight: rms errors of all vehicles on the ring over the evaluated time.

    `rate_off` is the mean rate's error as a share of the rate, of the worst vehicle. `settled_s` is the time from the
    last engagement until the ring is first within its limits for ten seconds. None does not apply, or never occurred.
    """

    job: Job
    radius_m: float
    strayed_m: float
    rate_rad_s: float
    rate_off: float
    spacing_deg: float | None
    closest_m: float | None
    settled_s: float | None
    on_ring: bool
    took_s: Vector
    unsolved: int
    time_s: Vector
    motion: RingMotion


def flown(job: Job) -> Outcome:
    """Fly a job and measure it."""
    mission, imperfections = _scene(job)
    watch = Stopwatch()
    factory: Callable[[AgentConfig], TaskPlanner] | None = None
    timing = nullcontext() if job.planner == NMPC else patch.object(Planner, "_encircle", _timed_encircle(watch))
    if job.planner == NMPC:

        def factory(config: AgentConfig) -> TaskPlanner:
            return TimedNmpc(config, watch)

    with timing:
        record = fly_simulated(
            mission, job.seed, job.duration_s, lambda _: None, planner=factory, imperfections=imperfections
        )
    return _measured(job, mission, record, watch)


def _scene(job: Job) -> tuple[Mission, Mapping[int, Imperfections] | None]:
    if job.scene != FAMILY:
        return load_mission(job.scene), None
    draw = drawn(job.seed, linear=False)
    return draw.mission, {vehicle_id: each.imperfections for vehicle_id, each in draw.family.items()}


def _timed_encircle(watch: Stopwatch) -> Callable[[Planner, Situation], Plan | None]:
    encircle = Planner._encircle
    return lambda planner, situation: watch.time(lambda: encircle(planner, situation))


def _measured(job: Job, mission: Mission, record: FlightRecord, watch: Stopwatch) -> Outcome:
    ring = ring_reference(mission)
    result = evaluate(record, ring, formation_reference(mission), verdict_tolerances(mission))
    motion, late = ring_motion(record), record.time_s >= job.from_s
    engaged = [time_s is not None for time_s in engagement_times_s(record)]
    radius_m = (motion.radius_m[engaged] - ring.radius_m)[:, late]
    rate_rad_s = (motion.rate_rad_s[engaged] - ring.angular_rate_rad_s)[:, late]
    spacing_rad = (motion.lead_rad - motion.desired_spacing_rad)[:, late]
    spacing_rad = spacing_rad[np.isfinite(spacing_rad)]
    bearings_rad = np.unwrap(motion.bearing_rad[engaged][:, late], axis=1)
    # The slope of the bearing: the difference of its ends would include their noise.
    rates_rad_s = np.polyfit(record.time_s[late], bearings_rad.T, 1)[0]
    return Outcome(
        job,
        _rms(radius_m),
        float(np.abs(radius_m).max()),
        _rms(rate_rad_s),
        float(np.abs(rates_rad_s / ring.angular_rate_rad_s - 1.0).max()),
        float(np.degrees(_rms(spacing_rad))) if spacing_rad.size else None,
        result.closest_approach_m,
        _settled_s(result),
        all(track.tactic[-1] == "encircle" for track, each in zip(record.vehicles, engaged, strict=True) if each),
        np.array(watch.took_s),
        watch.unsolved,
        record.time_s,
        motion,
    )


def _settled_s(result: FlightResult) -> float | None:
    """Return the time from the last engagement until the ring had first settled."""
    ring, engaged_s = result.ring, [each.engaged_at_s for each in result.vehicles if each.engaged_at_s is not None]
    if ring.first_settled_at_s is None or not engaged_s:
        return ring.settling_time_s
    return ring.first_settled_at_s - max(engaged_s)


def _rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values**2)))
