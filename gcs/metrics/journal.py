"""The journal of a flight: its data, collected tick by tick, and the flight record built from them."""

from array import array
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import cos, inf, sin

import numpy as np
from numpy.typing import NDArray

from agents.notes import AlertChange, CommandOutcome, Note
from agents.outputs import CoreStatus
from agents.tactics import NO_TACTIC
from agents.team.messages import CameraView, CommandAnswer, CommandKey, MemberState, NeighbourAngle
from agents.team.verbs import VERBS
from estimation.state import MOTION, POSITION, VELOCITY, Vector
from gcs.metrics.apart import closest_on_ways_m, ways_s
from gcs.metrics.ending import HeardLast, VehicleEnding
from gcs.metrics.record import (
    GAP_MAX_S,
    CameraTrack,
    FlightEvent,
    FlightRecord,
    GuardTally,
    InjectedFault,
    LoopStatistics,
    Mask,
    TargetPath,
    VehicleTrack,
    in_order,
    path_velocity_m_s,
)
from gcs.metrics.references import HEIGHT_SHARE
from gcs.metrics.ring import LOST_AFTER_S
from gcs.metrics.targets import ring_targets_of, targets_of
from gcs.mission.mission import Mission, TargetSection
from sitl.server.record import TruthTrack

_REJOIN = VERBS["rejoin"]


class EventLog:
    """Collects events on the team's clock, each of them once, from any source."""

    def __init__(self) -> None:
        self.events: list[FlightEvent] = []
        self._local_ids: set[int] = set()
        self._last: dict[int, MemberState] = {}
        self._answered: set[tuple[int, CommandKey, str]] = set()
        self._took_off: dict[int, CommandAnswer] = {}
        self._reported = 0

    def note(self, status: CoreStatus, others: Iterable[MemberState]) -> None:
        """Add the notes of a vehicle in this process, and the changes in the messages that it received.

        `others` are the states of vehicles in other processes.
        """
        self.add_notes(status.vehicle_id, status.notes)
        for peer in others:
            self.add_peer(peer)
        for answer in status.answers:
            self.add_answer(answer)

    def add_notes(self, vehicle_id: int, notes: Iterable[Note]) -> None:
        """Add the notes of a vehicle in this process."""
        self._local_ids.add(vehicle_id)
        self.events += [FlightEvent.of(vehicle_id, note) for note in notes]

    def new_events(self) -> list[FlightEvent]:
        """Return the events since the last call."""
        events, self._reported = self.events[self._reported :], len(self.events)
        return events

    @property
    def took_off_s(self) -> Mapping[int, float]:
        """When vehicles of other processes have answered last that they take off and join the others."""
        return {sender: answer.time_s for sender, answer in self._took_off.items()}

    def add_peer(self, peer: MemberState) -> None:
        """Add the changes in the state that a vehicle of another process sent."""
        if peer.sender in self._local_ids:
            return
        before = self._last.get(peer.sender)
        if before is not None and peer.time_s < before.time_s:
            return
        self._last[peer.sender] = peer
        time_s, sender = peer.time_s, peer.sender
        if before is not None and peer.tactic != before.tactic:
            self.events.append(FlightEvent(time_s, sender, "tactic", f"{before.tactic} -> {peer.tactic}"))
        alert = "" if before is None else before.alert
        if peer.alert != alert:
            text = f"alert: {peer.alert}" if peer.alert else f"alert cleared: {alert}"
            change = AlertChange(peer.alert or alert, is_over=not peer.alert)
            self.events.append(FlightEvent(time_s, sender, "failsafe", text, alert=change))

    def add_answer(self, answer: CommandAnswer) -> None:
        """Add the answer of a vehicle in another process to an operator."""
        if answer.sender in self._local_ids:
            return
        key = (answer.sender, answer.key, answer.did)
        if key not in self._answered:
            self._answered.add(key)
            took_off = self._took_off.get(answer.sender)
            if answer.verb == _REJOIN.name and answer.did == _REJOIN.done:
                self._took_off[answer.sender] = answer
            elif answer.is_refused and took_off is not None and took_off.key == answer.key:
                del self._took_off[answer.sender]
            outcome = CommandOutcome(answer.verb or "", answer.origin, answer.did, answer.is_refused)
            text = f"answers: {answer.did}"
            self.events.append(FlightEvent(answer.time_s, answer.sender, "command", text, command=outcome))


