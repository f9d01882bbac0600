"""The record of a team in a drill, and the check that the right vehicles, and no others, reacted as expected.

Pure: times are arguments, of one clock. Flight modes, setpoints and positions are observed at the
vehicles; tactics, alerts, radii and bearings are those that they report on the bus.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from math import degrees, hypot, tau
from typing import NamedTuple

from agents.ports import FlightMode
from agents.ring.place import Gaps, weights_of
from agents.tactics import Tactic
from estimation.frames import Triple

OFFBOARD = FlightMode.OFFBOARD.value
ON_MISSION = (Tactic.FORMATION.value, Tactic.ENCIRCLE.value)
NEAR_TOLERANCE_M = 0.3
SAME_HEIGHT_M = 1.0
PLACE_PERIOD_S = 0.02
IN_FLIGHT_S = 0.3
"""A setpoint sent before a pilot override may arrive within this time."""
ABANDONED_AFTER_S = 1.5
"""A vehicle in offboard has no agent if no message arrives for this time."""
UNEVEN_MAX_DEG = 25.0
RADIUS_SHARE = 0.2


class ReportedStatus(NamedTuple):
    """A vehicle's reported tactic and alert from a time on."""

    time_s: float
    tactic: str
    alert: str


class TeamPositions(NamedTuple):
    """Positions of the airborne vehicles at a time."""

    time_s: float
    position_m: dict[int, Triple]


@dataclass(slots=True)
class TeamLog:
    """All observations so far, by vehicle: changes of modes and reports, and all other samples.

    `gaps` are the weights of the wanted gaps on the ring.
    """

    gaps: Gaps = field(default_factory=dict)
    modes: defaultdict[int, list[tuple[float, str]]] = field(default_factory=lambda: defaultdict(list))
    reported: defaultdict[int, list[ReportedStatus]] = field(default_factory=lambda: defaultdict(list))
    received_s: dict[int, float] = field(default_factory=dict)
    setpoint_s: dict[int, float] = field(default_factory=dict)
    places: list[TeamPositions] = field(default_factory=list)
    radii_m: defaultdict[int, list[tuple[float, float]]] = field(default_factory=lambda: defaultdict(list))
    bearings_rad: dict[int, tuple[float, float]] = field(default_factory=dict)
    unaccounted_s: dict[int, float] = field(default_factory=dict)
    """When vehicles were first reported as unaccounted for."""

    def note_mode(self, time_s: float, vehicle: int, mode: str) -> None:
        """Record a flight mode."""
        if self.mode(vehicle) != mode:
            self.modes[vehicle].append((time_s, mode))

    def note_status(self, time_s: float, vehicle: int, tactic: str, alert: str) -> None:
        """Record a vehicle's report."""
        self.received_s[vehicle] = time_s
        if (self.tactic(vehicle), self.alert(vehicle)) != (tactic, alert):
            self.reported[vehicle].append(ReportedStatus(time_s, tactic, alert))

    def note_places(self, time_s: float, position_m: dict[int, Triple]) -> None:
        """Record the positions of the airborne vehicles."""
        if not self.places or time_s - self.places[-1].time_s >= PLACE_PERIOD_S:
            self.places.append(TeamPositions(time_s, position_m))

    def mode(self, vehicle: int) -> str:
        """Return the present flight mode, empty if unknown."""
        return self.modes[vehicle][-1][1] if self.modes[vehicle] else ""

    def tactic(self, vehicle: int) -> str:
        """Return the tactic last received."""
        return self.reported[vehicle][-1].tactic if self.reported[vehicle] else ""

    def alert(self, vehicle: int) -> str:
        """Return the alert last received."""
        return self.reported[vehicle][-1].alert if self.reported[vehicle] else ""

    def state(self, vehicle: int) -> str:
        """Return mode, tactic and alert as text."""
        alert = f", {self.alert(vehicle)}" if self.alert(vehicle) else ""
        return f"{self.mode(vehicle) or 'mode unknown'}, {self.tactic(vehicle) or 'no message received'}{alert}"

    def nearest_m(self, from_s: float, to_s: float) -> tuple[float, tuple[int, int]] | None:
        """Return the smallest distance of two vehicles at one height, and their ids; None if there were none."""
        near = (
            (hypot(here[0] - there[0], here[1] - there[1]), (one, other))
            for place in self.places
            if from_s <= place.time_s <= to_s
            for (one, here), (other, there) in combinations(sorted(place.position_m.items()), 2)
            if abs(here[2] - there[2]) < SAME_HEIGHT_M
        )
        return min(near, default=None)

    def uneven_deg(self, vehicles: tuple[int, ...]) -> float | None:
        """Return by how much a gap on the ring exceeds the wanted one, at most; None if one of them is not on it."""
        if any(each not in self.bearings_rad or self.tactic(each) != Tactic.ENCIRCLE.value for each in vehicles):
            return None
        placed = sorted((self.bearings_rad[each][1] % tau, each) for each in vehicles)
        bearings, weights = [bearing for bearing, _ in placed], weights_of((each for _, each in placed), self.gaps)
        after, unit_rad = [*bearings[1:], bearings[0] + tau], tau / sum(weights)
        ways = zip(bearings, after, weights, strict=True)
        return degrees(max(there - here - weight * unit_rad for here, there, weight in ways))


