"""`cordon sweep`: simulated flights over the product of values and seeds, and their figure."""

import difflib
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from cyclopts.validators import Number

from gcs.cli.options import RESULT, AllowPlugins, Changes, Duration, Json, MissionName, file_or_folder, only_file
from gcs.errors import Exit, InputError
from gcs.metrics.json_output import json_output
from gcs.signals import hold_back, pending

if TYPE_CHECKING:
    from gcs.mission.mission import Mission
    from gcs.sweep.columns import Column, Row
    from gcs.sweep.folder import SweepJournal
    from gcs.sweep.plan import SweepPlan
    from gcs.sweep.summary import SweepSummary
    from gcs.sweep.workers import Workers

_REASONS_SHOWN = 5
sweep = App(
    name="sweep",
    help="Fly a mission in simulated time with many values and seeds; write a table with a row for each run.\n\n"
    "Run the same command again to continue an interrupted sweep.\n\n"
    "Example: cordon sweep case2-field --vary encirclement.radius_m=8:16:2 --seeds 0:50 --out results",
)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions:
    """Options of `cordon sweep`."""

    mission: MissionName = field(kw_only=False)
    vary: Annotated[
        tuple[str, ...],
        Parameter(
            negative="",
            help="A key of the mission and its values, KEY=START:STOP:STEP (STOP is excluded) or KEY=VALUE,VALUE. "
            "May be repeated: all combinations of values are flown.",
        ),
    ] = ()
    seeds: Annotated[
        str | None,
        Parameter(help="Seeds for each combination of values: START:STOP (STOP is excluded) or SEED,SEED."),
    ] = None
    out: Annotated[
        Path,
        Parameter(
            validator=file_or_folder,
            group=RESULT,
            help="Folder of the sweep: its journal and its table, runs.parquet.",
        ),
    ]
    duration: Duration = None
    changes: Changes = ()
    allow_plugins: AllowPlugins = False
    workers: Annotated[
        int | None,
        Parameter(
            help="Worker processes on this computer; default: one for each core.", validator=Number(gte=1, lte=1024)
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        Parameter(help="Fly on a Dask cluster instead: the address of its scheduler, tcp://HOST:8786."),
    ] = None
    json: Json = False


@sweep.default
def fly_sweep(options: SweepOptions) -> Exit:
    """Fly a sweep, or continue an interrupted one."""
    hold_back()
    if options.scheduler is None:
        from gcs.sweep.forkserver import start_forkserver

        start_forkserver()
    from gcs.sweep.columns import require_pyarrow, table_bytes
    from gcs.sweep.folder import SweepFolder, write_whole
    from gcs.sweep.summary import SweepSummary

    require_pyarrow()
    plan, faults = _planned(options)
    folder, problem = SweepFolder(options.out), ""
    with folder.opened(options.mission, plan) as journal:
        try:
            _fly(plan, faults, journal, options)
        except _EndedError as error:
            problem = str(error)
        rows = journal.rows()
        if not problem:
            write_whole(folder.table, table_bytes(plan, rows))
    summary = SweepSummary.of(len(plan.runs), rows.values())
    _report(options, summary, folder.table, problem)
    if problem:
        return Exit.ENDED_IN_FLIGHT
    return Exit.HOLDS if summary.all_pass else Exit.VERDICT_FAILED


def _report(options: SweepOptions, summary: "SweepSummary", table: Path, problem: str) -> None:
    """Print the sweep's summary and the next step; with a problem there is no table yet."""
    from gcs.cli.output import print_result
    from gcs.console.terminal import print_line, print_problem
    from gcs.sweep.plan import counted

    for reason, count in islice(summary.errors.items(), _REASONS_SHOWN):
        print_line(f"error: {reason} ({counted(count, 'run')})", "red")
    print_line(f"{options.out}: {summary.line}")
    if problem:
        print_problem(problem, f"continue it by: {shlex.join(['cordon', *sys.argv[1:]])}")
    else:
        print_line(f"table: {table}\nnext: cordon sweep plot {shlex.quote(str(options.out))}")
    if options.json:
        written = None if problem else str(table)
        print_result(json_output({"mission": options.mission, "table": written, **summary.to_dict()}))


class _EndedError(Exception):
    """The sweep ended before all of its runs were flown; finished runs are kept."""


def _planned(options: SweepOptions) -> "tuple[SweepPlan, dict[int, str]]":
    """Return the plan, and the faults of the runs that cannot fly, by run index; raises InputError."""
    from gcs.cli.output import print_warning
    from gcs.mission.overrides import override
    from gcs.preflight.findings import Finding, Grade
    from gcs.preflight.mission import encounter
    from gcs.sweep.plan import counted, planned
    from gcs.sweep.variation import seed_range, variation

    variations = [variation(given) for given in options.vary]
    seeds = seed_range(options.seeds) if options.seeds is not None else ()
    if options.workers is not None and options.scheduler is not None:
        raise InputError(["--workers: not with --scheduler, whose cluster has its own workers: leave one of them out"])
    found: list[dict[str, Finding]] = []

    def check(mission: "Mission") -> None:
        warnings = [each for each in encounter(mission) if each.grade is not Grade.PASS]
        found.append({each.check: each for each in reversed(warnings)})

    fixed = dict(map(override, options.changes))
    given = (options.mission, variations, seeds, fixed, options.duration)
    result = planned(*given, check, pending, allow_plugins=options.allow_plugins)
    for name in dict.fromkeys(name for warned in found for name in warned):
        warned = [each[name] for each in found if name in each]
        whole = f"{len(warned)} of {counted(len(found), 'mission')}, the first: " if len(found) > 1 else ""
        print_warning(warned[0], whole)
    return result


def _fly(plan: "SweepPlan", faults: dict[int, str], journal: "SweepJournal", options: SweepOptions) -> None:
    """Fly the runs that the journal does not hold; raises _EndedError, and InputError without workers."""
    from gcs.console.terminal import print_line
    from gcs.sweep.sweep import PlannedFlights, SweepProgress, WorkersError, fly_missing
    from gcs.sweep.workers import failure

    for index, reason in faults.items():
        if index not in journal.finished:
            journal.append(index, failure(reason))
    runs = len(plan.runs)
    missing = runs - len(journal.finished)
    print_line(f"{options.mission}: {plan.line}")
    if missing < runs:
        print_line(f"{options.out}: {runs - missing} of the runs are finished or have no valid mission")
    if not missing:
        return
    workers = _workers(options, missing)
    try:
        with SweepProgress(missing) as progress:

            def finished(row: "Row") -> None:
                progress.add(failed="error" in row)

            fly_missing(PlannedFlights(plan), journal, workers, finished, pending)
    except KeyboardInterrupt as error:
        raise _EndedError("interrupted") from error
    except WorkersError as error:
        raise _EndedError(str(error)) from error
    except OSError as error:
        raise _EndedError(f"{options.out}: {error.strerror or error}") from error
    finally:
        workers.close()


def _workers(options: SweepOptions, runs: int) -> "Workers":
    """Return the workers that fly the runs; raises InputError without a cluster."""
    from gcs.console.terminal import print_line

    if options.scheduler is None:
        from gcs.sweep.workers import LocalWorkers

        return LocalWorkers(min(options.workers or os.cpu_count() or 1, runs))
    from gcs.sweep.workers import ClusterWorkers

    cluster = ClusterWorkers(options.scheduler)
    print_line(
        f"{options.scheduler}: {cluster.count} workers"
        if cluster.count
        else f"{options.scheduler}: no workers yet; start some by: dask worker {options.scheduler} --nthreads 1"
    )
    return cluster


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PlotOptions:
    """Options of `cordon sweep plot`."""

    folder: Annotated[Path, Parameter(validator=file_or_folder, help="The folder of a sweep, finished or not.")] = (
        field(kw_only=False)
    )
    over: Annotated[
        tuple[str, ...],
        Parameter(
            negative="",
            help="Varied key of the axes, at most two; default: the first two. Over one key, planners are drawn apart.",
        ),
    ] = ()
    metric: Annotated[
        tuple[str, ...],
        Parameter(negative="", help="Column of the table to draw; may be repeated. Default: the main metrics."),
    ] = ()
    out: Annotated[
        Path | None,
        Parameter(
            validator=only_file, group=RESULT, help="Figure, a .png, .svg or .pdf; default: sweep.png in the folder."
        ),
    ] = None
    worst: Annotated[
        int,
        Parameter(group=RESULT, help="How many runs to list that do not pass.", validator=Number(gte=0)),
    ] = 3
    json: Json = False


@sweep.command
def plot(options: PlotOptions) -> Exit:
    """Draw a sweep's metrics over one or two of its keys, and list its worst runs with commands to fly them again.

    Example: cordon sweep plot results --over encirclement.radius_m --metric closest_approach_m
    """
    from gcs.cli.output import check_file, print_result, writing
    from gcs.console.terminal import print_line
    from gcs.report.figure import METADATA
    from gcs.sweep.columns import full_rows, table_columns
    from gcs.sweep.figure import Picture, save_sweep_figure
    from gcs.sweep.folder import SweepFolder
    from gcs.sweep.summary import SweepSummary, worst_cases

    path = options.out or options.folder / "sweep.png"
    folder = SweepFolder(options.folder)
    plan, rows = folder.read()
    check_file("--out", path, tuple(METADATA))
    full = full_rows(plan, rows)
    metrics = _metrics(options.metric, table_columns(plan, full), full)
    summary = SweepSummary.of(len(plan.runs), rows.values())
    title, over = f"{folder.mission()}, {summary.line}", _over(options.over, plan)
    with writing("--out", path):
        save_sweep_figure(Picture(title, metrics, over, full, _apart(over, plan)), path)
    cases = worst_cases(plan, rows, metrics, folder.mission(), options.worst)
    print_line(f"{options.folder}: {summary.line}")
    for case in cases:
        print_line("; ".join(case.reasons))
        print_line(f"    {case.command}")
    print_line(f"figure: {path}")
    if options.json:
        print_result(json_output({**summary.to_dict(), "figure": str(path), "worst": list(map(asdict, cases))}))
    return Exit.HOLDS


def _over(given: Sequence[str], plan: "SweepPlan") -> tuple[str, ...]:
    """Return the keys of the axes: the seed if no key varies. Raises InputError."""
    from gcs.sweep.plan import PLANNER_PLACE

    varied = [each.place for each in plan.variations]
    if len(given) > 2:
        raise InputError([f"--over: at most two keys (given: {', '.join(given)})"])
    if faults := [
        f"--over {key}: the sweep does not vary it (it varies {', '.join(varied) or 'seeds alone'})"
        for key in given
        if key not in varied
    ]:
        raise InputError(faults)
    others = [key for key in varied if key != PLANNER_PLACE]
    return tuple(given or (varied[:2] if others == varied else others[:1] or varied) or ["seed"])


def _apart(over: Sequence[str], plan: "SweepPlan") -> tuple[str, ...]:
    """Return the keys whose values are drawn apart over these axes: over one key that is not the planner, planners."""
    from gcs.sweep.plan import PLANNER_PLACE

    varied = [each.place for each in plan.variations]
    return (PLANNER_PLACE,) if PLANNER_PLACE in varied and len(over) == 1 and PLANNER_PLACE not in over else ()


def _metrics(given: Sequence[str], columns: "Sequence[Column]", rows: "Sequence[Row]") -> "tuple[Column, ...]":
    """Return the columns to draw, by default those of the main metrics that have a value; raises InputError."""
    from gcs.sweep.columns import PASS

    numbers = {each.name: each for each in columns if each.kind is not str}
    faults = []
    for name in given:
        if name not in numbers:
            near = difflib.get_close_matches(name, numbers, n=3)
            hint = f"did you mean {', '.join(near)}?" if near else "docs/sweeps.md lists them"
            faults.append(f"--metric {name}: the table has no numeric column of this name; {hint}")
    wanted = given or [name for name, each in numbers.items() if each.drawn]
    flown = [row for row in rows if "error" not in row]
    known = [name for name in wanted if any(name in row or name == PASS for row in flown)]
    if not known and not faults:
        faults = ["no finished run has a value of these metrics; nothing to draw"]
    if faults:
        raise InputError(faults)
    return tuple(numbers[name] for name in known)
