"""Simulated flights: a mission in one process with simulated time, as `cordon sim` flies it.

>>> import cordon
>>> mission = cordon.load("case2")
>>> flight = cordon.simulate(mission, seed=3, duration_s=20.0)
>>> flight
<Flight of case2: 20 s, vehicles 1, 2, 3, seed 3>
>>> flight.vehicles[2].position_m.shape, flight.vehicles[2].setpoint_m.shape
((201, 2), (201, 3))
>>> flight.metrics.verdicts.separation
True
>>> slow = cordon.Plant(cordon.PlantAxis(0.4, 0.9), cordon.PlantAxis(0.4, 0.9), delay_s=0.2)
>>> later = cordon.simulate(mission, duration_s=20.0, plants={2: slow})
>>> bool(later.vehicles[2].position_m[20, 0] < flight.vehicles[2].position_m[20, 0])  # after 2 s
True
"""

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from agents.control.task_planner import PlannerFactory
from agents.outputs import TickOutput
from cordon.channels import channels_of
from cordon.decisions import Decisions
from cordon.flight import Flight
from cordon.missions import load
from cordon.own_plants import with_plants
from cordon.target_path import TargetPath, with_target_path
from estimation.plant.model import Plant
from gcs.errors import InputError
from gcs.flight.simulated import fly_simulated
from gcs.mission.mission import Mission
from sitl.vehicle.plant_step import StepFunction

if TYPE_CHECKING:
    from gcs.flightlog.simulation import SimulationRecording

DURATION_MAX_S = 86400.0


def simulate(
    mission: Mission | str | Path,
    *,
    seed: int | None = None,
    duration_s: float | None = None,
    log: str | Path | None = None,
    planner: PlannerFactory | None = None,
    plants: Mapping[int, Plant | StepFunction] = MappingProxyType({}),
    target: TargetPath | None = None,
) -> Flight:
    """Fly a mission in simulated time; equal arguments give equal flights.

    - `mission`: a mission from `cordon.load`, or an argument of it.
    - `seed`, `duration_s` [s]: replace the mission's.
    - `log`: record the flight to this file (MCAP), which must not exist yet; not with a `planner`.
    - `planner`: creates the planner of each vehicle from its configuration, see `cordon.TaskPlanner`.
    - `plants`: the true plants of vehicles, by id: a `Plant`, or a step function, see `cordon.StepFunction`. The
      controllers still use the plants of the profiles.
    - `target`: the target's position over time, see `cordon.TargetPath`.

    Raises InputError with every fault; exceptions of planners end the flight.
    """
    mission = mission if isinstance(mission, Mission) else load(mission)
    flown_s = mission.mission.duration_s if duration_s is None else float(duration_s)
    drawn = mission.mission.seed if seed is None else seed
    _require_flyable(flown_s, drawn, log, planner)
    if target is not None:
        mission = with_target_path(mission, target, flown_s)
    mission, steps = with_plants(mission, plants)
    recording = None if log is None else _recording(mission, Path(log), drawn, flown_s)
    samples = round(flown_s * mission.mission.rate_hz) + 1
    decisions = {vehicle_id: Decisions.unknown(samples) for vehicle_id in mission.ids}

    def on_tick(tick: int, at: int, output: TickOutput) -> None:
        decisions[mission.ids[at]].note(tick, output)

    record = fly_simulated(mission, drawn, flown_s, lambda _: None, recording, planner, steps=steps, on_tick=on_tick)
    for each, tick_us in zip(decisions.values(), record.loop.tick_us.reshape(samples, -1).T, strict=True):
        each.tick_us[:] = tick_us
    return Flight(mission, record, channels_of(record, decisions))


def _require_flyable(duration_s: float, seed: int, log: str | Path | None, planner: PlannerFactory | None) -> None:
    faults = []
    if not (isfinite(duration_s) and 0.0 < duration_s <= DURATION_MAX_S):
        faults.append(f"duration_s: it must be more than 0 and at most {DURATION_MAX_S:g} s (given: {duration_s:g})")
    if seed < 0:
        faults.append(f"seed: it must not be negative (given: {seed})")
    if log is not None and planner is not None:
        faults.append("log: a flight with a custom planner cannot be recorded: leave log or planner out")
    if faults:
        raise InputError(faults)


def _recording(mission: Mission, log: Path, seed: int, duration_s: float) -> "SimulationRecording":
    from gcs.flight.simulation_log import simulation_recording  # noqa: PLC0415 - what writes logs is slow to import

    return simulation_recording(mission, log, seed, duration_s)
