"""The record of a flight: the input of metrics, figures and reports."""

import re
from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from agents.notes import (
    AlertChange,
    CommandOutcome,
    GuardAction,
    Kind,
    Note,
    ReferenceChange,
    RingCommanded,
    TacticChange,
)
from agents.safety.guard import Guarded
from agents.tactics import NO_TACTIC, Tactic
from agents.team.messages import CameraView
from estimation.state import POSITION, VELOCITY, Vector
from gcs.metrics.ending import VehicleEnding

Mask = NDArray[np.bool_]
# Rounding errors of times on the record's grid are smaller than this.
TIME_GRAIN_S = 1e-6
GAP_MAX_S = 1.0
"""How far from a vehicle's nearest sample its motion and its tactic are known."""
ANOTHER_RING = "another ring"
"""The tactic that stands for `encircle` on another ring, in the record of one of several rings."""


@dataclass(frozen=True, slots=True)
class TargetPath:
    """The true motion of a target, (T, 2) each, NaN where nothing simulates it."""

    position_m: Vector
    velocity_m_s: Vector


@dataclass(frozen=True, slots=True)
class VehicleTrack:
    """One vehicle's flight on the record's time grid of T samples.

    `position_m`, `velocity_m_s` (T, 2) in the mission frame; `tactic` (T,) names (`formation`, `encircle`, ...);
    rows without data of the vehicle are NaN with tactic `unknown`. `target` (T, 4) = [x y x' y'] is the target's motion
    as the vehicle itself estimates it at the same times, NaN without an estimate; None on a true track, which refers to
    the record's target. `altitude_m` (T,) is the height on a true track, None on others. In a mission of several rings
    `ring` (T,) is the number of the ring that it is on or flies to, whose target `target` is; None in one of one ring.
    """

    vehicle_id: int
    position_m: Vector
    velocity_m_s: Vector
    tactic: np.ndarray[tuple[int], np.dtype[np.str_]]
    target: Vector | None = None
    altitude_m: Vector | None = None
    ring: "np.ndarray[tuple[int], np.dtype[np.intp]] | None" = None

    @property
    def last_tactic(self) -> str:
        """The last tactic that is known, `NO_TACTIC` without one."""
        known = self.tactic[self.tactic != NO_TACTIC]
        return str(known[-1]) if known.size else NO_TACTIC

    def encircles(self, number: int | None = None) -> Mask:
        """Return when (T,) it encircles, on the ring of a number or on any."""
        mask = np.asarray(self.tactic == Tactic.ENCIRCLE.value)
        return mask if number is None or self.ring is None else np.asarray(mask & (self.ring == number))


@dataclass(frozen=True, slots=True)
class LoopStatistics:
    """Timing of the control loop: `tick_us` (ticks,) are computing times in microseconds."""

    rate_hz: float
    ticks: int
    missed: int
    tick_us: Vector = field(default_factory=lambda: np.empty(0))


@dataclass(slots=True)
class GuardTally:
    """Counts the setpoints that the guard moved, in all and by cause; one setpoint may have several causes."""

    interventions: int = 0
    causes: Counter[str] = field(default_factory=Counter)

    def note(self, guarded: Guarded | None) -> None:
        """Count one tick."""
        if guarded is not None and guarded.causes:
            self.count([cause.words for cause in guarded.causes])

    def count(self, causes: Sequence[str]) -> None:
        """Count one tick by its causes; without any the guard did not move the setpoint."""
        if causes:
            self.interventions += 1
            self.causes.update(causes)


@dataclass(frozen=True, slots=True)
class FlightEvent:
    """An event of a vehicle: its time, kind and text, and the values of what it is (`agents.notes.Note`)."""

    time_s: float
    vehicle: int
    kind: Kind
    text: str
    alert: AlertChange | None = None
    command: CommandOutcome | None = None
    tactic: TacticChange | None = None
    reference: ReferenceChange | None = None
    guard: GuardAction | None = None
    ring: RingCommanded | None = None

    @classmethod
    def of(cls, vehicle_id: int, note: Note) -> "FlightEvent":
        """Return a note of a vehicle as an event."""
        return cls(
            note.time_s,
            vehicle_id,
            note.kind,
            note.text,
            note.alert,
            note.command,
            note.tactic,
            note.reference,
            note.guard,
            note.ring,
        )

    def to_dict(self) -> dict[str, object]:
        """Return it as plain data; `alert`, `command`, `reference`, `guard` and `ring` only where it has one.

        The number of a commanded `ring` is left out where it is 0; its name is in the text.
        """
        plain: dict[str, object] = {
            "time_s": self.time_s,
            "vehicle": self.vehicle,
            "kind": self.kind,
            "text": self.text,
        }
        names = ("alert", "command", "reference", "guard", "ring")
        values = {name: getattr(self, name) for name in names}
        known = {name: msgspec.structs.asdict(each) for name, each in values.items() if each is not None}
        if self.ring is not None:
            del known["ring"]["name"]
            if not self.ring.ring:
                del known["ring"]["ring"]
        return plain | known


