"""Tuning of the controllers, each key with its meaning and the reason for its default, which suits every mission.

The keys belong to `[tuning.formation]`, `[tuning.encirclement]`, `[tuning.safety]` and `[tuning.failsafe]` of a mission
file. Symbols are the paper's, with the equation. A stability margin is 1 minus the largest modulus of the eigenvalues,
per tick, of a vehicle of `case2-field` (gcs/mission/stability.py).
"""

from estimation.settings import Settings, tuned

SETPOINTS_FASTER = 2.0
"""Default ratio of the setpoints' speed limit to that of the vehicles."""
_SCALE = "Sets the scale: only ratios of weights matter."


class FormationTuning(Settings):
    """The LMPC of the formation: weights of the errors and of the input's increments, and both horizons."""

    position_weight: float = tuned(
        1.0,
        "weight of position errors",
        _SCALE,
        "Q of (13)",
        gt=0.0,
        le=1e6,
    )
    velocity_weight: float = tuned(
        1.0,
        "weight of velocity errors",
        "Adds damping: with 0 the stability margin is 0.071 instead of 0.083.",
        "Q of (13)",
        ge=0.0,
        le=1e6,
    )
    increment_weight: float = tuned(
        0.5,
        "weight of changes of the input",
        "With 0.1 a position error, and with it the noise of the estimate, moves the setpoint three times as far. "
        "With 2 the stability margin is 0.064 instead of 0.083.",
        "R of (13)",
        gt=0.0,
        le=1e6,
    )
    prediction_step_s: float = tuned(
        0.5,
        "step of the prediction",
        "8 steps of 0.5 s cover the 4 s of a step response.",
        gt=0.0,
        le=5.0,
    )
    horizon: int = tuned(
        8,
        "steps of the prediction",
        "5 and 12 give the same stability margin.",
        "M of (13)",
        ge=2,
        le=50,
    )
    control_horizon: int = tuned(
        2,
        "steps with an input of their own",
        "With 1 the stability margin is 0.052 instead of 0.083, with 3 it is 0.089.",
        ge=1,
        le=10,
    )


class EncirclementTuning(Settings):
    """The ring: the spacing gain, the weights of its LMPC, both horizons, and the range of its polar model."""

    smoothing_time_s: float = tuned(
        3.5,
        "time in which formation and ring are mixed",
        "With 3.5 s the ring of `case2-field` settles 3.5 s after the last vehicle has engaged, with 5 s after 4.7 s.",
        "t_sm",
        ge=0.0,
        le=60.0,
    )
    spacing_gain_per_s: float = tuned(
        0.3,
        "decay rate of spacing errors",
        "The same for any number of vehicles. Beyond 0.66 1/s spacings overshoot on most rings.",
        "γ of (22)",
        ge=0.0,
        le=2.0,
    )
    reference_lead_max_m: float = tuned(
        1.0,
        "largest distance of a vehicle from its reference",
        "Three times the lag of a plant that is 30 % off in a transition. A vehicle that lags further continues from "
        "where it is instead of catching up with its reference.",
        gt=0.0,
        le=100.0,
    )
    radius_weight: float = tuned(
        1.0,
        "weight of radius errors",
        _SCALE,
        "α of (24)",
        gt=0.0,
        le=1e6,
    )
    rate_weight: float = tuned(
        10.0,
        "weight of errors of the angular rate",
        "With 20 the stability margin of the bearing loop is 0.097 instead of 0.137, with 5 it is 0.130.",
        "β of (24)",
        gt=0.0,
        le=1e6,
    )
    spacing_weight: float = tuned(
        24.0,
        "weight of the angles to the vehicles behind and in front",
        "With 12 the stability margin of the bearing loop is 0.115 instead of 0.137. With 48 it is 0.148, but noise "
        "of the bearing has more effect.",
        "ρ + ζ of (24)",
        ge=0.0,
        le=2e6,
    )
    radial_increment_weight: float = tuned(
        0.2,
        "weight of changes of the radial input",
        "Compared with 0.05, an error of the radius, and with it the noise of the estimate, causes half the "
        "acceleration: 1.1 instead of 2.4 1/s².",
        "R of (24), radial",
        gt=0.0,
        le=1e6,
    )
    angular_increment_weight: float = tuned(
        2.0,
        "weight of changes of the angular input",
        "With 0.5 the noise of the estimate has 1.4 times the effect; with 8 the stability margin of the bearing loop "
        "is 0.093 instead of 0.137.",
        "R of (24), angular",
        gt=0.0,
        le=1e6,
    )
    radius_min_m: float = tuned(
        1.0,
        "nearer to the target a vehicle flies straight outwards",
        "The polar model is singular at the target. Nearer than this a vehicle flies outwards.",
        gt=0.0,
        le=1000.0,
    )
    radius_far_m: float | None = tuned(
        None,
        "farther out a vehicle flies straight inwards",
        "Farther out than this a vehicle flies straight inwards: unless given, 60 m or three times the radius of the "
        "ring, whichever is more.",
        gt=0.0,
        le=10000.0,
    )
    prediction_step_s: float = tuned(
        0.3,
        "step of the prediction",
        "Compared with 0.5 s, the stability margin of the bearing loop is 0.137 instead of 0.104; that of the radius "
        "loop is 0.085 instead of 0.092.",
        gt=0.0,
        le=5.0,
    )
    horizon: int = tuned(
        8,
        "steps of the prediction",
        "With 5 the stability margin of the bearing loop is 0.116 instead of 0.137, with 12 it is 0.095.",
        "M of (23)",
        ge=2,
        le=50,
    )
    control_horizon: int = tuned(
        2,
        "steps with an input of their own",
        "With 1 the stability margin of the bearing loop is 0.042 instead of 0.137, with 3 it is 0.124.",
        ge=1,
        le=10,
    )


