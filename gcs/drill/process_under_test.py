"""The flying process of a drill: `python -m gcs.drill.process_under_test MISSION DURATION [CLOCK SPEED]`.

CLOCK is the number of the governed clock of stub vehicles, SPEED that of the flight; without them the vehicles are
others. The process receives the faults to inject through the Unix socket that CORDON_DRILL names. Otherwise it is a
normal flight with a supervisor: no heavy import before signals are blocked.
"""

import os
import sys

from gcs.flight.supervisor import is_supervised, supervise
from gcs.signals import hold_back
from sitl.server.shared_clock import ClockName

SOCKET = "CORDON_DRILL"
"""The environment variable that names the socket."""
LOGS = "CORDON_DRILL_LOGS"
"""The environment variable that names the folder for the flight's log; missing or empty: not recorded."""


def main() -> int:
    """Fly, or supervise the process that flies."""
    hold_back()
    if not is_supervised():
        return supervise()
    from gcs.drill.failing_flight import fly  # noqa: PLC0415

    mission, duration, *governed = sys.argv[1:]
    clock, speed = (ClockName(int(governed[0])), float(governed[1])) if governed else (None, 1.0)
    return fly(mission, float(duration), clock, speed, socket=os.environ[SOCKET], logs=os.environ.get(LOGS, ""))


if __name__ == "__main__":
    sys.exit(main())