_FAULT = re.compile(r"(?P<name>[^@]+)@(?P<at_s>\d+(\.\d+)?)(:(?P<vehicle>\d+))?")


class InjectedFault(NamedTuple):
    """A fault injected into stub vehicles: its name, its time in the mission, the vehicle if one was named.

    `given` is its text, as in `--fault` and in logs: `link-cut@120:2`.
    """

    name: str
    at_s: float
    vehicle: int | None
    given: str

    @classmethod
    def of(cls, given: str) -> "InjectedFault | None":
        """Return the fault of a text, None for a text of another form."""
        form = _FAULT.fullmatch(given)
        if form is None:
            return None
        vehicle = None if form["vehicle"] is None else int(form["vehicle"])
        return cls(form["name"], float(form["at_s"]), vehicle, given)


def injected_faults(given: Iterable[str]) -> tuple[InjectedFault, ...]:
    """Return the faults of texts of a log, without those of another form."""
    return tuple(fault for each in given if (fault := InjectedFault.of(each)) is not None)


@dataclass(frozen=True, slots=True)
class CameraTrack:
    """Where one vehicle's camera looked, (K,) at `time_s` since the mission's start: elevation and bearing [rad].

    `altitude_m` (K,) is the height of the vehicle as its autopilot reported it, `target_height_m` that of what the
    camera is to look at.
    """

    time_s: Vector
    elevation_rad: Vector
    bearing_rad: Vector
    altitude_m: Vector
    target_height_m: float

    @classmethod
    def of(cls, views: Sequence[CameraView], start_s: float, target_height_m: float) -> "CameraTrack":
        """Return the track of views, whose times are on the clock on which the mission began at `start_s`."""
        rows = [(each.time_s - start_s, each.elevation_rad, each.bearing_rad, each.position_m[2]) for each in views]
        time_s, elevation_rad, bearing_rad, altitude_m = np.array(rows).reshape(-1, 4).T
        return cls(time_s, elevation_rad, bearing_rad, altitude_m, target_height_m)


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """A whole flight on an even grid `time_s` (T,) since the mission's start; the target's motion has shape (T, 2).

    `source` is simulation, sitl or flight; `reference` is truth or estimate: the source of the tracks. The target's
    motion is the true one, NaN where nothing simulates it. `guard` counts the interventions, None if unknown. `events`
    are in order, their times since the mission's start as well. `estimates` are the tracks by the estimates of the same
    vehicles beside the true ones, empty without both. `truth_missing` is the first lack of truth that left the
    reference at the estimate, empty where there is none or no truth at all. `endings` are those of the vehicles of
    which it is known. `faults` are those injected into stub vehicles. `ways_closest_m` is how near two came before the
    mission's start or after its end (`closest_on_ways_m`), None if there were never two in the air at a like height.
    `kinds` are what vehicles are (gcs/autopilots/autopilot.py), by their ids; empty in simulations. `cameras` are where
    the cameras of vehicles looked whose gimbals were pointed, by the vehicles' ids.

    The record of a mission of several targets or rings has the true motions of all `targets`, and the number of each
    ring's target in `ring_targets`; else these are empty. The record's own target is then that of the first ring.
    """

    mission: str
    seed: int
    source: str
    reference: Literal["truth", "estimate"]
    time_s: Vector
    target_position_m: Vector
    target_velocity_m_s: Vector
    vehicles: tuple[VehicleTrack, ...]
    loop: LoopStatistics
    wall_time_s: float
    guard: GuardTally | None = None
    events: tuple[FlightEvent, ...] = ()
    estimates: tuple[VehicleTrack, ...] = ()
    truth_missing: str = ""
    endings: tuple[VehicleEnding, ...] = ()
    faults: tuple[InjectedFault, ...] = ()
    kinds: Mapping[int, str] = field(default_factory=dict)
    targets: tuple[TargetPath, ...] = ()
    ring_targets: tuple[int, ...] = ()
    ways_closest_m: float | None = None
    cameras: Mapping[int, CameraTrack] = field(default_factory=dict)

    def of_ring(self, number: int) -> "FlightRecord":
        """Return the record as that of one ring and its target; the record itself is that of its only ring.

        On other rings the tactic of a vehicle is `ANOTHER_RING`, and its estimate of another target is left out. Rings
        that operators commanded are those of this ring.
        """
        if not self.targets:
            return self
        target = self.targets[self.ring_targets[number]]
        return replace(
            self,
            target_position_m=target.position_m,
            target_velocity_m_s=target.velocity_m_s,
            vehicles=tuple(self._on_ring(track, number) for track in self.vehicles),
            estimates=tuple(self._on_ring(track, number) for track in self.estimates),
            events=tuple(each for each in self.events if each.ring is None or each.ring.ring == number),
            targets=(),
            ring_targets=(),
            ways_closest_m=None,
        )

    def of_vehicles(self, vehicle_ids: Container[int]) -> "FlightRecord":
        """Return the record with the tracks of these vehicles alone."""
        return replace(
            self,
            vehicles=tuple(track for track in self.vehicles if track.vehicle_id in vehicle_ids),
            estimates=tuple(track for track in self.estimates if track.vehicle_id in vehicle_ids),
        )

    def _on_ring(self, track: VehicleTrack, number: int) -> VehicleTrack:
        if track.ring is None:
            return track
        tactic = np.where(track.encircles() & ~track.encircles(number), ANOTHER_RING, track.tactic)
        target = None if track.target is None else self._estimate_of(track, track.target, self.ring_targets[number])
        return replace(track, tactic=tactic, target=target, ring=None)

    def _estimate_of(self, track: VehicleTrack, estimate: Vector, target: int) -> Vector:
        """Return a track's estimate (T, 4) of its target, NaN where it is of another target than that of a number."""
        return np.where((self.target_numbers(track) == target)[:, None], estimate, np.nan)

    def target_numbers(self, track: VehicleTrack) -> "np.ndarray[tuple[int], np.dtype[np.intp]]":
        """Return the number (T,) of a track's target at each time: that of the ring that it is on or flies to."""
        of_rings = np.array(self.ring_targets or (0,))
        return np.broadcast_to(of_rings[0 if track.ring is None else track.ring], self.time_s.shape)

    def target_of(self, track: VehicleTrack) -> TargetPath:
        """Return the true motion of a track's target: at each time that of the ring that it is on or flies to."""
        if track.ring is None:
            return TargetPath(self.target_position_m, self.target_velocity_m_s)
        at = self.target_numbers(track), np.arange(self.time_s.size)
        position_m, velocity_m_s = (
            np.array([getattr(each, name) for each in self.targets]) for name in ("position_m", "velocity_m_s")
        )
        return TargetPath(position_m[at], velocity_m_s[at])

    def relative(self, track: VehicleTrack) -> tuple[Vector, Vector]:
        """Return position and velocity (T, 2) of a track relative to its target, both from the same source."""
        if track.target is None:
            target = self.target_of(track)
            return track.position_m - target.position_m, track.velocity_m_s - target.velocity_m_s
        return track.position_m - track.target[:, POSITION], track.velocity_m_s - track.target[:, VELOCITY]

    @property
    def target_path_m(self) -> Vector:
        """Where the target was (T, 2): the true positions or, where none is known, the mean of the estimates."""
        return self.target_paths_m[self.ring_targets[0] if self.ring_targets else 0]

    @property
    def target_paths_m(self) -> tuple[Vector, ...]:
        """Where each target was (T, 2), as `target_path_m`."""
        true_m = [each.position_m for each in self.targets] or [self.target_position_m]
        return tuple(self._path_m(number, each) for number, each in enumerate(true_m))

    def _path_m(self, number: int, true_m: Vector) -> Vector:
        seen_m = [
            self._estimate_of(track, track.target, number)[:, POSITION]
            for track in self.vehicles
            if track.target is not None
        ]
        if np.isfinite(true_m).any() or not seen_m:
            return true_m
        known = np.isfinite(seen_m)
        count = known.sum(axis=0)
        total_m = np.where(known, seen_m, 0.0).sum(axis=0)
        return np.where(count > 0, total_m / np.maximum(count, 1), np.nan)


