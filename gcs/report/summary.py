"""Text of a flight report: the verdicts with their measurements, and a paragraph that summarizes the flight."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from agents.notes import Kind
from gcs.metrics.catalogue import OF_THE_RING, VERDICTS, VerdictState, evidence
from gcs.metrics.departures import departures_line
from gcs.metrics.ending import named
from gcs.metrics.record import TIME_GRAIN_S
from gcs.metrics.references import DesiredRing, engaged_line
from gcs.metrics.result import (
    FlightResult,
    NamedRing,
    judged_line,
    reference_line,
    settled_line,
    verdict_states,
    window_line,
)
from gcs.report.evidence.criteria import Criteria
from gcs.report.page_parts import VerdictEntry

# More vehicles than these are not named one by one.
_NAMED = 4
_SOURCES = {
    "simulation": "in simulation",
    "sitl": "with simulated autopilots",
    "bench": "on the bench, with simulated bodies",
    "hybrid": "with stubs beside other vehicles",
    "flight": "in a flight",
}


def verdicts(result: FlightResult, criteria: Criteria) -> tuple[VerdictEntry, ...]:
    """Return the verdicts in the paper's order, each with its measured and its allowed values."""
    states = verdict_states(result)
    return tuple(
        VerdictEntry(each.name, each.subject, states[each.name], tuple(_measured(each.name, result, criteria)))
        for each in VERDICTS
    )


def _measured(verdict: str, result: FlightResult, criteria: Criteria) -> Iterator[tuple[str, str]]:
    """Return what a verdict judges, each with the tolerance; of several rings, the first three each with its name."""
    if verdict in OF_THE_RING and result.rings:
        for number, each in enumerate(result.rings):
            for measured, allowed in _measured(verdict, each.result, criteria.of_ring(number)):
                yield f"{each.name}: {measured}", allowed
        return
    for metric, judged, values in evidence(verdict, result):
        if judged.tolerance:
            worst = metric.amount(metric.farthest(values, _judged_ring(result, criteria)))
            limit = "at least" if metric.worst == "min" else "at most"
            allowed = f"{limit} {getattr(criteria.tolerances, judged.tolerance):g}{metric.spaced_unit}"
            yield " ".join(filter(None, (judged.subject, worst, judged.kind))), allowed
    beside = {
        **dict.fromkeys(OF_THE_RING, judged_line(result)),
        "engaged": engaged_line(result.engagement),
        "kept": departures_line(result.departures),
    }
    if text := beside.get(verdict):
        yield text, ""


def _judged_ring(result: FlightResult, criteria: Criteria) -> DesiredRing:
    """Return the ring that was desired at the end of the window of the ring metrics."""
    return criteria.ring if result.window_s is None else criteria.ring.before(result.window_s[1] + TIME_GRAIN_S)


def headline(result: FlightResult) -> str:
    """Return the verdicts in one line: of a flight that ended early, those of the part that was flown."""
    words = _verdicts_line(result)
    return f"Until then: {words[:1].lower()}{words[1:]}" if result.ended_early else words


def _verdicts_line(result: FlightResult) -> str:
    states = [state for state in verdict_states(result).values() if state is not VerdictState.NOT_ASKED]
    applied, failed, unjudged = len(states), states.count(VerdictState.FAILS), len(result.not_judged)
    if not applied:
        return "No verdict applies"
    if not failed and not unjudged:
        return "All verdicts pass" if applied == len(VERDICTS) else f"All {applied} verdicts that apply pass"
    of = f" of {applied} verdicts"
    fail = f"{failed}{of} {'fails' if failed == 1 else 'fail'}" if failed else ""
    left = f"{unjudged}{'' if failed else of} could not be judged" if unjudged else ""
    return ", ".join(filter(None, (fail, left)))


def summary(result: FlightResult, criteria: Criteria) -> str:
    """Return the flight in a paragraph."""
    sentences = [
        _flown(result),
        *_engaged(result),
        *_left(result),
        *_rings(result, criteria),
        *_estimate(result),
        *_apart(result, criteria),
        *_guarded(result),
        *_troubles(result),
    ]
    return re.sub(r"(\d) (s|m|setpoints?)\b", "\\1\u00a0\\2", " ".join(sentences))


def _flown(result: FlightResult) -> str:
    count = len(result.vehicles)
    source = _SOURCES.get(result.source, f"({result.source})")
    reference = reference_line(result)
    flown = f"{count} vehicle{_s(count)} flew {result.mission} for {result.duration_s:g} s {source}"
    return f"{flown}; {reference}."


