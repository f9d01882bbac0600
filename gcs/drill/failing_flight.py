"""A flight over MAVLink and Zenoh whose buses, sensors and process can be made to fail."""

import os

from gcs.console.result import show_result, verdict_of
from gcs.drill.injected_faults import FailingEquipment, FaultReceiver
from gcs.errors import Exit
from gcs.flight.plan import FlightPlan
from gcs.flight.recording import RecordingOptions
from gcs.flight.run import run_flight
from gcs.flightlog.place import FOLDER_VARIABLE
from gcs.metrics.record import FlightRecord
from gcs.mission.file import load_mission


def fly(name: str, speed: float, duration_s: float, *, socket: str, logs: str) -> Exit:
    """Fly a mission's whole team; `socket` delivers the faults, `logs` is the folder of the log (empty: unrecorded).

    Raises InputError.
    """
    os.environ[FOLDER_VARIABLE] = logs
    receiver = FaultReceiver()
    receiver.listen(socket)
    mission = load_mission(name)

    def judge(record: FlightRecord) -> Exit:
        return verdict_of(show_result(mission, record))

    equipment = FailingEquipment(receiver)
    plan = FlightPlan(mission, duration_s, mission.vehicles, stubs=False, speed=speed, equipment=equipment)
    return run_flight(plan, RecordingOptions(recorded=bool(logs)), judge)
