"""Join rings on random missions, and measure how gently: overshoot, speed, acceleration, settling, separation.

A seed determines the team and its formation, plants, ring, target, and who comes late or leaves. Half of the missions
fly the stub without noise; half fly plants that are up to 15 % off the plant file, with the noise and delay of
case2-field. Measured is the true motion. Exit code 1 if a limit is exceeded.
"""

import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from math import cos, inf, pi, sin, tau
from typing import NamedTuple

import numpy as np

from agents.outputs import TickOutput
from agents.ring.place import chord_m
from agents.ring.transition import transition_of
from agents.settings.shapes import SHAPES, SPACED_SHAPES, Shape, offset_m
from agents.tactics import NO_TACTIC
from agents.team.messages import OperatorCommand
from estimation.state import POSITION, VELOCITY, Vector
from gcs.metrics.record import FlightEvent, FlightRecord, LoopStatistics, Mask, TargetPath, VehicleTrack, in_order
from gcs.metrics.references import ring_reference
from gcs.metrics.ring import SETTLED_RADIUS_FRACTION, SETTLED_SPACING_RAD, RingMotion, on_ring, ring_motion
from gcs.metrics.targets import ring_targets_of, targets_of
from gcs.metrics.transitions import ACCELERATION_SPAN_S, RelativeMotion, overshoot_deg, relative_motion
from gcs.mission.mission import Mission
from sitl.simulation.simulation import Absence, SimulatedFlight
from tests.experiments.arguments import parser
from tests.experiments.membership import separation_left_m, settled_s
from tests.experiments.membership_scenes import FIELD, Scene, beside_target, drawn_rate, flown
from tests.support.mission_text import CASE2, Content, content, drawn_vehicle, parsed
from tests.support.paths import MISSIONS

SIZES = ((2, 3), (4, 6), (7, 12))
PLANT_OFF_MOST = 0.15
LIMITS_M_S = ((3.0, 2.0, 5.0), (4.0, 3.0, 6.0))
"""Speed and acceleration of the encirclement, and the speed of the guard: of most bundled missions, of case3-turns."""
ENGAGED_WITHIN_S = 110.0
SETTLES_S = 90.0

GUARD_ACTS_S = 3.0
"""A vehicle that the guard has moved backwards is not on its way forwards again sooner."""
OVERSHOOT_DEG, BOUND_SHARE, BACKWARDS_M_S = 5.0, 1.1, -0.1
SETTLES_LEAST_S, SETTLES_FACTOR = 20.0, 1.3
CLEARED, BENT_RAD = 4.0, pi / 2.0
"""The ring is bent around a vehicle that has left and is nearer to it than so many separations. Radii are not judged up
to a quarter turn away: the farther out that vehicle is, and the less it is known where, the higher and wider the bend.
"""
OVERSHOOT_SHARE, BOUNDS_SHARE, SETTLED_SHARE = 0.01, 0.02, 0.98


class Fleet(NamedTuple):
    """Slots relative to the leader's, and the shape that they form."""

    shape: Shape
    leader: int
    spacing_m: float
    slots_m: list[tuple[float, float]]


def drawn(seed: int) -> Scene:
    """Return the mission of a seed: the first draw in which every vehicle of the formation comes near the target."""
    random = np.random.default_rng(seed)
    count, noisy = int(random.integers(*SIZES[random.integers(len(SIZES))], endpoint=True)), bool(random.random() < 0.5)
    near_m = float(random.uniform(12.0, 40.0))
    while (scene := _tried(random, f"joins {seed}", count, near_m, noisy=noisy)) is None:
        pass
    return scene


