"""The metrics of the ring as a whole: when it settled, and the spacings between neighbours.

Arrays over time have shape (T,): the record's samples.
"""

from dataclasses import dataclass

import numpy as np

from estimation.state import Vector
from gcs.metrics.record import TIME_GRAIN_S, Mask, grid_time, largest, rms
from gcs.metrics.references import DesiredRing
from gcs.metrics.ring_motion import RingMotion, off_ring

SETTLED_FOR_S = 10.0
"""A ring that stays within its limits for this time has settled, even if it leaves them later."""


@dataclass(frozen=True, slots=True)
class RingResult:
    """The ring as a whole: time from the last engagement to settling, and the spacings between neighbours.

    `unsettled_at_s` is when a ring that had settled left its limits for the last time, None if it never did after the
    last engagement; `first_settled_at_s` is when it had settled first, None without that.
    """

    settling_time_s: float | None = None
    spacing_error_rms_deg: float | None = None
    spacing_error_max_deg: float | None = None
    first_settled_at_s: float | None = None
    unsettled_at_s: float | None = None


def judged_ring(
    time_s: Vector, motion: RingMotion, ring: DesiredRing, engaged_s: list[float]
) -> tuple[tuple[float, float] | None, RingResult]:
    """Return the window of the ring metrics, None where none engaged, and the ring as a whole."""
    if not engaged_s:
        return None, RingResult()
    settled_s = _settled_at_s(time_s, motion, ring, max(engaged_s))
    window_s = _window_s(time_s, settled_s)
    settling_time_s = None if settled_s is None else grid_time(settled_s - max(engaged_s))
    errors_deg = _spacing_errors_deg(motion, within(time_s, window_s))
    return window_s, RingResult(settling_time_s, *errors_deg, *_unsettled(time_s, motion, ring, max(engaged_s)))


def estimated_ring(
    time_s: Vector, motion: RingMotion, ring: DesiredRing, engaged_s: list[float], window: Mask
) -> RingResult:
    """Return the ring by the vehicles' estimates, its spacings in the window of the truth."""
    settled_s = _settled_at_s(time_s, motion, ring, max(engaged_s)) if engaged_s else None
    settling_time_s = None if settled_s is None else grid_time(settled_s - max(engaged_s))
    return RingResult(settling_time_s, *_spacing_errors_deg(motion, window))


def _settled_at_s(time_s: Vector, motion: RingMotion, ring: DesiredRing, last_engaged_s: float) -> float | None:
    """Return the time after the last engagement from which the ring stays within its limits to the end, or None."""
    outside = np.flatnonzero(off_ring(motion, ring))
    # Settling starts at a sample at which every member of the ring was measured.
    valid = motion.measured & (time_s >= last_engaged_s - TIME_GRAIN_S)
    valid[: outside[-1] + 1 if outside.size else 0] = False
    return float(time_s[np.argmax(valid)]) if valid.any() else None


def _unsettled(
    time_s: Vector, motion: RingMotion, ring: DesiredRing, last_engaged_s: float
) -> tuple[float | None, float | None]:
    """Return when the ring had settled first, and when it left its limits last after that; None if it never did.

    It counts as settled once it was within its limits for `SETTLED_FOR_S`.
    """
    off = off_ring(motion, ring)
    known = (off | motion.measured) & (time_s >= last_engaged_s - TIME_GRAIN_S)
    off, at_s = off[known], time_s[known]
    changes = np.flatnonzero(np.diff(off)) + 1
    begins, ends = np.append(0, changes), np.append(changes, off.size)
    stays = [
        (at_s[begin], at_s[end]) for begin, end in zip(begins, ends, strict=True) if end < off.size and not off[begin]
    ]
    settled_s = next((begin_s for begin_s, end_s in stays if end_s - begin_s >= SETTLED_FOR_S), None)
    if settled_s is None:
        return None, None
    return grid_time(float(settled_s)), grid_time(float(stays[-1][1]))


def _window_s(time_s: Vector, settled_s: float | None) -> tuple[float, float]:
    start_s, end_s = float(time_s[0]), float(time_s[-1])
    window_start_s = settled_s if settled_s is not None else end_s - (end_s - start_s) / 4.0
    return grid_time(window_start_s), grid_time(end_s)


def within(time_s: Vector, window_s: tuple[float, float] | None) -> Mask:
    """Return the samples (T,) in a window, none without one."""
    if window_s is None:
        return np.zeros(time_s.shape, dtype=np.bool_)
    return np.asarray((time_s >= window_s[0] - TIME_GRAIN_S) & (time_s <= window_s[1] + TIME_GRAIN_S))


def _spacing_errors_deg(motion: RingMotion, window: Mask) -> tuple[float | None, float | None]:
    error_deg = np.degrees(motion.lead_rad - motion.desired_spacing_rad)[:, window]
    return rms(error_deg), largest(error_deg)
