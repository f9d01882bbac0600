"""The grade of an identified plant, with the reasons as text."""

from collections.abc import Sequence

import numpy as np

from estimation.identification.excerpts import Excerpt, MotionRecording
from estimation.identification.identified import IdentificationResult, ParameterEstimate
from estimation.identification.output_error import DELAY_MAX_S, DELAY_MIN_S
from estimation.plant.model import FEEDFORWARD_MAX, PlantGrade
from estimation.state import Vector

DURATION_MIN_S = 30.0
SETPOINT_MOTION_MIN_M = 0.3
MOTION_SHARE_MIN = 0.15
WIDE_GOOD, WIDE_USABLE = 0.15, 0.5
DELAY_WIDE_GOOD_S, DELAY_WIDE_USABLE_S = 0.08, 0.2
DELAY_SPREAD_GOOD_S = 0.15
EARLY_GOOD_S, EARLY_USABLE_S = 0.05, 0.12
"""A response this long before the setpoint. Without a delay the plant is too quick: at the second, a0 by a quarter."""
FIT_GOOD_PERCENT, FIT_USABLE_PERCENT = 70.0, 40.0
LIMITED_SHARE_MIN, SATURATED_SHARE, SATURATED_RATIO = 0.03, 0.1, 0.6
"""Limits that acted for less than the first share of the time are no reason; from the second on, where the plant with
limits leaves less than this ratio of the error, the plant without them is wrong.
"""
_AXES = ("x", "y")

Reasons = list[tuple[PlantGrade, str]]


def refused(recordings: Sequence[MotionRecording], excerpts: Sequence[Excerpt]) -> IdentificationResult | None:
    """Return the result for flights without enough excitation, None if there is enough."""
    duration_s = sum(excerpt.duration_s for excerpt in excerpts)
    reason = _refusal(recordings, excerpts, duration_s)
    return None if reason is None else IdentificationResult(PlantGrade.DO_NOT_FLY, (reason,), duration_s, len(excerpts))


def _refusal(recordings: Sequence[MotionRecording], excerpts: Sequence[Excerpt], duration_s: float) -> str | None:
    if not any(recording.flown_s for recording in recordings):
        return "wrong mode: at no time did a computer's position setpoints fly the vehicle (offboard, guided)"
    if not excerpts or duration_s < DURATION_MIN_S:
        return (
            f"too short: {duration_s:.0f} s were flown by position setpoints without a break or a reset of the "
            f"estimator; {DURATION_MIN_S:.0f} s is the minimum, some minutes are better"
        )
    setpoint_m = np.sqrt(np.mean(np.concatenate([_centred(each.setpoint_m()) for each in excerpts]) ** 2, axis=0))
    moved_m = np.sqrt(np.mean(np.concatenate([_centred(each.position_m) for each in excerpts]) ** 2, axis=0))
    for name, setpoint, moved in zip(_AXES, setpoint_m.tolist(), moved_m.tolist(), strict=True):
        if setpoint < SETPOINT_MOTION_MIN_M:
            return (
                f"too little excitation: along {name} the setpoint moved by {setpoint:.2f} m rms; fly steps of metres "
                "along both axes"
            )
        if moved < MOTION_SHARE_MIN * setpoint:
            return (
                f"the vehicle hardly moved: along {name} by {moved:.2f} m rms, with setpoints that moved by "
                f"{setpoint:.2f} m rms: it was not flown by them"
            )
    return None


def _centred(values: Vector) -> Vector:
    return np.asarray(values - values.mean(axis=0), dtype=np.float64)


def graded(
    found: ParameterEstimate, unbounded_delay_s: float, delay_deviation_s: float
) -> tuple[PlantGrade, tuple[str, ...]]:
    """Return the grade of an identified plant, with the reasons, the most severe first."""
    reasons = [*_of_shaping(found), *_of_axes(found), *_of_delay(found, unbounded_delay_s, delay_deviation_s)]
    reasons += _of_feedforward(found)
    if not found.order.second_is_enough:
        reasons.append(
            (
                PlantGrade.USABLE,
                f"second order is not sufficient: with an additional lag of {found.order.lag_s:.2f} s the fit would be "
                f"{found.order.fit_third_percent:.0f} % instead of {found.order.fit_second_percent:.0f} %",
            )
        )
    if not found.consistent:
        reasons.append(
            (
                PlantGrade.USABLE,
                "the vehicle is not exactly of second order: slow and fast motions fit different parameters",
            )
        )
    gravity = list(PlantGrade)
    reasons.sort(key=lambda reason: -gravity.index(reason[0]))
    verdict = reasons[0][0] if reasons else PlantGrade.GOOD
    return verdict, tuple(words for _, words in reasons)


