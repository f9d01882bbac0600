"""Fly a mission in one process with simulated time: `cordon sim`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np

from agents.core import VehicleCore
from agents.outputs import TickOutput
from agents.settings.config import AgentConfig
from estimation.state import POSITION, VELOCITY
from gcs.flightlog.simulation import SimulationRecording
from gcs.metrics.record import (
    FlightEvent,
    FlightRecord,
    GuardTally,
    LoopStatistics,
    VehicleTrack,
    in_order,
)
from gcs.mission.mission import Mission
from gcs.mission.simulation import simulated_imperfections, target_sensor
from sitl.simulation.absence import Absence
from sitl.simulation.simulation import (
    NetworkModel,
    SimulatedFlight,
    SimulatedVehicle,
    TelemetryNoise,
    simulate,
)
from sitl.vehicle.imperfections import Imperfections


def fly_simulated(
    mission: Mission,
    seed: int,
    duration_s: float,
    progress: Callable[[float], None],
    recording: SimulationRecording | None = None,
) -> FlightRecord:
    """Fly the mission for `duration_s` of simulated time, telling `progress`; the same seed gives the same flight."""
    rate_hz = mission.mission.rate_hz
    tactics = np.full((round(duration_s * rate_hz) + 1, len(mission.vehicles)), "unknown", dtype="<U16")
    events: list[FlightEvent] = []

    guard = GuardTally()

    def observe(tick: int, vehicle: int, output: TickOutput) -> None:
        status = output.status
        tactics[tick, vehicle] = status.tactic.value
        guard.note(status.guarded)
        events.extend(FlightEvent(note.time_s, status.vehicle_id, note.kind, note.text) for note in status.notes)
        if recording is not None and vehicle == len(mission.vehicles) - 1:
            recording.advance((tick + 1) / rate_hz)

    network = NetworkModel(mission.network.range_m, mission.network.delay_s, mission.network.loss)
    began_s = perf_counter()
    flight = simulate(
        simulated_vehicles(mission, seed, VehicleCore if recording is None else recording.core),
        network,
        rate_hz=rate_hz,
        duration_s=duration_s,
        seed=seed,
        observe=observe,
        progress=progress,
    )
    wall_time_s = perf_counter() - began_s
    if recording is not None:
        recording.end(mission.ids, flight, wall_time_s)
    return replace(_record(mission, seed, flight, tactics, guard, wall_time_s), events=in_order(events))


def simulated_vehicles(
    mission: Mission,
    seed: int,
    new_core: Callable[[AgentConfig], VehicleCore] = VehicleCore,
    absences: Sequence[Absence] = (),
    natures: Mapping[int, Imperfections] | None = None,
) -> list[SimulatedVehicle[TickOutput]]:
    """Return the mission's vehicles with their cores, at rest where they start, and at work from time 0.

    But for their `absences`: an agent that comes back is a new one, which knows when the mission started. Without
    `natures`, by vehicle, all have the one that the mission's `[simulation]` says.
    """

    def at_work(config: AgentConfig) -> VehicleCore:
        core = new_core(config)
        core.start(0.0)
        return core

    simulation = mission.simulation
    noise = TelemetryNoise(simulation.position_noise_m, simulation.velocity_noise_m_s)
    imperfections = simulated_imperfections(mission)
    vehicles = []
    for vehicle in mission.vehicles:
        begin = partial(at_work, mission.agent_config(vehicle))
        vehicles.append(
            SimulatedVehicle(
                begin(),
                vehicle.true_plant,
                vehicle.section.start_m,
                vehicle.section.altitude_m,
                target_sensor(mission, vehicle.id, 0.0, seed),
                noise,
                simulation.wind_m_s2,
                seed=(seed, 2, vehicle.id),
                imperfections=natures[vehicle.id] if natures else imperfections,
                absences=[absence for absence in absences if absence.vehicle_id == vehicle.id],
                new_core=begin,
                climbs=mission.encirclement.altitude == "target",
            )
        )
    return vehicles


def _record(
    mission: Mission,
    seed: int,
    flight: SimulatedFlight,
    tactics: "np.ndarray[tuple[int, int], np.dtype[np.str_]]",
    guard: GuardTally,
    wall_time_s: float,
) -> FlightRecord:
    target = mission.target.motion
    tracks = tuple(
        VehicleTrack(
            vehicle_id,
            flight.motion[:, index, POSITION],
            flight.motion[:, index, VELOCITY],
            tactics[:, index],
        )
        for index, vehicle_id in enumerate(mission.ids)
    )
    return FlightRecord(
        mission=mission.mission.name,
        seed=seed,
        source="simulation",
        reference="truth",
        time_s=flight.time_s,
        target_position_m=np.array([target.position_m(time_s) for time_s in flight.time_s.tolist()]),
        target_velocity_m_s=np.array([target.velocity_at_m_s(time_s) for time_s in flight.time_s.tolist()]),
        vehicles=tracks,
        loop=LoopStatistics(mission.mission.rate_hz, flight.tick_us.size, 0, flight.tick_us.ravel()),
        wall_time_s=wall_time_s,
        guard=guard,
    )
