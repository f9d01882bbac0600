"""A flight over MAVLink and Zenoh with faults injected into its buses, sensors and process."""

import os
import socket as sockets
import threading

import msgspec

from gcs.console.summary import show_result, verdict_of
from gcs.errors import Exit
from gcs.flight.faults.failing_equipment import FailingEquipment
from gcs.flight.faults.team_faults import PresentFaults, TeamFaults
from gcs.flight.plan import FlightPlan
from gcs.flight.recording import FOLDER_VARIABLE, RecordingOptions
from gcs.flight.run import run_flight
from gcs.metrics.record import FlightRecord
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from sitl.server.shared_clock import ClockName


class FaultReceiver(PresentFaults):
    """The present faults of this process, received from the drill."""

    def listen(self, path: str) -> None:
        """Send this process's id, then receive faults on a separate thread."""
        connection = sockets.socket(sockets.AF_UNIX)
        connection.connect(path)
        connection.sendall(b"%d\n" % os.getpid())
        threading.Thread(target=self._receive, args=(connection,), name="drill", daemon=True).start()

    def _receive(self, connection: sockets.socket) -> None:
        with connection.makefile("rb") as lines:
            for line in lines:
                faults = msgspec.json.decode(line, type=TeamFaults)
                if faults.hang:  # nothing can be sent from then on
                    connection.sendall(b"\n")
                self.set(faults)
                if not faults.hang:
                    connection.sendall(b"\n")
        os._exit(0)  # the drill has ended, and its vehicles with it


def fly(name: str, duration_s: float, clock: ClockName | None, speed: float, *, socket: str, logs: str) -> Exit:
    """Fly a mission's whole team, at a speed of the clock at most.

    `socket` delivers the faults, `logs` is the folder of the log (empty: unrecorded).

    Raises InputError.
    """
    os.environ[FOLDER_VARIABLE] = logs
    receiver = FaultReceiver()
    receiver.listen(socket)
    mission = load_mission(name)

    def judge(flown: Mission, record: FlightRecord) -> Exit:
        return verdict_of(show_result(flown, record))

    equipment = FailingEquipment(receiver)
    plan = FlightPlan(mission, duration_s, mission.vehicles, speed, equipment=equipment, clock=clock)
    return run_flight(plan, RecordingOptions(recorded=bool(logs)), judge)