def _of_shaping(found: ParameterEstimate) -> Reasons:
    shaping = found.shaping
    if not shaping.matters:
        return []
    limits = (
        (shaping.speed_share, f"speed was limited to {shaping.speed_max_m_s:.1f} m/s"),
        (shaping.acceleration_share, f"acceleration was limited to {shaping.acceleration_max_m_s2:.1f} m/s2"),
    )
    return [
        (
            PlantGrade.DO_NOT_FLY
            if share > SATURATED_SHARE and shaping.error_ratio < SATURATED_RATIO
            else PlantGrade.USABLE,
            f"saturation: {words} for {100 * share:.0f} % of the time; fly smaller or slower setpoints",
        )
        for share, words in sorted(limits, reverse=True)
        if share > LIMITED_SHARE_MIN
    ]


def _of_delay(found: ParameterEstimate, unbounded_s: float, deviation_s: float) -> Reasons:
    delay = found.delay_s
    if delay.value > DELAY_MAX_S - 0.01:
        words = f"the delay is at its bound of {DELAY_MAX_S:g} s"
        return [(PlantGrade.DO_NOT_FLY, f"{words}: the clocks differ, or the vehicle was not flown by these setpoints")]
    if unbounded_s < min(-EARLY_GOOD_S, -3.0 * deviation_s) or unbounded_s < DELAY_MIN_S + 0.01:
        return [
            (
                PlantGrade.USABLE if unbounded_s > -EARLY_USABLE_S else PlantGrade.DO_NOT_FLY,
                f"the vehicle seems to respond {-unbounded_s:.2f} s before the setpoint: its log time-stamps setpoints "
                "late, or the autopilot shapes them; the delay was taken as 0",
            )
        ]
    if found.delay_spread_s > DELAY_SPREAD_GOOD_S:
        words = f"the delay differs by {found.delay_spread_s:.2f} s (rms) from time to time"
        return [(PlantGrade.USABLE, f"{words}: a busy link, or a vehicle that is not exactly of second order")]
    half_s = max(delay.high - delay.value, delay.value - delay.low)
    if half_s > DELAY_WIDE_GOOD_S:
        verdict = PlantGrade.DO_NOT_FLY if half_s > DELAY_WIDE_USABLE_S else PlantGrade.USABLE
        return [(verdict, f"{_why_wide(found)}: uncertainty of the delay {half_s:.2f} s")]
    return []


def _of_feedforward(found: ParameterEstimate) -> Reasons:
    gain = found.feedforward
    if gain is None:
        return []
    words = f"the feed-forward is {gain.value:.2f} ({gain.low:.2f} to {gain.high:.2f})"
    if gain.low <= 0.0:
        step = "check that the autopilot uses them, or fly position setpoints only"
        return [(PlantGrade.DO_NOT_FLY, f"{words}: the feed-forward velocities show no effect; {step}")]
    if gain.low > FEEDFORWARD_MAX:
        return [(PlantGrade.DO_NOT_FLY, f"{words}, more than any autopilot's {FEEDFORWARD_MAX:g}: check the units")]
    if gain.relative > WIDE_GOOD:
        verdict = PlantGrade.DO_NOT_FLY if gain.relative > WIDE_USABLE else PlantGrade.USABLE
        return [(verdict, f"{_why_wide(found)}: {words}")]
    return []


def _why_wide(found: ParameterEstimate) -> str:
    if _of_shaping(found):
        return "saturation"
    return "too little excitation for this noise" if found.consistent else "the vehicle is not exactly of second order"


def _of_axes(found: ParameterEstimate) -> Reasons:
    reasons: Reasons = []
    wide: list[tuple[float, str]] = []
    for name, axis in zip(_AXES, found.axes, strict=True):
        wide += [
            (interval.relative, f"{parameter} along {name} {100 * min(interval.relative, 9.99):.0f} %")
            for parameter, interval in (("a0", axis.a0_per_s2), ("a1", axis.a1_per_s))
            if interval.relative > WIDE_GOOD
        ]
        if axis.fit_percent < FIT_GOOD_PERCENT:
            verdict = PlantGrade.DO_NOT_FLY if axis.fit_percent < FIT_USABLE_PERCENT else PlantGrade.USABLE
            reasons.append((verdict, f"along {name} the validation fit is {axis.fit_percent:.0f} %"))
    if wide:
        verdict = PlantGrade.DO_NOT_FLY if max(relative for relative, _ in wide) > WIDE_USABLE else PlantGrade.USABLE
        words = ", ".join(words for _, words in wide)
        reasons.insert(0, (verdict, f"{_why_wide(found)}: uncertainty of {words}"))
    return reasons