def _tried(random: np.random.Generator, name: str, count: int, near_m: float, *, noisy: bool) -> Scene | None:
    separation_m = float(random.uniform(2.0, 3.5))
    radius_m = max(float(random.uniform(8.0, 20.0)), 1.3 * separation_m / chord_m(1.0, count))
    ring_m_s = drawn_rate(random, 0.8, 2.0)
    speed_m_s, acceleration_m_s2, guard_m_s = LIMITS_M_S[int(random.random() < 0.2 or abs(ring_m_s) > 1.8)]
    fleet = _fleet(random, count, separation_m * float(random.uniform(1.2, 2.0)))
    formation_m_s = float(random.uniform(0.2, 1.0))
    velocity_m_s = _velocity_m_s(random, min(1.0, 0.9 * speed_m_s - abs(ring_m_s)))
    met_s, off_rad = float(random.uniform(5.0, 30.0)), float(random.uniform(-pi / 3.0, pi / 3.0))
    target_m = (
        float(formation_m_s * met_s + near_m * cos(off_rad) - velocity_m_s[0] * met_s),
        float(near_m * sin(off_rad) - velocity_m_s[1] * met_s),
    )
    engaged_s = _engaged_s(fleet.slots_m, (formation_m_s - velocity_m_s[0], -velocity_m_s[1]), target_m, near_m - 1.0)
    if engaged_s > ENGAGED_WITHIN_S:
        return None

    mission = content(FIELD if noisy else CASE2)
    mission["mission"] |= {"name": name}
    mission["formation"] |= {
        "spacing_m": fleet.spacing_m,
        "speed_m_s": formation_m_s,
        "leader": fleet.leader + 1,
        "shape": fleet.shape,
    }
    mission["encirclement"] |= {
        "radius_m": radius_m,
        "angular_rate_rad_s": ring_m_s / radius_m,
        "speed_max_m_s": speed_m_s,
        "acceleration_max_m_s2": acceleration_m_s2,
    }
    mission["decision"]["distance_max_m"] = near_m
    mission["safety"] |= {"separation_m": separation_m, "speed_max_m_s": guard_m_s}
    mission["target"] |= {"start_m": list(target_m), "velocity_m_s": list(velocity_m_s)}
    mission["target"]["sensor"]["range_m"] = near_m + float(random.uniform(2.0, 20.0))
    mission["vehicles"] = [
        _vehicle(random, place, slot_m, free=fleet.shape == "free", noisy=noisy, separation_m=separation_m)
        for place, slot_m in enumerate(fleet.slots_m)
    ]
    return _scene(random, mission, engaged_s)


def _fleet(random: np.random.Generator, count: int, spacing_m: float) -> Fleet:
    shape: Shape = SHAPES[random.integers(len(SHAPES))]
    leader = int(random.integers(count))
    if shape in SPACED_SHAPES:
        return Fleet(shape, leader, spacing_m, [offset_m(shape, place, leader, spacing_m) for place in range(count)])
    slots_m: list[tuple[float, float]] = []
    while len(slots_m) < count:
        x, y = (float(each) for each in random.uniform(-1.0, 1.0, 2) * spacing_m * count**0.5)
        if all(np.hypot(x - other_x, y - other_y) >= spacing_m for other_x, other_y in slots_m):
            slots_m.append((x, y))
    lead_x, lead_y = slots_m[leader]
    return Fleet(shape, leader, spacing_m, [(x - lead_x, y - lead_y) for x, y in slots_m])


def _velocity_m_s(random: np.random.Generator, most_m_s: float) -> tuple[float, float]:
    """Return the velocity of the target, which rests in a third of the draws."""
    if random.random() < 1.0 / 3.0:
        return 0.0, 0.0
    speed_m_s, course_rad = random.uniform(0.0, most_m_s), random.uniform(0.0, tau)
    return float(speed_m_s * cos(course_rad)), float(speed_m_s * sin(course_rad))


def _engaged_s(
    slots_m: Sequence[tuple[float, float]], drift_m_s: tuple[float, float], target_m: tuple[float, float], near_m: float
) -> float:
    """Return when the last slot has come near the target, inf if one never does; `drift_m_s` is relative to it."""
    time_s = np.arange(0.0, ENGAGED_WITHIN_S + 1.0, 0.5)
    away_m = np.add(slots_m, np.multiply.outer(time_s, drift_m_s)[:, None]) - target_m
    near = np.linalg.norm(away_m, axis=2) < near_m
    return float(time_s[near.argmax(axis=0)].max()) if near.any(axis=0).all() else inf


