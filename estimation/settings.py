"""Settings of the estimators: validated, immutable, with their defaults."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Settings(BaseModel):
    """Base of every section: unknown keys are errors, numbers are finite, nothing changes after loading."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


def tuned(default: float | None, reason: str, symbol: str = "", **limits: float) -> Any:
    """Return a field that tunes a controller: its default with the reason for it, and the paper's symbol."""
    return Field(default, description=reason, json_schema_extra={"symbol": symbol}, **limits)  # type: ignore[call-overload]  # gt, ge, lt, le


class OwnFilterSettings(Settings):
    """Noise of a vehicle's own telemetry and of the plant model; standard deviations, and densities per root second.

    The disturbance is what the plant leaves unexplained. Part of it stands still, as wind does; a vehicle on the ring
    also looks for a part that swings as it goes around, as a wrong plant's errors do, unless `disturbance_turns` is
    false.
    """

    position_noise_m: float = tuned(
        0.02,
        "The stub's telemetry is exact. A small value keeps the filter quick; a real vehicle's profile has its own.",
        gt=0.0,
        le=10.0,
    )
    velocity_noise_m_s: float = tuned(0.02, "As for the position.", gt=0.0, le=10.0)
    acceleration_noise_m_s2: float = tuned(
        0.05, "Small beside what setpoints cause: an identified plant explains most of the motion.", gt=0.0, le=10.0
    )
    disturbance_noise_m_s2: float = tuned(
        0.03,
        "Slow enough to leave the noise of the telemetry out, fast enough for a wind that changes.",
        gt=0.0,
        le=10.0,
    )
    disturbance_max_m_s2: float = tuned(
        0.6,
        "Room for a fresh wind. Without a bound the disturbance of a vehicle that shapes its motion, as ArduCopter "
        "does, may grow without end.",
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
        "How far the integral of the reported velocity departs from the way flown, per root second: noise of s at f Hz "
        "gives s / sqrt(f), an error of s that lasts for t gives s sqrt(2 t). Where it is large the velocity does not "
        "show the wander.",
        gt=0.0,
        le=10.0,
    )
    disturbance_turns: bool = tuned(True, "Without it a wrong plant costs radius and rate on the ring (control.md).")
    gate_sigma: float = tuned(
        5.0,
        "A sample is refused beyond so many times the expected innovation (rms): a sound one never, a jump always.",
        gt=1.0,
        le=20.0,
    )
    gate_timeout_s: float = tuned(
        1.0,
        "Twenty samples in a row at 20 Hz: then the vehicle's estimator has moved, and the filter starts again.",
        gt=0.0,
        le=60.0,
    )


class TargetBehaviour(Settings):
    """What is known of the target: how it moves, and for how long it counts as known without sightings.

    It is expected to keep its velocity but for `acceleration_noise_m_s2`, a density per root second. Once sightings
    disagree with that on one side, its velocity may have changed by `manoeuvre_speed_m_s`, and for some time after it
    may accelerate by `manoeuvre_acceleration_m_s2`. `velocity_prior_m_s` is the standard deviation of its velocity
    before the first sightings. Out of sight it keeps its velocity for about `coast_s`; after `stale_after_s` without a
    sighting its place counts as unknown.
    """

    acceleration_noise_m_s2: float = Field(0.02, gt=0.0, le=10.0)
    manoeuvre_acceleration_m_s2: float = Field(0.5, ge=0.0, le=20.0)
    manoeuvre_speed_m_s: float = Field(1.5, gt=0.0, le=20.0)
    velocity_prior_m_s: float = Field(1.0, gt=0.0, le=20.0)
    coast_s: float = Field(2.0, gt=0.0, le=60.0)
    stale_after_s: float = Field(10.0, gt=0.0, le=600.0)


class TargetFilterTuning(Settings):
    """The target filter: how it treats outliers and late sightings."""

    gate_sigma: float = tuned(
        4.0,
        "A sighting is refused beyond so many times the expected innovation (rms): a sound one hardly ever, an "
        "outlier of 8 m with noise of 0.5 m always.",
        gt=1.0,
        le=20.0,
    )
    gate_timeout_s: float = tuned(
        2.0,
        "Ten sightings in a row at 5 Hz: then the estimate is wrong, and the filter starts again.",
        gt=0.0,
        le=60.0,
    )
    late_max_s: float = tuned(
        1.0, "A slow radio takes less. An older sighting adds little, and costs a longer history.", ge=0.0, le=10.0
    )


class TargetFilterSettings(TargetBehaviour, TargetFilterTuning):
    """All settings of the target filter."""
