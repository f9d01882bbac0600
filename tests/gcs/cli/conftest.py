"""Running commands in the process of the test."""

import os
import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from gcs.flight.supervision_protocol import HEARTBEAT_VARIABLE
from tests.conftest import RunHere

FlyingHere = Callable[[], AbstractContextManager[None]]


@pytest.fixture
def flying_here(monkeypatch: pytest.MonkeyPatch) -> FlyingHere:
    """Return a context in which this process is the one that would fly, for one command."""

    @contextmanager
    def flying() -> Iterator[None]:
        supervisor, flight = socket.socketpair()
        with supervisor, flight, monkeypatch.context() as patched:
            patched.setenv(HEARTBEAT_VARIABLE, str(os.dup(flight.fileno())))
            yield

    return flying


@pytest.fixture
def refused(
    run_here: RunHere, flying_here: FlyingHere, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[str]]:
    """Return a runner of commands that have to end as bad input before they do anything: what they complain about."""

    def complaints(*arguments: str) -> list[str]:
        monkeypatch.chdir(tmp_path)
        with flying_here():
            code, out, err = run_here(*arguments)
        assert (code, out) == (2, "")
        assert "metrics and verdicts" not in err, "it flew"
        return err.splitlines()

    return complaints
