"""Encirclement: the plan against the paper's cost (24) written out; the loop closed on a plant not the planner's."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi, tau
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from agents.control.encirclement import Approach, EncirclementPlan, EncirclementPlanner, RingTask
from agents.control.lmpc import QpStatus
from agents.ring.commanded_ring import Orbit
from agents.ring.detour import MARGIN_M, Obstacle
from agents.ring.joining import Joining
from agents.ring.place import RingPlace, place_errors_rad, ring_place
from agents.ring.reference import RingPoint, RingReference, RingWay
from agents.ring.transition import ShapedCoordinate
from agents.settings.config import AgentConfig
from estimation.filters.own import OwnFilter
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.polar import Polar, motion_from_polar, polar_from_motion
from estimation.state import DISTURBANCE, MOTION, Telemetry, Vector

Maker = Callable[..., AgentConfig]

TARGET = np.array([35.0, -5.0, 0.1, 0.05])
PERTURBED = Plant(PlantAxis(0.80 * 1.15, 0.87 * 0.9), PlantAxis(0.80 * 0.9, 0.87 * 1.1))
WIND = np.array([0.15, -0.1])
STILL = np.zeros(2)
FAR_OUT = Polar(50.0, 0.0, 0.0, 0.0)
PERIOD_S = 0.1


def ring_task(
    config: AgentConfig, motion: Vector, target: Vector, wind: Vector, place: RingPlace, **changes: Any
) -> RingTask:
    """The task to fly the mission's ring with a reference abeam, but for the changes."""
    ring, polar = config.encirclement, polar_from_motion(motion, target)
    orbit = changes.pop("orbit", Orbit(ring.radius_m, ring.angular_rate_rad_s))
    radius_m = changes.pop("radius_m", None) or orbit.radius_m
    reference = changes.pop("reference", None) or abeam(polar, radius_m, orbit.angular_rate_rad_s)
    rate_rad_s = orbit.angular_rate_rad_s
    beside = None
    if place.lead_rad is not None and place.lag_rad is not None:
        beside = (place.lag_rad, rate_rad_s), (place.lead_rad, rate_rad_s)
    return RingTask(motion, target, polar, wind, beside, orbit, radius_m, reference, **changes)


def abeam(polar: Polar, radius_m: float, rate_rad_s: float, ahead_rad: float = 0.0) -> RingPoint:
    """A reference on the ring at the vehicle's bearing, or ahead of it."""
    bearing = ShapedCoordinate(polar.bearing_rad + ahead_rad, rate_rad_s)
    return RingPoint(ShapedCoordinate(radius_m, 0.0), bearing, 0.0)


def polar_acceleration(config: AgentConfig, motion: Vector, plan: EncirclementPlan, wind: Vector) -> Vector:
    """What the planner's own plant would do at once: (r'', phi'')."""
    plant = config.plant
    cartesian = plant.a0_per_s2 * (plan.aim_m - motion[:2]) - plant.a1_per_s * motion[2:] + wind
    x, y, x_rate, y_rate = motion - TARGET
    radius = np.hypot(x, y)
    outward, sideways = np.array([x, y]) / radius, np.array([-y, x]) / radius
    radial_speed, rate = np.array([x_rate, y_rate]) @ outward, np.array([x_rate, y_rate]) @ sideways / radius
    return np.array(
        [cartesian @ outward + radius * rate**2, (cartesian @ sideways - 2.0 * radial_speed * rate) / radius]
    )