@dataclass(frozen=True, slots=True)
class Expectation:
    """The expected reaction to a fault: which vehicles react, how, within which time, and which fly on.

    A reaction is a tactic, an alert, leaving offboard, or the report that it is unaccounted for; without one all
    vehicles fly on until the drill ends.
    `limits_s` are tighter limits of single vehicles. With `stands_back` no more setpoints are sent to them;
    `at_last` is their final tactic. The gaps on the ring between the vehicles of `respacing` become as wanted.
    """

    reacting: tuple[int, ...]
    flying_on: tuple[int, ...]
    limit_s: float | None
    limits_s: Mapping[int, float] = field(default_factory=dict)
    tactic: str | None = None
    alert: str | None = None
    leaves_offboard: bool = False
    is_unaccounted: bool = False
    stands_back: bool = False
    at_last: str | None = None
    respacing: tuple[int, ...] = ()
    separation_m: float = 0.0
    radius_m: float | None = None

    @property
    def is_reaction(self) -> bool:
        """Whether a reaction is expected at all."""
        return self.leaves_offboard or self.is_unaccounted or self.tactic is not None or self.alert is not None


def reacted_s(expected: Expectation, log: TeamLog, began_s: float) -> float | None:
    """Return when the last of the reacting vehicles had reacted, None if one has not."""
    times = [_one_reacted_s(expected, log, each, began_s) for each in expected.reacting]
    known = [time_s for time_s in times if time_s is not None]
    return max(known, default=began_s) if len(known) == len(times) else None


def failures(expected: Expectation, log: TeamLog, began_s: float, until_s: float) -> list[str]:
    """Return all deviations from the expectation between `began_s` and `until_s`, one line each."""
    found: list[str] = []
    done_s = reacted_s(expected, log, began_s)
    if expected.is_reaction and done_s is None:
        late = [i for i in expected.reacting if _one_reacted_s(expected, log, i, began_s) is None]
        found += [f"vehicle {i} did not react: {log.state(i)}" for i in late]
    found += _late(expected, log, began_s)
    if done_s is not None:
        found += _relapses(expected, log, done_s)
    found += _others(expected, log, began_s)
    found += [] if respaced(expected.respacing, log) else ["the others did not close the gap on the ring"]
    found += _too_near(expected, log, began_s, until_s)
    found += _off_the_ring(expected, log, began_s)
    found += [
        f"vehicle {i} is in offboard without an agent"
        for i in sorted(log.modes)
        if log.mode(i) == OFFBOARD and until_s - log.received_s.get(i, 0.0) > ABANDONED_AFTER_S
    ]
    return found


def _late(expected: Expectation, log: TeamLog, began_s: float) -> list[str]:
    """Return which vehicles reacted, but later than their own limits."""
    took_s = {i: (_one_reacted_s(expected, log, i, began_s) or began_s) - began_s for i in expected.limits_s}
    return [
        f"vehicle {i} reacted after {took_s[i]:.1f} s, not within {limit_s:g} s"
        for i, limit_s in expected.limits_s.items()
        if took_s[i] > limit_s
    ]


