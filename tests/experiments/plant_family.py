"""Encircle with a family of plants drawn about the nominal one, and check radius, rate and stability.

Three vehicles encircle a target that moves at 0.1 to 1 m/s. Their plant file is the nominal plant; each vehicle's true
plant is drawn from the family about it (plant_draws.py), all in the same wind. The true paths are evaluated after
settling: a draw passes if the radius error (rms over the three vehicles) and the worst mean rate are within the limits.
Then the same for the family's linear part in a constant wind, and for named manoeuvres, each with a single
imperfection. Exit code 1 if a limit is exceeded.
"""

import os
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from math import cos, hypot, pi, sin

import numpy as np

from agents.outputs import TickOutput
from estimation.plant.model import Plant, PlantAxis
from estimation.settings import OwnFilterSettings
from estimation.state import POSITION, Vector
from gcs.flight.simulated import simulated_vehicles
from gcs.mission.mission import Mission
from sitl.simulation.simulation import SimulatedFlight
from sitl.vehicle.imperfections import IDEAL, EstimatorDriftModel, Imperfections, TelemetryTiming
from sitl.vehicle.shaping import ShapeLimits
from tests.experiments.arguments import seeded_parser
from tests.experiments.plant_draws import (
    ACCELERATION_M_S2,
    GAP_S,
    GAPS_EVERY_S,
    JERK_M_S3,
    JITTER,
    JUMP_M,
    JUMPS_EVERY_S,
    SPEED_M_S,
    WANDER_CORRELATION_S,
    WANDER_M,
    WIND_MAX_M_S,
    Relative,
    blowing,
    linear_relative,
    relative,
)
from tests.support.mission_text import Content, content, parsed
from tests.support.observed_flight import observed
from tests.support.paths import MISSIONS

FIELD = (MISSIONS / "case2-field.toml").read_text(encoding="utf-8")
NOMINALS = ("stub", "px4")
# The noise of case2-field, the disturbance equivalent to the plant error, and a gate that detects a jump of the
# estimator and restarts soon with a wrong plant.
OWN_FILTER = OwnFilterSettings(
    position_noise_m=0.1, velocity_noise_m_s=0.05, disturbance_max_m_s2=7.0, gate_sigma=8.0, gate_timeout_s=0.3
)
DURATION_S, SETTLED_S = 240.0, 90.0
LINEAR_DURATION_S, LINEAR_SETTLED_S = 300.0, 150.0
RADIUS_RMS_M, RATE_SHARE, HELD_SHARE = 0.3, 0.02, 0.95
LINEAR_RATE_SHARE, LINEAR_BIAS_M = 0.002, 0.02
DIVERGED_M = 5.0
"""The largest radius error of a vehicle after settling: half the radius."""


@dataclass(frozen=True)
class Draw:
    """A mission with the truth of each vehicle."""

    name: str
    mission: Mission
    family: dict[int, Relative]
    settled_s: float


