"""The raw log of one vehicle as a reader found it, and its conversion: one clock, checked values, named faults.

Check of a log's units: positions must change as fast as the velocities, and as far as the setpoints.

Ranges alone cannot distinguish millimetres from metres. Two correlated series can, if one moves hundreds of times as
far as the other. Series that are not correlated pass.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import log10, sqrt, tau
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from estimation.state import Vector
from gcs.autopilots.registry import AUTOPILOTS
from gcs.flightlog.container import LogError
from gcs.vehicle_logs.vehicle_log import (
    COLUMNS,
    SECONDS_MAX,
    ModeSegment,
    Number,
    Series,
    Span,
    Text,
    VehicleLog,
    spans_of,
)

WINDOW_S = 0.5
GAP_MAX_S = 2.0
WINDOWS_MIN = 10
LAGS_S = tuple(np.arange(0.0, 3.1, 0.5).tolist())
"""Lags of the position behind the setpoint that are tried."""
ALIKE_MIN = 0.6
"""Correlation above which two series are compared."""
VELOCITY_FACTOR_MAX, SETPOINT_FACTOR_MAX = 1.5, 20.0
"""Neither a filter's lag nor bad tracking causes factors beyond these, with noise taken into account for velocities."""


def unit_faults(series: Mapping[str, Series]) -> list[str]:
    """Return the faults of series that are not in metres and seconds, with topic and time."""
    faults = []
    for moved, velocity in (("position", "velocity"), ("true_position", "true_velocity")):
        if moved in series and velocity in series:
            faults += _against_velocity(series[moved], series[velocity])
    if "setpoint" in series and "position" in series:
        faults += _against_position(series["setpoint"], series["position"])
    return faults


def _against_velocity(position: Series, velocity: Series) -> list[str]:
    """Compare the distance moved in windows with the integral of the velocity."""
    times_s = _windows_s(position, velocity)
    if times_s.size < 2:
        return []
    moved = np.diff(_at(times_s, position.time_s, position.values), axis=0)
    steps_s = np.diff(velocity.time_s)[:, np.newaxis]
    means = 0.5 * (velocity.values[1:] + velocity.values[:-1])
    way = np.vstack((np.zeros(means.shape[1]), np.cumsum(means * np.minimum(steps_s, GAP_MAX_S), axis=0)))
    expected = np.diff(_at(times_s, velocity.time_s, way), axis=0)
    likeness, factor = _factor(expected, moved)
    # Noise of either series alone changes the factor by no more than their correlation.
    low, high = factor * likeness, factor / max(likeness, ALIKE_MIN)
    if likeness < ALIKE_MIN or (low < VELOCITY_FACTOR_MAX and high > 1.0 / VELOCITY_FACTOR_MAX):
        return []
    at_s = times_s[int(np.abs(moved).sum(axis=1).argmax())]
    return [
        f"{position.topic}: the position moves {_factor_text(factor)} as fast as the velocity in {velocity.topic}, "
        f"most of all at {at_s:.1f} s: one of them is not in metres and seconds"
    ]


def _against_position(setpoint: Series, position: Series) -> list[str]:
    """Compare how far the setpoints and the vehicle moved, at the lag of the highest correlation."""
    times_s = _windows_s(setpoint, position)
    if times_s.size < 2:
        return []
    held = setpoint.values[np.searchsorted(setpoint.time_s, times_s, side="right") - 1]
    known = np.isfinite(held).all(axis=1)
    if known.sum() < WINDOWS_MIN:
        return []
    held, times_s = held[known], times_s[known]
    asked = held - held.mean(axis=0)
    flown = [_at(times_s + lag_s, position.time_s, position.values) for lag_s in LAGS_S]
    likeness, factor = max(_factor(after - after.mean(axis=0), asked) for after in flown)
    if likeness < ALIKE_MIN or 1.0 / SETPOINT_FACTOR_MAX < factor < SETPOINT_FACTOR_MAX:
        return []
    at_s = times_s[int(np.abs(asked).sum(axis=1).argmax())]
    return [
        f"{setpoint.topic}: the setpoints move {_factor_text(factor)} as far as the vehicle in {position.topic}, "
        f"most of all at {at_s:.1f} s: one of them is not in metres"
    ]


def _windows_s(first: Series, second: Series) -> Vector:
    """Return the begin and end times of windows in which both series have samples."""
    begin_s = max(first.time_s[0], second.time_s[0])
    end_s = min(first.time_s[-1], second.time_s[-1])
    return np.arange(begin_s, end_s, WINDOW_S) if end_s > begin_s else np.empty(0)


def _at(times_s: Vector, sampled_s: Vector, values: Vector) -> Vector:
    return np.column_stack([np.interp(times_s, sampled_s, column) for column in values.T])


