"""The tables of both planners' flights."""

from collections.abc import Iterable, Sequence
from statistics import median

import numpy as np

from estimation.state import Vector
from tests.experiments.controllers.flights import FAMILY, LMPC, NMPC, Outcome

PLANNERS = (LMPC, NMPC)
_ERRORS = (
    "planner",
    "radius error, m",
    "at most, m",
    "rate error, mrad/s",
    "mean rate off, %",
    "spacing error, °",
    "closest, m",
    "settled after, s",
)
_SOLVES = ("planner", "plans", "median, ms", "99 %, ms", "not solved")
QUANTILES = (("median", 50.0), ("95 %", 95.0), ("worst", 100.0))


def flight_rows(scene: str, outcomes: Sequence[Outcome]) -> list[str]:
    """Return a mission's rows: medians over its seeds, and the worst of maxima and of the closest approach."""
    rows = []
    for planner in PLANNERS:
        mine = [each for each in outcomes if (each.job.scene, each.job.planner) == (scene, planner)]
        settled_s = [each.settled_s for each in mine if each.settled_s is not None]
        rows.append(
            _row(
                scene,
                planner,
                f"{median(each.radius_m for each in mine):.3f}",
                f"{max(each.strayed_m for each in mine):.2f}",
                f"{median(each.rate_rad_s for each in mine) * 1e3:.1f}",
                f"{median(each.rate_off for each in mine) * 1e2:.2f}",
                _or_none([each.spacing_deg for each in mine], "{:.2f}"),
                f"{_closest_m(mine):.2f}",
                f"{median(settled_s):.1f}" if settled_s else "-",
            )
        )
    return rows


def family_rows(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the family's rows: median, 95 % quantile and worst of the draws, for each figure separately."""
    rows = []
    for title, percent in QUANTILES:
        for planner in PLANNERS:
            mine = [each for each in outcomes if (each.job.scene, each.job.planner) == (FAMILY, planner)]
            spacings_deg = [each.spacing_deg for each in mine if each.spacing_deg is not None]
            closest_m = [each.closest_m for each in mine if each.closest_m is not None]
            # A draw that never settled is the latest.
            settled_s = [np.inf if each.settled_s is None else each.settled_s for each in mine]
            settled = _share(settled_s, percent)
            rows.append(
                _row(
                    title,
                    planner,
                    f"{_share([each.radius_m for each in mine], percent):.3f}",
                    f"{_share([each.strayed_m for each in mine], percent):.2f}",
                    f"{_share([each.rate_rad_s for each in mine], percent) * 1e3:.1f}",
                    f"{_share([each.rate_off for each in mine], percent) * 1e2:.2f}",
                    f"{_share(spacings_deg, percent):.2f}",
                    f"{_share(closest_m, 100.0 - percent):.2f}",
                    "never" if np.isinf(settled) else f"{settled:.1f}",
                )
            )
    return rows


def solve_rows(scene: str, outcomes: Sequence[Outcome]) -> list[str]:
    """Return the times of a scene's plans, and the number of unsolved ones."""
    rows = []
    for planner in PLANNERS:
        mine = [each for each in outcomes if (each.job.scene, each.job.planner) == (scene, planner)]
        took_ms = times_ms(mine)
        middle, most = np.percentile(took_ms, (50.0, 99.0)).tolist()
        unsolved = sum(each.unsolved for each in mine)
        rows.append(_row(scene, planner, str(took_ms.size), f"{middle:.3f}", f"{most:.3f}", str(unsolved)))
    return rows


def pairs_line(outcomes: Sequence[Outcome]) -> str:
    """Return a line with the number of draws in which each planner has the smaller errors."""
    by = {(each.job.seed, each.job.planner): each for each in outcomes if each.job.scene == FAMILY}
    seeds = sorted({seed for seed, _ in by})
    parts = []
    for name in ("radius_m", "rate_rad_s", "spacing_deg"):
        smaller = sum(getattr(by[seed, NMPC], name) < getattr(by[seed, LMPC], name) for seed in seeds)
        parts.append(f"{name.partition('_')[0]} in {smaller}")
    return f"NMPC has the smaller error of {', '.join(parts)} of {len(seeds)} draws"


def tables(scenes: Sequence[str], outcomes: Sequence[Outcome]) -> list[str]:
    """Return the lines of all tables: the missions' errors, those of the draws, and the times of the plans."""
    missions = [scene for scene in scenes if scene != FAMILY]
    lines = [*_head("mission", *_ERRORS), *(row for scene in missions for row in flight_rows(scene, outcomes))]
    if FAMILY in scenes:
        lines += ["", *_head("of the draws", *_ERRORS), *family_rows(outcomes), "", pairs_line(outcomes)]
    return [*lines, "", *_head("flights", *_SOLVES), *(row for scene in scenes for row in solve_rows(scene, outcomes))]


def times_ms(outcomes: Iterable[Outcome]) -> Vector:
    """Return the times of all plans of some flights (n,)."""
    return np.concatenate([each.took_s for each in outcomes]) * 1e3


def _closest_m(outcomes: Sequence[Outcome]) -> float:
    return min(each.closest_m for each in outcomes if each.closest_m is not None)


def _or_none(values: Sequence[float | None], form: str) -> str:
    known = [value for value in values if value is not None]
    return form.format(median(known)) if known else "-"


def _share(values: Sequence[float], percent: float) -> float:
    return float(np.percentile(values, percent, method="higher"))


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _head(*cells: str) -> tuple[str, str]:
    return _row(*cells), f"|{'---|' * len(cells)}"
