"""Running commands in the process of the test."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from gcs.flight.supervision_protocol import HEARTBEAT_VARIABLE
from tests.conftest import RunHere


@pytest.fixture
def refused(run_here: RunHere, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[str]]:
    """Return a runner of commands that have to end as bad input before they do anything: what they complain about.

    For `fly` this process is the one that would fly.
    """

    def complaints(*arguments: str) -> list[str]:
        monkeypatch.chdir(tmp_path)
        supervisor, flying = socket.socketpair()
        monkeypatch.setenv(HEARTBEAT_VARIABLE, str(os.dup(flying.fileno())))
        with supervisor, flying:
            code, out, err = run_here(*arguments)
        assert (code, out) == (2, "")
        assert "metrics and verdicts" not in err, "it flew"
        return err.splitlines()

    return complaints
