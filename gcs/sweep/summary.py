"""The summary of a sweep."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass

from gcs.sweep.columns import Row, failed_verdicts
from gcs.sweep.plan import counted


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
