"""`cordon cot`: bad input is named, and ends in exit code 2."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import RunHere

TO = ("--to", "udp://127.0.0.1:4242")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ((), "--to"),
        (("--to", "ftp://127.0.0.1:4242"), "'ftp'"),
        (("--to", "127.0.0.1:4242"), "'127.0.0.1:4242'"),
        (("--to", "udp://127.0.0.1"), "'udp://127.0.0.1'"),
        (("--to", "udp://127.0.0.1:99999"), "'udp://127.0.0.1:99999'"),
        (("--from", "udp:///x"), "'udp:///x'"),
        (("--from", "udp://0.0.0.0:4243"), "--track"),
        ((*TO, "--track", "BOAT"), "--from"),
        ((*TO, "--target", "boat"), "'boat'"),
        ((*TO, "--geoid", "500"), "150"),
        ((*TO, "--cert", "own.p12"), "--cert"),
        (("--to", "tls://127.0.0.1:8089"), "--cert"),
        (("--to", "tls://127.0.0.1:8089", "--cert", "none.p12"), "'none.p12'"),
        (("no-mission", *TO), "no-mission"),
    ],
)
def test_bad_options_are_named(run_here: RunHere, words: tuple[str, ...], named: str) -> None:
    ran = run_here("cot", *words)
    assert ran.code == 2
    assert named in ran.err


def test_a_local_frame_is_refused(run_here: RunHere, mission_file: Callable[..., str]) -> None:
    path = Path(mission_file("case2"))
    head, _, rest = path.read_text().partition("[frame]\n")
    _, _, rest = rest.partition("\n[")
    path.write_text(f"{head}[frame]\nlocal = true\n\n[{rest}")
    ran = run_here("cot", str(path), *TO)
    assert ran.code == 2
    assert "local" in ran.err


def test_without_pytak_the_next_step_is_named(run_here: RunHere, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pytak", None)
    ran = run_here("cot", *TO)
    assert ran.code == 2
    assert "pip install 'cordon-gcs[cot]'" in ran.err