@dataclass(frozen=True)
class PaperProblem:
    """(23)-(26) in the paper's four terms, the separations to be kept those of the references.

    Each neighbour flies on its own reference, which has any motion. The own one's acceleration fades at the gain.
    Angles count as distances at the vehicle's own radius, which on the ring are the paper's.
    """

    config: AgentConfig
    polar: Polar
    place: RingPlace
    reference: RingPoint
    previous: Vector
    weights: tuple[float, float]

    def rollout(self, decision: Vector) -> Vector:
        """Radius, angle turned, and their rates (horizon, 4)."""
        ring = self.config.encirclement
        dt, inputs = ring.prediction_step_s, decision.reshape(-1, 2)
        place, rates = (
            np.array([self.polar.radius_m, 0.0]),
            np.array([self.polar.radial_speed_m_s, self.polar.angular_rate_rad_s]),
        )
        states = []
        for step in range(ring.horizon):
            acceleration = inputs[min(step, len(inputs) - 1)]
            place = place + rates * dt + acceleration * dt**2 / 2.0
            rates = rates + acceleration * dt
            states.append([*place, *rates])
        return np.array(states)

    def neighbours(self) -> tuple[Vector, Vector]:
        """The angles of lead and lag over the horizon (horizon,), as the clearance is kept to them."""
        assert self.place.lead_rad is not None
        assert self.place.lag_rad is not None
        ring = self.config.encirclement
        turned = ring.angular_rate_rad_s * ring.prediction_step_s * np.arange(1, ring.horizon + 1)
        return np.asarray(self.place.lead_rad + turned), np.asarray(turned - self.place.lag_rad)

    def faded(self, coordinate: ShapedCoordinate) -> tuple[Vector, Vector]:
        """Value and rate of a coordinate over the horizon, integrated in small steps."""
        ring, fine = self.config.encirclement, 1000
        step_s = ring.prediction_step_s / fine
        at_s = step_s * (np.arange(ring.horizon * fine) + 0.5)
        pushes = coordinate.acceleration * np.exp(-ring.spacing_gain_per_s * at_s)
        rates = coordinate.rate + np.cumsum(pushes) * step_s
        values = coordinate.value + np.cumsum(rates) * step_s
        return values[fine - 1 :: fine], rates[fine - 1 :: fine]

    def cost(self, decision: Vector) -> float:
        ring = self.config.encirclement
        radius, angle, _, rate = self.rollout(decision).T
        wanted_m, _ = self.faded(self.reference.radius)
        bearing_rad, wanted_rad_s = self.faded(self.reference.bearing)
        farther = (self.polar.radius_m / ring.radius_m) ** 2
        total = ring.radius_weight * np.sum((radius - wanted_m) ** 2)
        total += farther * ring.rate_weight * np.sum((rate - wanted_rad_s) ** 2)
        own = angle + self.polar.bearing_rad
        times_s = ring.prediction_step_s * np.arange(1, ring.horizon + 1)
        lead, lag = bearing_rad + 2.1 - 0.3 * times_s, bearing_rad - 1.7 + 0.02 * times_s**2
        rho, zeta = self.weights
        total += farther * rho * np.sum(((own - lag) - (bearing_rad - lag)) ** 2)
        total += farther * zeta * np.sum(((lead - own) - (lead - bearing_rad)) ** 2)
        increments = np.diff(np.vstack([self.previous, decision.reshape(-1, 2)]), axis=0)
        weights = ring.radial_increment_weight, farther * ring.angular_increment_weight
        return float(total + np.sum(increments**2 @ weights))

    def slack(self, decision: Vector) -> Vector:
        """Nowhere negative where speed limit and clearance are kept.

        Each component of the speed may have what the other one leaves, and at least 0.7 of the limit. The clearance is
        a distance.
        """
        _, angle, radial_speed, rate = self.rollout(decision).T
        ring, polar = self.config.encirclement, self.polar
        limit, along = ring.speed_max_m_s, polar.radius_m * polar.angular_rate_rad_s
        radial, angular = (
            max(0.7 * limit, np.sqrt(max(0.0, limit**2 - other**2))) for other in (along, polar.radial_speed_m_s)
        )
        angular /= polar.radius_m
        slacks = [radial - radial_speed, radial + radial_speed, angular - rate, angular + rate]
        if self.place.members > 1:
            (lead, lag), clear = self.neighbours(), self.config.clearance_rad * ring.radius_m / polar.radius_m
            slacks += [lead - angle - clear, angle - lag - clear]
        return np.concatenate(slacks)

    def optimum(self) -> Vector:
        ring = self.config.encirclement
        most, before = ring.acceleration_max_m_s2, self.previous * [1.0, self.polar.radius_m]
        across = np.sqrt(np.maximum(most**2 - before[::-1] ** 2, 0.0))
        limit = np.maximum(0.7 * most, across)
        # The acceleration needs half a second from 0 to its bound. The first move is a tick after the last one.
        moves_s = 1.0 / self.config.rate_hz + ring.prediction_step_s * np.arange(ring.control_horizon)
        bounds = [
            np.clip((last - 2.0 * most * time_s, last + 2.0 * most * time_s), -furthest, furthest) / size_m
            for time_s in moves_s
            for last, furthest, size_m in zip(before, limit, (1.0, self.polar.radius_m), strict=True)
        ]
        corners = np.eye(2 * ring.control_horizon)
        result = minimize(
            self.cost,
            np.zeros(len(corners)),
            # Differences over any step are exact: the cost is quadratic, the constraints are linear.
            jac=lambda u: np.array([self.cost(u + corner) - self.cost(u - corner) for corner in corners]) / 2.0,
            bounds=bounds,
            constraints={
                "type": "ineq",
                "fun": self.slack,
                "jac": lambda u: np.array([self.slack(u + corner) - self.slack(u) for corner in corners]).T,
            },
            method="SLSQP",
            options={"ftol": 1e-12, "maxiter": 500},
        )
        assert result.status in (0, 8)  # converged, or as far as rounding allows
        return np.asarray(result.x[:2], dtype=np.float64)


