"""The stub vehicles in a separate process: its entry point, and the parent's handle."""

import asyncio
import multiprocessing
import signal
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection

from sitl.faults import VehicleInjection
from sitl.server.endpoint import StubClock
from sitl.server.server import Stub, StubConfig, StubRecord, serve
from sitl.server.shared_clock import ClockError


@dataclass(frozen=True, slots=True)
class StubReady:
    """Sent to the parent once every socket is bound."""


@dataclass(frozen=True, slots=True)
class StubFailed:
    """Sent to the parent with the reason why the stub cannot run."""

    reason: str


@dataclass(frozen=True, slots=True)
class StubInjection:
    """Sent by the parent: an injection into the vehicle of a system id."""

    vehicle_id: int
    injection: VehicleInjection


def run_in_process(configs: Sequence[StubConfig], make_clock: Callable[[], StubClock], connection: Connection) -> None:
    """Serve stubs: the target of a spawned multiprocessing.Process.

    Sends StubReady or StubFailed, takes StubInjections, runs until None arrives through `connection`, then sends its
    StubRecord. It also ends when the parent has ended, and ignores Ctrl-C, which the parent handles.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())  # the parent may block signals
    with suppress(BrokenPipeError):
        try:
            record = asyncio.run(_serve_until_stopped(configs, make_clock, connection))
        except (OSError, ValueError, ClockError) as error:
            connection.send(StubFailed(str(error)))
        else:
            connection.send(record)


async def _serve_until_stopped(
    configs: Sequence[StubConfig], make_clock: Callable[[], StubClock], connection: Connection
) -> StubRecord:
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    served: dict[int, Stub] = {}

    def listen() -> None:
        with suppress(EOFError, OSError):  # the parent has ended: stop as well
            while (message := connection.recv()) is not None:
                loop.call_soon_threadsafe(served[message.vehicle_id].inject, message.injection)
        with suppress(RuntimeError):  # the loop is closed already
            loop.call_soon_threadsafe(stop.set)

    def begin(stubs: Sequence[Stub]) -> None:
        served.update((stub.config.vehicle_id, stub) for stub in stubs)
        threading.Thread(target=listen, daemon=True).start()
        connection.send(StubReady())

    clock = make_clock()
    try:
        return await serve(configs, clock, stop, begin)
    finally:
        clock.close()


class StubProcess:
    """The parent's handle: start the stubs, later stop them and collect their record."""

    def __init__(self, configs: Sequence[StubConfig], make_clock: Callable[[], StubClock]) -> None:
        """Prepare a process; nothing runs yet. `make_clock` is pickled, and makes the stubs' clock in that process."""
        context = multiprocessing.get_context("spawn")
        self._connection, self._theirs = context.Pipe()
        self._process = context.Process(
            target=run_in_process, args=(tuple(configs), make_clock, self._theirs), daemon=True
        )

    @property
    def pid(self) -> int | None:
        """The process id, None before the start."""
        return self._process.pid

    def start(self) -> None:
        """Start and wait until every vehicle can be reached; raises OSError when that fails."""
        # The first start in a process unblocks SIGINT and SIGTERM (multiprocessing's resource tracker).
        held_back = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, held_back)
        self._theirs.close()
        try:
            answer = self._connection.recv()
        except EOFError:
            answer = StubFailed("the stub ended before it was ready")
        if isinstance(answer, StubFailed):
            self._process.join()
            raise OSError(answer.reason)

    def inject(self, vehicle_id: int, injection: VehicleInjection) -> None:
        """Inject faults into the vehicle of a system id from now on; raises OSError if the stub has ended."""
        self._connection.send(StubInjection(vehicle_id, injection))

    def stop(self) -> StubRecord:
        """Stop and return the record; raises OSError if the stub ended without one."""
        try:
            self._connection.send(None)
            answer = self._connection.recv()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            answer = StubFailed("the stub ended before it was stopped")
        self._process.join()
        if isinstance(answer, StubFailed):
            raise OSError(answer.reason)
        return answer  # type: ignore[no-any-return]  # pickled by run_in_process
