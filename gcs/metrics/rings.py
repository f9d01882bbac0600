"""The result of a flight over several rings: each ring as that of a flight over it alone, and the team as a whole.

What the result states once, and each ring has of its own:

- `verdicts`: C1 to C3 hold if those of all rings hold that were flown; None if one was not judged and none fails.
- `ring`: the worst of all rings that were flown, value by value; None where a ring did not settle.
- `window_s`: the time at which all of them were within their windows, None if there is none.
- `vehicles`: the figures of the ring that the vehicle was on last, of those whose window it was in.
- `transitions`: those of all rings, in order of time.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from agents.tactics import Tactic
from gcs.metrics.catalogue import OF_THE_RING, VERDICTS, not_judged
from gcs.metrics.record import FlightRecord, Mask
from gcs.metrics.references import EngagementResult, engagement, engagement_reference
from gcs.metrics.result import EstimateResult, FlightResult, NamedRing
from gcs.metrics.ring import RingResult
from gcs.metrics.vehicles import EstimatedVehicleResult, VehicleResult, engagement_times_s
from gcs.mission.mission import Mission

ValueT = TypeVar("ValueT", int, float)
_OnRingT = TypeVar("_OnRingT", VehicleResult, EstimatedVehicleResult)


def combined(team: FlightResult, record: FlightRecord, rings: tuple[NamedRing, ...]) -> FlightResult:
    """Return the result of a flight over several rings from that of the team, whose ring it replaces."""
    flown = [each.result for each in rings if each.result.window_s is not None]
    result = replace(
        team,
        window_s=_common_s(flown),
        vehicles=tuple(_on_last_ring(each, record, rings) for each in team.vehicles),
        ring=_worst_ring([each.ring for each in flown]),
        transitions=tuple(
            sorted((each for one in flown for each in one.transitions), key=lambda each: each.begins_at_s)
        ),
        estimate=None if team.estimate is None else _estimated(team.estimate, record, rings),
        verdicts=replace(
            team.verdicts,
            **{name.lower(): _held(name, rings) for name in OF_THE_RING},
            engaged=team.engagement.holds,
        ),
        not_judged=(),
        rings=rings,
    )
    unjudged = {*not_judged(result), *(name for each in rings for name in each.not_judged)}
    return replace(result, not_judged=tuple(each.name for each in VERDICTS if each.name in unjudged))


def rings_engagement(mission: Mission, record: FlightRecord) -> EngagementResult:
    """Return who was to engage on any ring, and who did.

    A vehicle was to if the rule of one target lets it that has a ring, and if there was a place about it: if there were
    never as many vehicles on its rings as these have places. One that is still on its way to a ring at the end may yet.
    """
    engaged = {
        track.vehicle_id
        for track, at_s in zip(record.vehicles, engagement_times_s(record), strict=True)
        if at_s is not None
    }
    due = set[int]()
    pending = {track.vehicle_id for track in record.vehicles if track.last_tactic == Tactic.TRANSIT.value}
    for target in dict.fromkeys(each.target for each in mission.rings):
        numbers = [number for number, each in enumerate(mission.rings) if each.target == target]
        on_them = np.array([_about(record, row, numbers) for row in range(len(record.vehicles))])
        places = sum(mission.rings[number].places for number in numbers)
        if on_them.sum(axis=0).max(initial=0) >= places:
            continue
        came_s = [float(record.time_s[np.argmax(row)]) if row.any() else None for row in on_them]
        reference = engagement_reference(mission.of_ring(numbers[0]))
        found = engagement(record.of_ring(numbers[0]), reference, came_s)
        due |= set(found.to_engage)
        pending |= set(found.pending)
    ids = tuple(track.vehicle_id for track in record.vehicles)
    open_ids = pending - engaged  # one with a ring still to come has missed none
    return EngagementResult(
        tuple(each for each in ids if each in engaged | (due - open_ids)),
        tuple(each for each in ids if each in engaged),
        tuple(each for each in mission.ids if each in open_ids),
    )


def _about(record: FlightRecord, row: int, numbers: Sequence[int]) -> Mask:
    """Return when (T,) a vehicle was on one of these rings."""
    return np.asarray(np.any([record.vehicles[row].encircles(number) for number in numbers], axis=0))


def _common_s(flown: Sequence[FlightResult]) -> tuple[float, float] | None:
    windows_s = [each.window_s for each in flown if each.window_s is not None]
    begins_s = max((begin_s for begin_s, _ in windows_s), default=0.0)
    ends_s = min((end_s for _, end_s in windows_s), default=0.0)
    return (begins_s, ends_s) if ends_s > begins_s else None


def _held(verdict: str, rings: Iterable[NamedRing]) -> bool | None:
    """Return whether a verdict holds on all rings to which it applies."""
    applies = [each for each in rings if each.verdict(verdict) is not None or verdict in each.not_judged]
    held = [each.verdict(verdict) for each in applies]
    return False if False in held else True if held and None not in held else None


def _on_last_ring(vehicle: VehicleResult, record: FlightRecord, rings: Sequence[NamedRing]) -> VehicleResult:
    """Return the figures of a vehicle with those of the last ring that it was on in that ring's window."""
    known = _of_last_ring(vehicle.id, record, [each.result.vehicles for each in rings])
    known = known or VehicleResult(vehicle.id, vehicle.engaged_at_s, vehicle.tactic)
    return replace(
        known,
        engaged_at_s=vehicle.engaged_at_s,
        tactic=vehicle.tactic,
        formation_speed_error_rms_m_s=vehicle.formation_speed_error_rms_m_s,
        formation_spacing_error_rms_m=vehicle.formation_spacing_error_rms_m,
    )


