"""Compare the two planners with cordon's: the same plants, drawn about the profile's, and the same noise for each."""

import argparse

import numpy as np
from cyclic_pursuit import CyclicPursuit
from nmpc import Nmpc

import cordon

near = {"start_m": [12.0, 0.0], "velocity_m_s": [0.1, 0.0]}


def plants(draw):
    """Plants with stiffness and damping 0.7 to 1.3 times those of the profile."""
    drawn = {}
    for vehicle in draw.mission.vehicles:
        a0, a1 = draw.random.uniform(0.7, 1.3, (2, 2)) * [vehicle.plant.a0_per_s2, vehicle.plant.a1_per_s]
        drawn[vehicle.id] = cordon.Plant(*(cordon.PlantAxis(*axis) for axis in np.transpose([a0, a1]).tolist()))
    return drawn


def radius_rms_m(flight):
    """The radius error of all vehicles in the second half of the flight, rms."""
    late = flight.record.time_s > flight.record.time_s[-1] / 2.0
    errors_m = [each.radius_m[late] - flight.mission.encirclement.radius_m for each in flight.vehicles.values()]
    return np.sqrt(np.mean(np.square(errors_m)))


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--runs", type=int, default=67, help="draws; each is flown with every planner")
found = cordon.sweep(
    cordon.load("case2-field", {"target": near, "decision.distance_max_m": 20.0}),
    runs=parser.parse_args().runs,
    duration_s=120.0,
    plants=plants,
    planners={"cordon": None, "cyclic pursuit": CyclicPursuit, "NMPC": Nmpc},
    metrics={"radius_rms_m": radius_rms_m},
)
metrics = ["radius_rms_m", "ring.spacing_error_rms_deg", "ring.settling_time_s", "closest_approach_m"]
print(found.summary(metrics=metrics))
