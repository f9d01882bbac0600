"""The solvers that planner_rivals.py uses in place of cordon's LMPC; the extra `rivals` installs their modules.

Each has the arguments of `Lmpc.solve` and is formulated as in its library's documentation: stage by stage, not with
cordon's condensed matrices. The bounds on states are soft by one slack, as in `Lmpc`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from agents.control.lmpc import Bounds, QpStatus, Solution, Solver
from agents.settings.sections import EncirclementSettings
from estimation.state import Vector

SLACK_WEIGHT = 100.0
"""As in agents/control/encirclement.py."""
OSQP_TOLERANCE = 1e-6
"""With 1e-5, as in agents/control/lmpc.py, OSQP is up to 7e-3 m/s² off the optimum in this form, and no faster."""
OPTIMUM_TOLERANCE = 1e-10
QRQP_ITERATIONS_MAX = 100
"""If qrqp solves the problem, it does so within these iterations. Its default of 1000 only takes longer."""


@dataclass(frozen=True)
class Rival:
    """A solver to compare with: the module that it needs, and its set-up."""

    name: str
    module: str
    build: Callable[[EncirclementSettings], Solver]
    nonlinear: bool = False


def unsolved(previous_input: Vector) -> Solution:
    """Return the plan after a failed solve: the previous input continues."""
    return Solution(previous_input.reshape(1, -1), QpStatus.FALLBACK)


class RingProblem:
    """(23) to (26) in [r R phi r' R phi'] with inputs [r'' R phi'']: model, and diagonals of both weights."""

    def __init__(self, settings: EncirclementSettings) -> None:
        step_s, along_m = settings.prediction_step_s, settings.radius_m
        self.horizon, self.control_horizon = settings.horizon, settings.control_horizon
        self.transition = np.array([[1, 0, step_s, 0], [0, 1, 0, step_s], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=float)
        half = step_s**2 / 2.0
        self.input_gain = np.array([[half, 0.0], [0.0, half], [step_s, 0.0], [0.0, step_s]])
        spacing_weight = settings.lag_weight + settings.lead_weight
        self.state_weights = np.array(
            [settings.radius_weight, spacing_weight / along_m**2, 0.0, settings.rate_weight / along_m**2]
        )
        self.increment_weights = np.array(
            [settings.radial_increment_weight, settings.angular_increment_weight / along_m**2]
        )


class CvxpySolver:
    """The problem stage by stage with parameters (DPP), for a solver of cvxpy."""

    def __init__(self, settings: EncirclementSettings, **options: Any) -> None:
        cp: Any = import_module("cvxpy")
        problem = RingProblem(settings)
        horizon, held = problem.horizon, problem.control_horizon - 1
        states, self._inputs = cp.Variable((horizon + 1, 4)), cp.Variable((held + 1, 2))
        slack = cp.Variable(nonneg=True)
        self._state, self._reference, self._previous = cp.Parameter(4), cp.Parameter((horizon, 4)), cp.Parameter(2)
        self._least, self._most = cp.Parameter(2), cp.Parameter(2)
        self._lowest, self._highest = cp.Parameter((horizon, 3)), cp.Parameter((horizon, 3))
        errors = (states[1:] - self._reference) @ np.diag(np.sqrt(problem.state_weights))
        before = cp.vstack([cp.reshape(self._previous, (1, 2), order="C"), self._inputs[:-1]])
        increments = (self._inputs - before) @ np.diag(np.sqrt(problem.increment_weights))
        cost = cp.sum_squares(errors) + cp.sum_squares(increments)
        cost += SLACK_WEIGHT * (slack + cp.square(slack) / 2.0)
        constraints = [states[0] == self._state]
        for step in range(horizon):
            input_now = self._inputs[min(step, held)]
            constraints.append(
                states[step + 1] == problem.transition @ states[step] + problem.input_gain @ input_now,
            )
        constraints += [row >= self._least for row in self._inputs]
        constraints += [row <= self._most for row in self._inputs]
        constraints += [states[1:, 1:] - slack <= self._highest, states[1:, 1:] + slack >= self._lowest]
        self._problem = cp.Problem(cp.Minimize(cost), constraints)
        self._solved = {cp.OPTIMAL}
        self._options = options

    def solve(self, state: Vector, reference: Vector, previous_input: Vector, bounds: Bounds) -> Solution:
        """See `Lmpc.solve`."""
        self._state.value, self._reference.value, self._previous.value = state, reference, previous_input
        self._least.value, self._most.value = bounds.inputs
        self._lowest.value, self._highest.value = bounds.states
        self._problem.solve(**self._options)
        if self._problem.status in self._solved:
            return Solution(self._inputs.value.copy(), QpStatus.BOUNDED)
        return unsolved(previous_input)


def cvxpy_osqp(settings: EncirclementSettings) -> CvxpySolver:
    """Return the rival: OSQP, which starts warm."""
    return CvxpySolver(settings, solver="OSQP", warm_start=True, eps_abs=OSQP_TOLERANCE, eps_rel=OSQP_TOLERANCE)


def optimum(settings: EncirclementSettings) -> CvxpySolver:
    """Return the reference: Clarabel, an interior-point method, with high accuracy."""
    digits = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), OPTIMUM_TOLERANCE)
    return CvxpySolver(settings, solver="CLARABEL", **digits)


class QrqpSolver:
    """The problem unrolled symbolically from the state; its matrices are derivatives.

    qrqp starts cold: with its previous multipliers it is a quarter faster, but fails more often, and reports more wrong
    plans as solved.
    """

    def __init__(self, settings: EncirclementSettings) -> None:
        ca: Any = import_module("casadi")
        problem = RingProblem(settings)
        size = 2 * problem.control_horizon
        given = ca.SX.sym("given", 4 + 4 * problem.horizon + 2)
        decision = ca.SX.sym("decision", size + 1)
        cost, rows = _rolled_out(ca, problem, given, decision)
        nothing = ca.DM.zeros(size + 1)
        hessian, _ = ca.hessian(cost, decision)
        slope, offset = ca.substitute([ca.gradient(cost, decision), rows], [decision], [nothing])
        self._terms = ca.Function("terms", [given], [slope, offset])
        constant = ca.Function("constant", [], [hessian, ca.jacobian(rows, decision)])
        self._hessian, self._rows = constant()["o0"], constant()["o1"]
        options = dict.fromkeys(("print_iter", "print_header", "print_info", "error_on_fail"), False)
        structure = {"h": self._hessian.sparsity(), "a": self._rows.sparsity()}
        self._conic = ca.conic("ring", "qrqp", structure, options | {"max_iter": QRQP_ITERATIONS_MAX})
        self._size, self._control_horizon = size, problem.control_horizon

    def solve(self, state: Vector, reference: Vector, previous_input: Vector, bounds: Bounds) -> Solution:
        """See `Lmpc.solve`."""
        slope, offset = self._terms(np.concatenate([state, reference.ravel(), previous_input]))
        drift = offset.full().ravel()
        beyond = np.full(len(drift) // 2, np.inf)
        least, most = bounds.inputs
        lowest, highest = bounds.states
        found = self._conic(
            h=self._hessian,
            g=slope,
            a=self._rows,
            lba=np.concatenate([-beyond, lowest.ravel()]) - drift,
            uba=np.concatenate([highest.ravel(), beyond]) - drift,
            lbx=np.append(np.tile(least, self._control_horizon), 0.0),
            ubx=np.append(np.tile(most, self._control_horizon), np.inf),
        )
        if not self._conic.stats()["success"]:
            return unsolved(previous_input)
        return Solution(found["x"].full().ravel()[: self._size].reshape(-1, 2), QpStatus.BOUNDED)


def _rolled_out(ca: Any, problem: RingProblem, given: Any, decision: Any) -> tuple[Any, Any]:
    """Return the cost, and the rows with a bound above followed by those with a bound below."""
    state, previous, slack = given[:4], given[-2:], decision[-1]
    cost = SLACK_WEIGHT * (slack + slack**2 / 2.0)
    above, below = [], []
    for step in range(problem.horizon):
        held = 2 * min(step, problem.control_horizon - 1)
        now = decision[held : held + 2]
        increment = now - previous
        cost += ca.dot(problem.increment_weights, increment**2)
        state = ca.mtimes(ca.DM(problem.transition), state) + ca.mtimes(ca.DM(problem.input_gain), now)
        error = state - given[4 + 4 * step : 8 + 4 * step]
        cost += ca.dot(problem.state_weights, error**2)
        above.append(state[1:] - slack)
        below.append(state[1:] + slack)
        previous = now
    return cost, ca.vertcat(*above, *below)


class DoMpcSolver:
    """The nonlinear polar model with IPOPT; the inputs are the accelerations along and across the radius.

    do-mpc has no control horizon, so there is an input for each sample; bounds on states apply from the present sample
    on, each with its own slack. It starts from its previous solution.
    """

    def __init__(self, settings: EncirclementSettings) -> None:
        do_mpc: Any = import_module("do_mpc")
        self._along_m, self._horizon = settings.radius_m, settings.horizon
        self._mpc = do_mpc.controller.MPC(_polar_model(do_mpc))
        self._mpc.settings.n_horizon = settings.horizon
        self._mpc.settings.t_step = settings.prediction_step_s
        self._mpc.settings.store_solver_stats = []
        self._mpc.settings.store_lagr_multiplier = False
        self._mpc.settings.supress_ipopt_output()
        self._ask(settings)
        self._varying = self._mpc.get_tvp_template()
        self._mpc.set_tvp_fun(lambda _now_s: self._varying)
        self._mpc.setup()

    def _ask(self, settings: EncirclementSettings) -> None:
        mpc, model = self._mpc, self._mpc.model
        radius, bearing, radial_rate, rate = (model.x[name] for name in ("radius", "bearing", "radial_rate", "rate"))
        spacing_weight = settings.lag_weight + settings.lead_weight
        cost = settings.radius_weight * (radius - model.tvp["radius_wanted"]) ** 2
        cost += spacing_weight * (bearing - model.tvp["bearing_wanted"]) ** 2
        cost += settings.rate_weight * (rate - model.tvp["rate_wanted"]) ** 2
        mpc.set_objective(lterm=cost, mterm=cost)
        mpc.set_rterm(
            outward=settings.radial_increment_weight,
            sideways=settings.angular_increment_weight / settings.radius_m**2,
        )
        for name in ("outward", "sideways"):
            mpc.bounds["lower", "_u", name] = -settings.acceleration_max_m_s2
            mpc.bounds["upper", "_u", name] = settings.acceleration_max_m_s2
        fastest_m_s, metres = settings.speed_max_m_s, settings.radius_m
        for name, too_much in (
            ("outwards", radial_rate - fastest_m_s),
            ("inwards", -radial_rate - fastest_m_s),
            ("along", radius * rate - fastest_m_s),
            ("against", -radius * rate - fastest_m_s),
            ("ahead", metres * (bearing - model.tvp["bearing_max"])),
            ("behind", metres * (model.tvp["bearing_min"] - bearing)),
        ):
            mpc.set_nl_cons(name, too_much, ub=0.0, soft_constraint=True, penalty_term_cons=SLACK_WEIGHT)

    def solve(self, state: Vector, reference: Vector, previous_input: Vector, bounds: Bounds) -> Solution:
        """See `Lmpc.solve`."""
        radius, _, radial_rate, rate = present = state / np.array([1.0, self._along_m, 1.0, self._along_m])
        wanted = np.column_stack([reference[:, [0, 1, 3]], *bounds.states[..., 0]])
        wanted[:, 1:] /= self._along_m
        for sample, row in enumerate([wanted[0], *wanted]):
            self._varying["_tvp", sample] = row
        if not previous_input.any():  # the vehicle comes from another tactic
            self._begin(present)
        outward, sideways = self._mpc.make_step(present.reshape(-1, 1)).ravel()
        if not self._mpc.solver_stats["success"]:
            return unsolved(previous_input)
        polar = outward + radius * rate**2, self._along_m * (sideways - 2.0 * radial_rate * rate) / radius
        return Solution(np.array([polar]), QpStatus.BOUNDED)

    def _begin(self, present: Vector) -> None:
        self._mpc.reset_history()
        self._mpc.x0, self._mpc.u0 = present, np.zeros(2)
        self._mpc.set_initial_guess()


def _polar_model(do_mpc: Any) -> Any:
    """Return (4), (5) about a target that does not accelerate."""
    model = do_mpc.model.Model("continuous")
    radius, _, radial_rate, rate = (
        model.set_variable("_x", name) for name in ("radius", "bearing", "radial_rate", "rate")
    )
    outward, sideways = model.set_variable("_u", "outward"), model.set_variable("_u", "sideways")
    for name in ("radius_wanted", "bearing_wanted", "rate_wanted", "bearing_min", "bearing_max"):
        model.set_variable("_tvp", name)
    model.set_rhs("radius", radial_rate)
    model.set_rhs("bearing", rate)
    model.set_rhs("radial_rate", outward + radius * rate**2)
    model.set_rhs("rate", (sideways - 2.0 * radial_rate * rate) / radius)
    model.setup()
    return model


RIVALS = (
    Rival("CasADi qrqp", "casadi", QrqpSolver),
    Rival("cvxpy, OSQP", "cvxpy", cvxpy_osqp),
    Rival("do-mpc, IPOPT", "do_mpc", DoMpcSolver, nonlinear=True),
)
OPTIMUM = Rival("Clarabel", "cvxpy", optimum)
"""The reference solver."""
