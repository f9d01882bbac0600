"""Helpers for tests of flight logs: short recorded simulations, and modified copies of them."""

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path
from typing import Any

from foxglove import Context
from msgspec import structs

from gcs.flight.simulated import fly_simulated
from gcs.flightlog.reader import FlightLog, LogRecord, read_log
from gcs.flightlog.recorder import SimulationRecording
from gcs.flightlog.run import run_of
from gcs.flightlog.schema import Codec
from gcs.flightlog.writer import LogWriter
from gcs.metrics.record import FlightRecord
from gcs.mission.file import parse_mission
from gcs.mission.mission import Mission
from tests.support.mission_text import Place, content, parsed, put, text_of
from tests.support.paths import MISSIONS


def engaging(name: str = "case2-field", *changes: tuple[Place, object]) -> Mission:
    """Return a mission with its target near, so that all engage within seconds, and other changes.

    case2-field has noise and lost messages. Changes of `own_filter` are those of every profile.
    """
    mission = content((MISSIONS / f"{name}.toml").read_text(encoding="utf-8"))
    for place, value in ((("target", "start_m"), [8.0, -5.0]), *changes):
        mission = put(mission, place, value)
    own_filter = mission.pop("own_filter", {})
    profiles = {name: content(text) for name, text in parsed(mission).profile_texts.items()}
    changed = {name: each | {"own_filter": each.get("own_filter", {}) | own_filter} for name, each in profiles.items()}
    return parse_mission(text_of(mission), MISSIONS, {name: text_of(each) for name, each in changed.items()})


def record_simulation(
    mission: Mission, path: Path, *, seed: int = 3, duration_s: float = 40.0, flush_s: float = inf
) -> FlightRecord:
    """Fly a mission in simulation, recorded at `path` and flushed at times, for chunks as in a flight's log."""
    return record_into(LogWriter(path, Context()), mission, seed=seed, duration_s=duration_s, flush_s=flush_s)


def record_into(
    writer: LogWriter, mission: Mission, *, seed: int = 3, duration_s: float = 40.0, flush_s: float = inf
) -> FlightRecord:
    """Fly a mission in simulation, recorded by a writer."""
    run = run_of(mission, mission.ids, seed=seed, source="simulation", speed=1.0, began_s=1.7e9, duration_s=duration_s)
    recording = SimulationRecording(writer, run)
    flushed_s = 0.0

    def flush(time_s: float) -> None:
        nonlocal flushed_s
        if time_s - flushed_s >= flush_s:
            flushed_s = time_s
            writer.flush()

    return fly_simulated(mission, seed, duration_s, flush, recording)


@contextmanager
def files_up_to(size_bytes: int) -> Iterator[None]:
    """Limit the size of this process's files; Python ignores the signal, so that writes fail."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def part(log: FlightLog, *vehicles: int) -> FlightLog:
    """Return the log that a process with only these vehicles would have left."""
    own = FlightLog(log.path.with_name(f"{vehicles}.mcap"), log.run_records, {i: log.vehicles[i] for i in vehicles})
    own.__dict__["run"] = structs.replace(log.run, vehicles=vehicles)
    return own


def reencoded(record: LogRecord, changed: Any, number: int | None = None) -> LogRecord:
    """Return a record with other contents and the same number, unless another is given."""
    number = record.plain()["number"] if number is None else number
    return record._replace(payload=Codec(record.kind).encode(changed, number))


def rewrite(log: FlightLog, path: Path, vehicle_id: int, change: Callable[[LogRecord], object]) -> FlightLog:
    """Copy a log with each record of a vehicle replaced by the result of `change`, and read the copy.

    None deletes the record; vehicle 0 is the run.
    """
    writer = LogWriter(path, Context())
    for each_id, records in {0: log.run_records, **log.vehicles}.items():
        for record in records:
            changed = change(record) if each_id == vehicle_id else record.read(record.kind)
            if changed is not None:
                writer.write(each_id, record.plain()["number"], record.time_ns, changed)
    writer.close()
    return read_log(path)
