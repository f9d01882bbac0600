"""What the tests of flight logs share: a short simulated flight on record."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path

from foxglove import Context

from gcs.flightlog.run import run_of
from gcs.flightlog.simulation import SimulationRecording
from gcs.flightlog.writer import LogWriter
from gcs.mission import Mission
from gcs.record import FlightRecord
from gcs.simulated import fly_simulated
from tests.conftest import MISSIONS
from tests.mission_text import content, parsed, put


def engaging() -> Mission:
    """Return case2-field with its target near: all engage within seconds, in noise and with lost messages."""
    mission = content((MISSIONS / "case2-field.toml").read_text(encoding="utf-8"))
    return parsed(put(mission, ("target", "start_m"), [8.0, -5.0]))


def record_simulation(
    mission: Mission, path: Path, *, seed: int = 3, duration_s: float = 40.0, flush_s: float = inf
) -> FlightRecord:
    """Fly a mission in simulation, recorded at `path`; flushed now and then, it is in as many pieces as a flight's."""
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
    """No file of this process may grow larger; Python ignores the signal, and the writing fails."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