PLACES = {
    "alone": RingPlace(1, None, None),
    "two": RingPlace(2, 3.13, tau - 3.13),
    "three": RingPlace(3, 2.11, 2.08),
    "crowded": RingPlace(3, 0.32, 2.0),
    "squeezed": RingPlace(3, 0.35, 0.36),
}


@given(
    polar=st.builds(Polar, st.floats(9.7, 10.2), st.floats(-pi, pi), st.floats(-0.1, 0.1), st.floats(0.02, 0.06))
    | st.builds(Polar, st.floats(20.0, 30.0), st.floats(-pi, pi), st.floats(-1.0, 0.0), st.floats(0.0, 0.02)),
    place=st.sampled_from(list(PLACES.values())),
    weights=st.tuples(st.floats(4.0, 10.0), st.floats(4.0, 10.0)),
)
@settings(max_examples=10)
def test_the_plan_minimises_the_papers_cost(
    make_config: Maker, polar: Polar, place: RingPlace, weights: tuple[float, float]
) -> None:
    """Near the ring no bound is active, far out one is."""
    config = make_config(encirclement={"spacing_weight": sum(weights)}, safety={"separation_m": 3.0})
    planner, motion, previous = EncirclementPlanner(config), motion_from_polar(polar, TARGET), np.zeros(2)
    radius = ShapedCoordinate(10.1, -0.05, 0.1)
    reference, turned = (
        RingPoint(
            radius, ShapedCoordinate(polar.bearing_rad + 0.02 + turn, polar.angular_rate_rad_s + 0.01, -0.005), 0.0
        )
        for turn in (0.0, tau)
    )
    for _ in range(2):  # the second plan continues the first: it pays for the change of acceleration
        plan = planner.plan(ring_task(config, motion, TARGET, WIND, place, reference=turned))
        acceleration = polar_acceleration(config, motion, plan, WIND)
        problem = PaperProblem(config, polar, place, reference, previous, weights)
        assert acceleration == pytest.approx(problem.optimum(), abs=3e-3)
        previous = acceleration
    if min(place.lead_rad or pi, place.lag_rad or pi) > 1.0:  # nearer, the clearance may bind as well
        assert plan.status is (QpStatus.INTERIOR if polar.radius_m < 15.0 else QpStatus.BOUNDED)


@given(
    polar=st.builds(Polar, st.floats(1.5, 55.0), st.floats(-pi, pi), st.floats(-2.5, 2.5), st.floats(-0.5, 0.5)),
    others=st.lists(st.floats(-pi, pi), max_size=3),
)
def test_the_planned_acceleration_stays_within_its_bounds(
    polar: Polar, others: list[float], make_config: Maker
) -> None:
    config = make_config()
    motion = motion_from_polar(polar, TARGET)
    plan = EncirclementPlanner(config).plan(
        ring_task(config, motion, TARGET, WIND, ring_place(polar.bearing_rad, others))
    )
    radial, angular = np.abs(polar_acceleration(config, motion, plan, WIND))
    assert radial <= config.encirclement.acceleration_max_m_s2 + 1e-6
    assert angular * polar.radius_m <= config.encirclement.acceleration_max_m_s2 + 1e-6


