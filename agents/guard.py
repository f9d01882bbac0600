"""The guard: the last stage before the wire. It changes a setpoint as little as possible so that nothing is hit.

It knows no tactic and no plan. Its quadratic programme has two unknowns, the lead u of the setpoint before the vehicle:
minimise |u - u_wished|^2 under the demands of agents/barriers.py, which the plant makes linear in u,
`a = a0 u - a1 v + w`. What a demand takes from the wish is given back to the right: vehicles that meet head on go
around each other instead of standing there.
"""

from collections.abc import Sequence
from enum import Enum
from math import cos, hypot, pi

import msgspec
import numpy as np
import osqp
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from agents.barriers import Body, Cause, Demand, Pair, apart, inside, slow, unsure_m
from agents.fence import Fence
from agents.settings import AgentConfig
from agents.situation import Situation
from estimation.state import POSITION, VELOCITY, Vector

_FREE = 1e20
_KEPT = 1e-6
_SOLVED = 5e-3
_SIDES = 8
_ELASTIC_WEIGHT = 100.0
_EVADE_SHARE = 1.0
_CHANGED_M = 0.01
_LEVELS = (Cause.SPEED, Cause.KEEP_OUT, Cause.FENCE, Cause.SEPARATION)
ROWS_MAX = 64


class GuardStatus(Enum):
    """What the guard did with the wish."""

    PASSED = "passed"
    CHANGED = "changed"
    YIELDED = "yielded"
    BRAKED = "braked"


class Guarded(msgspec.Struct, frozen=True):
    """The setpoint (2,) to send, why it was changed if it was, and up to which cause the demands had to yield."""

    setpoint_m: Vector
    status: GuardStatus = GuardStatus.PASSED
    causes: tuple[Cause, ...] = ()
    yielded: Cause | None = None


class Guard:
    """Guards one vehicle's setpoints; remembers nothing that changes its answers."""

    def __init__(self, config: AgentConfig) -> None:
        self._safety = config.safety
        self._a0 = config.plant.a0_per_s2
        self._a1 = config.plant.a1_per_s
        self._fence = Fence(config.safety.fence_m) if config.safety.fence_m else None
        self._qp: _Qp | None = None

    def check(self, situation: Situation, wish_m: Vector, bodies: Sequence[Body]) -> Guarded:
        """Return the setpoint nearest to the wish (2,) that keeps what there is to keep."""
        position, velocity = situation.acting_motion[POSITION], situation.acting_motion[VELOCITY]
        lead = wish_m - position
        reached = self._reached(lead)
        broken = () if reached is lead else (Cause.REACH,)
        if self._safety.guard:
            drift = situation.disturbance - self._a1 * velocity
            rows = self._rows(situation, bodies, drift)
            if rows is not None and (rows.normals.dot(reached) < rows.least - _KEPT).any():
                return self._kept(position, lead, reached, rows, broken)
        return Guarded(position + reached, GuardStatus.CHANGED, broken) if broken else Guarded(wish_m)

    def altitude_m(self, wish_m: float) -> float:
        """Return the altitude nearest to the wish that is inside the band."""
        low, high = self._safety.altitude_min_m, self._safety.altitude_max_m
        wish_m = wish_m if high is None else min(wish_m, high)
        return wish_m if low is None else max(wish_m, low)

    def _kept(
        self, position: Vector, lead: Vector, reached: Vector, rows: "_Rows", broken: tuple[Cause, ...]
    ) -> Guarded:
        if self._qp is None:
            self._qp = _Qp(self._safety.setpoint_lead_max_m)
        kept, yielded = self._qp.nearest(reached + rows.evasion(reached), rows)
        status = GuardStatus.CHANGED if yielded is None else GuardStatus.YIELDED
        if kept is None:  # an unsolved problem must not fly: stop
            kept, status = np.zeros(2), GuardStatus.BRAKED
        if hypot(*(kept - lead).tolist()) < _CHANGED_M:
            return Guarded(position + kept)
        causes = sorted(
            {Cause(level) for level in rows.levels[rows.normals.dot(reached) < rows.least - _KEPT].tolist()}
        )
        return Guarded(position + kept, status, (*causes, *broken), yielded)

    def _reached(self, lead: Vector) -> Vector:
        """Keep the setpoint within the allowed lead of the vehicle: no estimate gone wrong may send it far away."""
        distance_m, limit_m = hypot(*lead.tolist()), self._safety.setpoint_lead_max_m
        return lead if distance_m <= limit_m else lead * (limit_m / distance_m)

    def _rows(self, situation: Situation, bodies: Sequence[Body], drift: Vector) -> "_Rows | None":
        """Return the demands on the lead, None if there are none."""
        demands, bounds = self._demands(situation, bodies)
        if not demands and not bounds:
            return None
        accelerations = np.array([demand.normal for demand in demands]).reshape(-1, 2)
        least = np.array([min(demand.least_m_s2, self._safety.acceleration_max_m_s2) for demand in demands])
        normals = np.vstack([accelerations * self._a0, np.array([bound[0] for bound in bounds]).reshape(-1, 2)])
        least = np.concatenate([least - accelerations.dot(drift), [bound[1] for bound in bounds]])
        levels = np.array([demand.cause for demand in demands] + [Cause.FENCE] * len(bounds))
        evades = np.array([demand.evades for demand in demands] + [False] * len(bounds))
        return _Rows(normals[:ROWS_MAX], least[:ROWS_MAX], levels[:ROWS_MAX], evades[:ROWS_MAX])

    def _demands(self, situation: Situation, bodies: Sequence[Body]) -> tuple[list[Demand], list[tuple[Pair, float]]]:
        safety = self._safety
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        place, velocity, rate = (x, y), (x_rate, y_rate), safety.barrier_rate_per_s
        demands = [apart(place, velocity, body, rate, Cause.SEPARATION) for body in bodies]
        demands += slow(velocity, safety.speed_max_m_s, rate)
        if safety.keep_out_m > 0.0 and situation.acting_target is not None and situation.target is not None:
            tx, ty, tx_rate, ty_rate = situation.acting_target.tolist()
            disc = Body((tx, ty), (tx_rate, ty_rate), (0.0, 0.0), safety.keep_out_m, shares=False)
            demands.append(apart(place, velocity, disc, rate, Cause.KEEP_OUT))
        bounds: list[tuple[Pair, float]] = []
        if self._fence is not None:
            margin_m = unsure_m(safety.uncertainty_sigmas, situation.position_sigma_m, 0.0)
            within_m = safety.setpoint_lead_max_m + margin_m
            demands += inside(self._fence, place, velocity, margin_m, rate, within_m + safety.speed_max_m_s)
            bounds = [
                (point.inward, margin_m - point.distance_m) for point in self._fence.nearest_points(place, within_m)
            ]
        return demands, bounds