class SafetyTuning(Settings):
    """The guard, and the limits of setpoints' lead and speed."""

    barrier_rate_per_s: float = tuned(
        1.3,
        "largest relative rate at which a distance to a limit shrinks; smaller evades earlier",
        "A smaller rate starts evasion earlier and wider, a larger one needs more acceleration.",
        gt=0.0,
        le=5.0,
    )
    uncertainty_sigmas: float = tuned(
        3.0,
        "margin added to distances, in standard deviations of both estimates",
        "3 standard deviations are exceeded in one case of 700.",
        ge=0.0,
        le=10.0,
    )
    setpoint_lead_max_m: float = tuned(
        6.0,
        "largest distance of a setpoint from its vehicle",
        "A setpoint leads a vehicle by (a + a1 v) / a0: up to 4.2 m at 3 m/s for the bundled plants. The limit keeps "
        "setpoints near the vehicle if the plant is wrong.",
        gt=0.0,
        le=50.0,
    )
    setpoint_speed_max_m_s: float | None = tuned(
        None,
        "largest speed of planned setpoints; none: twice `safety.speed_max_m_s`",
        "Setpoints lead vehicles that accelerate or turn. The guard may move them faster.",
        gt=0.0,
        le=100.0,
    )


class FailsafeTuning(Settings):
    """Thresholds of the conditions of the failsafe table, and how long each has to last before the reaction."""

    settle_s: float = tuned(
        5.0,
        "*estimator jumped*, *target jumped*: duration after the filter's restart",
        "A filter settles within this time after a restart, and a second jump is detected.",
        gt=0.0,
        le=600.0,
    )
    battery_s: float = tuned(
        5.0,
        "*battery low*, *battery critical*, *no way home*: grace time",
        "At full throttle the voltage drops, and with it the estimated charge.",
        ge=0.0,
        le=60.0,
    )
    estimator_s: float = tuned(
        3.0,
        "*estimator failing*, *estimator degraded*: grace time",
        "Estimator reports arrive once a second: a single outlier is not enough.",
        ge=0.0,
        le=60.0,
    )
    following_m: float = tuned(
        3.0,
        "*not following*: distance from the plant's motion",
        "Twice the deviation from the linear plant of a vehicle with shaped motion on the ring of `shaped-trio`, or of "
        "the worst plant with which the controller keeps the ring.",
        gt=0.0,
        le=100.0,
    )
    following_s: float = tuned(
        1.0,
        "*not following*: grace time",
        "Two comparisons, which are a second apart.",
        ge=0.0,
        le=60.0,
    )
    tilt_max_deg: float = tuned(
        35.0,
        "*tilt too large*: tilt",
        "An acceleration of 4 m/s² tilts by 22 degrees; PX4 tilts by up to 45, ArduCopter by up to 30 degrees.",
        gt=0.0,
        le=180.0,
    )
    tilt_s: float = tuned(
        2.0,
        "*tilt too large*: grace time",
        "Several attitude samples: a gust may tilt the vehicle briefly.",
        ge=0.0,
        le=60.0,
    )
    wind_max_m_s: float = tuned(
        12.0,
        "*wind too strong*: wind",
        "The strongest wind that common quadrotors of 1 to 2 kg are specified for.",
        gt=0.0,
        le=50.0,
    )
    wind_s: float = tuned(
        5.0,
        "*wind too strong*: grace time",
        "Longer than a gust.",
        ge=0.0,
        le=60.0,
    )
    fence_s: float = tuned(
        0.5,
        "*fence left*, *no-fly zone entered*, *altitude limit left*: grace time",
        "Ten samples at 20 Hz: a single outlier is not enough.",
        ge=0.0,
        le=60.0,
    )
    separation_share: float = tuned(
        0.8,
        "*too close*: share of `safety.separation_m`",
        "With noise the guard may miss the separation slightly. A fifth of it is a failure.",
        ge=0.0,
        le=1.0,
    )
    separation_s: float = tuned(
        0.3,
        "*too close*: grace time",
        "Three ticks at 10 Hz: a single late message is not enough.",
        ge=0.0,
        le=60.0,
    )
    plan_s: float = tuned(
        1.0,
        "*plan failing*: grace time",
        "Ten ticks at 10 Hz: a single failure at a bound is not enough.",
        ge=0.0,
        le=60.0,
    )
    late_s: float = tuned(
        2.0,
        "*late ticks*: grace time",
        "Longer than the start of another program on the same computer.",
        ge=0.0,
        le=60.0,
    )
    doubt_m: float = tuned(
        1.0,
        "*peer doubtful*: distance of a position from where its velocities lead",
        "Sound peers differ by up to 0.3 m with noise, losses and plants 20 % off.",
        ge=1.0,
        le=1000.0,
    )
    doubt_s: float = tuned(
        2.0,
        "*peer doubtful*, *sightings contradict*: grace time",
        "A vehicle that does not follow, or whose estimate jumps, mostly reports that itself by then. The guard keeps "
        "clear of both places at once.",
        ge=0.0,
        le=60.0,
    )
    flood_per_s: float = tuned(
        100.0,
        "*bus flooded*: refused messages a second",
        "More than a misconfigured program sends by mistake.",
        ge=1.0,
        le=1e6,
    )
    clock_s: float = tuned(
        1.0,
        "*peer's clock stepped*, *drifted*: grace time",
        "Several messages: a single late one is not enough.",
        ge=0.0,
        le=60.0,
    )
