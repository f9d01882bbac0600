"""The report of a flight as one HTML file for screen and print, which fetches nothing.

It begins with how the flight ended. One part replays the flight on the operator's page; all else is there without
scripts.
"""

from pathlib import Path

from gcs.metrics.result import FlightResult, reference_line
from gcs.report.evidence.criteria import Criteria
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.next_steps import alert_table, next_steps
from gcs.report.page import key_of, render
from gcs.report.replay import licences, packed_replay
from gcs.report.sections import flight_of, sections
from gcs.report.summary import headline, summary, verdicts
from gcs.station.picture import FlightPicture


def write_report(
    evidence: FlightEvidence, result: FlightResult, criteria: Criteria, shown: FlightPicture, path: Path
) -> None:
    """Write the report of a flight, which replays it as `shown`; raises OSError when it cannot be written."""
    path.write_text(report_html(evidence, result, criteria, shown), encoding="utf-8")


def report_html(evidence: FlightEvidence, result: FlightResult, criteria: Criteria, shown: FlightPicture) -> str:
    """Return the report of a flight, which replays it as `shown`, as a page of HTML."""
    flight = flight_of(evidence, result, criteria)
    return render(
        "report.html.j2",
        result=result,
        facts=_facts(evidence, result),
        headline=headline(result),
        verdicts=verdicts(result, criteria),
        summary=summary(result, criteria),
        steps=next_steps(result, evidence),
        alerts=alert_table(result),
        plants=evidence.plants,
        key=key_of(evidence.record),
        sections=sections(flight),
        replay=packed_replay(shown),
        licences=licences(),
    )


def _facts(evidence: FlightEvidence, result: FlightResult) -> dict[str, str]:
    facts = dict(evidence.facts)
    versions = {"versions": facts.pop("versions")} if "versions" in facts else {}
    return {
        **facts,
        "source": f"{result.source}, seed {result.seed}" if result.source != "flight" else "flight",
        "mission time": f"{result.duration_s:g} s at {result.loop.rate_hz:g} Hz",
        **({"wall time": result.wall_time_line} if result.wall_time_line else {}),
        "vehicles": ", ".join(str(track.vehicle_id) for track in evidence.record.vehicles) or "none",
        "reference": reference_line(result),
        **versions,
    }