def _of_last_ring(vehicle_id: int, record: FlightRecord, rings: Sequence[Sequence[_OnRingT]]) -> _OnRingT | None:
    track = next(each for each in record.vehicles if each.vehicle_id == vehicle_id)
    last, found = -1, None
    for number, vehicles in enumerate(rings):
        each = next((each for each in vehicles if each.id == vehicle_id), None)
        if each is not None and each.radius_error_rms_m is not None:
            on = int(np.flatnonzero(track.encircles(number))[-1])
            last, found = (on, each) if on > last else (last, found)
    return found


def _worst_ring(rings: Sequence[RingResult]) -> RingResult:
    """Return the worst of all rings, value by value; of one that settled and left its limits, that which did last."""
    if not rings:
        return RingResult()
    left = max(rings, key=lambda each: each.unsettled_at_s or 0.0)

    def worst(of: Callable[[Iterable[ValueT]], ValueT], values: Iterable[ValueT | None]) -> ValueT | None:
        known = [each for each in values if each is not None]
        return of(known) if known else None

    settling_s = [each.settling_time_s for each in rings]
    from_s = [each.judged_from_s for each in rings]
    return RingResult(
        settling_time_s=None if None in settling_s else worst(max, settling_s),
        spacing_error_rms_deg=worst(max, (each.spacing_error_rms_deg for each in rings)),
        spacing_error_max_deg=worst(max, (each.spacing_error_max_deg for each in rings)),
        first_settled_at_s=left.first_settled_at_s,
        unsettled_at_s=left.unsettled_at_s,
        judged_s=worst(min, (each.judged_s for each in rings)),
        judged_from_s=None if None in from_s else worst(max, from_s),
        judged_share=worst(min, (each.judged_share for each in rings)),
        members_min=worst(min, (each.members_min for each in rings)),
    )


def _estimated(team: EstimateResult, record: FlightRecord, rings: Sequence[NamedRing]) -> EstimateResult:
    estimates = [each.result.estimate for each in rings]
    vehicles = [() if each is None else each.vehicles for each in estimates]
    return replace(
        team,
        vehicles=tuple(
            _of_last_ring(each.id, record, vehicles) or EstimatedVehicleResult(each.id) for each in team.vehicles
        ),
        ring=_worst_ring([each.ring for each in estimates if each is not None]),
    )
