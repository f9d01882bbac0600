"""Bad input of `cordon station`, and of commands that show its page: named before anything is served or flown."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.page.map_tiles import mbtiles
from tests.support.paths import DATA

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
