"""Command random rings in flight, and measure how gently and how soon they are flown, and the separation.

A seed determines the mission, as in random_joins.py, and two to six commands of radius, rate or both, also reversals
and commands before the last one is flown. One vehicle receives a command; the others have it from its states. Measured
is the true motion. Exit code 1 if a limit is exceeded.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, sqrt

import numpy as np
from msgspec.structs import asdict, astuple

from agents.ring.commanded_ring import ring_refusal
from agents.ring.feasibility import RESERVE
from agents.ring.transition import transition_of
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from agents.team.messages import OperatorCommand, RingValues
from estimation.state import Vector
from gcs.metrics.record import FlightRecord, Mask
from gcs.metrics.references import DesiredRing, ring_reference
from gcs.metrics.ring import RingMotion, off_ring, on_ring, ring_motion
from gcs.metrics.transitions import overshoot_deg, relative_motion
from tests.experiments.arguments import parser
from tests.experiments.judged import Judged, Measure, judged_flights
from tests.experiments.membership import separation_left_m
from tests.experiments.membership_scenes import Scene
from tests.experiments.random_joins import BOUND_SHARE, OVERSHOOT_DEG, drawn, recorded

RADII_M, SPEEDS_M_S = (6.0, 25.0), (0.3, 2.0)
ALTITUDES_M, TILTS_DEG = (5.0, 25.0), (-25.0, 25.0)
PAUSES_S = (3.0, 60.0)
SETTLES_S, SETTLES_FACTOR = 20.0, 1.3
"""A commanded ring settles within the first, or the second times the least time with the bounds of a transition."""
IN_TIME_SHARE = 0.98


def commanded(seed: int) -> Scene:
    """Return the mission of a seed without latecomers and leavers, and its commands."""
    scene, random = drawn(seed), np.random.default_rng([14, seed])
    # Simulated vehicles follow heights in missions whose ring has an altitude.
    heights = {"altitude_m": 8.0, "tilt_bearing_deg": float(random.uniform(0.0, 360.0))}
    mission = scene.mission.replace(encirclement=heights)
    configs = [mission.agent_config(vehicle) for vehicle in mission.vehicles]
    told, at_s = [], scene.from_s + float(random.uniform(30.0, 60.0))
    for number in range(int(random.integers(2, 7))):
        values = _values(random, configs, mission.target.motion.speed_max_m_s, mission.sensor(1).range_m)
        told.append(OperatorCommand(at_s, "ring", None, "tower", number, ring=values))
        configs = [each.with_ring(*astuple(values)) for each in configs]
        at_s += float(random.uniform(*PAUSES_S))
    return Scene(mission, (), at_s + 60.0, scene.from_s, told=tuple(told))


def _values(
    random: np.random.Generator, configs: Sequence[AgentConfig], target_m_s: float, range_m: float
) -> RingValues:
    """Return values of a ring that all vehicles can fly about their target, and see it from there."""
    while True:
        values = drawn_values(random)
        wanted = [each.with_ring(*astuple(values)) for each in configs]
        ring = wanted[0].encirclement
        along_m_s = abs(ring.angular_rate_rad_s) * ring.radius_m
        if (
            ring.radius_m < RESERVE * range_m
            and along_m_s + target_m_s <= RESERVE * ring.speed_max_m_s
            and along_m_s**2 / ring.radius_m <= RESERVE * ring.acceleration_max_m_s2
            and not any(ring_refusal(each, inf) for each in wanted)
        ):
            return values


def drawn_values(random: np.random.Generator) -> RingValues:
    """Return values of a ring, which need not be possible: radius or rate or both, and perhaps altitude and tilt."""
    radius_m = float(random.uniform(*RADII_M))
    rate_rad_s = float(random.uniform(*SPEEDS_M_S) * random.choice([-1.0, 1.0]) / radius_m)
    which = random.integers(3)
    altitude_m, tilt_deg = (float(random.uniform(*each)) for each in (ALTITUDES_M, TILTS_DEG))
    return RingValues(
        None if which == 0 else radius_m,
        None if which == 1 else rate_rad_s,
        altitude_m if random.random() < 0.5 else None,
        tilt_deg if random.random() < 0.5 else None,
    )


def least_s(before: Vector, after: Vector, config: AgentConfig) -> float:
    """Return the least time from one ring to another (radius, rate), from rest to rest within a transition's bounds."""
    bounds = transition_of(config.with_ring(*after).encirclement)
    way_m = abs(after[0] - before[0])
    quick_m = bounds.speed_m_s**2 / bounds.acceleration_m_s2
    way_s = 2.0 * sqrt(way_m / bounds.acceleration_m_s2)
    if way_m > quick_m:
        way_s = way_m / bounds.speed_m_s + bounds.speed_m_s / bounds.acceleration_m_s2
    change_m_s = abs(float(after[0] * after[1] - before[0] * before[1]))
    return max(way_s, change_m_s / bounds.acceleration_m_s2)


@dataclass(frozen=True)
class Changed(Judged):
    """One flight: how many rings were commanded and long enough flown to be judged, and which of them took too long.

    Speed and acceleration are shares of the limits of the encirclement. The separation is what is left of it.
    """

    commands: int = 0
    judged: int = 0
    late: tuple[str, ...] = ()

    @property
    def reasons(self) -> list[str]:
        """What misses its limit."""
        return [*super().reasons, *self.late]