def _vehicle(
    random: np.random.Generator,
    place: int,
    slot_m: tuple[float, float],
    *,
    free: bool,
    noisy: bool,
    separation_m: float,
) -> Content:
    x, y = np.add(slot_m, random.uniform(-0.05, 0.05, 2) * separation_m).tolist()
    vehicle = drawn_vehicle(random, place, (x, y), PLANT_OFF_MOST)
    if not noisy:
        del vehicle["profile"], vehicle["true_scale"]
    return vehicle | {"slot_m": list(slot_m)} if free else vehicle


def _scene(random: np.random.Generator, mission: Content, last_s: float) -> Scene:
    """Return the scene with latecomers and leavers, in a third of the draws each."""
    ids = [int(each) for each in random.permutation(len(mission["vehicles"])) + 1]
    absences, told = [], []
    if random.random() < 1.0 / 3.0:
        last_s += float(random.uniform(10.0, 60.0))
        bearing_rad = float(random.uniform(0.0, tau))
        for vehicle_id in ids[: int(random.integers(1, min(3, len(ids) - 1), endpoint=True))]:
            place_m = beside_target(mission, last_s, bearing_rad, _off_ring_m(random, mission))
            absences.append(Absence(vehicle_id, 0.0, last_s, place_m))
            last_s, bearing_rad = (
                last_s + float(random.uniform(2.0, 40.0)),
                bearing_rad + float(random.uniform(1.0, 2.6)),
            )
        last_s = absences[-1].to_s
    if random.random() < 1.0 / 3.0:
        last_s += float(random.uniform(50.0, 90.0))
        for number, vehicle_id in enumerate(ids[-int(random.integers(1, min(2, len(ids) - 1), endpoint=True)) :]):
            last_s += number * float(random.uniform(2.0, 40.0))
            verb = random.choice(["lost", "hold", "land"])
            if verb == "lost":
                absences.append(Absence(vehicle_id, last_s, inf))
            else:
                told.append(OperatorCommand(last_s, "hold" if verb == "hold" else "land", vehicle_id, "tower", number))
    mission["mission"]["duration_s"] = last_s + SETTLES_S
    return Scene(parsed(mission, MISSIONS), tuple(absences), last_s + SETTLES_S, last_s, told=tuple(told))


def _off_ring_m(random: np.random.Generator, mission: Content) -> float:
    """Return the distance from the target at which a latecomer appears: outside the ring if it engages there."""
    ring_m, near_m = mission["encirclement"]["radius_m"], mission["decision"]["distance_max_m"] - 1.0
    outside_m = ring_m + mission["safety"]["separation_m"] + 1.0
    if near_m > outside_m:
        return float(random.uniform(outside_m, near_m))
    return float(random.uniform(0.3, 0.6) * ring_m)


def recorded(scene: Scene, seed: int) -> tuple[FlightRecord, SimulatedFlight, Mask]:
    """Fly a scene and return its true record, and where (V, T) the guard has acted in the last `GUARD_ACTS_S`.

    A vehicle without an agent has no tactic.
    """
    mission, has_rings = scene.mission, len(scene.mission.rings) > 1
    tactics = np.full((len(mission.ids), round(scene.duration_s * mission.mission.rate_hz) + 1), NO_TACTIC, "<U16")
    guarded = np.zeros(tactics.shape, dtype=np.bool_)
    rings = np.zeros(tactics.shape, dtype=np.intp)
    events = list[FlightEvent]()
    acts = round(GUARD_ACTS_S * mission.mission.rate_hz)

    def observe(tick: int, vehicle: int, output: TickOutput) -> None:
        status = output.status
        tactics[vehicle, tick], rings[vehicle, tick] = status.tactic.value, status.ring
        events.extend(FlightEvent.of(status.vehicle_id, note) for note in status.notes)
        if status.guarded is not None and status.guarded.causes:
            guarded[vehicle, tick : tick + acts] = True

    flight = flown(scene, seed, observe)
    position_m, velocity_m_s = mission.target.motion.over(flight.time_s)
    record = FlightRecord(
        mission=mission.mission.name,
        seed=seed,
        source="simulation",
        reference="truth",
        time_s=flight.time_s,
        target_position_m=position_m,
        target_velocity_m_s=velocity_m_s,
        vehicles=tuple(
            VehicleTrack(vehicle_id, motion[:, POSITION], motion[:, VELOCITY], tactic, ring=ring if has_rings else None)
            for vehicle_id, motion, tactic, ring in zip(
                mission.ids, flight.motion.swapaxes(0, 1), tactics, rings, strict=True
            )
        ),
        loop=LoopStatistics(mission.mission.rate_hz, flight.tick_us.size, 0),
        wall_time_s=0.0,
        events=in_order(events),
        targets=tuple(TargetPath(*each.motion.over(flight.time_s)) for each in targets_of(mission)),
        ring_targets=ring_targets_of(mission),
    )
    return record, flight, guarded


