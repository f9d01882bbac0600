"""Bad input of `cordon station`, and of commands that show its page: named before anything is served or flown.

And Ctrl-C as soon as the page's address is shown.
"""

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from socket import socket
from types import SimpleNamespace
from typing import Any

import pytest

from gcs.cli import station as command
from gcs.console import terminal
from gcs.errors import Exit
from gcs.station.access import checked_access
from gcs.viewer.origin_gate import Address
from tests.support.page.map_tiles import mbtiles
from tests.support.paths import DATA
from tests.support.wire import LOOPBACK, free_port

Refused = Callable[..., list[str]]
LOCAL_FRAME = ("latitude_deg = 47.397742\nlongitude_deg = 8.545594\naltitude_m = 488.0", "local = true")


def test_an_address_or_a_token_that_cannot_be_is_named(refused: Refused, subtests: pytest.Subtests) -> None:
    for name, arguments, words in (
        ("every host", ("--address", "0.0.0.0:8766"), "--tls"),
        ("no port", ("--address", "localhost"), "--address"),
        ("no token", ("--token-file", "/nowhere"), "/nowhere"),
    ):
        with subtests.test(name):
            assert words in "".join(refused("station", *arguments))


def test_tiles_that_cannot_be_drawn_are_named(
    mission_file: Callable[..., str], tmp_path: Path, refused: Refused, subtests: pytest.Subtests
) -> None:
    vector = str(mbtiles(tmp_path / "vector.mbtiles", [(0, 0, 0, b"a vector tile")], format="pbf"))
    local = mission_file("case2", LOCAL_FRAME)
    for arguments, words in (
        (("station", "--tiles", vector), "'pbf'"),
        (("sim", "case2", "--station", "--station-tiles", vector), "'pbf'"),
        (("sim", "case2", "--station-tiles", vector), "--station"),
        (("station", "--mission", local, "--tiles", vector), "local"),
    ):
        with subtests.test(words, verb=arguments[0]):
            told = "".join(refused(*arguments))
            assert words in told
            assert "http" not in told


def test_a_log_that_is_none_of_cordons_is_named(tmp_path: Path, refused: Refused, subtests: pytest.Subtests) -> None:
    text = tmp_path / "text.mcap"
    text.write_text("no log")
    for log in (DATA / "px4-quad.ulg", DATA / "arducopter.bin", text, tmp_path / "none.mcap"):
        with subtests.test(log.name):
            assert log.name in "".join(refused("station", str(log)))


def test_ctrl_c_counts_as_soon_as_the_address_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    ending: Any = SimpleNamespace(pipe=None, stop=lambda: pytest.fail("as before anything was served"))
    monkeypatch.setattr(terminal, "print_line", lambda *_: ending.stop())

    async def serve(listening: Sequence[socket], stop: asyncio.Event) -> None:
        await stop.wait()
        for each in listening:
            each.close()

    access = checked_access(Address(LOOPBACK, free_port()), None, None)
    assert command._serve(serve, access, "team", ending) is Exit.HOLDS
