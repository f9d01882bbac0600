"""A vehicle's own filter against batch least squares, its Riccati equation, statistics of simulated truth; trouble."""

import tracemalloc
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from scipy.stats import chi2

from estimation.filters.own import OwnFilter
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.settings import OwnFilterSettings
from estimation.state import Telemetry, Vector

pytestmark = pytest.mark.filterwarnings("error")

PLANT = Plant(PlantAxis(0.80, 0.87), PlantAxis(0.60, 1.10))
DELAYED = Plant(PLANT.x, PLANT.y, 0.25)
SETTINGS = OwnFilterSettings()
OBSERVATION = np.eye(4, 6)
NOISE = np.diag([SETTINGS.position_noise_m**2] * 2 + [SETTINGS.velocity_noise_m_s**2] * 2)
PERIOD_S = 0.1


def telemetry(time_s: float, motion: Vector) -> Telemetry:
    x, y, x_rate, y_rate = motion.tolist()
    return Telemetry(time_s, (x, y, 8.0), (x_rate, y_rate, 0.0))


def model(step_s: float) -> tuple[Vector, Vector, Vector]:
    """Transition (6, 6) and setpoint gain (6, 2) by matrix exponential, process noise (6, 6) by Van Loan's method."""
    flow = np.zeros((8, 8))
    flow[:2, 2:4] = flow[2:4, 4:6] = np.eye(2)
    flow[2:4, :2], flow[2:4, 2:4] = -np.diag(PLANT.a0_per_s2), -np.diag(PLANT.a1_per_s)
    flow[2:4, 6:] = np.diag(PLANT.a0_per_s2)
    response = expm(flow * step_s)
    # White noise enters as on a free mass: over a step of the loop plant and wind hardly act on it.
    free, density = np.zeros((6, 6)), np.zeros((6, 6))
    free[:2, 2:4] = np.eye(2)
    density[2:4, 2:4] = np.eye(2) * SETTINGS.acceleration_noise_m_s2**2
    density[4:, 4:] = np.eye(2) * SETTINGS.disturbance_noise_m_s2**2
    pair = expm(np.block([[-free, density], [np.zeros((6, 6)), free.T]]) * step_s)
    noise = pair[6:, 6:].T @ pair[:6, 6:]
    return response[:6, :6], response[:6, 6:], noise


def fly(
    own: OwnFilter, plant: Plant, ticks: int, *, wind: tuple[float, float] = (0.0, 0.0), noise_m: float = 0.0
) -> Vector:
    """Fly a weaving course with a filter that hears everything; return the true motion (4,) at the last tick."""
    random = np.random.default_rng(4)
    motion, delay_ticks = np.zeros(4), plant.delay_s / PERIOD_S
    whole, part_s = int(delay_ticks), (delay_ticks % 1.0) * PERIOD_S
    sent = [np.zeros(2)] * (whole + 2)
    for tick in range(ticks + 1):
        if tick > 0:
            for setpoint, step_s in ((sent[-whole - 2], part_s), (sent[-whole - 1], PERIOD_S - part_s)):
                motion = exact_step(plant, step_s).advance(motion, setpoint, np.array(wind))
        own.measure(telemetry(tick * PERIOD_S, motion + noise_m * random.standard_normal(4)))
        sent.append(np.array([2.0 * np.sin(0.5 * tick * PERIOD_S), 0.3 * tick * PERIOD_S]))
        own.command(tick * PERIOD_S, sent[-1])
    return motion


def estimated(own: OwnFilter, now_s: float) -> Vector:
    estimate = own.estimate(now_s)
    assert estimate is not None
    assert estimate.time_s == pytest.approx(now_s)
    return estimate.mean


def test_the_filter_is_the_batch_least_squares_estimate(batch_mean: Callable[..., Vector]) -> None:
    random = np.random.default_rng(0)
    own = OwnFilter(PLANT, SETTINGS)
    first = random.standard_normal(4) * 0.02
    own.measure(telemetry(0.0, first))
    half_limit = SETTINGS.disturbance_max_m_s2 / 2.0
    prior = np.concatenate([first, np.zeros(2)]), np.diag([*np.diag(NOISE), half_limit**2, half_limit**2])
    steps, measurements, now_s = [], [], 0.0
    for step_s in (0.1, 0.05, 0.2, 0.1):
        setpoint = random.standard_normal(2)
        own.command(now_s, setpoint)
        transition, gain, noise = model(step_s)
        now_s += step_s
        measured = random.standard_normal(4) * 0.03
        own.measure(telemetry(now_s, measured))
        steps.append((transition, gain @ setpoint, noise))
        measurements.append((measured, OBSERVATION, NOISE))
    assert own.refused == 0
    assert estimated(own, now_s) == pytest.approx(batch_mean(prior, steps, measurements), abs=1e-8)


