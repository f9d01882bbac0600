"""Measure the computing time of an encirclement plan, compared with the same plan by do-mpc, cvxpy and CasADi.

All plan the bundled mission case2: three vehicles, horizon 8, the same bounds and weights. Only the solver in place of
cordon's LMPC differs (planner_solvers.py); references, bounds and feedback linearisation are cordon's for all and are
part of a plan's time, set-up is not. Times are processor times of all threads, which other work on the computer affects
little.

First, each plans for the same random approaches to the ring, flown by cordon's plans at 10 Hz, some with active bounds.
The planners take turns, approach by approach. All but qrqp start warm from their previous solution; the first plan of
an approach has none, and is not timed. The solvers of the same quadratic programmes are compared with the optimum of an
interior-point method; the numbers of unsolved and wrong plans are printed. do-mpc solves another problem, the polar
model. Second, each flies a team of three, and the errors on the ring have to be small.
"""

import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from math import atan2, nan, pi, tau
from statistics import median
from time import process_time
from typing import NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np

from agents.control.encirclement import Approach, EncirclementPlanner, RingTask, ring_lmpc
from agents.control.lmpc import Bounds, QpStatus, Solution, Solver
from agents.ring.feasibility import Orbit
from agents.ring.place import ring_place, spacing_errors_rad
from agents.ring.reference import RingPoint, RingReference, RingWay
from agents.ring.transition import ShapedCoordinate
from agents.settings.config import AgentConfig
from estimation.plant.model import exact_step
from estimation.polar import Polar, motion_from_polar, polar_from_motion
from estimation.state import POSITION, VELOCITY, Vector
from gcs.mission.file import load_mission
from tests.experiments.arguments import seeded_parser
from tests.experiments.planner_solvers import OPTIMUM, RIVALS, Rival

APPROACHES = 25
TICKS, PERIOD_S = 40, 0.1
CORDON = Rival("cordon", "agents.control.encirclement", ring_lmpc)
ERROR_MAX_M_S2 = 5e-3
"""Tolerance of the first planned acceleration, 1/400 of a vehicle's limit. A plan with a larger error is wrong."""
FAILED_MAX = 0.1
"""The largest share of a rival's unsolved or wrong plans; rivals above it are not compared. cordon's must be 0."""
TEAM_S, TEAM_WINDOW_S = 60.0, 20.0
RADIUS_ERROR_MAX_M, SPACING_ERROR_MAX_DEG = 0.05, 0.5
TEAM = 3
IMPORTS = 3
TABLE_HEAD = (
    "| solver | median, µs | 99 %, µs | ratio | inside, µs | on bounds, µs | import, s "
    "| unsolved | wrong | off at most, m/s² | radius error, mm | spacing error, ° |",
    "|---" * 12 + "|",
)


@dataclass
class Plans:
    """The results of one planner: the times of its timed plans [us], the number of plans, and of unsolved ones."""

    took_us: list[float] = field(default_factory=list)
    planned: int = 0
    unsolved: int = 0


class Programme(NamedTuple):
    """The arguments of `Lmpc.solve`."""

    state: Vector
    reference: Vector
    previous_input: Vector
    bounds: Bounds


class Recorder:
    """cordon's LMPC, which records its programmes."""

    def __init__(self, config: AgentConfig) -> None:
        self._lmpc = ring_lmpc(config.encirclement)
        self.programmes: list[Programme] = []

    def solve(self, state: Vector, reference: Vector, previous_input: Vector, bounds: Bounds) -> Solution:
        """See `Lmpc.solve`."""
        kept = Bounds(bounds.inputs.copy(), bounds.states.copy())
        self.programmes.append(Programme(state.copy(), reference.copy(), previous_input.copy(), kept))
        return self._lmpc.solve(state, reference, previous_input, bounds)


@dataclass(frozen=True)
class Draw:
    """One vehicle's approach: its tasks in turn, their programmes, and whether bounds are active in them."""

    tasks: Sequence[RingTask]
    programmes: Sequence[Programme]
    bounded: Sequence[bool]


