"""The predicted time to settle: against the law's closed form; the flown missions compare it with flights."""

from collections.abc import Callable
from dataclasses import replace
from math import inf, log, pi, radians

import pytest

from agents.ring.settling import settling_s
from agents.settings.config import AgentConfig
from estimation.polar import Polar

Maker = Callable[..., AgentConfig]
RADIUS_M, RATE_RAD_S, SMOOTHING_S = 10.0, 0.05, 5.0
WITHIN = 0.05, radians(5.0)


def config_of(make_config: Maker, gain_per_s: float = 0.3) -> AgentConfig:
    ring = {"radius_m": RADIUS_M, "angular_rate_rad_s": RATE_RAD_S, "smoothing_time_s": SMOOTHING_S}
    return make_config(encirclement={**ring, "spacing_gain_per_s": gain_per_s})


def on_ring(*bearings_rad: float) -> dict[int, Polar]:
    return {i: Polar(RADIUS_M, bearing_rad, 0.0, RATE_RAD_S) for i, bearing_rad in enumerate(bearings_rad, 1)}


@pytest.mark.parametrize("count", [2, 3, 8])
def test_small_errors_decay_as_the_law_states(count: int, make_config: Maker) -> None:
    """(20): every spacing error decays at gamma. The vehicles begin at the ring's rate, within an acceleration."""
    gain_per_s, off_rad = 0.1, radians(12.0)
    even_rad = 2.0 * pi / count
    bearings_rad = [0.0, *(even_rad * each + off_rad for each in range(1, count))]
    predicted_s = settling_s(config_of(make_config, gain_per_s), on_ring(*bearings_rad), *WITHIN)
    assert predicted_s == pytest.approx(SMOOTHING_S + log(12.0 / 5.0) / gain_per_s, rel=0.1)


def test_uneven_gaps_are_where_the_ring_settles(make_config: Maker) -> None:
    """One of three has twice the gap: 180, 90 and 90 degrees."""
    config = replace(config_of(make_config, 0.1), gaps={2: 2.0})
    off_rad = radians(12.0)
    settled_s, uneven_s = (
        settling_s(config, on_ring(0.0, pi / 2.0 + off, 1.5 * pi), *WITHIN) for off in (0.0, off_rad)
    )
    assert settled_s == SMOOTHING_S
    assert uneven_s == pytest.approx(SMOOTHING_S + log(12.0 / 5.0) / 0.1, rel=0.1)
    assert settling_s(config_of(make_config, 0.0), on_ring(0.0, pi / 2.0, 1.5 * pi), *WITHIN) == inf


def test_a_large_error_takes_its_way_at_the_speed_of_a_transition(make_config: Maker) -> None:
    """Of two at one bearing each has a quarter turn to go, 15.7 m."""
    config = config_of(make_config)
    way_m = RADIUS_M * pi / 2.0
    predicted_s = settling_s(config, on_ring(0.0, 0.01), *WITHIN) - SMOOTHING_S
    assert way_m / config.encirclement.transition_speed_m_s < predicted_s
    # The slower one keeps a fifth of the ring's 0.5 m/s, so the other flies its way at up to 1 m/s and more of it.
    assert predicted_s < 2.0 * way_m / config.encirclement.transition_speed_m_s + 10.0


def test_a_ring_that_is_even_has_settled_and_one_without_a_gain_never_does(make_config: Maker) -> None:
    assert settling_s(config_of(make_config), on_ring(0.0, pi), *WITHIN) == SMOOTHING_S
    assert settling_s(config_of(make_config), on_ring(1.0), *WITHIN) == SMOOTHING_S
    assert settling_s(config_of(make_config, 0.0), on_ring(0.0, pi / 2.0), *WITHIN) == inf


def test_a_vehicle_outside_has_its_way_in_as_well(make_config: Maker) -> None:
    config = config_of(make_config)
    outside = Polar(2.0 * RADIUS_M, pi, 0.0, 0.0)
    alone_s = settling_s(config, {2: outside}, *WITHIN)
    assert alone_s > SMOOTHING_S + 0.95 * RADIUS_M / config.encirclement.speed_max_m_s
    assert settling_s(config, {**on_ring(0.0), 2: outside}, *WITHIN) >= alone_s
