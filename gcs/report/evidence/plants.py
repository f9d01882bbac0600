"""Whether the profiles' plants still explain how the vehicles flew, and when to identify one again."""

import numpy as np

from estimation.plant.model import Plant
from estimation.plant.watch import others, watch
from estimation.state import POSITION
from gcs.mission.mission import Mission, MissionVehicle
from gcs.report.evidence.flight import FlightEvidence, VehicleEvidence

AGAIN_SHARE = 0.7
"""Where another plant leaves less than this of what the profile's leaves (rms), it is time to identify again: half of
the variance. In closed loop noise alone makes a somewhat softer plant look better: PX4's wander makes that 0.9."""


def plant_facts(mission: Mission, evidence: FlightEvidence) -> dict[str, str]:
    """Return a sentence on each recorded vehicle's plant, by its profile's name."""
    return {
        f"plant of vehicle {each.vehicle_id}": _told(mission.vehicle(each.vehicle_id), each)
        for each in evidence.vehicles
        if each.loop.time_s.size and each.samples.size
    }


def _told(vehicle: MissionVehicle, evidence: VehicleEvidence) -> str:
    loop, plant = evidence.loop, vehicle.plant
    sent = [loop.time_s, loop.setpoint_m[:, POSITION]] + [loop.velocity_m_s[:, POSITION]] * (plant.feedforward > 0.0)
    watched, name = watch(plant, np.column_stack(sent), evidence.samples), f"'{vehicle.section.profile}'"
    if watched is None:
        return f"{name}; too little was asked of the vehicle to tell whether it still explains it"
    left = f"{name} leaves {watched.unexplained_m:.2f} m unexplained (rms over {watched.windows} windows)"
    if watched.best_m >= AGAIN_SHARE * watched.unexplained_m:
        return f"{left}, the best of {len(others(plant))} others {watched.best_m:.2f} m: it explains the flight"
    return (
        f"{left}, another {watched.best_m:.2f} m ({_numbers(watched.best, plant)}): identify it again (cordon excite)"
    )


def _numbers(best: Plant, plant: Plant) -> str:
    words = f"a0 {best.x.a0_per_s2:.2f} 1/s², a1 {best.x.a1_per_s:.2f} 1/s, delay {best.delay_s:.2f} s"
    return words if best.feedforward == plant.feedforward else f"{words}, velocities without effect"
