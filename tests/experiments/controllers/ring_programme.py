"""The nonlinear programme of the encirclement: (23) to (26) over the polar model itself, by CasADi and IPOPT.

One vehicle's state about the target is [r phi r' phi']. Its inputs are the accelerations along and across the radius,
so the model (4), (5) contains the terms that feedback linearisation cancels:

    r'' = u_r + r phi'^2        phi'' = (u_phi - 2 r' phi') / r

The cost is (24): radius, angular rate, and the angles to the neighbours behind and in front, which turn at the ring's
rate (25), (26); and the increments of the inputs. Inputs have hard bounds. Bounds on speeds and on the clearance to
both neighbours are soft by one slack, as in `Lmpc`.
"""

from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from agents.settings.sections import EncirclementSettings
from estimation.polar import Polar
from estimation.state import Vector

SLACK_WEIGHT = 100.0
"""As in agents/control/encirclement.py: the weight of exceeding a bound by 1 m or 1 m/s."""
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 50,
    "tol": 1e-5,
    "mu_strategy": "adaptive",
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-6,
    "warm_start_mult_bound_push": 1e-6,
    "warm_start_slack_bound_push": 1e-6,
}
_STATES, _INPUTS = 4, 2
_SAMPLE = _INPUTS + _STATES


class Neighbours(NamedTuple):
    """The angles to the vehicle in front and from the one behind [rad], and the even spacing (15) [rad]."""

    lead_rad: float
    lag_rad: float
    spacing_rad: float


class Optimum(NamedTuple):
    """The accelerations (horizon, 2) along and across the radius [m/s²], and whether IPOPT has solved the programme."""

    inputs_m_s2: Vector
    solved: bool


class RingProgramme:
    """Solves one vehicle's programme for the inputs and states of all samples (multiple shooting).

    It starts from its previous solution.
    """

    def __init__(self, settings: EncirclementSettings, clearance_rad: float) -> None:
        """Set the programme up; raises ModuleNotFoundError without CasADi."""
        ca: Any = import_module("casadi")
        self._horizon = settings.horizon
        decision = ca.SX.sym("decision", _SAMPLE * self._horizon + 1)
        given = ca.SX.sym("given", 9)
        cost, gaps, rows = _rolled_out(ca, settings, clearance_rad, decision, given)
        problem = {"x": decision, "p": given, "f": cost, "g": ca.vertcat(gaps, rows)}
        self._solver = ca.nlpsol("ring", "ipopt", problem, {"print_time": False, "ipopt": IPOPT})
        most = [settings.acceleration_max_m_s2] * _INPUTS + [np.inf] * _STATES
        below = np.concatenate([np.zeros(gaps.numel()), np.full(rows.numel(), -np.inf)])
        highest = np.append(np.tile(most, self._horizon), np.inf)
        lowest = np.append(-highest[:-1], 0.0)
        self._bounds = {"lbx": lowest, "ubx": highest, "lbg": below, "ubg": 0.0}
        self._start: dict[str, Any] | None = None

    def reset(self) -> None:
        """Clear the previous solution."""
        self._start = None

    def solve(self, polar: Polar, neighbours: Neighbours | None, before_m_s2: Sequence[float]) -> Optimum:
        """Plan from a polar state with the previous input (2,); without neighbours if alone on the ring."""
        motion = (polar.radius_m, polar.radial_speed_m_s, polar.angular_rate_rad_s)
        angles = (0.0, 0.0, 0.0, 0.0) if neighbours is None else (*neighbours, 1.0)
        if self._start is None:
            stays = (0.0, 0.0, polar.radius_m, 0.0, *motion[1:])
            self._start = {"x0": np.append(np.tile(stays, self._horizon), 0.0)}
        found = self._solver(p=(*motion, *angles, *before_m_s2), **self._start, **self._bounds)
        solved = bool(self._solver.stats()["success"])
        self._start = {"x0": found["x"], "lam_x0": found["lam_x"], "lam_g0": found["lam_g"]} if solved else None
        inputs = found["x"].full().ravel()[:-1].reshape(-1, _SAMPLE)[:, :_INPUTS]
        return Optimum(np.asarray(inputs, dtype=np.float64), solved)


def _rolled_out(
    ca: Any, settings: EncirclementSettings, clearance_rad: float, decision: Any, given: Any
) -> tuple[Any, Any, Any]:
    """Return the cost, the equality constraints (gaps between samples), and the inequality constraints (<= 0)."""
    radius, radial_rate, rate, lead, lag, spacing, others = (given[place] for place in range(7))
    state, before, slack = ca.vertcat(radius, 0.0, radial_rate, rate), given[7:9], decision[-1]
    step, metres, rate_wanted = _step(ca, settings.prediction_step_s), settings.radius_m, settings.angular_rate_rad_s
    weights = ca.DM([settings.radial_increment_weight, settings.angular_increment_weight / metres**2])
    cost, gaps, rows = SLACK_WEIGHT * (slack + slack**2 / 2.0), [], []
    for sample in range(settings.horizon):
        now, after = ca.vertsplit(decision[_SAMPLE * sample : _SAMPLE * (sample + 1)], [0, _INPUTS, _SAMPLE])
        gaps.append(step(state, now) - after)
        cost += ca.dot(weights, (now - before) ** 2)
        state, before = after, now
        r, phi, r_rate, phi_rate = ca.vertsplit(state)
        drift = rate_wanted * settings.prediction_step_s * (sample + 1)
        behind, ahead = phi + lag - drift, lead + drift - phi
        cost += settings.radius_weight * (r - metres) ** 2 + settings.rate_weight * (phi_rate - rate_wanted) ** 2
        cost += others * settings.lag_weight * (behind - spacing) ** 2
        cost += others * settings.lead_weight * (ahead - spacing) ** 2
        too_fast = [speed - settings.speed_max_m_s for speed in (r_rate, -r_rate, r * phi_rate, -r * phi_rate)]
        too_near = [others * metres * (clearance_rad - angle) for angle in (behind, ahead)]
        rows += [each - slack for each in (*too_fast, *too_near, settings.radius_min_m - r)]
    return cost, ca.vertcat(*gaps), ca.vertcat(*rows)


def _step(ca: Any, step_s: float) -> Any:
    """Return the polar model over one sample with held inputs, by the classical Runge-Kutta method."""
    state, inputs = ca.SX.sym("state", _STATES), ca.SX.sym("inputs", _INPUTS)
    slope = ca.Function("slope", [state, inputs], [_slope(ca, state, inputs)])
    first = slope(state, inputs)
    second = slope(state + step_s / 2.0 * first, inputs)
    third = slope(state + step_s / 2.0 * second, inputs)
    fourth = slope(state + step_s * third, inputs)
    after = state + step_s / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return ca.Function("step", [state, inputs], [after])


def _slope(ca: Any, state: Any, inputs: Any) -> Any:
    radius, _, radial_rate, rate = ca.vertsplit(state)
    outward, across = ca.vertsplit(inputs)
    return ca.vertcat(radial_rate, rate, outward + radius * rate**2, (across - 2.0 * radial_rate * rate) / radius)