def _factor(reference: Vector, other: Vector) -> tuple[float, float]:
    """Return the correlation of two series, and how much farther the other one moves; 0 if unknown."""
    if reference.shape[0] < WINDOWS_MIN:
        return 0.0, 0.0
    product, own, others = (float((a * b).sum()) for a, b in ((reference, other), (reference,) * 2, (other,) * 2))
    scale = sqrt(own) * sqrt(others)
    return (product / scale, sqrt(others) / sqrt(own)) if scale > 0.0 else (0.0, 0.0)


def _factor_text(factor: float) -> str:
    exact = 10.0 ** round(log10(factor))
    if exact == 1.0 or not 0.5 < factor / exact < 2.0:
        return f"{factor:.3g} times"
    return f"about {exact:g} times ({factor:.3g})"


Stamps = NDArray[np.int64]

CORDON = "cordon"
"""The name of the mode in which cordon itself flies, in its own log."""
EXTERNAL = frozenset({CORDON, *(each.external_mode for each in AUTOPILOTS)})
"""The modes in which a computer's position setpoints control the vehicle."""
US = 1e6
STAMP_MAX_US = 2**62
FAULTS_MAX = 8
"""Most faults reported for one log."""

RESTART_MIN_US, RESTART_STAMPS = 1_000_000, 3
"""An autopilot has restarted where this many stamps in a row are earlier, by this much, than as many before them."""
JUMP_MIN_M, JUMP_NOISES = 0.5, 8.0
"""A position that moves farther than its velocity states by this, and by this multiple of the usual difference, has
jumped."""
DRIFT_S = 1.0
"""The same holds for what a position gains on its velocity in this time without a jump: it stands still, or drifts."""
JUMP_WITHIN_S = 0.5
"""Over a longer gap the velocities at its ends do not tell how far the vehicle moved."""

REACH_MAX_M, SPEED_MAX_M_S = 100e3, 300.0
LIMITS = MappingProxyType(
    {
        "setpoint": (REACH_MAX_M, "m"),
        "setpoint_velocity": (SPEED_MAX_M_S, "m/s"),
        "position": (REACH_MAX_M, "m"),
        "true_position": (REACH_MAX_M, "m"),
        "velocity": (SPEED_MAX_M_S, "m/s"),
        "true_velocity": (SPEED_MAX_M_S, "m/s"),
        "attitude": (tau, "rad"),
        "battery": (5000.0, "V, A or share"),
    }
)
"""Bounds of plausible values: a log beyond them has wrong units, or is damaged."""
NAN_TOLERATED = frozenset({"setpoint", "battery"})
SUPPORTING = frozenset({"attitude", "battery"})
"""A faulty series of these is left out with a note; the others remain valid."""


@dataclass(frozen=True, slots=True)
class Samples:
    """One topic with the stamps of its log: microseconds (T,) on the vehicle's clock, and SI values (T, k), z up."""

    topic: str
    stamps_us: Stamps
    values: Vector


@dataclass(slots=True)
class RawLog:
    """The data of one vehicle as a reader found it; stamps are microseconds on the vehicle's clock.

    `begin_us` is when logging began, if the log holds it: values stamped earlier were latched, not sampled.
    """

    path: str
    format: str
    sha256: str
    autopilot: str
    firmware: str = ""
    system_id: int = 0
    begin_us: int | None = None
    samples: dict[str, Samples] = field(default_factory=dict)
    mode_topic: str = ""
    modes: list[tuple[int, str]] = field(default_factory=list)
    armed: list[tuple[int, bool]] = field(default_factory=list)
    texts: list[tuple[int, int | None, str]] = field(default_factory=list)
    resets_us: list[int] = field(default_factory=list)
    parameters: dict[str, Number] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    is_damaged: bool = False

    def add_setpoints(self, topic: str, stamps: Stamps, setpoint_m: Vector, velocity_m_s: Vector) -> None:
        """Add setpoints (T, 3), and the velocities sent with them (T, 3), NaN if there were none."""
        self.samples["setpoint"] = Samples(topic, stamps, setpoint_m)
        given = np.isfinite(velocity_m_s[:, :2]).all(axis=1)
        if given.any():
            self.samples["setpoint_velocity"] = Samples(topic, stamps[given], np.nan_to_num(velocity_m_s[given]))


def stamps_us(raw: NDArray[Any]) -> Stamps:
    """Return stamps of any integer type as signed microseconds, limited to STAMP_MAX_US."""
    if raw.dtype.kind not in "iu":
        raise ValueError(f"stamps are {raw.dtype}, not integers")
    return raw.astype(np.int64) if raw.dtype != np.uint64 else np.minimum(raw, STAMP_MAX_US).astype(np.int64)


