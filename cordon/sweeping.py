"""Sweeps: many simulated flights with values, plants and events drawn at random, in one table."""

import os
import pickle
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from agents.control.plan import PlannerFactory
from cordon.flight import Flight
from cordon.simulation import load
from cordon.study import EventsOf, PlantsOf, Study, StudyFlights
from cordon.sweep_result import SweepResult
from gcs.errors import InputError
from gcs.mission.mission import Mission
from gcs.sweep.columns import RUN, TEAM, Row, require_pyarrow
from gcs.sweep.draws import Sampling, Vary, drawn_values
from gcs.sweep.plan import counted
from gcs.sweep.summary import SweepSummary
from gcs.sweep.sweep import SweepProgress, WorkersError, fly_missing
from gcs.sweep.workers import LocalWorkers

MISSING = "a sweep needs cloudpickle; install it by: pip install 'cordon-gcs[sweep]'"
_REASONS_SHOWN = 3
_RESERVED = {"mission", "planner", "series", *(each.name for each in (*RUN, *TEAM))}


def sweep(
    missions: Mission | str | Path | Sequence[Mission | str | Path] | Mapping[str, Mission | str | Path],
    *,
    runs: int = 1,
    vary: Vary = MappingProxyType({}),
    sampling: Sampling = "sobol",
    seed: int = 0,
    duration_s: float | None = None,
    plants: PlantsOf | None = None,
    events: EventsOf | None = None,
    planners: Mapping[str, PlannerFactory | None] = MappingProxyType({"cordon": None}),
    metrics: Mapping[str, Callable[[Flight], float]] = MappingProxyType({}),
    series: str | Path | None = None,
    jobs: int | None = None,
) -> SweepResult:
    """Fly missions in simulated time with values drawn at random; equal arguments give equal tables.

    - `missions`: one or several, as for `cordon.simulate`; a mapping names them. Each draw is flown with each mission
      and each planner, with the same seed.
    - `vary`: a `cordon.Range` or a list of values for each key of the mission. Keys that begin with `draw.` are not of
      the mission: `plants` and `events` find them in `draw.values`.
    - `sampling`, `runs`: `sobol`, `lhs` (Latin hypercube) and `random` draw that many values of all keys, each with a
      seed. `grid` takes all combinations of lists, each with that many seeds, the same for all; so does a sequence of
      mappings as `vary`, whose values are taken as they are.
    - `seed`: of the draws and of all seeds. `duration_s` [s] replaces the missions'.
    - `plants`, `events`: functions of a `cordon.Draw` that return what `cordon.simulate` takes.
    - `planners`: factories by names of your own; None is cordon's planner.
    - `metrics`: functions of the `cordon.Flight` that return a number, or None without one, by their columns' names.
    - `series`: a new folder for the channels of all flights, a Parquet file for each run.
    - `jobs`: number of processes; None: one for each core.

    Functions are sent to the processes by cloudpickle: they may be lambdas, and belong to a notebook or a script. A
    run that fails is a row with `error`. Ctrl-C ends the sweep, and the result holds the finished runs; a warning
    reports both. Raises InputError with every fault, also if no mission is valid with any of its values.

    >>> import cordon
    >>> found = cordon.sweep("case2", runs=2, vary={"encirclement.radius_m": cordon.Range(8, 14)}, duration_s=5.0)
    >>> found
    <SweepResult of 2 runs: 0 pass, 2 not judged>
    >>> [name for name in found.table][:4], found.table["closest_approach_m"].shape
    (['mission', 'planner', 'encirclement.radius_m', 'seed'], (2,))
    """
    named = _named(missions)
    draws = drawn_values(vary, sampling, runs, seed)
    if faults := [*_faults(planners, metrics, {key for _, values in draws[:1] for key in values}, jobs)]:
        raise InputError(faults)
    folder = None if series is None else Path(series).absolute()
    study = Study(named, dict(planners), draws, seed, duration_s, plants, events, dict(metrics), folder)
    for name in named:
        _require_valid(study, name)
    flights = StudyFlights(_pickled(study), len(study))
    if folder is not None:
        _create(folder)
    kept = _Kept()
    problem = _fly(flights, kept, min(jobs or os.cpu_count() or 1, len(study)))
    summary = SweepSummary.of(len(study), kept.rows.values())
    if problem:
        warnings.warn(f"{problem}: {summary.finished} of {counted(summary.runs, 'run')} are finished", stacklevel=2)
    for reason, count in [*summary.errors.items()][:_REASONS_SHOWN]:
        warnings.warn(f"{counted(count, 'run')} failed: {reason}", stacklevel=2)
    return SweepResult.of(study, kept.rows, summary)


