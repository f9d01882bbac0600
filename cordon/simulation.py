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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil, hypot, isfinite, nan
from numbers import Integral, Real
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

from agents.control.plan import PlannerFactory
from agents.outputs import TickOutput
from cordon.channels import channels_of
from cordon.decisions import Decisions
from cordon.flight import Flight
from estimation.plant.model import Plant
from gcs.errors import InputError
from gcs.flight.simulated import fly_simulated
from gcs.flight.simulated_events import Links, SimulatedEvents, SimulationEvent
from gcs.mission.file import load_mission
from gcs.mission.mission import PARTS_MAX, TARGET_SPEED_MAX_M_S, Mission
from gcs.mission.planner import ChosenPlanner, given_planner, planner_of
from sitl.reacting_target import Reaction
from sitl.vehicle.plant_step import Motion, Pair, StepFunction

if TYPE_CHECKING:
    from gcs.flightlog.recorder import SimulationRecording


def load(mission: str | Path, overrides: Mapping[str, object] = MappingProxyType({})) -> Mission:
    """Return a bundled mission by its name, or a mission from a file.

    `overrides` replace values of the file, by their paths or nested. `Mission.replace` does the same for a loaded
    mission. Keys are described in docs/mission-keys.md; their names end with the unit. Raises InputError with every
    fault.

    >>> mission = load("case2", {"encirclement.radius_m": 12.0, "vehicles[0].altitude_m": 9.0})
    >>> mission.encirclement.radius_m, mission.vehicle(1).section.altitude_m
    (12.0, 9.0)
    >>> mission.replace(target={"velocity_m_s": (0.0, 0.2)}, vehicles={2: {"altitude_m": 7.0}}).target.velocity_m_s
    (0.0, 0.2)
    >>> load("case2", {"encirclement.radius": 12.0})
    Traceback (most recent call last):
    ...
    gcs.mission.file.MissionError: encirclement.radius: unknown key; did you mean 'radius_m'? [set, not in the file]
    """
    if not isinstance(mission, str | Path):
        raise InputError([f"mission: {mission!r}: give the name of a bundled mission, or a file"])
    if not isinstance(overrides, Mapping):
        example = '{"encirclement.radius_m": 12.0}'
        raise InputError([f"overrides: {overrides!r}: give a mapping, such as {example}"])
    return load_mission(str(mission), overrides)


def finite_numbers(returned: object, names: tuple[str, ...], of: str) -> tuple[float, ...]:
    """Return a function's result as finite numbers, one for each name; raises InputError for anything else."""
    try:
        numbers = tuple(map(float, returned))  # type: ignore[call-overload]  # anything, until here
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != len(names) or not all(map(isfinite, numbers)):
        raise InputError([f"{of} returned {returned!r}: return ({', '.join(names)}), finite numbers"])
    return numbers


def with_plants(
    mission: Mission, plants: Mapping[int, Plant | StepFunction]
) -> tuple[Mission, dict[int, StepFunction]]:
    """Return the mission with these true plants, and the step functions among them, by vehicle; raises InputError.

    The vehicles' controllers still use the plants of their profiles.
    """
    if not isinstance(plants, Mapping):
        raise InputError([f"plants: {plants!r}: give plants by vehicle, such as {{{mission.ids[0]}: plant}}"])
    known = ", ".join(map(str, mission.ids))
    faults = [
        f"plants: the mission has no vehicle {each!r} (it has {known})" for each in plants if each not in mission.ids
    ]
    faults += [
        f"plants: that of vehicle {vehicle_id} is {plant!r}: give a cordon.Plant, or a step function"
        for vehicle_id, plant in cast(Mapping[int, object], plants).items()
        if not (isinstance(plant, Plant) or callable(plant))
    ]
    if faults:
        raise InputError(faults)
    linear = {vehicle_id: plant for vehicle_id, plant in plants.items() if isinstance(plant, Plant)}
    vehicles = tuple(
        replace(vehicle, true_plant=linear.get(vehicle.id, vehicle.true_plant)) for vehicle in mission.vehicles
    )
    steps = {
        vehicle_id: _checked(vehicle_id, plant) for vehicle_id, plant in plants.items() if not isinstance(plant, Plant)
    }
    return replace(mission, vehicles=vehicles), steps


_FAR_M, _FAST_M_S = 1e5, 1e3
"""Beyond these a vehicle's own dynamics have diverged: nothing of the flight means anything from there on."""


