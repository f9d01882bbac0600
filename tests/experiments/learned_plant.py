"""Fly the plant family twice: the second time with the plants that vehicles learnt on their first flight.

Each vehicle learns a residual of its plant by recursive least squares from its own estimates and setpoints, bounded to
half of each parameter; the profile's plant with the residual is the controller's on the second flight. With the
disturbance oscillators of the own-vehicle filter (docs/notes/control.md) and without them, beside the profile's plant
alone and the true one, which no learning can surpass. All paths are true ones. The last line is the share of the radius
error that repeats with the phase on the ring: no periodic correction removes more.

With `--log`, vehicles learn from a log, such as one of a flight on an autopilot's firmware: a profile with the learnt
plant is written for each vehicle (its name ends with the id), to be flown by another flight. With `--oscillators off`
it has none.
"""

import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

import cordon
from agents.outputs import TickOutput
from estimation.plant.model import Plant, PlantAxis
from estimation.state import POSITION, Vector
from gcs.flight.simulated import simulated_vehicles
from gcs.mission.mission import MissionVehicle
from sitl.simulation.simulation import SimulatedFlight
from tests.experiments.arguments import seeded_parser
from tests.experiments.plant_family import Draw, Flown, drawn, judged
from tests.support.observed_flight import observed
from tests.support.paths import PROFILES

SPAN_S = 1.0
"""Speeds are compared over this time: the noise of one sample's acceleration would hide the plant."""
NOISE_M_S = 1.0
PRIOR_SHARE, BOUND_SHARE = 0.3, 0.5
"""Of each parameter: the standard deviation of the residual before any flight, and its bound."""
WIND_M_S2 = 1.0
HARMONICS = 4
WITHIN_M = 0.5
COLUMNS = ("radius rms [m]", "95 % [m]", "rate off [%]", "95 % [%]", "spacing [deg]", "settled [s]")


class PlantLearner:
    """Recursive least squares of one axis: the residuals of a0 and a1, and a constant acceleration."""

    def __init__(self, axis: PlantAxis) -> None:
        self._prior = np.array([axis.a0_per_s2, axis.a1_per_s, 0.0])
        self._parameters = self._prior.copy()
        self._covariance = np.diag(np.square([*(PRIOR_SHARE * self._prior[:2]), WIND_M_S2]))

    def learn(self, regressor: Vector, change_m_s: float) -> None:
        """Take the integrals (3,) of lead, negative speed and time over a span, and the change of speed in it."""
        gain = self._covariance @ regressor
        gain /= NOISE_M_S**2 + regressor @ gain
        self._parameters += gain * (change_m_s - regressor @ self._parameters)
        self._covariance -= np.outer(gain, regressor @ self._covariance)

    @property
    def learnt(self) -> PlantAxis:
        """The profile's axis with the bounded residual."""
        bound = BOUND_SHARE * self._prior[:2]
        a0, a1 = self._prior[:2] + np.clip(self._parameters[:2] - self._prior[:2], -bound, bound)
        return PlantAxis(float(a0), float(a1))


@dataclass(frozen=True)
class Own:
    """What a vehicle knows of its own flight at each tick: motion (n, 4), and the setpoint's position and velocity."""

    motion: list[Vector]
    setpoint: list[tuple[float, float, float, float]]


def learnt(plant: Plant, own: Own, rate_hz: float) -> Plant:
    """Return the plant with the residual that a vehicle learns from its flight; the delay remains the profile's."""
    motion, setpoint = np.array(own.motion), np.array(own.setpoint)
    late, span = round(plant.delay_s * rate_hz), round(SPAN_S * rate_hz)
    axes = []
    for at, axis in enumerate((plant.x, plant.y)):
        position, speed = motion[late:, at], motion[late:, 2 + at]
        sent, fed = setpoint[: len(position), at], plant.feedforward * setpoint[: len(position), 2 + at]
        learner = PlantLearner(axis)
        for begin in range(0, len(position) - span, span):
            over = slice(begin, begin + span)
            # A setpoint sent at a tick acts until the next one: it meets the mean motion of the two.
            mean_m, mean_m_s = ((each[over] + each[begin + 1 : begin + span + 1]) / 2.0 for each in (position, speed))
            regressor = np.array([np.sum(sent[over] - mean_m), np.sum(fed[over] - mean_m_s), span]) / rate_hz
            learner.learn(regressor, float(speed[begin + span] - speed[begin]))
        axes.append(learner.learnt)
    return replace(plant, x=axes[0], y=axes[1])