class Flyer:
    """A vehicle of a perturbed plant in the wind, with filter and planner of the nominal plant."""

    def __init__(self, config: AgentConfig, polar: Polar, plant: Plant = PERTURBED) -> None:
        self.config, self.plant = config, plant
        self.motion = motion_from_polar(polar, TARGET)
        self.own = OwnFilter(config.plant, config.own_filter)
        self.planner = EncirclementPlanner(config)
        self.joining, self.reference = Joining(config), RingReference(config)
        self.point: RingPoint | None = None
        self.plans: list[EncirclementPlan] = []

    def tick(self, now_s: float, others: Sequence["Flyer"]) -> None:
        x, y, x_rate, y_rate = self.motion.tolist()
        self.own.measure(Telemetry(now_s, (x, y, 8.0), (x_rate, y_rate, 0.0)))
        mean = self.own.predicted(now_s + PERIOD_S / 2.0, PERIOD_S / 2.0)
        acting = mean[MOTION]
        target = target_at(now_s + PERIOD_S / 2.0)
        drift = self.config.encirclement.angular_rate_rad_s * PERIOD_S / 2.0
        bearings = [polar_from_motion(other.motion, target_at(now_s)).bearing_rad + drift for other in others]
        polar, at_s = polar_from_motion(acting, target), now_s + PERIOD_S / 2.0
        place, ring = ring_place(polar.bearing_rad, bearings), self.config.encirclement
        references = [other.point.place_rad(at_s) for other in others if other.point is not None]
        orbit, joining = Orbit(ring.radius_m, ring.angular_rate_rad_s), self.joining
        own_rad = self.reference.place_rad(polar, orbit, at_s)
        errors = place_errors_rad([own_rad, *references], range(len(references) + 1))
        movers = [joining.mover(error, polar.radius_m, orbit) for error in errors]
        way = RingWay(orbit, ring.radius_m, movers, joining.acceleration)
        self.point = self.reference.advance(polar, way, at_s)
        task = ring_task(self.config, acting, target, mean[DISTURBANCE], place, reference=self.point)
        self.plans.append(self.planner.plan(task))
        if self.plans[-1].approach is not Approach.ORBIT:
            self.reference.reset()
        self.own.command(now_s, self.plans[-1].aim_m)

    def advance(self) -> None:
        self.motion = exact_step(self.plant, PERIOD_S).advance(self.motion, self.plans[-1].aim_m, WIND)


def target_at(time_s: float) -> Vector:
    return np.concatenate([TARGET[:2] + TARGET[2:] * time_s, TARGET[2:]])


def fly(flyers: Sequence[Flyer], duration_s: float) -> Vector:
    """Fly all of them; return radius, unwrapped bearing and their rates (T, N, 4)."""
    track = []
    for tick in range(round(duration_s / PERIOD_S)):
        motions = [flyer.motion for flyer in flyers]
        polars = [polar_from_motion(motion, target_at(tick * PERIOD_S)) for motion in motions]
        track.append([[p.radius_m, p.bearing_rad, p.radial_speed_m_s, p.angular_rate_rad_s] for p in polars])
        for index, flyer in enumerate(flyers):
            flyer.tick(tick * PERIOD_S, [*flyers[:index], *flyers[index + 1 :]])
        for flyer in flyers:
            flyer.advance()
    flown = np.array(track)
    flown[:, :, 1] = np.unwrap(flown[:, :, 1], axis=0)
    return flown


@pytest.mark.parametrize(("members", "gain_per_s"), [(2, 0.4), (3, 0.1), (12, 0.2), (24, 0.3)])
def test_the_spacing_of_flown_vehicles_decays_at_the_gain_for_any_number(
    members: int, gain_per_s: float, make_config: Maker
) -> None:
    config = make_config(encirclement={"spacing_gain_per_s": gain_per_s}, safety={"separation_m": 1.0})
    even = tau * np.arange(members) / members
    mode = 0.05 * np.cos(even)  # half a metre: no bound is active
    flyers = [Flyer(config, Polar(10.0, bearing, 0.0, 0.05), config.plant) for bearing in even + mode]
    flown = fly(flyers, 8.0 + 2.5 / gain_per_s)[80:, :, 1]  # the filters learn the wind first
    gaps = np.diff(np.column_stack([flown, flown[:, 0] + tau]), axis=1) % tau
    off = gaps - tau / members
    value = 0.5 * (off**2).sum(axis=1)  # (18), which decays twice as fast
    fitted_per_s = -np.polyfit(np.arange(len(value)) * PERIOD_S, np.log(value), 1)[0] / 2.0
    assert fitted_per_s == pytest.approx(gain_per_s, rel=0.05)


def test_the_speed_limit_is_kept_on_the_way_and_on_the_ring(make_config: Maker) -> None:
    config = make_config(encirclement={"speed_max_m_s": 1.0, "angular_rate_rad_s": 0.3})
    flown = fly([Flyer(config, Polar(40.0, 1.0, 0.0, 0.0), config.plant)], 120.0)[:, 0]
    assert np.abs(flown[:, 2]).max() < 1.0 * 1.05
    assert np.abs(flown[:, 0] * flown[:, 3]).max() < 1.0 * 1.05
    # 0.3 rad/s would need 3 m/s: the vehicle turns as fast as it may.
    assert flown[-50:, 3] == pytest.approx(0.1, abs=0.003)
    assert flown[-50:, 0] == pytest.approx(10.0, abs=0.1)