def event_line(event: FlightEvent, start_s: float | None) -> str:
    """Return an event as text; `start_s` is the mission's start on the team's clock, None while it is unknown."""
    since_s = -1.0 if start_s is None else event.time_s - start_s
    when = f"{since_s:.1f} s" if since_s >= 0.0 else "before the start"
    return f"{when}: vehicle {event.vehicle}: {event.text}"


_TRUTH_GAP_MAX_S = 0.5
"""A true position farther in time than this from the nearest sample is unknown. Between two samples twice as far apart,
a straight line is off a ring by 3 cm at 1.5 m/s and 10 m."""
_GRAIN_S = 1e-3
_CLIMBS, _CLIMBS_S = "takes off", 60.0
"""The state of a vehicle that sends none yet, and the longest time until it does."""
_LOW_SHARE = 0.5
"""A vehicle that was received last above this share of its flying height was not about to land."""


def true_track(estimated: VehicleTrack, truth: TruthTrack, grid_s: Vector) -> VehicleTrack:
    """Return a vehicle's true track on the grid, NaN where unknown; its tactics and rings are those of `estimated`."""
    time_s, motion = _samples(truth)
    on_grid = np.column_stack([np.interp(grid_s, time_s, column) for column in motion.T])
    # Nothing is extrapolated before the first sample and after the last one.
    outside = (grid_s < time_s[0] - _GRAIN_S) | (grid_s > time_s[-1] + _GRAIN_S)
    on_grid[outside | ~_known(time_s, grid_s)] = np.nan
    position_m, velocity_m_s, altitude_m = on_grid[:, POSITION], on_grid[:, VELOCITY], on_grid[:, 4]
    decided = estimated.tactic, None, altitude_m, estimated.ring
    return VehicleTrack(estimated.vehicle_id, position_m, velocity_m_s, *decided)


def path_on_grid_m(time_s: Vector, position_m: Vector, grid_s: Vector) -> Vector:
    """Return a path of positions (K, N) on the grid (T, N), NaN where no sample is near enough."""
    on_grid_m = np.column_stack([np.interp(grid_s, time_s, column) for column in position_m.T])
    outside = (grid_s < time_s[0] - _GRAIN_S) | (grid_s > time_s[-1] + _GRAIN_S)
    on_grid_m[outside | ~_known(time_s, grid_s)] = np.nan
    return on_grid_m


def missing_truth(
    estimated: Sequence[VehicleTrack], truth: Mapping[int, TruthTrack], time_s: Vector, grid_s: Vector
) -> str:
    """Return the first vehicle and time without a true motion during its flight; empty if there is none.

    `truth` is by vehicle id; `grid_s` is the clock of the truth, `time_s` the time since the mission's start.
    """
    for track in estimated:
        sampled_s = _samples(truth[track.vehicle_id])[0] if track.vehicle_id in truth else np.empty(0)
        if not sampled_s.size:
            return f"no ground truth of vehicle {track.vehicle_id}"
        missing = np.flatnonzero((track.tactic != NO_TACTIC) & ~_known(sampled_s, grid_s))
        if missing.size:
            first = int(missing[0])
            known_again = np.flatnonzero(_known(sampled_s, grid_s[first:]))
            until = f" to {time_s[first + int(known_again[0])]:.1f} s" if known_again.size else " on"
            return f"no ground truth of vehicle {track.vehicle_id} from {time_s[first]:.1f} s{until}"
    return ""