def drawn(seed: int, *, linear: bool) -> Draw:
    """Return the draw of a seed, with a ring that the slowest vehicle can fly."""
    random = np.random.default_rng([seed, int(linear)])
    wind_m_s = blowing(random)
    nominal = str(random.choice(NOMINALS))
    target_m_s, course_rad = random.uniform(0.1, 1.0), random.uniform(0.0, 2.0 * pi)
    radius_m = float(random.uniform(8.0, 12.0))
    mission = _field(nominal)
    mission["mission"] |= {"seed": seed}
    draw = linear_relative if linear else relative
    plant = parsed(mission).vehicles[0].plant
    family = {vehicle["id"]: draw(plant, wind_m_s, random) for vehicle in mission["vehicles"]}
    shapes = [each.imperfections.shape for each in family.values() if each.imperfections.shape is not None]
    speed_m_s = min([0.8 * shape.speed_m_s for shape in shapes] + [3.0])
    acceleration_m_s2 = min([0.8 * shape.acceleration_m_s2 for shape in shapes] + [2.0])
    ring_m_s = float(random.uniform(0.4, 1.0) * min(speed_m_s - target_m_s, 1.5))
    mission["encirclement"] |= {
        "radius_m": radius_m,
        "angular_rate_rad_s": ring_m_s / radius_m * float(random.choice([-1.0, 1.0])),
        "speed_max_m_s": speed_m_s + 0.2,
        "acceleration_max_m_s2": acceleration_m_s2,
    }
    velocity_m_s = float(target_m_s * cos(course_rad)), float(target_m_s * sin(course_rad))
    mission["target"] |= {"velocity_m_s": list(velocity_m_s)}
    if linear:
        mission["mission"] |= {"duration_s": LINEAR_DURATION_S}
        mission["target"]["sensor"] |= {"noise_m": 0.0}
        mission["simulation"] |= {"position_noise_m": 0.0, "velocity_noise_m_s": 0.0}
        mission["network"] |= {"delay_s": 0.0, "loss": 0.0}
    title = (
        f"seed {seed} ({nominal}, R {radius_m:.1f} m, {ring_m_s:.2f} + {target_m_s:.2f} m/s, wind {_norm(wind_m_s)})"
    )
    return _with_truth(title, mission, family, LINEAR_SETTLED_S if linear else SETTLED_S)


def _norm(wind_m_s: tuple[float, float]) -> str:
    return f"{hypot(*wind_m_s):.1f} m/s"


def _field(nominal: str) -> Content:
    """Return case2-field with three vehicles of one plant file, about a target in sight, with room for this family."""
    mission = content(FIELD)
    mission["vehicles"] = [vehicle | {"profile": nominal} for vehicle in mission["vehicles"]]
    for vehicle in mission["vehicles"]:
        del vehicle["true_scale"]
    mission["mission"] |= {"name": "family", "duration_s": DURATION_S}
    mission["decision"] |= {"distance_max_m": 100.0}
    mission["target"] |= {"start_m": [14.0, 0.0]}
    mission["target"]["sensor"] |= {"range_m": 60.0, "noise_m": 0.3}
    # The lead that the plant with the lowest stiffness needs at full speed.
    mission["safety"] |= {"separation_m": 2.0}
    mission["tuning"] = {"safety": {"setpoint_lead_max_m": 10.0}}
    return mission


def _with_truth(name: str, mission: Content, family: dict[int, Relative], settled_s: float) -> Draw:
    loaded = parsed(mission)
    vehicles = tuple(
        replace(vehicle, true_plant=family[vehicle.id].plant, own_filter=OWN_FILTER) for vehicle in loaded.vehicles
    )
    return Draw(name, replace(loaded, vehicles=vehicles), family, settled_s)


Scale = tuple[float, float, float, float]
_SAME: Scale = (1.0, 1.0, 1.0, 1.0)
_SHAPE = ShapeLimits(SPEED_M_S[0], ACCELERATION_M_S2[0], JERK_M_S3)
_DRIFT = EstimatorDriftModel(WANDER_M / 2.0, WANDER_CORRELATION_S)
_JUMPS = EstimatorDriftModel(0.0, WANDER_CORRELATION_S, JUMPS_EVERY_S, JUMP_M)
_WIND = (0.0, WIND_MAX_M_S)
MANOEUVRES: dict[str, tuple[Scale, float, Imperfections]] = {
    "nominal": (_SAME, 0.0, IDEAL),
    "half as stiff and damped": ((0.5, 0.5, 0.5, 0.5), 0.0, IDEAL),
    "half as stiff, more damped": ((0.5, 1.5, 0.5, 1.5), 0.0, IDEAL),
    "stiffer, half as damped": ((1.5, 0.5, 1.5, 0.5), 0.0, IDEAL),
    "axes that differ": ((0.5, 1.5, 1.5, 0.5), 0.0, IDEAL),
    "delay 0.4 s, unknown": (_SAME, 0.4, IDEAL),
    "2 m/s, 1 m/s2": (_SAME, 0.0, Imperfections(_SHAPE)),
    "wind 8 m/s": (_SAME, 0.0, Imperfections(wind_m_s=_WIND)),
    "wind 8 m/s, gusts": (_SAME, 0.0, Imperfections(wind_m_s=_WIND, gusts=True)),
    "estimator wanders": (_SAME, 0.0, Imperfections(estimator_drift=_DRIFT)),
    "estimator jumps": (_SAME, 0.0, Imperfections(estimator_drift=_JUMPS)),
    "telemetry 10 Hz, jitter, gaps": (
        _SAME,
        0.0,
        Imperfections(telemetry_timing=TelemetryTiming(10.0, JITTER, GAPS_EVERY_S, GAP_S)),
    ),
}
"""Factors of a0 and a1 on x and on y, the true delay (the plant file's is 0), and imperfections."""


