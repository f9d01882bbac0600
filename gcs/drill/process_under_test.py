"""The flying process of a drill: `python -m gcs.drill.process_under_test MISSION SPEED DURATION`.

It receives the faults to inject through the Unix socket that CORDON_DRILL names. Otherwise it is a flight as any other,
with a supervisor: nothing heavy is imported before signals are held back.
"""

import os
import sys

from gcs.flight.supervision.supervisor import is_supervised, supervise
from gcs.signals import hold_back

SOCKET = "CORDON_DRILL"
"""The environment variable that names the socket."""
LOGS = "CORDON_DRILL_LOGS"
"""The environment variable that names the folder for the flight's log; without it, or empty: it is not recorded."""


def main() -> int:
    """Fly, or supervise the process that flies."""
    hold_back()
    if not is_supervised():
        return supervise()
    from gcs.drill.failing_flight import fly  # noqa: PLC0415

    mission, speed, duration = sys.argv[1:]
    return fly(mission, float(speed), float(duration), socket=os.environ[SOCKET], logs=os.environ.get(LOGS, ""))


if __name__ == "__main__":
    sys.exit(main())
