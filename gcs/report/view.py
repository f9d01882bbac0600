"""What stands on a page, before anybody makes HTML of it: verdicts, tables, and sections of charts and tables."""

from dataclasses import dataclass

from gcs.report.charts.chart import Chart

_NARROW_COLUMNS = 5


@dataclass(frozen=True, slots=True)
class Verdict:
    """A verdict (True holds, False does not, None does not apply) and its evidence: what was measured and allowed."""

    name: str
    meaning: str
    holds: bool | None
    evidence: tuple[tuple[str, str], ...]

    @property
    def sign(self) -> str:
        """The verdict as a sign."""
        return {True: "✓", False: "✗", None: "–"}[self.holds]

    @property
    def word(self) -> str:
        """The verdict as words."""
        return {True: "holds", False: "does not hold", None: "does not apply"}[self.holds]

    @property
    def style(self) -> str:
        """The class of its looks."""
        return {True: "good", False: "bad", None: "none"}[self.holds]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text; the first `words` columns hold words, the others numbers. A folded one opens on demand."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1
    folded: bool = False

    @property
    def narrow(self) -> bool:
        """Whether it fits beside a chart."""
        return len(self.columns) <= _NARROW_COLUMNS and not self.folded


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page: what it is about, and what there is to see; `missing` says what there is not, and why.

    One that is `keyed` shows which lines are whose.
    """

    anchor: str
    title: str
    lead: str = ""
    charts: tuple[Chart, ...] = ()
    tables: tuple[Table, ...] = ()
    missing: tuple[str, ...] = ()
    keyed: bool = True

    @property
    def drawn(self) -> tuple[Chart, ...]:
        """The charts with something to see."""
        return tuple(each for each in self.charts if not each.missing)

    @property
    def absent(self) -> tuple[str, ...]:
        """What there is not to see, a line each: charts that are missing for the same reason together."""
        reasons: dict[str, list[str]] = {}
        for each in self.charts:
            if each.missing:
                reasons.setdefault(each.missing, []).append(each.title)
        return (*(f"{', '.join(titles)}: {reason}." for reason, titles in reasons.items()), *self.missing)
