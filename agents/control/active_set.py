"""The active set of a small quadratic programme. Its optimum is the starting point of OSQP.

From a cold start OSQP takes hundreds of iterations where several bounds on states are active, whatever the scaling
(docs/notes/control.md). With the active set known, the optimum solves a few linear equations.

The dual of  min x' P x / 2 + q' x,  G x <= b  is  min y' K y / 2 + d' y,  y >= 0,  with  K = G P^-1 G'  and the slack
d = b + G P^-1 q  of the bounds at the unbounded optimum. It is solved by Lawson and Hanson's algorithm for non-negative
least squares: the bound that is exceeded most becomes active, and one whose multiplier turns negative leaves.
"""

from collections.abc import Sequence

import numpy as np

from estimation.state import Vector

_EXCESS_MAX = 1e-9
_RIDGE = 1e-12
"""Added to the diagonal of K, which is 1: dependent bounds then have unique multipliers, and some of them leave."""
_CHANGES_MAX = 50
_ZERO = np.zeros(1)


class ActiveSet:
    """Finds which of the bounds on `rows` (m, n) are active, at a cost with a positive definite Hessian (n, n)."""

    def __init__(self, hessian: Vector, rows: Vector) -> None:
        sides = np.vstack([rows, -rows])  # on each row an upper and a lower bound
        self._inverse: Vector = np.asarray(np.linalg.inv(hessian), dtype=np.float64)
        self._scale: Vector = ((sides @ self._inverse) * sides).sum(axis=1) ** -0.5
        sides = self._scale[:, np.newaxis] * sides
        self._responses: Vector = np.asarray(sides @ self._inverse, dtype=np.float64)
        self._coupling: Vector = self._responses @ sides.T + _RIDGE * np.eye(len(sides))
        self._active: list[int] = []

    def optimum(self, gradient: Vector, lower: Vector, upper: Vector) -> tuple[Vector, Vector] | None:
        """Return the optimum (n,) and the multipliers (m,), positive on upper bounds and negative on lower ones.

        The search begins at the active set found last. None if it exceeds its limit of steps.
        """
        room = np.concatenate((upper, -lower)) * self._scale + self._responses.dot(gradient)
        multipliers = self._multipliers(room)
        if multipliers is None:
            return None
        active = self._active
        optimum = -self._inverse.dot(gradient) - multipliers.dot(self._responses[active])
        by_side = np.zeros(len(room))
        by_side[active] = multipliers * self._scale[active]
        above, below = by_side.reshape(2, -1)
        return optimum, above - below

    def _multipliers(self, room: Vector) -> Vector | None:
        """Return the multipliers of the active bounds once no bound is exceeded; `room` is (2 m,)."""
        multipliers = self._stationary(room)
        while multipliers.size and multipliers.min() < 0.0:
            self._keep((multipliers >= 0.0).tolist())
            multipliers = self._stationary(room)
        for _ in range(_CHANGES_MAX):
            left = room + multipliers.dot(self._coupling[self._active])
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
        coupling = self._coupling.take(active, axis=0).take(active, axis=1)
        return np.asarray(-np.linalg.solve(coupling, room.take(active)), dtype=np.float64)
