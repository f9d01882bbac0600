"""Linear model predictive control: solves the quadratic programmes of agents/control/lmpc_cost.py under bounds.

Inputs and selected states are bounded. Bounds on inputs are hard, bounds on states soft: a vehicle outside them still
has a plan, which leads back inside.

The active set of a small quadratic programme. Its optimum is the starting point of OSQP.

From a cold start OSQP takes hundreds of iterations where several bounds on states are active, whatever the scaling
(docs/notes/control.md). With the active set known, the optimum solves a few linear equations. On the bounds of the
mission `crossing`, the search takes 19 us and OSQP from its optimum 9 us (median); OSQP from a cold start takes 200 us,
and 15 ms in the slowest 1 %. daqp alone takes 7 us, but its plans differ by 1e-5 m/s²: recorded flights would no longer
be replayed bit for bit.

The dual of  min x' P x / 2 + q' x,  G x <= b  is  min y' K y / 2 + d' y,  y >= 0,  with  K = G P^-1 G'  and the slack
d = b + G P^-1 q  of the bounds at the unbounded optimum. It is solved by Lawson and Hanson's algorithm for non-negative
least squares: the bound that is exceeded most becomes active, and one whose multiplier turns negative leaves.
"""

from collections.abc import Sequence
from enum import Enum
from functools import lru_cache
from typing import Final

import numpy as np

from agents.control.lmpc_cost import QuadraticProgram
from estimation.state import Vector
from estimation.vectors import Pair

_EXCESS_MAX: Final = 1e-9
_RIDGE: Final = 1e-12
"""Added to the diagonal of K, which is 1: dependent bounds then have unique multipliers, and some of them leave."""
_CHANGES_MAX = 50  # not Final, which is compiled into its users: tests change it
_ZERO = np.zeros(1)


class BoundedCost:
    """A cost with a positive definite Hessian (n, n), and `rows` (m, n) with bounds; searches can share one."""

    def __init__(self, hessian: Vector, rows: Vector) -> None:
        self.hessian: Final = hessian
        self.rows: Final = rows
        sides = np.vstack([rows, -rows])  # on each row an upper and a lower bound
        self.inverse: Final[Vector] = np.asarray(np.linalg.inv(hessian), dtype=np.float64)
        self.scale: Final[Vector] = ((sides @ self.inverse) * sides).sum(axis=1) ** -0.5
        sides = self.scale[:, np.newaxis] * sides
        self.responses: Final[Vector] = np.asarray(sides @ self.inverse, dtype=np.float64)
        self.coupling: Final[Vector] = self.responses @ sides.T + _RIDGE * np.eye(len(sides))


class ActiveSet:
    """Finds which of the bounds of a cost are active."""

    def __init__(self, cost: BoundedCost) -> None:
        self._cost = cost
        self._active: list[int] = []

    def optimum(self, gradient: Vector, lower: Vector, upper: Vector) -> tuple[Vector, Vector] | None:
        """Return the optimum (n,) and the multipliers (m,), positive on upper bounds and negative on lower ones.

        The search begins at the active set found last. None if it exceeds its limit of steps.
        """
        room = np.concatenate((upper, -lower)) * self._cost.scale + self._cost.responses.dot(gradient)
        multipliers = self._multipliers(room)
        if multipliers is None:
            return None
        active = self._active
        optimum = -self._cost.inverse.dot(gradient) - multipliers.dot(self._cost.responses[active])
        by_side = np.zeros(len(room))
        by_side[active] = multipliers * self._cost.scale[active]
        above, below = by_side.reshape(2, -1)
        return optimum, above - below

    def _multipliers(self, room: Vector) -> Vector | None:
        """Return the multipliers of the active bounds once no bound is exceeded; `room` is (2 m,)."""
        multipliers = self._stationary(room)
        while multipliers.size and multipliers.min() < 0.0:
            self._keep((multipliers >= 0.0).tolist())
            multipliers = self._stationary(room)
        for _ in range(_CHANGES_MAX):
            left = room + multipliers.dot(self._cost.coupling[self._active])
            left[self._active] = 0.0
            worst = int(left.argmin())
            if not left.item(worst) < -_EXCESS_MAX:
                return multipliers
            self._active.append(worst)
            multipliers = self._with_newest(room, np.concatenate((multipliers, _ZERO)))
        return None

    def _with_newest(self, room: Vector, multipliers: Vector) -> Vector:
        """Move multipliers (k,) towards the stationary ones; a bound whose multiplier reaches zero leaves."""
        wanted = self._stationary(room)
        while wanted.size and wanted.min() < 0.0:
            falls = np.flatnonzero(wanted < 0.0)
            shares = multipliers[falls] / (multipliers[falls] - wanted[falls])
            multipliers = multipliers + shares.min() * (wanted - multipliers)
            multipliers[falls[shares.argmin()]] = 0.0
            stays = multipliers > 0.0
            self._keep(stays.tolist())
            multipliers, wanted = multipliers[stays], self._stationary(room)
        return wanted

    def _keep(self, stays: Sequence[bool]) -> None:
        self._active = [bound for bound, kept in zip(self._active, stays, strict=True) if kept]

    def _stationary(self, room: Vector) -> Vector:
        active = np.array(self._active, dtype=np.intp)
        coupling = self._cost.coupling.take(active, axis=0).take(active, axis=1)
        return np.asarray(-np.linalg.solve(coupling, room.take(active)), dtype=np.float64)


