"""Settings of the estimators: validated, immutable, with defaults."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Settings(BaseModel):
    """Base of every section: unknown keys are errors, numbers are finite, nothing changes after loading."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


def tuned(default: float | None, meaning: str, reason: str = "", symbol: str = "", **limits: float) -> Any:
    """Return a tuning field: its default, its meaning, the reason for the default, and the paper's symbol."""
    extra = {"symbol": symbol, "reason": reason}
    return Field(default, description=meaning, json_schema_extra=extra, **limits)  # type: ignore[call-overload]  # gt, ge, lt, le


class OwnFilterSettings(Settings):
    """Noise of a vehicle's telemetry and of the plant model. The disturbance is the acceleration that the plant does
    not explain.
    """

    position_noise_m: float = tuned(
        0.02,
        "noise of the reported position, standard deviation",
        "The stub's telemetry is exact, and a small value keeps the filter fast. Profiles of real vehicles have their "
        "own value.",
        gt=0.0,
        le=10.0,
    )
    velocity_noise_m_s: float = tuned(
        0.02,
        "noise of the reported velocity, standard deviation",
        "As for the position.",
        gt=0.0,
        le=10.0,
    )
    acceleration_noise_m_s2: float = tuned(
        0.05,
        "noise of the plant model, per root second",
        "Small beside commanded accelerations: an identified plant explains most motion.",
        gt=0.0,
        le=10.0,
    )
    disturbance_noise_m_s2: float = tuned(
        0.03,
        "change of the disturbance, per root second",
        "Slow enough to reject the noise of the telemetry, fast enough for changing wind.",
        gt=0.0,
        le=10.0,
    )
    disturbance_max_m_s2: float = tuned(
        0.6,
        "bound of the disturbance",
        "Sufficient for a fresh breeze. Without a limit the disturbance of a vehicle with shaped motion, such as "
        "ArduCopter, may diverge.",
        ge=0.0,
        le=10.0,
    )
    wander_m: float = tuned(
        0.0,
        "slow error of the reported position, standard deviation per axis (GPS: 0.2 to 1, RTK: 0.02); 0: none",
        "No wander is estimated unless the profile states it.",
        ge=0.0,
        le=5.0,
    )
    wander_s: float = tuned(
        20.0,
        "correlation time of that error",
        "Typical of GPS receivers.",
        gt=0.0,
        le=3600.0,
    )
    velocity_walk_m: float = tuned(
        0.1,
        "drift of the integrated velocity from the true way, per root second",
        "Random walk of the integral of the reported velocity, per root second: noise of s at f Hz gives s / sqrt(f), "
        "an error of s that lasts for t gives s sqrt(2 t). If it is large, the velocity does not reveal the wander.",
        gt=0.0,
        le=10.0,
    )
    disturbance_turns: bool = tuned(
        True,
        "estimate a disturbance at the ring's frequency, too",
        "Without it, plant errors cause errors of radius and rate on the ring (docs/notes/control.md).",
    )
    gate_sigma: float = tuned(
        5.0,
        "innovation gate, in multiples of the expected innovation",
        "Passes every sound sample, rejects every jump.",
        gt=1.0,
        le=20.0,
    )
    gate_timeout_s: float = tuned(
        1.0,
        "the filter restarts after rejecting samples for this time",
        "After 20 rejected samples in a row, at 20 Hz, the vehicle's estimator has moved, and the filter restarts.",
        gt=0.0,
        le=60.0,
    )


class TargetBehaviour(Settings):
    """The target filter's motion model, and how long the estimate is valid without sightings."""

    acceleration_noise_m_s2: float = Field(
        0.02, gt=0.0, le=10.0, description="filter: change of a steady target's velocity, per root second"
    )
    manoeuvre_acceleration_m_s2: float = Field(
        0.5, ge=0.0, le=20.0, description="filter: the same for some time after a manoeuvre"
    )
    manoeuvre_speed_m_s: float = Field(
        1.5, gt=0.0, le=20.0, description="filter: change of the velocity by a manoeuvre"
    )
    velocity_prior_m_s: float = Field(
        1.0, gt=0.0, le=20.0, description="filter: standard deviation of the velocity at first"
    )
    coast_s: float = Field(2.0, gt=0.0, le=60.0, description="filter: how long the velocity is kept without sightings")
    stale_after_s: float = Field(
        10.0,
        gt=0.0,
        le=600.0,
        description="time without sightings after which the position is unknown and vehicles on the ring hold",
    )


class TargetFilterTuning(Settings):
    """The target filter: outliers and late sightings."""

    gate_sigma: float = tuned(
        4.0,
        "innovation gate, in multiples of the expected innovation",
        "Passes nearly every sound sighting, rejects every outlier of 8 m with noise of 0.5 m.",
        gt=1.0,
        le=20.0,
    )
    gate_timeout_s: float = tuned(
        2.0,
        "the filter restarts after rejecting sightings for this time",
        "After 10 rejected sightings in a row, at 5 Hz, the estimate is wrong, and the filter restarts.",
        gt=0.0,
        le=60.0,
    )
    late_max_s: float = tuned(
        1.0,
        "largest delay of a sighting that is used",
        "More than the delay of a slow radio. An older sighting adds little, and needs a longer history.",
        ge=0.0,
        le=10.0,
    )


class TargetFilterSettings(TargetBehaviour, TargetFilterTuning):
    """All settings of the target filter."""
