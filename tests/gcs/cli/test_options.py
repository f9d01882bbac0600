"""What several verbs share: the mission that they were given."""

from pathlib import Path

import pytest

from gcs.cli.options import loaded_mission
from gcs.mission.file import load_mission
from tests.support.mission_text import content, put, text_of


def test_keys_that_moved_are_told_on_standard_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "old.toml"
    path.write_text(text_of(put(content(), ("vehicles", 0, "plant"), "px4")))
    mission = loaded_mission(str(path))
    out, err = capsys.readouterr()
    assert out == ""
    assert len(mission.warnings) == 1
    assert err.splitlines() == [f"warning: {mission.warnings[0]}"]


def test_a_mission_of_today_is_loaded_without_a_word(capsys: pytest.CaptureFixture[str]) -> None:
    assert loaded_mission("case2") == load_mission("case2")
    assert capsys.readouterr() == ("", "")