_FEASIBLE_SLACK: Final = 1e-9
_SLACK_WEIGHT: Final = 1e4
_FREE: Final = 1e20


class QpStatus(Enum):
    """How a plan was found: the optimum inside the bounds or on them, or the fallback after a failed solve."""

    INTERIOR = "interior"
    BOUNDED = "bounded"
    FALLBACK = "fallback"


_INTERIOR: Final = QpStatus.INTERIOR


class Solution:
    """The optimal inputs (control_horizon, m), the last held to the end of the horizon, and the status."""

    def __init__(self, inputs: Vector, status: QpStatus) -> None:
        self.inputs: Final = inputs
        self.status: Final = status

    @property
    def first_input(self) -> Vector:
        """The input (m,) to apply now."""
        first: Vector = self.inputs[0]
        return first


class StateBound:
    """The least and the most of a constrained state at the samples: lines over time, by their values now and rates."""

    def __init__(self, least: float, most: float, least_rate: float = 0.0, most_rate: float = 0.0) -> None:
        self.least: Final = least
        self.most: Final = most
        self.least_rate: Final = least_rate
        self.most_rate: Final = most_rate


class Bounds:
    """The bounds of one solve: least and most of each entry of U (s,), and of each constrained state (k,)."""

    def __init__(self, inputs: Sequence[Pair], states: Sequence[StateBound]) -> None:
        self.inputs: Final = inputs
        self.states: Final = states


class Lmpc:
    """An LMPC with constant matrices: a solve updates vectors only and starts warm - (13), (23)."""

    def __init__(self, programme: QuadraticProgram, step_s: float, slack_weight: float = _SLACK_WEIGHT) -> None:
        """Set the solver up, with samples `step_s` apart.

        `slack_weight` is the cost of exceeding a bound on states. It must be well above what the other terms gain by
        exceeding it; a much larger one makes the solver slow and inaccurate.
        """
        states, inputs, horizon = programme.states, programme.inputs, programme.horizon
        size, rows = len(programme.hessian), len(programme.forced_rows)
        self._states, self._inputs, self._size = states, inputs, size
        self._gradient, self._free_rows = programme.gradient, programme.free_rows
        # State, reference and previous input form one vector, in which the problem is linear.
        self._given = np.zeros(self._gradient.shape[1])
        self._given_reference = self._given[states:-inputs].reshape(horizon, states)
        self._outcome = programme.outcome
        self._times_s = step_s * np.arange(1, horizon + 1, dtype=np.float64)
        self._sampled_s: list[float] = self._times_s.tolist()
        self._lower, self._upper = np.empty((2, size + rows))
        self._solver = _SoftQp(_soft(programme, slack_weight), slack_weight)

    def solve(self, state: Vector, reference: Vector, previous_input: Vector, bounds: Bounds) -> Solution:
        """Plan from `state` (n,) along `reference` (horizon, n), starting from the input (m,) applied before."""
        given, size = self._given, self._size
        given[: self._states] = state
        self._given_reference[:] = reference
        given[-self._inputs :] = previous_input
        # Usually no bound is active: the optimum is then a matrix product, exact and cheaper than a solver.
        outcome = self._outcome.dot(given)
        if self._is_inside(outcome.tolist(), bounds):
            return Solution(outcome[:size].reshape(-1, self._inputs), _INTERIOR)
        optimum, status = self._bounded(outcome[:size], bounds)
        return Solution(optimum.reshape(-1, self._inputs), status)

    def _is_inside(self, outcome: list[float], bounds: Bounds) -> bool:
        """Return whether inputs and states, sample by sample, are within the bounds; false for NaN."""
        for number, (least, most) in enumerate(bounds.inputs):
            value = outcome[number]
            if not (value - least >= -_FEASIBLE_SLACK and most - value >= -_FEASIBLE_SLACK):
                return False
        first, states = self._size, bounds.states
        for at_s in self._sampled_s:
            for bound in states:
                value = outcome[first]
                first += 1
                if not (
                    value - (bound.least_rate * at_s + bound.least) >= -_FEASIBLE_SLACK
                    and (bound.most_rate * at_s + bound.most) - value >= -_FEASIBLE_SLACK
                ):
                    return False
        return True

    def _bounded(self, interior: Vector, bounds: Bounds) -> tuple[Vector, QpStatus]:
        size, lower, upper = self._size, self._lower, self._upper
        lower[:size], upper[:size] = zip(*bounds.inputs, strict=True)
        for number, bound in enumerate(bounds.states):
            rows = slice(size + number, None, len(bounds.states))
            lower[rows] = bound.least_rate * self._times_s + bound.least
            upper[rows] = bound.most_rate * self._times_s + bound.most
        drift = self._free_rows.dot(self._given)
        lower[size:] -= drift
        upper[size:] -= drift
        solution = self._solver.minimise(self._gradient.dot(self._given), lower, upper)
        if solution is not None:
            return np.clip(solution, lower[:size], upper[:size]), QpStatus.BOUNDED
        # The fallback for a failed solve: the unbounded optimum, clipped to the input bounds.
        return np.clip(interior, lower[:size], upper[:size]), QpStatus.FALLBACK