class Settling(NamedTuple):
    """How long a ring took to settle after a vehicle engaged or left at `at_s`, and how long it may take.

    `took_s` is None if the next vehicle engaged or left before it could settle, inf if it did not settle at all.
    `allowed_s` assumes that a vehicle flies to its place at the limits of the encirclement, also backwards. `gentle_s`
    assumes that all keep the bounds of a transition along the ring and that none flies backwards, as measured here.
    """

    at_s: float
    took_s: float | None
    allowed_s: float
    gentle_s: float

    @property
    def in_time(self) -> bool:
        return self.took_s is None or self.took_s <= self.allowed_s

    @property
    def gently_in_time(self) -> bool:
        return self.took_s is None or self.took_s <= self.gentle_s


class Ring:
    """The members of the ring of a flight, shape (V, T) each, while the set of members is the same: a span.

    A vehicle is a member while it encircles, and `on` the ring from when it first reaches the radius after the mixing
    with the formation: one that engages there has the formation's velocity, in whatever direction.
    """

    def __init__(self, record: FlightRecord, mission: Mission) -> None:
        self.settings, self.separation_m = mission.encirclement, mission.safety.separation_m
        reference = ring_reference(mission)
        self.time_s = record.time_s
        self.motion: RingMotion = ring_motion(record)
        self.relative: RelativeMotion = relative_motion(record, self.motion, reference)
        self.off_share = np.abs(self.motion.radius_m / reference.radius_m - 1.0)
        mixed = round(self.settings.smoothing_time_s * mission.mission.rate_hz)
        self.on = on_ring(self.time_s, self.motion, reference, mixed)
        self._places = np.array([record.relative(track)[0] for track in record.vehicles]) @ np.array([1.0, 1.0j])

    def spans(self) -> Iterator[slice]:
        """Return the samples of every span."""
        member = self.motion.member
        edges = [0, *(np.flatnonzero((member[:, 1:] != member[:, :-1]).any(axis=0)) + 1).tolist(), self.time_s.size]
        return (slice(*edge) for edge in pairwise(edges) if member[:, edge[0]].any())

    def beyond_deg(self, span: slice) -> float:
        """Return how far a gap between neighbours on the ring goes beyond the wanted one in a span."""
        return overshoot_deg(self.motion, self.on, span) or 0.0

    def settling(self, span: slice) -> Settling:
        """Return how long the ring took to settle in a span."""
        time_s = self.time_s[span] - self.time_s[span.start]
        error_rad = np.abs(self.motion.lead_rad[:, span] - self.motion.desired_spacing_rad[:, span])
        off = (self.off_share[:, span] > SETTLED_RADIUS_FRACTION) & ~self._bent(span)
        took_s = settled_s(time_s, ~(off | (error_rad > SETTLED_SPACING_RAD)).any(axis=0))
        allowed_s, gentle_s = (max(SETTLES_LEAST_S, SETTLES_FACTOR * least_s) for least_s in self._least_s(span))
        known = took_s < inf or time_s[-1] >= allowed_s
        return Settling(float(self.time_s[span.start]), took_s if known else None, allowed_s, gentle_s)

    def _bent(self, span: slice) -> Mask:
        """Return where the ring is bent for a vehicle: near another one that was a member and has left."""
        member = self.motion.member
        left = np.flatnonzero(member[:, : span.start].any(axis=1) & ~member[:, span.start])
        places, ring_m = self._places[:, span], self.settings.radius_m
        bent = np.zeros(places.shape, dtype=np.bool_)
        for each in left:
            beside = np.abs(np.abs(places[each]) - ring_m) < CLEARED * self.separation_m
            bent |= beside & (np.abs(np.angle(places / places[each])) < BENT_RAD)
        return bent

    def _least_s(self, span: slice) -> tuple[float, float]:
        """Return the least time in which the members could take even places, in the order in which they end.

        The places move with the ring: forwards a vehicle gains on them by its speed less the ring's. One on the ring
        moves within the bounds of a transition. Any other flies to the nearest point of the ring, then along it: first
        within the limits of the encirclement, second along it also within the bounds of a transition, and forwards: a
        place behind a vehicle comes to it at the ring's speed at most. Of all even places those that are reached first
        count.
        """
        settings, gentle = self.settings, transition_of(self.settings)
        ring_m_s = settings.angular_rate_rad_s * settings.radius_m
        members = np.flatnonzero(self.motion.member[:, span.start])
        members = members[np.argsort(self.motion.bearing_rad[members, span.stop - 1])]
        bearing_rad, on = self.motion.bearing_rad[members, span.start], self.on[members, span.start]
        places_rad = np.linspace(0.0, tau, 720)[:, None] + tau / members.size * np.arange(members.size)
        ahead_m = settings.radius_m * ((places_rad - bearing_rad + pi) % tau - pi)
        way_m, inwards_m = np.abs(ahead_m), settings.radius_m * self.off_share[members, span.start]
        relative_m_s = settings.speed_max_m_s - np.sign(ahead_m) * ring_m_s
        moves_s = _way_s(way_m, gentle.speed_m_s, gentle.acceleration_m_s2)
        waits_m_s = min(gentle.speed_m_s, abs(ring_m_s))
        forwards_m_s = np.where(ahead_m * ring_m_s < 0.0, waits_m_s, gentle.speed_m_s)
        forwards_s = _way_s(way_m, forwards_m_s, gentle.acceleration_m_s2)
        comes_s = _way_s(inwards_m, settings.speed_max_m_s, settings.acceleration_max_m_s2)
        inwards_m = (
            inwards_m * relative_m_s / settings.speed_max_m_s
        )  # as far as it would come along the ring meanwhile
        joins_s = np.where(on, moves_s, _way_s(way_m + inwards_m, relative_m_s, settings.acceleration_max_m_s2))
        gently_s = np.where(on, forwards_s, comes_s + forwards_s)
        return float(joins_s.max(axis=1).min()), float(gently_s.max(axis=1).min())

    def speed_share(self) -> float:
        """Return the largest speed relative to the target as a share of its bound, on the ring and off it.

        Where the ring is bent around a vehicle that has left, the way is longer, and the bound is that off the ring.
        """
        settings, on = self.settings, self.on.copy()
        for span in self.spans():
            on[:, span] &= ~self._bent(span)
        along_m_s = abs(settings.angular_rate_rad_s) * settings.radius_m
        bound_m_s = np.where(on, along_m_s + transition_of(settings).speed_m_s, settings.speed_max_m_s)
        return float((self.relative.speed_m_s / bound_m_s)[self.motion.member].max(initial=0.0))

    def acceleration_share(self) -> float:
        """Return the largest acceleration of a member as a share of its bound."""
        half = round(ACCELERATION_SPAN_S / 2.0 / float(self.time_s[1] - self.time_s[0]))
        member = self.motion.member.copy()
        for shift in (-half, half):  # it was a member before and will be after
            member &= np.roll(self.motion.member, shift, axis=1)
        share = self.relative.acceleration_m_s2 / self.settings.acceleration_max_m_s2
        return float(np.nanmax(share[member], initial=0.0))

    def forwards_m_s(self, where: Mask | None = None) -> float:
        """Return the lowest speed of a vehicle on the ring along it, anywhere or only in some samples (V, T)."""
        on = self.on if where is None else self.on & where
        return float(self.relative.forwards_m_s[on].min(initial=inf))


