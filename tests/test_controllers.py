"""The NMPC that cordon's planner is compared with: its optimum against independent ones, and its flights."""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from math import pi, tau
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

from agents.control.encirclement import ring_lmpc
from agents.control.lmpc import Bounds
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from estimation.polar import Polar
from estimation.state import Vector
from tests.experiments.controllers import comparison
from tests.experiments.controllers.figures import draw
from tests.experiments.controllers.flights import FAMILY, LMPC, NMPC, Job, flown
from tests.experiments.controllers.ring_programme import Neighbours, RingProgramme
from tests.experiments.controllers.tables import tables

Maker = Callable[..., AgentConfig]

needs_casadi = pytest.mark.skipif(
    importlib.util.find_spec("casadi") is None, reason="needs CasADi: pip install -e '.[rivals]'"
)
EVEN = Neighbours(tau / 3.0, tau / 3.0, tau / 3.0)


def settings_of(make_config: Maker, **changes: float) -> EncirclementSettings:
    return make_config(encirclement=changes).encirclement


@needs_casadi
def test_at_rest_on_the_ring_the_optimum_is_to_go_on(make_config: Maker) -> None:
    """The acceleration of a circle is R w² inwards and nothing else, alone and with neighbours evenly spaced."""
    ring, radius_m, rate_rad_s = settings_of(make_config), 10.0, 0.05
    circling = (-radius_m * rate_rad_s**2, 0.0)
    for neighbours in (None, EVEN):
        found = RingProgramme(ring, 0.3).solve(Polar(radius_m, 2.0, 0.0, rate_rad_s), neighbours, circling)
        assert found.solved
        assert np.abs(found.inputs_m_s2 - circling).max() < 1e-5


@needs_casadi
def test_near_a_ring_at_rest_it_plans_as_the_lmpc_does(make_config: Maker) -> None:
    """Slowly about a ring that does not turn, the polar model is two double integrators: the LMPC's."""
    ring = settings_of(make_config, angular_rate_rad_s=0.0, control_horizon=8)
    metres, off_m, ahead_rad, speed_m_s = ring.radius_m, 0.02, 0.003, (0.004, -0.006)
    neighbours = Neighbours(tau / 3.0 + ahead_rad, tau / 3.0 - ahead_rad, tau / 3.0)
    polar = Polar(metres + off_m, -1.0, speed_m_s[0], speed_m_s[1] / metres)
    before = np.array([0.01, -0.02])
    found = RingProgramme(ring, 0.3).solve(polar, neighbours, before.tolist())
    state = np.array([polar.radius_m, 0.0, *speed_m_s])
    reference = np.tile([metres, metres * ahead_rad, 0.0, 0.0], (ring.horizon, 1))
    free = Bounds(np.array([[-9.0, -9.0], [9.0, 9.0]]), np.array([[[-1e20] * 3], [[1e20] * 3]]))
    lmpc = ring_lmpc(ring).solve(state, reference, before, free)
    assert found.solved
    assert np.abs(lmpc.inputs).max() > 0.02
    assert found.inputs_m_s2 == pytest.approx(lmpc.inputs, abs=2e-4)


@needs_casadi
def test_off_the_ring_its_optimum_is_that_of_another_solver_and_another_integrator(make_config: Maker) -> None:
    ring = settings_of(make_config, acceleration_max_m_s2=0.8)
    polar, neighbours, before = Polar(12.0, 0.5, -0.6, -0.05), Neighbours(1.2, 1.9, tau / 3.0), (0.1, 0.2)
    found = RingProgramme(ring, 0.3).solve(polar, neighbours, before)
    bounds = [(-0.8, 0.8)] * (2 * ring.horizon)
    best = minimize(
        lambda inputs: cost(ring, polar, neighbours, before, inputs.reshape(-1, 2)),
        np.zeros(2 * ring.horizon),
        bounds=bounds,
        method="SLSQP",
        options={"ftol": 1e-10, "maxiter": 200},
    )
    inputs = best.x.reshape(-1, 2)
    assert found.solved
    assert np.abs(inputs).max() == pytest.approx(0.8), "a bound is active"
    assert np.abs(inputs).min() < 0.7
    assert found.inputs_m_s2 == pytest.approx(inputs, abs=5e-3)


