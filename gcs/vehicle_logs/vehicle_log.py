"""The content of one vehicle's log, whatever its format: time series, flight modes, texts and parameters. No I/O.

Every vector is in one frame: right-handed about the vehicle's own local origin, x north, y west, z up, which is the
mission frame of bearing 0 (see `estimation.frames`). Times are seconds since the log's first sample, on the vehicle's
own clock. A reader lists in `notes` what it left out, and in `missing` the topics that it did not find.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite
from types import MappingProxyType

import numpy as np

from estimation.state import Vector
from gcs.flightlog.container import LogError

SECONDS_MAX = 7 * 86400.0
"""No flight lasts longer than this; a stamp farther from its log's first sample is not valid."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One quantity over time: `time_s` (T,), strictly increasing, and `values` (T, k) with one column for each name.

    `topic` is its name in the log. Raises ValueError when the shapes do not match, a time is not finite or does not
    come after the one before. Readers leave out empty series.
    """

    topic: str
    columns: tuple[str, ...]
    time_s: Vector
    values: Vector

    def __post_init__(self) -> None:
        if self.time_s.ndim != 1 or self.values.shape != (self.time_s.size, len(self.columns)):
            raise ValueError(f"{self.topic}: {self.values.shape} values for {self.time_s.shape} times")
        if self.time_s.size == 0 or not np.isfinite(self.time_s).all():
            raise ValueError(f"{self.topic}: no times, or some that are not finite")
        if (np.diff(self.time_s) <= 0.0).any():
            raise ValueError(f"{self.topic}: times do not increase")

    @property
    def rate_hz(self) -> float:
        """The usual rate: one over the median of the intervals; 0 for a single sample."""
        return 1.0 / float(np.median(np.diff(self.time_s))) if self.time_s.size > 1 else 0.0


@dataclass(frozen=True, slots=True)
class Span:
    """A part of the log, from `begin_s` up to `end_s`."""

    begin_s: float
    end_s: float

    def __post_init__(self) -> None:
        if not (isfinite(self.begin_s) and isfinite(self.end_s) and self.begin_s <= self.end_s):
            raise ValueError(f"{self} is no part of a log")


@dataclass(frozen=True, slots=True)
class ModeSegment:
    """A span in one flight mode; `external` if a computer's setpoints control the vehicle: offboard, guided."""

    span: Span
    name: str
    external: bool


@dataclass(frozen=True, slots=True)
class Text:
    """A status text of the autopilot; `severity` from 0, emergency, to 7, debug; None if the log does not state it."""

    time_s: float
    severity: int | None
    text: str


Number = int | float


@dataclass(frozen=True, slots=True, eq=False)
class VehicleLog:
    """One vehicle's log. Positions [m], velocities [m/s], attitude as roll, pitch, yaw [rad] of front, left, up.

    `setpoint` holds the position setpoints x, y, z at the times at which they were logged, NaN on an axis without one,
    and `setpoint_velocity` the velocities sent with them, if any; `battery` holds volts,
    amperes and the share remaining (0 to 1), NaN if unknown. At `position_resets_s` the estimator reset its
    position. A series is None if the log has none. `sha256` is that of the whole file, `format` the
    name of its format. It `is_damaged` if more is wrong than an early end, as after a loss of power.
    """

    path: str
    format: str
    sha256: str
    autopilot: str
    firmware: str
    system_id: int
    duration_s: float
    setpoint: Series | None = None
    setpoint_velocity: Series | None = None
    position: Series | None = None
    velocity: Series | None = None
    true_position: Series | None = None
    true_velocity: Series | None = None
    attitude: Series | None = None
    battery: Series | None = None
    modes: tuple[ModeSegment, ...] = ()
    position_resets_s: tuple[float, ...] = ()
    armed: tuple[Span, ...] = ()
    texts: tuple[Text, ...] = ()
    parameters: Mapping[str, Number] = field(default_factory=lambda: MappingProxyType({}))
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    is_damaged: bool = False

    def series(self) -> dict[str, Series]:
        """Return the series that the log has, by the name of their field."""
        named = {name: getattr(self, name) for name in SERIES}
        return {name: series for name, series in named.items() if series is not None}

    def require(self, *names: str) -> None:
        """Raise LogError with the topics looked for if one of the named series is missing."""
        absent = [name for name in names if getattr(self, name) is None]
        if absent:
            looked = f"; looked for {', '.join(self.missing)}" if self.missing else ""
            wanted = " and ".join(name.replace("_", " ") for name in absent)
            raise LogError([f"{self.path}: vehicle {self.system_id}: the log has no {wanted}{looked}"])


SERIES = (
    *("setpoint", "setpoint_velocity", "position", "velocity", "true_position", "true_velocity"),
    *("attitude", "battery"),
)
XYZ = ("x", "y", "z")
COLUMNS = MappingProxyType(
    {
        "setpoint": XYZ,
        "setpoint_velocity": XYZ,
        "position": XYZ,
        "velocity": XYZ,
        "true_position": XYZ,
        "true_velocity": XYZ,
        "attitude": ("roll", "pitch", "yaw"),
        "battery": ("volt", "ampere", "remaining"),
    }
)
"""The series of a log, and the names of their columns."""


def spans_of(times_s: Sequence[float], states: Sequence[object], end_s: float) -> list[tuple[Span, object]]:
    """Return the spans in which a state reported at increasing times stayed the same; the last one ends at `end_s`."""
    changes = [
        (time_s, state)
        for index, (time_s, state) in enumerate(zip(times_s, states, strict=True))
        if index == 0 or state != states[index - 1]
    ]
    ends_s = [time_s for time_s, _ in changes[1:]] + [max(end_s, changes[-1][0])] if changes else []
    return [(Span(begin_s, end_s), state) for (begin_s, state), end_s in zip(changes, ends_s, strict=True)]


def describe(log: VehicleLog) -> list[tuple[str, str]]:
    """Return the content of a log as text, for reports and the command line: items by name, some without content."""
    firmware = f", firmware {log.firmware}" if log.firmware else ""
    items = [(f"{log.format} of vehicle {log.system_id}", f"{log.autopilot}{firmware}, {log.duration_s:.1f} s")]
    for name, series in log.series().items():
        items.append((name.replace("_", " "), _series_text(series)))
    items += [(f"no {topic} in it", "") for topic in log.missing]
    external_s = sum(mode.span.end_s - mode.span.begin_s for mode in log.modes if mode.external)
    if log.modes:
        names = " -> ".join(dict.fromkeys(mode.name for mode in log.modes))
        items.append(("flight modes", f"{names}; {external_s:.1f} s under external position control"))
    if log.armed:
        items.append((f"armed for {sum(span.end_s - span.begin_s for span in log.armed):.1f} s", ""))
    items.append((f"{len(log.texts)} status texts, {len(log.parameters)} parameters", ""))
    return items + [("note", note) for note in log.notes]


def _series_text(series: Series) -> str:
    text = f"{series.time_s.size} samples from {series.topic}"
    if series.time_s.size > 1:
        gap_s = max(later - earlier for earlier, later in pairwise(series.time_s.tolist()))
        begin_s, end_s = series.time_s[0], series.time_s[-1]
        text += f", {series.rate_hz:.3g} Hz, {begin_s:.1f} to {end_s:.1f} s, longest gap {gap_s:.2f} s"
    unset = [name for name, column in zip(series.columns, series.values.T, strict=True) if bool(np.isnan(column).all())]
    return text + (f", without {', '.join(unset)}" if unset else "")