def _way_s(way_m: Vector, speed_m_s: float | Vector, acceleration_m_s2: float) -> Vector:
    """Return the least time for a way from rest to rest."""
    long_s = way_m / speed_m_s + speed_m_s / acceleration_m_s2
    return np.where(way_m < speed_m_s**2 / acceleration_m_s2, 2.0 * np.sqrt(way_m / acceleration_m_s2), long_s)


@dataclass(frozen=True)
class Joined:
    """One flight; the speed and acceleration are shares of their bounds.

    `planned_m_s` is the lowest speed along the ring of a vehicle that the guard did not move.
    """

    seed: int
    vehicles: int
    about: str
    overshoot_deg: float
    speed_share: float
    acceleration_share: float
    forwards_m_s: float
    planned_m_s: float
    settlings: tuple[Settling, ...]
    separation_left_m: float
    never_engaged: tuple[int, ...]

    @property
    def worst(self) -> Settling:
        """The settling that took longest."""
        return max(self.settlings, key=lambda each: (not each.in_time, each.took_s or 0.0))

    @property
    def settled(self) -> bool:
        return not self.never_engaged and all(each.in_time for each in self.settlings)

    @property
    def in_bounds(self) -> bool:
        return max(self.speed_share, self.acceleration_share) <= BOUND_SHARE

    @property
    def reasons(self) -> list[str]:
        """What misses its limit."""
        late = [each for each in self.settlings if not each.in_time]
        found = [
            (self.overshoot_deg > OVERSHOOT_DEG, f"overshoot {self.overshoot_deg:.1f} deg"),
            (self.speed_share > BOUND_SHARE, f"speed {self.speed_share:.2f} of its bound"),
            (self.acceleration_share > BOUND_SHARE, f"acceleration {self.acceleration_share:.2f} of its bound"),
            (self.planned_m_s < BACKWARDS_M_S, f"backwards at {-self.planned_m_s:.2f} m/s on purpose"),
            (bool(self.never_engaged), f"never engaged: {self.never_engaged}"),
            (self.separation_left_m < 0.0, f"separation {self.separation_left_m:+.2f} m"),
        ]
        found += [
            (True, f"settled {each.took_s:.1f} s after {each.at_s:.1f} s ({each.allowed_s:.0f} s)") for each in late
        ]
        return [words for missed, words in found if missed]

    def __str__(self) -> str:
        worst = self.worst
        return (
            f"seed {self.seed}: {self.about}: overshoot {self.overshoot_deg:.1f} deg, "
            f"speed {self.speed_share:.2f}, acceleration {self.acceleration_share:.2f}, "
            f"forwards {self.forwards_m_s:+.2f} m/s (on purpose {self.planned_m_s:+.2f} m/s), "
            f"settled after {worst.took_s or 0.0:.1f} of {worst.allowed_s:.0f} s, "
            f"separation {self.separation_left_m:+.2f} m"
        )


