"""The summary of a sweep."""

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

from gcs.mission.overrides import override_text
from gcs.sweep.columns import Column, Row, failed_verdicts
from gcs.sweep.plan import SweepPlan, SweepRun, counted


@dataclass(frozen=True, slots=True)
class WorstCase:
    """A run with its reasons: metrics whose worst value it has, verdicts that do not hold, or its error."""

    reasons: tuple[str, ...]
    command: str


def worst_cases(
    plan: SweepPlan, rows: Mapping[int, Row], metrics: Iterable[Column], mission: str, most: int
) -> list[WorstCase]:
    """Return the worst run of each metric, the first `most` runs that do not hold, and one run for each error.

    A run is listed once, with all its reasons. `mission` is the mission of the commands.
    """
    runs = plan.runs
    worst_in: dict[int, list[str]] = {}
    for metric in metrics:
        known = {index: row[metric.name] for index, row in sorted(rows.items()) if metric.name in row}
        if metric.worst is not None and len({*known.values()}) > 1:
            index = (max if metric.worst == "max" else min)(known, key=known.__getitem__)
            worst_in.setdefault(index, []).append(f"{metric.name} ({known[index]:.4g})")
    not_holding = [index for index, row in sorted(rows.items()) if row.get("holds") is False]
    failed = {row["error"]: index for index, row in sorted(rows.items(), reverse=True) if "error" in row}
    chosen = dict.fromkeys([*worst_in, *not_holding[:most], *sorted(failed.values())])
    return [
        WorstCase((*_worst(worst_in.get(index, ())), *_faults(rows[index])), command(plan, runs[index], mission))
        for index in chosen
    ]


def command(plan: SweepPlan, run: SweepRun, mission: str) -> str:
    """Return the command that flies a run again."""
    values = {**plan.fixed, **run.values}
    words = [word for place, value in values.items() for word in ("--set", override_text(place, value))]
    duration = [] if plan.duration_s is None else ["--duration", str(plan.duration_s).removesuffix(".0")]
    return shlex.join(["cordon", "sim", mission, *words, "--seed", str(run.seed), *duration])


def _worst(metrics: Sequence[str]) -> list[str]:
    return [f"worst in {', '.join(metrics)}"] if metrics else []


def _faults(row: Row) -> list[str]:
    failing = failed_verdicts(row)
    named = [f"does not hold: {', '.join(failing)}"] if failing else []
    return [*named, *([f"failed: {row['error']}"] if "error" in row else [])]


@dataclass(frozen=True, slots=True)
class SweepSummary:
    """Numbers of a sweep's `runs`: finished, with all verdicts holding, with verdicts not holding, and failed.

    `verdicts` counts runs by verdicts that do not hold, `errors` by the reasons of failed runs.
    """

    runs: int
    finished: int
    hold: int
    do_not_hold: int
    failed: int
    verdicts: dict[str, int]
    errors: dict[str, int]

    @classmethod
    def of(cls, runs: int, rows: Iterable[Row]) -> "SweepSummary":
        """Return the summary of the finished runs."""
        rows = list(rows)
        verdicts = Counter(name for row in rows for name in failed_verdicts(row))
        errors = Counter(str(row["error"]) for row in rows if "error" in row)
        hold = sum(row.get("holds") is True for row in rows)
        failed = errors.total()
        sums = {name: dict(sorted(each.items())) for name, each in (("verdicts", verdicts), ("errors", errors))}
        return cls(runs, len(rows), hold, len(rows) - hold - failed, failed, **sums)

    @property
    def all_hold(self) -> bool:
        """Whether all runs are finished and hold."""
        return self.hold == self.runs

    @property
    def line(self) -> str:
        """The summary in one line."""
        named = ", ".join(f"{name} {count}" for name, count in self.verdicts.items())
        parts = [f"{self.hold} hold"]
        if self.do_not_hold:
            parts.append(
                f"{self.do_not_hold} {'does' if self.do_not_hold == 1 else 'do'} not{f' ({named})' if named else ''}"
            )
        if self.failed:
            parts.append(f"{self.failed} failed")
        finished = "" if self.finished == self.runs else f"{self.finished} of "
        return f"{finished}{counted(self.runs, 'run')}: {', '.join(parts)}"

    def to_dict(self) -> dict[str, object]:
        """Return the summary as plain dicts, in their documented order."""
        return asdict(self)
