"""Fly a mission in one process with simulated time: `cordon sim`."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import starmap
from time import perf_counter
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from agents.control.plan import PlannerError, PlannerFactory
from agents.core import VehicleCore
from agents.flight_end import FlightEnd
from agents.inputs import Message, Presence, Start
from agents.outputs import CoreStatus, TickOutput
from agents.settings.config import AgentConfig
from agents.tactics import NO_TACTIC, Tactic
from estimation.state import POSITION, VELOCITY, Vector
from gcs.errors import InputError
from gcs.flight.simulated_events import SimulatedEvents
from gcs.metrics.ending import VehicleEnding
from gcs.metrics.record import (
    GAP_MAX_S,
    FlightEvent,
    FlightRecord,
    GuardTally,
    LoopStatistics,
    TargetPath,
    VehicleTrack,
    in_order,
    path_velocity_m_s,
)
from gcs.metrics.targets import ring_targets_of, targets_of
from gcs.mission.mission import Mission, MissionVehicle, TargetSection
from gcs.mission.simulation import flown_target, simulated_imperfections, target_sensor
from sitl.reacting_target import FlownTarget, Reaction
from sitl.simulation.simulation import (
    Absence,
    Inputs,
    NetworkModel,
    SimulatedFlight,
    SimulatedVehicle,
    TelemetryNoise,
    VehicleModel,
    simulate,
)
from sitl.vehicle.imperfections import Imperfections
from sitl.vehicle.plant_step import Motion, StepFunction

if TYPE_CHECKING:
    from gcs.flightlog.recorder import SimulationRecording


INPUTS = Inputs(Message, Presence)
"""Of the agents' cores, for the simulation."""
OnTick = Callable[[int, int, TickOutput], None]
_COMES_DOWN = (Tactic.RETURN_AND_LAND, Tactic.LAND)


def fly_simulated(
    mission: Mission,
    seed: int,
    duration_s: float,
    progress: Callable[[float], None],
    recording: "SimulationRecording | None" = None,
    planner: PlannerFactory | None = None,
    *,
    steps: Mapping[int, StepFunction] = MappingProxyType({}),
    reaction: Reaction | None = None,
    events: SimulatedEvents | None = None,
    on_tick: OnTick = lambda *_: None,
) -> FlightRecord:
    """Fly the mission for `duration_s` of simulated time; the same seed gives the same flight.

    Vehicles in reserve stay on the ground, and are not in the record.

    `progress` is called with the simulated time flown [s], `on_tick` with the number of each tick, the vehicle's place
    in line and its output. `planner` creates each vehicle's planner, see `TaskPlanner`; its faults
    raise InputError. `steps`: see `simulated_vehicles`. A `reaction` moves the target in
    place of the mission's. `events` are of this flight only.
    """
    mission = mission.without_reserves
    rate_hz, count = mission.mission.rate_hz, len(mission.vehicles)
    observed, target = _Observed(round(duration_s * rate_hz) + 1, count, rate_hz), flown_target(mission, reaction)

    def observe(tick: int, vehicle: int, output: TickOutput) -> None:
        observed.note(tick, vehicle, output.status)
        on_tick(tick, vehicle, output)

    def move_target(now_s: float, motions: Sequence[Motion]) -> None:
        if target is not None:
            target.advance(now_s, motions)
            if recording is not None:
                recording.target(now_s, target.path_m[-1])

    def intervene(tick: int, now_s: float) -> NetworkModel:
        if recording is not None:
            recording.advance(now_s)
        observed.note_absences(tick, [vehicle.present for vehicle in vehicles])
        return happens.act(now_s, vehicles)

    happens = events or SimulatedEvents(mission)
    new_core = partial(VehicleCore if recording is None else recording.core, planner=planner)
    began_s = perf_counter()
    with _planner_faults():
        vehicles = simulated_vehicles(mission, seed, new_core, happens.absences, steps=steps, target=target)
        flight = simulate(
            vehicles,
            happens.network,
            rate_hz=rate_hz,
            duration_s=duration_s,
            seed=seed,
            inputs=INPUTS,
            observe=observe,
            progress=progress,
            move_target=move_target,
            intervene=intervene,
        )
    wall_time_s = perf_counter() - began_s
    if recording is not None:
        recording.end(observed.endings(mission.ids), flight, wall_time_s)
    return _record(mission, seed, flight, target, observed, wall_time_s)


@contextmanager
def _planner_faults() -> Iterator[None]:
    """Turn the faults of a plug-in planner into InputError."""
    try:
        yield
    except PlannerError as error:
        raise InputError([f"planner: {error}"]) from error


