"""Validation of the profiles' plants against the flight, and when to identify a plant again."""

import numpy as np

from estimation.plant.model import Plant
from estimation.plant.watch import others, watch
from estimation.state import POSITION
from gcs.mission.mission import Mission, MissionVehicle
from gcs.report.evidence.flight import FlightEvidence, VehicleEvidence

AGAIN_SHARE = 0.7
"""Identify again where another plant leaves less than this share of the residual of the profile's plant (rms):
half of the variance. In closed loop, noise alone favours a softer plant: the drift of PX4's estimate gives 0.9."""


def plant_facts(mission: Mission, evidence: FlightEvidence) -> dict[str, str]:
    """Return the validation of the plant of each recorded vehicle's profile as text, by fact name."""
    return {
        f"plant of vehicle {each.vehicle_id}": _validation(mission.vehicle(each.vehicle_id), each)
        for each in evidence.vehicles
        if each.loop.time_s.size and each.samples.size
    }


def _validation(vehicle: MissionVehicle, evidence: VehicleEvidence) -> str:
    loop, plant = evidence.loop, vehicle.plant
    sent = [loop.time_s, loop.setpoint_m[:, POSITION]] + [loop.velocity_m_s[:, POSITION]] * (plant.feedforward > 0.0)
    watched, name = watch(plant, np.column_stack(sent), evidence.samples), f"'{vehicle.section.profile}'"
    if watched is None:
        return f"{name}: not enough excitation to validate the plant"
    left = f"{name}: residual {watched.unexplained_m:.2f} m rms over {watched.windows} windows"
    if watched.best_m >= AGAIN_SHARE * watched.unexplained_m:
        return f"{left}, best of {len(others(plant))} other plants {watched.best_m:.2f} m: valid for this flight"
    return (
        f"{left}, other plant {watched.best_m:.2f} m ({_numbers(watched.best, plant)}): identify again (cordon excite)"
    )


def _numbers(best: Plant, plant: Plant) -> str:
    text = f"a0 {best.x.a0_per_s2:.2f} 1/s², a1 {best.x.a1_per_s:.2f} 1/s, delay {best.delay_s:.2f} s"
    return text if best.feedforward == plant.feedforward else f"{text}, without velocity feed-forward"