def in_order(events: Iterable[FlightEvent], start_s: float = 0.0) -> tuple[FlightEvent, ...]:
    """Return events by time since the mission's start at `start_s` [ms], then by vehicle, else in given order."""
    since = (replace(event, time_s=round(event.time_s - start_s, 3)) for event in events)
    return tuple(sorted(since, key=lambda event: (event.time_s, event.vehicle)))


def path_velocity_m_s(time_s: Vector, position_m: Vector) -> Vector:
    """Return the velocities (T, 2) of a target along its path, from the positions at the samples before and after."""
    if time_s.size < 2:
        return np.zeros_like(position_m)
    return np.asarray(np.gradient(position_m, time_s, axis=0))


def rms(errors: Vector) -> float | None:
    """Return the root mean square of the errors that are known, None without one."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def largest(errors: Vector) -> float | None:
    """Return the largest absolute value of the errors that are known, None without one."""
    known = errors[np.isfinite(errors)]
    return float(np.abs(known).max()) if known.size else None


def lasting_s(time_s: Vector, mask: Mask) -> float:
    """Return how long a condition (T,) lasted in all."""
    return grid_time(float(np.diff(time_s)[mask[1:] & mask[:-1]].sum()))


def grid_time(time_s: float) -> float:
    """Round away the accumulated error of time steps."""
    return round(time_s, 6)