@dataclass(frozen=True)
class RingErrors:
    """The rms errors of a team on its ring."""

    radius_m: float
    spacing_deg: float


def ring_config() -> AgentConfig:
    """Return the configuration of a vehicle of case2."""
    mission = load_mission("case2")
    return mission.agent_config(mission.vehicles[0])


def planner_of(rival: Rival, config: AgentConfig) -> EncirclementPlanner:
    """Return cordon's planner with a rival's solver."""
    return EncirclementPlanner(config, rival.build(config.encirclement))


def approach(config: AgentConfig, seed: int) -> Draw:
    """Draw a vehicle near the ring, its neighbours and its target, and fly it to the ring by cordon's plans.

    Its reference is on the ring from the beginning, midway between the neighbours, so that bounds are active.
    """
    random, ring = np.random.default_rng(seed), config.encirclement
    orbit = Orbit(ring.radius_m, ring.angular_rate_rad_s)
    radius_m, bearing_rad = random.uniform(0.5, 2.5) * ring.radius_m, random.uniform(-pi, pi)
    speeds_m_s = random.uniform(-1.5, 1.5, 2)
    lead_rad, lag_rad = random.uniform(1.2 * config.clearance_rad, pi, 2)
    target = np.concatenate([random.uniform(-50.0, 50.0, 2), random.uniform(-0.3, 0.3, 2)])
    wind_m_s2 = random.uniform(-0.2, 0.2, 2)
    motion = motion_from_polar(Polar(radius_m, bearing_rad, speeds_m_s[0], speeds_m_s[1] / radius_m), target)
    recorder, step = Recorder(config), exact_step(config.plant, PERIOD_S)
    planner = EncirclementPlanner(config, recorder)
    tasks, bounded = [], []
    for tick in range(TICKS):
        polar = polar_from_motion(motion, target)
        turned_rad = bearing_rad + orbit.angular_rate_rad_s * tick * PERIOD_S
        place = ring_place(polar.bearing_rad, (turned_rad + lead_rad, turned_rad - lag_rad))
        middle = ShapedCoordinate(turned_rad + (lead_rad - lag_rad) / 2.0, orbit.angular_rate_rad_s)
        point = RingPoint(ShapedCoordinate(orbit.radius_m, 0.0), middle, tick * PERIOD_S)
        tasks.append(RingTask(motion, target, polar, wind_m_s2, place, orbit, orbit.radius_m, point))
        plan = planner.plan(tasks[-1])
        bounded.append(plan.status is not QpStatus.INTERIOR)
        motion, target = step.advance(motion, plan.aim_m, wind_m_s2), _moved(target)
    return Draw(tasks, recorder.programmes, bounded)


def _moved(target: Vector) -> Vector:
    return np.concatenate([target[POSITION] + target[VELOCITY] * PERIOD_S, target[VELOCITY]])


def plan_all(planners: Mapping[str, EncirclementPlanner], draws: Sequence[Draw]) -> dict[str, Plans]:
    """Plan every approach with all planners, each time in another order."""
    names, plans = list(planners), {name: Plans() for name in planners}
    for number, draw in enumerate(draws):
        for place in range(len(names)):
            name = names[(place + number) % len(names)]
            _plan(planners[name], draw, plans[name])
    return plans


def _plan(planner: EncirclementPlanner, draw: Draw, plans: Plans) -> None:
    planner.reset()
    for tick, task in enumerate(draw.tasks):
        began = process_time()
        plan = planner.plan(task)
        took_us = (process_time() - began) * 1e6
        plans.planned += 1
        plans.unsolved += plan.status is QpStatus.FALLBACK
        if tick:
            plans.took_us.append(took_us)


def errors_m_s2(solver: Solver, programmes: Sequence[Programme], optima: Sequence[Vector]) -> Vector:
    """Return the errors of a solver's first inputs [r'' R phi''] from the optima (n,), NaN if unsolved."""
    found = [solver.solve(*programme) for programme in programmes]
    off_m_s2 = np.linalg.norm(np.array([solution.first_input for solution in found]) - optima, axis=1)
    off_m_s2[[solution.status is QpStatus.FALLBACK for solution in found]] = nan
    return np.asarray(off_m_s2, dtype=np.float64)