def test_the_speed_limit_is_one_of_the_vector(make_config: Maker) -> None:
    """Towards a reference that has the limit in both directions, and is as far ahead as it may be."""
    config = make_config()
    ring, planner, motion = config.encirclement, EncirclementPlanner(config), motion_from_polar(FAR_OUT, TARGET)
    lead_m, limit_m_s, speeds_m_s = ring.reference_lead_max_m, ring.speed_max_m_s, []
    for tick in range(100):
        target = target_at(tick * PERIOD_S)
        polar = polar_from_motion(motion, target)
        reference = RingPoint(
            ShapedCoordinate(polar.radius_m - lead_m, -limit_m_s),
            ShapedCoordinate(polar.bearing_rad + lead_m / polar.radius_m, limit_m_s / polar.radius_m),
            0.0,
        )
        task = ring_task(config, motion, target, STILL, PLACES["alone"], reference=reference)
        motion = exact_step(config.plant, PERIOD_S).advance(motion, planner.plan(task).aim_m, STILL)
        speeds_m_s.append(float(np.hypot(*(motion - target)[2:])))
    assert max(speeds_m_s) <= 1.1 * limit_m_s
    assert speeds_m_s[-1] >= 0.9 * limit_m_s


@pytest.mark.parametrize("ahead_rad", [0.2, -0.2])
def test_far_outside_a_neighbour_that_is_far_enough_away_changes_nothing(ahead_rad: float, make_config: Maker) -> None:
    """The clearance is a distance: at the bearing that it is on the ring, vehicles 8 m apart would turn back."""
    config, motion = make_config(safety={"separation_m": 3.0}), motion_from_polar(Polar(40.0, 1.0, 0.0, 0.0), TARGET)
    alone, beside = (
        EncirclementPlanner(config).plan(ring_task(config, motion, TARGET, STILL, ring_place(1.0, others)))
        for others in ([], [1.0 + ahead_rad, 1.0 + pi])
    )
    assert beside.aim_m == pytest.approx(alone.aim_m, abs=1e-6)


@pytest.mark.parametrize(("lead", "lag"), [(0.6, 0.8), (0.8, 0.6)])
def test_the_clearance_to_a_neighbour_is_kept_against_a_reference_inside_it(
    lead: float, lag: float, make_config: Maker
) -> None:
    config = make_config(safety={"separation_m": 3.0})
    planner, motion = EncirclementPlanner(config), motion_from_polar(Polar(10.0, 3.0, 0.0, 0.05), target_at(0.0))
    gaps = []
    for tick in range(300):
        now_s = tick * PERIOD_S
        polar = polar_from_motion(motion, target_at(now_s))
        place = ring_place(polar.bearing_rad, [3.0 + lead + 0.05 * now_s, 3.0 - lag + 0.05 * now_s])
        assert place.lead_rad is not None
        assert place.lag_rad is not None
        gaps.append(min(place.lead_rad, place.lag_rad))
        beside_rad = (lead if lead < lag else -lag) + 3.0 + 0.05 * now_s - polar.bearing_rad
        reference = abeam(polar, 10.0, 0.05, beside_rad)
        plan = planner.plan(ring_task(config, motion, target_at(now_s), STILL, place, reference=reference))
        motion = exact_step(config.plant, PERIOD_S).advance(motion, plan.aim_m, STILL)
    assert min(gaps) == pytest.approx(config.clearance_rad, rel=0.05)


@given(st.sampled_from([0.0, 0.99, 1.01, 59.9, 60.1]) | st.floats(0.0, 120.0), st.floats(-pi, pi))
def test_near_the_centre_and_far_out_the_way_is_radial(make_config: Maker, radius: float, bearing: float) -> None:
    assume(min(abs(radius - 1.0), abs(radius - 60.0)) > 1e-6)
    approach = Approach.OUTWARD if radius < 1.0 else Approach.ORBIT if radius < 60.0 else Approach.INWARD
    config = make_config()
    motion = motion_from_polar(Polar(radius, bearing, 0.0, 0.0), TARGET)
    plan = EncirclementPlanner(config).plan(ring_task(config, motion, TARGET, WIND, PLACES["three"]))
    assert plan.approach is approach
    assert np.isfinite(plan.aim_m).all()
    if approach is not Approach.ORBIT and radius > 1e-3:
        radial, angular = polar_acceleration(config, motion, plan, WIND)
        assert angular * radius == pytest.approx(0.0, abs=1e-9)
        assert radial * (1.0 if approach is Approach.OUTWARD else -1.0) == pytest.approx(0.87 * 3.0)


