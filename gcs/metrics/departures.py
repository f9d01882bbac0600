"""The vehicles that left formation or ring although neither an operator nor their mission sent them away.

Equations (8), (9) and (10) demand the ring of every vehicle: those that are left may keep it, and the team has not.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from agents.flight_end import FlightEnd
from agents.notes import AlertChange
from agents.safety.failsafe import TABLE, Reaction
from agents.tactics import NO_TACTIC, Event, Tactic
from gcs.metrics.ending import VehicleEnding, named
from gcs.metrics.record import FlightEvent, FlightRecord, VehicleTrack, grid_time
from gcs.metrics.ring import LOST_AFTER_S

_IN_PLACE = {Tactic.FORMATION.value: "formation", Tactic.ENCIRCLE.value: "ring", Tactic.TRANSIT.value: "ring"}
"""The places of a mission by the tactics that fly them; the way to a ring is one to it."""
_NEVER_ORDERED = (Tactic.ASIDE.value, Tactic.PILOT_OVERRIDE.value)
_ORDERED_ENDS = frozenset({
    FlightEnd.LANDED, FlightEnd.SIMULATED, FlightEnd.OPERATOR, FlightEnd.ABORTED, FlightEnd.KILLED, FlightEnd.UNKNOWN,
    FlightEnd.FLIES_ON,
})  # fmt: skip
"""The ends by order; of a killed vehicle an operator cut the motors."""
_FLIES_ON = frozenset(row.condition.value for row in TABLE if row.reactions == (Reaction.DEGRADE,))
_EVENT_GRAIN_S = 1e-3
"""Times of events are rounded to this."""
NO_DATA = "no data"
"""The cause where nothing more is known of a vehicle."""


@dataclass(frozen=True, slots=True)
class Departure:
    """A vehicle that left its place, `formation` or `ring`, not by order, or fell silent elsewhere in the `flight`.

    `cause` is a condition of the failsafe table, the tactic that took it away, how its flight ended, or `NO_DATA`.
    `back_at_s` is when it flew there again, None if it never did; one that left the formation may be on the ring.
    """

    vehicle: int
    at_s: float
    place: str
    cause: str
    back_at_s: float | None = None


def departures(record: FlightRecord) -> tuple[Departure, ...] | None:
    """Return the departures that were not by order, by time; None if no vehicle was in formation or on the ring.

    By order are operators' commands and the end of the mission. Not by order are reactions of the failsafe table, a
    pilot override, the end of a flight otherwise, as with its process, and that nothing is known of a vehicle for more
    than `LOST_AFTER_S` until the end of the record or until it is elsewhere, or in the air of one that joined from
    another process.
    """
    flown = [track for track in record.vehicles if np.isin(track.tactic, list(_IN_PLACE)).any()]
    silent = [each for each in record.endings if each.fell_silent]
    if not flown and not silent:
        return None
    found = [each for track in flown for each in _departures(record, track)]
    found += [_into_silence(record, each) for each in silent]
    return tuple(sorted(found, key=lambda each: (each.at_s, each.vehicle)))


def departures_line(found: Sequence[Departure] | None) -> str:
    """Return which vehicles left, when and why; empty if none was in formation or on the ring."""
    if found is not None and not found:
        return "no vehicle left its place"
    alike: dict[tuple[str, str], list[Departure]] = {}
    for each in found or ():
        alike.setdefault((each.place, each.cause), []).append(each)
    return "; ".join(_line(place, cause, each) for (place, cause), each in alike.items())


def _line(place: str, cause: str, alike: Sequence[Departure]) -> str:
    first_s, last_s = alike[0].at_s, alike[-1].at_s
    when = f"at {first_s:.1f} s" if first_s == last_s else f"from {first_s:.1f} to {last_s:.1f} s"
    returned_s = [each.back_at_s for each in alike if each.back_at_s is not None]
    back = f", back at {max(returned_s):.1f} s" if len(returned_s) == len(alike) else ""
    return f"{named(sorted({each.vehicle for each in alike}))} left the {place} {when} ({cause}){back}"


def _departures(record: FlightRecord, track: VehicleTrack) -> Iterator[Departure]:
    known = np.flatnonzero(track.tactic != NO_TACTIC)
    in_place = np.isin(track.tactic[known], list(_IN_PLACE))
    events = [event for event in record.events if event.vehicle == track.vehicle_id]
    ends = [each for each in record.endings if each.vehicle == track.vehicle_id and each.how not in _ORDERED_ENDS]
    fell_silent = any(each.fell_silent for each in ends)
    ended = next((each.reason or each.how.value for each in ends if not fell_silent), "")
    for leaves in np.flatnonzero(in_place[:-1] & ~in_place[1:]):
        before, after = known[leaves], known[leaves + 1]
        span_s = record.time_s[before] - _EVENT_GRAIN_S, record.time_s[after] + _EVENT_GRAIN_S
        then = [event for event in events if span_s[0] <= event.time_s <= span_s[1]]
        tactic = str(track.tactic[after])
        taken = _condition(then) or (tactic if tactic in _NEVER_ORDERED else "")
        is_silent = record.time_s[after] - record.time_s[before] > LOST_AFTER_S
        if cause := taken or ("" if any(map(_is_order, then)) else ended):
            yield _departure(record, track, before, after, cause)
        elif is_silent:  # another process brings it home, or its autopilot
            yield _departure(record, track, before, before, NO_DATA)
    last_s = float(record.time_s[known[-1]])
    # A later change of its tactic is the end of its mission: the record ends with that of the team.
    went_on = any(each.kind == "tactic" and each.time_s > last_s + _EVENT_GRAIN_S for each in events)
    if in_place[-1] and not (went_on or fell_silent):
        lost = NO_DATA if record.time_s[-1] - last_s > LOST_AFTER_S else ""
        if cause := ended or lost:
            yield _departure(record, track, known[-1], known[-1], cause)


def _into_silence(record: FlightRecord, ending: VehicleEnding) -> Departure:
    """Return the departure of a vehicle that joined and fell silent in the air, also after the mission's end."""
    heard_s = 0.0 if ending.heard_s is None else ending.heard_s
    tracks = (each for each in record.vehicles if each.vehicle_id == ending.vehicle and heard_s <= record.time_s[-1])
    place = next((_IN_PLACE[each.last_tactic] for each in tracks if each.last_tactic in _IN_PLACE), "flight")
    return Departure(ending.vehicle, grid_time(heard_s), place, ending.reason)