def cost(
    ring: EncirclementSettings, polar: Polar, neighbours: Neighbours, before: tuple[float, float], inputs: Vector
) -> float:
    """Return (24) with the increments of inputs (horizon, 2), from Cartesian motion about the target."""
    x = np.array([polar.radius_m, 0.0, polar.radial_speed_m_s, polar.radius_m * polar.angular_rate_rad_s])
    radial, angular = ring.radial_increment_weight, ring.angular_increment_weight / ring.radius_m**2
    total, last = 0.0, np.array(before)
    for sample, now in enumerate(inputs, start=1):
        total += float(np.array([radial, angular]) @ (now - last) ** 2)
        last = now
        x = solve_ivp(_pushed, (0.0, ring.prediction_step_s), x, args=(now,), rtol=1e-9, atol=1e-10).y[:, -1]
        radius, bearing = np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])
        rate = (x[0] * x[3] - x[1] * x[2]) / radius**2
        turned = ring.angular_rate_rad_s * ring.prediction_step_s * sample
        total += ring.radius_weight * (radius - ring.radius_m) ** 2
        total += ring.rate_weight * (rate - ring.angular_rate_rad_s) ** 2
        total += ring.lag_weight * (bearing - (turned - neighbours.lag_rad) - neighbours.spacing_rad) ** 2
        total += ring.lead_weight * (turned + neighbours.lead_rad - bearing - neighbours.spacing_rad) ** 2
    return float(total)


def _pushed(_time_s: float, x: Vector, push: Vector) -> list[float]:
    cosine, sine = x[:2] / np.hypot(x[0], x[1])
    return [x[2], x[3], push[0] * cosine - push[1] * sine, push[0] * sine + push[1] * cosine]


@needs_casadi
def test_no_neighbour_is_come_nearer_than_the_clearance(make_config: Maker) -> None:
    """A neighbour just ahead stops a vehicle that is faster than the ring, although its place is farther on."""
    ring, clearance_rad = settings_of(make_config, lead_weight=0.0), 0.3
    polar, before = Polar(10.0, 0.0, 0.0, 0.15), (0.0, 0.0)
    near = Neighbours(clearance_rad + 0.05, pi / 2.0, pi)
    free = Neighbours(pi, pi / 2.0, pi)
    braked = RingProgramme(ring, clearance_rad).solve(polar, near, before)
    hurried = RingProgramme(ring, clearance_rad).solve(polar, free, before)
    assert braked.solved
    assert hurried.solved
    assert braked.inputs_m_s2[0, 1] < -0.2 < 0.2 < hurried.inputs_m_s2[0, 1]


@needs_casadi
def test_both_planners_fly_one_mission_and_are_measured_alike(tmp_path: Path) -> None:
    outcomes = [flown(Job("case3-turns", 0, planner, 14.0, 10.0)) for planner in (LMPC, NMPC)]
    plans = [each.took_s.size for each in outcomes]
    assert plans[0] == plans[1] > 500
    for outcome in outcomes:
        assert outcome.on_ring
        assert outcome.unsolved == 0
        assert outcome.took_s.min() > 0.0
        assert outcome.radius_m < 16.0 / 4.0, "on its way to the ring"
    assert not np.array_equal(outcomes[0].motion.radius_m, outcomes[1].motion.radius_m)
    drawn = [replace(each, job=replace(each.job, scene=FAMILY)) for each in outcomes]
    lines = tables(["case3-turns", FAMILY], [*outcomes, *drawn])
    cells = {len(line.split("|")) for line in lines if line.startswith("|")}
    assert cells == {11, 8}
    field = [replace(each, job=replace(each.job, scene="case2-field")) for each in outcomes]
    pictures = draw(tmp_path, [*field, *drawn])
    assert [path.stat().st_size > 10_000 for path in pictures] == [True, True]


def test_without_casadi_the_comparison_names_the_extra(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparison, "find_spec", lambda name: None)
    assert comparison.main(1, 0, ["case1"], None) == 2
    assert ".[rivals]" in capsys.readouterr().err