@pytest.mark.parametrize("radius", [0.0, 90.0])
def test_from_the_centre_and_from_afar_a_vehicle_reaches_the_ring(radius: float, make_config: Maker) -> None:
    config = make_config()
    flyer = Flyer(config, Polar(radius, 2.0, 0.0, 0.0), config.plant)
    flown = fly([flyer], 90.0)[:, 0]
    assert flyer.plans[0].approach is (Approach.INWARD if radius > 60.0 else Approach.OUTWARD)
    assert flyer.plans[-1].approach is Approach.ORBIT
    assert np.abs(flown[:, 2]).max() < 3.0 * 1.02
    assert flown[-100:, 0] == pytest.approx(10.0, abs=0.1)


def test_with_little_authority_the_model_alone_leads_along_the_ring(make_config: Callable[..., AgentConfig]) -> None:
    # On the ring feedback has nothing to say; off it, a tenth of the authority says a tenth - to first order.
    config = make_config(encirclement={"angular_rate_rad_s": 0.1})
    settings, alone = config.encirclement, RingPlace(1, None, None)
    ring = Polar(settings.radius_m, 0.7, 0.0, settings.angular_rate_rad_s)

    def setpoint(polar: Polar, authority: float) -> Vector:
        planner = EncirclementPlanner(config)
        motion = motion_from_polar(polar, TARGET)
        return planner.plan(ring_task(config, motion, TARGET, STILL, alone, authority=authority)).aim_m

    led = setpoint(ring, 1.0)
    assert setpoint(ring, 0.1) == pytest.approx(led, abs=1e-9)
    off = Polar(ring.radius_m + 0.1, ring.bearing_rad, 0.05, ring.angular_rate_rad_s + 0.002)
    assert setpoint(off, 0.1) - led == pytest.approx((setpoint(off, 1.0) - led) / 10.0, abs=2e-3)
    assert np.linalg.norm(setpoint(off, 1.0) - led) > 0.05


@pytest.mark.parametrize(
    ("radius_m", "stands_m", "at_m"),
    [
        (19.0, None, 19.0),  # waiting outside the ring
        (None, None, 15.0),  # on an orbit wider and slower than the mission's
        (None, 15.0, 17.0 + MARGIN_M),  # on the bend about an obstacle
    ],
)
def test_where_it_is_to_fly_a_vehicle_of_little_authority_stays(
    radius_m: float | None, stands_m: float | None, at_m: float, make_config: Maker
) -> None:
    config = make_config(encirclement={"angular_rate_rad_s": 0.1})
    orbit, alone = Orbit(15.0, 0.05), RingPlace(1, None, None)
    obstacles = [] if stands_m is None else [Obstacle(0.7, stands_m, 2.0)]
    motion = motion_from_polar(Polar(at_m, 0.7, 0.0, 0.05), TARGET)

    def setpoint(authority: float) -> Vector:
        planner = EncirclementPlanner(config)
        where = {"orbit": orbit, "radius_m": radius_m, "obstacles": obstacles}
        return planner.plan(ring_task(config, motion, TARGET, STILL, alone, authority=authority, **where)).aim_m

    assert setpoint(0.1) == pytest.approx(setpoint(1.0), abs=1e-9)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_far_outside_a_neighbour_goes_on_at_its_own_rate(direction: float, make_config: Maker) -> None:
    """At the ring's rate it would come at 5 m/s at this radius, and push the vehicle beyond its speed."""
    config = make_config(safety={"separation_m": 3.0}, encirclement={"angular_rate_rad_s": direction * 0.13})
    polar, orbit = Polar(38.0, 1.0, 0.0, 0.0), Orbit(10.0, direction * 0.13)
    abreast = (0.11, 0.0), (0.11, 0.0)
    alone, between = (
        RingTask(motion_from_polar(polar, TARGET), TARGET, polar, STILL, others, orbit, 14.5, abeam(polar, 38.0, 0.0))
        for others in (None, abreast)
    )
    aims_m = [EncirclementPlanner(config).plan(task).aim_m for task in (alone, between)]
    assert aims_m[0] == pytest.approx(aims_m[1], abs=1e-6)