def manoeuvre(name: str) -> Draw:
    """Return a named manoeuvre: the stub's plant file, a target at 0.5 m/s, a ring at 1 m/s."""
    (x0, x1, y0, y1), delay_s, imperfections = MANOEUVRES[name]
    mission = _field("stub")
    mission["encirclement"] |= {"angular_rate_rad_s": 0.1, "speed_max_m_s": 1.8, "acceleration_max_m_s2": 0.8}
    mission["target"] |= {"velocity_m_s": [0.3, 0.4]}
    plant = parsed(mission).vehicles[0].plant
    true = Plant(
        PlantAxis(plant.x.a0_per_s2 * x0, plant.x.a1_per_s * x1),
        PlantAxis(plant.y.a0_per_s2 * y0, plant.y.a1_per_s * y1),
        delay_s,
    )
    return _with_truth(
        name, mission, {vehicle["id"]: Relative(true, imperfections) for vehicle in mission["vehicles"]}, SETTLED_S
    )


@dataclass(frozen=True)
class Flown:
    """The results of one draw after settling: over all vehicles, or of the worst one."""

    name: str
    radius_rms_m: float
    worst_radius_rms_m: float
    bias_m: float
    rate_error: float
    spacing_rms_deg: float
    strayed_m: float
    on_ring: bool

    @property
    def diverged(self) -> bool:
        """Whether a vehicle left the ring, by its own decision or by half the radius; also for NaN."""
        return not (self.strayed_m < DIVERGED_M and self.on_ring)

    @property
    def holds(self) -> bool:
        """Whether the whole family's limits were kept."""
        return not self.diverged and self.radius_rms_m <= RADIUS_RMS_M and abs(self.rate_error) <= RATE_SHARE

    @property
    def holds_linear(self) -> bool:
        """Whether the limits of the family's linear part were kept."""
        return not self.diverged and abs(self.bias_m) <= LINEAR_BIAS_M and abs(self.rate_error) <= LINEAR_RATE_SHARE

    def __str__(self) -> str:
        return (
            f"radius {self.radius_rms_m:.3f} m rms (worst vehicle {self.worst_radius_rms_m:.3f}, "
            f"bias {self.bias_m:+.3f}, most {self.strayed_m:.2f}), rate {self.rate_error:+.2%}, "
            f"spacing {self.spacing_rms_deg:.2f} deg rms: {self.name}{' - left the ring' if self.diverged else ''}"
        )


def flown(draw: Draw, duration_s: float | None = None) -> Flown:
    """Fly a draw, for as long as its mission unless told otherwise, and evaluate it."""
    mission = draw.mission
    tactics = [""] * len(mission.vehicles)

    def observe(_tick: int, vehicle: int, output: TickOutput) -> None:
        tactics[vehicle] = output.status.tactic.value

    seed, imperfections = mission.mission.seed, {key: each.imperfections for key, each in draw.family.items()}
    vehicles = simulated_vehicles(mission, seed, imperfections=imperfections)
    flight = observed(mission, seed, observe, duration_s=duration_s, vehicles=vehicles)
    return judged(draw, flight, on_ring=set(tactics) == {"encircle"})


