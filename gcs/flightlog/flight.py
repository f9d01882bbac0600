"""Recording a flight: the inputs and decisions of this process's agents, the facts of their vehicles, the ending."""

from types import TracebackType
from typing import Self

from agents.core import VehicleCore
from agents.recording import RecordedCore
from agents.settings.config import AgentConfig
from agents.shell.clock import MissionClock
from estimation.state import Telemetry
from gcs.flightlog.audit import AuditTrail
from gcs.flightlog.recorder import Recorder, RecorderThread, RecordWriter, VehicleRecorder
from gcs.flightlog.records import Cost, Parameter, Run, RunEnd, Truth, Vehicle, VehicleEnd
from gcs.preflight.findings import VehicleFacts
from sitl.server.server import TruthTrack


class Recording:
    """Records nothing of a flight; `FlightRecording` writes a log."""

    @property
    def fault(self) -> str:
        """Why the record ends before the flight does, empty if it does not."""
        return ""

    def begin(self, run: Run) -> None:
        """Record the run as a whole; a later call replaces an earlier one."""

    def core(self, config: AgentConfig) -> VehicleCore:
        """Return the core of an agent."""
        return VehicleCore(config)

    def begin_vehicle(self, facts: VehicleFacts) -> None:
        """Record the facts that a vehicle reported before take-off."""

    def cost(self, vehicle_id: int, time_s: float, tick_us: float) -> None:
        """Record the computing time of a tick of a vehicle's control loop."""

    def end_vehicle(self, vehicle_id: int, end: VehicleEnd) -> None:
        """Record the totals of a vehicle's control loop, and how its flight ended."""

    def end(self, end: RunEnd) -> None:
        """Record how the run ended."""

    def true_track(self, vehicle_id: int, track: TruthTrack) -> None:
        """Record a vehicle's true track."""

    def truth(self, vehicle_id: int, motion: Telemetry) -> None:
        """Record a true motion that a vehicle's simulator sent."""


class FlightRecording(Recording):
    """Records on a thread of its own; use it as a context manager around everything that flies."""

    def __init__(self, writer: RecordWriter, clock: MissionClock) -> None:
        self._recorder = Recorder(writer, clock.now_s, lambda: clock.time_scale, AuditTrail())
        self._thread = RecorderThread(self._recorder)
        self._vehicles: dict[int, VehicleRecorder] = {}

    def __enter__(self) -> Self:
        """Start to write."""
        self._thread.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the remaining records."""
        self._thread.__exit__(kind, error, trace)

    @property
    def fault(self) -> str:
        """Why the record ends before the flight does, empty if it does not."""
        return self._recorder.fault

    def begin(self, run: Run) -> None:
        """Record the run as a whole; a later call replaces an earlier one."""
        self._recorder.note(0, 0, run)

    def core(self, config: AgentConfig) -> VehicleCore:
        """Return a core whose inputs and outputs are recorded."""
        return RecordedCore(config, self._vehicle(config.vehicle_id))

    def begin_vehicle(self, facts: VehicleFacts) -> None:
        """Record the facts that a vehicle reported before take-off."""
        known = {name: value for name, value in sorted(facts.parameters.items()) if value is not None}
        parameters = tuple(Parameter(name, value) for name, value in known.items())
        self._vehicle(facts.vehicle_id).note(
            Vehicle(facts.autopilot.label, facts.firmware, parameters, facts.kind.value)
        )

    def cost(self, vehicle_id: int, time_s: float, tick_us: float) -> None:
        """Record the computing time of a tick of a vehicle's control loop."""
        self._vehicle(vehicle_id).note(Cost(time_s, tick_us))

    def end_vehicle(self, vehicle_id: int, end: VehicleEnd) -> None:
        """Record the totals of a vehicle's control loop, and how its flight ended."""
        self._vehicle(vehicle_id).note(end)

    def end(self, end: RunEnd) -> None:
        """Record how the run ended."""
        self._recorder.note(0, 0, end)

    def true_track(self, vehicle_id: int, track: TruthTrack) -> None:
        """Record a vehicle's true track."""
        recorder, rows = self._vehicle(vehicle_id), (track.time_s, track.position_m, track.velocity_m_s)
        for time_s, (x, y, z), (x_rate, y_rate, z_rate) in zip(*(each.tolist() for each in rows), strict=True):
            recorder.note(Truth(time_s, (x, y, z), (x_rate, y_rate, z_rate)), time_s)

    def truth(self, vehicle_id: int, motion: Telemetry) -> None:
        """Record a true motion that a vehicle's simulator sent."""
        self._vehicle(vehicle_id).note(Truth(motion.time_s, motion.position_m, motion.velocity_m_s, received=True))

    def _vehicle(self, vehicle_id: int) -> VehicleRecorder:
        if vehicle_id not in self._vehicles:
            self._vehicles[vehicle_id] = self._recorder.vehicle(vehicle_id)
        return self._vehicles[vehicle_id]
