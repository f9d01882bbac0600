"""Fence and zones written into a mission's text: nothing else changes, comments stay."""

import tomllib

import pytest

from gcs.errors import InputError
from gcs.mission.area_text import with_areas
from gcs.mission.file import parse_mission
from tests.support.mission_text import CASE2

FENCE = [[-20.0, -35.0], [200.0, -35.0], [200.0, 35.5], [-20.0, 35.0]]
SCHOOL = {"name": "school", "polygon_m": [[60.0, 20.0], [70.0, 20.0], [70.0, 30.0]], "ceiling_m": 120.0}
MAST = {"name": "mast", "center_m": [5.0, 28.0], "radius_m": 3.0}

WRITTEN = """# at the top
[mission]
name = "a"  # its name

[safety]
# before the fence
separation_m = 3.0
fence_m = [
  [0.0, 0.0],  # a corner ]
  [9.0, 0.0],
  [9.0, 9.0],
]
speed_max_m_s = 4.0

[[safety.no_fly]]
name = "old"
center_m = [1.0, 1.0]
radius_m = 1.0

[target]  # after a zone
path = [
  [1, 2],
]
"""


def test_only_fence_and_zones_change() -> None:
    made = with_areas(WRITTEN, FENCE, [SCHOOL, MAST])
    content, before = tomllib.loads(made), tomllib.loads(WRITTEN)
    assert content["safety"].pop("fence_m") == FENCE
    assert content["safety"].pop("no_fly") == [SCHOOL, MAST]
    del before["safety"]["fence_m"], before["safety"]["no_fly"]
    assert content == before
    for comment in ("# at the top", "# its name", "# before the fence", "# after a zone"):
        assert comment in made
    assert with_areas(made, FENCE, [SCHOOL, MAST]) == made
    assert tomllib.loads(with_areas(made, [], [])) == before


def test_a_bundled_mission_takes_them() -> None:
    mission = parse_mission(with_areas(CASE2, FENCE, [SCHOOL, MAST]), None)
    assert [list(corner) for corner in mission.safety.fence_m] == FENCE
    assert [each.name for each in mission.safety.no_fly] == ["school", "mast"]
    assert mission.safety.no_fly[0].ceiling_m == 120.0


def test_a_text_that_is_written_otherwise_is_refused() -> None:
    for text in (
        "safety = { separation_m = 3.0 }\n",
        "safety.separation_m = 3.0\nsafety.fence_m = [[0, 0], [1, 0], [1, 1]]\n",
    ):
        with pytest.raises(InputError, match=r"\[safety\]"):
            with_areas(text, FENCE, [SCHOOL])
