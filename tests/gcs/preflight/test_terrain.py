"""Heights above ground: on a plane that rises to the east, whose heights are known everywhere."""

import re
from dataclasses import replace
from math import cos, floor, radians
from pathlib import Path

import numpy as np
import pytest

from gcs.errors import InputError
from gcs.mission.elevation import Elevation, read_elevation
from gcs.mission.file import load_mission, parse_mission
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade
from gcs.preflight.terrain import terrain
from tests.support.mission_text import CASE2
from tests.support.wording import facts_missing

DEGREE_M = 111_195.0
"""Of latitude, on the sphere; the slopes below are about 0.3 % off on the ellipsoid."""


def plane(path: Path, slope: float, side: int = 1201) -> Path:
    """Write ground that rises to the east by `slope`; the file has whole metres."""
    east_m = np.linspace(0.0, DEGREE_M * cos(radians(47.4)), side)
    path.write_bytes(np.tile(np.round(slope * east_m), (side, 1)).astype(">i2").tobytes())
    return path


def found(mission: Mission, folder: Path, **safety: object) -> list[Finding]:
    changed = mission.safety.model_copy(update={"elevation": "N47E008.hgt", **safety})
    return list(terrain(replace(mission, safety=changed, folder=folder)))


def test_heights_above_sloping_ground_are_those_of_the_plane(tmp_path: Path) -> None:
    """Case 2 flies 120 m east at 8 m: on a slope of 4 % the ground there is 4.8 m higher, and 3.2 m are left."""
    plane(tmp_path / "N47E008.hgt", 0.04)
    mission = load_mission("case2")
    findings = found(mission, tmp_path)
    assert [finding.grade for finding in findings] == [Grade.PASS] * 3
    (least,) = {float(finding.found.split(" m above")[0].split()[-1]) for finding in findings[1:2]}
    assert least == pytest.approx(8.0 - 0.04 * 120.0, abs=0.6), "samples are whole metres"
    assert facts_missing(findings[1].found, "at (120, 0)", "required 3 m") == []
    higher = found(mission, tmp_path, min_height_above_ground_m=5.0)
    assert [finding.grade for finding in higher] == [Grade.REFUSE] * 3
    plane(tmp_path / "N47E008.hgt", -0.04, 3601)
    down = found(mission, tmp_path, min_height_above_ground_m=7.0)
    assert [finding.grade for finding in down] == [Grade.PASS] * 3
    assert list(terrain(mission)) == []


def test_ground_between_samples_is_bilinear_and_unknown_in_voids_and_outside() -> None:
    heights = np.array([[30.0, 40.0, 50.0], [10.0, 20.0, 30.0], [0.0, 10.0, np.nan]])
    ground = Elevation(47, 8, heights)
    assert ground.ground_m(48.0, 8.0) == 30.0
    assert ground.ground_m(47.0, 8.0) == 0.0
    assert ground.ground_m(47.75, 8.25) == pytest.approx(25.0)
    assert ground.ground_m(47.75, 9.0) == pytest.approx(40.0)
    assert [ground.ground_m(*place) for place in ((47.2, 8.8), (48.01, 8.5), (47.5, 7.9))] == [None] * 3


def test_a_file_that_is_none_is_refused(tmp_path: Path, subtests: pytest.Subtests) -> None:
    (tmp_path / "N47E008.hgt").write_bytes(b"\0" * 1000)
    (tmp_path / "field.hgt").write_bytes(b"\0" * 1000)
    for name, words in (
        ("N47E008.hgt", ("safety.elevation", "1000 bytes", "2884802")),
        ("field.hgt", ("safety.elevation", "'field.hgt'", "N47E008.hgt")),
        ("N48E008.hgt", ("safety.elevation", "No such file")),
    ):
        with subtests.test(name), pytest.raises(InputError) as caught:
            read_elevation(tmp_path / name)
        assert facts_missing(str(caught.value), *words) == []
    (refused,) = found(load_mission("case2"), tmp_path)
    assert refused.grade is Grade.REFUSE
    plane(tmp_path / "N47E009.hgt", 0.0)
    elsewhere = found(load_mission("case2"), tmp_path, elevation="N47E009.hgt")
    assert {finding.grade for finding in elsewhere} == {Grade.WARNING}
    assert facts_missing(elsewhere[0].found, "47.397", "8.545", "not in N47E009.hgt") == []


def test_places_with_ground_are_judged_beside_those_without(tmp_path: Path) -> None:
    """On a slope of 8 %, 8 m leave 3 m of height after 62 m east; from the sample there on, 81 m east, are voids."""
    heights = np.frombuffer(plane(tmp_path / "N47E008.hgt", 0.08).read_bytes(), ">i2").reshape(1201, 1201).copy()
    heights[:, floor(0.545594 * 1200) + 3 :] = -32768
    (tmp_path / "N47E008.hgt").write_bytes(heights.tobytes())
    mission = load_mission("case2")
    findings = [each for each in found(mission, tmp_path) if each.about == mission.ids[0]]
    assert [each.grade for each in findings] == [Grade.WARNING, Grade.REFUSE]
    assert facts_missing(findings[0].found, "not in N47E008.hgt") == []
    assert facts_missing(findings[1].found, "required 3 m") == []


def test_places_beyond_the_fence_are_not_judged(tmp_path: Path) -> None:
    """The ground rises by 10 %: at 8 m it is met after 80 m, and the fence ends after 45 m."""
    plane(tmp_path / "N47E008.hgt", 0.1)
    mission = load_mission("case2")
    fence_m = ((-20.0, -60.0), (45.0, -60.0), (45.0, 60.0), (-20.0, 60.0))
    assert {each.grade for each in found(mission, tmp_path)} == {Grade.REFUSE}
    fenced = found(mission, tmp_path, fence_m=fence_m)
    assert {each.grade for each in fenced} == {Grade.PASS}
    assert facts_missing(fenced[0].found, "at (45, ") == []


def test_a_local_frame_has_no_elevation() -> None:
    local = re.sub(r"\[frame\][^\[]*", "[frame]\nlocal = true\n\n", CASE2)
    assert parse_mission(local, None).frame.local
    with pytest.raises(InputError) as caught:
        parse_mission(local.replace("[safety]\n", '[safety]\nelevation = "N47E008.hgt"\n'), None)
    assert facts_missing(str(caught.value), "safety.elevation", "local") == []