def _engaged(result: FlightResult) -> list[str]:
    missing = result.engagement.missing
    joined = sorted((v.engaged_at_s, v.id) for v in result.vehicles if v.engaged_at_s is not None)
    if not joined:
        target = "a" if result.rings else "the"
        return [f"No vehicle engaged {target} target{f', though {named(missing)} should have' if missing else ''}."]
    each = [f"vehicle {vehicle_id} after {at_s:.1f} s" for at_s, vehicle_id in joined]
    shown = listed(each) if len(each) <= _NAMED else f"{len(each)} vehicles, from {each[0]} to {each[-1]}"
    stayed = [str(v.id) for v in result.vehicles if v.engaged_at_s is None and v.id not in missing]
    rest = f"; not engaged: {listed(stayed)}" if stayed else ""
    never = f"; {named(missing)} should have, and never did" if missing else ""
    return [f"Engaged on {'a' if result.rings else 'the'} ring: {shown}{rest}{never}."]


def _left(result: FlightResult) -> list[str]:
    left = departures_line(result.departures)
    return [f"{left[:1].upper()}{left[1:]}."] if result.departures else []


def _rings(result: FlightResult, criteria: Criteria) -> list[str]:
    if not result.rings:
        return _ring(result, criteria)
    return [ring_paragraph(each, criteria.of_ring(number)) for number, each in enumerate(result.rings)]


def ring_paragraph(ring: NamedRing, criteria: Criteria) -> str:
    """Return one of several rings in sentences, by its own criteria."""
    vehicles = [vehicle.id for vehicle in ring.result.vehicles]
    if not vehicles:
        return f"No vehicle was on ring {ring.name}{ring.about}."
    flown = f"On ring {ring.name}{ring.about}: {named(vehicles)}."
    return " ".join([flown, *_ring(ring.result, criteria)])


def _ring(result: FlightResult, criteria: Criteria) -> list[str]:
    if result.window_s is None:
        return []
    radius_m = _worst(v.radius_error_rms_m for v in result.vehicles)
    largest_m = _worst(v.radius_error_max_m for v in result.vehicles)
    desired_m = _judged_ring(result, criteria).radius_m
    parts = []
    if radius_m is not None and largest_m is not None:
        parts.append(f"radius {radius_m:.3f} m rms ({largest_m:.2f} m max) of {desired_m:g} m")
    if result.ring.spacing_error_rms_deg is not None:
        parts.append(f"spacing {result.ring.spacing_error_rms_deg:.2f}° rms")
    window = window_line(result)
    errors = f"{window[:1].upper()}{window[1:]}"
    after = f" From the last engagement on it {settled}." if (settled := settled_line(result)) else ""
    return [f"{errors}.{after} Errors: {', '.join(parts)}."] if parts else []


def _estimate(result: FlightResult) -> list[str]:
    if result.estimate is None:
        return []
    radius_m = _worst(v.radius_error_rms_m for v in result.estimate.vehicles)
    off_m = _worst(v.estimate_error_rms_m for v in result.estimate.vehicles)
    spacing_deg = result.estimate.ring.spacing_error_rms_deg
    parts = [
        "" if radius_m is None else f"radius {radius_m:.3f} m rms",
        "" if spacing_deg is None else f"spacing {spacing_deg:.2f}° rms",
        "" if off_m is None else f"estimated positions {off_m:.3f} m rms off",
    ]
    known = [part for part in parts if part]
    return [f"By the vehicles' own estimates in the same window: {', '.join(known)}."] if known else []


def _apart(result: FlightResult, criteria: Criteria) -> list[str]:
    figures = [
        "" if closest_m is None else f"{closest_m:.2f} m {where}"
        for closest_m, where in (
            (result.closest_approach_m, "in the mission"),
            (result.ways_closest_m, "on the ways out and home"),
        )
    ]
    known = ", ".join(filter(None, figures))
    return [f"Closest approach: {known} (required separation {criteria.tolerances.separation_m:g} m)."] if known else []


def _guarded(result: FlightResult) -> list[str]:
    if result.guard_interventions is None:
        return []
    if not result.guard_interventions:
        return ["The guard moved no setpoint."]
    counted = [f"{cause} {count}" for cause, count in result.guard_causes.items()]
    why = f" ({listed(counted)})" if counted else ""
    return [f"The guard moved {result.guard_interventions} setpoint{_s(result.guard_interventions)}{why}."]


def _troubles(result: FlightResult) -> list[str]:
    kinds = Counter(event.kind for event in result.events)
    named: dict[Kind, str] = {"failsafe": "failsafe event", "command": "operator command event"}
    return [f"{kinds[kind]} {name}{_s(kinds[kind])} (see the timeline)." for kind, name in named.items() if kinds[kind]]


def _s(count: int) -> str:
    return "" if count == 1 else "s"


def listed(parts: Sequence[str]) -> str:
    """Return one or more parts of a sentence as one: `a, b and c`."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _worst(values: Iterable[float | None]) -> float | None:
    return max((abs(value) for value in values if value is not None), default=None)
