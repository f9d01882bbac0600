"""The journal of a flight: its data tick by tick while it is flown, and the flight record built from them."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agents.outputs import CoreStatus
from agents.team.messages import MemberState
from estimation.state import MOTION, POSITION, VELOCITY, Vector
from gcs.metrics.event_log import EventLog
from gcs.metrics.record import FlightEvent, FlightRecord, GuardTally, LoopStatistics, VehicleTrack, in_order
from gcs.mission.mission import Mission
from sitl.server.server import TruthTrack

_GAP_MAX_S = 1.0


@dataclass(slots=True)
class _Samples:
    """The samples of one vehicle: times, motions [x y x' y'] and tactics."""

    time_s: list[float] = field(default_factory=list)
    motion: list[Vector] = field(default_factory=list)
    tactic: list[str] = field(default_factory=list)

    def add(self, time_s: float, motion: Vector, tactic: str) -> None:
        if not self.time_s or time_s > self.time_s[-1]:
            self.time_s.append(time_s)
            self.motion.append(motion)
            self.tactic.append(tactic)


@dataclass(frozen=True, slots=True)
class RunTotals:
    """The totals of a run: source, ticks and missed ticks of all loops, wall time, and truth where it is known.

    `seed` overrides the seed of the mission. `truth` replaces the estimates, `received_truth`, which the vehicles'
    simulators sent in flight, stands beside them.
    """

    source: str
    ticks: int
    missed: int
    wall_time_s: float
    truth: tuple[TruthTrack, ...] = ()
    seed: int | None = None
    received_truth: tuple[TruthTrack, ...] = ()


class Journal:
    """Collects every tick of the agents in this process, and the states that they receive from other processes."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._samples: defaultdict[int, _Samples] = defaultdict(_Samples)
        self._tick_us: list[float] = []
        self._guard = GuardTally()
        self.event_log = EventLog()
        self.latest: dict[int, CoreStatus] = {}

    def new_events(self) -> list[FlightEvent]:
        """Return the events since the last call, on the team's clock."""
        return self.event_log.new_events()

    def note(self, status: CoreStatus, tick_us: float | None) -> None:
        """Add one tick; outside the control loop, where `tick_us` is None, only its events."""
        self.event_log.note(status)
        if tick_us is None:
            return
        self.tick(tick_us, () if status.guarded is None else [cause.words for cause in status.guarded.causes])
        self.latest[status.vehicle_id] = status
        if status.motion is not None:
            self.add_sample(status.vehicle_id, status.time_s, status.motion, status.tactic.value)
        for peer in status.peers:
            self.add_peer(peer)

    def tick(self, tick_us: float, guarded: Sequence[str]) -> None:
        """Add the computing time of a tick, and the causes for which the guard moved its setpoint."""
        self._tick_us.append(tick_us)
        self._guard.count(guarded)

    def add_sample(self, vehicle_id: int, time_s: float, motion: Vector, tactic: str) -> None:
        """Add a vehicle's motion (4,) and tactic, unless it is older than the last sample."""
        self._samples[vehicle_id].add(time_s, motion, tactic)

    def add_peer(self, peer: MemberState) -> None:
        """Add the state that a peer sent."""
        self.add_sample(peer.sender, peer.time_s, np.array([*peer.position_m, *peer.velocity_m_s]), peer.tactic)

    def record(self, start_s: float, duration_s: float, run: RunTotals) -> FlightRecord:
        """Build the record of the mission that began at `start_s`, from the truth where a simulator knows it."""
        mission, target = self._mission, self._mission.target.motion
        rate_hz = mission.mission.rate_hz
        time_s = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
        return FlightRecord(
            mission=mission.mission.name,
            seed=mission.mission.seed if run.seed is None else run.seed,
            source=run.source,
            reference="truth" if run.truth else "estimate",
            time_s=time_s,
            target_position_m=np.array([target.position_m(at_s) for at_s in time_s.tolist()]),
            target_velocity_m_s=np.array([target.velocity_at_m_s(at_s) for at_s in time_s.tolist()]),
            vehicles=self._tracks(run.truth, time_s + start_s),
            truth=self._true_tracks(run, time_s + start_s),
            loop=LoopStatistics(rate_hz, run.ticks, run.missed, np.array(self._tick_us)),
            wall_time_s=run.wall_time_s,
            guard=self._guard,
            events=in_order(self.event_log.events, start_s),
        )

    def _tracks(self, truth: tuple[TruthTrack, ...], grid_s: Vector) -> tuple[VehicleTrack, ...]:
        true = {track.vehicle_id: track for track in truth}  # a simulated vehicle is known by its system id
        return tuple(
            self._track(vehicle_id, samples, true.get(self._mission.vehicle(vehicle_id).system_id), grid_s)
            for vehicle_id in self._mission.ids
            if (samples := self._samples.get(vehicle_id)) is not None
        )

    def _true_tracks(self, run: RunTotals, grid_s: Vector) -> tuple[VehicleTrack, ...]:
        """Return the true tracks beside the estimates: of all vehicles or, where one has none, of none."""
        known = {track.vehicle_id for track in run.received_truth}
        flown = {self._mission.vehicle(vehicle_id).system_id for vehicle_id in self._samples}
        return self._tracks(run.received_truth, grid_s) if flown <= known and not run.truth else ()

    def _track(self, vehicle_id: int, samples: _Samples, true: TruthTrack | None, grid_s: Vector) -> VehicleTrack:
        sample_s = np.array(samples.time_s)
        if true is None:
            motion = _resampled(sample_s, np.array(samples.motion), grid_s)
        else:
            columns = np.hstack([true.position_m[:, POSITION], true.velocity_m_s[:, POSITION]])
            motion = _resampled(true.time_s, columns, grid_s)
        return VehicleTrack(
            vehicle_id, motion[:, POSITION], motion[:, VELOCITY], _latest(sample_s, np.array(samples.tactic), grid_s)
        )


def _resampled(time_s: Vector, motion: Vector, grid_s: Vector) -> Vector:
    """Return motions (T, 4) on the grid, NaN where the nearest sample is more than a second away."""
    resampled = np.column_stack([np.interp(grid_s, time_s, column) for column in motion.T])
    resampled[~_covered(time_s, grid_s), MOTION] = np.nan
    return resampled


def _latest(time_s: Vector, tactic: "NDArray[np.str_]", grid_s: Vector) -> "np.ndarray[tuple[int], np.dtype[np.str_]]":
    """Return the tactic at each time of the grid."""
    index = np.maximum(np.searchsorted(time_s, grid_s, side="right") - 1, 0)
    return np.where(_covered(time_s, grid_s), tactic[index], "unknown")


def _covered(time_s: Vector, grid_s: Vector) -> NDArray[np.bool_]:
    before = np.maximum(np.searchsorted(time_s, grid_s, side="right") - 1, 0)
    after = np.minimum(before + 1, time_s.size - 1)
    nearest_s = np.minimum(np.abs(grid_s - time_s[before]), np.abs(time_s[after] - grid_s))
    return np.asarray(nearest_s <= _GAP_MAX_S)