def _samples(truth: TruthTrack) -> tuple[Vector, Vector]:
    """Return the times (K,), horizontal motions and heights (K, 5) of the finite samples, in order of time."""
    motion = np.hstack([truth.position_m[:, POSITION], truth.velocity_m_s[:, POSITION], truth.position_m[:, 2:]])
    known = np.flatnonzero(np.isfinite(motion).all(axis=1))
    order = known[np.argsort(truth.time_s[known], kind="stable")]
    return truth.time_s[order], motion[order]


def _known(time_s: Vector, grid_s: Vector) -> Mask:
    """Return where on the grid the nearest sample is near enough."""
    after = np.minimum(np.searchsorted(time_s, grid_s), time_s.size - 1)
    before = np.maximum(after - 1, 0)
    nearest_s = np.minimum(np.abs(grid_s - time_s[before]), np.abs(time_s[after] - grid_s))
    return np.asarray(nearest_s <= _TRUTH_GAP_MAX_S)


def _numbers() -> "array[float]":
    return array("d")


@dataclass(slots=True)
class _Samples:
    """The samples of one vehicle: times, motions [x y x' y'], heights, tactics, rings; and its target estimates.

    Numbers are packed, motions four by four: as objects they took five times the memory.
    """

    time_s: "array[float]" = field(default_factory=_numbers)
    motions: "array[float]" = field(default_factory=_numbers)
    tactic: list[str] = field(default_factory=list)
    ring: list[int] = field(default_factory=list)
    height_m: "array[float]" = field(default_factory=_numbers)
    target_s: "array[float]" = field(default_factory=_numbers)
    targets: "array[float]" = field(default_factory=_numbers)

    @property
    def motion(self) -> Vector:
        """The motions (K, 4)."""
        return np.array(self.motions).reshape(-1, 4)

    @property
    def target(self) -> Vector:
        """The target estimates (K, 4)."""
        return np.array(self.targets).reshape(-1, 4)

    def add(self, time_s: float, motion: Vector, height_m: float, tactic: str, ring: int) -> None:
        if not self.time_s or time_s > self.time_s[-1]:
            self.time_s.append(time_s)
            self.motions.frombytes(motion.tobytes())
            self.height_m.append(height_m)
            self.tactic.append(tactic)
            self.ring.append(ring)

    def add_target(self, time_s: float, target: Vector) -> None:
        if not self.target_s or time_s > self.target_s[-1]:
            self.target_s.append(time_s)
            self.targets.frombytes(target.tobytes())


@dataclass(frozen=True, slots=True)
class RunTotals:
    """The totals of a run: source, ticks and missed ticks of all loops, wall time, and truth where it is known.

    `truth` holds simulators' true tracks by system id. `seed` overrides the seed of the mission. `endings` are those of
    the vehicles, as far as known. `faults` are those injected into stub vehicles. `kinds` are the vehicles' kinds by
    id. `target_path` holds the times (K,) and true positions (K, 2) of a target that reacts, None of any other. `views`
    are where cameras looked, by the vehicles' ids.
    """

    source: str
    ticks: int
    missed: int
    wall_time_s: float
    truth: tuple[TruthTrack, ...] = ()
    seed: int | None = None
    endings: tuple[VehicleEnding, ...] = ()
    faults: tuple[InjectedFault, ...] = ()
    kinds: Mapping[int, str] = field(default_factory=dict)
    target_path: tuple[Vector, Vector] | None = None
    views: Mapping[int, Sequence[CameraView]] = field(default_factory=dict)


