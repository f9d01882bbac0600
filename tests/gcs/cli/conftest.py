"""Running commands in the process of the test."""

import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gcs.cli import main
from gcs.flight.supervision.protocol import HEARTBEAT_VARIABLE


@pytest.fixture
def refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., list[str]]:
    """Return a runner of commands that have to end as bad input before they do anything: what they complain about.

    It runs them in this process, which is faster; the process gives users the same. For `fly` this process is the one
    that would fly.
    """

    def complaints(*arguments: str) -> list[str]:
        monkeypatch.setattr(sys, "argv", ["cordon", *arguments])
        monkeypatch.chdir(tmp_path)
        supervisor, flying = socket.socketpair()
        monkeypatch.setenv(HEARTBEAT_VARIABLE, str(os.dup(flying.fileno())))
        with supervisor, flying, pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        assert (ended.value.code, out) == (2, "")
        assert "metrics and verdicts" not in err, "it flew"
        return err.splitlines()

    return complaints
