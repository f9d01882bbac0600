"""A general solver as the reference for the exact one and the guard, and what OSQP returns when it fails."""

from math import inf
from types import SimpleNamespace

import numpy as np
from scipy.optimize import minimize

from estimation.state import Vector

UNSOLVED = SimpleNamespace(x=np.full(100, np.nan), info=SimpleNamespace(status="maximum iterations reached"))
"""A result of OSQP without a solution."""


def slsqp(wanted: Vector, radius: float, normals: Vector, least: Vector) -> Vector | None:
    """The nearest point by a general solver, from several starts."""
    constraints = [
        {"type": "ineq", "fun": lambda u: normals @ u - least, "jac": lambda u: normals},
        {"type": "ineq", "fun": lambda u: radius**2 - u @ u, "jac": lambda u: -2.0 * u},
    ]
    found: list[Vector] = []
    for start in (np.zeros(2), wanted, -wanted):
        result = minimize(
            lambda u: np.sum((u - wanted) ** 2),
            start,
            jac=lambda u: 2.0 * (u - wanted),
            constraints=constraints,
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 200},
        )
        missing = max((least - normals @ result.x).max(initial=-inf), np.linalg.norm(result.x) - radius)
        if missing < 1e-6:
            found.append(np.asarray(result.x))
    return min(found, key=lambda u: float(np.sum((u - wanted) ** 2))) if found else None
