"""The report of a flight as one HTML file for screen and print, which fetches nothing.

It begins with how the flight ended. One part replays the flight on the operator's page; all else is there without
scripts.

What to do after a flight: steps that follow from its end, its verdicts, its plants and its control loop.

What to do about an alert stands in `gcs/console/advice.py`: `alert_table` shows it for the alerts of the flight.
"""

import gzip
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from pathlib import Path
from shlex import quote

import msgspec

from agents.flight_end import FlightEnd
from gcs import station
from gcs.console.advice import advice, late_ticks
from gcs.flightlog.reader import FlightLog
from gcs.keys.private_files import create
from gcs.metrics.ending import named
from gcs.metrics.result import FlightResult, reference_line
from gcs.report.evidence.criteria import Criteria
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.page_parts import Table, key_of, render
from gcs.report.sections import flight_of, sections
from gcs.report.summary import headline, listed, summary, verdicts
from gcs.station.picture import FlightPicture
from gcs.station.recorded_flight import recorded_flight

_AFTER_ENDING = {
    FlightEnd.LOST: "recover it at its last position, and find out why its link was lost",
    FlightEnd.KILLED: "recover and inspect before the next flight",
    FlightEnd.ERROR: "report the error with this log, and repeat the mission in simulation before the next flight",
    FlightEnd.WATCHDOG: "find out what stopped the agent's process; docs/deadman.md lists causes",
    FlightEnd.IN_FLIGHT: "the landing is not recorded: find out where and how it went, and why the recording ended",
    FlightEnd.PILOT: "find out who or what changed its mode",
    FlightEnd.REFUSED: "correct what the autopilot refuses; cordon check states the findings without a flight",
    FlightEnd.BATTERY: "charge the battery; fly a shorter mission if it was full at take-off",
    FlightEnd.FAILSAFE: "remove the cause of the failsafe; the alerts are below",
    FlightEnd.UNKNOWN: "evaluate this log with the version of cordon that recorded it",
    FlightEnd.ABORTED: "ask the operator for the reason; the commands are on the timeline",
    FlightEnd.OPERATOR: "ask the operator for the reason; the commands are on the timeline",
}
_ERRORS = {"C2": "angular_rate_error_rms_rad_s", "formation": "formation_spacing_error_rms_m"}
"""The metric that tells which vehicle to look at, by the verdict; that of the others is the error of the radius."""


@dataclass(frozen=True, slots=True)
class NextStep:
    """A step to take after a flight, and the command for it; empty without one."""

    text: str
    command: str = ""


def next_steps(result: FlightResult, evidence: FlightEvidence) -> tuple[NextStep, ...]:
    """Return the steps, the most urgent first; empty where nothing is to be corrected."""
    return (
        *_after_ending(result),
        *_separate(result, evidence),
        *_engage(result, evidence),
        *_keep(result, evidence),
        *_identify(result, evidence),
        *_settle(result, evidence),
        *_judge(result),
        *_hurry(result, evidence),
    )


def alert_table(result: FlightResult) -> Table:
    """Return the alerts of a flight: which vehicles sent each, since when, and what an operator does about it."""
    begun: dict[str, list[tuple[float, int]]] = {}
    for event in result.events:
        if event.alert is not None and not event.alert.is_over:
            begun.setdefault(event.alert.condition, []).append((event.time_s, event.vehicle))
    rows = tuple(
        (alert, ", ".join(map(str, sorted({vehicle for _, vehicle in each}))), advice(alert), f"{each[0][0]:.1f}")
        for alert, each in begun.items()
    )
    columns = ("alert", "vehicles", "what to do in flight", "first at [s]")
    return Table("Alerts of this flight, and what to do about each", columns, rows, words=3)


def _after_ending(result: FlightResult) -> Iterator[NextStep]:
    if result.ended is not None and result.ended.is_early:
        whose = named(result.ended.vehicles)
        yield NextStep(f"{whose[:1].upper()}{whose[1:]}: {_AFTER_ENDING[result.ended.how]}.")


def _separate(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    if result.verdicts.separation is False:
        text = (
            "Find out why vehicles came too close before this mission flies again. The chart of the closest approach "
            "names them, and the guard's reasons are in"
        )
        yield NextStep(text, _explained(evidence, "ID"))


def _engage(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    for vehicle in result.vehicles:
        if vehicle.id in result.engagement.missing:
            yield NextStep(f"Vehicle {vehicle.id} did not engage: the reasons are in", _explained(evidence, vehicle.id))


def _keep(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    left: dict[str, list[int]] = {}
    for each in result.departures or ():
        left.setdefault(each.cause, []).append(each.vehicle)
    for cause, vehicles in left.items():
        whose = named(sorted({*vehicles}))
        text = f"{whose[:1].upper()}{whose[1:]} left formation or ring ({cause}): the reasons are in"
        yield NextStep(text, _explained(evidence, vehicles[0]))


def _identify(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    differing = [plant.id for plant in evidence.plants if plant.differs]
    if differing:
        text = f"Identify {named(differing)}, as another plant explains this flight better than the profile's:"
        yield NextStep(text, f"cordon excite {quote(result.mission)}")


def _settle(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    failed = [name for name, holds in result.verdicts.named().items() if holds is False and name not in _APART]
    if not failed:
        return
    metric = _ERRORS.get(failed[0], "radius_error_rms_m")
    worst = max(result.vehicles, key=lambda vehicle: getattr(vehicle, metric) or 0.0)
    left_s = result.ring.unsettled_at_s
    when = f"The ring left its limits at {left_s:.1f} s: look" if left_s is not None else "Look"
    text = f"{listed(failed)} {'fails' if len(failed) == 1 else 'fail'}. {when} at the timeline and at"
    yield NextStep(text, _explained(evidence, worst.id))


_APART = ("separation", "engaged", "kept")
"""The verdicts that have steps of their own."""


def _judge(result: FlightResult) -> Iterator[NextStep]:
    if result.passes is None and not result.ended_early:
        yield NextStep(f"{listed(result.not_judged)} could not be judged: fly for longer.")


def _hurry(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    below_speed = evidence.speed if evidence.speed > 1.0 else None
    if late := late_ticks(result.loop.missed, result.loop.ticks, below_speed=below_speed):
        yield NextStep(f"{late}.")


def _explained(evidence: FlightEvidence, vehicle: int | str) -> str:
    log = quote(evidence.logs[0]) if len(evidence.logs) == 1 else "LOG"
    return f"cordon replay {log} --explain {vehicle}"


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
    with create(path) as file:
        file.write(
            report_html(evidence, result, criteria, shown).encode(errors="replace")
        )  # names of files may hold bytes that are no text


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