@dataclass(frozen=True)
class Result:
    """One flight of a draw: its judgement, when all vehicles had settled, and the share of the error that repeats."""

    flown: Flown
    settled_s: float
    repeating: float


Change = Callable[[MissionVehicle], MissionVehicle]


def fly(draw: Draw, change: Change) -> tuple[Result, dict[int, Own]]:
    """Fly a draw with changed vehicles; return also what each vehicle knows of its flight."""
    mission = replace(draw.mission, vehicles=tuple(map(change, draw.mission.vehicles)))
    knowledge = {vehicle_id: Own([], []) for vehicle_id in mission.ids}
    tactics = dict.fromkeys(mission.ids, "")

    def observe(_tick: int, _at: int, output: TickOutput) -> None:
        status, sent = output.status, output.setpoint
        tactics[status.vehicle_id] = status.tactic.value
        if sent is not None and status.motion is not None:
            known = knowledge[status.vehicle_id]
            known.motion.append(np.array(status.motion))
            known.setpoint.append((*sent.position_m[:2], *(sent.velocity_m_s[:2] or (0.0, 0.0))))  # type: ignore[arg-type]

    imperfections = {key: each.imperfections for key, each in draw.family.items()}
    vehicles = simulated_vehicles(mission, mission.mission.seed, imperfections=imperfections)
    flight = observed(mission, mission.mission.seed, observe, vehicles=vehicles)
    flown = judged(draw, flight, on_ring=set(tactics.values()) == {"encircle"})
    return Result(flown, *_on_ring(draw, flight)), knowledge


def _on_ring(draw: Draw, flight: SimulatedFlight) -> tuple[float, float]:
    """Return since when all radius errors are within WITHIN_M [s], and the share that repeats with the phase."""
    target, ring = draw.mission.target.motion, draw.mission.encirclement
    places = np.array([target.position_m(at_s) for at_s in flight.time_s.tolist()])
    around = (flight.motion[..., POSITION] - places[:, None]) @ np.array([1.0, 1.0j])
    error_m = np.abs(around) - ring.radius_m
    off = np.flatnonzero((np.abs(error_m) > WITHIN_M).any(axis=1) & (flight.time_s < draw.settled_s))
    late = flight.time_s >= draw.settled_s
    total = left = 0.0
    for bearing, errors_m in zip(np.angle(around[late]).T, error_m[late].T, strict=True):
        waves = [each(count * bearing) for count in range(1, HARMONICS + 1) for each in (np.cos, np.sin)]
        columns = np.column_stack([np.ones_like(bearing), *waves])
        fitted = columns @ np.linalg.lstsq(columns, errors_m, rcond=None)[0]
        total += float(np.sum(errors_m**2))
        left += float(np.sum((errors_m - fitted) ** 2))
    return float(flight.time_s[off[-1]]) if off.size else 0.0, 1.0 - left / total


def without_oscillators(vehicle: MissionVehicle) -> MissionVehicle:
    """Return the vehicle with a filter that estimates a steady disturbance only."""
    return replace(vehicle, own_filter=vehicle.own_filter.model_copy(update={"disturbance_turns": False}))


def compared(seed: int, *, linear: bool) -> dict[str, Result]:
    """Fly a draw with each plant, with and without oscillators."""
    draw, results = drawn(seed, linear=linear), {}
    for title, base in (("oscillators", lambda vehicle: vehicle), ("none", without_oscillators)):
        results[f"{title}, profile"], own = fly(draw, base)
        plants = {
            "learnt": {
                each.id: learnt(each.plant, own[each.id], draw.mission.mission.rate_hz)
                for each in draw.mission.vehicles
            },
            "true": {each.id: each.true_plant for each in draw.mission.vehicles},
        }
        for name, by_id in plants.items():
            changed: Change = lambda vehicle, base=base, by_id=by_id: replace(base(vehicle), plant=by_id[vehicle.id])  # type: ignore[misc]  # noqa: E731
            results[f"{title}, {name}"], _ = fly(draw, changed)
    return results


def whole(seed: int) -> dict[str, Result]:
    """Compare on a draw of the whole family."""
    return compared(seed, linear=False)