def team_errors(planners: Sequence[EncirclementPlanner], config: AgentConfig, seed: int) -> RingErrors:
    """Fly one vehicle per planner to the ring, and return the errors in the last part of the flight."""
    random, ring = np.random.default_rng(seed), config.encirclement
    step, orbit = exact_step(config.plant, PERIOD_S), Orbit(ring.radius_m, ring.angular_rate_rad_s)
    target = np.array([35.0, -5.0, 0.1, 0.0])
    starts = zip(
        random.uniform(0.8, 1.4, len(planners)), np.cumsum(random.uniform(0.6, 1.2, len(planners))), strict=True
    )
    motions = [motion_from_polar(Polar(ring.radius_m * far, at, 0.0, 0.0), target) for far, at in starts]
    references, wind_m_s2 = [RingReference(ring) for _ in planners], np.array([0.1, -0.05])
    track = []
    for planner in planners:
        planner.reset()
    for tick in range(round(TEAM_S / PERIOD_S)):
        polars, now_s = [polar_from_motion(motion, target) for motion in motions], tick * PERIOD_S
        bearings_rad = [
            reference.bearing_rad(polar, now_s) for reference, polar in zip(references, polars, strict=True)
        ]
        for number, planner in enumerate(planners):
            others = [polar.bearing_rad for other, polar in enumerate(polars) if other != number]
            errors_rad = spacing_errors_rad([bearings_rad[number], *bearings_rad[:number], *bearings_rad[number + 1 :]])
            polar, motion = polars[number], motions[number]
            point = references[number].advance(polar, RingWay(orbit, orbit.radius_m, errors_rad), now_s)
            place = ring_place(polar.bearing_rad, others)
            task = RingTask(motion, target, polar, wind_m_s2, place, orbit, orbit.radius_m, point)
            plan = planner.plan(task)
            assert plan.approach is Approach.ORBIT
            motions[number] = step.advance(motion, plan.aim_m, wind_m_s2)
        target = _moved(target)
        track.append([motion[POSITION] - target[POSITION] for motion in motions])
    return _errors(np.array(track[-round(TEAM_WINDOW_S / PERIOD_S) :]), orbit)


def _errors(away_m: Vector, orbit: Orbit) -> RingErrors:
    """Return the errors of positions (T, N, 2) about the target."""
    radii_m = np.linalg.norm(away_m, axis=2)
    bearings_rad = np.sort([[atan2(y, x) for x, y in row] for row in away_m], axis=1)
    gaps_rad = np.diff(np.column_stack([bearings_rad, bearings_rad[:, 0] + tau]), axis=1)
    spacing_rad = gaps_rad - tau / away_m.shape[1]
    return RingErrors(
        float(np.sqrt(np.mean((radii_m - orbit.radius_m) ** 2))), float(np.degrees(np.sqrt(np.mean(spacing_rad**2))))
    )


def import_s(module: str) -> float:
    """Return the import time of a module in a new process, with cached files."""
    program = f"import time; began = time.process_time(); import {module}; print(time.process_time() - began)"
    runs = (subprocess.run([sys.executable, "-c", program], check=True, capture_output=True) for _ in range(IMPORTS))
    return median(float(run.stdout.split()[-1]) for run in runs)


def missing(rivals: Sequence[Rival]) -> list[str]:
    """Return the modules that are not installed."""
    return sorted({rival.module for rival in rivals if find_spec(rival.module) is None})