def test_the_covariance_settles_where_the_riccati_equation_says() -> None:
    transition, _, noise = model(PERIOD_S)
    prior = solve_discrete_are(transition.T, OBSERVATION.T, noise, NOISE)
    gain = prior @ OBSERVATION.T @ np.linalg.inv(OBSERVATION @ prior @ OBSERVATION.T + NOISE)
    own = OwnFilter(PLANT, SETTINGS)
    for tick in range(400):
        own.measure(telemetry(tick * PERIOD_S, np.zeros(4)))
    estimate = own.estimate(399 * PERIOD_S)
    assert estimate is not None
    assert estimate.covariance == pytest.approx((np.eye(6) - gain @ OBSERVATION) @ prior, rel=1e-5, abs=1e-10)


def test_errors_match_the_filters_covariance() -> None:
    transition, gain, noise = model(PERIOD_S)
    random = np.random.default_rng(7)
    root, flights, squares = np.linalg.cholesky(noise), 40, []
    for _ in range(flights):
        own = OwnFilter(PLANT, SETTINGS)
        truth, setpoint = np.concatenate([np.zeros(4), random.standard_normal(2) * 0.1]), np.zeros(2)
        for tick in range(50):
            if tick > 0:
                truth = transition @ truth + gain @ setpoint + root @ random.standard_normal(6)
            own.measure(telemetry(tick * PERIOD_S, truth[:4] + np.sqrt(np.diag(NOISE)) * random.standard_normal(4)))
            setpoint = random.standard_normal(2)
            own.command(tick * PERIOD_S, setpoint)
        estimate = own.estimate(49 * PERIOD_S)
        assert estimate is not None
        error = truth - estimate.mean
        squares.append(float(error @ np.linalg.solve(estimate.covariance, error)))
    lowest, highest = chi2.ppf([0.001, 0.999], 6 * flights)
    assert lowest < sum(squares) < highest


def test_a_link_delays_setpoints_as_a_slower_plant_does() -> None:
    """One filter knows the plant and the link, the other one plant with the delay of both."""
    slow = Plant(PLANT.x, PLANT.y, 0.25 + 0.13)
    over_link, whole = OwnFilter(DELAYED, SETTINGS), OwnFilter(slow, SETTINGS)
    over_link.delay_by(0.13)
    fly(over_link, slow, 60, wind=(0.3, -0.1))
    fly(whole, slow, 60, wind=(0.3, -0.1))
    assert estimated(over_link, 6.0) == pytest.approx(estimated(whole, 6.0), abs=1e-12)
    assert over_link.predicted(6.4, 0.05) == pytest.approx(whole.predicted(6.4, 0.05), abs=1e-12)


def test_a_setpoint_does_not_act_before_its_predecessor() -> None:
    """The delay falls from 0.5 s to none: the setpoints of this time act at once then, the newest last."""
    own = OwnFilter(PLANT, SETTINGS)
    own.measure(telemetry(0.0, np.zeros(4)))
    own.delay_by(0.5)
    for tick in range(5):
        own.command(0.1 * tick, np.array([float(tick), 0.0]))
    own.delay_by(0.0)
    own.command(0.5, np.array([9.0, 0.0]))
    assert own.mean_aim_m(0.91, 1.5) == (9.0, 0.0)
    assert own.mean_aim_m(0.7, 0.8) == pytest.approx((2.0, 0.0))


def test_a_constant_wind_is_found() -> None:
    own = OwnFilter(PLANT, SETTINGS)
    fly(own, PLANT, 300, wind=(0.3, -0.2))
    assert estimated(own, 30.0)[4:] == pytest.approx([0.3, -0.2], abs=2e-3)


def test_the_disturbance_stays_within_its_bound() -> None:
    own = OwnFilter(PLANT, SETTINGS)
    fly(own, PLANT, 100, wind=(3.0, -3.0))
    limit = SETTINGS.disturbance_max_m_s2
    assert estimated(own, 10.0)[4:] == pytest.approx([limit, -limit])


def test_setpoints_act_one_delay_later() -> None:
    own, hasty = OwnFilter(DELAYED, SETTINGS), OwnFilter(PLANT, SETTINGS)
    truth = fly(own, DELAYED, 150, wind=(0.1, 0.1))
    fly(hasty, DELAYED, 150, wind=(0.1, 0.1))
    assert estimated(own, 15.0)[4:] == pytest.approx([0.1, 0.1], abs=0.01)
    assert estimated(own, 15.0)[:4] == pytest.approx(truth, abs=1e-3)
    assert np.abs(estimated(hasty, 15.0)[4:] - 0.1).max() > 0.05


