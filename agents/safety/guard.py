"""The guard: the last stage before the setpoint. It changes aims as little as possible to keep them safe.

It is independent of tactic and plan. Its quadratic programme has two unknowns, the lead u of the aim ahead of the
vehicle: minimise |u - u_planned|^2 under the demands of agents/safety/barriers.py, which are linear in u with the plant
`a = a0 u - a1 v + w`. The reduction of the lead by a demand is added on the right-hand side, so that vehicles that meet
head on pass each other instead of stopping. Demands that cannot all be met are relaxed level by level.
"""

from collections.abc import Iterable, Sequence
from enum import Enum
from math import cos, hypot, inf, pi, sqrt
from typing import Final

import numpy as np

from agents.notes import GuardAction
from agents.safety.barriers import Body, Cause, Demand, apart, slow, unsure_m, within
from agents.safety.fence import Area, NearestPoint
from agents.safety.routes import ZONE_MARGIN_M
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from estimation.state import POSITION, Vector
from estimation.vectors import Pair, clipped_pair

_MET: Final = 1e-9
_PARALLEL: Final = 1e-12


class HalfPlane:
    """All points u with `normal . u >= least`; the normal has length one."""

    def __init__(self, normal: Pair, least: float) -> None:
        self.normal: Final = normal
        self.least: Final = least

    def missing(self, point: Pair) -> float:
        """Return the distance of a point from the half-plane, negative inside."""
        return self.least - self.normal[0] * point[0] - self.normal[1] * point[1]


def nearest(wanted: Pair, radius: float, planes: Sequence[HalfPlane]) -> Pair | None:
    """Return the point of all half-planes and of the disc about the origin that is nearest to `wanted`.

    None if they have no point in common. The planes are added one by one: if the point violates the next plane, the new
    point lies on that plane's edge. With m half-planes this takes m (m + 1) / 2 steps at most.
    """
    point = clipped_pair(wanted, radius)
    for index, plane in enumerate(planes):
        if plane.missing(point) > _MET:
            on_edge = _nearest_on_edge(wanted, radius, plane, planes[:index])
            if on_edge is None:
                return None
            point = on_edge
    return point


def _nearest_on_edge(wanted: Pair, radius: float, plane: HalfPlane, others: Iterable[HalfPlane]) -> Pair | None:
    """Return the point nearest to `wanted` on the edge of one half-plane, inside the disc and the other half-planes."""
    normal_x, normal_y = plane.normal
    half_chord2 = radius**2 - plane.least**2
    if half_chord2 < 0.0:
        return None
    high = sqrt(half_chord2)
    low = -high
    # Along the edge: from the point nearest to the origin, to the left of the normal.
    for other in others:
        across = normal_x * other.normal[1] - normal_y * other.normal[0]
        missing = other.least - plane.least * (normal_x * other.normal[0] + normal_y * other.normal[1])
        if abs(across) < _PARALLEL:
            low = inf if missing > _MET else low
        elif across > 0.0:
            low = max(low, missing / across)
        else:
            high = min(high, missing / across)
    if low > high:
        return None
    along = min(max(normal_x * wanted[1] - normal_y * wanted[0], low), high)
    return plane.least * normal_x - along * normal_y, plane.least * normal_y + along * normal_x


_FREE: Final = 1e20
_KEPT_M: Final = 1e-6
_SOLVED_M: Final = 5e-3
_SIDES: Final = 8
_ELASTIC_WEIGHT: Final = 100.0
_EVADE_SHARE: Final = 1.0
_CHANGED_M: Final = 0.01
_BOUNDARIES = (Cause.FENCE, Cause.NO_FLY)
_OF_BOUNDARIES = 4.0 / 3.0
"""By how much the margin at a boundary is larger: 4 standard deviations are exceeded in one direction in one case of
30000. Two vehicles have margins that add up, and see each other come nearer; a boundary shows nothing of an error.
"""
_CLOSED_WITHIN_M = ZONE_MARGIN_M / 2.0
"""A zone is closed for a vehicle that is less than this above or below it."""
ROWS_MAX: Final = 32
"""The number of demands in the relaxed problem: those that the planned aim violates most."""