class _Rows(msgspec.Struct, frozen=True):
    """Demands on the lead, `normals u >= least`: (m, 2), (m,), and for each its level and whether it is evaded (m,)."""

    normals: Vector
    least: Vector
    levels: "NDArray[np.int64]"
    evades: "NDArray[np.bool_]"

    def evasion(self, lead: Vector) -> Vector:
        """Return what to add to the wish so that it goes around on the right what is in its way."""
        missing = np.where(self.evades, np.maximum(self.least - self.normals.dot(lead), 0.0), 0.0)
        lengths = np.einsum("ij,ij->i", self.normals, self.normals)
        right = np.column_stack([-self.normals[:, 1], self.normals[:, 0]])  # of one that looks against the normal
        return np.asarray(_EVADE_SHARE * (missing / lengths).dot(right), dtype=np.float64)


class _Qp:
    """min |u - wanted|^2 under `normals u >= least` and a polygon in the reach; what is infeasible yields by level."""

    def __init__(self, reach_m: float) -> None:
        angles = 2.0 * pi / _SIDES * (np.arange(_SIDES) + 0.5)
        self._rows = np.zeros((ROWS_MAX + _SIDES, 3))
        self._rows[ROWS_MAX:, 0], self._rows[ROWS_MAX:, 1] = np.cos(angles), np.sin(angles)
        # Column by column, as OSQP keeps them; only the slack's column has no entry for the polygon.
        self._used = np.ones((3, ROWS_MAX + _SIDES), dtype=np.bool_)
        self._used[2, ROWS_MAX:] = False
        self._lower = np.full(ROWS_MAX + _SIDES, -_FREE)
        upper = np.full(ROWS_MAX + _SIDES, _FREE)
        upper[ROWS_MAX:] = reach_m * cos(pi / _SIDES)
        pattern = csc_matrix(self._used.T.astype(np.float64))
        self._gradient = np.zeros(3)
        self._solver = osqp.OSQP()
        self._solver.setup(
            csc_matrix(np.diag([1.0, 1.0, _ELASTIC_WEIGHT])),
            self._gradient,
            pattern,
            self._lower,
            upper,
            verbose=False,
            eps_abs=1e-4,
            eps_rel=1e-4,
            eps_prim_inf=1e-3,
            max_iter=1000,
            check_termination=10,
            # OSQP would otherwise time itself to choose this, and the same problem would have two answers.
            adaptive_rho_interval=10,
        )
        self._upper = upper

    def nearest(self, wanted: Vector, rows: _Rows) -> tuple[Vector | None, Cause | None]:
        """Return the lead, None if the solver fails, and the highest level that had to yield, None if none had to."""
        normals, least, levels = rows.normals, rows.least, rows.levels
        count = len(levels)
        self._rows[:ROWS_MAX] = 0.0
        self._rows[:count, :2] = normals
        self._gradient[:2] = -wanted
        for level in _LEVELS:
            self._rows[:count, 2] = levels == level
            self._lower[:ROWS_MAX] = -_FREE
            self._lower[:count] = np.where(levels >= level, least, -_FREE)
            self._solver.update(Ax=self._rows.T[self._used], q=self._gradient, l=self._lower, u=self._upper)
            result = self._solver.solve(raise_error=False)
            solution = np.asarray(result.x, dtype=np.float64)
            if np.isfinite(solution).all() and self._kept(solution):
                slack = (least - normals.dot(solution[:2]))[levels <= level]
                yields = slack.size > 0 and slack.max() > _SOLVED
                return solution[:2], level if yields else None
        return None, Cause.SEPARATION

    def _kept(self, solution: Vector) -> bool:
        values = self._rows.dot(solution)
        return bool(np.minimum(values - self._lower, self._upper - values).min() > -_SOLVED)