def linear(seed: int) -> dict[str, Result]:
    """Compare on a draw of the family's linear part."""
    return compared(seed, linear=True)


def row(results: list[Result]) -> list[float]:
    """Return the figures of COLUMNS over all draws."""
    radius = [each.flown.radius_rms_m for each in results]
    rate = [100.0 * abs(each.flown.rate_error) for each in results]
    spacing = [each.flown.spacing_rms_deg for each in results]
    settled = [each.settled_s for each in results]
    worst = [float(np.quantile(each, 0.95)) for each in (radius, rate)]
    return [median(radius), worst[0], median(rate), worst[1], median(spacing), median(settled)]


def main(count: int, first: int) -> int:
    """Compare on a number of draws of both parts of the family, from the seed `first` on."""
    with ProcessPoolExecutor() as pool:
        for title, compare in (("the whole family", whole), ("its linear part", linear)):
            draws = list(pool.map(compare, range(first, first + count)))
            print(f"{title}, {count} draws: {', '.join(COLUMNS)}")
            for name in draws[0]:
                results = [each[name] for each in draws]
                cells = "  ".join(f"{value:8.3f}" for value in row(results))
                lost = sum(each.flown.diverged for each in results)
                print(f"    {name:22}{cells}   diverged {lost}", flush=True)
            repeats = median(each["oscillators, profile"].repeating for each in draws)
            print(f"    radius error that repeats with the phase: {repeats:.0%} of its square in the median")
    return 0


def write_profiles(log: Path, folder: Path, *, learns: bool, oscillators: bool) -> int:
    """Write the profile of each vehicle of a log, with the plant that it learnt in this flight if it `learns`."""
    flight = cordon.read(log)
    rate_hz, bearing_rad = flight.mission.mission.rate_hz, flight.mission.mission_frame().x_bearing_rad
    assert np.isclose(np.sin(bearing_rad), 1.0), "profiles point north and west, and the mission east"
    for vehicle in flight.mission.vehicles:
        flown = flight.vehicles[vehicle.id]
        motion = np.hstack([flown.position_estimate_m, flown.velocity_estimate_m_s])
        setpoint = np.hstack([flown.setpoint_m[:, POSITION], flown.setpoint_velocity_m_s[:, POSITION]])
        known = np.isfinite(np.hstack([motion, setpoint])).all(axis=1)
        own = Own(list(motion[known]), [tuple(row) for row in setpoint[known].tolist()])
        plant = learnt(vehicle.plant, own, rate_hz) if learns else vehicle.plant
        text = (PROFILES / f"{vehicle.section.profile}.toml").read_text(encoding="utf-8")
        for name, axis in (("x", plant.y), ("y", plant.x)):
            values = f"a0_per_s2 = {axis.a0_per_s2:.4f}\na1_per_s = {axis.a1_per_s:.4f}\n"
            text = re.sub(rf"(\[{name}\]\n).*\n.*\n", rf"\1{values}", text)
        text = text.partition("[identified]")[0]
        if not oscillators:
            text = text.replace("[own_filter]\n", "[own_filter]\ndisturbance_turns = false\n")
        path = folder / f"{vehicle.section.profile}-{vehicle.id}.toml"
        path.write_text(text, encoding="utf-8")
        numbers = ", ".join(f"{each.a0_per_s2:.3f} and {each.a1_per_s:.3f}" for each in (plant.x, plant.y))
        print(f"{path}: a0 and a1 along the mission's x and y: {numbers}")
    return 0


if __name__ == "__main__":
    reader = seeded_parser("learned_plant", __doc__, 50)
    reader.add_argument("--log", type=Path, help="the flight to learn from, in place of the family")
    reader.add_argument("--profiles", type=Path, default=Path(), help="where to write profiles (default: here)")
    reader.add_argument("--oscillators", choices=("on", "off"), default="on", help="those of the written profiles")
    reader.add_argument("--plant", choices=("learnt", "profile"), default="learnt", help="that of the written profiles")
    given = reader.parse_args()
    if given.log is not None:
        how = {"learns": given.plant == "learnt", "oscillators": given.oscillators == "on"}
        raise SystemExit(write_profiles(given.log, given.profiles, **how))
    raise SystemExit(main(given.count, given.first))
