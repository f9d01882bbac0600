"""The template of a project with tests on stub vehicles runs as it stands, and a failing test leaves its tracks."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cordon
from tests.support.paths import DOCS

pytestmark = [pytest.mark.wire, pytest.mark.long]

OTHERS = r"""
import asyncio


def test_that_fails(cordon_stubs):
    team = cordon_stubs("case2", vehicles=2)
    team[2].arm()
    assert cordon_stubs("case2", 1)[1].truth().armed


async def run(team):
    return await team.until(lambda: team[1].truth().time_s > 5.0)


def test_in_an_event_loop(cordon_stubs):
    assert asyncio.run(run(cordon_stubs("case2", 1))) > 5.0


def test_without_stubs():
    pass
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    return Path(shutil.copytree(DOCS / "examples" / "pytest-project", tmp_path / "project"))


def run_pytest(project: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run pytest in a project as a user does, also where a worker of pytest runs this test."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *arguments]
    return subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, check=False)


def test_the_template_is_green(project: Path) -> None:
    done = run_pytest(project, "-n", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 passed" in done.stdout


def test_a_failing_test_keeps_the_true_tracks_and_the_report_names_them(project: Path, tmp_path: Path) -> None:
    (project / "test_others.py").write_text(OTHERS)
    done = run_pytest(project, "-n", "2", "--basetemp", str(tmp_path / "base"), "test_others.py")
    assert done.returncode == 1
    assert "1 failed, 2 passed" in done.stdout, done.stdout + done.stderr
    assert re.findall(r"vehicle (\d): (\w+), mode Hold", done.stdout) == [
        ("1", "disarmed"),
        ("2", "armed"),
        ("1", "disarmed"),
    ]
    first, second = map(Path, re.findall(r"true tracks: (.*\.csv)", done.stdout))
    assert {*np.loadtxt(first, delimiter=",", skiprows=1)[:, 0]} == {1.0, 2.0}
    assert {*np.loadtxt(second, delimiter=",", skiprows=1)[:, 0]} == {1.0}


FLIGHTS = """
import cordon
import pytest


@pytest.mark.parametrize("closest_m", [2.0, 99.0])
def test_flight(cordon_flight, closest_m):
    mission = cordon.load("case2", {"target.start_m": [10.0, 0.0]})
    wider = cordon.Commanded(20.0, "ring radius=12")
    result = cordon_flight(mission, duration_s=45.0, faults=["GPS-jump@30:2"], commands=[wider], speed=20.0)
    assert result.faults == ("GPS-jump@30:2",)
    assert {event.ring.radius_m for event in result.events if event.ring is not None} == {12.0}
    assert result.closest_approach_m > closest_m
"""


def test_flights_run_beside_each_other_and_a_failing_test_keeps_log_and_report(project: Path, tmp_path: Path) -> None:
    (project / "test_flights.py").write_text(FLIGHTS)
    done = run_pytest(project, "-n", "2", "--basetemp", str(tmp_path / "base"), "-m", "cordon", "test_flights.py")
    assert "1 failed, 1 passed" in done.stdout, done.stdout + done.stderr
    ((log, page),) = re.findall(r"^log: (.*\.mcap), report: (.*\.html)$", done.stdout, re.MULTILINE)
    assert cordon.read(log).metrics.faults == ("GPS-jump@30:2",)
    assert "GPS" in Path(page).read_text(encoding="utf-8")


def test_tests_with_stubs_have_a_mark(project: Path) -> None:
    (project / "test_others.py").write_text(OTHERS)
    done = run_pytest(project, "-m", "not cordon")
    assert (done.returncode, "1 passed, 5 deselected" in done.stdout) == (0, True), done.stdout
