"""Measure what PX4's wandering position estimate costs a ring, from the logs of one px4-trio flight.

PX4's simulator logs the truth beside the estimate. The difference, as it was in that flight, is given to three
simulated vehicles that are otherwise perfect: the plant of the plant file, no noise, no wind. What is left in their
radius, judged by their estimates as a flight's verdicts are, is the wander's; flown with a constant error it is what
the controller leaves by itself.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from pyulog import ULog

from agents.outputs import TickOutput
from estimation.state import POSITION, Telemetry, Vector
from gcs.flight.simulated import simulated_vehicles
from gcs.mission.file import load_mission
from sitl.simulation.simulation import NetworkModel, SimulatedVehicle, simulate
from tests.experiments.arguments import parser

MISSION, SETTLED_S, ALOFT_M = "px4-trio", 60.0, 5.0


class Wander(NamedTuple):
    """How far a vehicle's estimate was off the truth, from when it was up: times (T,), position and velocity (T, 2).

    In the mission's axes, east and north, less the mean position error: that is a shift of the whole flight.
    """

    time_s: Vector
    position_m: Vector
    velocity_m_s: Vector

    def at(self, time_s: float) -> tuple[Vector, Vector]:
        """Return the error of position and velocity (2,) at a time."""
        place = int(np.searchsorted(self.time_s, time_s).clip(0, len(self.time_s) - 1))
        return self.position_m[place], self.velocity_m_s[place]


def wander_of(path: Path) -> Wander:
    """Read the wander from a log of PX4's simulator."""
    topics = ("vehicle_local_position", "vehicle_local_position_groundtruth")
    found = {topic.name: topic.data for topic in ULog(str(path), list(topics)).data_list}
    estimate, truth = (found[topic] for topic in topics)
    time_s, truth_s = estimate["timestamp"] * 1e-6, truth["timestamp"] * 1e-6
    off = {key: estimate[key] - np.interp(time_s, truth_s, truth[key]) for key in ("x", "y", "vx", "vy")}
    aloft = np.interp(time_s, truth_s, -truth["z"]) > ALOFT_M
    position_m = np.stack([off["y"], off["x"]], axis=1)[aloft]
    velocity_m_s = np.stack([off["vy"], off["vx"]], axis=1)[aloft]
    return Wander(time_s[aloft] - time_s[aloft][0], position_m - position_m.mean(axis=0), velocity_m_s)


def wander_into(vehicle: SimulatedVehicle[TickOutput], wander: Wander) -> None:
    """Let a simulated vehicle's estimate be off as that of the log was."""

    def off_m(at_s: float) -> tuple[float, float]:
        x, y = wander.at(at_s)[0].tolist()
        return x, y

    def sample(at_s: float) -> Telemetry:
        position_off_m, velocity_off_m_s = wander.at(at_s)
        x, y = (vehicle.motion[POSITION] + position_off_m).tolist()
        x_rate, y_rate = (vehicle.motion[2:] + velocity_off_m_s).tolist()
        return Telemetry(at_s, (x, y, 0.0), (x_rate, y_rate, 0.0))

    # Not a nature of its own: no other simulation flies errors out of a log.
    vars(vehicle).update(_off_m=off_m, _sample=sample)


def radius_rms_m(wanders: list[Wander]) -> Vector:
    """Fly, and return the radius error of each vehicle by its own estimate, rms after settling (V,)."""
    mission = load_mission(MISSION)
    vehicles = simulated_vehicles(mission, 0)
    for vehicle, wander in zip(vehicles, wanders, strict=True):
        wander_into(vehicle, wander)
    duration_s = min(mission.mission.duration_s, *(float(wander.time_s[-1]) for wander in wanders))
    network = mission.network
    flight = simulate(
        vehicles,
        NetworkModel(network.range_m, network.delay_s, network.loss),
        rate_hz=mission.mission.rate_hz,
        duration_s=duration_s,
        seed=0,
        observe=lambda *_: None,
        progress=lambda _: None,
    )
    target_m = np.array([mission.target.motion.position_m(time_s) for time_s in flight.time_s.tolist()])
    errors = []
    for index, wander in enumerate(wanders):
        off_m = np.array([wander.at(time_s)[0] for time_s in flight.time_s.tolist()])
        away_m = np.linalg.norm(flight.motion[:, index, POSITION] + off_m - target_m, axis=1)
        errors.append((away_m - mission.encirclement.radius_m)[flight.time_s > SETTLED_S])
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=1)), dtype=np.float64)


def main(paths: list[Path]) -> None:
    """Print how the estimates wandered, and what that leaves in the radius."""
    wanders = [wander_of(path) for path in paths]
    for path, wander in zip(paths, wanders, strict=True):
        (x, y), (x_rate, y_rate) = wander.position_m.std(axis=0), wander.velocity_m_s.std(axis=0)
        print(f"{path}: off by {x:.3f} and {y:.3f} m (east, north; rms about the mean), {x_rate:.3f}, {y_rate:.3f} m/s")
    steady = [Wander(each.time_s, 0.0 * each.position_m, 0.0 * each.velocity_m_s) for each in wanders]
    for what, flown in (("with it", wanders), ("without", steady)):
        print(
            f"radius error {what}:", ", ".join(f"{each:.3f}" for each in radius_rms_m(flown)), "m rms by the estimate"
        )


if __name__ == "__main__":
    reader = parser("px4_wander", __doc__)
    reader.add_argument("logs", nargs=3, type=Path, metavar="ULG", help="log of each vehicle")
    main(reader.parse_args().logs)
