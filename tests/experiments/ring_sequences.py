"""Command random rings and assign random vehicles in missions of several rings, and measure separation and rings.

A seed determines the team and its rings, as in rings.py, and a sequence of commands: values of one ring, also reversals
and changes before the last one is flown, and vehicles assigned to rings, also to full ones. A ring that the operator's
check refuses is not sent. One vehicle receives a ring; the others have it from its states. Measured is the true motion;
speed, acceleration and settling are judged where the guard has not acted. Exit code 1 if a limit is exceeded.
"""

import sys
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from agents.team.messages import MISSION_RING, OperatorCommand
from gcs.metrics.record import FlightRecord, Mask
from gcs.metrics.references import ring_references
from gcs.metrics.ring import TOGETHER_S, RingMotion, off_ring, ring_motion
from gcs.metrics.transitions import predicted, transitions
from gcs.mission.mission import Mission
from gcs.preflight.mission import ring_change_faults
from tests.experiments.arguments import seeded_parser
from tests.experiments.judged import Measure, judged_flights
from tests.experiments.membership import separation_left_m
from tests.experiments.membership_scenes import Scene
from tests.experiments.random_joins import PLANT_OFF_MOST, recorded
from tests.experiments.ring_commands import (
    SETTLES_FACTOR,
    SETTLES_S,
    Changed,
    drawn_values,
    gentleness,
    verdict,
)
from tests.experiments.rings import conditions, kind_of, late, on_rings, place_faults, team
from tests.support.mission_text import parsed

VEHICLES = 7
FIRST_S, PAUSES_S = (55.0, 65.0), (2.0, 20.0)
"""When the first command is sent, all being on their rings, and how long after it the next one."""
REACHES_S, JUDGED_S = 65.0, 25.0
"""How long the last command takes at most, also to a ring far off, and how long the flight's end is judged."""
ASSIGNED_SHARE, FREE_SHARE = 0.4, 0.25
"""The share of commands that assign a vehicle, and that of those which let it choose."""


def drawn(seed: int) -> tuple[Scene, int]:
    """Return the mission of a seed with its commands, and how many commands the operator's check refused."""
    random = np.random.default_rng([22, seed])
    content = team(random, VEHICLES, PLANT_OFF_MOST)
    for ring in content["rings"]:
        # Simulated vehicles follow heights in missions whose rings have an altitude.
        ring.setdefault("altitude_m", 8.0)
    at_s = float(random.uniform(*FIRST_S))
    times_s = np.cumsum([at_s, *random.uniform(*PAUSES_S, int(random.integers(3, 7)))]).tolist()
    duration_s = times_s[-1] + REACHES_S + JUDGED_S
    content["mission"]["duration_s"] = duration_s
    mission = parsed(content)
    told, refused, flown = [], 0, [MISSION_RING] * len(mission.rings)
    for number, at_s in enumerate(times_s):
        ring = int(random.integers(len(mission.rings)))
        if random.random() < ASSIGNED_SHARE:
            goes_to = None if random.random() < FREE_SHARE else ring
            vehicle = int(random.choice(mission.ids))
            told.append(OperatorCommand(at_s, "assign", vehicle, "tower", number, ring_number=goes_to))
            continue
        values = drawn_values(random)
        if ring_change_faults(mission, values, flown, ring):
            refused += 1
            continue
        told.append(OperatorCommand(at_s, "ring", None, "tower", number, ring=values, ring_number=ring))
        flown[ring] = flown[ring].commanded(values, at_s)
    return Scene(mission, (), duration_s, times_s[0], told=tuple(told)), refused


def measured(seed: int) -> Changed:
    """Fly the commands of a seed, and measure."""
    scene, refused = drawn(seed)
    mission = scene.mission
    record, flight, guarded = recorded(scene, seed)
    settlings = [each for number in range(len(mission.rings)) for each in _settlings(scene, record, guarded, number)]
    on = on_rings(record)[:, late(record, JUDGED_S)]
    faults = place_faults(mission, on, np.ones(len(mission.ids), dtype=np.bool_))
    faults += _elsewhere(scene, on[:, -1])
    faults += [
        f"vehicle {each.vehicle}: {each.text}" for each in record.events if each.command and each.command.is_refused
    ]
    measures = (
        Measure("separation", separation_left_m(scene, flight), 0.0, "m", at_least=True),
        *conditions(mission, record, JUDGED_S),
        *_gentleness(mission, record, ~guarded & (record.time_s >= scene.from_s)),
    )
    rings = sum(each.verb == "ring" for each in scene.told)
    about = (
        f"{len(mission.ids)} vehicles, {len(mission.rings)} rings ({kind_of(mission)}), {rings} commanded, "
        f"{refused} refused, {len(scene.told) - rings} assignments, guard {guarded.mean():.1%}"
    )
    slow = tuple(each for each in settlings if each)
    return Changed(seed, about, measures, tuple(faults), rings, len(settlings), slow)


