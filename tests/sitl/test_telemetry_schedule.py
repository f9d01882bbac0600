"""When telemetry comes: rate, jitter and gaps as told."""

import numpy as np
import pytest

from estimation.state import Vector
from sitl.vehicle.imperfections import TelemetrySchedule, TelemetryTiming


def times_s(model: TelemetryTiming, until_s: float, seed: int = 5) -> Vector:
    telemetry_timing = TelemetrySchedule(model, np.random.default_rng(seed))
    return np.concatenate([telemetry_timing.due_s(at_s) for at_s in np.arange(0.0, until_s, 0.1)])


def test_jitter_moves_every_sample_within_its_share_and_never_past_another() -> None:
    times = times_s(TelemetryTiming(20.0, jitter=0.3), 200.0)
    off = times * 20.0 - np.arange(len(times))
    assert np.abs(off).max() <= 0.3 + 1e-9
    assert off.std() == pytest.approx(0.3 / np.sqrt(3.0), rel=0.05)
    assert np.diff(times).min() > 0.0


def test_gaps_have_the_given_interval_and_duration() -> None:
    times = times_s(TelemetryTiming(50.0, gaps_every_s=20.0, gap_s=0.4), 4000.0)
    gaps = np.diff(times)[np.diff(times) > 0.1]
    assert len(gaps) == pytest.approx(4000.0 / 20.0, rel=0.2)
    assert gaps.min() >= 0.4 - 1e-9
    assert np.median(gaps) < 0.4 + 2.0 / 50.0 + 1e-9
