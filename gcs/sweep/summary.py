"""The summary of a sweep."""

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

from gcs.mission.overrides import override_text
from gcs.sweep.columns import PASS, Column, Row, failed_verdicts
from gcs.sweep.plan import PLANNER_PLACE, SweepPlan, SweepRun, counted


@dataclass(frozen=True, slots=True)
class WorstCase:
    """A run with its reasons: metrics whose worst value it has, verdicts that it does not pass, or its error."""

    reasons: tuple[str, ...]
    command: str


def worst_cases(
    plan: SweepPlan, rows: Mapping[int, Row], metrics: Iterable[Column], mission: str, most: int
) -> list[WorstCase]:
    """Return the worst run of each metric, the first `most` runs that do not pass, and one run for each error.

    A run is listed once, with all its reasons. `mission` is the mission of the commands.
    """
    runs = plan.runs
    worst_in: dict[int, list[str]] = {}
    for metric in metrics:
        known = {index: row[metric.name] for index, row in sorted(rows.items()) if metric.name in row}
        if metric.worst is not None and len({*known.values()}) > 1:
            index = (max if metric.worst == "max" else min)(known, key=known.__getitem__)
            worst_in.setdefault(index, []).append(f"{metric.name} ({known[index]:.4g})")
    not_passing = [index for index, row in sorted(rows.items()) if "error" not in row and row.get(PASS) is not True]
    not_passing.sort(key=lambda index: PASS not in rows[index])  # those that were not judged follow
    failed = {row["error"]: index for index, row in sorted(rows.items(), reverse=True) if "error" in row}
    chosen = dict.fromkeys([*worst_in, *not_passing[:most], *sorted(failed.values())])
    return [
        WorstCase((*_worst(worst_in.get(index, ())), *_faults(rows[index])), command(plan, runs[index], mission))
        for index in chosen
    ]


def command(plan: SweepPlan, run: SweepRun, mission: str) -> str:
    """Return the command that flies a run again."""
    values = {**plan.fixed, **run.values}
    words = [word for place, value in values.items() for word in ("--set", override_text(place, value))]
    duration = [] if plan.duration_s is None else ["--duration", str(plan.duration_s).removesuffix(".0")]
    named = values.get(PLANNER_PLACE, next(iter(plan.planners), ""))
    plugins = ["--allow-plugins"] if named in plan.planners else []
    return shlex.join(["cordon", "sim", mission, *words, "--seed", str(run.seed), *duration, *plugins])


def _worst(metrics: Sequence[str]) -> list[str]:
    return [f"worst in {', '.join(metrics)}"] if metrics else []


def _faults(row: Row) -> list[str]:
    failing = failed_verdicts(row)
    ended = f"ended early: {row.get('ended.reason', '')}" if row.get(PASS) is False and not failing else ""
    found = (
        f"fails: {', '.join(failing)}" if failing else ended,
        f"not judged: {row['not_judged']}" if "not_judged" in row else "",
        f"error: {row['error']}" if "error" in row else "",
    )
    return [each for each in found if each]


@dataclass(frozen=True, slots=True)
class SweepSummary:
    """Numbers of a sweep's `runs`: finished, that pass (`hold`), that do not, that could not be judged, and errors.

    `verdicts` counts runs by verdicts that fail, `errors` by the reasons of runs without a result (`failed`).
    """

    runs: int
    finished: int
    hold: int
    do_not_hold: int
    not_judged: int
    failed: int
    verdicts: dict[str, int]
    errors: dict[str, int]

    @classmethod
    def of(cls, runs: int, rows: Iterable[Row]) -> "SweepSummary":
        """Return the summary of the finished runs."""
        rows = list(rows)
        verdicts = Counter(name for row in rows for name in failed_verdicts(row))
        errors = Counter(str(row["error"]) for row in rows if "error" in row)
        hold, do_not_hold = (sum(row.get(PASS) is each for row in rows) for each in (True, False))
        failed = errors.total()
        sums = {name: dict(sorted(each.items())) for name, each in (("verdicts", verdicts), ("errors", errors))}
        return cls(runs, len(rows), hold, do_not_hold, len(rows) - hold - do_not_hold - failed, failed, **sums)

    @property
    def all_pass(self) -> bool:
        """Whether all runs are finished and pass."""
        return self.hold == self.runs

    @property
    def line(self) -> str:
        """The summary in one line."""
        named = ", ".join(f"{name} {count}" for name, count in self.verdicts.items())
        parts = [f"{self.hold} {'passes' if self.hold == 1 else 'pass'}"]
        if self.do_not_hold:
            fail = "fails" if self.do_not_hold == 1 else "fail"
            parts.append(f"{self.do_not_hold} {fail}{f' ({named})' if named else ''}")
        if self.not_judged:
            parts.append(f"{self.not_judged} not judged")
        if self.failed:
            parts.append(f"{self.failed} without a result")
        finished = "" if self.finished == self.runs else f"{self.finished} of "
        return f"{finished}{counted(self.runs, 'run')}: {', '.join(parts)}"

    def to_dict(self) -> dict[str, object]:
        """Return the summary as plain dicts, in their documented order."""
        return asdict(self)
