"""What the commands do that read flight logs."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from itertools import count
from json import dumps
from pathlib import Path
from typing import Any

from gcs.cli.output import (
    STDERR,
    ReadingProgress,
    ReplayProgress,
    print_result,
)
from gcs.errors import Exit, InputError
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.recover import examine, recover, recovered_path
from gcs.flightlog.run import mission_of
from gcs.replay.cores import replay as replayed
from gcs.replay.playback import recorded_vehicles, tick_count
from gcs.replay.story import story_of
from gcs.replay.story_view import story_dict, story_view
from gcs.replay.view import replay_dict, replay_view
from gcs.replay.what_if import changed_filters, what_if
from gcs.replay.what_if_view import what_if_dict, what_if_view


def replay_log(path: Path, *, json: bool, explain: int | None, changes: Sequence[str]) -> Exit:
    """`cordon replay`."""
    log = read_log(path)
    vehicles = recorded_vehicles(log)
    if explain is not None and explain not in vehicles:
        known = ", ".join(map(str, vehicles))
        raise InputError([f"--explain: the log has no records of a vehicle {explain} (it has {known})"])
    for fault in log.faults:
        _say(f"{path}: {fault}", "yellow")
    result: dict[str, Any] = {"log": str(path)}
    verdict = Exit.HOLDS
    if changes:
        mission = mission_of(log)
        tried = changed_filters(mission, changes)
        with _counting(log, vehicles) as on_tick:
            comparison = what_if(log, mission, tried, on_tick)
        STDERR.print(what_if_view(comparison))
        result["what_if"] = what_if_dict(comparison)
    if explain is not None:
        story = story_of(log, explain)
        STDERR.print(story_view(story))
        result["story"] = story_dict(story)
    if not changes and explain is None:
        with _counting(log, vehicles) as on_tick:
            replay = replayed(log, on_tick)
        STDERR.print(replay_view(replay))
        result |= replay_dict(replay)
        verdict = Exit.HOLDS if replay.same else Exit.VERDICT_FAILED
    if json:
        print_result(dumps(result, indent=2, default=bytes.hex))
    return verdict


@contextmanager
def _counting(log: FlightLog, vehicles: Sequence[int]) -> Iterator[Callable[[], None]]:
    """Show on a terminal how many ticks have been replayed; give what is to be called for each."""
    ticks = sum(tick_count(log, vehicle_id) for vehicle_id in vehicles)
    done = count(1)
    with ReplayProgress(log.run.mission, ticks) as progress:
        yield lambda: progress.update(next(done))


def recover_log(path: Path, output: Path | None) -> Exit:
    """`cordon log recover`; raises InputError."""
    target = output or recovered_path(path)
    with ReadingProgress(path) as progress:
        found = examine(path, progress.update)
    if not found.faults:
        _say(f"{path}: it is whole: {found.records} records of {found.seconds:.1f} s; nothing is to be recovered")
        return Exit.HOLDS
    with ReadingProgress(path) as progress:
        recovered = recover(path, target, progress.update)
    _say(f"{target}: {recovered.records} records of {recovered.seconds:.1f} s are recovered; {path} is as it was")
    for fault in recovered.faults:
        _say(f"not whole: {fault}", "yellow")
    return Exit.HOLDS


def write_layout(path: Path) -> None:
    """Write the layout for viewers; raises InputError when that is not possible, or when the file exists already."""
    text = files("gcs.viewer").joinpath("cordon-layout.json").read_text(encoding="utf-8")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise InputError([f"--output: {str(path)!r}: {error.strerror or error}"]) from error


def _say(text: str, style: str = "") -> None:
    STDERR.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
