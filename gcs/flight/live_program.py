"""The program of a flying process that another program operates: `python -m gcs.flight.live_program`.

Only `gcs.flight.live.process` starts it.
"""

import os
import sys
from multiprocessing.connection import Connection

from agents.ports import VehicleRefusedError
from gcs.errors import Exit, InputError
from gcs.flight.live.exchange import PROGRAM_VARIABLE, Failed, LiveRequest, Over
from gcs.flight.live.operating import ProgramLink
from gcs.flight.run import flown
from gcs.flight.supervisor import is_supervised, supervise
from gcs.metrics.ending import LostFlight
from gcs.signals import hold_back


class _Program:
    """Implements `gcs.flight.supervisor.FlightPage`: the program is told that its flying process was lost."""

    def __init__(self, descriptor: int) -> None:
        self.kept_open = (descriptor,)

    def lose(self, flight: LostFlight) -> None:
        ended = VehicleRefusedError(flight.reason, flight.next_step)
        with Connection(os.dup(self.kept_open[0])) as connection:
            connection.send(Failed(ended))

    def interrupt(self) -> None:
        pass


def main() -> int:
    """Fly, in a process of its own under a supervisor; return the exit code."""
    hold_back()
    descriptor = int(os.environ[PROGRAM_VARIABLE])
    if not is_supervised():
        return supervise(page=_Program(descriptor))
    del os.environ[PROGRAM_VARIABLE]
    os.set_inheritable(descriptor, False)
    with Connection(descriptor) as connection:
        request: LiveRequest = connection.recv()
        with ProgramLink(connection, request.program_id) as program:
            return _fly(request, program)


def _fly(request: LiveRequest, program: ProgramLink) -> Exit:
    try:
        flight, _ = flown(request.flight.plan(), request.recording, program)
    except InputError as error:
        program.send(Failed(error))
        return Exit.BAD_INPUT
    except VehicleRefusedError as refusal:
        program.send(Failed(refusal))
        return Exit.REFUSED
    program.send(Over(flight.record))
    return Exit.HOLDS


if __name__ == "__main__":
    sys.exit(main())
