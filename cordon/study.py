"""The runs of a sweep in Python: what each flies, and its row in the table."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isnan
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from agents.control.plan import PlannerFactory
from cordon.flight import Flight
from cordon.simulation import simulate
from estimation.plant.model import Plant
from gcs.errors import InputError
from gcs.flight.simulated_events import SimulationEvent
from gcs.mission.mission import Mission
from gcs.sweep.columns import Row, result_row
from gcs.sweep.draws import OWN, Draw, random_of, run_seed
from gcs.sweep.workers import Task, failure
from sitl.vehicle.plant_step import StepFunction

PlantsOf = Callable[[Draw], Mapping[int, Plant | StepFunction]]
EventsOf = Callable[[Draw], Sequence[SimulationEvent]]
_PLANTS, _EVENTS = 0, 1


@dataclass(frozen=True, slots=True)
class Study:
    """What a sweep flies: each draw with each mission and each planner, with the same seed.

    `draws` are the number of the seed and the varied values. Runs are in the order of the table: draws, missions,
    planners.
    """

    missions: Mapping[str, Mission]
    planners: Mapping[str, PlannerFactory | None]
    draws: Sequence[tuple[int, Mapping[str, Any]]]
    seed: int
    duration_s: float | None
    plants: PlantsOf | None
    events: EventsOf | None
    metrics: Mapping[str, Callable[[Flight], float]]
    series: Path | None

    def __len__(self) -> int:
        return len(self.draws) * len(self.missions) * len(self.planners)

    def case(self, index: int) -> tuple[str, str, int, Mapping[str, Any]]:
        """Return mission and planner of a run by their names, the number of its seed, and the varied values."""
        of_mission, planner = divmod(index, len(self.planners))
        of_draw, mission = divmod(of_mission, len(self.missions))
        return [*self.missions][mission], [*self.planners][planner], *self.draws[of_draw]

    def mission(self, name: str, values: Mapping[str, Any]) -> Mission:
        """Return a mission with varied values; raises InputError."""
        keys = {key: value for key, value in values.items() if not key.startswith(OWN)}
        return self.missions[name].replace(**keys) if keys else self.missions[name]

    def flight(self, index: int) -> Flight:
        """Fly a run; raises what its functions raise."""
        name, planner, number, values = self.case(index)
        mission, seed = self.mission(name, values), run_seed(self.seed, number)
        draw = partial(Draw, mission, values, seed)
        plants = {} if self.plants is None else self.plants(draw(random_of(self.seed, number, _PLANTS)))
        events = () if self.events is None else self.events(draw(random_of(self.seed, number, _EVENTS)))
        return simulate(
            mission,
            seed=seed,
            duration_s=self.duration_s,
            planner=self.planners[planner],
            plants=plants,
            events=events,
        )

    def row(self, index: int) -> Row:
        """Fly a run and return its metrics; a failed run is a row with only `error`."""
        try:
            flight = self.flight(index)
            row = result_row(flight.metrics) | self._own(flight)
            if self.series is not None:
                row["series"] = name = f"{index:06d}.parquet"
                _write_series(flight, self.series / name)
        except InputError as error:
            return failure("; ".join(error.faults))
        except Exception as error:  # no error of one run ends the sweep
            return failure(f"{type(error).__name__}: {error}")
        return row

    def _own(self, flight: Flight) -> Row:
        """Return the values of the given metrics; NaN and None are missing. Raises InputError."""
        row: Row = {}
        for name, function in self.metrics.items():
            try:
                value: object = function(flight)
            except Exception as error:
                raise InputError([f"metrics: {name!r} raised {type(error).__name__}: {error}"]) from error
            if not (value is None or isinstance(value, Real | np.bool_)):
                raise InputError([f"metrics: {name!r} returned {value!r}: return a number, or None without one"])
            if value is not None and not isnan(value):
                row[name] = float(value)
        return row


@dataclass(frozen=True, slots=True)
class StudyFlights:
    """The runs of a study as tasks. Each task holds the pickled study, so that runs share no state of its functions."""

    pickled: bytes
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Task:
        return partial(flown_of, self.pickled, index)


def flown_of(pickled: bytes, index: int) -> Row:
    """Fly a run of a pickled study and return its row."""
    import cloudpickle  # noqa: PLC0415 - of the extra `sweep`

    try:
        study: Study = cloudpickle.loads(pickled)
    except Exception as error:  # a module of the functions that is not found here, or fails to be imported
        return failure(f"its functions cannot be read by a worker: {type(error).__name__}: {error}")
    return study.row(index)


def _write_series(flight: Flight, path: Path) -> None:
    """Write the channels of a flight, without computing times, which are never the same."""
    import pyarrow.parquet  # noqa: PLC0415

    columns = [
        {"vehicle": np.full(each.time_s.size, vehicle_id), **each.columns()}
        for vehicle_id, each in flight.vehicles.items()
    ]
    whole = {name: np.concatenate([each[name] for each in columns]) for name in columns[0] if name != "tick_us"}
    pyarrow.parquet.write_table(pyarrow.table(whole), path)
