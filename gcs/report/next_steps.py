"""What to do after a flight: steps that follow from its end, its verdicts, its plants and its control loop.

What to do about an alert stands in `gcs/console/advice.py`: `alert_table` shows it for the alerts of the flight.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from shlex import quote

from agents.flight_end import FlightEnd
from gcs.console.advice import advice, late_ticks
from gcs.metrics.ending import named
from gcs.metrics.result import FlightResult
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.page_parts import Table
from gcs.report.summary import listed

_AFTER_ENDING = {
    FlightEnd.KILLED: "recover and inspect before the next flight",
    FlightEnd.ERROR: "report the error with this log, and repeat the mission in simulation before the next flight",
    FlightEnd.WATCHDOG: "find out what stopped the agent's process; docs/deadman.md lists causes",
    FlightEnd.IN_FLIGHT: "the landing is not recorded: find out where and how it went, and why the recording ended",
    FlightEnd.PILOT: "ask the pilot for the reason",
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
        *_identify(result, evidence),
        *_settle(result, evidence),
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


def _identify(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    invalid = [note.vehicle_id for note in evidence.plants if note.is_invalid]
    if invalid:
        text = f"Identify {named(invalid)} again, as another plant explains this flight better than the profile's:"
        yield NextStep(text, f"cordon excite {quote(result.mission)}")


def _settle(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    failed = [name for name, holds in result.verdicts.named().items() if holds is False and name not in _APART]
    if not failed:
        return
    metric = _ERRORS.get(failed[0], "radius_error_rms_m")
    worst = max(result.vehicles, key=lambda vehicle: getattr(vehicle, metric) or 0.0)
    left_s = result.ring.unsettled_at_s
    when = f"The ring left its limits at {left_s:.1f} s: look" if left_s is not None else "Look"
    text = f"{listed(failed)} {'does' if len(failed) == 1 else 'do'} not hold. {when} at the timeline and at"
    yield NextStep(text, _explained(evidence, worst.id))


_APART = ("separation", "engaged")
"""The verdicts that have steps of their own."""


def _hurry(result: FlightResult, evidence: FlightEvidence) -> Iterator[NextStep]:
    below_speed = evidence.speed if evidence.speed > 1.0 else None
    if late := late_ticks(result.loop.missed, result.loop.ticks, below_speed=below_speed):
        yield NextStep(f"{late}.")


def _explained(evidence: FlightEvidence, vehicle: int | str) -> str:
    log = quote(evidence.logs[0]) if len(evidence.logs) == 1 else "LOG"
    return f"cordon replay {log} --explain {vehicle}"