class GuardStatus(Enum):
    """The guard's effect on the planned aim."""

    PASSED = "passed"
    CHANGED = "changed"
    YIELDED = "yielded"
    BRAKED = "braked"


class Guarded:
    """The guarded aim (2,), the causes of a change, the highest cause that was relaxed, and the vehicles evaded."""

    def __init__(
        self,
        aim_m: Vector,
        status: GuardStatus = GuardStatus.PASSED,
        causes: tuple[Cause, ...] = (),
        yielded: Cause | None = None,
        evaded: tuple[int, ...] = (),
    ) -> None:
        self.aim_m: Final = aim_m
        self.status: Final = status
        self.causes: Final = causes
        self.yielded: Final = yielded
        self.evaded: Final = evaded


class _Row:
    """A demand as a half-plane of the lead, in metres."""

    def __init__(self, plane: HalfPlane, cause: Cause, evades: bool = False, vehicle_id: int = 0) -> None:
        self.plane: Final = plane
        self.cause: Final = cause
        self.evades: Final = evades
        self.vehicle_id: Final = vehicle_id


class Guard:
    """Guards one vehicle's aims; its results depend on the inputs only."""

    def __init__(self, config: AgentConfig) -> None:
        safety = self._safety = config.safety
        # Read in every tick: as a machine number each costs a tenth of a setting.
        self._guards, self._lead_max_m = safety.guard, safety.setpoint_lead_max_m
        self._low_m, self._high_m = safety.altitude_min_m, safety.altitude_max_m
        self._axes = (config.plant.x, config.plant.y)
        self._area = Area(config.safety)
        self._qp: _ElasticQp | None = None

    def check(
        self, situation: Situation, aim_m: Vector, bodies: Sequence[Body], traffic: Sequence[Body] = ()
    ) -> Guarded:
        """Return the aim nearest to `aim_m` (2,) that meets all demands: apart from own `bodies` and from `traffic`."""
        x, y, _, _ = situation.acting_motion.tolist()
        aim_x, aim_y = aim_m.tolist()
        lead = (aim_x - x, aim_y - y)
        reached = self._reached(lead)
        rows = self._rows(situation, bodies, traffic, reached) if self._guards else []
        missed = [row for row in rows if row.plane.missing(reached) > _KEPT_M]
        if missed:
            return self._kept(situation, lead, reached, rows, missed, bodies)
        if reached == lead:
            return Guarded(aim_m)
        return self._guarded(situation.acting_motion[POSITION], lead, reached, [], None)

    def altitude_m(self, planned_m: float, motion: Vector, height_m: float) -> float:
        """Return the altitude nearest to `planned_m` within the limits, above or below zones at a motion (4,)."""
        if self._area.zones and self._guards:
            planned_m = self._passing_m(planned_m, motion, height_m)
        low, high = self._low_m, self._high_m
        planned_m = planned_m if high is None else min(planned_m, high)
        return planned_m if low is None else max(planned_m, low)

    def _passing_m(self, planned_m: float, motion: Vector, height_m: float) -> float:
        """Return the altitude nearest to `planned_m` that leads into no zone from above or below."""
        x, y, x_rate, y_rate = motion.tolist()
        near_m = ZONE_MARGIN_M + hypot(x_rate, y_rate) / self._safety.barrier_rate_per_s
        for zone in self._area.zones:
            if zone.boundary.clearance_m((x, y)) < near_m:
                planned_m = zone.height_m(planned_m, height_m, ZONE_MARGIN_M)
        return planned_m

    def _kept(
        self,
        situation: Situation,
        lead: Pair,
        reached: Pair,
        rows: Sequence[_Row],
        missed: Sequence[_Row],
        bodies: Sequence[Body],
    ) -> Guarded:
        position, wanted = situation.acting_motion[POSITION], _evading(reached, missed)
        kept = nearest(wanted, self._lead_max_m, [row.plane for row in rows])
        if kept is not None:
            return self._guarded(position, lead, kept, missed, None)
        if self._qp is None:
            self._qp = _ElasticQp(self._lead_max_m)
        if any(row.cause in _BOUNDARIES for row in rows):
            rows = self._with_margins(situation, rows, bodies)
        worst = sorted(rows, key=lambda row: -row.plane.missing(wanted))[:ROWS_MAX]
        kept, yielded = self._qp.nearest(wanted, worst)
        if kept is None:  # the solver failed: stop
            return self._guarded(position, lead, (0.0, 0.0), missed, yielded, GuardStatus.BRAKED)
        return self._guarded(position, lead, self._reached(kept), missed, yielded)

    def _guarded(
        self,
        position: Vector,
        lead: Pair,
        kept: Pair,
        missed: Sequence[_Row],
        yielded: Cause | None,
        status: GuardStatus | None = None,
    ) -> Guarded:
        aim = position + kept
        status = status or (GuardStatus.CHANGED if yielded is None else GuardStatus.YIELDED)
        if status is GuardStatus.CHANGED and hypot(kept[0] - lead[0], kept[1] - lead[1]) < _CHANGED_M:
            return Guarded(aim)
        causes = {row.cause for row in missed}
        if hypot(*lead) > self._lead_max_m:
            causes.add(Cause.REACH)
        evaded = tuple(sorted({row.vehicle_id for row in missed if row.vehicle_id}))
        return Guarded(aim, status, tuple(sorted(causes)), yielded, evaded)

    def _reached(self, lead: Pair) -> Pair:
        """Limit the lead of the aim: a wrong estimate must not send the vehicle far away."""
        return clipped_pair(lead, self._lead_max_m)

    def _rows(self, situation: Situation, bodies: Sequence[Body], traffic: Sequence[Body], lead: Pair) -> list[_Row]:
        """Return the half-planes of the lead; none if this lead meets all demands, which is the usual case."""
        safety = self._safety
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        place, velocity, rate = (x, y), (x_rate, y_rate), safety.barrier_rate_per_s
        demands = [apart(place, velocity, body, rate, Cause.SEPARATION) for body in bodies]
        demands += [apart(place, velocity, each, rate, Cause.TRAFFIC) for each in traffic]
        demands += slow(velocity, safety.speed_max_m_s, rate)
        if safety.keep_out_m > 0.0:
            own = situation.acting_target
            for target in [*([] if own is None else [own]), *situation.acting_others.values()]:
                tx, ty, tx_rate, ty_rate = target.tolist()
                disc = Body((tx, ty), (tx_rate, ty_rate), (0.0, 0.0), safety.keep_out_m, shares=False)
                demands.append(apart(place, velocity, disc, rate, Cause.KEEP_OUT))
        bounds: list[_Row] = []
        if self._area.fence is not None or self._area.zones:
            margin_m = _OF_BOUNDARIES * unsure_m(safety.uncertainty_sigmas, situation.boundary_sigma_m, 0.0)
            within_m = self._lead_max_m + margin_m
            for points, cause in self._nearest(place, situation.height_m, within_m + safety.speed_max_m_s):
                demands += within(points, velocity, margin_m, rate, cause)
                # The aim stays there as well: a vehicle whose agent stops sending flies to it and stops.
                bounds += [
                    _Row(HalfPlane(point.inward, margin_m - point.distance_m), cause)
                    for point in points
                    if point.distance_m <= within_m
                ]
        drift = self._drift(situation)
        answer = self._axes[0].a0_per_s2 * lead[0] + drift[0], self._axes[1].a0_per_s2 * lead[1] + drift[1]
        if not bounds and all(demand.met_by(answer) for demand in demands):
            return []
        return [self._row(demand, drift) for demand in demands] + bounds

    def _with_margins(self, situation: Situation, rows: Sequence[_Row], bodies: Sequence[Body]) -> list[_Row]:
        """Return the rows with those of vehicles that evade as margins, and rows that keep `separation_m` from them."""
        shares, drift = {body.vehicle_id for body in bodies if body.shares}, self._drift(situation)
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        rate_per_s, separation_m = self._safety.barrier_rate_per_s, self._safety.separation_m
        found = [
            _Row(row.plane, Cause.MARGIN, row.evades, row.vehicle_id)
            if row.cause is Cause.SEPARATION and row.vehicle_id in shares
            else row
            for row in rows
        ]
        for body in bodies:
            if body.shares:
                kept = body.nearer(separation_m)
                found.append(self._row(apart((x, y), (x_rate, y_rate), kept, rate_per_s, Cause.SEPARATION), drift))
        return found

    def _drift(self, situation: Situation) -> Pair:
        """Return the acceleration of a vehicle whose aim is where it is."""
        _, _, x_rate, y_rate = situation.acting_motion.tolist()
        w_x, w_y = situation.disturbance.tolist()
        return w_x - self._axes[0].a1_per_s * x_rate, w_y - self._axes[1].a1_per_s * y_rate

    def _nearest(self, place: Pair, height_m: float, within_m: float) -> list[tuple[list[NearestPoint], Cause]]:
        """Return the nearest points of the fence, and of each zone that is closed about a height."""
        area, found = self._area, list[tuple[list[NearestPoint], Cause]]()
        if area.fence is not None:
            found.append((area.fence.nearest_points(place, within_m), Cause.FENCE))
        for zone in area.zones:
            if zone.overlaps(height_m - _CLOSED_WITHIN_M, height_m + _CLOSED_WITHIN_M):
                found.append((zone.boundary.nearest_points(place, within_m), Cause.NO_FLY))
        return found

    def _row(self, demand: Demand, drift: Pair) -> _Row:
        """Return the half-plane of the lead for a demanded acceleration, with `a = a0 u + drift`."""
        normal_x, normal_y = demand.normal
        least_m_s2 = min(demand.least_m_s2, self._safety.acceleration_max_m_s2)
        pull_x, pull_y = normal_x * self._axes[0].a0_per_s2, normal_y * self._axes[1].a0_per_s2
        pull = hypot(pull_x, pull_y)
        least_m = (least_m_s2 - normal_x * drift[0] - normal_y * drift[1]) / pull
        plane = HalfPlane((pull_x / pull, pull_y / pull), least_m)
        return _Row(plane, demand.cause, demand.evades, demand.vehicle_id)