def _checked(vehicle_id: int, step: StepFunction) -> StepFunction:
    """Return a step function that raises InputError if the result is not a motion, or has diverged."""
    flown_s = 0.0

    def checked(motion: Motion, aim_m: Pair, disturbance_m_s2: Pair, step_s: float) -> Motion:
        nonlocal flown_s
        flown_s += step_s
        returned = step(motion, aim_m, disturbance_m_s2, step_s)
        of = f"plants: the step of vehicle {vehicle_id} at {flown_s:.2f} s"
        x, y, x_rate, y_rate = finite_numbers(returned, ("x", "y", "x'", "y'"), of)
        if max(abs(x), abs(y)) > _FAR_M or max(abs(x_rate), abs(y_rate)) > _FAST_M_S:
            away = f"{hypot(x, y):.3g} m from the origin with {hypot(x_rate, y_rate):.3g} m/s"
            raise InputError([f"{of} diverged: the vehicle is {away}"])
        return x, y, x_rate, y_rate

    return checked


TargetPath = Callable[[float], tuple[float, float]]
"""The target's path: from the mission time [s] to its position (x, y) in the mission frame [m].

The target moves straight from its position at one tick to that at the next; in flights of more than 1000 ticks, from
every second, third, ... tick to the next. At the end it stays at its last position.
"""


@dataclass(frozen=True, slots=True)
class ReactingTarget:
    """A target that reacts to the vehicles: `position(t, team)` returns its position (x, y) in the mission frame [m].

    It is called once a tick, in order of mission time `t` [s]; `team` holds the vehicles' true motions [x y x' y'] by
    id. The target moves at 20 m/s at most. A function with state serves one flight. The flight's mission has
    `target.source = "external"`: its motion is a plan only. The path flown is in the log.
    """

    position: Callable[[float, Mapping[int, Motion]], tuple[float, float]]


def with_reacting_target(mission: Mission, target: ReactingTarget) -> tuple[Mission, Reaction]:
    """Return the mission with a target whose path it does not state, and the checked reaction of one flight.

    Raises InputError, also for a target of the mission that reacts by itself; the reaction raises it during the flight.
    """
    _require_one_planned_target(mission)
    step_s = 1.0 / mission.mission.rate_hz
    before_m: Pair | None = None

    def checked(time_s: float, team: Mapping[int, Motion]) -> Pair:
        nonlocal before_m
        place_m = _place(target.position(time_s, team), time_s)
        if before_m is not None:
            _speed_m_s(time_s - step_s, before_m, place_m, step_s)
        before_m = place_m
        return place_m

    return mission.replace(target={"source": "external"}), checked


def _require_one_planned_target(mission: Mission) -> None:
    if mission.targets:
        raise InputError([f"target: the mission has {len(mission.targets)} targets: give one with a single [target]"])
    if mission.target.evades is not None:
        raise InputError(["target: the mission's own target reacts ([target.evades]): give a mission without it"])


def with_target_path(mission: Mission, path: TargetPath, duration_s: float) -> Mission:
    """Return the mission with a simulated target that follows the path until `duration_s`, and stays there.

    The path is stored as straight `legs` of the mission, so that a log of the flight contains it. Raises InputError,
    also for a target above the maximum speed, and for one of the mission that reacts.
    """
    _require_one_planned_target(mission)
    ticks = max(round(duration_s * mission.mission.rate_hz), 1)
    stride = ceil(ticks / PARTS_MAX)
    step_s = stride / mission.mission.rate_hz
    times_s = [index * step_s for index in range(ceil(ticks / stride) + 1)]
    points = [_place(path(time_s), time_s) for time_s in times_s]
    legs = [_leg(begin_s, *ends, step_s) for begin_s, ends in zip(times_s, pairwise(points), strict=False)]
    target = {"source": "simulated", "start_m": points[0], "velocity_m_s": (0.0, 0.0), "legs": legs, "rounds": 1}
    return mission.replace(target=target)


def _place(returned: object, time_s: float) -> Pair:
    x, y = finite_numbers(returned, ("x_m", "y_m"), f"target: the path at {time_s:g} s")
    return x, y


def _leg(begin_s: float, from_m: Pair, to_m: Pair, step_s: float) -> dict[str, object]:
    speed_m_s = _speed_m_s(begin_s, from_m, to_m, step_s)
    if speed_m_s == 0.0:
        return {"to_m": to_m, "speed_m_s": TARGET_SPEED_MAX_M_S, "pause_s": step_s}
    return {"to_m": to_m, "speed_m_s": speed_m_s}


def _speed_m_s(begin_s: float, from_m: Pair, to_m: Pair, step_s: float) -> float:
    """Return the speed of a target between two positions; raises InputError above the maximum."""
    speed_m_s = hypot(to_m[0] - from_m[0], to_m[1] - from_m[1]) / step_s
    if speed_m_s > TARGET_SPEED_MAX_M_S:
        most = f"targets move at {TARGET_SPEED_MAX_M_S:g} m/s at most"
        raise InputError([f"target: the path moves at {speed_m_s:.3g} m/s at {begin_s:g} s: {most}"])
    return speed_m_s