def _elsewhere(scene: Scene, on: "np.ndarray[tuple[int], np.dtype[np.intp]]") -> Iterator[str]:
    """Return which vehicles are in the end not on the rings that were assigned to them last, though all have places."""
    last = {each.vehicle: each.ring_number for each in scene.told if each.verb == "assign"}
    for number, ring in enumerate(scene.mission.rings):
        assigned = [each for each in scene.mission.ids if last.get(each) == number]
        if len(assigned) <= ring.places:
            away = [each for each in assigned if on[scene.mission.ids.index(each)] != number]
            yield from (f"vehicle {each} is not on {ring.name}, which was assigned to it" for each in away)


def _gentleness(mission: Mission, record: FlightRecord, where: Mask) -> Iterator[Measure]:
    """Return the largest speed and acceleration on any ring in some samples (V, T), as shares of their limits."""
    found = []
    for number, ring in enumerate(ring_references(mission, record)):
        alone = record.of_ring(number)
        motion = ring_motion(alone, ring.gaps)
        found.append(gentleness(alone, motion, motion.member & where, ring, mission.rings[number].encirclement))
    yield from (max(each, key=lambda measure: measure.value) for each in zip(*found, strict=True))


def _settlings(scene: Scene, record: FlightRecord, guarded: Mask, number: int) -> Iterator[str]:
    """Return for every change of a ring that was long enough flown why it settled too late, empty if it did not.

    A ring changes when it is commanded, when a vehicle comes or goes, and while the guard moves one (V, T).
    """
    mission = scene.mission
    alone, ring = record.of_ring(number), ring_references(mission, record)[number]
    motion, time_s = ring_motion(alone, ring.gaps), record.time_s
    evading_s = time_s[(guarded & motion.member).any(axis=0)].tolist()
    changes = list(_changes(alone, motion, [*ring.changed_s, *evading_s]))
    off, firsts_s = off_ring(time_s, motion, ring), [*(first_s for first_s, _ in changes[1:]), float(time_s[-1])]
    ends_s = dict(zip((last_s for _, last_s in changes), firsts_s, strict=False))
    config = mission.agent_config(mission.vehicles[0]).on_ring(number)
    for each in predicted(transitions(alone, motion, ring, list(ends_s)), alone, config, ring):
        begin_s = each.begins_at_s
        end_s = ends_s[min(ends_s, key=lambda at_s: abs(at_s - begin_s))]
        if begin_s < scene.from_s or each.settling_predicted_s is None:
            continue
        way_s = max((old.until_s + old.change_s - begin_s for old in ring.earlier if old.until_s <= begin_s), default=0)
        allowed_s = max(SETTLES_S, SETTLES_FACTOR * max(each.settling_predicted_s, way_s))
        if end_s - begin_s < allowed_s:
            continue
        missed = np.flatnonzero(off & (time_s >= begin_s) & (time_s < end_s))
        took_s = float(time_s[missed[-1]]) - begin_s if missed.size else 0.0
        took = (
            f"{mission.rings[number].name} of {each.members} at {begin_s:.1f} s took {took_s:.1f} of {allowed_s:.1f} s"
        )
        yield took if took_s > allowed_s else ""


def _changes(record: FlightRecord, motion: RingMotion, others_s: list[float]) -> Iterator[tuple[float, float]]:
    """Return the first and the last time of the changes of a ring that are together: of its members, and others."""
    changed = np.flatnonzero((motion.member[:, 1:] != motion.member[:, :-1]).any(axis=0)) + 1
    times_s = sorted({*record.time_s[changed].tolist(), *others_s})
    first_s = times_s[0] if times_s else np.inf
    for at_s, after_s in pairwise([*times_s, np.inf]):
        if after_s - at_s > TOGETHER_S:
            yield first_s, at_s
            first_s = after_s


if __name__ == "__main__":
    reader = seeded_parser("ring_sequences", __doc__, 100)
    given = reader.parse_args()
    sys.exit(verdict(judged_flights(measured, given.first, given.count)))
