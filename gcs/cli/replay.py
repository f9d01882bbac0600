"""`cordon replay`: recomputes the decisions of a recorded flight."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from gcs.cli.options import AllowPlugins, Json, only_file
from gcs.errors import Exit, InputError
from gcs.metrics.json_output import json_output

if TYPE_CHECKING:
    from gcs.flightlog.reader import FlightLog


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """Options of `cordon replay`."""

    log: Annotated[Path, Parameter(validator=only_file, help="A log that cordon recorded (MCAP).")] = field(
        kw_only=False
    )
    json: Json = False
    explain: Annotated[int | None, Parameter(help="Instead show the decisions of this vehicle with their reasons.")] = (
        None
    )
    changes: Annotated[
        tuple[str, ...],
        Parameter(
            name="--set",
            negative="",
            show_default=False,
            help="Replay only the filters, with another value: own_filter.KEY=VALUE or target_filter.KEY=VALUE; may be "
            "repeated.",
        ),
    ] = ()
    allow_plugins: AllowPlugins = False


def replay(options: ReplayOptions) -> Exit:
    """Replay a recorded flight through new agents and check that every decision is reproduced. Exit code 1 if not.

    A damaged log is replayed as far as it can be read; the exit code is 1 then, too.

    Example: cordon replay flight.mcap --explain 2
    """
    from gcs.cli.output import print_log_faults, print_result
    from gcs.flightlog.reader import read_log
    from gcs.replay.playback import recorded_vehicles

    log = read_log(options.log)
    vehicles = recorded_vehicles(log)
    if options.explain is not None and options.explain not in vehicles:
        known = ", ".join(map(str, vehicles))
        raise InputError([f"--explain: the log has no vehicle {options.explain} (it has {known})"])
    print_log_faults(log)
    result: dict[str, Any] = {"log": str(options.log)}
    verdict = Exit.VERDICT_FAILED if log.is_damaged else Exit.HOLDS
    if options.changes:
        result["what_if"] = _what_if(log, options.changes)
    if options.explain is not None:
        result["story"] = _timeline(log, options.explain)
    if not options.changes and options.explain is None:
        same, replayed = _replay(log, allowed=options.allow_plugins)
        verdict = max(verdict, same)
        result |= replayed
    if options.json:
        print_result(json_output(result))
    return verdict


def _what_if(log: "FlightLog", changes: tuple[str, ...]) -> dict[str, Any]:
    from gcs.console.terminal import STDERR
    from gcs.flightlog.run import mission_of
    from gcs.replay.what_if import changed_filters, what_if, what_if_dict, what_if_view

    mission = mission_of(log)
    changed = changed_filters(mission, changes)
    with _counting(log) as on_tick:
        comparison = what_if(log, mission, changed, on_tick)
    STDERR.print(what_if_view(comparison))
    return what_if_dict(comparison)


def _timeline(log: "FlightLog", vehicle_id: int) -> dict[str, Any]:
    from gcs.console.terminal import STDERR
    from gcs.replay.timeline import timeline_dict, timeline_of, timeline_view

    timeline = timeline_of(log, vehicle_id)
    STDERR.print(timeline_view(timeline))
    return timeline_dict(timeline)


def _replay(log: "FlightLog", *, allowed: bool) -> tuple[Exit, dict[str, Any]]:
    from gcs.console.terminal import STDERR
    from gcs.mission.planner import named_planner
    from gcs.replay.cores import replay as replayed
    from gcs.replay.replay_view import replay_dict, replay_view

    planner = None if log.run.planner is None else named_planner(log.run.planner.name, allowed=allowed)
    with _counting(log) as on_tick:
        result = replayed(log, on_tick, planner)
    STDERR.print(replay_view(result))
    return Exit.HOLDS if result.same else Exit.VERDICT_FAILED, replay_dict(result)


@contextmanager
def _counting(log: "FlightLog") -> Iterator[Callable[[], None]]:
    """Show a progress bar of the ticks replayed; yields the function to call after each."""
    from gcs.cli.output import ReplayProgress
    from gcs.replay.playback import recorded_vehicles, tick_count

    ticks = sum(tick_count(log, vehicle_id) for vehicle_id in recorded_vehicles(log))
    done = count(1)
    with ReplayProgress(log.run.mission, ticks) as progress:
        yield lambda: progress.update(next(done))
