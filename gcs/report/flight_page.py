"""The report of a flight as one HTML file for screen and print, which fetches nothing.

It begins with how the flight ended. One part replays the flight on the operator's page; all else is there without
scripts.
"""

import gzip
from base64 import b64encode
from math import inf
from pathlib import Path

import msgspec

from gcs import station
from gcs.flightlog.reader import FlightLog
from gcs.metrics.result import FlightResult, reference_line
from gcs.report.evidence.criteria import Criteria
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.next_steps import alert_table, next_steps
from gcs.report.page import key_of, render
from gcs.report.sections import flight_of, sections
from gcs.report.summary import headline, summary, verdicts
from gcs.station.picture import FlightPicture
from gcs.station.recorded_flight import recorded_flight

PAGE = Path(station.__file__).parent / "page"
FLIGHT = "flight.json"
"""The file of the page that holds the recorded flight."""
_KINDS = frozenset({".css", ".html", ".js", ".mjs", ".svg"})
_VEHICLE_PICTURES = 16_000
"""A vehicle at one time takes about 30 bytes of a report, and 90 where hardly a number repeats: at most 1.4 MB."""


def replay_flight(*logs: FlightLog) -> FlightPicture:
    """Return the logs of a flight's processes as a report replays them; raises LogError as `recorded_flight` does.

    Long flights and large teams are shown less often than five times a second; the replay says how often.
    """
    return recorded_flight(*logs, vehicle_pictures=_VEHICLE_PICTURES, step_max_s=inf)


def packed_replay(flight: FlightPicture) -> str:
    """Return the files of the operator's page with a recorded flight: a JSON object of texts by name, gzip, base64."""
    texts = {name: path.read_text(encoding="utf-8") for name, path in _page_files().items()}
    texts[FLIGHT] = msgspec.json.encode(flight).decode()
    return b64encode(gzip.compress(msgspec.json.encode(texts), compresslevel=9, mtime=0)).decode()


def licences() -> str:
    """Return the licences of the libraries of the page: who gives them on has to give these with them."""
    return "\n".join(path.read_text(encoding="utf-8") for path in sorted(PAGE.rglob("*.LICENSE.txt")))


def _page_files() -> dict[str, Path]:
    """Return the files that a browser loads, by their names relative to the page's folder."""
    return {path.relative_to(PAGE).as_posix(): path for path in sorted(PAGE.rglob("*")) if path.suffix in _KINDS}


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
