"""Recording a simulated flight: the cores' inputs and decisions during it, and the simulation's truth afterwards."""

from collections.abc import Sequence

from agents.core import VehicleCore
from agents.recording import RecordedCore
from agents.settings.config import AgentConfig
from gcs.flightlog.recorder import Recorder, VehicleRecorder
from gcs.flightlog.records import Cost, Run, RunEnd, Truth, VehicleEnd
from gcs.flightlog.writer import LogWriter
from gcs.metrics.ending import VehicleEnding
from sitl.simulation.simulation import SimulatedFlight

DRAIN_PERIOD_S = 1.0
"""Writing after every tick would evict the processor's caches before the next one."""


class SimulationRecording:
    """A recorder whose clock is the simulation's."""

    def __init__(self, writer: LogWriter, run: Run) -> None:
        self.writer = writer
        self._now_s = self._drained_s = 0.0
        self._recorder = Recorder(writer, lambda: self._now_s, lambda: 1.0)
        self._vehicles: dict[int, VehicleRecorder] = {}
        self._recorder.note(0, 0, run)

    def core(self, config: AgentConfig) -> VehicleCore:
        """Return a core that is recorded."""
        recorder = self._vehicles[config.vehicle_id] = self._recorder.vehicle(config.vehicle_id)
        return RecordedCore(config, recorder)

    def advance(self, now_s: float) -> None:
        """Set the time of the records from now on. Write the waiting records from time to time."""
        self._now_s = now_s
        if now_s - self._drained_s >= DRAIN_PERIOD_S:
            self._drained_s = now_s
            self._recorder.drain()

    def end(self, endings: Sequence[VehicleEnding], flight: SimulatedFlight, wall_time_s: float) -> None:
        """Add the truth, the computing time of each tick, and each vehicle's ending, in the order of the flight."""
        ticks = flight.time_s.size
        for column, ending in enumerate(endings):
            recorder, times_s = self._vehicles[ending.vehicle], flight.time_s.tolist()
            known = (each[:, column].tolist() for each in (flight.motion, flight.altitude_m, flight.tick_us))
            for self._now_s, motion, altitude_m, tick_us in zip(times_s, *known, strict=True):
                x, y, x_rate, y_rate = motion
                recorder.note(Truth(self._now_s, (x, y, altitude_m), (x_rate, y_rate, 0.0)))
                recorder.note(Cost(self._now_s, tick_us))
            recorder.note(VehicleEnd(ticks, 0, None, ending.how.value, ending.reason))
            self._recorder.drain()
        self._recorder.note(0, 0, RunEnd(float(flight.time_s[-1]), wall_time_s))
        self._recorder.close()
