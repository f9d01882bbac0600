"""The condensed quadratic programmes of the LMPC: matrices, and the linear feedback that solves them without bounds.

Over the decision U = (u_0 ... u_{c-1}), with the last input held to the end of the horizon, it minimises

    sum_j (x_j - r_j)' Q (x_j - r_j) + sum_i du_i' R du_i,   x_{j+1} = A x_j + B u_j

(13), (14) for the formation, (23), (24) for the ring. Every term of these costs is here, its weight is a key in
agents/settings/tuning.py. They need no solver: missions are checked with their gains.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import msgspec
import numpy as np

from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings, FormationSettings
from estimation.plant.model import Plant, exact_step
from estimation.state import Vector

_FORMATION_CONSTRAINED = (2, 3)  # the two speeds
RING_CONSTRAINED = (1, 2, 3)  # bearing, radial speed, angular rate
_KEPT: Final = 16
"""The programmes that vehicles of a process share: one for each plant, and each ring that is flown."""


class Gains(msgspec.Struct, frozen=True):
    """The first input while no bound is active: `state @ x + reference @ r + previous @ u`, with constant r.

    Shapes (m, n), (m, n) and (m, m).
    """

    state: Vector
    reference: Vector
    previous: Vector


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """Half U' `hessian` U + g' `gradient`' U, with g the state, the reference and the previous input in one vector.

    Vehicles with the same settings share one.

    U has s = `control_horizon` m entries, g has n + `horizon` n + m. `hessian` is (s, s), `gradient` (s, g). Without
    bounds `best` (s, g) takes g to the optimum. The constrained states of all samples, k of each, are
    `free_rows` (horizon k, g) times g plus `forced_rows` (horizon k, s) times U; `outcome` takes g to the optimum and
    to them without bounds.
    """

    states: int
    inputs: int
    horizon: int
    control_horizon: int
    hessian: Vector
    gradient: Vector
    best: Vector
    free_rows: Vector
    forced_rows: Vector
    outcome: Vector

    @property
    def gains(self) -> Gains:
        """The linear feedback that equals the optimum while no bound is active."""
        first = self.best[: self.inputs]
        by_sample = first[:, self.states : -self.inputs].reshape(self.inputs, self.horizon, self.states)
        return Gains(first[:, : self.states], by_sample.sum(axis=1), first[:, -self.inputs :])


def formation_programme(config: AgentConfig) -> QuadraticProgram:
    """Return the formation's programme: the error dynamics of a vehicle and its predecessor - (1), (2), (13), (14).

    They equal the plant's, in [e_x e_y e_x' e_y'] with relative aims as inputs.
    """
    return _formation_programme(config.plant, config.formation)


@lru_cache(maxsize=_KEPT)
def _formation_programme(plant: Plant, settings: FormationSettings) -> QuadraticProgram:
    step = exact_step(plant, settings.prediction_step_s)
    return condensed(
        step.transition,
        step.input_gain,
        horizon=settings.horizon,
        control_horizon=settings.control_horizon,
        state_weight=np.diag([settings.position_weight] * 2 + [settings.velocity_weight] * 2),
        increment_weight=np.full(2, settings.increment_weight),
        constrained_states=_FORMATION_CONSTRAINED,
    )


@lru_cache(maxsize=_KEPT)
def ring_programme(settings: EncirclementSettings) -> QuadraticProgram:
    """Return the ring's programme: integrators in [r r phi r' r phi'] with inputs [r'' r phi''] - (12), (23) to (26).

    Angles are in metres along the circle of the vehicle's present radius r, so that one slack suits all bounds.

    (24b) and (24c) weight, by rho and zeta, the differences between the angles to the neighbours behind and in front
    and the angles between the references. The neighbours are predicted on their references, as (25) and (26) do at the
    ring's rate. Both terms therefore weight the vehicle's distance from its own reference, by rho + zeta
    (`spacing_weight`).
    """
    per_m2 = settings.radius_m**-2
    step_s = settings.prediction_step_s
    transition = np.eye(4)
    transition[:2, 2:] = np.eye(2) * step_s
    input_gain = np.vstack([np.eye(2) * step_s**2 / 2.0, np.eye(2) * step_s])
    return condensed(
        transition,
        input_gain,
        horizon=settings.horizon,
        control_horizon=settings.control_horizon,
        state_weight=np.diag(
            [settings.radius_weight, settings.spacing_weight * per_m2, 0.0, settings.rate_weight * per_m2]
        ),
        increment_weight=np.array([settings.radial_increment_weight, settings.angular_increment_weight * per_m2]),
        constrained_states=RING_CONSTRAINED,
    )


def condensed(
    transition: Vector,
    input_gain: Vector,
    *,
    horizon: int,
    control_horizon: int,
    state_weight: Vector,
    increment_weight: Vector,
    constrained_states: tuple[int, ...],
) -> QuadraticProgram:
    """Condense A (n, n), B (n, m) with weights Q (n, n) and the diagonal of R (m,)."""
    states, inputs = input_gain.shape
    size = control_horizon * inputs
    free, forced = _responses(transition, input_gain, horizon, control_horizon)
    weighted = np.kron(np.eye(horizon), state_weight) @ forced
    difference = np.eye(size) - np.eye(size, k=-inputs)
    increment_cost = difference.T @ np.diag(np.tile(increment_weight, control_horizon))
    hessian = 2.0 * (forced.T @ weighted + increment_cost @ difference)
    gradient = 2.0 * np.hstack([weighted.T @ free, -weighted.T, -increment_cost[:, :inputs]])
    rows = [step * states + state for step in range(horizon) for state in constrained_states]
    best = -np.asarray(np.linalg.solve(hessian, gradient), dtype=np.float64)
    free_rows = np.hstack([free[rows], np.zeros((len(rows), gradient.shape[1] - states))])
    return QuadraticProgram(
        states=states,
        inputs=inputs,
        horizon=horizon,
        control_horizon=control_horizon,
        hessian=hessian,
        gradient=gradient,
        best=best,
        free_rows=free_rows,
        forced_rows=forced[rows],
        outcome=np.vstack([best, free_rows + forced[rows] @ best]),
    )


def _responses(transition: Vector, input_gain: Vector, horizon: int, control_horizon: int) -> tuple[Vector, Vector]:
    """Return the free response (horizon n, n) and the response to the decision (horizon n, control_horizon m)."""
    states, inputs = input_gain.shape
    free = np.zeros((horizon * states, states))
    forced = np.zeros((horizon * states, control_horizon * inputs))
    power, response = np.eye(states), np.zeros((states, control_horizon * inputs))
    for step in range(horizon):
        held = min(step, control_horizon - 1) * inputs
        power, response = transition @ power, transition @ response
        response[:, held : held + inputs] += input_gain
        free[step * states : (step + 1) * states] = power
        forced[step * states : (step + 1) * states] = response
    return free, forced
