"""What was seen of a flight while it was flown, and the flight record made of it."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agents.outputs import CoreStatus
from agents.team.messages import MemberState
from estimation.state import (
    MOTION,
    POSITION,
    VELOCITY,
    Vector,
)
from gcs.metrics.event_log import EventLog
from gcs.metrics.record import (
    FlightEvent,
    FlightRecord,
    GuardTally,
    LoopStatistics,
    VehicleTrack,
    in_order,
)
from gcs.mission.mission import Mission
from sitl.server.server import TruthTrack

_GAP_MAX_S = 1.0


@dataclass(slots=True)
class _Sightings:
    """What was seen of one vehicle: times, motions [x y x' y'] and tactics."""

    time_s: list[float] = field(default_factory=list)
    motion: list[Vector] = field(default_factory=list)
    tactic: list[str] = field(default_factory=list)

    def add(self, time_s: float, motion: Vector, tactic: str) -> None:
        if not self.time_s or time_s > self.time_s[-1]:
            self.time_s.append(time_s)
            self.motion.append(motion)
            self.tactic.append(tactic)


class Journal:
    """Notes every tick of the agents in this process, and what they hear of their peers in others."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._seen: defaultdict[int, _Sightings] = defaultdict(_Sightings)
        self._tick_us: list[float] = []
        self._guard = GuardTally()
        self.event_log = EventLog()
        self.latest: dict[int, CoreStatus] = {}

    def news(self) -> list[FlightEvent]:
        """Return what has happened since the last time, on the team's clock."""
        return self.event_log.news()

    def note(self, status: CoreStatus, tick_us: float | None) -> None:
        """Note one tick; outside the control loop, where it has no time, only what happened."""
        self.event_log.note(status)
        if tick_us is None:
            return
        self.tick(tick_us, () if status.guarded is None else [cause.words for cause in status.guarded.causes])
        self.latest[status.vehicle_id] = status
        if status.motion is not None:
            self.see(status.vehicle_id, status.time_s, status.motion, status.tactic.value)
        for peer in status.peers:
            self.see_peer(peer)

    def tick(self, tick_us: float, guarded: Sequence[str]) -> None:
        """Note what a tick of a control loop took, and why its setpoint was changed, if it was."""
        self._tick_us.append(tick_us)
        self._guard.count(guarded)

    def see(self, vehicle_id: int, time_s: float, motion: Vector, tactic: str) -> None:
        """Note a vehicle's motion (4,) and tactic, unless it is older than what was noted last."""
        self._seen[vehicle_id].add(time_s, motion, tactic)

    def see_peer(self, peer: MemberState) -> None:
        """Note what a peer says of itself."""
        self.see(peer.sender, peer.time_s, np.array([*peer.position_m, *peer.velocity_m_s]), peer.tactic)

    def record(
        self,
        start_s: float,
        duration_s: float,
        *,
        ticks: int,
        missed: int,
        wall_time_s: float,
        source: str,
        truth: tuple[TruthTrack, ...] = (),
        seed: int | None = None,
    ) -> FlightRecord:
        """Make the record of the mission that began at `start_s`, from the truth where a simulator knows it.

        `seed` is what was flown with, unless it was the mission's.
        """
        mission = self._mission
        time_s = np.arange(round(duration_s * mission.mission.rate_hz) + 1) / mission.mission.rate_hz
        true = {track.vehicle_id: track for track in truth}  # a stub knows its system id
        tracks = tuple(
            self._track(
                vehicle_id, self._seen[vehicle_id], true.get(mission.vehicle(vehicle_id).system_id), time_s + start_s
            )
            for vehicle_id in mission.ids
            if vehicle_id in self._seen
        )
        target = mission.target.motion
        return FlightRecord(
            mission=mission.mission.name,
            seed=mission.mission.seed if seed is None else seed,
            source=source,
            reference="truth" if truth else "estimate",
            time_s=time_s,
            target_position_m=np.array([target.position_m(at_s) for at_s in time_s.tolist()]),
            target_velocity_m_s=np.array([target.velocity_at_m_s(at_s) for at_s in time_s.tolist()]),
            vehicles=tracks,
            loop=LoopStatistics(mission.mission.rate_hz, ticks, missed, np.array(self._tick_us)),
            wall_time_s=wall_time_s,
            guard=self._guard,
            events=in_order(self.event_log.events, start_s),
        )

    def _track(self, vehicle_id: int, seen: _Sightings, true: TruthTrack | None, grid_s: Vector) -> VehicleTrack:
        seen_s = np.array(seen.time_s)
        if true is None:
            motion = _resampled(seen_s, np.array(seen.motion), grid_s)
        else:
            columns = np.hstack([true.position_m[:, POSITION], true.velocity_m_s[:, POSITION]])
            motion = _resampled(true.time_s, columns, grid_s)
        return VehicleTrack(
            vehicle_id, motion[:, POSITION], motion[:, VELOCITY], _latest(seen_s, np.array(seen.tactic), grid_s)
        )


def _resampled(time_s: Vector, motion: Vector, grid_s: Vector) -> Vector:
    """Return motions (T, 4) on the grid, NaN where nothing was seen for a second."""
    resampled = np.column_stack([np.interp(grid_s, time_s, column) for column in motion.T])
    resampled[~_covered(time_s, grid_s), MOTION] = np.nan
    return resampled


def _latest(time_s: Vector, tactic: "NDArray[np.str_]", grid_s: Vector) -> "np.ndarray[tuple[int], np.dtype[np.str_]]":
    """Return the tactic that held at each time of the grid."""
    index = np.maximum(np.searchsorted(time_s, grid_s, side="right") - 1, 0)
    return np.where(_covered(time_s, grid_s), tactic[index], "unknown")


def _covered(time_s: Vector, grid_s: Vector) -> NDArray[np.bool_]:
    before = np.maximum(np.searchsorted(time_s, grid_s, side="right") - 1, 0)
    after = np.minimum(before + 1, time_s.size - 1)
    nearest_s = np.minimum(np.abs(grid_s - time_s[before]), np.abs(time_s[after] - grid_s))
    return np.asarray(nearest_s <= _GAP_MAX_S)
