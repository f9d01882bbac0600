"""Measure the effect of PX4's estimation errors on a ring, from the log of one px4-trio flight on PX4's simulator.

The simulator sends the truth in addition to the estimates. The recorded differences are applied to three otherwise
ideal simulated vehicles: the plant of the profile, no noise, no wind, a target that each sees relative to itself. PX4's
estimates act twice: in its telemetry, and in its control loops, where a velocity error acts as a disturbance. Each
error is also flown alone.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from agents.outputs import TickOutput
from estimation.state import MOTION, POSITION, VELOCITY, Sighting, Telemetry, Vector
from gcs.flight.simulated import INPUTS, simulated_vehicles
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Truth
from gcs.flightlog.run import mission_of
from gcs.mission.mission import Mission
from sitl.simulation.simulation import NetworkModel, SimulatedVehicle, simulate
from tests.experiments.arguments import parser

SETTLED_S, DELAYS_S = 60.0, np.arange(-0.1, 0.11, 0.01)


class Wander(NamedTuple):
    """The errors of an estimate: times since the first sample (T,), errors (T, 4) of [x y x' y']."""

    time_s: Vector
    error: Vector

    def at(self, time_s: float) -> Vector:
        """Return the error (4,) at a time."""
        place = int(np.searchsorted(self.time_s, time_s).clip(0, len(self.time_s) - 1))
        return np.asarray(self.error[place])

    def part(self, *, position: bool, velocity: bool) -> "Wander":
        """Return the same with only one kind of error."""
        return Wander(self.time_s, self.error * np.repeat([position, velocity], 2))


class Ring(NamedTuple):
    """The rms radius errors of a flight (V,), true and estimated [m], and the spacing errors [deg]."""

    true_m: Vector
    seen_m: Vector
    spacing_deg: float


def wander_of(log: FlightLog, vehicle_id: int) -> Wander:
    """Read the estimation errors of a vehicle, at the delay between truth and telemetry that minimises them."""
    truth, telemetry = log.of_kind(vehicle_id, Truth), log.of_kind(vehicle_id, Telemetry)
    (true_s, true), (time_s, reported) = _motions(truth), _motions(telemetry)
    inside = (time_s > true_s[0] - DELAYS_S[0]) & (time_s < true_s[-1] - DELAYS_S[-1])
    time_s, reported = time_s[inside], reported[inside]

    def error(delay_s: float) -> Vector:
        return np.asarray(reported - np.column_stack([np.interp(time_s + delay_s, true_s, each) for each in true.T]))

    least = min((error(delay_s) for delay_s in DELAYS_S), key=lambda each: float(each[:, POSITION].std()))
    return Wander(time_s - time_s[0], least - least.mean(axis=0))


def _motions(samples: Iterable[Truth | Telemetry]) -> tuple[Vector, Vector]:
    rows = np.array([(each.time_s, *each.position_m[:2], *each.velocity_m_s[:2]) for each in samples])
    return rows[:, 0], rows[:, 1:]


def wander_into(vehicle: SimulatedVehicle[TickOutput], wander: Wander) -> None:
    """Apply the logged errors to a simulated vehicle's estimate."""
    plant, sense = vehicle._model.plant, vehicle.sense

    def off_m(at_s: float) -> tuple[float, float]:
        error = wander.at(at_s)
        # In x'' = a0 (X - x) - a1 x' a velocity error is equivalent to a setpoint error of a1 / a0 times it.
        x, y = (error[POSITION] + plant.a1_per_s / plant.a0_per_s2 * error[VELOCITY]).tolist()
        return x, y

    def sample(at_s: float) -> Telemetry:
        x, y, x_rate, y_rate = (np.array(vehicle.motion) + wander.at(at_s)).tolist()
        return Telemetry(at_s, (x, y, 0.0), (x_rate, y_rate, 0.0))

    def sensed(now_s: float) -> tuple[list[Telemetry], Sighting | None]:
        samples, sighting = sense(now_s)
        if sighting is None:
            return samples, None
        x, y = (np.array(sighting.position_m) + wander.at(sighting.time_s)[POSITION]).tolist()
        return samples, replace(sighting, position_m=(x, y))

    # Only this experiment simulates errors from a log, so sitl has no model of it.
    vars(vehicle).update(_off_m=off_m, _sample=sample, sense=sensed)


