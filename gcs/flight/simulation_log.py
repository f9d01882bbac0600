"""The log of a simulated flight, which its own process writes."""

from pathlib import Path
from time import time

from foxglove import Context

from gcs.flight.recording import log_input_errors
from gcs.flightlog.run import run_of
from gcs.flightlog.simulation import SimulationRecording
from gcs.flightlog.writer import LogWriter
from gcs.mission.mission import Mission
from gcs.viewer.scene import Scene


def simulation_recording(mission: Mission, path: Path, seed: int, duration_s: float) -> SimulationRecording:
    """Return the recording of a simulated flight; raises InputError."""
    run = run_of(mission, mission.ids, seed=seed, source="simulation", speed=1.0, began_s=time(), duration_s=duration_s)
    context = Context()
    with log_input_errors(path):
        return SimulationRecording(LogWriter(path, context, Scene(context, mission)), run)
