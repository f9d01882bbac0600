"""The program of the stubs' process: `python -m sitl.server.program SOCKET`, started only by the handle."""

import sys
from contextlib import suppress
from multiprocessing.connection import Connection

from sitl.server.process import run_in_process


def main() -> None:
    """Serve the stubs that the parent sends, until it stops them or has ended."""
    with Connection(int(sys.argv[1])) as connection, suppress(EOFError):
        configs, make_clock = connection.recv()
        run_in_process(configs, make_clock, connection)


if __name__ == "__main__":
    main()
