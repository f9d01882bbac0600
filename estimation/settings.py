"""Settings of the estimators: a section of the mission file, validated, immutable, with its defaults."""

from pydantic import BaseModel, ConfigDict, Field


class Settings(BaseModel):
    """Base of every section: unknown keys are errors, numbers are finite, nothing changes after loading."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class OwnFilterSettings(Settings):
    """Noise of a vehicle's own telemetry and of the plant model; standard deviations, and densities per root second.

    The disturbance is what the plant leaves unexplained. Part of it stands still, as wind does; a vehicle on the ring
    also looks for a part that swings as it goes around, as a wrong plant's errors do, unless `disturbance_turns` is
    false.
    """

    position_noise_m: float = Field(0.02, gt=0.0, le=10.0)
    velocity_noise_m_s: float = Field(0.02, gt=0.0, le=10.0)
    acceleration_noise_m_s2: float = Field(0.05, gt=0.0, le=10.0)
    disturbance_noise_m_s2: float = Field(0.03, gt=0.0, le=10.0)
    disturbance_max_m_s2: float = Field(0.6, ge=0.0, le=10.0)
    disturbance_turns: bool = True
    gate_sigma: float = Field(5.0, gt=1.0, le=20.0)
    gate_timeout_s: float = Field(1.0, gt=0.0, le=60.0)


class TargetFilterSettings(Settings):
    """Constant-velocity model of the target: its acceleration, and how outliers and late sightings are met.

    Once sightings clearly lean to one side, the velocity may have changed by the manoeuvre's, and for some time after
    the acceleration grows by it. A target out of sight keeps its velocity for about `coast_s`.
    """

    acceleration_noise_m_s2: float = Field(0.02, gt=0.0, le=10.0)
    manoeuvre_acceleration_m_s2: float = Field(0.5, ge=0.0, le=20.0)
    manoeuvre_speed_m_s: float = Field(1.5, gt=0.0, le=20.0)
    velocity_prior_m_s: float = Field(1.0, gt=0.0, le=20.0)
    coast_s: float = Field(2.0, gt=0.0, le=60.0)
    gate_sigma: float = Field(4.0, gt=1.0, le=20.0)
    gate_timeout_s: float = Field(2.0, gt=0.0, le=60.0)
    late_max_s: float = Field(1.0, ge=0.0, le=10.0)
    stale_after_s: float = Field(10.0, gt=0.0, le=600.0)