def test_the_motion_is_predicted_through_the_setpoints_on_their_way(subtests: pytest.Subtests) -> None:
    for ahead_s in [0.0, 0.13, 0.25]:
        with subtests.test(ahead_s=ahead_s):
            own = OwnFilter(DELAYED, SETTINGS)
            truth = fly(own, DELAYED, 150)
            sent = [
                (tick * PERIOD_S + 0.25, 2.0 * np.sin(0.5 * tick * PERIOD_S), 0.3 * tick * PERIOD_S)
                for tick in range(151)
            ]
            time_s = 15.0
            while time_s < 15.0 + ahead_s - 1e-9:
                until_s = min(15.0 + ahead_s, *(acts_s for acts_s, _, _ in sent if acts_s > time_s + 1e-9))
                _, x, y = [entry for entry in sent if entry[0] <= time_s + 1e-9][-1]
                truth = exact_step(DELAYED, until_s - time_s).advance(truth, np.array([x, y]), np.zeros(2))
                time_s = until_s
            assert own.predicted(15.0 + ahead_s, 0.0)[:4] == pytest.approx(truth, abs=2e-3)


def test_there_is_no_estimate_before_telemetry_and_none_before_its_time() -> None:
    own = OwnFilter(PLANT, SETTINGS)
    assert own.estimate(1.0) is None
    assert own.received_s is None
    own.measure(telemetry(5.0, np.ones(4)))
    early = own.estimate(4.0)
    assert early is not None
    assert early.time_s == own.received_s == 5.0


def settled() -> OwnFilter:
    """A filter that has seen a vehicle hover at the origin until 5 s."""
    own = OwnFilter(PLANT, SETTINGS)
    for tick in range(51):
        own.measure(telemetry(tick * PERIOD_S, np.zeros(4)))
        own.command(tick * PERIOD_S, np.zeros(2))
    return own


def test_telemetry_from_the_past_is_refused() -> None:
    own = settled()
    own.measure(telemetry(4.9, np.full(4, 0.05)))
    assert own.refused == 1
    assert estimated(own, 5.0) == pytest.approx(np.zeros(6), abs=1e-9)
    own.measure(telemetry(5.0, np.full(4, 0.02)))
    assert own.refused == 1


def test_an_outlier_changes_nothing() -> None:
    for far_m in (30.0, 1e200, -1e308):
        own = settled()
        own.measure(telemetry(5.1, np.array([far_m, 0.0, 0.0, 0.0])))
        assert (own.refused, own.resets) == (1, 0)
        assert estimated(own, 5.1) == pytest.approx(np.zeros(6), abs=1e-9)