def flown(mission: Mission, wanders: list[Wander]) -> Ring:
    """Fly, and return the figures after settling."""
    vehicles = simulated_vehicles(mission, 0)
    for vehicle, wander in zip(vehicles, wanders, strict=True):
        wander_into(vehicle, wander)
    rate_hz, network = mission.mission.rate_hz, mission.network
    duration_s = min(mission.mission.duration_s, *(float(wander.time_s[-1]) for wander in wanders))
    seen_m = np.full((round(duration_s * rate_hz) + 1, len(vehicles)), np.nan)

    def observe(tick: int, vehicle: int, output: TickOutput) -> None:
        situation = output.status.situation
        if situation is not None and situation.target is not None:
            off_m = situation.own.mean[MOTION][POSITION] - situation.target.mean[POSITION]
            seen_m[tick, vehicle] = np.hypot(*off_m)

    flight = simulate(
        vehicles,
        NetworkModel(network.range_m, network.delay_s, network.loss),
        rate_hz=rate_hz,
        duration_s=duration_s,
        seed=0,
        inputs=INPUTS,
        observe=observe,
        progress=lambda _: None,
    )
    target_m = np.array([mission.target.motion.position_m(time_s) for time_s in flight.time_s.tolist()])
    settled = flight.time_s > SETTLED_S
    away_m = (flight.motion[:, :, POSITION] - target_m[:, None])[settled]
    ring_m = mission.encirclement.radius_m
    bearings_deg = np.sort(np.degrees(np.arctan2(away_m[..., 1], away_m[..., 0])), axis=1)
    spacing_deg = np.diff(bearings_deg, axis=1, append=bearings_deg[:, :1] + 360.0) - 360.0 / len(vehicles)
    return Ring(
        _rms(np.linalg.norm(away_m, axis=2) - ring_m),
        _rms(seen_m[settled] - ring_m),
        float(np.sqrt(np.mean(spacing_deg**2))),
    )


def _rms(errors: Vector) -> Vector:
    return np.asarray(np.sqrt(np.nanmean(np.square(errors), axis=0)))


def main(path: Path) -> None:
    """Print the estimation errors, and the effect of each on the ring."""
    log = read_log(path)
    mission = mission_of(log)
    wanders = [wander_of(log, vehicle_id) for vehicle_id in mission.ids]
    for vehicle_id, wander in zip(mission.ids, wanders, strict=True):
        x, y, x_rate, y_rate = wander.error.std(axis=0)
        print(f"vehicle {vehicle_id}: off by {x:.3f}, {y:.3f} m and {x_rate:.3f}, {y_rate:.3f} m/s (east, north)")
    common = Wander(wanders[0].time_s, wanders[0].error)
    for what, each in (
        ("all errors", wanders),
        ("of the position", [wander.part(position=True, velocity=False) for wander in wanders]),
        ("of the velocity", [wander.part(position=False, velocity=True) for wander in wanders]),
        ("vehicle 1's in all", [common] * len(wanders)),
        ("none", [wander.part(position=False, velocity=False) for wander in wanders]),
    ):
        ring = flown(mission, each)
        true, seen = (", ".join(f"{radius:.3f}" for radius in radii) for radii in (ring.true_m, ring.seen_m))
        print(f"{what}: radius error {true} m rms by truth, {seen} as seen; spacing {ring.spacing_deg:.2f} deg rms")


if __name__ == "__main__":
    reader = parser("px4_wander", __doc__)
    reader.add_argument("log", type=Path, metavar="LOG", help="log of a flight whose simulators sent their truth")
    main(reader.parse_args().log)
