"""The data of a fit: parts of flights that were flown by position setpoints, on a uniform time grid."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil

import numpy as np
from numpy.typing import NDArray

from estimation.identification.response import AxisInput, InputHold, SetpointSteps, steps_of
from estimation.state import Vector

GRID_S = 0.1
"""A plant's phase changes by tenths of a radian in this time; faster samples only add correlated noise."""
GAP_MAX_S = 0.5
SETTLE_S = 1.0
"""After a mode change, setpoints of the previous mode may still act."""
EXCERPT_MIN_S = 8.0
EXCERPT_MAX_S = 60.0
"""Longer parts are cut: the end of each is used for validation, and each starts from the estimate at its begin."""
FROZEN_S, FROZEN_MOVES_M = 10.0, 2.0
"""A vehicle that moves by more than the distance, later than the time after its setpoint's last change in the log, is
flown by setpoints that are not in the log. Every plant has settled by then, and estimators wander by 1 m.
"""
FED_MIN_M_S = 0.05
"""Feed-forward velocities that vary by less (rms, along both axes) do not identify the feed-forward gain."""

Spans = Sequence[tuple[float, float]]


def grid_s(count: int) -> Vector:
    """Return the first `count` times of the grid, from 0."""
    return np.arange(count, dtype=np.float64) * GRID_S


@dataclass(frozen=True, slots=True, eq=False)
class MotionRecording:
    """One vehicle's horizontal motion from a log: positions (T, 2) [m], setpoints (n, 2) [m], and their times [s].

    `flown_s` are the spans in which the setpoints flew the vehicle, `resets_s` the times of position resets of its
    estimator. With `sampled`, the log samples the active setpoint, and does not hold when each was sent. `velocity_m_s`
    (n, 2) are the velocities sent with the setpoints, None without; `reported_m_s` (T, 2) are the vehicle's reported
    velocities at the times of its positions, None if not logged.
    """

    position_time_s: Vector
    position_m: Vector
    setpoint_time_s: Vector
    setpoint_m: Vector
    flown_s: Spans
    resets_s: Sequence[float] = ()
    sampled: bool = False
    velocity_m_s: Vector | None = None
    reported_m_s: Vector | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Excerpt:
    """A part of a flight without a gap: positions (T, 2) every GRID_S from begin_s on, and all setpoints.

    `reported_m_s` are the vehicle's reported velocities (T, 2), None if not logged.
    """

    begin_s: float
    position_m: Vector
    recording: MotionRecording
    reported_m_s: Vector | None = None

    @property
    def duration_s(self) -> float:
        """The duration."""
        return float(self.position_m.shape[0] * GRID_S)

    @property
    def time_s(self) -> Vector:
        """Times of the positions (T,)."""
        return self.begin_s + grid_s(self.position_m.shape[0])

    @property
    def fed(self) -> bool:
        """Whether varying velocities were sent with the setpoints."""
        spread = np.std(self.velocity_m_s(), axis=0) if self.recording.velocity_m_s is not None else np.zeros(2)
        return float(np.hypot(*spread)) > FED_MIN_M_S

    def setpoint_m(self) -> Vector:
        """Return the setpoints held at the times of the positions, (T, 2)."""
        return self._held(self.recording.setpoint_m)

    def velocity_m_s(self) -> Vector:
        """Return the velocities sent with them, (T, 2); 0 without."""
        velocity_m_s = self.recording.velocity_m_s
        return self._held(np.zeros_like(self.recording.setpoint_m) if velocity_m_s is None else velocity_m_s)

    def inputs(self, between: InputHold) -> tuple[AxisInput, AxisInput]:
        """Return the input of each axis, as sums of steps or ramps."""
        x, y = (self._inputs(axis, between) for axis in range(2))
        return x, y

    def _inputs(self, axis: int, between: InputHold) -> AxisInput:
        recording = self.recording
        times_s, velocity_m_s = recording.setpoint_time_s, recording.velocity_m_s
        velocity: SetpointSteps | None = None
        if velocity_m_s is not None:
            velocity = steps_of(times_s, velocity_m_s[:, axis], between)
        return AxisInput(steps_of(times_s, recording.setpoint_m[:, axis], between), velocity)

    def _held(self, values: Vector) -> Vector:
        at = np.searchsorted(self.recording.setpoint_time_s, self.time_s, side="right") - 1
        return np.asarray(values[np.maximum(at, 0)], dtype=np.float64)


