"""How the controllers are tuned: what no mission has to choose, each key with the reason for its default.

The keys stand under `[tuning.formation]`, `[tuning.encirclement]`, `[tuning.safety]` and `[tuning.failsafe]` of a
mission file. A symbol is the paper's, with its equation. Margins of stability are 1 minus the largest modulus of the
eigenvalues, a tick, of a vehicle of `case2-field` (gcs/mission/stability.py).
"""

from estimation.settings import Settings, tuned

SETPOINTS_FASTER = 2.0
"""How many times faster than the vehicles setpoints may move by default."""
_SCALE = "It sets the scale: only ratios of weights count. A first prototype used 1 as well."


class FormationTuning(Settings):
    """The LMPC of the formation: weights of the errors and of the input's increments, and both horizons."""

    position_weight: float = tuned(1.0, "It sets the scale: only ratios of weights count.", "Q of (13)", gt=0.0, le=1e6)
    velocity_weight: float = tuned(
        1.0, "It damps: without it the margin of stability is 0.071 instead of 0.083.", "Q of (13)", ge=0.0, le=1e6
    )
    increment_weight: float = tuned(
        0.5,
        "With 0.1 a position error, and with it the noise of the estimate, moves the setpoint three times as far. "
        "With 2 the margin of stability is 0.064 instead of 0.083.",
        "R of (13)",
        gt=0.0,
        le=1e6,
    )
    prediction_step_s: float = tuned(
        0.5, "A first prototype used 0.5 s as well. 8 steps cover the 4 s of a step response.", gt=0.0, le=5.0
    )
    horizon: int = tuned(
        8, "A first prototype used 8 as well. 5 and 12 give the same margin.", "M of (13)", ge=2, le=50
    )
    control_horizon: int = tuned(
        2,
        "A first prototype used 2 as well. With 1 the margin is 0.052 instead of 0.083, with 3 it is 0.089.",
        ge=1,
        le=10,
    )


class EncirclementTuning(Settings):
    """The ring: the spacing gain, the weights of its LMPC and both horizons, and where its model holds."""

    smoothing_time_s: float = tuned(
        3.5,
        "A first prototype used 5 s. With 3.5 s the ring of `case2-field` settles 3.5 s after the last vehicle has "
        "engaged, with 5 s after 4.7 s.",
        "t_sm",
        ge=0.0,
        le=60.0,
    )
    spacing_gain_per_s: float = tuned(
        0.3,
        "A first prototype used 0.3 as well. It is scaled with the number of vehicles, so that the errors of the "
        "spacing decay as fast on any ring. Vehicles have to follow it: they do up to 1.4 1/s.",
        "γ of (22)",
        ge=0.0,
        le=2.0,
    )
    reference_lead_max_m: float = tuned(
        1.0,
        "Three times what a plant 30 % off is behind its reference in a transition. A vehicle that is held up further "
        "goes on from where it is, and does not hurry after its reference.",
        gt=0.0,
        le=100.0,
    )
    radius_weight: float = tuned(1.0, _SCALE, "α of (24)", gt=0.0, le=1e6)
    rate_weight: float = tuned(
        10.0,
        "A first prototype used 20, with which the margin of keeping the bearing is 0.097 instead of 0.137; with 5 "
        "it is 0.130.",
        "β of (24)",
        gt=0.0,
        le=1e6,
    )
    lag_weight: float = tuned(
        12.0,
        "A first prototype used 6, with which the margin of keeping the bearing is 0.115 instead of 0.137. With 24 "
        "it is 0.148, and noise of the bearing counts more.",
        "ρ of (24)",
        ge=0.0,
        le=1e6,
    )
    lead_weight: float = tuned(12.0, "As `lag_weight`: neither neighbour comes first.", "ζ of (24)", ge=0.0, le=1e6)
    radial_increment_weight: float = tuned(
        0.2,
        "A first prototype used 0.05, with an exact state. With 0.2 an error of the radius, and with it the noise"
        " of the estimate, is answered with half the acceleration: 1.1 instead of 2.4 1/s².",
        "R of (24), radial",
        gt=0.0,
        le=1e6,
    )
    angular_increment_weight: float = tuned(
        2.0,
        "A first prototype used 2 as well. With 0.5 the noise of the estimate counts 1.4 times as much; with 8 the "
        "margin of keeping the bearing is 0.093 instead of 0.137.",
        "R of (24), angular",
        gt=0.0,
        le=1e6,
    )
    radius_min_m: float = tuned(
        1.0, "The polar model is singular at the target. Nearer than this a vehicle flies outwards.", gt=0.0, le=1000.0
    )
    radius_far_m: float = tuned(
        60.0,
        "Farther out than this a vehicle flies straight inwards: six times the radius of the bundled rings.",
        gt=0.0,
        le=10000.0,
    )
    prediction_step_s: float = tuned(
        0.3,
        "A first prototype used 0.5 s. With 0.3 s the margin of keeping the bearing is 0.137 instead of 0.104; "
        "that of the radius is 0.085 instead of 0.092.",
        gt=0.0,
        le=5.0,
    )
    horizon: int = tuned(
        8,
        "A first prototype used 8 as well. With 5 the margin of keeping the bearing is 0.116 instead of 0.137, "
        "with 12 it is 0.095.",
        "M of (23)",
        ge=2,
        le=50,
    )
    control_horizon: int = tuned(
        2,
        "A first prototype used 2 as well. With 1 the margin of keeping the bearing is 0.042 instead of 0.137, "
        "with 3 it is 0.124.",
        ge=1,
        le=10,
    )


