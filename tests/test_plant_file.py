"""Plant files: what is bundled, what a user's own may say, and how its faults are told."""

from pathlib import Path

import pytest

from estimation.plant import Plant, PlantAxis
from estimation.plant_file import PlantFileError, bundled_plants, load_plant

AXES = "[x]\na0_per_s2 = 0.5\na1_per_s = 1\n[y]\na0_per_s2 = 0.6\na1_per_s = 1.1\n"


def test_the_bundled_plants_load(tmp_path: Path) -> None:
    axis = PlantAxis(0.80, 0.87)
    assert {name: load_plant(name, tmp_path) for name in bundled_plants()} == {
        "ardupilot": Plant(PlantAxis(0.97, 1.33), PlantAxis(0.97, 1.33), 0.03),
        "px4": Plant(PlantAxis(1.7, 1.8), PlantAxis(1.7, 1.8), 0.2),
        "stub": Plant(axis, axis),
        "stub-delayed": Plant(axis, axis, 0.15),
    }


def test_a_file_of_the_users_own_is_found_beside_the_mission(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text("delay_s = 0.2\n" + AXES)
    assert load_plant("own.toml", tmp_path) == Plant(PlantAxis(0.5, 1.0), PlantAxis(0.6, 1.1), 0.2)


def test_a_missing_file_names_the_bundled_ones(tmp_path: Path) -> None:
    with pytest.raises(
        PlantFileError, match=r"no plant file 'stubb' .*bundled plants: ardupilot, px4, stub, stub-delayed"
    ):
        load_plant("stubb", tmp_path)


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"a0 = = 1", "'own.toml' is not TOML"),
        (b"\xff\xfe", "'own.toml' is not TOML"),
        (AXES.encode() + b"extra = 1\n", "own.toml: y.extra: Extra inputs are not permitted"),
        (b"delay_s = 1.5\n" + AXES.encode(), "own.toml: delay_s: Input should be less than or equal to 1"),
        (AXES.replace("0.6", "nan").encode(), "own.toml: y.a0_per_s2: Input should be a finite number"),
        (AXES.replace("0.6", "'0.6'").encode(), "own.toml: y.a0_per_s2: Input should be a valid number"),
        (AXES.replace("0.6", "-0.6").encode(), "own.toml: y: a0_per_s2 = -0.6 makes the plant unstable"),
    ],
)
def test_a_fault_is_told_with_its_place(content: bytes, fault: str, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_bytes(content)
    with pytest.raises(PlantFileError) as caught:
        load_plant("own.toml", tmp_path)
    assert len(caught.value.faults) == 1
    assert caught.value.faults[0].startswith(fault)


@pytest.mark.parametrize("wrong", [{"0.5": "-0.5", "0.6": "0.0"}, {"a0_per_s2 = 0.5\n": "", "1.1": "true"}])
def test_all_faults_are_told_at_once(wrong: dict[str, str], tmp_path: Path) -> None:
    content = AXES
    for right, fault in wrong.items():
        content = content.replace(right, fault)
    (tmp_path / "own.toml").write_text(content)
    with pytest.raises(PlantFileError) as caught:
        load_plant("own.toml", tmp_path)
    assert [fault.split(":")[1].strip()[0] for fault in caught.value.faults] == ["x", "y"]
