"""Pages as one HTML file without network access, and their parts: verdicts, tables, and sections of charts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from gcs.metrics.catalogue import VerdictState
from gcs.metrics.record import FlightRecord
from gcs.report.charts.chart import Chart
from gcs.style import DARK, themed, vehicle_style


@dataclass(frozen=True, slots=True)
class KeyLine:
    """The style of one line in the legend of a page."""

    label: str
    colour: str
    dashes: str


def render(template: str, **context: object) -> str:
    """Return a page rendered from a template of this package; text is escaped unless it is markup."""
    environment = Environment(
        loader=PackageLoader("gcs.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["themed"] = themed
    return environment.get_template(template).render(dark=DARK, **context)


def key_of(record: FlightRecord) -> tuple[KeyLine, ...]:
    """Return the legend: the line style of every vehicle."""
    vehicles = len(record.vehicles)
    return tuple(
        key_line(f"vehicle {track.vehicle_id}", vehicle_style(row, vehicles))
        for row, track in enumerate(record.vehicles)
    )


def key_line(label: str, style: Mapping[str, Any]) -> KeyLine:
    """Return a line of a legend in a style of matplotlib's."""
    dashes = "" if style["linestyle"] == "-" else " ".join(f"{2.0 * part:g}" for part in style["linestyle"][1])
    return KeyLine(label, style["color"], dashes)


_NARROW_COLUMNS = 6


@dataclass(frozen=True, slots=True)
class VerdictEntry:
    """A verdict with its (measured, allowed) values."""

    name: str
    meaning: str
    state: VerdictState
    evidence: tuple[tuple[str, str], ...]

    @property
    def style(self) -> str:
        """The CSS class of the verdict."""
        return {VerdictState.PASSES: "good", VerdictState.FAILS: "bad"}.get(self.state, "none")


@dataclass(frozen=True, slots=True)
class Table:
    """A table; the first `words` columns hold text, the others numbers. A folded table opens on demand."""

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
    """A section of a page: lead, charts and tables; `missing` states what is not available, and why.

    A `keyed` section shows the legend of the vehicles' lines.
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
        """The charts that hold data."""
        return tuple(each for each in self.charts if not each.missing)

    @property
    def absent(self) -> tuple[str, ...]:
        """The missing charts by reason, and the other missing data, one line each."""
        reasons: dict[str, list[str]] = {}
        for each in self.charts:
            if each.missing:
                reasons.setdefault(each.missing, []).append(each.title)
        return (*(f"{', '.join(titles)}: {reason}." for reason, titles in reasons.items()), *self.missing)
