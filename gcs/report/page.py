"""The report of a flight as one HTML file without scripts or network access, for screen and print."""

from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from gcs.metrics.record import FlightRecord
from gcs.metrics.result import FlightResult, reference_line
from gcs.report.evidence.criteria import Criteria
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.sections import flight_of, sections
from gcs.report.summary import headline, summary, verdicts
from gcs.style import vehicle_style


@dataclass(frozen=True, slots=True)
class KeyLine:
    """The line style of one vehicle in the legend of a page."""

    label: str
    colour: str
    dashes: str


def write_report(evidence: FlightEvidence, result: FlightResult, criteria: Criteria, path: Path) -> None:
    """Write the report of a flight to a file; raises OSError when it cannot be written."""
    path.write_text(report_html(evidence, result, criteria), encoding="utf-8")


def report_html(evidence: FlightEvidence, result: FlightResult, criteria: Criteria) -> str:
    """Return the report of a flight as a page of HTML."""
    flight = flight_of(evidence, result, criteria)
    return render(
        "report.html.j2",
        result=result,
        facts=_facts(evidence, result),
        headline=headline(result),
        verdicts=verdicts(result, criteria),
        summary=summary(result, criteria),
        key=key_of(evidence.record),
        sections=sections(flight),
    )


def render(template: str, **context: object) -> str:
    """Return a page rendered from a template of this package; text is escaped unless it is markup."""
    environment = Environment(
        loader=PackageLoader("gcs.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**context)


def key_of(record: FlightRecord) -> tuple[KeyLine, ...]:
    """Return the legend: the line style of every vehicle."""
    lines = []
    for row, track in enumerate(record.vehicles):
        style = vehicle_style(row, len(record.vehicles))
        dashes = "" if style["linestyle"] == "-" else " ".join(f"{2.0 * part:g}" for part in style["linestyle"][1])
        lines.append(KeyLine(f"vehicle {track.vehicle_id}", style["color"], dashes))
    return tuple(lines)


def _facts(evidence: FlightEvidence, result: FlightResult) -> dict[str, str]:
    return {
        **evidence.facts,
        "source": f"{result.source}, seed {result.seed}" if result.source != "flight" else "flight",
        "duration": f"{result.duration_s:g} s at {result.loop.rate_hz:g} Hz",
        "vehicles": ", ".join(str(track.vehicle_id) for track in evidence.record.vehicles) or "none",
        "reference": reference_line(result),
    }