class SafetyTuning(Settings):
    """The guard, and how far and fast setpoints move."""

    barrier_rate_per_s: float = tuned(
        1.3,
        "A distance may shrink by this share of what is left each second. A smaller rate evades earlier and wider, a "
        "larger one asks for more acceleration.",
        gt=0.0,
        le=5.0,
    )
    uncertainty_sigmas: float = tuned(
        3.0,
        "So many standard deviations of both estimates are added to a distance: 3 leave one case in 700 out.",
        ge=0.0,
        le=10.0,
    )
    setpoint_lead_max_m: float = tuned(
        6.0,
        "A setpoint leads a vehicle by (a + a1 v) / a0: on the bundled plants by up to 4.2 m at 3 m/s. The bound "
        "keeps a wrong plant from sending setpoints far away.",
        gt=0.0,
        le=50.0,
    )
    setpoint_speed_max_m_s: float | None = tuned(
        None,
        f"{SETPOINTS_FASTER:g} times `safety.speed_max_m_s` unless given: setpoints move ahead of vehicles that speed "
        "up or turn. The guard may move them faster.",
        gt=0.0,
        le=100.0,
    )


class FailsafeTuning(Settings):
    """For how long a condition of the failsafe table has to last before it counts, and when it is there."""

    settle_s: float = tuned(
        5.0, "A filter that started again has settled by then, and a second jump has shown.", gt=0.0, le=600.0
    )
    battery_s: float = tuned(
        5.0, "Under full throttle the voltage drops, and with it the estimate of what is left.", ge=0.0, le=60.0
    )
    estimator_s: float = tuned(
        3.0, "Estimators are reported once a second: a single outlier is not enough.", ge=0.0, le=60.0
    )
    following_m: float = tuned(
        3.0,
        "Twice what a vehicle that shapes its motion is off its linear plant on the ring of `shaped-trio`, or one whose"
        " plant is off as far as the controller holds the ring with it.",
        gt=0.0,
        le=100.0,
    )
    following_s: float = tuned(1.0, "One comparison after the first: they are a second apart.", ge=0.0, le=60.0)
    tilt_max_deg: float = tuned(
        35.0,
        "An acceleration of 4 m/s² tilts by 22 degrees; PX4 tilts by up to 45, ArduCopter by up to 30 degrees.",
        gt=0.0,
        le=180.0,
    )
    tilt_s: float = tuned(2.0, "Several attitudes: a gust may tilt the vehicle for a moment.", ge=0.0, le=60.0)
    wind_max_m_s: float = tuned(
        12.0, "The strongest wind that common quadrotors of 1 to 2 kg are specified for.", gt=0.0, le=50.0
    )
    wind_s: float = tuned(5.0, "Longer than a gust.", ge=0.0, le=60.0)
    fence_s: float = tuned(0.5, "Ten samples at 20 Hz: a single outlier is not enough.", ge=0.0, le=60.0)
    separation_share: float = tuned(
        0.8, "Noise lets the guard miss the separation by a little. A fifth of it is a failure.", ge=0.0, le=1.0
    )
    separation_s: float = tuned(0.3, "Three ticks at 10 Hz: a single late message is not enough.", ge=0.0, le=60.0)
    plan_s: float = tuned(1.0, "Ten ticks at 10 Hz: a single failure at a bound is not enough.", ge=0.0, le=60.0)
    late_s: float = tuned(2.0, "Longer than the start of another program on the same computer.", ge=0.0, le=60.0)
    clock_step_s: float = tuned(
        0.5, "More than messages vary on the way, less than what mixes up plans.", ge=0.1, le=10.0
    )
    doubt_m: float = tuned(
        1.0,
        "A peer's positions may be so much farther than its velocities lead, as in a jump of its own estimate. Honest "
        "ones were off by 0.3 m at most in 28 flights with noise, losses and plants 20 % off.",
        ge=1.0,
        le=1000.0,
    )
    flood_per_s: float = tuned(100.0, "More than a misconfigured program sends by mistake.", ge=1.0, le=1e6)
    clock_s: float = tuned(1.0, "Several messages: a single late one is not enough.", ge=0.0, le=60.0)