def measured(seed: int) -> Joined:
    """Fly the mission of a seed and measure."""
    scene = drawn(seed)
    return judged(seed, scene, *recorded(scene, seed))


def judged(seed: int, scene: Scene, record: FlightRecord, flight: SimulatedFlight, guarded: Mask) -> Joined:
    """Measure a flight."""
    ring = Ring(record, scene.mission)
    spans = list(ring.spans())
    engaged = ring.motion.member.sum(axis=1).tolist()
    return Joined(
        seed,
        len(scene.mission.ids),
        _about(scene),
        max(map(ring.beyond_deg, spans), default=0.0),
        ring.speed_share(),
        ring.acceleration_share(),
        ring.forwards_m_s(),
        ring.forwards_m_s(~guarded),
        tuple(map(ring.settling, spans)),
        separation_left_m(scene, flight),
        tuple(each for each, has in zip(scene.mission.ids, engaged, strict=True) if not has),
    )


def _about(scene: Scene) -> str:
    mission = scene.mission
    ring, config = mission.encirclement, mission.agent_config(mission.vehicles[0])
    late, lost = (sum((each.to_s == inf) == gone for each in scene.absences) for gone in (False, True))
    along_m_s = ring.angular_rate_rad_s * ring.radius_m
    words = [
        f"n {len(mission.ids)}, {config.shape}, R {ring.radius_m:.1f} m at {along_m_s:+.2f} m/s",
        f"engages at {mission.vehicles[0].decision.distance_max_m:.0f} m",
        f"target {np.hypot(*mission.target.velocity_m_s):.2f} m/s",
        "noisy" if mission.simulation.position_noise_m else "clean",
    ]
    words += [f"{late} late"] * bool(late) + [f"{lost + len(scene.told)} leave"] * bool(lost + len(scene.told))
    return ", ".join(words)


