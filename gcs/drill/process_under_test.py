"""`cordon fly` of a mission that is to fail: `python -m gcs.drill.process_under_test MISSION SPEED DURATION`.

What is to be wrong is told through the Unix socket that CORDON_DRILL names. Everything else is a flight as any other,
its supervisor included, and so nothing heavy is imported before signals are held back.
"""

import os
import sys
from contextlib import suppress

from gcs.flight.supervisor import is_supervised, supervise
from gcs.signals import hold_back

SOCKET = "CORDON_DRILL"
"""The environment variable that names the socket."""
LOGS = "CORDON_DRILL_LOGS"
"""The environment variable that names the folder for the flight's log; without it, or empty: it is not recorded."""


def main() -> int:
    """Fly, or watch the process that flies."""
    hold_back()
    if not is_supervised():
        return supervise(_tell)
    from gcs.cli.commands import fly_mission  # noqa: PLC0415
    from gcs.drill.injected_faults import FailingEquipment, Patient  # noqa: PLC0415
    from gcs.flightlog.place import FOLDER_VARIABLE  # noqa: PLC0415

    mission, speed, duration = sys.argv[1:]
    logs = os.environ.get(LOGS, "")
    os.environ[FOLDER_VARIABLE] = logs
    patient = Patient()
    patient.listen(os.environ[SOCKET])
    return fly_mission(
        mission,
        sitl=False,
        speed=float(speed),
        only=None,
        duration=float(duration),
        log=None,
        json=False,
        plot=None,
        recorded=bool(logs),
        equipment=FailingEquipment(patient),
    )


def _tell(line: str) -> None:
    with suppress(OSError):
        os.write(sys.stderr.fileno(), f"{line}\n".encode())


if __name__ == "__main__":
    sys.exit(main())
