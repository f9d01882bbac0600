"""`cordon new`: the file it writes, what it refuses, and that it writes nothing then."""

import os
import pty
import re
import sys
import time
import tomllib
from functools import partial
from itertools import product
from math import ceil
from pathlib import Path
from typing import get_args

import psutil
import pytest

import cordon
from agents.settings.shapes import SPACED_SHAPES
from gcs.mission.file import bundled_missions, load_mission, parse_mission
from gcs.mission.template import PROFILES, Links, NewMission, least_radius_m, own_ports
from gcs.preflight.findings import Grade
from gcs.preflight.mission import feasibility
from tests.conftest import RunHere
from tests.support.wording import facts_missing

pytestmark = pytest.mark.slow

CHOICES = {
    "--vehicles": "5",
    "--links": "stub",
    "--shape": "wedge",
    "--radius": "15",
    "--rate": "0.1",
    "--target": "moving",
    "--fence": "20",
}


def words(**changes: str) -> list[str]:
    return [word for pair in {**CHOICES, **changes}.items() for word in pair]


@pytest.fixture
def new(run_here: RunHere, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunHere:
    """Return a runner of `cordon new my.toml` in an empty folder, without a terminal."""
    monkeypatch.chdir(tmp_path)
    return partial(run_here, "new", "my.toml")


def chosen(**changes: object) -> NewMission:
    usual = {"name": "my", "vehicles": 5, "links": "stub", "profile": "stub", "shape": "line", "radius_m": 15.0}
    more = {"angular_rate_rad_s": 0.1, "target_speed_m_s": 0.1, "fence_m": 20.0, "ports": range(20000, 20254)}
    return NewMission(**{**usual, **more, **changes})  # type: ignore[arg-type]  # by name


@pytest.mark.parametrize("count", [2, 3, 64, 200, 254])
def test_a_mission_of_any_size_is_accepted(count: int) -> None:
    """With the radius and the rate that the questions propose."""
    radius_m = float(max(10, ceil(1.5 * least_radius_m(count))))
    text = chosen(vehicles=count, radius_m=radius_m, angular_rate_rad_s=min(0.1, 1.0 / radius_m)).text
    mission = parse_mission(text, Path(), {})
    if count <= 64:  # a larger one takes half a minute
        assert [each.found for each in feasibility(mission) if each.grade is not Grade.PASS] == []
        flown = cordon.simulate(mission, duration_s=2.0)
        assert {*flown.vehicles} == {*mission.ids}


def test_a_mission_of_ones_own_settles_on_its_ring(new: RunHere, tmp_path: Path) -> None:
    code, _, said = new(*words(**{"--vehicles": "3", "--profile": "0.8,0.9,0.1", "--plot": "my.svg"}))
    assert code == 0
    assert "3 of 3 vehicles engaged" in said
    assert "settled after" in said
    assert "next: cordon fly my.toml --sitl --speed 10" in said
    assert (tmp_path / "my.svg").stat().st_size > 0
    mission = load_mission("my.toml")
    ring, target = mission.encirclement, mission.target
    assert (len(mission.vehicles), mission.formation.shape) == (3, "wedge")
    assert (ring.radius_m, ring.angular_rate_rad_s) == (15.0, 0.1)
    assert target.velocity_m_s == (0.1, 0.0)
    plant = mission.vehicles[0].plant
    assert (plant.x.a0_per_s2, plant.y.a1_per_s, plant.delay_s) == (0.8, 0.9, 0.1)
    before = {path: path.read_bytes() for path in tmp_path.glob("*.toml")}
    code, _, said = new(*words())
    assert code == 2
    assert "my.toml exists already" in said
    assert {path: path.read_bytes() for path in tmp_path.glob("*.toml")} == before


def test_what_would_not_hold_is_refused_before_anything_is_written(
    new: RunHere, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    for option, value, *says in (
        ("--radius", "2", "--radius", "2.56", "3 m between vehicles"),
        ("--rate", "0.3", "encirclement.angular_rate_rad_s", "4.60 m/s", "3.0 m/s"),
        ("--vehicles", "0", "--vehicles", "'0'"),
        ("--links", "wifi", "--links", '"wifi"', "stub"),
        ("--profile", "0.8,0.9", "--profile", "A0,A1,DELAY", "'0.8,0.9'"),
        ("--profile", "0.8,-1,0", "--profile", "'-1'"),
        ("--profile", "mine.toml", "vehicles[0].profile", "'mine.toml'", "bundled profiles: "),
    ):
        with subtests.test(option=option, value=value):
            code, _, said = new(*words(**{option: value}))
            assert code == 2
            assert facts_missing(said, *says) == [], said
            assert list(tmp_path.iterdir()) == []


def test_the_next_command_fits_the_links_and_the_place_is_taken(new: RunHere) -> None:
    ran = new(*words(**{"--vehicles": "1", "--links": "serial", "--place": "47.1,8.2,450,30"}))
    assert "next: cordon check my.toml" in ran.err
    frame = load_mission("my.toml").frame
    assert (frame.latitude_deg, frame.longitude_deg, frame.altitude_m, frame.x_bearing_deg) == (47.1, 8.2, 450.0, 30.0)


def test_real_vehicles_have_no_default_place(new: RunHere, tmp_path: Path, subtests: pytest.Subtests) -> None:
    for place in (None, "47.1,8.2", "147.1,8.2,450", "47.1,8.2,x"):
        with subtests.test(place=place):
            code, _, said = new(*words(**{"--links": "udp"} | ({"--place": place} if place else {})))
            assert code == 2
            assert said.startswith("--place: " if place else "--place: missing")
            assert list(tmp_path.iterdir()) == []


def test_target_starts_where_it_is_told_and_inside_the_fence(new: RunHere) -> None:
    code, _, said = new(*words(**{"--vehicles": "1", "--target-start": "50,-8", "--target": "rest"}))
    assert code == 0, said
    assert "ring: 0.1 rad/s on 15 m: 1.5 m/s, a lap in 63 s\n" in said, "a lap takes 2 pi / 0.1 s"
    mission = load_mission("my.toml")
    assert mission.target.start_m == (50.0, -8.0)
    corners = mission.safety.fence_m
    assert corners is not None
    assert (min(y for _, y in corners), max(x for x, _ in corners)) == (-43.0, 85.0)  # 15 m of ring and 20 m of margin


def test_without_a_terminal_every_missing_option_is_named(new: RunHere, tmp_path: Path) -> None:
    code, _, said = new("--vehicles", "5", "--shape", "wedge")
    assert code == 2
    missing = [line.partition(":")[0] for line in said.splitlines()]
    assert missing == ["--links", "--radius", "--rate", "--target", "--fence"]
    assert list(tmp_path.iterdir()) == []


COLOUR = re.compile(r"\x1b\[[\d;]*m")
ANSWERS = (
    ("File to write? (my.toml)", ""),
    ("(stub)", "udp"),
    ("(px4)", ""),
    ("LATITUDE,LONGITUDE,ALTITUDE of the ground?", ""),
    ("--place: LATITUDE,LONGITUDE,ALTITUDE, such as", "47.1,8.2,450"),
    ("(line)", ""),
    ("Radius of the ring in m?", "20"),
    ("(0.05 rad/s on 20 m: 1 m/s, a lap in 126 s)?", "0.1"),
    ("ring: 0.1 rad/s on 20 m: 2 m/s, a lap in 63 s", ""),
    ("Where is the target at first: ahead, or X,Y in m", "30,5"),
)
"""What `cordon new` asks of real vehicles and prints, and what is answered. A lap takes 2 pi / rate."""


def test_ctrl_c_at_a_question_writes_nothing(tmp_path: Path) -> None:
    process, terminal = pty.fork()
    if process == 0:
        os.chdir(tmp_path)
        os.execv(sys.executable, [sys.executable, "-m", "gcs", "new", "--vehicles", "5"])
    for question, answer in (*ANSWERS, ("Margin to a fence", None)):
        said = ""
        while question not in " ".join(COLOUR.sub("", said).split()):
            said += os.read(terminal, 4096).decode()
        if answer is not None:
            os.write(terminal, f"{answer}\n".encode())
    while psutil.Process(process).status() != psutil.STATUS_SLEEPING:
        time.sleep(
            0.01
        )  # an interrupt between the question and the read of its answer takes effect with the next key only
    os.write(terminal, b"\x03")
    _, status = os.waitpid(process, 0)
    assert os.waitstatus_to_exitcode(status) == 3
    os.close(terminal)
    assert list(tmp_path.iterdir()) == []


def test_every_choice_makes_a_mission_that_holds(subtests: pytest.Subtests) -> None:
    for links, shape, vehicles in product(get_args(Links), SPACED_SHAPES, (1, 2, 20)):
        with subtests.test(f"{links} {shape} {vehicles}"):
            mission = chosen(links=links, profile=PROFILES[links], shape=shape, vehicles=vehicles)
            assert parse_mission(mission.text, None).formation.shape == shape
    for target_speed_m_s, fence_m in product((0.0, 1.5), (0.0, 0.5)):
        parse_mission(chosen(target_speed_m_s=target_speed_m_s, fence_m=fence_m).text, None)


def test_every_key_is_explained_once_and_the_name_may_be_any() -> None:
    text = chosen(name='a "b" \\ ü').text
    assert tomllib.loads(text)["mission"]["name"] == 'a "b" \\ ü'
    plain = {"name", "description", "radius_m", "id", "latitude_deg", "longitude_deg"}
    bare = {line.partition(" = ")[0] for line in text.splitlines() if " = " in line and "#" not in line}
    assert bare <= plain


def test_missions_in_one_folder_share_no_port_with_each_other_or_with_the_bundled() -> None:
    taken = {
        int(address.rpartition(":")[2])
        for name in bundled_missions()
        for vehicle in load_mission(name).vehicles
        for address in (vehicle.section.url, vehicle.section.endpoint)
    }
    for number in range(40):
        ports = own_ports(f"mission-{number}", 12, taken)
        assert taken.isdisjoint(ports)
        assert own_ports(f"mission-{number}", 12, ()) == own_ports(f"mission-{number}", 12, ())
        taken |= {*ports}
