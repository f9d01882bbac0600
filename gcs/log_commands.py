"""What the commands do that read flight logs."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from json import dumps
from pathlib import Path
from typing import Any

from gcs.exits import Exit, InputError
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.run import mission_of
from gcs.output import STDERR, ReplayProgress, print_result
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
        STDERR.print(f"{path}: {fault}", style="yellow", markup=False, highlight=False, soft_wrap=True)
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