def _row(name: str, flights: Sequence[Joined]) -> str:
    if not flights:
        return f"{name:>6} {0:>6}"
    took_s = [each.worst.took_s or 0.0 for each in flights]
    shares = (
        [each.overshoot_deg > OVERSHOOT_DEG for each in flights],
        [not each.in_bounds for each in flights],
        [each.forwards_m_s < BACKWARDS_M_S for each in flights],
        [each.planned_m_s < BACKWARDS_M_S for each in flights],
        [each.settled for each in flights],
        [all(settling.gently_in_time for settling in each.settlings) for each in flights],
        [each.separation_left_m >= 0.0 for each in flights],
    )
    columns = " ".join(f"{np.mean(each):>10.1%}" for each in shares)
    return f"{name:>6} {len(flights):>6} {columns} {np.median(took_s):>8.1f} s {max(took_s):>6.1f} s"


def main(count: int, first: int, *, listed: bool) -> int:
    """Fly a number of missions, from the seed `first` on, on all cores."""
    flights = []
    with ProcessPoolExecutor() as pool:
        for flight in pool.map(measured, range(first, first + count)):
            flights.append(flight)
            if listed:
                print(flight, flush=True)
    titles = ("overshoot", "bounds", "backwards", "on purpose", "settled", "gently", "separated")
    print(f"{'n':>6} {'draws':>6} {' '.join(f'{each:>10}' for each in titles)} {'median':>10} {'worst':>8}")
    for low, high in SIZES:
        print(_row(f"{low}-{high}", [each for each in flights if low <= each.vehicles <= high]))
    print(_row("all", flights))
    missed = sorted((each for each in flights if each.reasons), key=lambda each: -len(each.reasons))
    print(f"{len(missed)} of {count} miss a limit; the worst:")
    print(
        *(f"  seed {each.seed}: {'; '.join(each.reasons)} ({each.about})" for each in missed[:10]), sep="\n", flush=True
    )
    kept = (
        sum(each.overshoot_deg > OVERSHOOT_DEG for each in flights) <= OVERSHOOT_SHARE * count
        and sum(not each.in_bounds for each in flights) <= BOUNDS_SHARE * count
        and all(each.planned_m_s >= BACKWARDS_M_S and each.separation_left_m >= 0.0 for each in flights)
        and sum(each.settled for each in flights) >= SETTLED_SHARE * count
    )
    return 0 if kept else 1


if __name__ == "__main__":
    reader = parser("random_joins", __doc__)
    reader.add_argument("count", nargs="?", type=int, default=300, help="number of seeds (default: %(default)s)")
    reader.add_argument("--seed", type=int, default=0, help="first seed (default: %(default)s)")
    reader.add_argument("--list", action="store_true", help="print every flight")
    given = reader.parse_args()
    sys.exit(main(given.count, given.seed, listed=given.list))
