"""The stub vehicles in a separate process: the parent's handle, and what the process answers."""

import asyncio
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import NamedTuple

from estimation.frames import Triple
from sitl.faults import VehicleInjection
from sitl.server.endpoint import StubClock
from sitl.server.governed_clock import GovernedClock
from sitl.server.one_core import OneCore
from sitl.server.record import StubRecord
from sitl.server.server import Stub, StubConfig, serve
from sitl.server.shared_clock import ClockError
from sitl.server.true_state import TrueState


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

    def __call__(self, stub: Stub) -> None:
        """Inject it."""
        stub.inject(self.injection)


class StubAnswer(NamedTuple):
    """Sent to the parent: the true state of a vehicle, and why it refused a request (empty if it did not)."""

    state: TrueState
    refusal: str


@dataclass(frozen=True, slots=True)
class StubRequest:
    """Sent by the parent to be answered: a function of a stub and its arguments, None for the state alone."""

    vehicle_id: int
    call: Callable[..., str] | None = None
    arguments: tuple[Triple, ...] = ()

    def answer(self, stub: Stub) -> StubAnswer:
        """Carry it out."""
        refusal = "" if self.call is None else self.call(stub, *self.arguments)
        return StubAnswer(stub.state(), refusal)


def run_in_process(configs: Sequence[StubConfig], make_clock: Callable[[], StubClock], connection: Connection) -> None:
    """Serve stubs: what the process of `sitl.server.program` does.

    Sends StubReady or StubFailed, takes StubInjections and StubRequests, runs until None arrives through `connection`,
    then sends its StubRecord. It also ends when the parent has ended, and ignores Ctrl-C, which the parent handles.
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

    def answer(request: StubRequest) -> None:
        with suppress(OSError):  # the parent has ended
            connection.send(request.answer(served[request.vehicle_id]))

    def listen() -> None:
        with suppress(EOFError, OSError):  # the parent has ended: stop as well
            while (message := connection.recv()) is not None:
                if isinstance(message, StubRequest):
                    loop.call_soon_threadsafe(answer, message)
                else:
                    loop.call_soon_threadsafe(message, served[message.vehicle_id])
        with suppress(RuntimeError):  # the loop is closed already
            loop.call_soon_threadsafe(stop.set)

    def begin(stubs: Sequence[Stub]) -> None:
        served.update((stub.config.vehicle_id, stub) for stub in stubs)
        threading.Thread(target=listen, daemon=True).start()
        connection.send(StubReady())

    clock = make_clock()
    try:
        with OneCore() if isinstance(clock, GovernedClock) else nullcontext():
            return await serve(configs, clock, stop, begin)
    finally:
        clock.close()


_PROGRAM = "sitl.server.program"


class StubProcess:
    """The parent's handle: start the stubs, later stop them and collect their record."""

    def __init__(self, configs: Sequence[StubConfig], make_clock: Callable[[], StubClock]) -> None:
        """Prepare a process; nothing runs yet. `make_clock` is pickled, and makes the stubs' clock in that process."""
        self._work = (tuple(configs), make_clock)
        self._process: subprocess.Popen[bytes] | None = None
        self._asking = threading.Lock()

    @property
    def pid(self) -> int | None:
        """The process id, None before the start."""
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Start and wait until every vehicle can be reached; raises OSError when that fails."""
        self._connection, theirs = Pipe()
        with theirs:
            # Not by multiprocessing: it would import the parent's main program, which may be anything.
            command = [sys.executable, "-m", _PROGRAM, str(theirs.fileno())]
            self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)
        try:
            self._connection.send(self._work)
            answer = self._connection.recv()
        except (EOFError, OSError):
            answer = StubFailed("the stub ended before it was ready")
        except BaseException:  # Ctrl-C: the process ends as its connection does
            self._connection.close()
            raise
        if isinstance(answer, StubFailed):
            self._process.wait()
            raise OSError(answer.reason)

    def inject(self, vehicle_id: int, injection: VehicleInjection) -> None:
        """Inject faults into the vehicle of a system id from now on; raises OSError if the stub has ended."""
        self._connection.send(StubInjection(vehicle_id, injection))

    def ask(self, request: StubRequest) -> StubAnswer:
        """Return the answer to a request; raises OSError if the stub has ended."""
        with self._asking:
            try:
                self._connection.send(request)
                return self._connection.recv()  # type: ignore[no-any-return]  # sent by _serve_until_stopped
            except EOFError as error:
                raise OSError("the stub has ended") from error

    def stop(self) -> StubRecord:
        """Stop and return the record; raises OSError if the stub ended without one."""
        try:
            self._connection.send(None)
            answer = self._connection.recv()
        except (EOFError, OSError):
            answer = StubFailed("the stub ended before it was stopped")
        self._connection.close()
        if self._process is not None:
            self._process.wait()
        if isinstance(answer, StubFailed):
            raise OSError(answer.reason)
        return answer  # type: ignore[no-any-return]  # pickled by run_in_process