def test_outliers_that_go_on_are_the_new_truth() -> None:
    own = settled()
    moved = np.array([30.0, -5.0, 0.0, 0.0])
    for tick in range(1, 10):
        own.measure(telemetry(5.0 + tick * PERIOD_S, moved))
    assert (own.refused, own.resets) == (9, 0)
    assert own.received_s == pytest.approx(5.9), "refused, but heard"
    for tick in range(10, 14):
        own.measure(telemetry(5.0 + tick * PERIOD_S, moved))
        if own.resets:  # only then are setpoints where the vehicle is
            own.command(5.0 + tick * PERIOD_S, moved[:2])
    assert (own.resets, own.jumps, own.received_s) == (1, 1, 6.3)
    assert estimated(own, 6.3) == pytest.approx([30.0, -5.0, 0.0, 0.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(("lasts", "jumps"), [(15, 1), (5, 0)])
def test_a_height_that_jumps_and_stays_is_a_jump(lasts: int, jumps: int) -> None:
    own = settled()
    for tick in range(1, 20):
        sample = telemetry(5.0 + tick * PERIOD_S, np.zeros(4))
        x, y, z = sample.position_m
        own.measure(msgspec.structs.replace(sample, position_m=(x, y, z + (6.0 if tick <= lasts else 0.0))))
    assert (own.refused, own.resets, own.jumps) == (0, 0, jumps)


def test_a_wrong_plant_resets_the_filter_and_lowers_the_authority_but_is_no_jump() -> None:
    # It flies off at 3 m/s2, as no setpoint tells it: every sample is where its velocity leads.
    own = settled()
    assert own.authority == 1.0
    for tick in range(1, 31):
        time_s = tick * PERIOD_S
        own.measure(telemetry(5.0 + time_s, np.array([1.5 * time_s**2, 0.0, 3.0 * time_s, 0.0])))
    assert own.resets >= 1
    assert own.jumps == 0
    assert own.authority < 0.5


def circled(own: OwnFilter, plant: Plant, *, rate_rad_s: float, duration_s: float) -> np.ndarray:
    """Let `plant` follow a setpoint that circles at 2 m and drifts by 0.3 m/s; return how far predictions were off."""
    motion, off, told = np.zeros(4), [], None
    for tick in range(round(duration_s / PERIOD_S)):
        now_s = tick * PERIOD_S
        own.measure(telemetry(now_s, motion))
        if told is not None:
            off.append(motion - told)
        angle = rate_rad_s * now_s
        setpoint = np.array([2.0 * np.cos(angle) + 0.3 * now_s, 2.0 * np.sin(angle)])
        own.command(now_s, setpoint)
        motion = exact_step(plant, PERIOD_S).advance(motion, setpoint, np.array([0.1, -0.2]))
        told = own.predicted(now_s + PERIOD_S, 0.0)[:4]
    return np.array(off)


def test_the_disturbance_of_a_wrong_plant_on_a_circle_is_estimated_without_lag() -> None:
    # Each axis is wrong by another share: no disturbance that turns as a whole would do.
    wrong = Plant(
        PlantAxis(PLANT.x.a0_per_s2 * 1.2, PLANT.x.a1_per_s), PlantAxis(PLANT.y.a0_per_s2, PLANT.y.a1_per_s * 0.7)
    )
    errors = {}
    for rate_rad_s in (0.0, 0.2):
        own = OwnFilter(PLANT, SETTINGS)
        own.turn_disturbance(rate_rad_s)
        errors[rate_rad_s] = np.abs(circled(own, wrong, rate_rad_s=0.2, duration_s=120.0)[-300:]).max()
    assert errors[0.2] < 2e-4
    assert errors[0.0] > 10.0 * errors[0.2], "a disturbance that is taken to stand still lags"


def test_a_ring_that_turns_at_another_rate_is_followed() -> None:
    wrong = Plant(PLANT.x, PlantAxis(PLANT.y.a0_per_s2, PLANT.y.a1_per_s * 0.7))
    errors = []
    for rates_rad_s in ((0.2,), (0.2, 0.1)):
        own = OwnFilter(PLANT, SETTINGS)
        for rate_rad_s in rates_rad_s:
            own.turn_disturbance(rate_rad_s)
        errors.append(np.abs(circled(own, wrong, rate_rad_s=0.1, duration_s=120.0)[-300:]).max())
    assert errors[1] < 1e-4
    assert errors[0] > 10.0 * errors[1]


def test_the_swinging_part_is_not_lost_when_the_ring_is_left() -> None:
    own = OwnFilter(PLANT, SETTINGS)
    own.turn_disturbance(0.2)
    circled(own, Plant(PLANT.x, PlantAxis(PLANT.y.a0_per_s2, PLANT.y.a1_per_s * 0.7)), rate_rad_s=0.2, duration_s=100.0)
    before = own.predicted(100.0, 0.0)
    own.turn_disturbance(0.0)
    assert own.predicted(100.0, 0.0)[4:] == pytest.approx(before[4:], abs=0.02)


def test_a_shift_of_the_frame_shifts_estimate_and_setpoints() -> None:
    """As if all telemetry and setpoints had been in the other frame from the start."""
    moved_m = np.array([3.0, -2.0])
    found = []
    for before_m, after_m in ((moved_m, np.zeros(2)), (np.zeros(2), moved_m)):
        own = OwnFilter(DELAYED, SETTINGS)
        for tick in range(40):
            at_s, offset_m = tick * PERIOD_S, before_m + after_m if tick >= 25 else before_m
            if tick == 25 and after_m.any():
                own.shift(*after_m.tolist())
            own.measure(telemetry(at_s, np.array([0.3 * at_s + offset_m[0], offset_m[1], 0.3, 0.0])))
            own.command(at_s, np.array([0.3 * at_s + 1.0, 0.5]) + offset_m)
        estimate = own.estimate(4.0)
        assert estimate is not None
        found.append((estimate.mean, own.predicted(4.2, PERIOD_S / 2.0), own.mean_aim_m(2.2, 3.0), own.resets))
    (first, first_predicted, first_aim, _), (second, second_predicted, second_aim, resets) = found
    np.testing.assert_allclose(second, first, atol=1e-9)
    np.testing.assert_allclose(second_predicted, first_predicted, atol=1e-9)
    assert second_aim == pytest.approx(first_aim)
    assert resets == 0


# Memory


def test_filters_of_one_plant_share_what_follows_from_its_steps() -> None:
    """Telemetry in flight comes at uneven times: each filter on its own kept a kilobyte for each of them."""
    grown = []
    filters = [OwnFilter(PLANT, SETTINGS) for _ in range(2)]
    times_s = np.cumsum(np.arange(0.02, 0.42, 0.001)).tolist()
    for own in filters:
        tracemalloc.start()
        for time_s in times_s:
            own.measure(telemetry(time_s, np.zeros(4)))
            own.command(time_s, np.zeros(2))
        grown.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert grown[0] > 200_000 > 10 * grown[1]