class Journal:
    """Collects every tick of the agents in this process, and the states that they receive from other processes."""

    def __init__(self, mission: Mission) -> None:
        self._mission, self._count = mission, len(mission.ids)
        self._ids: set[int] = set()
        self._own: defaultdict[int, _Samples] = defaultdict(_Samples)
        self._received: defaultdict[int, _Samples] = defaultdict(_Samples)
        self._tick_us = _numbers()
        self._guard = GuardTally()
        self.event_log = EventLog()
        self.latest: dict[int, CoreStatus] = {}

    @property
    def joined(self) -> Collection[int]:
        """The vehicles of other processes that have been received in the air, or have answered that they take off."""
        return {*self._received, *self.event_log.took_off_s}

    def enlarge(self, mission: Mission) -> None:
        """Take the mission with a vehicle that has joined the flight."""
        self._mission = mission

    def new_events(self) -> list[FlightEvent]:
        """Return the events since the last call, on the team's clock."""
        return self.event_log.new_events()

    def note(self, status: CoreStatus, tick_us: float | None) -> None:
        """Add one tick; outside the control loop, where `tick_us` is None, only its events."""
        self._ids.add(status.vehicle_id)
        here = self._ids
        all_here = len(here) == self._count and status.added is None  # then none looks through many others every tick
        others = [] if all_here else [peer for peer in status.peers if peer.sender not in here]
        self.event_log.note(status, others)
        if tick_us is None:
            return
        self.tick(tick_us, () if status.guarded is None else [cause.words for cause in status.guarded.causes])
        self.latest[status.vehicle_id] = status
        if status.situation is not None and status.motion is not None:
            of_tick = status.motion, status.situation.height_m, status.tactic.value, status.target, status.ring
            self.add_sample(status.vehicle_id, status.time_s, *of_tick)
        self.add_peers(others, status.target, status.ring)

    def tick(self, tick_us: float, guarded: Sequence[str]) -> None:
        """Add the computing time of a tick, and the causes for which the guard moved its setpoint."""
        self._tick_us.append(tick_us)
        self._guard.count(guarded)

    def add_sample(
        self,
        vehicle_id: int,
        time_s: float,
        motion: Vector,
        height_m: float,
        tactic: str,
        target: Vector | None = None,
        ring: int = 0,
    ) -> None:
        """Add the motion (4,), height, tactic and ring of a vehicle of this process, and its target estimate (4,)."""
        self._own[vehicle_id].add(time_s, motion, height_m, tactic, ring)
        if target is not None:
            self._own[vehicle_id].add_target(time_s, target)

    def add_peers(self, peers: Iterable[MemberState], target: Vector | None, ring: int = 0) -> None:
        """Add the states that peers sent, and the target positions that follow from their places on the ring.

        Peers do not send their estimate of the target's velocity: the receiver's estimate `target` (4,) provides it,
        where the receiver's `ring` is about the same target.
        """
        for peer in peers:
            samples, its_ring = self._received[peer.sender], peer.ring_number
            motion = np.array([*peer.position_m, *peer.velocity_m_s])
            samples.add(peer.time_s, motion, peer.altitude_m, peer.tactic, its_ring)
            angle, is_same = peer.angle, self._target_number(its_ring) == self._target_number(ring)
            if angle is not None and target is not None and is_same and angle.time_s == peer.time_s:
                samples.add_target(peer.time_s, np.array([*_centre_m(peer, angle), *target[VELOCITY]]))

    def record(self, start_s: float, duration_s: float, run: RunTotals) -> FlightRecord:
        """Build the record of the mission that began at `start_s`: from truth if it is known for all vehicles."""
        mission = self._mission
        rate_hz = mission.mission.rate_hz
        time_s = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
        estimated = self._estimated_tracks(time_s + start_s)
        target = self._true_target(mission.target, time_s, run, start_s)
        targets = tuple(self._true_target(each, time_s, run, start_s) for each in targets_of(mission))
        true, missing = self._true_tracks(estimated, run, time_s, start_s)
        if true and not all(np.isfinite(each.position_m).all() for each in (target, *targets)):
            true, missing = (), "no ground truth of the target"
        # In a simulation only the truth is judged.
        beside = estimated if true and run.source != "simulation" else ()
        return FlightRecord(
            mission=mission.mission.name,
            seed=mission.mission.seed if run.seed is None else run.seed,
            source=run.source,
            reference="truth" if true else "estimate",
            time_s=time_s,
            target_position_m=target.position_m,
            target_velocity_m_s=target.velocity_m_s,
            vehicles=true or estimated,
            loop=LoopStatistics(rate_hz, run.ticks, run.missed, np.array(self._tick_us)),
            wall_time_s=run.wall_time_s,
            guard=self._guard,
            events=in_order(self.event_log.events, start_s),
            estimates=beside,
            truth_missing=missing,
            endings=(*run.endings, *self._joined_ending(start_s)),
            faults=run.faults,
            kinds=run.kinds,
            targets=targets,
            ring_targets=ring_targets_of(mission),
            ways_closest_m=self._ways_closest_m(run.truth if true else (), start_s, start_s + float(time_s[-1])),
            cameras={i: self._camera(i, views, start_s) for i, views in run.views.items() if views},
        )

    def _joined_ending(self, start_s: float) -> Iterator[VehicleEnding]:
        """Yield how the flight of a vehicle ended that joined from another process, as far as it was received."""
        added, own = self._mission.added, [each.time_s[-1] for each in self._own.values() if each.time_s]
        if added is None or added in self._own or added not in self.joined or not own:
            return
        samples, section = self._received.get(added, _Samples()), self._mission.vehicle(added).section
        took_off_s, lost_after_s = self.event_log.took_off_s.get(added, -inf), LOST_AFTER_S
        if samples.time_s and samples.time_s[-1] > took_off_s:
            heard_s, tactic, height_m = samples.time_s[-1], samples.tactic[-1], samples.height_m[-1]
            x, y = samples.motion[-1, POSITION].tolist()
        else:
            heard_s, tactic, height_m, lost_after_s = took_off_s, _CLIMBS, 0.0, _CLIMBS_S
            x, y = section.start_m
        is_high = height_m > _LOW_SHARE * section.altitude_m
        last = HeardLast(added, tactic, heard_s - start_s, max(own) - heard_s, (x, y, height_m), is_high=is_high)
        yield last.ending(self._mission.mission_frame(), lost_after_s)

    def _ways_closest_m(self, truth: Sequence[TruthTrack], start_s: float, end_s: float) -> float | None:
        """Return how near two vehicles came outside the mission, by truth if it is known, else by their estimates."""
        paths = [
            (time_s, np.column_stack((motion[:, POSITION], motion[:, 4]))) for time_s, motion in map(_samples, truth)
        ] or [
            (np.array(each.time_s), np.column_stack((each.motion[:, POSITION], each.height_m)))
            for each in {**self._received, **self._own}.values()
        ]
        grid_s = ways_s([time_s for time_s, _ in paths], (start_s, end_s))
        position_m = np.array([path_on_grid_m(*path, grid_s) for path in paths if path[0].size])
        return closest_on_ways_m(position_m, HEIGHT_SHARE * self._mission.safety.vertical_separation_m)

    def _camera(self, vehicle_id: int, views: Sequence[CameraView], start_s: float) -> CameraTrack:
        """Return where a vehicle's camera looked; the target's own height counts where the mission has it."""
        gimbal, height_m = self._mission.vehicle(vehicle_id).section.gimbal, self._mission.target.altitude_m
        aimed_m = 0.0 if gimbal is None else gimbal.target_height_m
        return CameraTrack.of(views, start_s, aimed_m if height_m is None else height_m)

    def _target_number(self, ring: int) -> int:
        """Return the number of a ring's target."""
        rings = self._mission.rings
        return rings[ring].target if ring < len(rings) else 0

    def _estimated_tracks(self, grid_s: Vector) -> tuple[VehicleTrack, ...]:
        """Return the tracks as estimated; for vehicles of this process its own samples replace their messages."""
        samples = {**self._received, **self._own}
        has_rings = len(self._mission.rings) > 1
        return tuple(_track(each, samples[each], grid_s, has_rings) for each in self._mission.ids if each in samples)

    def _true_tracks(
        self, estimated: tuple[VehicleTrack, ...], run: RunTotals, time_s: Vector, start_s: float
    ) -> tuple[tuple[VehicleTrack, ...], str]:
        """Return the true tracks of all vehicles, or none and which is missing; empty if there is no truth at all."""
        of_system = {track.vehicle_id: track for track in run.truth}
        known = {each.vehicle_id: self._mission.vehicle(each.vehicle_id).system_id for each in estimated}
        truth = {vehicle_id: of_system[system] for vehicle_id, system in known.items() if system in of_system}
        if not truth:
            return (), ""
        missing = missing_truth(estimated, truth, time_s, time_s + start_s)
        if missing:
            return (), missing
        return tuple(true_track(each, truth[each.vehicle_id], time_s + start_s) for each in estimated), ""

    def _true_target(self, target: TargetSection, time_s: Vector, run: RunTotals, start_s: float) -> TargetPath:
        """Return a target's true motion, NaN where it is not known.

        It is that which the run recorded of the first ring's target, or the mission's motion if that was simulated.
        """
        if run.target_path is not None and target == self._mission.target:
            target_m = path_on_grid_m(*run.target_path, time_s + start_s)
            return TargetPath(target_m, path_velocity_m_s(time_s, target_m))
        if target.has_planned_path or (run.source == "simulation" and target.evades is None):
            return TargetPath(*target.motion.over(time_s))
        unknown = np.full((time_s.size, 2), np.nan)
        return TargetPath(unknown, unknown)


