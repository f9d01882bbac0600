"""The program of the log process: `python -m gcs.flight.log_program SOCKET`, started only by the handle."""

import os
import signal
import sys
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection

from foxglove import Context

from agents.ports import VehicleRefusedError
from gcs.flight.log_process import CLOSE, FLUSH, BatchReader, LogRequest, LogStatus
from gcs.flightlog.writer import LogWriter
from gcs.signals import ENDING
from gcs.viewer.live_server import live_server
from gcs.viewer.scene import Scene

NICENESS = 5
"""Lower priority than the flying process: control loops come first on a busy processor."""


def main() -> None:
    """Write until the flying process closes the log or has ended. That process handles the signals."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)
    with Connection(int(sys.argv[1])) as connection, ExitStack() as stack, suppress(BrokenPipeError, EOFError):
        try:
            writer = _opened(connection.recv(), stack)
        except (OSError, VehicleRefusedError) as error:
            connection.send(error)
        else:
            _serve(connection, writer)


def _opened(request: LogRequest, stack: ExitStack) -> LogWriter:
    """Open the log, and serve it to viewers as long as the stack is open."""
    context = Context()
    if request.address is not None:
        stack.enter_context(live_server(request.address, context, request.origins))
    return LogWriter(request.path, context, Scene(context, request.mission))


def _serve(connection: Connection, writer: LogWriter) -> None:
    connection.send(_status(writer))
    try:
        _write(connection, writer)
    finally:
        writer.close()
        connection.send(_status(writer))


def _write(connection: Connection, writer: LogWriter) -> None:
    reader = BatchReader()
    while (frame := connection.recv_bytes()) != CLOSE:
        if frame == FLUSH:
            writer.flush()
            connection.send(_status(writer))
            continue
        for row in reader.rows(frame):
            try:
                writer.write(row.vehicle_id, row.number, row.log_time_ns, reader.record(row))
            except Exception as error:  # a bug with one record must not lose the others
                writer.fail(f"a {row.kind} could not be written: {type(error).__name__}: {error}")


def _status(writer: LogWriter) -> LogStatus:
    return LogStatus(writer.size_bytes, writer.fault)


if __name__ == "__main__":
    main()