def _evading(lead: Pair, missed: Sequence[_Row]) -> Pair:
    """Return the lead shifted to the right of what is in its way."""
    x, y = lead
    for row in missed:
        if row.evades:
            aside_m = _EVADE_SHARE * row.plane.missing(lead)
            # To the right when looking against the normal.
            x, y = x - aside_m * row.plane.normal[1], y + aside_m * row.plane.normal[0]
    return x, y


class _ElasticQp:
    """min |u - wanted|^2 in a polygon within the reach, with demands that are relaxed by level."""

    def __init__(self, reach_m: float) -> None:
        self._reach_m = reach_m
        angles = 2.0 * pi / _SIDES * (np.arange(_SIDES) + 0.5)
        self._rows = np.zeros((ROWS_MAX + _SIDES, 3))
        self._rows[ROWS_MAX:, 0], self._rows[ROWS_MAX:, 1] = np.cos(angles), np.sin(angles)
        # Column by column, as OSQP stores them; the slack's column has no entries for the polygon.
        self._used = np.ones((3, ROWS_MAX + _SIDES), dtype=np.bool_)
        self._used[2, ROWS_MAX:] = False
        self._lower = np.full(ROWS_MAX + _SIDES, -_FREE)
        self._upper = np.full(ROWS_MAX + _SIDES, _FREE)
        self._upper[ROWS_MAX:] = reach_m * cos(pi / _SIDES)
        self._gradient = np.zeros(3)
        from osqp import OSQP  # noqa: PLC0415 - slow to import, and many processes never solve
        from scipy.sparse import csc_matrix  # noqa: PLC0415

        self._solver = OSQP()
        self._solver.setup(
            csc_matrix(np.diag([1.0, 1.0, _ELASTIC_WEIGHT])),
            self._gradient,
            csc_matrix(self._used.T.astype(np.float64)),
            self._lower,
            self._upper,
            verbose=False,
            eps_abs=1e-4,
            eps_rel=1e-4,
            eps_prim_inf=1e-3,
            max_iter=1000,
            check_termination=10,
            # By default OSQP chooses this from measured time, which makes results irreproducible.
            adaptive_rho_interval=10,
        )

    def nearest(self, wanted: Pair, rows: Sequence[_Row]) -> tuple[Pair | None, Cause]:
        """Return the lead, None if the solver fails, and the highest level that was relaxed."""
        count = len(rows)
        normals = np.array([row.plane.normal for row in rows])
        least, levels = np.array([row.plane.least for row in rows]), np.array([row.cause for row in rows])
        self._rows[:ROWS_MAX] = 0.0
        self._rows[:count, :2] = normals
        self._gradient[:2] = -wanted[0], -wanted[1]
        for level in sorted({row.cause for row in rows}):
            if nearest(wanted, self._reach_m, [row.plane for row in rows if row.cause > level]) is None:
                continue  # a higher level has to be relaxed
            self._rows[:count, 2] = levels == level
            self._lower[:ROWS_MAX] = -_FREE
            self._lower[:count] = np.where(levels >= level, least, -_FREE)
            self._solver.update(Ax=self._rows.T[self._used], q=self._gradient, l=self._lower, u=self._upper)
            solution = np.asarray(self._solver.solve(raise_error=False).x, dtype=np.float64)
            if np.isfinite(solution).all() and self._kept(solution):
                x, y, _ = solution.tolist()
                return (x, y), level
        return None, Cause.SEPARATION

    def _kept(self, solution: Vector) -> bool:
        values = self._rows.dot(solution)
        return bool(np.minimum(values - self._lower, self._upper - values).min() > -_SOLVED_M)