class _Observed:
    """The vehicles' decisions: tactics and rings (T, N), events, the guard's interventions, and the latest status."""

    def __init__(self, ticks: int, vehicles: int, rate_hz: float) -> None:
        self._gap_ticks = int(GAP_MAX_S * rate_hz + 1e-9)
        self.tactics = np.full((ticks, vehicles), NO_TACTIC, dtype="<U16")
        self.rings = np.zeros((ticks, vehicles), dtype=np.intp)
        self.events: list[FlightEvent] = []
        self.guard = GuardTally()
        self._latest: list[CoreStatus | None] = [None] * vehicles

    def note(self, tick: int, vehicle: int, status: CoreStatus) -> None:
        """Add one tick of one vehicle; its tactic and ring hold until a later tick changes them."""
        latest, self._latest[vehicle] = self._latest[vehicle], status
        if latest is None or status.tactic is not latest.tactic:
            self.tactics[tick:, vehicle] = status.tactic.value
        if status.ring != self.rings[tick, vehicle]:
            self.rings[tick:, vehicle] = status.ring
        self.guard.note(status.guarded)
        if status.notes:
            self.events += [FlightEvent.of(status.vehicle_id, note) for note in status.notes]

    def note_absences(self, tick: int, present: Sequence[bool]) -> None:
        """Note which vehicles have an agent at a tick: the tactic of others is unknown, as soon as it is in a log."""
        for vehicle, is_present in enumerate(present):
            if not is_present and self._latest[vehicle] is not None:
                self.tactics[tick + self._gap_ticks :, vehicle] = NO_TACTIC
                self._latest[vehicle] = None

    def endings(self, vehicle_ids: Sequence[int]) -> tuple[VehicleEnding, ...]:
        """Return how the flights ended: in the air at the end, earlier by a failsafe landing, or without agent."""
        return tuple(starmap(_ending, zip(vehicle_ids, self._latest, strict=True)))


def _ending(vehicle_id: int, status: CoreStatus | None) -> VehicleEnding:
    if status is None:
        return VehicleEnding(vehicle_id, FlightEnd.WATCHDOG, "its agent was absent when the simulation ended")
    if status.alert and status.tactic in _COMES_DOWN:
        return VehicleEnding(vehicle_id, FlightEnd.FAILSAFE, status.alert)
    return VehicleEnding(vehicle_id, FlightEnd.SIMULATED, "in the air when the simulation ended")


def simulated_vehicles(
    mission: Mission,
    seed: int,
    new_core: Callable[[AgentConfig], VehicleCore] = VehicleCore,
    absences: Sequence[Absence] = (),
    imperfections: Mapping[int, Imperfections] | None = None,
    steps: Mapping[int, StepFunction] = MappingProxyType({}),
    target: FlownTarget | None = None,
) -> list[SimulatedVehicle[TickOutput]]:
    """Return the mission's vehicles with their cores, at rest at their starts, active from time 0.

    During `absences` a vehicle has no agent; a new agent follows, with the mission's start time.
    `imperfections` are by vehicle, by default those of the mission's `[simulation]` for all. `steps` are
    the dynamics of vehicles that do not move by the equation of a plant. `target` is one that reacts.
    """
    common = simulated_imperfections(mission)
    return [
        _simulated_vehicle(
            mission,
            vehicle,
            seed,
            new_core,
            [absence for absence in absences if absence.vehicle_id == vehicle.id],
            imperfections[vehicle.id] if imperfections else common,
            steps.get(vehicle.id),
            target,
        )
        for vehicle in mission.vehicles
    ]


def _simulated_vehicle(
    mission: Mission,
    vehicle: MissionVehicle,
    seed: int,
    new_core: Callable[[AgentConfig], VehicleCore],
    absences: Sequence[Absence],
    imperfections: Imperfections,
    step: StepFunction | None,
    target: FlownTarget | None,
) -> SimulatedVehicle[TickOutput]:
    config = mission.agent_config(vehicle)

    def started() -> VehicleCore:
        core = new_core(config)
        core.take(Start(0.0))
        return core

    simulation = mission.simulation
    model = VehicleModel(
        vehicle.true_plant,
        vehicle.section.start_m,
        vehicle.section.altitude_m,
        seed=(seed, 2, vehicle.id),
        noise=TelemetryNoise(simulation.position_noise_m, simulation.velocity_noise_m_s),
        disturbance_m_s2=simulation.wind_m_s2,
        imperfections=imperfections,
        absences=absences,
        climbs=any(each.encirclement.altitude == "target" or each.encirclement.has_heights for each in mission.alone),
        step=step,
    )
    return SimulatedVehicle(model, started(), target_sensor(mission, vehicle.id, 0.0, seed, target), started)


def _record(
    mission: Mission,
    seed: int,
    flight: SimulatedFlight,
    target: FlownTarget | None,
    observed: _Observed,
    wall_time_s: float,
) -> FlightRecord:
    own = _target_path(mission, mission.target, flight.time_s, target)
    has_rings = len(mission.rings) > 1
    tracks = tuple(
        VehicleTrack(
            vehicle_id,
            flight.motion[:, index, POSITION],
            flight.motion[:, index, VELOCITY],
            observed.tactics[:, index],
            altitude_m=flight.altitude_m[:, index],
            ring=observed.rings[:, index] if has_rings else None,
        )
        for index, vehicle_id in enumerate(mission.ids)
    )
    return FlightRecord(
        mission=mission.mission.name,
        seed=seed,
        source="simulation",
        reference="truth",
        time_s=flight.time_s,
        target_position_m=own.position_m,
        target_velocity_m_s=own.velocity_m_s,
        vehicles=tracks,
        loop=LoopStatistics(mission.mission.rate_hz, flight.tick_us.size, 0, flight.tick_us.ravel()),
        wall_time_s=wall_time_s,
        guard=observed.guard,
        events=in_order(observed.events),
        endings=observed.endings(mission.ids),
        targets=tuple(_target_path(mission, each, flight.time_s, target) for each in targets_of(mission)),
        ring_targets=ring_targets_of(mission),
    )


def _target_path(mission: Mission, target: TargetSection, time_s: Vector, flown: FlownTarget | None) -> TargetPath:
    """Return a target's true motion; the one that reacts is that of the first ring."""
    if flown is None or target != mission.target:
        return TargetPath(*target.motion.over(time_s))
    path_m = np.array(flown.path_m)
    return TargetPath(path_m, path_velocity_m_s(time_s, path_m))
