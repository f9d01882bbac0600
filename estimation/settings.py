"""Settings of the estimators: validated, immutable, with defaults."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Settings(BaseModel):
    """Base of every section: unknown keys are errors, numbers are finite, nothing changes after loading."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


def tuned(default: float | None, reason: str, symbol: str = "", **limits: float) -> Any:
    """Return a tuning field: its default with the reason for it, and the paper's symbol."""
    return Field(default, description=reason, json_schema_extra={"symbol": symbol}, **limits)  # type: ignore[call-overload]  # gt, ge, lt, le


class OwnFilterSettings(Settings):
    """Noise of a vehicle's own telemetry and of the plant model: standard deviations, and densities per root second.

    The disturbance is the acceleration that the plant does not explain. One part is constant, such as wind. On the ring
    the filter also estimates a part at the ring's frequency, such as the error of a wrong plant, unless
    `disturbance_turns` is false.
    """

    position_noise_m: float = tuned(
        0.02,
        "The stub's telemetry is exact, and a small value keeps the filter fast. Profiles of real vehicles have their "
        "own value.",
        gt=0.0,
        le=10.0,
    )
    velocity_noise_m_s: float = tuned(0.02, "As for the position.", gt=0.0, le=10.0)
    acceleration_noise_m_s2: float = tuned(
        0.05, "Small beside commanded accelerations: an identified plant explains most motion.", gt=0.0, le=10.0
    )
    disturbance_noise_m_s2: float = tuned(
        0.03,
        "Slow enough to reject the noise of the telemetry, fast enough for changing wind.",
        gt=0.0,
        le=10.0,
    )
    disturbance_max_m_s2: float = tuned(
        0.6,
        "Sufficient for a fresh breeze. Without a limit the disturbance of a vehicle with shaped motion, such as "
        "ArduCopter, may diverge.",
        ge=0.0,
        le=10.0,
    )
    wander_m: float = tuned(
        0.0,
        "Standard deviation per axis of the slow error of the reported position; 0 estimates none. A GPS receiver's is "
        "0.2 to 1 m, with RTK 0.02 m.",
        ge=0.0,
        le=5.0,
    )
    wander_s: float = tuned(20.0, "Correlation time of that error.", gt=0.0, le=3600.0)
    velocity_walk_m: float = tuned(
        0.1,
        "Random walk of the integral of the reported velocity, per root second: noise of s at f Hz gives s / sqrt(f), "
        "an error of s that lasts for t gives s sqrt(2 t). If it is large, the velocity does not reveal the wander.",
        gt=0.0,
        le=10.0,
    )
    disturbance_turns: bool = tuned(
        True, "Without it, plant errors cause errors of radius and rate on the ring (control.md)."
    )
    gate_sigma: float = tuned(
        5.0,
        "Innovation gate, in multiples of the expected rms innovation: passes every sound sample, rejects every jump.",
        gt=1.0,
        le=20.0,
    )
    gate_timeout_s: float = tuned(
        1.0,
        "After 20 rejected samples in a row, at 20 Hz, the vehicle's estimator has moved, and the filter restarts.",
        gt=0.0,
        le=60.0,
    )


class TargetBehaviour(Settings):
    """The target filter's motion model, and how long the estimate is valid without sightings.

    The velocity is constant but for `acceleration_noise_m_s2`, a density per root second. When sightings deviate from
    that consistently to one side, the velocity may have changed by `manoeuvre_speed_m_s`, and for some time the target
    may accelerate by `manoeuvre_acceleration_m_s2`. `velocity_prior_m_s` is the standard deviation of the velocity
    before the first sightings. Without sightings the velocity is kept for about `coast_s`; after `stale_after_s` the
    position is unknown.
    """

    acceleration_noise_m_s2: float = Field(0.02, gt=0.0, le=10.0)
    manoeuvre_acceleration_m_s2: float = Field(0.5, ge=0.0, le=20.0)
    manoeuvre_speed_m_s: float = Field(1.5, gt=0.0, le=20.0)
    velocity_prior_m_s: float = Field(1.0, gt=0.0, le=20.0)
    coast_s: float = Field(2.0, gt=0.0, le=60.0)
    stale_after_s: float = Field(10.0, gt=0.0, le=600.0)


class TargetFilterTuning(Settings):
    """The target filter: outliers and late sightings."""

    gate_sigma: float = tuned(
        4.0,
        "Innovation gate, in multiples of the expected rms innovation: passes nearly every sound sighting, rejects "
        "every outlier of 8 m with noise of 0.5 m.",
        gt=1.0,
        le=20.0,
    )
    gate_timeout_s: float = tuned(
        2.0,
        "After 10 rejected sightings in a row, at 5 Hz, the estimate is wrong, and the filter restarts.",
        gt=0.0,
        le=60.0,
    )
    late_max_s: float = tuned(
        1.0,
        "More than the delay of a slow radio. An older sighting adds little, and needs a longer history.",
        ge=0.0,
        le=10.0,
    )


class TargetFilterSettings(TargetBehaviour, TargetFilterTuning):
    """All settings of the target filter."""