def _centre_m(peer: MemberState, angle: NeighbourAngle) -> tuple[float, float]:
    """Return the target's position that a peer's place on the ring refers to."""
    (x, y), radius_m = peer.position_m, angle.radius_m
    return x - radius_m * cos(angle.bearing_rad), y - radius_m * sin(angle.bearing_rad)


def _track(vehicle_id: int, samples: _Samples, grid_s: Vector, has_rings: bool) -> VehicleTrack:
    """Return one vehicle's track from its estimates of itself and the target, with its ring if there are several."""
    sample_s = np.array(samples.time_s)
    motion = _resampled(sample_s, samples.motion, grid_s)
    latest = _latest(sample_s, grid_s)
    tactic = np.where(_covered(sample_s, grid_s), np.array(samples.tactic)[latest], NO_TACTIC)
    ring = np.array(samples.ring)[latest] if has_rings else None
    target = np.full_like(motion, np.nan)
    if samples.target_s:
        target = _resampled(np.array(samples.target_s), samples.target, grid_s)
    return VehicleTrack(vehicle_id, motion[:, POSITION], motion[:, VELOCITY], tactic, target, ring=ring)


def _resampled(time_s: Vector, motion: Vector, grid_s: Vector) -> Vector:
    """Return motions (T, 4) on the grid, NaN where the nearest sample is more than a second away."""
    resampled = np.column_stack([np.interp(grid_s, time_s, column) for column in motion.T])
    resampled[~_covered(time_s, grid_s), MOTION] = np.nan
    return resampled


def _latest(time_s: Vector, grid_s: Vector) -> "NDArray[np.intp]":
    """Return the place of the latest sample at each time of the grid."""
    return np.maximum(np.searchsorted(time_s, grid_s, side="right") - 1, 0)


def _covered(time_s: Vector, grid_s: Vector) -> NDArray[np.bool_]:
    before = np.maximum(np.searchsorted(time_s, grid_s, side="right") - 1, 0)
    after = np.minimum(before + 1, time_s.size - 1)
    nearest_s = np.minimum(np.abs(grid_s - time_s[before]), np.abs(time_s[after] - grid_s))
    return np.asarray(nearest_s <= GAP_MAX_S)
