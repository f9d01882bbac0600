"""Recording a flight: the inputs and decisions of this process's agents, the facts of their vehicles, the ending."""

from contextlib import AbstractContextManager, nullcontext
from typing import Any, Self

from agents.control.plan import PlannerFactory
from agents.core import VehicleCore
from agents.recording import RecordedCore
from agents.settings.config import AgentConfig
from agents.shell.clock import MissionClock
from estimation.state import Telemetry
from gcs.flightlog.audit import AuditEntry, AuditHead, AuditTrail
from gcs.flightlog.recorder import Recorder, RecorderThread, RecordWriter, VehicleRecorder
from gcs.flightlog.records import Cost, Parameter, Run, RunEnd, Truth, Vehicle, VehicleEnd
from gcs.preflight.findings import VehicleFacts
from sitl.server.record import TruthTrack


class Recording:
    """Records a flight on a thread of its own: use it as a context manager around everything that flies.

    Without a writer it records nothing.
    """

    def __init__(self, writer: RecordWriter | None, clock: MissionClock) -> None:
        self._recorder: Recorder | None = None
        if writer is not None:
            self._recorder = Recorder(writer, clock.now_s, lambda: clock.time_scale, AuditTrail())
        self._thread: AbstractContextManager[object] = (
            nullcontext() if self._recorder is None else RecorderThread(self._recorder)
        )
        self._vehicles: dict[int, VehicleRecorder] = {}

    def __enter__(self) -> Self:
        self._thread.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._thread.__exit__(*error)

    @property
    def fault(self) -> str:
        """Why the record ends before the flight does, empty if it does not."""
        return "" if self._recorder is None else self._recorder.fault

    @property
    def head(self) -> AuditHead | None:
        """The newest head of the audit log, None before the first."""
        return None if self._recorder is None else self._recorder.head

    def note_run(self, record: Run | RunEnd | AuditEntry) -> None:
        """Record the run as a whole, where a later record replaces an earlier one, how it ended, or an audit entry."""
        if self._recorder is not None:
            self._recorder.note(0, 0, record)

    def core(self, config: AgentConfig, planner: PlannerFactory | None = None) -> VehicleCore:
        """Return the core of an agent, whose inputs and outputs are recorded; `planner` makes its plug-in planner."""
        recorder = self._vehicle(config.vehicle_id)
        return VehicleCore(config, planner) if recorder is None else RecordedCore(config, recorder, planner)

    def begin_vehicle(self, facts: VehicleFacts) -> None:
        """Record the facts that a vehicle reported before take-off."""
        known = {name: value for name, value in sorted(facts.parameters.items()) if value is not None}
        parameters = tuple(Parameter(name, value) for name, value in known.items())
        self._note(facts.vehicle_id, Vehicle(facts.autopilot.label, facts.firmware, parameters, facts.kind.value))

    def cost(self, vehicle_id: int, time_s: float, tick_us: float) -> None:
        """Record the computing time of a tick of a vehicle's control loop."""
        self._note(vehicle_id, Cost(time_s, tick_us))

    def end_vehicle(self, vehicle_id: int, end: VehicleEnd) -> None:
        """Record the totals of a vehicle's control loop, and how its flight ended."""
        self._note(vehicle_id, end)

    def true_track(self, vehicle_id: int, track: TruthTrack) -> None:
        """Record a vehicle's true track."""
        rows = (track.time_s, track.position_m, track.velocity_m_s)
        for time_s, (x, y, z), (x_rate, y_rate, z_rate) in zip(*(each.tolist() for each in rows), strict=True):
            self._note(vehicle_id, Truth(time_s, (x, y, z), (x_rate, y_rate, z_rate)), time_s)

    def truth(self, vehicle_id: int, motion: Telemetry) -> None:
        """Record a true motion that a vehicle's simulator sent."""
        self._note(vehicle_id, Truth(motion.time_s, motion.position_m, motion.velocity_m_s, received=True))

    def _note(self, vehicle_id: int, record: object, time_s: float | None = None) -> None:
        if (recorder := self._vehicle(vehicle_id)) is not None:
            recorder.note(record, time_s)

    def _vehicle(self, vehicle_id: int) -> VehicleRecorder | None:
        if self._recorder is not None and vehicle_id not in self._vehicles:
            self._vehicles[vehicle_id] = self._recorder.vehicle(vehicle_id)
        return self._vehicles.get(vehicle_id)
