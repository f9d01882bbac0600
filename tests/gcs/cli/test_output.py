"""What a command leaves behind: JSON for scripts, text for people, a figure where it was asked for."""

import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from gcs.cli import output
from gcs.cli.output import SimulationProgress, check_plot, present
from gcs.errors import InputError
from gcs.flight.simulated import fly_simulated
from gcs.metrics.record import FlightRecord
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission


@pytest.fixture(scope="module")
def mission() -> Mission:
    return load_mission("case1")


@pytest.fixture(scope="module")
def record(mission: Mission) -> FlightRecord:
    """A flight that has just begun: nothing can have gone wrong yet."""
    return fly_simulated(mission, 3, 2.0, lambda _: None)


# Figures are refused before anything flies


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a file in it, and a folder with the name of a figure."""
    (tmp_path / "file").touch()
    (tmp_path / "folder.png").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_figure_that_cannot_be_is_a_fault(folder: Path, subtests: pytest.Subtests) -> None:
    for writable in ("FLIGHT.PDF", "a[b].png", "two words.svg"):
        check_plot(Path(writable))
        check_plot(folder / writable)
    for name, number, fault in [
        *((name, None, r"--plot: .* must end in") for name in ("a.png.txt", "png", "")),
        *((f"{parent}/a.png", None, "--plot: no folder") for parent in ("missing", "file")),
        ("folder.png", None, r"--plot: .*folder\.png"),
        ("a.png", 7, "--figure: the paper has no figure 7"),
        (None, 4, "add --plot"),
    ]:
        with subtests.test(name=name, number=number), pytest.raises(InputError, match=fault):
            check_plot(None if name is None else Path(name), number)


# The result


def test_a_figure_is_written_and_its_name_is_told_as_it_is(
    mission: Mission, record: FlightRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a[b]c.svg"
    present(mission, record, json=False, plot=path)
    assert path.read_bytes().startswith(b"<?xml")
    assert f"figure: {path}\n" in capsys.readouterr().err


def test_a_figure_that_cannot_be_written_after_all_is_told(
    mission: Mission, record: FlightRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "gone" / "flight.png"
    with pytest.raises(InputError, match=r"--plot: .*gone"):
        present(mission, record, json=True, plot=path)


# Progress


def test_progress_on_a_terminal_names_the_mission_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    screen, name = StringIO(), "[bold]{braces}[/bold] 50 %"
    monkeypatch.setattr(output, "STDERR", Console(file=screen, force_terminal=True, width=120, color_system=None))
    with SimulationProgress(name, 10.0) as progress:
        for flown_s in range(8):
            progress.update(float(flown_s))
    assert f"{name}: 7 of 10 s flown" in screen.getvalue()


def test_a_simulation_imports_no_link_no_bus_and_no_viewer() -> None:
    """Each takes longer to import than a short mission takes to fly."""
    heavy = ("mavsdk", "zenoh", "foxglove", "mcap", "psutil", "matplotlib", "pymavlink")
    program = (
        f"import sys, gcs.cli.output, gcs.flight.simulated; print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
