"""What to do after a flight: steps that follow from its end, its verdicts, its plants and its control loop.

What to do about an alert stands in `gcs/console/advice.py`: `alert_table` shows it for the alerts of the flight.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from shlex import quote

from agents.shell.outcome import KILLED
from gcs.console.advice import advice, begun_alert, late_ticks
from gcs.metrics.ending import How, named
from gcs.metrics.result import FlightResult, VehicleResult
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.page_parts import Table
from gcs.report.summary import listed

_AFTER_ENDING = {
    How.KILLED: f"{KILLED.next_step} before it flies again",
    How.ERROR: "repeat the mission with `cordon sim`, and report the error with this log",
    How.WATCHDOG: "find out what stopped the agent's process: docs/deadman.md lists the causes",
    How.IN_FLIGHT: "find out where it landed, and why the recording ended",
    How.PILOT: "ask the pilot for the reason",
    How.REFUSED: "let `cordon check` state what its autopilot refuses",
    How.BATTERY: "charge its battery; fly a shorter mission if the battery was full at take-off",
    How.FAILSAFE: "remove the cause of the failsafe, which the alerts below state",
    How.UNKNOWN: "evaluate this log with the version of cordon that recorded it",
    How.ABORTED: "ask the operator for the reason; the commands are on the timeline",
    How.OPERATOR: "ask the operator for the reason; the commands are on the timeline",
}


@dataclass(frozen=True, slots=True)
class Step:
    """A step to take after a flight, and the command for it; empty without one."""

    text: str
    command: str = ""


def next_steps(result: FlightResult, evidence: FlightEvidence) -> tuple[Step, ...]:
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
        if alert := begun_alert(event.kind, event.text):
            begun.setdefault(alert, []).append((event.time_s, event.vehicle))
    rows = tuple(
        (alert, ", ".join(map(str, sorted({vehicle for _, vehicle in each}))), advice(alert), f"{each[0][0]:.1f}")
        for alert, each in begun.items()
    )
    columns = ("alert", "vehicles", "what to do in flight", "first at [s]")
    return Table("Alerts of this flight, and what to do about each", columns, rows, words=3)


def _after_ending(result: FlightResult) -> Iterator[Step]:
    if result.ended is not None and result.ended.is_early:
        text = _AFTER_ENDING[result.ended.how]
        yield Step(
            f"{_sentence(named(result.ended.vehicles))}: {text}." if result.ended.vehicles else f"{_sentence(text)}."
        )


def _separate(result: FlightResult, evidence: FlightEvidence) -> Iterator[Step]:
    if result.verdicts.separation is False:
        text = "Find out why the vehicles came too close before this mission flies again: the guard's reasons are in"
        yield Step(text, _explained(evidence, result.vehicles[0]))


def _engage(result: FlightResult, evidence: FlightEvidence) -> Iterator[Step]:
    for vehicle in result.vehicles:
        if vehicle.id in result.engagement.missing:
            yield Step(f"Vehicle {vehicle.id} did not engage: the reasons are in", _explained(evidence, vehicle))


def _identify(result: FlightResult, evidence: FlightEvidence) -> Iterator[Step]:
    invalid = [note.vehicle_id for note in evidence.plants if note.is_invalid]
    if invalid:
        text = f"Identify {named(invalid)} again, as another plant explains this flight better than the profile's:"
        yield Step(text, f"cordon excite {quote(result.mission)}")


def _settle(result: FlightResult, evidence: FlightEvidence) -> Iterator[Step]:
    failed = [name for name, holds in result.verdicts.named().items() if holds is False and name not in _APART]
    if not failed:
        return
    worst = max(result.vehicles, key=_ring_error)
    left_s = result.ring.unsettled_at_s
    when = f"The ring left its limits at {left_s:.1f} s: look" if left_s is not None else "Look"
    text = f"{listed(failed)} {'does' if len(failed) == 1 else 'do'} not hold. {when} at the timeline and at"
    yield Step(text, _explained(evidence, worst))


_APART = ("separation", "engaged")
"""The verdicts that have steps of their own."""


def _hurry(result: FlightResult, evidence: FlightEvidence) -> Iterator[Step]:
    below_speed = evidence.speed if evidence.speed > 1.0 else None
    if late := late_ticks(result.loop.missed, result.loop.ticks, below_speed=below_speed):
        yield Step(f"{late}.")


def _ring_error(vehicle: VehicleResult) -> float:
    return vehicle.radius_error_rms_m or vehicle.formation_spacing_error_rms_m or 0.0


def _explained(evidence: FlightEvidence, vehicle: VehicleResult) -> str:
    log = evidence.facts.get("log", "")
    return f"cordon replay {quote(log) if log and ', ' not in log else 'LOG'} --explain {vehicle.id}"


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"
