"""Identification of plants that are known, flown by another arithmetic; and flights that nothing can be learnt from."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.identification.excerpts import MotionRecording, excerpts_of
from estimation.identification.identified import IdentificationResult, ParameterEstimate
from estimation.identification.identify import identify
from estimation.identification.response import InputHold
from estimation.identification.simulated import fit_percent, simulated
from estimation.plant.model import PlantGrade
from estimation.state import Vector
from tests.experiments.identification_draws import drawn, intervals_of
from tests.support.synthetic_flights import SENT_S, Cascade, Truth, cascaded, excitation_m, recorded, saturated

pytestmark = pytest.mark.slow

TRUTH = Truth((1.5, 1.1), (1.9, 1.6), 0.2)


def short_m(seed: int) -> Vector:
    """Return the setpoints of half an excitation, where a plant is found as well."""
    return excitation_m(np.random.default_rng(seed), 45.0, 30.0)


def found_in(identified: IdentificationResult) -> ParameterEstimate:
    assert identified.found is not None, identified.reasons
    return identified.found


def values(found: ParameterEstimate) -> list[float]:
    return [interval.value for interval in intervals_of(found)]


def test_without_noise_the_plant_is_found_as_it_is() -> None:
    """Setpoints logged as they were sent: held."""
    recording = recorded(TRUTH, 1, noise_m=1e-4, setpoints_hz=25.0, sampled=False, setpoint_m=short_m(1))
    found = found_in(identify([recording]))
    assert found.between is InputHold.HELD
    assert values(found) == pytest.approx([1.5, 1.9, 1.1, 1.6, 0.2], rel=0.01)
    x, _ = found.axes
    assert x.frequency_rad_s.value == pytest.approx(np.sqrt(1.5), rel=0.005)
    assert x.damping.value == pytest.approx(1.9 / 2.0 / np.sqrt(1.5), rel=0.005)
    assert min(axis.fit_percent for axis in found.axes) > 99.0


def test_the_feed_forward_gain_is_identified() -> None:
    fed = replace(TRUTH, feedforward=0.8)
    recording = recorded(fed, 1, noise_m=1e-3, setpoints_hz=25.0, sampled=False, fed=True, setpoint_m=short_m(1))
    identified = identify([recording])
    found = found_in(identified)
    assert identified.verdict is PlantGrade.GOOD
    assert values(found) == pytest.approx([1.5, 1.9, 1.1, 1.6, 0.2, 0.8], rel=0.01)
    assert found.plant.feedforward == pytest.approx(0.8, rel=0.01)
    assert found.covariance.shape == (6, 6)
    assert found.baseline is not None
    assert found.baseline.feedforward == pytest.approx(0.8, abs=0.1)


def test_a_vehicle_that_ignores_velocities_must_not_be_flown_with_them() -> None:
    identified = identify([recorded(TRUTH, 13, fed=True, setpoint_m=short_m(13))])
    assert identified.verdict is PlantGrade.DO_NOT_FLY
    assert "the feed-forward velocities show no effect" in identified.reasons[0]


def test_velocities_that_stay_the_same_tell_nothing() -> None:
    recording = recorded(TRUTH, 14, fed=True)
    steady = np.tile((0.3, 0.0), (recording.setpoint_time_s.size, 1))
    for velocity_m_s, fed in ((recording.velocity_m_s, True), (steady, False), (None, False)):
        assert any(each.fed for each in excerpts_of(replace(recording, velocity_m_s=velocity_m_s))) is fed


@pytest.fixture(scope="module")
def draws() -> list[tuple[float, Vector, Vector]]:
    return [(draw.noise_m, draw.errors, draw.covered) for draw in map(drawn, (0, 4, 18))]


def test_plants_are_found_in_coloured_noise(draws: list[tuple[float, Vector, Vector]]) -> None:
    """A few of the hundred of `python -m tests.experiments.identification_draws`."""
    quiet = [errors for noise_m, errors, _ in draws if noise_m == 0.05]
    assert len(quiet) == 2
    assert np.median(np.abs(quiet)[:, :4]) < 0.02
    assert np.abs(quiet)[:, 4].max() < 0.05


def test_intervals_hold_the_truth(draws: list[tuple[float, Vector, Vector]]) -> None:
    assert np.mean([covered for _, _, covered in draws]) >= 0.85


@pytest.fixture(scope="module")
def quiet() -> tuple[IdentificationResult, list[float]]:
    """Return what a good flight identifies, and the progress told meanwhile."""
    shares: list[float] = []
    return identify([recorded(TRUTH, 5, noise_m=0.05, setpoint_m=short_m(5))], shares.append), shares


def test_a_good_flight_is_graded_good_and_progress_rises_to_the_end(
    quiet: tuple[IdentificationResult, list[float]],
) -> None:
    identified, shares = quiet
    assert (identified.verdict, identified.reasons) == (PlantGrade.GOOD, ())
    assert found_in(identified).order.second_is_enough
    assert shares == sorted(shares)
    assert shares[0] < 0.3
    assert shares[-1] == pytest.approx(1.0)


def test_intervals_are_as_wide_as_noise_makes_them(quiet: tuple[IdentificationResult, list[float]]) -> None:
    calm = found_in(quiet[0])
    loud = found_in(identify([recorded(TRUTH, 5, noise_m=0.2, setpoint_m=short_m(5))]))
    ratios = [
        wide.relative / narrow.relative for narrow, wide in zip(intervals_of(calm), intervals_of(loud), strict=True)
    ]
    assert 3.0 < float(np.median(ratios)) < 20.0


def test_axes_are_fitted_as_one_unless_they_differ(quiet: tuple[IdentificationResult, list[float]]) -> None:
    alike = Truth((1.5, 1.5), (1.9, 1.9), 0.2)
    same = found_in(identify([recorded(alike, 15, noise_m=0.05, setpoint_m=short_m(15))]))
    assert (same.axes_alike, found_in(quiet[0]).axes_alike) == (True, False)
    assert same.plant.x == same.plant.y
    assert same.plant.x.a0_per_s2 == pytest.approx(1.5, rel=0.05)


def test_setpoints_that_are_frozen_while_the_vehicle_moves_identify_nothing() -> None:
    recording = recorded(TRUTH, 1)
    from_s = float(recording.setpoint_time_s[0]) + 40.0
    frozen = (from_s < recording.setpoint_time_s) & (recording.setpoint_time_s < from_s + 60.0)
    setpoint_m = recording.setpoint_m.copy()
    setpoint_m[frozen] = setpoint_m[np.argmax(frozen)]
    damaged = replace(recording, setpoint_m=setpoint_m)
    missing = replace(
        damaged, setpoint_m=recording.setpoint_m[~frozen], setpoint_time_s=recording.setpoint_time_s[~frozen]
    )
    for each in (damaged, missing):
        spans_s = [(excerpt.begin_s, excerpt.begin_s + excerpt.duration_s) for excerpt in excerpts_of(each)]
        assert not [span for span in spans_s if span[0] < from_s + 59.0 and from_s + 2.0 < span[1]]
    a0, *_ = intervals_of(found_in(identify([damaged])))
    assert a0.low < TRUTH.a0[0] < a0.high


def test_a_setpoint_that_stays_while_the_vehicle_hovers_is_no_fault() -> None:
    recording = recorded(TRUTH, 1)
    still = replace(
        recording,
        setpoint_m=np.zeros_like(recording.setpoint_m),
        position_m=0.4 * np.sin(recording.position_time_s)[:, None] * np.ones(2),
    )
    assert [each.begin_s for each in excerpts_of(still)] == [each.begin_s for each in excerpts_of(recording)]


def test_several_flights_are_one_identification() -> None:
    """Beginning elsewhere, and in another wind, each."""
    flights = []
    for seed in (3, 4):
        random = np.random.default_rng(seed)
        flight = recorded(TRUTH, seed, setpoint_m=excitation_m(random, 45.0, 0.0), noise_m=0.02)
        offset_m = random.uniform(-40.0, 40.0, 2)
        wind_m = random.uniform(2.0, 4.0, 2)
        flights.append(
            replace(flight, position_m=flight.position_m + offset_m + wind_m, setpoint_m=flight.setpoint_m + offset_m)
        )
    identified = identify(flights)
    assert identified.excerpts == 2
    found = found_in(identified)
    assert values(found) == pytest.approx([1.5, 1.9, 1.1, 1.6, 0.2], rel=0.06)
    assert max(interval.relative for interval in intervals_of(found)[:4]) < 0.06


def still(recording: MotionRecording) -> MotionRecording:
    nothing = np.zeros_like(recording.setpoint_m)
    noise_m = recording.position_m - recording.position_m.mean(axis=0)
    return replace(recording, setpoint_m=nothing, position_m=0.02 * noise_m)


def unmoved(recording: MotionRecording) -> MotionRecording:
    return replace(recording, position_m=0.02 * recording.position_m)


@pytest.mark.parametrize(
    ("recording", "reason"),
    [
        (still(recorded(TRUTH, 6)), "too little excitation: along x the setpoint moved by 0.00 m rms"),
        (unmoved(recorded(TRUTH, 6)), "the vehicle hardly moved: along x by 0.04 m rms"),
        (replace(recorded(TRUTH, 6), flown_s=[]), "wrong mode: at no time did a computer's position setpoints fly"),
        (replace(recorded(TRUTH, 6), flown_s=[(5.0, 25.0)]), "too short: 19 s were flown"),
        (replace(recorded(TRUTH, 6), resets_s=np.arange(0.0, 150.0, 7.0).tolist()), "too short: 0 s were flown"),
    ],
)
def test_a_bad_flight_identifies_nothing_and_the_reason_is_reported(recording: MotionRecording, reason: str) -> None:
    identified = identify([recording])
    assert identified.verdict is PlantGrade.DO_NOT_FLY
    assert identified.found is None
    assert len(identified.reasons) == 1
    assert identified.reasons[0].startswith(reason)


def test_a_vehicle_at_its_speed_limit_is_detected_with_the_speed() -> None:
    identified = identify([saturated(TRUTH, 7, speed_max_m_s=1.0)])
    assert identified.verdict is PlantGrade.DO_NOT_FLY
    assert identified.reasons[0].startswith("saturation: speed was limited to 1.0 m/s for ")
    shaping = found_in(identified).shaping
    assert shaping.speed_max_m_s == pytest.approx(1.0, rel=0.05)
    assert shaping.speed_share == pytest.approx(0.6, abs=0.15)


def test_saturated_acceleration_is_named_as_the_cause_and_not_noise() -> None:
    """The plant that is found without it is nine times too slow, with narrow intervals."""
    identified = identify([saturated(TRUTH, 7, acceleration_max_m_s2=0.5)])
    assert identified.verdict is PlantGrade.DO_NOT_FLY
    assert identified.reasons[0].startswith("saturation: acceleration was limited to 0.5 m/s2")
    assert not any("noise" in reason for reason in identified.reasons)
    assert found_in(identified).shaping.acceleration_max_m_s2 == pytest.approx(0.5, rel=0.05)


def test_noise_that_looks_like_any_acceleration_is_no_error() -> None:
    """White noise of half a metre: what it accelerates is beyond the bounds of the fit."""
    flight = recorded(TRUTH, 7, noise_m=0.5, memory_s=1e-3, sampled=False, setpoint_m=short_m(7))
    identified = identify([flight])
    assert identified.verdict is not PlantGrade.GOOD
    assert identified.reasons[0].startswith("too little excitation for this noise")
    assert [interval.value for interval in intervals_of(found_in(identified))[:4]] == pytest.approx(
        (1.5, 1.9, 1.1, 1.6), rel=0.2
    )


def test_a_delay_beyond_any_plants_is_noticed() -> None:
    late = recorded(replace(TRUTH, delay_s=0.9), 8, noise_m=0.02, setpoint_m=short_m(8))
    identified = identify([late])
    assert identified.verdict is PlantGrade.DO_NOT_FLY
    assert any(reason.startswith("the delay is at its bound of 0.6 s") for reason in identified.reasons)


def test_a_response_before_the_setpoint_is_detected() -> None:
    """The log stamps setpoints late: a plant is found, without a delay. The later, the quicker it seems to be."""
    prompt, sent_m = replace(TRUTH, delay_s=0.0), short_m(9)
    flight = recorded(prompt, 9, noise_m=0.02, setpoints_hz=25.0, sampled=False, setpoint_m=sent_m)
    for late_s, verdict in ((0.08, PlantGrade.USABLE), (0.2, PlantGrade.DO_NOT_FLY)):
        identified = identify([replace(flight, setpoint_time_s=flight.setpoint_time_s + late_s)])
        assert identified.verdict is verdict
        assert any("s before the setpoint" in reason for reason in identified.reasons)
        found = found_in(identified)
        assert found.delay_s.value == 0.0
        is_right = found.axes[0].a0_per_s2.value == pytest.approx(TRUTH.a0[0], rel=0.25)
        assert is_right is (verdict is PlantGrade.USABLE)


def test_a_flight_without_excitation_leaves_large_uncertainty() -> None:
    """One slow ramp: no wish of a plant's can be told from another's."""
    ramp_m = np.column_stack([np.linspace(0.0, 20.0, round(60.0 / SENT_S))] * 2)
    identified = identify([recorded(TRUTH, 10, noise_m=0.1, setpoint_m=ramp_m)])
    assert identified.verdict is PlantGrade.DO_NOT_FLY
    assert identified.reasons[0].startswith("too little excitation for this noise: uncertainty of a0 along x ")


def test_another_order_is_detected() -> None:
    """A lag of half a second in the actuators."""
    identified = identify([recorded(TRUTH, 11, noise_m=0.02, lag_s=0.5, setpoint_m=short_m(11))])
    order = found_in(identified).order
    assert not order.second_is_enough
    assert order.lag_s == pytest.approx(0.5, rel=0.3)
    assert any(reason.startswith("second order is not sufficient") for reason in identified.reasons)


def test_an_estimators_drift_does_not_lower_the_validation_fit() -> None:
    recording = recorded(TRUTH, 13, noise_m=0.02)
    wander_m = 0.6 * np.sin(2.0 * np.pi * recording.position_time_s / 80.0)
    found = found_in(identify([replace(recording, position_m=recording.position_m + wander_m[:, None])]))
    assert min(axis.fit_percent for axis in found.axes) > 90.0
    validation = found.validation
    through = [fit_percent(simulated(validation.excerpts, validation.trained, axis, 0.7)) for axis in range(2)]
    assert max(through) < 80.0
    assert [axis.a0_per_s2.value for axis in found.axes] == pytest.approx(TRUTH.a0, rel=0.05)


def test_a_soft_cascade_with_an_integral_part_validates_better_than_plain_least_squares() -> None:
    """Least squares gives a slow plant, whose free motion would pass for what the estimator wanders."""
    flight = cascaded(Cascade(0.5, 1.0, 0.17), 0, 0.5 * excitation_m(np.random.default_rng(0)))
    found = found_in(identify([flight]))
    assert found.baseline_fit_percent is not None
    fits = [axis.fit_percent for axis in found.axes]
    assert np.greater(fits, found.baseline_fit_percent).all(), (fits, found.baseline_fit_percent)
    assert [axis.a0_per_s2.value for axis in found.axes] == pytest.approx([0.5 * 1.0] * 2, rel=0.25)