def excerpts_of(recording: MotionRecording) -> list[Excerpt]:
    """Return the parts of a recording that can be used for a fit."""
    time_s = recording.position_time_s
    if recording.setpoint_time_s.size < 2 or time_s.size < 2:
        return []
    gaps = np.flatnonzero(np.diff(time_s) > GAP_MAX_S)
    # A reset lies between two positions, too: the part before it ends at the first of them.
    resets = np.minimum(np.searchsorted(time_s, recording.resets_s), time_s.size - 1)
    resets_s = set(time_s[resets].tolist())
    ends = np.append(gaps, np.maximum(resets - 1, 0))
    breaks = sorted({*time_s[ends].tolist(), *time_s[gaps + 1].tolist(), *resets_s})
    first_s, last_s = max(time_s[0], recording.setpoint_time_s[0]), time_s[-1]
    found = []
    for begin_s, end_s in _followed_s(recording):
        begin_s, end_s = max(begin_s + SETTLE_S, first_s), min(end_s, last_s)  # noqa: PLW2901
        inner = [at_s for at_s in breaks if begin_s < at_s < end_s]
        for from_s, to_s in zip([begin_s, *inner], [*inner, end_s], strict=True):
            if from_s in resets_s and to_s - from_s >= EXCERPT_MIN_S:
                from_s = _returned_s(_excerpt(recording, from_s, to_s))  # noqa: PLW2901
            if to_s - from_s >= EXCERPT_MIN_S and not _in_gap(time_s, gaps, from_s, to_s):
                edges_s = np.linspace(from_s, to_s, ceil((to_s - from_s) / EXCERPT_MAX_S) + 1).tolist()
                found += [_excerpt(recording, one + 1e-6, other - 1e-6) for one, other in pairwise(edges_s)]
    return found


def _followed_s(recording: MotionRecording) -> list[tuple[float, float]]:
    """Return the spans in which the logged setpoints flew the vehicle: it does not move under frozen ones."""
    sent = recording.setpoint_m
    if recording.velocity_m_s is not None:
        sent = np.hstack((sent, recording.velocity_m_s))
    changes_s = recording.setpoint_time_s[1:][np.any(np.diff(sent, axis=0) != 0.0, axis=1)]
    found = []
    for begin_s, end_s in recording.flown_s:
        inner_s = changes_s[(begin_s < changes_s) & (changes_s < end_s)].tolist()
        frozen = [each for each in pairwise((begin_s, *inner_s, end_s)) if _moves(recording, *each)]
        edges_s = (begin_s, *(edge_s for each in frozen for edge_s in each), end_s)
        found += list(zip(edges_s[::2], edges_s[1::2], strict=True))
    return found


def _moves(recording: MotionRecording, from_s: float, to_s: float) -> bool:
    """Return whether the vehicle moves between two changes of its setpoint, when it should have settled."""
    if to_s - from_s <= FROZEN_S:
        return False
    time_s = recording.position_time_s
    settled_m = recording.position_m[(from_s + FROZEN_S < time_s) & (time_s < to_s)]
    return settled_m.size > 0 and bool(np.ptp(settled_m, axis=0).max() > FROZEN_MOVES_M)


def _returned_s(after: Excerpt) -> float:
    """Return when the vehicle, which follows its position's jump back to the setpoints, is as near them as usual."""
    apart_m = after.position_m - after.setpoint_m()
    off_m = np.hypot(*(apart_m - np.median(apart_m, axis=0)).T)
    return float(after.time_s[np.argmax(off_m <= np.median(off_m))])


def _in_gap(time_s: Vector, gaps: NDArray[np.intp], from_s: float, to_s: float) -> bool:
    middle_s = (from_s + to_s) / 2.0
    return bool(((time_s[gaps] <= middle_s) & (middle_s <= time_s[gaps + 1])).any())


def _excerpt(recording: MotionRecording, from_s: float, to_s: float) -> Excerpt:
    at_s = np.arange(from_s, to_s, GRID_S)
    position_m = _at(at_s, recording.position_time_s, recording.position_m)
    velocity_m_s = recording.reported_m_s
    reported_m_s = None if velocity_m_s is None else _at(at_s, recording.position_time_s, velocity_m_s)
    return Excerpt(from_s, position_m, recording, reported_m_s)


def _at(at_s: Vector, time_s: Vector, values: Vector) -> Vector:
    return np.column_stack([np.interp(at_s, time_s, column) for column in values.T])
