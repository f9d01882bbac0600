"""What several verbs share: the mission that they were given."""

import pytest

from gcs.cli.options import stub_ids, with_stubs
from gcs.errors import InputError
from gcs.mission.file import load_mission


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("fly case2", "fly case2"),
        ("fly case2 --sitl", "fly case2 --sitl=all"),
        ("fly --sitl case2 --speed 3", "fly --sitl=all case2 --speed 3"),
        ("fly case2 --sitl 2,3 --json", "fly case2 --sitl=2,3 --json"),
        ("fly case2 --sitl=2", "fly case2 --sitl=2"),
        ("excite case2 --sitl", "excite case2 --sitl"),
    ],
)
def test_sitl_takes_vehicles_or_none(line: str, expected: str) -> None:
    assert with_stubs(line.split()) == expected.split()


@pytest.mark.parametrize(
    ("given", "faults"),
    [
        (
            "4,2,9",
            [
                "--sitl: the mission has no vehicle 4 (it has 1, 2, 3)",
                "--sitl: the mission has no vehicle 9 (it has 1, 2, 3)",
            ],
        ),
        ("2,3,2", ["--sitl: vehicle 2 is given twice"]),
        ("2;3", ["--sitl: '2;3' is not a list of vehicles like 2,3"]),
        ("", ["--sitl: '' is not a list of vehicles like 2,3"]),
    ],
)
def test_vehicles_that_cannot_be_stubs_are_named(given: str, faults: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        stub_ids(given, load_mission("case2"))
    assert list(caught.value.faults) == faults


def test_stubs_are_all_or_those_named() -> None:
    mission = load_mission("case2")
    assert stub_ids("all", mission) == mission.ids
    assert stub_ids("3,1", mission) == (3, 1)