def measured(seed: int) -> Changed:
    """Fly the commands of a seed, and measure."""
    scene = commanded(seed)
    record, flight, _ = recorded(scene, seed)
    ring = ring_reference(scene.mission, record.events)
    motion = ring_motion(record, ring.gaps)
    # Before the first command it is a flight of random_joins.
    member = motion.member & (record.time_s >= scene.told[0].time_s)
    config = scene.mission.agent_config(scene.mission.vehicles[0])
    settlings = list(_settlings(record, motion, ring, config))
    on = on_ring(record.time_s, replace(motion, member=member), ring)
    overshot_deg = max((overshoot_deg(motion, on, span) or 0.0 for span in _spans(record.time_s, ring)), default=0.0)
    measures = (
        Measure("overshoot", overshot_deg, OVERSHOOT_DEG, "deg"),
        *gentleness(record, motion, member, ring, scene.mission.encirclement),
        Measure("separation", separation_left_m(scene, flight), 0.0, "m", at_least=True),
    )
    commands = len(ring.earlier)
    faults = ("no command was long enough flown to be judged",) if commands and not settlings else ()
    about, late = f"n {len(scene.mission.ids)}, {commands} commands", tuple(words for words in settlings if words)
    return Changed(seed, about, measures, faults, commands, len(settlings), late)


def gentleness(
    record: FlightRecord, motion: RingMotion, member: Mask, ring: DesiredRing, settings: EncirclementSettings
) -> tuple[Measure, Measure]:
    """Return the largest speed and acceleration of members (V, T) of a ring, as shares of their limits."""
    relative = relative_motion(record, motion, ring)
    limits = (
        ("speed share", relative.speed_m_s, settings.speed_max_m_s),
        ("acceleration share", relative.acceleration_m_s2, settings.acceleration_max_m_s2),
    )
    first, second = (Measure(name, _most(values, member) / most, BOUND_SHARE) for name, values, most in limits)
    return first, second


def _spans(time_s: Vector, ring: DesiredRing) -> Iterator[slice]:
    """Return the samples from each commanded ring to the next."""
    edges = [*np.searchsorted(time_s, ring.changed_s).tolist(), time_s.size]
    return (slice(begin, end) for begin, end in pairwise(edges))


def _climbs_s(record: FlightRecord, ring: DesiredRing, config: AgentConfig) -> Iterator[float]:
    """Return the least time of the climb to each commanded ring."""
    noted, before = {each.time_s: each.ring for each in record.events if each.ring is not None}, config.encirclement
    for at_s in ring.changed_s:
        after = before.model_copy(update=asdict(noted[at_s]))
        tilts_m = before.rise_m + after.rise_m if after.tilt_deg != before.tilt_deg else 0.0
        yield (abs((after.altitude_m or 0.0) - (before.altitude_m or 0.0)) + tilts_m) / after.climb_max_m_s
        before = after


def _settlings(record: FlightRecord, motion: RingMotion, ring: DesiredRing, config: AgentConfig) -> Iterator[str]:
    """Return for every ring that was commanded long enough why it settled too late, empty if it did not."""
    time_s = record.time_s
    off = off_ring(time_s, motion, ring)
    desired = np.stack([ring.over_m(time_s), ring.over_rad_s(time_s)], axis=1)
    for span, climb_s in zip(_spans(time_s, ring), _climbs_s(record, ring, config), strict=True):
        before, after = desired[span.start - 1], desired[span.start]
        allowed_s = max(SETTLES_S, SETTLES_FACTOR * max(least_s(before, after, config), climb_s))
        if time_s[span.stop - 1] - time_s[span.start] < allowed_s:
            continue
        last = np.flatnonzero(off[span])
        took_s = float(time_s[span.start + last[-1]] - time_s[span.start]) if last.size else 0.0
        late = f"{before.round(2).tolist()} -> {after.round(2).tolist()} took {took_s:.1f} of {allowed_s:.1f} s"
        yield late if took_s > allowed_s else ""


def _most(values: Vector, where: Mask) -> float:
    return float(np.nanmax(values[where], initial=0.0))


def verdict(flights: Sequence[Changed]) -> int:
    """Print how many rings settled in time; return 1 if too few did, or two vehicles came too near, else 0."""
    judged, late = sum(each.judged for each in flights), sum(len(each.late) for each in flights)
    commands = sum(each.commands for each in flights)
    print(f"{commands} rings commanded in {len(flights)} flights, {judged} long enough to settle")
    print(f"settled in time: {1.0 - late / max(judged, 1):.1%}")
    separated = all(each.value("separation") >= 0.0 for each in flights)
    return 0 if separated and late <= (1.0 - IN_TIME_SHARE) * judged else 1


if __name__ == "__main__":
    reader = parser("ring_commands", __doc__)
    reader.add_argument("count", nargs="?", type=int, default=100, help="number of seeds (default: %(default)s)")
    reader.add_argument("--seed", type=int, default=0, help="first seed (default: %(default)s)")
    reader.add_argument("--list", action="store_true", help="print every flight")
    given = reader.parse_args()
    sys.exit(verdict(judged_flights(measured, given.seed, given.count, listed=given.list)))