class _Kept:
    """The finished runs, in memory."""

    def __init__(self) -> None:
        self.rows: dict[int, Row] = {}

    @property
    def finished(self) -> Collection[int]:
        return self.rows.keys()

    def append(self, run: int, row: Row) -> None:
        self.rows[run] = row


def _fly(flights: StudyFlights, kept: _Kept, jobs: int) -> str:
    """Fly all runs; return why the sweep ended before, if it did."""
    workers = LocalWorkers(jobs)
    try:
        with SweepProgress(len(flights)) as progress:
            fly_missing(flights, kept, workers, lambda row: progress.add(failed="error" in row), lambda: False)
    except KeyboardInterrupt:
        return "interrupted"
    except WorkersError as error:
        return str(error)
    finally:
        workers.close()
    return ""


def _named(missions: object) -> dict[str, Mission]:
    """Return the missions by their names; raises InputError."""
    if isinstance(missions, Mapping):
        named = {str(name): _loaded(each) for name, each in missions.items()}
    else:
        given = missions if isinstance(missions, Sequence) and not isinstance(missions, str) else [missions]
        loaded = [_loaded(each) for each in given]
        named = {each.mission.name: each for each in loaded}
        if len(named) < len(loaded):
            raise InputError(["missions: two have the same name: give a mapping from names of your own to missions"])
    if not named:
        raise InputError(["missions: give at least one"])
    return named


def _loaded(mission: object) -> Mission:
    return mission if isinstance(mission, Mission) else load(mission)  # type: ignore[arg-type]  # load checks it


def _faults(planners: object, metrics: object, varied: set[str], jobs: object) -> list[str]:
    """Return the faults of these arguments."""
    faults = []
    if not isinstance(planners, Mapping) or not planners:
        faults.append(f"planners: {planners!r}: give factories by name, such as {{'cordon': None, 'mine': Planner}}")
    else:
        faults += [
            f"planners: {name!r} is {factory!r}: give a function of the AgentConfig, or None for cordon's planner"
            for name, factory in planners.items()
            if not (factory is None or callable(factory))
        ]
    if not isinstance(metrics, Mapping):
        faults.append(f"metrics: {metrics!r}: give functions of a flight by name")
    else:
        for name, function in metrics.items():
            if not callable(function):
                faults.append(f"metrics: {name!r} is {function!r}: give a function of a flight")
            if name in _RESERVED | varied:
                faults.append(f"metrics: the table has a column {name!r} already: give it another name")
    if not (jobs is None or (isinstance(jobs, int) and jobs >= 1)):
        faults.append(f"jobs: it must be a whole number of processes from 1 (given: {jobs!r})")
    return faults


def _require_valid(study: Study, name: str) -> None:
    """Raise the faults of the first draw if a mission is valid with no draw."""
    first: InputError | None = None
    for _, values in study.draws:
        try:
            study.mission(name, values)
        except InputError as error:
            first = first or error
        else:
            return
    if first is not None:
        raise first


def _pickled(study: Study) -> bytes:
    try:
        import cloudpickle  # noqa: PLC0415 - of the extra `sweep`
    except ImportError as error:
        raise InputError([MISSING]) from error
    if study.series is not None:
        require_pyarrow()
    try:
        return bytes(cloudpickle.dumps(study))
    except (TypeError, pickle.PicklingError) as error:
        text = (
            "functions of plants, events, planners and metrics are sent to other processes, and one of them cannot be"
        )
        raise InputError([f"{text}: {error}"]) from error


def _create(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise InputError([f"series: {folder} holds files: give a new folder"])
    except OSError as error:
        raise InputError([f"series: {folder}: {error.strerror or error}"]) from error