@lru_cache(maxsize=16)
def _soft(programme: QuadraticProgram, slack_weight: float) -> BoundedCost:
    """Return the cost of (U, slack): one slack widens all bounds on states, at a cost."""
    hessian, state_rows = programme.hessian, programme.forced_rows
    size, states = len(hessian), len(state_rows)
    slack = np.ones((states, 1))
    rows = np.block(
        [
            [np.eye(size), np.zeros((size, 1))],
            [state_rows, -slack],  # state - slack <= upper
            [state_rows, slack],  # state + slack >= lower
            [np.zeros((1, size)), np.ones((1, 1))],
        ]
    )
    cost = np.zeros((size + 1, size + 1))
    cost[:size, :size] = hessian
    cost[size, size] = slack_weight
    return BoundedCost(cost, rows)


class _SoftQp:
    """Solves the bounded problem in (U, slack)."""

    def __init__(self, cost: BoundedCost, slack_weight: float) -> None:
        bounds, size = len(cost.rows), len(cost.hessian) - 1
        self._size = size
        self._gradient = np.full(size + 1, slack_weight)
        self._lower = np.full(bounds, -_FREE)
        self._upper = np.full(bounds, _FREE)
        self._lower[-1] = 0.0
        self._active_set = ActiveSet(cost)
        # OSQP and scipy take 0.3 s to import, and processes such as the log's never solve.
        from osqp import OSQP  # noqa: PLC0415
        from scipy.sparse import csc_matrix  # noqa: PLC0415

        self._solver = OSQP()
        self._solver.setup(
            csc_matrix(np.triu(cost.hessian)),
            self._gradient,
            csc_matrix(cost.rows),
            self._lower,
            self._upper,
            verbose=False,
            eps_abs=1e-5,
            eps_rel=1e-5,
            max_iter=1000,
            check_termination=1,
            # By default OSQP chooses this from measured time, which makes results irreproducible.
            adaptive_rho_interval=100,
        )

    def minimise(self, gradient: Vector, lower: Vector, upper: Vector) -> Vector | None:
        """Return the optimal decision (size,) under bounds on inputs and states, or None if the solver fails."""
        size, states = self._size, len(lower) - self._size
        self._gradient[:size] = gradient
        self._lower[:size], self._upper[:size] = lower[:size], upper[:size]
        self._upper[size : size + states] = np.minimum(upper[size:], _FREE)
        self._lower[size + states : -1] = np.maximum(lower[size:], -_FREE)
        self._solver.update(q=self._gradient, l=self._lower, u=self._upper)
        start = self._active_set.optimum(self._gradient, self._lower, self._upper)
        if start is not None:
            optimum, multipliers = start
            self._solver.warm_start(x=optimum, y=multipliers)
        result = self._solver.solve(raise_error=False)
        solved = result.info.status == "solved" and np.isfinite(result.x).all()
        return np.asarray(result.x[:size], dtype=np.float64) if solved else None
