"""All flights by both planners: flown on all cores, printed, drawn, and judged."""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import agents.control.planner
from tests.experiments.controllers.figures import draw
from tests.experiments.controllers.flights import COURSES, FAMILY, LMPC, NMPC, Course, Job, Outcome, family, flown
from tests.experiments.controllers.tables import PLANNERS, tables

UNSOLVED_MAX = {LMPC: 0.0, NMPC: 0.1}
"""The largest share of unsolved plans; with more failures a comparison with the NMPC is not fair."""


def flights(courses: dict[str, Course]) -> list[Outcome]:
    """Fly all courses by both planners on all cores, the longest flights first."""
    jobs = [
        Job(scene, seed, planner, course.duration_s, course.from_s)
        for planner in (NMPC, LMPC)
        for scene, course in courses.items()
        for seed in course.seeds
    ]
    outcomes = []
    with ProcessPoolExecutor() as pool:
        for number, outcome in enumerate(pool.map(flown, jobs), start=1):
            outcomes.append(outcome)
            print(f"\r{number} of {len(jobs)} flights", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return outcomes


def faults(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the failures of flights and plans."""
    found = [
        f"{each.job.planner} left the ring: {each.job.scene}, seed {each.job.seed}"
        for each in outcomes
        if not each.on_ring
    ]
    for planner in PLANNERS:
        mine = [each for each in outcomes if each.job.planner == planner]
        unsolved, plans = sum(each.unsolved for each in mine), sum(each.took_s.size for each in mine)
        if unsolved > UNSOLVED_MAX[planner] * plans:
            found.append(f"{planner}: {unsolved} of {plans} plans are not solved")
    return found


def main(count: int, first: int, scenes: Sequence[str], folder: Path | None) -> int:
    """Print the tables of both planners, draw the figures into a folder, and return the exit code."""
    if find_spec("casadi") is None:
        print("not installed: casadi; install it by: pip install -e '.[rivals]'", file=sys.stderr)
        return 2
    if not str(agents.control.planner.__file__).endswith(".py"):
        print(
            "cordon is compiled, so its plans cannot be timed: install its sources by: pip install -e '.[rivals]'",
            file=sys.stderr,
        )
        return 2
    courses = COURSES | {FAMILY: family(count, first)}
    outcomes = flights({scene: courses[scene] for scene in scenes})
    print(*tables(scenes, outcomes), sep="\n")
    if folder is not None:
        print(*draw(folder, outcomes), sep="\n", file=sys.stderr)
    found = faults(outcomes)
    print(*found, sep="\n", end="\n" if found else "", file=sys.stderr)
    return 1 if found else 0
