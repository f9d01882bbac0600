"""Targets that evade vehicles: the law in closed form, and its bounds with random teams."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest

from sitl.reacting_target import Evasion, FlownTarget
from sitl.vehicle.plant_step import Motion

LAW = Evasion(speed_m_s=1.5, acceleration_m_s2=0.5, distance_m=25.0)
RATE_HZ = 10.0


def at(*places_m: tuple[float, float]) -> dict[int, Motion]:
    """A team at rest."""
    return {number: (x, y, 0.0, 0.0) for number, (x, y) in enumerate(places_m, 1)}


def around(count: int, radius_m: float, turned_rad: float = 0.0) -> list[tuple[float, float]]:
    angles = [turned_rad + 2.0 * pi * k / count for k in range(count)]
    return [(radius_m * cos(angle), radius_m * sin(angle)) for angle in angles]


def test_it_flees_one_vehicle_that_approaches_as_the_closed_form_says() -> None:
    """At 3 m/s from 40 m off a vehicle is within 25 m after 5 s; then the target accelerates uniformly up to its speed.

    It decides at a tick, and moves from then on: s = a t²/2 until t = v/a, then s = v t - v²/(2 a).
    """
    reaction = LAW.reaction((40.0, 0.0), RATE_HZ)
    near_s = 5.1  # the first tick at which the vehicle is nearer than 25 m: at 5.0 s it is just as far
    for tick in range(200):
        time_s = tick / RATE_HZ
        since_s = max(time_s - near_s, 0.0)
        ramp_s = 1.5 / 0.5
        fled_m = 0.5 * since_s**2 / 2.0 if since_s <= ramp_s else 1.5 * since_s - 1.5**2 / (2.0 * 0.5)
        assert reaction(time_s, at((3.0 * time_s, 0.0))) == pytest.approx((40.0 + fled_m, 0.0), abs=1e-9)


def test_it_stops_as_evenly_as_it_started_when_the_vehicle_is_gone() -> None:
    reaction = LAW.reaction((0.0, 0.0), RATE_HZ)
    path_m = [reaction(tick / RATE_HZ, at((0.0, -10.0)) if tick < 60 else {}) for tick in range(140)]
    # Its velocity is v, and changes to none within v/a: it comes to rest v²/(2 a) = 2.25 m farther.
    assert path_m[60] == pytest.approx((0.0, 1.5 * 6.0 - 2.25))
    assert path_m[-1] == path_m[91] == pytest.approx((0.0, path_m[60][1] + 2.25))


def test_the_desired_velocity_is_that_of_the_law(subtests: pytest.Subtests) -> None:
    here = (0.0, 0.0)
    cases: dict[str, tuple[list[tuple[float, float]], tuple[float, float]]] = {
        "one vehicle, however near": ([(0.0, -1.0)], (0.0, 1.5)),
        "one vehicle, just within": ([(24.9, 0.0)], (-1.5, 0.0)),
        "one vehicle, as far": ([(25.0, 0.0)], (0.0, 0.0)),
        "no direction": ([(0.0, 0.0)], (0.0, 0.0)),
        "three, evenly around": (around(3, 12.0, 0.4), (0.0, 0.0)),
        "two that are opposite and equally near": ([(9.0, 0.0), (-9.0, 0.0)], (0.0, 0.0)),
        # 1.5 (1 - (25 - 15) / (25 - 5)) = 0.75
        "two that are opposite, one nearer": ([(5.0, 0.0), (-15.0, 0.0)], (-0.75, 0.0)),
        # Two equal pushes at a right angle are longer than one: the speed is the limit.
        "two at a right angle": ([(8.0, 0.0), (0.0, 8.0)], (-1.5 / 2**0.5, -1.5 / 2**0.5)),
        "a gap": (around(4, 12.0)[1:], (1.5, 0.0)),
    }
    for name, (places_m, wanted_m_s) in cases.items():
        with subtests.test(name):
            assert LAW.velocity_wanted_m_s(here, at(*places_m)) == pytest.approx(wanted_m_s, abs=1e-9)


def test_it_never_exceeds_speed_and_acceleration_whatever_the_team_does(subtests: pytest.Subtests) -> None:
    for seed in range(20):
        random = np.random.default_rng(seed)
        speed, acceleration, distance = random.uniform((0.2, 0.1, 2.0), (5.0, 3.0, 60.0)).tolist()
        count, rate_hz = int(random.integers(1, 9)), float(random.choice([5.0, 10.0, 20.0]))
        reaction = Evasion(speed, acceleration, distance).reaction((0.0, 0.0), rate_hz)
        # Every vehicle jumps anywhere at any tick: no true team demands as much.
        teams = random.normal(0.0, 0.5 * distance, (400, count, 2))
        path_m = np.array([reaction(k / rate_hz, at(*map(tuple, team.tolist()))) for k, team in enumerate(teams)])
        velocity_m_s = np.diff(path_m, axis=0) * rate_hz
        with subtests.test(seed=seed):
            assert np.hypot(*velocity_m_s.T).max() <= speed * (1.0 + 1e-9)
            assert np.hypot(*np.diff(velocity_m_s, axis=0).T).max() * rate_hz <= acceleration * (1.0 + 1e-9)
            assert np.hypot(*velocity_m_s.T).max() > 0.1 * speed, "it does flee"


def test_a_flown_target_keeps_its_path_and_knows_the_vehicles_by_their_ids() -> None:
    seen: list[tuple[float, dict[int, Motion]]] = []

    def reaction(time_s: float, team: object) -> tuple[float, float]:
        assert isinstance(team, dict)
        seen.append((time_s, team))
        return time_s, hypot(3.0, 4.0)

    target = FlownTarget(reaction, (4, 2))
    for time_s in (0.0, 0.1):
        target.advance(time_s, [(1.0, 2.0, 3.0, 4.0), (5.0, 6.0, 7.0, 8.0)])
    assert target.path_m == [(0.0, 5.0), (0.1, 5.0)]
    assert target.position_m(7.0) == (0.1, 5.0)
    assert seen[1] == (0.1, {4: (1.0, 2.0, 3.0, 4.0), 2: (5.0, 6.0, 7.0, 8.0)})