def judged(draw: Draw, flight: SimulatedFlight, *, on_ring: bool) -> Flown:
    """Evaluate a flight of a draw after settling, on its true paths."""
    target, ring = draw.mission.target.motion, draw.mission.encirclement
    late = flight.time_s >= draw.settled_s
    time_s = flight.time_s[late]
    places = np.array([target.position_m(at_s) for at_s in time_s.tolist()])
    around = (flight.motion[late][..., POSITION] - places[:, None]) @ np.array([1.0, 1.0j])
    error_m = np.abs(around) - ring.radius_m
    # The slope of the bearing: the difference of its ends would include their errors.
    rates = np.polyfit(time_s - time_s[0], np.unwrap(np.angle(around), axis=0), 1)[0]
    bearings = np.sort(np.angle(around), axis=1)
    gaps = np.diff(bearings, axis=1, append=bearings[:, :1] + 2.0 * pi)
    return Flown(
        draw.name,
        _rms(error_m),
        max(_rms(each) for each in error_m.T),
        _largest(error_m.mean(axis=0)),
        _largest(rates / ring.angular_rate_rad_s - 1.0),
        float(np.degrees(_rms(gaps - 2.0 * pi / gaps.shape[1]))),
        float(np.abs(error_m).max()),
        on_ring,
    )


def _rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _largest(values: Vector) -> float:
    return float(values[np.abs(values).argmax()])


def whole(seed: int) -> Flown:
    """Fly the draw of a seed from the whole family."""
    return flown(drawn(seed, linear=False))


def linear(seed: int) -> Flown:
    """Fly the draw of a seed from the family's linear part."""
    return flown(drawn(seed, linear=True))


def named(name: str) -> Flown:
    """Fly a named manoeuvre."""
    return flown(manoeuvre(name))


def _told(title: str, flights: list[Flown], held: Callable[[Flown], bool]) -> int:
    """Print the results of many draws; return the number that failed."""
    failed = [flight for flight in flights if not held(flight)]
    rms = np.array([flight.radius_rms_m for flight in flights])
    print(
        f"{title}: {len(flights) - len(failed)} of {len(flights)} hold, "
        f"{sum(flight.diverged for flight in flights)} diverge; radius error median {np.median(rms):.3f}, "
        f"95 % {np.quantile(rms, 0.95):.3f}, worst {rms.max():.3f} m rms"
    )
    print("  largest radius error:", *sorted(flights, key=lambda flight: -flight.radius_rms_m)[:3], sep="\n    ")
    print("  largest error of rate:", *sorted(flights, key=lambda flight: -abs(flight.rate_error))[:3], sep="\n    ")
    print(f"  not held: {len(failed)}", *failed, sep="\n    ", flush=True)
    return len(failed)


def main(count: int, first: int) -> int:
    """Fly a number of draws, from the seed `first` on, on all cores."""
    seeds: Iterable[int] = range(first, first + count)
    with ProcessPoolExecutor(initializer=os.nice, initargs=(10,)) as pool:
        manoeuvres = list(pool.map(named, MANOEUVRES))
        print("named manoeuvres:", *manoeuvres, sep="\n    ", flush=True)
        flights = list(pool.map(whole, seeds))
        failed = _told("the whole family", flights, lambda flight: flight.holds)
        straight = list(pool.map(linear, seeds))
        off = _told("its linear part", straight, lambda flight: flight.holds_linear)
    missed = failed > (1.0 - HELD_SHARE) * count or any(flight.diverged for flight in flights)
    return 1 if missed or off or not all(flight.holds for flight in manoeuvres) else 0


if __name__ == "__main__":
    given = seeded_parser("plant_family", __doc__, 500).parse_args()
    sys.exit(main(given.count, given.first))
