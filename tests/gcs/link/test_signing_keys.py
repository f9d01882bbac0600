"""The file of signing keys: who may read it, and what is wrong with it."""

from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.link.signing_keys import issue_keys, read_keys, signing_keys
from gcs.mission.file import load_mission, mission_path

MISSION = mission_path("case2")


def test_keys_are_made_once_and_only_their_user_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "mavlink.keys"
    first = issue_keys(path, [1, 2])
    assert path.stat().st_mode & 0o777 == 0o600
    assert len({*first.values()}) == 2
    assert {len(key) for key in first.values()} == {32}
    second = issue_keys(path, [2, 3])
    assert second.items() > first.items()
    assert read_keys(path) == second
    assert [each.name for each in tmp_path.iterdir()] == ["mavlink.keys"]


@pytest.mark.parametrize(
    ("text", "mode", "fault"),
    [
        (f'1 = "{"ab" * 32}"', 0o644, "chmod 600"),
        (f'1 = "{"ab" * 31}"', 0o600, "64 hexadecimal digits"),
        (f'1 = "{"00" * 32}"', 0o600, "64 hexadecimal digits"),
        (f'300 = "{"ab" * 32}"', 0o600, "system id"),
        ("1 = ", 0o600, "Invalid value"),
        ("1 = " + "[" * 5000, 0o600, "nested too deeply"),
        ("#" * 70_000, 0o600, "larger"),
        (None, 0, "keys issue mavlink"),
    ],
)
def test_a_file_that_cannot_be_used_is_bad_input(text: str | None, mode: int, fault: str, tmp_path: Path) -> None:
    path = tmp_path / "mavlink.keys"
    if text is not None:
        path.write_text(text)
        path.chmod(mode)
    with pytest.raises(InputError) as error:
        read_keys(path)
    assert str(path) in str(error.value)
    assert fault in str(error.value)
    assert "abab" not in str(error.value), "a key was repeated"


def test_a_mission_needs_a_key_for_each_vehicle(tmp_path: Path) -> None:
    text = MISSION.read_text()
    assert signing_keys(load_mission(str(MISSION))) == {}
    path = tmp_path / "signed.toml"
    path.write_text(text + '\n[link]\nsigning_key_file = "mavlink.keys"\n')
    mission = load_mission(str(path))  # reading a mission opens no key file
    issue_keys(tmp_path / "mavlink.keys", [1, 3])
    with pytest.raises(InputError, match="system id 2"):
        signing_keys(mission)
    issue_keys(tmp_path / "mavlink.keys", [2])
    assert signing_keys(mission).keys() == {1, 2, 3}
