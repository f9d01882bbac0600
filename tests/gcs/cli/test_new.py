"""`cordon new`: the file it writes, what it refuses, and that it writes nothing then."""

import os
import pty
import sys
import tomllib
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import get_args

import pytest

from agents.settings.shapes import SPACED_SHAPES
from gcs.cli import main
from gcs.mission.file import bundled_missions, load_mission, parse_mission
from gcs.mission.template import PROFILES, Links, NewMission, own_ports

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
OPTIONS = tuple(word for pair in CHOICES.items() for word in pair)


@pytest.fixture
def new(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Return a runner of `cordon new my.toml` in an empty folder, without a terminal: its exit code."""
    monkeypatch.chdir(tmp_path)

    def run(*options: str) -> int:
        monkeypatch.setattr(sys, "argv", ["cordon", "new", "my.toml", *options])
        with pytest.raises(SystemExit) as ended:
            main()
        return int(ended.value.code or 0)

    return run


def chosen(**changes: object) -> NewMission:
    usual = {"name": "my", "vehicles": 5, "links": "stub", "profile": "stub", "shape": "line", "radius_m": 15.0}
    more = {"angular_rate_rad_s": 0.1, "target_speed_m_s": 0.1, "fence_m": 20.0, "ports": range(20000, 20254)}
    return NewMission(**{**usual, **more, **changes})  # type: ignore[arg-type]  # by name


def test_a_mission_of_ones_own_settles_on_its_ring(
    new: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(*OPTIONS, "--profile", "0.8,0.9,0.1", "--plot", "my.svg") == 0
    said = capsys.readouterr().err
    assert "5 of 5 vehicles engaged the target" in said
    assert "settled after" in said
    assert (tmp_path / "my.svg").stat().st_size > 0
    mission = load_mission("my.toml")
    ring, target = mission.encirclement, mission.target
    assert (len(mission.vehicles), mission.formation.shape, ring.radius_m, ring.angular_rate_rad_s) == (
        5,
        "wedge",
        15.0,
        0.1,
    )
    assert target.velocity_m_s == (0.1, 0.0)
    plant = mission.vehicles[0].plant
    assert (plant.x.a0_per_s2, plant.y.a1_per_s, plant.delay_s) == (0.8, 0.9, 0.1)
    before = {path: path.read_bytes() for path in tmp_path.glob("*.toml")}
    assert new(*OPTIONS) == 2
    assert "my.toml exists already" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.glob("*.toml")} == before


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--radius", "2"], ["--radius", "2.56", "3 m between vehicles"]),
        (["--rate", "0.3"], ["encirclement.angular_rate_rad_s", "4.60 m/s", "3.0 m/s"]),
        (["--radius", "nan"], ["--radius", "'nan'"]),
        (["--vehicles", "0"], ["--vehicles", "'0'"]),
        (["--links", "wifi"], ["--links", '"wifi"', "stub"]),
        (["--target", "fast"], ["--target", "'fast'"]),
        (["--profile", "0.8,0.9"], ["--profile", "A0,A1,DELAY", "'0.8,0.9'"]),
        (["--profile", "0.8,-1,0"], ["--profile", "'-1'"]),
        (["--profile", "mine.toml"], ["vehicles[0].profile", "'mine.toml'", "bundled profiles: "]),
    ],
)
def test_what_would_not_hold_is_refused_before_anything_is_written(
    new: Callable[..., int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    says: list[str],
) -> None:
    assert new(*(word for pair in {**CHOICES, options[0]: options[1]}.items() for word in pair)) == 2
    said = capsys.readouterr().err
    assert [words for words in says if words not in said] == [], said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("links", "step"), [("udp", "fly my.toml --sitl --speed 10"), ("serial", "check my.toml")])
def test_the_next_command_fits_the_links(
    new: Callable[..., int], capsys: pytest.CaptureFixture[str], links: str, step: str
) -> None:
    new(*(word for pair in {**CHOICES, "--links": links, "--profile": "stub"}.items() for word in pair))
    assert f"next: cordon {step}" in capsys.readouterr().err


def test_without_a_terminal_every_missing_option_is_named(
    new: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new("--vehicles", "5", "--shape", "wedge") == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["--links", "--radius", "--rate", "--target", "--fence"]
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_at_a_question_writes_nothing(tmp_path: Path) -> None:
    process, terminal = pty.fork()
    if process == 0:
        os.chdir(tmp_path)
        os.execv(sys.executable, [sys.executable, "-m", "gcs", "new", "my.toml", "--vehicles", "5"])
    said = b""
    while b"(stub)" not in said:
        said += os.read(terminal, 4096)
    os.write(terminal, b"udp\n")
    while b"(px4)" not in said:
        said += os.read(terminal, 4096)
    os.write(terminal, b"\x03")
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 3
    os.close(terminal)
    assert list(tmp_path.iterdir()) == []


def test_every_choice_makes_a_mission_that_holds(subtests: pytest.Subtests) -> None:
    for links, shape, vehicles in product(get_args(Links), SPACED_SHAPES, (1, 2, 5, 20)):
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
    for number in range(200):
        ports = own_ports(f"mission-{number}", 12, taken)
        assert taken.isdisjoint(ports)
        assert own_ports(f"mission-{number}", 12, ()) == own_ports(f"mission-{number}", 12, ())
        taken |= {*ports}
