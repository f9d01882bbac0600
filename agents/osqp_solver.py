"""OSQP, set up once for a problem whose vectors change."""

from typing import Any

import numpy as np

from estimation.state import Vector


def osqp_solver(cost: Vector, gradient: Vector, rows: Vector, lower: Vector, upper: Vector, **settings: float) -> Any:
    """Return an `osqp.OSQP` that minimises x' P x / 2 + q' x for l <= A x <= u.

    P (n, n), of which the upper triangle is read, q (n,), A (k, n), l and u (k,), and settings of OSQP.
    """
    # With scipy these take 0.3 s to import: a process that solves nothing, such as the log's, does without.
    from osqp import OSQP  # noqa: PLC0415
    from scipy.sparse import csc_matrix  # noqa: PLC0415

    solver = OSQP()
    solver.setup(
        csc_matrix(np.triu(cost)),
        gradient,
        csc_matrix(rows),
        lower,
        upper,
        verbose=False,
        **settings,
    )
    return solver