QUIET_S: Final = 5.0
"""After this long without an intervention the next one is reported again."""
BENT_M: Final = 0.5
BENT_FOR_S: Final = 3.0
STRAIGHT_AFTER_S: Final = 1.0
"""An aim is bent if it is moved by so much; on the way it is shown after so long, and until so long after the end."""
_ON_THE_WAY = (Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT, Tactic.EXCITE, Tactic.RETURN_AND_LAND)
"""In these tactics vehicles pass each other: a short evasion belongs to them."""
_EVASIONS = (Cause.SEPARATION, Cause.FENCE, Cause.NO_FLY, Cause.TRAFFIC, Cause.KEEP_OUT)
"""What leads a vehicle elsewhere than planned; the other causes only slow it down."""


class Interventions:
    """Monitors one vehicle's guard: the last intervention, and the aim that it keeps bending."""

    def __init__(self) -> None:
        self._last_s = -inf
        self._bent_since_s = self._bent_s = -inf
        self._bent: GuardAction | None = None

    def news(self, now_s: float, aim_m: Vector, guarded: Guarded) -> tuple[GuardAction, str] | None:
        """Return the action, and the change of the planned aim (2,) as text; None if there is nothing new."""
        if not guarded.causes:
            return None
        quiet_s, self._last_s = now_s - self._last_s, now_s
        (x, y), moved_m = aim_m.tolist(), hypot(*(guarded.aim_m - aim_m).tolist())
        evasions = tuple([cause.words for cause in guarded.causes if cause in _EVASIONS])
        if evasions and moved_m >= BENT_M:
            if now_s - self._bent_s > STRAIGHT_AFTER_S:
                self._bent_since_s = now_s
            self._bent_s, self._bent = now_s, GuardAction(evasions, guarded.evaded)
        if quiet_s <= QUIET_S:
            return None
        action = GuardAction(tuple([cause.words for cause in guarded.causes]), guarded.evaded)
        return action, f"the planned aim ({x:.2f}, {y:.2f}) m was moved by {moved_m:.2f} m"

    def lasting(self, now_s: float, tactic: Tactic) -> GuardAction | None:
        """Return why the aim is bent at present, None if it is not, or on the way only for a moment."""
        if now_s - self._bent_s > STRAIGHT_AFTER_S:
            return None
        return None if tactic in _ON_THE_WAY and self._bent_s - self._bent_since_s < BENT_FOR_S else self._bent
