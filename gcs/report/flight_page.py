"""The report of a flight as one HTML file for screen and print, which fetches nothing.

Its first part replays the flight on the operator's page. All else is there without scripts.
"""

from pathlib import Path

from gcs.metrics.result import FlightResult, reference_line
from gcs.report.evidence.criteria import Criteria
from gcs.report.evidence.flight import FlightEvidence
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
        key=key_of(evidence.record),
        sections=sections(flight),
        replay=packed_replay(shown),
        licences=licences(),
    )


def _facts(evidence: FlightEvidence, result: FlightResult) -> dict[str, str]:
    return {
        **evidence.facts,
        "source": f"{result.source}, seed {result.seed}" if result.source != "flight" else "flight",
        "duration": f"{result.duration_s:g} s at {result.loop.rate_hz:g} Hz",
        "vehicles": ", ".join(str(track.vehicle_id) for track in evidence.record.vehicles) or "none",
        "reference": reference_line(result),
    }