DURATION_MAX_S = 86400.0


def simulate(
    mission: Mission | str | Path,
    *,
    seed: int | None = None,
    duration_s: float | None = None,
    log: str | Path | None = None,
    planner: PlannerFactory | None = None,
    plants: Mapping[int, Plant | StepFunction] = MappingProxyType({}),
    target: TargetPath | ReactingTarget | None = None,
    events: Sequence[SimulationEvent] = (),
    links: Links | None = None,
) -> Flight:
    """Fly a mission in simulated time; equal arguments give equal flights.

    - `mission`: a mission from `cordon.load`, or an argument of it.
    - `seed`, `duration_s` [s]: replace the mission's.
    - `log`: record the flight to this file (MCAP), which must not exist yet.
    - `planner`: creates the planner of each vehicle from its configuration, see `cordon.TaskPlanner`; in place of the
      mission's, which is flown only if the environment variable CORDON_ALLOW_PLUGINS is 1.
    - `plants`: the true plants of vehicles, by id: a `Plant`, or a step function, see `cordon.StepFunction`. The
      controllers still use the plants of the profiles.
    - `target`: a `cordon.TargetPath` or a `cordon.ReactingTarget`.
    - `events`: what happens in the flight: `cordon.Absent`, `cordon.Commanded`, `cordon.Disturbance` and
      `cordon.MessageLoss`.
    - `links`: the radio links, a `cordon.Link` for each pair of vehicles that has one; None: all within
      `network.range_m`.

    Raises InputError with every fault, also for a planner that fails in flight.
    """
    mission = mission if isinstance(mission, Mission) else load(mission)
    flown_s, drawn = _flyable(
        mission.mission.duration_s if duration_s is None else duration_s,
        mission.mission.seed if seed is None else seed,
        log,
        target,
    )
    chosen = planner_of(mission, allowed=False) if planner is None else given_planner(planner)
    reaction = None
    if isinstance(target, ReactingTarget):
        mission, reaction = with_reacting_target(mission, target)
    elif target is not None:
        mission = with_target_path(mission, target, flown_s)
    mission, steps = with_plants(mission, plants)
    happens = SimulatedEvents(mission, events, links, flown_s)
    if log is not None and (back := [each for each in happens.absences if each.from_s > 0.0 and each.to_s < flown_s]):
        raise InputError([f"log: vehicle {back[0].vehicle_id} comes back, and a log holds one agent of each vehicle"])
    recording = None if log is None else _recording(mission, Path(log), drawn, flown_s, chosen)
    samples = round(flown_s * mission.mission.rate_hz) + 1
    decisions = {vehicle_id: Decisions.unknown(samples) for vehicle_id in mission.ids}

    def on_tick(tick: int, at: int, output: TickOutput) -> None:
        decisions[mission.ids[at]].note(tick, output)

    record = fly_simulated(
        mission,
        drawn,
        flown_s,
        lambda _: None,
        recording,
        None if chosen is None else chosen.factory,
        steps=steps,
        reaction=reaction,
        events=happens,
        on_tick=on_tick,
    )
    for each, tick_us in zip(decisions.values(), record.loop.tick_us.reshape(samples, -1).T, strict=True):
        each.tick_us[:] = tick_us
    return Flight(mission, record, channels_of(record, decisions))


def _flyable(duration_s: object, seed: object, log: object, target: object) -> tuple[float, int]:
    """Return duration [s] and seed as numbers; raises InputError with the faults of these arguments."""
    faults = []
    flown_s = float(duration_s) if isinstance(duration_s, Real) else nan
    if not 0.0 < flown_s <= DURATION_MAX_S:
        most = f"it must be more than 0 and at most {DURATION_MAX_S:g} s"
        faults.append(f"duration_s: {most} (given: {duration_s!r})")
    drawn = int(seed) if isinstance(seed, Integral) and not isinstance(seed, bool) else -1
    if drawn < 0:
        faults.append(f"seed: it must be a whole number, not negative (given: {seed!r})")
    if not (log is None or isinstance(log, str | Path)):
        faults.append(f"log: it must be a path (given: {log!r})")
    reacts = target.position if isinstance(target, ReactingTarget) else target
    if not (reacts is None or callable(reacts)):
        faults.append(f"target: it must be a function of the time, or a cordon.ReactingTarget (given: {reacts!r})")
    if faults:
        raise InputError(faults)
    return flown_s, drawn


def _recording(
    mission: Mission, log: Path, seed: int, duration_s: float, planner: ChosenPlanner | None
) -> "SimulationRecording":
    from gcs.flight.recording import simulation_recording  # noqa: PLC0415 - what writes logs is slow to import

    return simulation_recording(mission, log, seed, duration_s, "log", planner)