def _one_reacted_s(expected: Expectation, log: TeamLog, vehicle: int, began_s: float) -> float | None:
    times = [began_s]
    if expected.leaves_offboard:
        times.append(_since_s([(at_s, mode != OFFBOARD) for at_s, mode in log.modes[vehicle]], began_s))
    if expected.is_unaccounted:
        times.append(log.unaccounted_s.get(vehicle, float("inf")))
    if expected.tactic is not None:
        times.append(
            _since_s([(each.time_s, each.tactic == expected.tactic) for each in log.reported[vehicle]], began_s)
        )
    if expected.alert is not None:
        times.append(_since_s([(each.time_s, each.alert == expected.alert) for each in log.reported[vehicle]], began_s))
    return max(times) if max(times) < float("inf") else None


def _since_s(changes: list[tuple[float, bool]], began_s: float) -> float:
    """Return when something first became true after the fault, infinity if it did not; earlier changes are ignored."""
    return next((at_s for at_s, is_so in changes if is_so and at_s >= began_s), float("inf"))


def _relapses(expected: Expectation, log: TeamLog, done_s: float) -> list[str]:
    found = []
    for i in expected.reacting:
        if expected.leaves_offboard and any(mode == OFFBOARD and at_s > done_s for at_s, mode in log.modes[i]):
            found.append(f"vehicle {i} returned to offboard by itself")
        back = [each.tactic for each in log.reported[i] if each.time_s > done_s and each.tactic in ON_MISSION]
        if back and expected.tactic is not None:
            found.append(f"vehicle {i} returned to '{back[0]}' by itself")
        late_s = log.setpoint_s.get(i, 0.0) - done_s
        if expected.stands_back and late_s > IN_FLIGHT_S:
            found.append(f"vehicle {i} was sent a setpoint {late_s:.1f} s after the pilot override")
        if expected.at_last is not None and log.tactic(i) != expected.at_last:
            found.append(f"vehicle {i} ended at '{log.tactic(i)}', not at '{expected.at_last}'")
    return found


def respaced(vehicles: tuple[int, ...], log: TeamLog) -> bool:
    """Return whether the gaps between vehicles on the ring are as wanted."""
    if len(vehicles) < 2:
        return True
    uneven_deg = log.uneven_deg(vehicles)
    return uneven_deg is not None and uneven_deg <= UNEVEN_MAX_DEG


def _others(expected: Expectation, log: TeamLog, began_s: float) -> list[str]:
    """Return which vehicles changed tactic or mode although they should fly on."""
    found = []
    for i in expected.flying_on:
        before = [each for each in log.reported[i] if each.time_s < began_s]
        after = [each for each in log.reported[i] if each.time_s >= began_s]
        changed = [each for each in after if before and each.tactic != before[-1].tactic]
        if changed:
            found.append(f"vehicle {i} went from '{before[-1].tactic}' to '{changed[0].tactic}' ({changed[0].alert})")
        left = [mode for at_s, mode in log.modes[i] if at_s >= began_s and mode != OFFBOARD]
        if left:
            found.append(f"vehicle {i} left offboard for {left[0]}")
    return found


def _too_near(expected: Expectation, log: TeamLog, began_s: float, until_s: float) -> list[str]:
    nearest = log.nearest_m(began_s, until_s)
    if nearest is None or nearest[0] >= expected.separation_m - NEAR_TOLERANCE_M:
        return []
    (one, other) = nearest[1]
    return [f"vehicles {one} and {other} came within {nearest[0]:.2f} m of each other"]


def _off_the_ring(expected: Expectation, log: TeamLog, began_s: float) -> list[str]:
    if expected.radius_m is None:
        return []
    found = []
    for i, radii in sorted(log.radii_m.items()):
        off_m = max((abs(radius_m - expected.radius_m) for at_s, radius_m in radii if at_s >= began_s), default=0.0)
        if off_m > RADIUS_SHARE * expected.radius_m:
            found.append(f"vehicle {i} was {off_m:.1f} m off the ring")
    return found