def longest_boot(stamps: Stamps, notes: list[str]) -> tuple[int, int]:
    """Return from and up to which index the autopilot ran longest without a restart; adds a note if it restarted.

    `stamps` are of its own clock, in the order in which they were logged. Single wrong stamps are no restart.
    """
    edges = [0, stamps.size]
    if stamps.size >= 2 * RESTART_STAMPS:
        rows = sliding_window_view(stamps, RESTART_STAMPS)
        back = rows[RESTART_STAMPS:].max(axis=1) + RESTART_MIN_US < rows[:-RESTART_STAMPS].min(axis=1)
        edges[1:1] = (np.flatnonzero(back) + RESTART_STAMPS).tolist()
    boots = list(pairwise(edges))
    spans_s = [float(np.ptp(stamps[begin:end])) / US if end > begin else 0.0 for begin, end in boots]
    longest = int(np.argmax(spans_s))
    if len(boots) > 1:
        lengths = ", ".join(f"{span_s:.1f}" for span_s in spans_s)
        notes.append(
            f"the autopilot restarted: of {len(boots)} boots ({lengths} s) the longest was read, number {longest + 1}"
        )
    return boots[longest]


def vehicle_log(raw: RawLog) -> VehicleLog:
    """Return the converted log.

    Raises LogError, naming topic and time, where time goes backwards or values are implausible.
    """
    origin_us = _origin_us(raw)
    faults: list[str] = []
    series: dict[str, Series] = {}
    for name, samples in raw.samples.items():
        made, found = _series(name, samples, origin_us, raw.notes)
        if made is not None:
            series[name] = made
        elif found and name in SUPPORTING:
            raw.notes.append(f"{name} left out: {found[0]}")
            found = []
        faults += found
    stamps = [min(stamp_us, STAMP_MAX_US) for stamp_us, _ in raw.modes]
    faults += _clock_faults(raw.mode_topic, np.array(stamps, dtype=np.int64), origin_us)
    # A log without positions may still hold modes and texts.
    faults += [] if faults else unit_faults(series)
    if faults:
        raise LogError([f"{raw.path}: {fault}" for fault in faults[:FAULTS_MAX]])
    raw.resets_us += [round(time_s * US) + origin_us for time_s in _contradicted_s(series, raw.notes)]
    return _assembled(raw, series, origin_us)


def _contradicted_s(series: Mapping[str, Series], notes: list[str]) -> list[float]:
    """Return the times of positions that did not move as their velocity states, horizontally; adds notes.

    They are the first after a jump, and all while the position stands still or drifts against the velocity.
    """
    if "position" not in series or "velocity" not in series:
        return []
    position, velocity = series["position"], series["velocity"]
    time_s = position.time_s
    steps_s = np.diff(time_s)
    rates = _at(time_s, velocity.time_s, velocity.values[:, :2])
    apart = np.diff(position.values[:, :2], axis=0) - (rates[1:] + rates[:-1]) / 2.0 * steps_s[:, np.newaxis]
    apart[steps_s > JUMP_WITHIN_S] = 0.0
    apart_m = np.hypot(*apart.T)
    jumped = _beyond_noise(apart_m)
    apart[jumped] = 0.0
    drift_m = np.vstack((np.zeros(2), np.cumsum(apart, axis=0)))
    ends = np.minimum(np.searchsorted(time_s, time_s + DRIFT_S), time_s.size - 1)
    begun = _beyond_noise(np.hypot(*(drift_m[ends] - drift_m).T))
    # A window that is beyond noise counts from its begin to its end.
    edges = np.bincount(np.flatnonzero(begun), minlength=time_s.size + 1)
    edges = edges - np.bincount(ends[begun] + 1, minlength=time_s.size + 1)
    drifted = np.cumsum(edges)[: time_s.size] > 0
    if jumped.any():
        largest = int(np.argmax(np.where(jumped, apart_m, 0.0)))
        notes.append(
            f"{position.topic}: {int(jumped.sum())} jumps that the velocity does not explain, the largest of "
            f"{apart_m[largest]:.1f} m at {time_s[largest + 1]:.1f} s"
        )
    if drifted.any():
        within_s = float(steps_s[drifted[1:]].sum())
        first_s = time_s[np.argmax(drifted)]
        notes.append(
            f"{position.topic}: the position contradicts the velocity for {within_s:.1f} s, from {first_s:.1f} s"
        )
    contradicted: list[float] = time_s[drifted | np.append(False, jumped)].tolist()
    return contradicted


def _beyond_noise(apart_m: Vector) -> NDArray[np.bool_]:
    usual_m = float(np.median(apart_m)) if apart_m.size else 0.0
    return np.asarray(apart_m > max(JUMP_MIN_M, JUMP_NOISES * usual_m))


