"""Simulated flights of a mission that are observed at every tick of every vehicle."""

from collections.abc import Callable, Sequence

from agents.outputs import TickOutput
from gcs.flight.simulated import INPUTS, simulated_vehicles
from gcs.mission.mission import Mission
from sitl.simulation.simulation import NetworkModel, SimulatedFlight, SimulatedVehicle, simulate


def observed(
    mission: Mission,
    seed: int,
    observe: Callable[[int, int, TickOutput], None] = lambda *_: None,
    *,
    duration_s: float | None = None,
    vehicles: Sequence[SimulatedVehicle[TickOutput]] = (),
    network: NetworkModel | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> SimulatedFlight:
    """Fly a mission, by default with its own vehicles and network; `observe` takes tick, vehicle and output."""
    own = mission.network
    return simulate(
        vehicles or simulated_vehicles(mission, seed),
        network or NetworkModel(mission.range_m, own.delay_s, own.loss),
        rate_hz=mission.mission.rate_hz,
        duration_s=duration_s or mission.mission.duration_s,
        seed=seed,
        inputs=INPUTS,
        observe=observe,
        progress=progress,
    )