@dataclass(frozen=True)
class Outcome:
    """The measurements of a solver.

    They are its plans, its errors from the optima (n,), NaN if unsolved (None: it solves another problem), and the
    errors of its team.
    """

    rival: Rival
    plans: Plans
    off_m_s2: Vector | None
    ring: RingErrors

    @property
    def unsolved(self) -> float:
        """The share of plans that it reports as failed."""
        if self.off_m_s2 is None:
            return self.plans.unsolved / self.plans.planned
        return float(np.isnan(self.off_m_s2).mean())

    @property
    def wrong(self) -> float:
        """The share of wrong plans that it reports as solved."""
        return 0.0 if self.off_m_s2 is None else float((self.off_m_s2 > ERROR_MAX_M_S2).mean())

    @property
    def faults(self) -> list[str]:
        """The reasons why it does not solve the problem."""
        name, ring, found = self.rival.name, self.ring, []
        if not self.unsolved + self.wrong <= (0.0 if self.rival is CORDON else FAILED_MAX):
            found.append(f"{name}: {self.unsolved:.1%} of the plans are unsolved, {self.wrong:.1%} wrong")
        if not ring.radius_m <= RADIUS_ERROR_MAX_M:
            found.append(f"{name}: radius error {ring.radius_m:.3g} m, at most {RADIUS_ERROR_MAX_M:g} m are allowed")
        if not ring.spacing_deg <= SPACING_ERROR_MAX_DEG:
            found.append(f"{name}: spacing error {ring.spacing_deg:.3g}°, at most {SPACING_ERROR_MAX_DEG:g}°")
        return found

    def row(self, ours: Plans, bounded: Vector) -> str:
        """Return its row of the table; `bounded` (n,) is which timed plans have active bounds."""
        took_us = np.array(self.plans.took_us)
        middle, most = np.percentile(took_us, [50.0, 99.0]).tolist()
        cells = [
            self.rival.name,
            f"{middle:.0f}",
            f"{most:.0f}",
            f"{middle / median(ours.took_us):.1f}",
            f"{np.median(took_us[np.logical_not(bounded)]):.0f}",
            f"{np.median(took_us[bounded]):.0f}",
            f"{import_s(self.rival.module):.2f}",
            f"{self.unsolved:.1%}",
            "-" if self.off_m_s2 is None else f"{self.wrong:.1%}",
            "-" if self.off_m_s2 is None else f"{np.fmax.reduce(self.off_m_s2):.0e}",
            f"{self.ring.radius_m * 1e3:.1f}",
            f"{self.ring.spacing_deg:.3f}",
        ]
        return f"| {' | '.join(cells)} |"


def measured(count: int, first: int, rivals: Sequence[Rival], truth: Rival) -> tuple[list[Outcome], Vector]:
    """Plan and fly with cordon's solver and the rivals'; return the outcomes, and the timed plans (n,) on bounds."""
    config = ring_config()
    draws = [approach(config, seed) for seed in range(first, first + count)]
    programmes = [programme for draw in draws for programme in draw.programmes]
    exact = truth.build(config.encirclement)
    optima = [exact.solve(*programme).first_input for programme in programmes]
    solvers = (CORDON, *rivals)
    plans = plan_all({each.name: planner_of(each, config) for each in solvers}, draws)
    outcomes = [
        Outcome(
            each,
            plans[each.name],
            None if each.nonlinear else errors_m_s2(each.build(config.encirclement), programmes, optima),
            team_errors([planner_of(each, config) for _ in range(TEAM)], config, first),
        )
        for each in solvers
    ]
    return outcomes, np.array([flag for draw in draws for flag in draw.bounded[1:]])


def main(count: int, first: int, rivals: Sequence[Rival] = RIVALS, truth: Rival = OPTIMUM) -> int:
    """Print the table of cordon's solver and the rivals', and return the exit code."""
    if absent := missing([*rivals, truth]):
        print(f"not installed: {', '.join(absent)}; install them by: pip install -e '.[rivals]'", file=sys.stderr)
        return 2
    with catch_warnings():
        simplefilter("ignore")  # do-mpc warns of unused extras, and of CasADi's next version
        outcomes, bounded = measured(count, first, rivals, truth)
    print(f"{len(bounded)} plans of {count} approaches; bounds are active in {bounded.mean():.0%} of them\n")
    print(*TABLE_HEAD, sep="\n")
    for outcome in outcomes:
        print(outcome.row(outcomes[0].plans, bounded))
    found = [fault for outcome in outcomes for fault in outcome.faults]
    for fault in found:
        print(fault, file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    given = seeded_parser("planner_rivals", __doc__, APPROACHES).parse_args()
    sys.exit(main(given.count, given.first))