def _origin_us(raw: RawLog) -> int:
    if raw.begin_us is not None:
        return raw.begin_us
    first = [int(samples.stamps_us.min()) for samples in raw.samples.values() if samples.stamps_us.size]
    first += [stamp_us for stamp_us, _ in raw.modes[:1]]
    first += [stamp_us for stamp_us, _, _ in raw.texts[:1]] if not first else []
    return min(first, default=0)


def _assembled(raw: RawLog, series: Mapping[str, Series], origin_us: int) -> VehicleLog:
    modes = [(_seconds(stamp_us, origin_us), name) for stamp_us, name in raw.modes]
    armed = [(_seconds(stamp_us, origin_us), state) for stamp_us, state in raw.armed]
    ends = [float(one.time_s[-1]) for one in series.values()] + [time_s for time_s, _ in modes]
    end_s = max(ends, default=0.0)
    texts = [Text(_seconds(stamp_us, origin_us), severity, text) for stamp_us, severity, text in raw.texts]
    if not series:
        end_s = max([end_s, *(text.time_s for text in texts if text.time_s <= SECONDS_MAX)])
    kept = tuple(text for text in texts if text.time_s <= min(end_s + 60.0, SECONDS_MAX))
    if len(kept) < len(texts):
        raw.notes.append(f"{len(texts) - len(kept)} texts left out: stamped long after everything else")
    return VehicleLog(
        path=raw.path,
        format=raw.format,
        sha256=raw.sha256,
        autopilot=raw.autopilot,
        firmware=raw.firmware,
        system_id=raw.system_id,
        duration_s=end_s,
        **series,
        modes=tuple(ModeSegment(span, str(name), name in EXTERNAL) for span, name in _spans(modes, end_s)),
        position_resets_s=tuple(
            time_s
            for stamp_us in sorted(set(raw.resets_us))
            if 0.0 < (time_s := _seconds(stamp_us, origin_us)) <= end_s
        ),
        armed=tuple(span for span, is_armed in _spans(armed, end_s) if is_armed),
        texts=kept,
        parameters=MappingProxyType(dict(raw.parameters)),
        missing=tuple(raw.missing),
        notes=tuple(raw.notes),
        is_damaged=raw.is_damaged,
    )


def _spans(reports: Sequence[tuple[float, object]], end_s: float) -> list[tuple[Span, object]]:
    return spans_of([time_s for time_s, _ in reports], [state for _, state in reports], end_s)


def _seconds(stamp_us: int, origin_us: int) -> float:
    return max(0.0, (stamp_us - origin_us) / US)


def _series(name: str, samples: Samples, origin_us: int, notes: list[str]) -> tuple[Series | None, list[str]]:
    """Return a series, or None and its faults; unusable samples are left out with a note."""
    faults = _clock_faults(samples.topic, samples.stamps_us, origin_us)
    if faults:
        return None, faults
    stamps, values = samples.stamps_us, samples.values.astype(np.float64)
    # Of two samples with the same stamp, the later one is kept.
    usable = np.append(np.diff(stamps) > 0, True)[: stamps.size] & (stamps >= origin_us)
    if name not in NAN_TOLERATED:
        finite = np.isfinite(values).all(axis=1)
        if not finite.all():
            notes.append(f"{samples.topic}: {int((~finite).sum())} of {finite.size} samples without a {name} left out")
        usable &= finite
    if not usable.any():
        return None, []
    time_s, values = (stamps[usable] - origin_us) / US, values[usable]
    if faults := _range_faults(name, samples.topic, time_s, values):
        return None, faults
    return Series(samples.topic, COLUMNS[name], time_s, values), []


def _clock_faults(topic: str, stamps: Stamps, origin_us: int) -> list[str]:
    backwards = np.flatnonzero(np.diff(stamps) < 0)
    if backwards.size:
        before_s, after_s = ((int(stamps[backwards[0] + step]) - origin_us) / US for step in (0, 1))
        return [f"{topic}: time goes backwards at {before_s:.6f} s, to {after_s:.6f} s"]
    far = np.flatnonzero(stamps - origin_us > SECONDS_MAX * US)
    if far.size:
        return [
            f"{topic}: sample {far[0]} is stamped {(int(stamps[far[0]]) - origin_us) / US:.6g} s after the log's begin"
        ]
    return []


def _range_faults(name: str, topic: str, time_s: Vector, values: Vector) -> list[str]:
    limit, unit = LIMITS[name]
    beyond = np.argwhere((np.abs(values) > limit) & ~np.isnan(values))
    if not beyond.size:
        return []
    row, column = beyond[0]
    return [
        f"{topic}: {COLUMNS[name][column]} = {values[row, column]:.6g} {unit} at {time_s[row]:.3f} s "
        f"is not a plausible {name.replace('_', ' ')} (at most {limit:g} {unit}): wrong units, or a damaged log"
    ]