def _departure(record: FlightRecord, track: VehicleTrack, before: int, after: int, cause: str) -> Departure:
    left = str(track.tactic[before])
    back = after + 1 + np.flatnonzero(np.isin(track.tactic[after + 1 :], (left, Tactic.ENCIRCLE.value)))
    back_at_s = grid_time(float(record.time_s[back[0]])) if back.size else None
    return Departure(track.vehicle_id, grid_time(float(record.time_s[after])), _IN_PLACE[left], cause, back_at_s)


def _condition(events: Iterable[FlightEvent]) -> str:
    """Return the last condition of the failsafe table that took a vehicle away in these events; empty without one."""
    causes = [
        event.text if event.alert is None else event.alert.condition  # logs of earlier versions have the text only
        for event in events
        if event.kind == "failsafe" and (event.alert is None or _takes_away(event.alert))
    ]
    return causes[-1] if causes else ""


def _is_order(event: FlightEvent) -> bool:
    """Whether an operator commanded a vehicle, or its mission ended."""
    commanded = event.command is not None and not event.command.is_refused
    return commanded or (event.tactic is not None and event.tactic.event == Event.END.value)


def _takes_away(alert: AlertChange) -> bool:
    """Whether the vehicle leaves its place; the state that a vehicle of another process sends names no reaction."""
    reacts = alert.reaction != Reaction.DEGRADE.value if alert.reaction else alert.condition not in _FLIES_ON
    return reacts and not alert.is_over
